"""What the two NuBot systems share: tracking by matching, fused with odometry, until five bad frames in a row.

    image ─▶ line points ─▶ matching from the prediction ◀─ odometry
                               ├─▶ Kalman fusion ─▶ estimate
                               ├─▶ mirror tilt, compass correction
                               └─▶ failure detection ─▶ global localization, which each system has its own of

Xiong et al., section 4.2; Lu et al. 2013, section 4 and figure 3.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray, Pose, mirrored_covariance, wrap_angle
from touchline.localization.fusion.compass_correction import CompassCorrection, CompassSettings
from touchline.localization.fusion.failure import FailureDetector, FailureSettings
from touchline.localization.fusion.pose_filter import FusionSettings, PoseFilter
from touchline.localization.matching.global_search import OWN_HALF, GlobalFix, GlobalSearch, GlobalSearchSettings
from touchline.localization.matching.matcher import Match, Matcher, MatchingSettings, as_pose
from touchline.localization.matching.mirror_tilt import MirrorTilt, MirrorTiltSettings
from touchline.localization.matching.weights import WeightSettings, precision_weights
from touchline.motion import CompassTrackSettings, Motion, MotionHistory, OdometrySettings
from touchline.perception import LearningSettings, LinePointSettings, SelfLearningDetector, observe
from touchline.systems.setup import RobotSetup
from touchline.types import Estimate, Frame, Hypothesis, LinePoints, Prior, Status

# Without a compass the whole circle is searched; matching turns by half a step and more.
_ALL_HEADINGS = tuple(float(heading) for heading in np.arange(24) * np.pi / 12.0 - np.pi)


class MapSettings(Settings):
    """The table of distances to the lines."""

    resolution_m: float = Field(0.025, gt=0, description="distance of its samples (m)")
    margin_m: float = Field(3.0, gt=0, description="how far it reaches beyond the lines (m)")


class TrackerSettings(Settings):
    """What both papers fix of tracking, and what they leave open."""

    line_points: LinePointSettings = LinePointSettings()
    learning: LearningSettings = LearningSettings()
    map: MapSettings = MapSettings()
    weights: WeightSettings = WeightSettings()
    matching: MatchingSettings = MatchingSettings()
    mirror_tilt: MirrorTiltSettings = MirrorTiltSettings()
    fusion: FusionSettings = FusionSettings()
    compass: CompassSettings = CompassSettings()
    failure: FailureSettings = FailureSettings()
    odometry: OdometrySettings = OdometrySettings()
    compass_track: CompassTrackSettings = CompassTrackSettings()


class MatchingTracker(ABC):
    """A system as sources and sinks know it: `reset` and `step`. Global localization is its heirs' part."""

    def __init__(
        self, setup: RobotSetup, settings: TrackerSettings, search: GlobalSearchSettings | None = None
    ) -> None:
        """search: of the whole field, where something looks wrong."""
        self.shared = settings
        self.field = field = setup.field
        self.detector = (
            None
            if setup.camera is None
            else SelfLearningDetector(setup.camera, settings.line_points, settings.learning, field.line_width)
        )
        self.matcher = Matcher(field.distance_map(settings.map.resolution_m, settings.map.margin_m), settings.matching)
        self.search = GlobalSearch(self.matcher, field.length, field.width, search)
        self.tilt = MirrorTilt(field, settings.mirror_tilt)

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        s = self.shared
        prior = prior or Prior()
        self.region = OWN_HALF if prior.own_half else None
        self.side_known = True
        self.history = MotionHistory(s.odometry, s.compass_track)
        self.correction = CompassCorrection(s.compass)
        self.failure = FailureDetector(s.failure)
        self.filter = PoseFilter(prior.pose or Pose(0.0, 0.0, 0.0), None, s.fusion)
        self.status = Status.TRACKING if prior.pose is not None else Status.SEARCHING
        self.placed = prior.pose is not None
        self.told = prior.pose is not None
        self.tilt.reset()
        self.hypotheses: tuple[Hypothesis, ...] = ()
        self.failures = 0  # how often the pose was believed wrong
        self.stamp_ns: int | None = None
        self.motion: Motion | None = None
        if self.detector is not None:
            self.detector.reset()

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        started = time.perf_counter()
        observation = observe(frame, self.detector)  # section 4.1
        points = observation.points
        seen = time.perf_counter()
        self._predict(frame)
        compass_rad = self.history.at(frame.stamp_ns).heading_rad
        weights = precision_weights(points, self.shared.weights)
        usable = len(points) >= self.shared.failure.least_points
        match = self._match_from_prediction(points, weights, compass_rad) if usable and self.placed else None
        if self.status is Status.TRACKING:
            if match is not None:
                self._fuse(points, weights, match, compass_rad)
            failed = self._failed(match, points, weights, compass_rad)
            if failed or (self.told and self.failure.bad_frames > 0):  # a told pose that nothing has confirmed yet
                self.status = Status.LOST
                self.failures += 1
            self.told = self.told and match is None
        if self.status is not Status.TRACKING and usable:
            match = self._localize(points, weights, compass_rad, match)
        done = time.perf_counter()
        return Estimate(
            frame.stamp_ns,
            self.filter.pose,
            self._covariance(),
            self.status,
            float("nan") if match is None else match.mean_distance_m,
            len(points),
            self.hypotheses if self.side_known else (*self.hypotheses, self._mirrored(match)),
            perception_ms=1e3 * (seen - started),
            localization_ms=1e3 * (done - seen),
            observation=observation,
        )

    def _covariance(self) -> FloatArray:
        """The estimate's (3, 3). A pose that is not believed is the best guess, but the robot may be anywhere."""
        if self.status is Status.TRACKING:
            return self.filter.covariance.copy()
        return self.filter.covariance + self.shared.matching.uncertainty.unknown

    @abstractmethod
    def _localize(
        self, points: LinePoints, weights: FloatArray, compass_rad: float | None, held: Match | None
    ) -> Match | None:
        """Global localization, or the next cycle of it: sets filter and status. held: the match from the prediction."""

    def _believe(self) -> None:
        """Global localization has succeeded: from here on the pose is tracked."""
        self.status, self.region = Status.TRACKING, None
        self.failure.reset()
        self.correction.interrupt()

    def _knows_the_side(self, compass_rad: float | None) -> bool:
        """Whether a pose found now is known to be at the right end of the field."""
        return compass_rad is not None or self.region is not None or not self.field.is_symmetric

    def _may_face(self, heading_rad: float, compass_rad: float | None) -> bool:
        """Whether a heading doesn't contradict the compass outright, as at the wrong end of a symmetric field."""
        if compass_rad is None:
            return True
        return (
            abs(wrap_angle(heading_rad - self.correction.heading(compass_rad))) < self.shared.failure.lone_heading_rad
        )

    def _mirrored(self, match: Match | None) -> Hypothesis:
        """The pose at the other end of a symmetric field, which the lines alone can't exclude."""
        residual_m = float("nan") if match is None else match.mean_distance_m
        covariance = mirrored_covariance(self._covariance())
        return Hypothesis(self.filter.pose.mirrored(), residual_m, covariance=covariance)

    def _predict(self, frame: Frame) -> None:
        """Section 4.2: the odometry carries the pose on to this frame."""
        self.history.add(frame)
        if self.stamp_ns is not None:
            self.motion = self.history.between(self.stamp_ns, frame.stamp_ns)
            self.filter.predict(self.motion.pose, self.motion.covariance)
        self.stamp_ns = frame.stamp_ns
        self.hypotheses = ()

    def _match_from_prediction(self, points: LinePoints, weights: FloatArray, compass_rad: float | None) -> Match:
        """Section 4.2: matching that starts where the odometry says."""
        positions_m = self.tilt.corrected(points.positions_m)
        pose, error, _ = self.matcher.descend(positions_m, weights, self.filter.pose.as_array())
        heading = self.filter.pose.heading if compass_rad is None else self.correction.heading(compass_rad)
        turn_rad = abs(wrap_angle(heading - self.filter.pose.heading))
        s = self.shared.fusion
        if turn_rad > s.shoved_rad or (error > s.poor_error and turn_rad > 0.0):
            # a shove turns the robot, too; the compass feels what the odometry doesn't
            turned = self.filter.pose._replace(heading=heading)
            other, other_error, _ = self.matcher.descend(positions_m, weights, turned.as_array())
            if other_error < error:
                pose, error = other, other_error
        return self._upright(points, weights, pose, error)

    def _fuse(self, points: LinePoints, weights: FloatArray, match: Match, compass_rad: float | None) -> None:
        """Section 4.2: Kalman fusion of prediction and match, and correction of the compass."""
        s = self.shared.fusion
        if self.filter.distance2_to(match.pose, match.covariance) <= s.gate:
            self.filter.update(match.pose, match.covariance)
        elif not self._fuse_what_is_observed(points, weights, match):
            positions_m = self.tilt.corrected(points.positions_m)
            error = self.matcher.error(positions_m, weights, self.filter.pose.as_array())
            self.filter.update(match.pose, match.covariance, trusted=error > self._enough(match))
        if compass_rad is not None:
            self.correction.update(match.mean_distance_m, match.pose.heading, compass_rad)

    def _enough(self, match: Match) -> float:
        """Mean error up to which another pose explains the points as well as a match."""
        s = self.shared.fusion
        return max(s.better_factor * match.error, match.error + s.better_margin)

    def _fuse_what_is_observed(self, points: LinePoints, weights: FloatArray, match: Match) -> bool:
        """Fuse a match far from the prediction by what the points observe at the prediction; whether that is enough.

        RPROP may slide along a lone line to where the same points look unambiguous. First the prediction is taken at
        its word, then as that of a robot that was shoved.
        """
        s = self.shared.fusion
        positions_m = self.tilt.corrected(points.positions_m)
        predicted = self.filter.pose.as_array()
        there = self.matcher.assess(positions_m, weights, predicted, match.error).covariance
        for shove in (0.0, 1.0):
            grown = np.diag([s.shove_position_m, s.shove_position_m, s.shove_heading_rad]) ** 2 * shove
            fused = PoseFilter(self.filter.pose, self.filter.covariance + grown, s)
            if not fused.update(match.pose, there, trusted=False):
                continue
            if self.matcher.error(positions_m, weights, fused.pose.as_array()) <= self._enough(match):
                self.filter = fused
                return True
        return False

    def _upright(self, points: LinePoints, weights: FloatArray, pose: FloatArray, error: float) -> Match:
        """The match at a pose (3,) of this error, refined with this frame's own tilt of the mirror taken out."""
        tilt = self.shared.mirror_tilt
        if tilt.enabled and error < tilt.most_error:
            positions_m = self.tilt.corrected(points.positions_m, self.tilt.update(points, as_pose(pose)))
            refined, refined_error, _ = self.matcher.descend(positions_m, weights, pose)
            if refined_error <= error:
                return self.matcher.assess(positions_m, weights, refined, refined_error)
        return self.matcher.assess(self.tilt.corrected(points.positions_m), weights, pose, error)

    def _failed(self, match: Match | None, points: LinePoints, weights: FloatArray, compass_rad: float | None) -> bool:
        """Section 4.2: mean deviation and heading against the compass, for several frames in a row."""
        missing_s = 0.0 if self.motion is None else self.motion.missing_s
        if match is None:
            self.correction.interrupt()
            return self.failure.update(len(points), float("inf"), None, missing_s)
        strays = None
        if compass_rad is not None:
            # the fused heading: a match that was turned to the compass but not believed would hide the contradiction
            strays = wrap_angle(self.filter.pose.heading - self.correction.heading(compass_rad))
        failed = self.failure.update(len(points), match.mean_distance_m, strays, missing_s)
        return failed or (self.failure.suspicious and self._fits_elsewhere(points, weights, match, compass_rad))

    def _fits_elsewhere(self, points: LinePoints, weights: FloatArray, match: Match, compass_rad: float | None) -> bool:
        """Whether some other place explains the points far better than this match; the papers have no such test."""
        fix = self._search(points, weights, compass_rad)
        return fix is not None and match.error > self._enough(fix.match)

    def _search(self, points: LinePoints, weights: FloatArray, compass_rad: float | None) -> GlobalFix | None:
        """The best of the sampled search with the compass heading, or with headings all around without a compass."""
        positions_m = self.tilt.corrected(points.positions_m)
        headings = _ALL_HEADINGS if compass_rad is None else (self.correction.heading(compass_rad),)
        fixes = [self.search.locate(positions_m, weights, heading, self.region) for heading in headings]
        return min((fix for fix in fixes if fix is not None), key=lambda fix: fix.match.error, default=None)
