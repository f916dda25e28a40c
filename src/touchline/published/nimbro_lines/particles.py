"""The configuration of the particle filter on features (Schulz and Behnke 2012, section 5): augmented MCL.

particles ─▶ motion (3) ─▶ crossings and landmarks (4, 5), lines (6, 7) ─▶ product (8) ─▶ weights ─▶ main mode
    ▲                                                                         │
    └── random particles, if certainty drops ◀── resampling, 250 to 1000 ◀────┘
"""

import math
from typing import NamedTuple

import numba
import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.field import FieldModel
from touchline.field.region import Region
from touchline.geometry import FloatArray, Pose, as_pose
from touchline.localization.registration.feature_model import FeatureModel, FeatureView
from touchline.localization.search.feature_poses import FeaturePoses, PoseProposals
from touchline.motion.odometry import Motion
from touchline.published.particles.motion_model import MotionModel, MotionNoise
from touchline.published.particles.particle_filter import ParticleFilter
from touchline.published.particles.particle_set import ParticleSet, mean_and_covariance
from touchline.published.particles.random_particles import BEYOND_M, AugmentedInjection, UniformPoses
from touchline.published.particles.resampling import EVERY_CYCLE, CertaintyNumber, Resampling

MIN_DEVIATIONS = np.array([0.02, 0.02, 0.01])  # smallest believed ones of a mode: few particles may be left in it
UNCERTAIN_M = 1.0  # deviation of the position from which there are most particles
MODE_M = 0.6  # radius of a mode of the particles ...
MODE_RAD = 0.5  # ... and how far its headings reach
CELL_M, CELL_RAD = 0.5, math.pi / 6.0  # of the histogram that finds modes
SLOW, FAST = 0.02, 0.2  # forgetting of the long- and the short-term likelihood per cycle: some 50 and 5 images
PROPOSED_RATIO = 0.2  # of the particles while searching: at poses that the features of the frame propose


class StepNoise(MotionNoise):
    """The motion model's noise on top of the odometry's own: that of steps."""

    translation_from_translation: float = Field(
        0.1, ge=0, description="noise of the position per distance walked (m/m): steps slip"
    )
    rotation_from_rotation: float = Field(0.1, ge=0, description="noise of the heading per turn (rad/rad): steps slip")
    rotation_from_translation_rad_per_m: float = Field(
        0.05, ge=0, description="noise of the heading per distance walked (rad/m): steps bend"
    )
    translation_at_rest_m: float = Field(
        0.01, ge=0, description="noise of the position per cycle, at rest, too (m): parts equal particles"
    )
    rotation_at_rest_rad: float = Field(
        0.01, ge=0, description="noise of the heading per cycle, at rest, too (rad): as translation_at_rest_m"
    )


class NimbroParticlePaper(Settings):
    """Switches to the paper's exact form."""

    resample_always: bool = added(
        False,
        paper=True,
        description="draw the particles anew in every cycle, as the paper does; off: once half of them are effective",
    )
    min_effective_ratio: float = added(
        0.05,
        paper=0.0,
        ge=0,
        lt=1,
        description="ratio of particles that an observation must leave effective: its likelihood is tempered, for "
        "features of one frame err together; 0 is the paper's form",
    )
    per_observation: bool = added(
        True,
        paper=False,
        description="random particles by the likelihood of one observation, so that frames that show more are no "
        "worse; off by that of all, as in the paper",
    )
    start_particles: int = added(
        4000,
        paper=1000,
        ge=10,
        le=10_000_000,
        description="particles at a start from nowhere, until they are drawn anew for the first time; the paper has no "
        "more than 1000",
    )
    proposals: bool = added(
        True,
        paper=False,
        description="while searching, random particles start where the features of the frame fit the field, too; off: "
        "anywhere, as in the paper",
    )


class NimbroParticleSettings(Settings):
    """The paper gives 250 to 1000 particles and the models; nothing else."""

    min_particles: int = Field(
        250, ge=10, le=10_000_000, description="particles while the pose is certain; the paper's 250"
    )
    max_particles: int = Field(1000, ge=10, le=10_000_000, description="particles while it is not; the paper's 1000")
    random_ratio: float = Field(
        0.01, ge=0, lt=1, description="ratio of random particles in every drawing: the paper's small amount"
    )
    max_random_ratio: float = Field(
        0.2,
        ge=0,
        lt=1,
        description="largest ratio of random particles, when the likelihood falls: more leave too few to a right pose. "
        "With this and random_ratio 0 a pose is tracked, and never found anew, as in the paper's section 6.2",
    )
    motion: StepNoise = StepNoise()
    paper: NimbroParticlePaper = NimbroParticlePaper()


class ParticleMode(NamedTuple):
    """A cluster of particles: mean, covariance (3, 3) in (m, m, rad), field frame, and its share of all weight.

    twin_weight: the share of those about its twin, half a turn about the centre mark.
    """

    pose: Pose
    covariance: FloatArray
    weight: float
    twin_weight: float = 0.0


class SidedPoses(NamedTuple):
    """Random poses at the end of the field where the robot is known to be: of a pose and its twin the one that faces
    the way of `about`, or lies in that half, so that random particles don't take a robot to the other end, which looks
    the same.
    """

    uniform: UniformPoses
    about: Pose | Region | None

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """So many poses (count, 3)."""
        poses = self.uniform.draw(rng, count)
        if self.about is not None:
            poses[:, 2] += math.pi * rng.integers(0, 2, count)
            poses = on_side(poses, self.about)
        return poses


def on_side(poses: FloatArray, about: Pose | Region) -> FloatArray:
    """Of each pose (N, 3) and its twin the one that faces the way of another pose, or lies in a half of the field."""
    far = poses[:, :1] > about.max_x if isinstance(about, Region) else np.cos(poses[:, 2:] - about.heading) < 0.0
    return np.where(far, poses * (-1.0, -1.0, 1.0) + (0.0, 0.0, math.pi), poses)


class NimbroParticles:
    """Particles on one field. `filter`: the particle filter; `particles`: its set."""

    def __init__(
        self,
        field: FieldModel,
        model: FeatureModel,
        rng: np.random.Generator,
        symmetric: bool,
        settings: NimbroParticleSettings | None = None,
    ) -> None:
        """symmetric: nothing tells both ends of the field apart."""
        self.settings = s = settings or NimbroParticleSettings()
        self.rng, self.symmetric, self.sensor_model = rng, symmetric, model
        self._reach_m = 0.5 * np.array([field.length, field.width]) + BEYOND_M
        self.proposals = PoseProposals(model, self._reach_m) if s.paper.proposals else None
        self.particles = ParticleSet(np.zeros((1, 3)))
        number = CertaintyNumber(s.min_particles, max(s.min_particles, s.max_particles), UNCERTAIN_M)
        self.injection = AugmentedInjection(
            SidedPoses(UniformPoses(self._reach_m), None), SLOW, FAST, s.random_ratio, s.max_random_ratio
        )
        self.filter: ParticleFilter[FeatureView] = ParticleFilter(
            self.particles,
            MotionModel(s.motion),
            model,
            Resampling(EVERY_CYCLE if s.paper.resample_always else 0.5, number),
            rng,
            self.injection,
            min_effective=s.paper.min_effective_ratio * s.max_particles,
        )
        self.restart()

    def restart(self, region: Region | None = None) -> None:
        """Spread the particles over the field or a region of it. Of twins on a symmetric field one half is enough."""
        uniform = UniformPoses(self._reach_m, region or Region(), None, self.symmetric)
        self._start(uniform.draw(self.rng, self.settings.paper.start_particles))

    def start_at(self, pose: Pose, covariance: FloatArray) -> None:
        """Start about a pose that is known with a covariance (3, 3)."""
        drawn = self.rng.multivariate_normal(pose.as_array(), covariance, self.settings.max_particles, method="eigh")
        self._start(np.ascontiguousarray(drawn))

    def predict(self, motion: Motion) -> None:
        """Equation (3): every particle moves by the odometry's motion, with noise of its own."""
        self.filter.predict(motion)

    def update(self, view: FeatureView, about: Pose | Region | None = None, searching: bool = False) -> ParticleMode:
        """Equations (4) to (8) and resampling; returns the main mode. A view without features changes nothing.

        about: the pose on whose side of a symmetric field random particles start, or the half they start in; None: on
        both. searching: whether there is no pose that is believed.
        """
        if view.size:
            if searching and self.proposals is not None:
                self._inject(self.proposals.of(view), about)
            self.injection.poses = SidedPoses(UniformPoses(self._reach_m), about if self.symmetric else None)
            self.injection.observations = view.size if self.settings.paper.per_observation else 1
            self.filter.weigh(view)
            self.filter.normalize()
            self._mode = self.main_mode()
            self.filter.resample_if_due()
        else:
            self._mode = self.main_mode()
        return self._mode

    def main_mode(self) -> ParticleMode:
        """The heaviest cluster of particles."""
        poses, weights = self.particles.poses, self.particles.weights
        inside = in_mode(poses, weights, self._reach_m[0], self._reach_m[1])
        weight = float(inside.sum())
        if weight <= 0.0:
            found = self.particles.estimate()
            return ParticleMode(found.pose, found.covariance, 0.0)
        mean, covariance = mean_and_covariance(poses, inside / weight)
        floor = np.maximum(MIN_DEVIATIONS**2 - np.diag(covariance), 0.0)
        pose = as_pose(mean)
        return ParticleMode(pose, covariance + np.diag(floor), weight, self._weight_near(pose.mirrored()))

    def _weight_near(self, pose: Pose) -> float:
        away = self.particles.poses - pose
        near = np.hypot(away[:, 0], away[:, 1]) < MODE_M
        near &= np.cos(away[:, 2]) > math.cos(MODE_RAD)
        return float(self.particles.weights[near].sum())

    def _inject(self, proposed: FeaturePoses, about: Pose | Region | None) -> None:
        count = int(PROPOSED_RATIO * len(self.particles))
        if len(proposed.poses) and count:
            poses = proposed.draw(self.rng, count)
            self.filter.inject(poses if about is None or not self.symmetric else on_side(poses, about))

    def _start(self, poses: FloatArray) -> None:
        self.filter.start(poses)
        poses_from, s = self.injection.poses, self.settings
        self.injection = AugmentedInjection(poses_from, SLOW, FAST, s.random_ratio, s.max_random_ratio)
        self.filter.injection = self.injection


@numba.njit(cache=True)
def in_mode(poses, weights, reach_x, reach_y):  # type: ignore[no-untyped-def]
    """Weights (N,) of the particles in the heaviest mode, 0 elsewhere.

    The heaviest cell of a histogram over poses (N, 3), within reach_x, reach_y (m) of the centre, is the start of a
    mean shift with a window of MODE_M and MODE_RAD.
    """
    nx, ny = int(2.0 * reach_x / CELL_M) + 3, int(2.0 * reach_y / CELL_M) + 3
    nt = int(2.0 * math.pi / CELL_RAD + 0.5)
    cells = np.zeros((nx, ny, nt))
    best, bx, by, bt = -1.0, 0, 0, 0
    for j in range(poses.shape[0]):
        ix = min(max(int((poses[j, 0] + reach_x) / CELL_M) + 1, 0), nx - 1)
        iy = min(max(int((poses[j, 1] + reach_y) / CELL_M) + 1, 0), ny - 1)
        it = math.floor(poses[j, 2] / CELL_RAD) % nt
        cells[ix, iy, it] += weights[j]
        if cells[ix, iy, it] > best:
            best, bx, by, bt = cells[ix, iy, it], ix, iy, it
    x, y = (bx - 0.5) * CELL_M - reach_x, (by - 0.5) * CELL_M - reach_y
    heading = (bt + 0.5) * CELL_RAD
    inside = np.zeros(poses.shape[0])
    for _ in range(4):
        total = sx = sy = st = 0.0
        for j in range(poses.shape[0]):
            dx, dy = poses[j, 0] - x, poses[j, 1] - y
            turned = poses[j, 2] - heading
            turned -= 2.0 * math.pi * math.floor(turned / (2.0 * math.pi) + 0.5)
            near = dx * dx + dy * dy < MODE_M * MODE_M and abs(turned) < MODE_RAD
            inside[j] = weights[j] if near else 0.0
            if near:
                total += weights[j]
                sx += weights[j] * dx
                sy += weights[j] * dy
                st += weights[j] * turned
        if total <= 0.0:
            break
        x, y, heading = x + sx / total, y + sy / total, heading + st / total
    return inside
