"""nimbro-lines: lines, crossings, posts and poles of a perspective camera on a walking robot.

H. Schulz, S. Behnke: Utilizing the structure of field lines for efficient soccer robot localization, Advanced Robotics
2012.

    image ─▶ field boundary, line graph (3) ─▶ crossings, lines, posts, poles (4.1 to 4.3)
                          IMU or kinematics ─▶ egocentric coordinates (4.4)
                                                         │
    odometry ─▶ augmented Monte Carlo localization (5) ◀─┘
                          └─▶ main mode ─▶ least squares on its features (ours) ─▶ estimate
"""

from dataclasses import replace

import numpy as np

from touchline.camera import PerspectiveCamera
from touchline.config import Settings, added
from touchline.field.association import FieldAssociations
from touchline.field.region import OWN_HALF, Region
from touchline.geometry import FloatArray, Pose
from touchline.localization.estimator.monitor import monitored
from touchline.localization.registration.feature_model import FeatureModel, FeatureView, field_lines
from touchline.localization.registration.features import Features, FeatureSettings, levelled
from touchline.motion import LeanFilter, MotionHistory
from touchline.perception import Detector, LineGraphSettings, line_graph_detector, observe
from touchline.published.nimbro_lines.feature_belief import BeliefSettings
from touchline.published.nimbro_lines.feature_filter import FeatureFilter
from touchline.published.nimbro_lines.feature_tracker import FeatureTracker
from touchline.published.nimbro_lines.particles import NimbroParticles, NimbroParticleSettings
from touchline.systems.info import SystemInfo
from touchline.systems.setup import CAMERA_HEIGHT_M, RobotSetup, open_monitor, system_text
from touchline.systems.stopwatch import Stopwatch
from touchline.types import Estimate, Frame, Observation, Prior, as_prior


class NimbroPaper(Settings):
    """Switches to the paper's exact form."""

    rates: bool = added(
        True,
        paper=False,
        description="the gyro's rates carry roll and pitch on to the image, for angles are late; off: the newest "
        "angles as they are, as in the paper, whose camera is as late",
    )
    refine: bool = added(
        True,
        paper=False,
        description="the pose by least squares on the features about the particles' main mode; off: the mode's mean",
    )
    twin: bool = added(
        True,
        paper=False,
        description="the pose is compared in every frame with its twin at the other end, where colours alone tell them "
        "apart, and not believed before that is refuted; off: the particles alone tell",
    )
    restart: bool = added(
        True,
        paper=False,
        description="all particles start anew anywhere once the pose explains too little; off: random particles alone "
        "find a robot that was carried away, as in the paper",
    )
    monitor: bool = monitored()


class NimbroLinesSettings(Settings):
    """Everything that the paper fixes, and everything that it leaves open."""

    line_graph: LineGraphSettings = LineGraphSettings()
    features: FeatureSettings = FeatureSettings()
    particles: NimbroParticleSettings = NimbroParticleSettings()
    belief: BeliefSettings = BeliefSettings()
    paper: NimbroPaper = NimbroPaper()


class NimbroLines:
    """The system as sources and sinks know it: `reset` and `step`."""

    __repr__ = system_text

    def __init__(self, setup: RobotSetup, settings: NimbroLinesSettings, rng: np.random.Generator) -> None:
        """rng: all chance comes from it."""
        field, camera, s = setup.field, setup.camera, settings
        self.setup = setup
        self.settings = settings
        self.detector: Detector | None = None
        if camera is not None:
            self.detector = line_graph_detector(camera, s.line_graph, field)
        self.leaning = LeanFilter(s.paper.rates)
        self.history = MotionHistory()
        self.max_range_m = setup.max_range_m
        height_m = setup.height_m or CAMERA_HEIGHT_M
        if isinstance(camera, PerspectiveCamera):
            height_m = float(camera.base_from_camera.translation_m[2])
        seen_from = setup if camera is not None else replace(setup, height_m=height_m)
        self.monitor = open_monitor(seen_from, s.paper.monitor)
        associations, lines = FieldAssociations(field), field_lines(field)
        self.features = Features(associations, s.features, height_m)
        told_apart = self.features.tell_ends_apart
        symmetric = field.is_symmetric and not told_apart
        model = FeatureModel(associations.tables, lines, polar=not s.features.paper.covariances)
        self.particles = NimbroParticles(field, model, rng, symmetric, s.particles)
        feature_filter = FeatureFilter(associations.tables, lines, height_m, s.features.noise.lean_rad)
        colours = model if s.paper.twin and field.is_symmetric and told_apart else None
        self.tracker = FeatureTracker(feature_filter, symmetric, s.belief, s.paper.refine, colours)
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        prior = as_prior(prior)
        if self.detector is not None:
            self.detector.reset()
        self.history.clear()
        self.leaning.clear()
        self.tracker.reset(prior)
        self.monitor.reset()
        if prior.pose is not None:
            self.particles.start_at(self.tracker.pose, self.tracker.filter.covariance)
        else:
            self.particles.restart(OWN_HALF if prior.own_half else None)

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        clock = Stopwatch()
        motion = self.history.take(frame)
        self.particles.predict(motion)  # motion model, equation (3)
        self.tracker.predict(motion, self.particles.filter.motion_model.deviations(motion))
        frame = self.leaning.at_image(frame)  # roll and pitch at the image, section 4.4
        observation = clock.perception(observe, frame, self.detector, self.max_range_m)  # features, sections 3 and 4
        view = self.features.of(observation, self._level)  # egocentric, sections 4.4 and 5.3
        mode = self.particles.update(view, self._side(), self.tracker.belief.is_searching)  # resampling, (4) to (8)
        self.tracker.update(view, mode, frame.stamp_ns)  # ours: least squares about the main mode; is it tracked
        if self.tracker.turned:
            self.particles.start_at(self.tracker.pose, self.tracker.filter.covariance)
        if self.tracker.is_lost and self.settings.paper.restart:
            self._search()  # ours, beside section 5's random particles
        estimate = self._report(observation, view, clock)
        return self.monitor.judged(estimate, frame, self.history)  # ours: does anything contradict the pose?

    @property
    def feature_model(self) -> FeatureModel:
        """The observation model by which features weigh a pose."""
        return self.particles.sensor_model

    @property
    def weighed_poses(self) -> FloatArray:
        """(N, 4) particles: x, y (m), heading (rad), weight."""
        return np.column_stack((self.particles.particles.poses, self.particles.particles.weights))

    @property
    def camera_lean(self) -> FloatArray:
        """(2,) roll and pitch (rad) by which the camera is turned throughout, as far as the lines tell it."""
        return self.tracker.filter.lean

    def _search(self) -> None:
        self.tracker.lose()
        self.particles.restart()

    def _level(self, ground: FloatArray) -> FloatArray:
        """Ground points without the lean that the tracker has found."""
        lean = self.tracker.filter.lean
        return ground if lean is None else levelled(ground, self.features.height_m, lean)

    def _side(self) -> Pose | Region | None:
        """The end of the field, where that is known: the pose's, or as given before there is a pose."""
        if not self.tracker.ends.known:
            return None
        return self.tracker.pose if self.tracker.has_pose else OWN_HALF

    def _report(self, observation: Observation, view: FeatureView, clock: Stopwatch) -> Estimate:
        tracker = self.tracker
        return Estimate(
            observation.stamp_ns,
            tracker.pose,
            tracker.covariance,
            tracker.status,
            tracker.belief.residual_m,
            view.size + len(observation.points),
            tracker.hypotheses,
            perception_ms=clock.perception_ms,
            localization_ms=clock.localization_ms,
            observation=observation,
        )


NIMBRO_LINES = SystemInfo(
    "nimbro-lines",
    "lines, crossings, posts of a walking robot's camera, augmented MCL (Schulz and Behnke 2012)",
    NimbroLinesSettings,
    NimbroLines,
    cameras=(PerspectiveCamera,),
)
