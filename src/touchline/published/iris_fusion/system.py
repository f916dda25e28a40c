"""iris-fusion: measuring wheels and gyro, particle filter, and the fusion of both.

M. A. Ismail, D. Purwanto, A. Arifin: Soccer robot localization based on sensor fusion from odometry and omnivision,
figures 1, 4, 8 and 11.

    encoders, gyro ─▶ odometry (1-6) ───┬────────────────────────▶ sensor fusion (15-19) ─▶ estimate, mode
                          ▲             ▼                              ▲      │
    image ─▶ line points ─┼─▶ particle filter (7-14) ──────────────────┘      │
    compass ──────────────┼──────▶┘ first headings                           │
                          └──────────── offset ◀─────────────────────────────┘
"""

import math
from dataclasses import fields, replace

import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.field.region import OWN_HALF
from touchline.geometry import FloatArray, Pose, mirrored_covariance, wrap_angle
from touchline.localization.camera_errors.mirror_response import HEIGHT_M
from touchline.localization.estimator.monitor import monitored
from touchline.localization.registration.covariance import is_one_line
from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.motion import (
    CompassTrackSettings,
    DeadReckoning,
    GyroSettings,
    Motion,
    MotionHistory,
    OdometrySettings,
    WheelSettings,
)
from touchline.motion.samples import NANOSECONDS
from touchline.motion.start import StartSettings
from touchline.perception import observe
from touchline.published.iris_fusion.field_side import FieldSide
from touchline.published.iris_fusion.hsv_lines import HsvLineDetector, HsvLineSettings
from touchline.published.iris_fusion.image_doubt import ImageMirror
from touchline.published.iris_fusion.modes import MIN_POINTS, SensorFusion, SensorFusionSettings
from touchline.published.iris_fusion.particles import IrisParticles, IrisParticleSettings
from touchline.published.iris_fusion.restart import RestartRule, RestartSettings
from touchline.published.particles.particle_set import ParticleEstimate
from touchline.systems.info import Needs, SystemInfo
from touchline.systems.setup import RobotSetup, open_monitor, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import (
    Estimate,
    Frame,
    Hypothesis,
    LinePoints,
    Mode,
    Observation,
    Prior,
    Status,
    as_prior,
)

_STILL = Motion(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)


NEAR_FITTED_M = 0.06  # the same while the camera's errors are unknown, of points that they are fitted to
NEAR_M = 0.1  # distance within which a point lies on a line: calibration, blur
# what the camera may shake by in one image (rad), which moves far points off their lines: while the robot is searched
# for such points count, up to NEAR_M more
SHAKE_RAD = math.radians(0.1)
_END_RAD = 0.5 * math.pi  # difference of two headings from which they belong to different ends of the field
# standard deviation of the first headings about the one known before the robot was lost, without a compass, beside what
# odometry may have gone wrong: a robot may have been turned, hardly to the other goal
KNOWN_HEADING_RAD = 0.8
OWN_HALF_M = 0.1  # how far beyond the centre line a robot may stand whose own half is given


class IrisPaper(Settings):
    """Switches to the paper's exact form."""

    all_points: bool = added(
        False,
        paper=True,
        description="true as in the paper: every point has its say; false: no more than max_points, evenly chosen",
    )
    monitor: bool = monitored()


class IrisFusionSettings(StartSettings):
    """Everything that the paper fixes, and everything that it leaves open."""

    lines: HsvLineSettings = HsvLineSettings()
    max_points: int = Field(
        100,
        ge=1,
        le=10_000_000,
        description="line points that the particles are weighed by, evenly chosen of more: the time grows with it",
    )
    wheels: WheelSettings = WheelSettings()
    gyro: GyroSettings = GyroSettings()
    odometry: OdometrySettings = OdometrySettings()
    compass_track: CompassTrackSettings = CompassTrackSettings()
    particles: IrisParticleSettings = IrisParticleSettings()
    fusion: SensorFusionSettings = SensorFusionSettings()
    restart: RestartSettings = RestartSettings()
    paper: IrisPaper = IrisPaper()


class IrisFusion:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: IrisFusionSettings, rng: np.random.Generator) -> None:
        """setup: without its wheels' directions the frames' odometry takes the wheels' place."""
        self.setup = setup
        self.settings = settings
        self.field = field = setup.field
        self.unknown = np.diag([0.5 * field.length, 0.5 * field.width, math.pi]) ** 2
        """Covariance (3, 3) of a pose of a robot that may be anywhere (m, m, rad)."""
        self.detector = (
            None if setup.camera is None else HsvLineDetector(setup.camera, settings.lines, field.line_width)
        )
        s = settings
        self.max_range_m = setup.max_range_m
        self.history = MotionHistory(s.odometry, s.compass_track, s.gyro, s.wheels, setup.wheel_directions_rad)
        self.odometry = DeadReckoning(self.history)
        self.rng = rng
        paper = settings.fusion.paper
        self.image = ImageMirror(LearnedMirror(field, setup.camera, paper.camera_errors, (paper.displacement, True)))
        self.mirror = self.image.mirror
        self.fusion = SensorFusion(settings.fusion)
        self.restart = RestartRule(settings.restart)
        self.side = FieldSide(settings.restart.paper.heading_rad)
        self.monitor = open_monitor(setup, settings.paper.monitor)
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        s, prior = self.settings, as_prior(prior)
        self.region = replace(OWN_HALF, max_x=OWN_HALF.max_x + OWN_HALF_M) if prior.own_half else None
        self.moved = Pose(0.0, 0.0, 0.0)  # since the robot stood in the start region
        self.history.clear()
        self.odometry.reset(prior.pose)
        self.fusion.forget()
        self.image.reset()
        self.status = Status.SEARCHING
        self.side.start(known=True, start_known=prior.pose is not None)
        self.stamp_ns: int | None = None
        self.searching = prior.pose is None
        self.restart.reset()
        self.monitor.reset()
        self.particles = IrisParticles(self.field, self.rng, s.particles)
        if prior.pose is not None:
            covariance = s.start_covariance if prior.covariance is None else prior.covariance
            self.fusion.place(prior.pose, covariance)
            self.particles.start_at(prior.pose, covariance)
            self.status = Status.TRACKING

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        clock = Stopwatch()
        self.status = Status.SEARCHING if self.searching else self.status
        motion, duration_s = self._odometry(frame)  # predict: wheels and gyro, figure 4, equations (1) to (6)
        observation = clock.perception(observe, frame, self.detector, self.max_range_m)  # observe: figures 6 and 7
        compass_rad = self.history.at(frame.stamp_ns).heading_rad
        vision, residual_m = self._particle_filter(observation.points, motion, compass_rad)  # figure 8, (7) to (14)
        self.fusion.update(  # fuse: figure 11, (15) to (19)
            self.odometry.pose, motion, vision, duration_s, motion.by_gyro, vision and self.image.doubt(vision.pose)
        )
        self._correct(compass_rad)  # figure 1: the odometry's offset
        estimate = self._report(observation, residual_m, clock)
        return self.monitor.judged(estimate, frame, self.history)  # ours: does anything contradict the pose?

    def _odometry(self, frame: Frame) -> tuple[Motion, float]:
        """Figure 4: the motion since the last frame, without what is known of the gyro's bias, and its time (s)."""
        self.history.add(frame)
        duration_s = 0.0 if self.stamp_ns is None else (frame.stamp_ns - self.stamp_ns) / NANOSECONDS
        self.stamp_ns = frame.stamp_ns
        return self.odometry.advance(frame.stamp_ns, self.fusion.bias_rad_s), duration_s

    def _report(self, observation: Observation, residual_m: float, clock: Stopwatch) -> Estimate:
        unknown = self.searching or self.side.either_end
        status = Status.SEARCHING if unknown and self.status is Status.TRACKING else self.status
        covariance = self.unknown.copy() if unknown else self.fusion.believed_covariance
        twin = self.fusion.pose.mirrored(), residual_m, self.side.twin_probability, mirrored_covariance(covariance)
        return Estimate(
            observation.stamp_ns,
            self.fusion.pose,
            covariance,
            status,
            residual_m,
            len(observation.points),
            () if self.side.twin_probability == 0.0 else (Hypothesis(*twin),),
            perception_ms=clock.perception_ms,
            localization_ms=clock.localization_ms,
            observation=observation,
            mode=self.fusion.mode,
        )

    def _particle_filter(
        self, points: LinePoints, motion: Motion, compass_rad: float | None
    ) -> tuple[ParticleEstimate | None, float]:
        """Figure 8: one cycle; its estimate, and the mean error of the points (m, at most the map's largest)."""
        self._move(motion)
        image_cycles = self.settings.restart.paper.image_cycles
        if len(points) < MIN_POINTS:
            self.restart.see_nothing()
            return None, float("nan")
        if not self.searching:
            vision, residual_m = self._cycles(points, 1 if motion.missing_s == 0.0 else image_cycles)
            if self._is_still_tracked(vision):
                return vision, residual_m
            self.searching, self.status = True, Status.LOST
            self._start(compass_rad)
        elif self.restart.start_is_due() and not self.fusion.contradicting:
            self._start(compass_rad)
        vision, residual_m = self._cycles(points, image_cycles)
        lone_line = not self.settings.restart.paper.lone_line and is_one_line(points.positions_m)
        return vision if self._began_in_start_region(vision.pose) and not lone_line else None, residual_m

    def _move(self, motion: Motion) -> None:
        """The particles move; as long as the start region counts, none of them may have begun outside."""
        self.particles.predict(motion)
        self.moved = self.moved.compose(motion.pose)
        if self.region is not None:
            self.particles.keep_within(self.region, self.moved)

    def _is_still_tracked(self, vision: ParticleEstimate) -> bool:
        """Whether the robot is still followed, at the right end of the field."""
        refuted = self.restart.is_refuted(vision.inlier_ratio, self.status is Status.LOST) or self.side.wrong
        return not refuted and self._began_in_start_region(vision.pose)

    def _began_in_start_region(self, pose: Pose) -> bool:
        """Whether a robot that is here now, also as the points would have it, has begun in the start region, if any."""
        if self.region is None:
            return True
        poses = [pose] if self.image.pose is None else [pose, self.image.pose]
        return all(self.region.contains(each.compose(self.moved.inverse())) for each in poses)

    def _cycles(self, points: LinePoints, count: int) -> tuple[ParticleEstimate, float]:
        """So many cycles on one image."""
        most = len(points) if self.settings.paper.all_points else self.settings.max_points
        chosen = evenly_chosen(points, most)
        positions_m = self.mirror.corrected(chosen.positions_m)
        pose = self.odometry.pose
        for _ in range(count - 1):
            pose = self._cycle(positions_m).pose
            self._move(_STILL)
        if not self.searching:
            positions_m = self.mirror.corrected(chosen.positions_m, self.image.errors_of(chosen, pose))
        found = self._cycle(positions_m)
        self.image.see(chosen, found.pose)
        fitted = self.image.pose
        near = fitted is not None and fitted.distance_to(found.pose) <= NEAR_M
        if fitted is None or not self.mirror.enabled or (self.mirror.settled and not near):
            errors_m, near_m = self.particles.errors_m(positions_m, found.pose), NEAR_M
        else:
            errors_m, near_m = self.image.residuals_m, NEAR_FITTED_M
        inlier_ratio = float(np.mean(errors_m <= near_m + self._shaken_m(positions_m)))
        return found._replace(points=len(points), inlier_ratio=inlier_ratio), float(errors_m.mean())

    def _shaken_m(self, positions_m: FloatArray) -> FloatArray:
        """How far (M,) a shaking camera may have moved points (M, 2) off their lines; none while the robot is followed.

        There the strict measure notices sooner that it is not where it was. The paper knows no errors of its camera.
        """
        if not self.searching or not self.mirror.enabled:
            return np.zeros(len(positions_m))
        return np.minimum(SHAKE_RAD * np.sum(positions_m**2, axis=1) / HEIGHT_M, NEAR_M)

    def _cycle(self, positions_m: FloatArray) -> ParticleEstimate:
        """Equations (7) to (14)."""
        self.restart.count_cycle()
        return self.particles.update(positions_m)

    def _start(self, compass_rad: float | None) -> None:
        """Spread the particles over the field, or the start region; the compass helps with the first headings alone."""
        self.fusion.search_anew(self.restart.failed, displaced=self.side.wrong)
        end_known = self.region is not None or not self.field.is_symmetric
        believed_rad = self.side.heading(compass_rad)
        self.side.search(known=end_known or compass_rad is not None, by_compass=not end_known)
        heading_rad, deviation_rad = self._first_headings(believed_rad, self.restart.start())
        if self.region is not None and heading_rad is not None:
            heading_rad -= self.moved.heading
        self.particles.restart(heading_rad, self.region, deviation_rad)
        if self.region is not None:
            self.particles.predict(Motion(self.moved, np.zeros((3, 3)), 0.0))
        if self.fusion.has_pose:
            self._put_nearby(self.odometry.pose, compass_rad)  # it may have been right

    def _first_headings(self, compass_rad: float | None, widening: float) -> tuple[float | None, float]:
        """Mean and standard deviation (rad) of the headings that a search starts with: the compass's, or the last."""
        s = self.settings.particles
        if compass_rad is not None:
            return compass_rad, widening * s.compass_rad
        if self.fusion.has_pose:
            return self.odometry.pose.heading, widening * math.hypot(
                KNOWN_HEADING_RAD, self.fusion.heading_deviation_rad
            )
        return None, math.pi

    def _correct(self, compass_rad: float | None) -> None:
        """Figure 1: the offset of the odometry from the fused pose; some particles stay about it. And the status."""
        if self.fusion.mode is not Mode.ODOMETRY:
            if self.fusion.confirmed:
                self.image.learn()
            self.odometry.set_pose(self.fusion.pose)
            self.status, self.searching = Status.TRACKING, False
            self.restart.found()
            off_rad = None if compass_rad is None else wrap_angle(self.fusion.pose.heading - compass_rad)
            self.side.update_from_compass(off_rad, self.fusion.moved)
            if self.fusion.confirmed:
                self.region = None
        elif (self.fusion.lost or self.fusion.doubtful) and self.status is Status.TRACKING:
            self.status = Status.LOST
        if self.fusion.has_pose:
            self._put_nearby(self.fusion.pose, compass_rad)

    def _put_nearby(self, pose: Pose, compass_rad: float | None) -> None:
        """Some particles come to about a pose; in a search by the compass to its twin, if that is at the compass's end.

        Particles at both ends fit alike wherever the robot is near the twin, and would never agree.
        """
        believed_rad = self.side.heading(compass_rad) if self.searching else None
        if believed_rad is not None and self.field.is_symmetric and self.region is None:
            at_other_end = abs(wrap_angle(pose.heading - believed_rad)) > _END_RAD
            pose = pose.mirrored() if at_other_end else pose
        self.particles.put_nearby(pose)


def evenly_chosen(points: LinePoints, most: int) -> LinePoints:
    """No more than so many of some points, evenly over their order, as the particle filter takes them."""
    if len(points) <= most:
        return points
    rows = np.arange(most) * len(points) // most
    return LinePoints(*(getattr(points, one.name)[rows] for one in fields(points)))


IRIS_FUSION = SystemInfo(
    "iris-fusion",
    "measuring wheels and gyro, 600 particles on an error map, fused in three modes (Ismail et al. 2021)",
    IrisFusionSettings,
    IrisFusion,
    Needs(
        "measures its way with two wheels and a gyro",
        ("wheels", "gyro"),
        "odometry",
        "no motion is measured, poses come from the images alone",
    ),
)
