"""What the experiments of iris-fusion share: one drive by odometry, particles and fusion, its eyes.

These are rays every 2.5 degrees, masks of HSV and HSL, and ranges by a regression of the robot's own (Ismail et al.
2021, section II.B, figures 6, 7 and 14).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from touchline.camera import require_omni
from touchline.config import Settings
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, IntArray, Pose, wrap_angles
from touchline.motion import DeadReckoning, MotionHistory
from touchline.published.iris_fusion.modes import MIN_POINTS
from touchline.published.iris_fusion.particles import IrisParticles
from touchline.published.iris_fusion.range_pairs import Optics, RangePairs
from touchline.published.iris_fusion.range_regression import RangeRegression, fit_range
from touchline.published.iris_fusion.system import IrisFusionSettings, evenly_chosen
from touchline.systems import RobotSetup, open_system, paper_settings
from touchline.types import Estimate, LinePoints, Mode, Status
from touchline_lab.experiments.drives import Drive, Track
from touchline_lab.experiments.harness import gathered, seed_range
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.observation.goal_clutter import GoalClutter
from touchline_lab.simulation.observation.observed_lines import IRIS_PATHS
from touchline_lab.simulation.observation.point_errors import ObservationNoise
from touchline_lab.simulation.run import Eyes, Simulation
from touchline_lab.simulation.scenario import Scenario
from touchline_lab.simulation.world.calibration_layout import STRIP_EDGES_M

IDEAL = ("ideal=true",)
SYSTEMS = ODOMETRY, PARTICLES, FUSION = "odometry", "particle filter", "sensor fusion"
FORMS = ("as built", "its form here", "ideal")
IMAGE_ROBOTS = 1  # robots whose images are rendered, which takes a hundred times as long as their points


@dataclass(frozen=True, eq=False, slots=True)
class IrisDrive:
    """One drive from the first located image on, N images; none if the robot was never found.

    tracks: by the names of SYSTEMS, (N) each. seen (N,): whether the image showed anything. modes: of the fusion.
    before_ns (B,): stamps of the images before the first.
    """

    field: FieldModel
    tracks: Mapping[str, Track]
    seen: BoolArray
    modes: tuple[Mode | None, ...]
    before_ns: IntArray

    @property
    def fused(self) -> Track:
        """Of the fusion."""
        return self.tracks[FUSION]

    @property
    def truth(self) -> FloatArray:
        """(N, 3) where the robot was."""
        return self.fused.truth

    @property
    def found(self) -> bool:
        """Whether the robot was found, and followed for two images at least."""
        return len(self.truth) > 1

    def tracked_ratio(self, start_s: float) -> float:
        """Share of all images from some time on in which the robot is tracked; of none before it is found."""
        late = self.fused.times_s >= start_s
        count = np.count_nonzero(late) + np.count_nonzero(self.before_ns >= 1e9 * start_s)
        return float(np.count_nonzero(self.fused.tracking[late])) / max(int(count), 1)

    def jitter(self, system: str) -> tuple[float, float]:
        """How much the error changes from image to image, root mean square: position (m), heading (rad)."""
        steps = np.diff(self.tracks[system].errors, axis=0)
        turns = wrap_angles(steps[:, 2])
        return math.sqrt(float(np.mean(steps[:, 0] ** 2 + steps[:, 1] ** 2))), math.sqrt(float(np.mean(turns**2)))


def drive(taken: Drive, seed: int, paper: bool = False) -> IrisDrive:
    """Take every frame through the fusion, the particle filter alone and the odometry alone.

    Odometry and particles start where the fusion first found the robot and
    are left alone from then on: the odometry's pose is what wheels and gyro say (figure 4), the particles' is their own
    mean (figure 8), moved by the same wheels and gyro. Nothing comes to them from the fusion. paper: all three with the
    system's preset.
    """
    s: Settings = paper_settings("iris-fusion") if paper else IrisFusionSettings()
    assert isinstance(s, IrisFusionSettings)
    setup = taken.setup
    system = open_system("iris-fusion", setup, s, np.random.default_rng(seed))
    history = MotionHistory(s.odometry, s.compass_track, s.gyro, s.wheels, setup.wheel_directions_rad)
    odometry = DeadReckoning(history)
    particles = IrisParticles(setup.field, np.random.default_rng(seed), s.particles)
    estimates: list[Estimate] = []
    poses: list[tuple[Pose, Pose, Pose]] = []
    before: list[int] = []
    for frame in taken.frames:
        history.add(frame)
        motion = odometry.advance(frame.stamp_ns)
        estimate = system.step(frame)
        points = LinePoints.none() if estimate.observation is None else estimate.observation.points
        if estimates:
            particles.predict(motion)
            if len(points) >= MIN_POINTS:
                most = len(points) if s.paper.all_points else s.max_points
                particles.update(evenly_chosen(points, most).positions_m)
        elif estimate.status is Status.TRACKING:
            odometry.set_pose(estimate.pose)
            particles.start_at(estimate.pose, estimate.covariance)
        else:
            before.append(frame.stamp_ns)
            continue
        estimates.append(estimate)
        poses.append((odometry.pose, particles.estimate().pose, estimate.pose))
    rows = np.array(poses, dtype=np.float64).reshape(-1, len(SYSTEMS), 3)
    times_s = np.array([e.stamp_ns for e in estimates], dtype=np.int64) / 1e9
    tracking = np.array([e.status is Status.TRACKING for e in estimates], dtype=np.bool_)
    true = taken.truth[len(before) :]
    return IrisDrive(
        setup.field,
        {name: Track(times_s, rows[:, k], true, tracking) for k, name in enumerate(SYSTEMS)},
        np.array([e.points > 0 for e in estimates], dtype=np.bool_),
        tuple(e.mode for e in estimates),
        np.array(before, dtype=np.int64),
    )


Runs = dict[str, list[IrisDrive]]
"""Drives by form: the names of FORMS, and the same on images."""


def by_form(seeds: int, what: str, one: Callable[[int, str, tuple[str, ...], bool], IrisDrive]) -> Runs:
    """The drives of each form at the observation level: one(seed, level, changes to the robot, whether by the paper's
    own form).
    """

    def forms(seed: int) -> dict[str, IrisDrive]:
        forms = (((), False), ((), True), (IDEAL, False))
        return {name: one(seed, "points", *form) for name, form in zip(FORMS, forms, strict=True)}

    return gathered(forms, seed_range(seeds), what)


def found_of(runs: Mapping[str, Sequence[IrisDrive]]) -> Runs:
    """By form those drives in which the robot was found."""
    return {form: [driven for driven in drives if driven.found] for form, drives in runs.items()}


def missed_note(*runs: Mapping[str, Sequence[IrisDrive]]) -> tuple[str, ...]:
    """A note on drives in which the robot was not found, if there are any."""
    drives = [driven for some in runs for each in some.values() for driven in each]
    missed = sum(not driven.found for driven in drives)
    return (f"The robot was not found in {missed} of {len(drives)} drives; they are left out.",) if missed else ()


DIRECTIONS = 24
MARK_NOISE_PX = 0.3
# How HsvLineDetector errs on rendered images
IRIS_NOISE = ObservationNoise(
    noise_px=0.0509, tail=1.056, oblique_sine=0.407, thin_px=0.271, kept_ratio=0.947, phase_px=0.3,
    found_ratio=0.977, thin_half_px=0.931, thin_slope_px=0.0714, coarse_half_m=0.2787, coarse_slope_m=0.0037,
    flat_half=0.174, flat_slope=0.11, blur_px=4.61, long_slope_px=0.896, bar_ratio=0.707, bar_half_m=5.18,
    bar_slope_m=0.0537, mark_ratio=0.582, grazed_ratio=0.355, grazed_factor=6.64, mixed_ratio=0.997,
    mixed_factor=2.08, contrast_px=1.23, false_points=0.0396,
    white_goals=GoalClutter(
        net_points=50.0, net_half_m=2.87, net_slope_m=0.474, net_near_m=2.77, side_points=4.49, side_half_m=3.5,
        side_slope_m=0.596
    ),
    coloured_goals=GoalClutter(
        net_points=90.1, net_half_m=3.0, net_slope_m=0.474, net_near_m=2.66, side_points=12.9, side_half_m=1.69,
        side_slope_m=1.25
    ),
    covered_goals=GoalClutter(
        net_points=40.2, net_half_m=2.58, net_slope_m=0.437, net_near_m=2.71, side_points=7.06, side_half_m=2.98,
        side_slope_m=0.8
    ),
)  # fmt: skip


def range_regression(simulation: Simulation, rng: np.random.Generator) -> RangeRegression:
    """Figure 14: marks at the distances of the strip, seen in many directions by the robot's own head as it is built.

    One polynomial for all directions, as in the paper: what a tilted mirror does differently on two sides stays in it.
    """
    bearings = np.repeat(2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS), len(STRIP_EDGES_M))
    ranges = np.tile(STRIP_EDGES_M, DIRECTIONS)
    ground = np.column_stack((ranges * np.cos(bearings), ranges * np.sin(bearings)))
    head = simulation.camera_model
    pixels = (
        head.project(ground) if isinstance(head, SimulatedOmniCamera) else simulation.camera.image_from_ground(ground)
    )
    mirror = require_omni(simulation.camera, "marks are read in images of")
    offset = pixels + MARK_NOISE_PX * rng.standard_normal(pixels.shape) - mirror.center
    optics = Optics(
        mirror.width, mirror.height, mirror.center, mirror.handedness, mirror.mount_yaw_rad, mirror.inner_radius_px
    )
    places = tuple(f"mark {k}" for k in range(len(ranges)))
    words = f"{len(ranges)} simulated marks"
    return fit_range(
        RangePairs(np.hypot(*offset.T), ranges, np.arctan2(offset[:, 1], offset[:, 0]), places, words, optics)
    )


def open_iris(scenario: Scenario, level: str, seed: int) -> tuple[Simulation, RobotSetup]:
    """A run and the robot in it, who looks through the regression that its own head has marked.

    level: `images`, through its masks and rays; or `points`, with the geometry and the errors of these.
    """
    simulation = Simulation(scenario, level)
    known = range_regression(simulation, np.random.default_rng([seed, 14])).camera()
    if level == "points":
        simulation = Simulation(scenario, level, eyes=Eyes(IRIS_PATHS, IRIS_NOISE, known))
    return simulation, RobotSetup(simulation.field, known, simulation.wheel_directions_rad)
