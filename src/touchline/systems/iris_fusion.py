"""iris-fusion: measuring wheels and gyro, particle filter, and the fusion of both.

M. A. Ismail, D. Purwanto, A. Arifin: Soccer robot localization based on sensor fusion from odometry and omnivision,
figures 1, 4, 8 and 11.

    encoders, gyro ─▶ odometry (1-6) ───┬────────────────────────▶ sensor fusion (15-19) ─▶ estimate, mode
                          ▲             ▼                              ▲      │
    image ─▶ line points ─┼─▶ particle filter (7-14) ──────────────────┘      │
    compass ──────────────┼──────▶┘ first headings                           │
                          └──────────── offset ◀─────────────────────────────┘
"""

from __future__ import annotations

import time

import numpy as np
from pydantic import Field

from touchline.camera import OmniCamera
from touchline.config import Settings
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.global_search import OWN_HALF
from touchline.localization.particle_filter import ParticleFilter, ParticleFilterSettings
from touchline.localization.sensor_fusion import SensorFusion, SensorFusionSettings, Vision
from touchline.motion import CompassTrack, CompassTrackSettings, Motion, WheelOdometry, WheelOdometrySettings
from touchline.perception import LearningSettings, LinePointSettings, SelfLearningDetector
from touchline.types import (
    Estimate,
    Frame,
    Hypothesis,
    LinePoints,
    Mode,
    Observation,
    Prior,
    Status,
    empty_points,
)


class RestartSettings(Settings):
    """When the particles are believed to have lost the robot. The paper has no rule."""

    least_share: float = Field(
        0.5, ge=0, le=1, description="share of points on lines below which an image contradicts the particles"
    )
    frames: int = Field(3, ge=1, description="such images in a row after which the particles start anew over the field")
    blind_frames: int = Field(
        2,
        ge=1,
        description="images without usable points in a row after which one such image is enough: whoever was covered "
        "may have been carried",
    )
    most_cycles: int = Field(
        12, ge=1, description="cycles after which a search that found nothing starts anew: it takes 4 to 7"
    )
    widening: float = Field(
        1.5, ge=1, description="factor by which every new start widens the first headings about the compass"
    )
    heading_rad: float | None = Field(
        1.6,
        gt=0,
        description="difference from the compass (rad) that shows the wrong end of a symmetric field, where the lines "
        "look the same; none as in the paper, whose compass serves at the start alone",
    )
    heading_frames: int = Field(5, ge=1, description="images in a row with such a difference until the search starts")


class IrisFusionSettings(Settings):
    """Everything that the paper fixes, and everything that it leaves open."""

    line_points: LinePointSettings = LinePointSettings()
    learning: LearningSettings = LearningSettings()
    most_points: int = Field(
        144, ge=1, description="line points that the particles are weighed by, evenly chosen: one per 2.5°, the paper's"
    )
    wheels: WheelOdometrySettings = WheelOdometrySettings()
    compass_track: CompassTrackSettings = CompassTrackSettings()
    particles: ParticleFilterSettings = ParticleFilterSettings()
    fusion: SensorFusionSettings = SensorFusionSettings()
    restart: RestartSettings = RestartSettings()
    start_position_m: float = Field(
        0.3, gt=0, description="standard deviation of x and y of a pose told by a person (m)"
    )
    start_heading_rad: float = Field(
        0.15, gt=0, description="standard deviation of the heading of a pose told by a person (rad)"
    )


class IrisFusion:
    """The system as sources and sinks know it: `reset` and `step`."""

    def __init__(
        self,
        field: FieldModel,
        camera: OmniCamera | None,
        settings: IrisFusionSettings,
        rng: np.random.Generator,
        wheel_directions_rad: tuple[float, float] | None = None,
    ) -> None:
        """camera: None if frames bring their points. rng: all chance comes from it. wheel_directions_rad: rolling
        directions of the wheels a and b in the robot frame; without them the frames' odometry takes their place.
        """
        self.settings = settings
        self.field = field
        self.detector = (
            None
            if camera is None
            else SelfLearningDetector(camera, settings.line_points, settings.learning, field.line_width)
        )
        self.odometry = WheelOdometry(settings.wheels, *(wheel_directions_rad or (None, None)))
        self.particles = ParticleFilter(field, rng, settings.particles)
        self.fusion = SensorFusion(settings.fusion)
        self.compass = CompassTrack(settings.compass_track)
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        s, prior = self.settings, prior or Prior()
        self.region = OWN_HALF if prior.own_half else None
        self.odometry.reset(prior.pose)
        self.compass.reset()
        self.fusion.forget()
        self.status, self.side_known = Status.SEARCHING, True
        self.searching = prior.pose is None
        self.starts = self.cycles = self.blind = self.contradicted = self.turned = 0
        if prior.pose is not None:
            deviations = np.array([s.start_position_m, s.start_position_m, s.start_heading_rad])
            self.fusion.place(prior.pose, np.diag(deviations**2))
            self.particles.start_at(prior.pose, np.diag(deviations**2))
            self.status = Status.TRACKING
        if self.detector is not None:
            self.detector.reset()

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        started = time.perf_counter()
        points = self._line_points(frame)
        seen = time.perf_counter()
        self.compass.add(frame.compass, frame.gyro)
        compass_rad = self.compass.heading_at(frame.stamp_ns)
        motion = self.odometry.update(frame)  # figure 4, equations (1) to (6)
        vision, residual_m = self._particle_filter(points, motion, compass_rad)  # figure 8, equations (7) to (14)
        self.fusion.update(self.odometry.pose, motion, vision)  # figure 11, equations (15) to (19)
        self._correct()
        self._judge(vision, compass_rad)
        done = time.perf_counter()
        twin = () if self.side_known else (Hypothesis(self.fusion.pose.mirrored(), residual_m),)
        return Estimate(
            frame.stamp_ns,
            self.fusion.pose,
            self.fusion.covariance.copy(),
            self.status,
            residual_m,
            len(points),
            twin,
            1e3 * (seen - started),
            1e3 * (done - seen),
            Observation(frame.stamp_ns, points, None if self.detector is None else self.detector.problem),
            self.fusion.mode,
        )

    def _line_points(self, frame: Frame) -> LinePoints:
        """Figures 6 and 7: line points of the image."""
        if self.detector is not None:
            return self.detector.detect(frame).finite()
        return empty_points() if frame.points is None else frame.points.finite()

    def _particle_filter(
        self, points: LinePoints, motion: Motion, compass_rad: float | None
    ) -> tuple[Vision | None, float]:
        """Figure 8: one cycle; what it says, and the mean error of the points (m, at most the map's largest)."""
        self.particles.move(motion)
        if len(points) < self.settings.fusion.least_points:
            return None, float("nan")
        if self.searching and self.cycles in (0, self.settings.restart.most_cycles):
            self._start(compass_rad)
        self.cycles += 1
        chosen = self._chosen(points.positions_m)
        pose = self.particles.cycle(chosen)
        errors_m = self.particles.errors_m(chosen, pose)
        on_lines = float(np.mean(errors_m <= self.settings.fusion.near_m))
        return Vision(pose, self.particles.covariance, len(points), on_lines), float(errors_m.mean())

    def _chosen(self, positions_m: FloatArray) -> FloatArray:
        """No more points than are wanted, evenly chosen."""
        most = self.settings.most_points
        if len(positions_m) > most:
            positions_m = positions_m[np.linspace(0, len(positions_m) - 1, most).astype(np.int64)]
        return np.ascontiguousarray(positions_m, dtype=np.float64)

    def _start(self, compass_rad: float | None) -> None:
        """Spread the particles over the field; the compass helps with the first headings alone."""
        self.particles.restart(compass_rad, self.region, self.settings.restart.widening**self.starts)
        self.starts, self.cycles = self.starts + 1, 0
        self.fusion.interrupt()
        self.side_known = compass_rad is not None or self.region is not None or not self.field.is_symmetric

    def _correct(self) -> None:
        """Figure 1: the offset of the odometry from the fused pose; some particles stay about it."""
        if self.fusion.mode is not Mode.ODOMETRY:
            self.odometry.set_pose(self.fusion.pose)
        if self.fusion.placed:
            self.particles.put_nearby(self.fusion.pose)

    def _judge(self, vision: Vision | None, compass_rad: float | None) -> None:
        """The status, and whether the particles must start anew."""
        s = self.settings.restart
        if self.fusion.mode is not Mode.ODOMETRY:
            self.status, self.searching, self.region = Status.TRACKING, False, None
            self.starts = self.cycles = 0
        was_blind, self.blind = self.blind, self.blind + 1 if vision is None else 0
        if vision is not None:
            contradicts = vision.on_lines < s.least_share
            self.contradicted = self.contradicted + 1 if contradicts else 0
        self.turned = self.turned + 1 if self._strays(compass_rad) else 0
        enough = 1 if was_blind >= s.blind_frames else s.frames
        if not self.searching and (self.contradicted >= enough or self.turned >= s.heading_frames):
            self.searching, self.cycles, self.starts = True, 0, 0
            self.contradicted = self.turned = 0
            self.status = Status.LOST
        elif self.searching and self.status is Status.LOST:
            self.status = Status.SEARCHING
        elif self.status is Status.TRACKING and self.fusion.lost:
            self.status = Status.LOST

    def _strays(self, compass_rad: float | None) -> bool:
        most_rad = self.settings.restart.heading_rad
        if most_rad is None or compass_rad is None or self.searching:
            return False
        return abs(wrap_angle(self.fusion.pose.heading - compass_rad)) > most_rad
