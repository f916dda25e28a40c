"""nubot-mti: omnidirectional vision and compass.

D. Xiong, H. Lu, Z. Zheng: A self-localization method based on omnidirectional vision and MTi for soccer robots.

    image ─▶ line points ─┬─▶ global localization (4.1) ─▶ pose
                          │      compass ─┘                 │
                          └─▶ matching from the prediction ◀┴─ odometry
                                 │
                                 ├─▶ Kalman fusion ─▶ estimate
                                 ├─▶ compass correction
                                 └─▶ failure detection ─▶ global localization again (4.2)
"""

from __future__ import annotations

import time

import numpy as np
from pydantic import Field

from touchline.camera import OmniCamera
from touchline.config import Settings
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.compass import CompassCorrection, CompassSettings
from touchline.localization.failure import FailureDetector, FailureSettings
from touchline.localization.global_search import OWN_HALF, GlobalFix, GlobalSearch, GlobalSearchSettings
from touchline.localization.matching import Match, Matcher, MatchingSettings, as_pose
from touchline.localization.mirror_tilt import MirrorTilt, MirrorTiltSettings
from touchline.localization.tracking import FusionSettings, PoseFilter
from touchline.localization.weights import WeightSettings, precision_weights
from touchline.motion.compass import CompassTrack, CompassTrackSettings
from touchline.motion.odometry import OdometrySettings, OdometryTrack
from touchline.perception import LearningSettings, LinePointSettings, SelfLearningDetector
from touchline.types import Estimate, Frame, Hypothesis, LinePoints, Observation, Prior, Status

# Without a compass the whole circle is searched; matching turns by half a step and more.
_ALL_HEADINGS = tuple(float(heading) for heading in np.arange(24) * np.pi / 12.0 - np.pi)


class MapSettings(Settings):
    """The table of distances to the lines."""

    resolution_m: float = Field(0.025, gt=0, description="distance of its samples (m)")
    margin_m: float = Field(3.0, gt=0, description="how far it reaches beyond the lines (m)")


class NubotMtiSettings(Settings):
    """Everything that the paper fixes, and everything that it leaves open."""

    line_points: LinePointSettings = LinePointSettings()
    learning: LearningSettings = LearningSettings()
    map: MapSettings = MapSettings()
    weights: WeightSettings = WeightSettings()
    matching: MatchingSettings = MatchingSettings()
    mirror_tilt: MirrorTiltSettings = MirrorTiltSettings()
    global_search: GlobalSearchSettings = GlobalSearchSettings()
    fusion: FusionSettings = FusionSettings()
    compass: CompassSettings = CompassSettings()
    failure: FailureSettings = FailureSettings()
    odometry: OdometrySettings = OdometrySettings()
    compass_track: CompassTrackSettings = CompassTrackSettings()


class NubotMti:
    """The system as sources and sinks know it: `reset` and `step`."""

    def __init__(
        self, field: FieldModel, camera: OmniCamera | None, settings: NubotMtiSettings, rng: np.random.Generator
    ) -> None:
        """camera: None if frames bring their points. rng is not needed: nothing here is left to chance."""
        self.settings = settings
        self.field = field
        self.detector = (
            None
            if camera is None
            else SelfLearningDetector(camera, settings.line_points, settings.learning, field.line_width)
        )
        self.matcher = Matcher(field.distance_map(settings.map.resolution_m, settings.map.margin_m), settings.matching)
        self.tilt = MirrorTilt(field, settings.mirror_tilt)
        self.search = GlobalSearch(self.matcher, field.length, field.width, settings.global_search)
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        s = self.settings
        prior = prior or Prior()
        self.region = OWN_HALF if prior.own_half else None
        self.side_known = True
        self.odometry = OdometryTrack(s.odometry)
        self.compass = CompassTrack(s.compass_track)
        self.correction = CompassCorrection(s.compass)
        self.failure = FailureDetector(s.failure)
        self.filter = PoseFilter(prior.pose or Pose(0.0, 0.0, 0.0), None, s.fusion)
        self.status = Status.TRACKING if prior.pose is not None else Status.SEARCHING
        self.tilt.reset()
        self.rivals: tuple[Hypothesis, ...] = ()
        self.stamp_ns: int | None = None
        if self.detector is not None:
            self.detector.reset()

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp."""
        started = time.perf_counter()
        points = self._line_points(frame)
        seen = time.perf_counter()
        self._predict(frame)
        compass_rad = self.compass.heading_at(frame.stamp_ns)
        weights = precision_weights(points, self.settings.weights)
        usable = len(points) >= self.settings.failure.least_points
        match = None
        if self.status is Status.TRACKING:
            match = self._track(points, weights, compass_rad) if usable else None
            if self._failed(match, len(points), compass_rad):
                self.status = Status.LOST
        if self.status is not Status.TRACKING and usable:
            match = self._localize(points, weights, compass_rad, match)
        done = time.perf_counter()
        return Estimate(
            frame.stamp_ns,
            self.filter.pose,
            self.filter.covariance.copy(),
            self.status,
            float("nan") if match is None else match.mean_distance_m,
            len(points),
            self.rivals if self.side_known else (*self.rivals, self._twin(match)),
            1e3 * (seen - started),
            1e3 * (done - seen),
            Observation(frame.stamp_ns, points),
        )

    def _twin(self, match: Match | None) -> Hypothesis:
        """The pose at the other end of a symmetric field, which the lines alone can't exclude."""
        return Hypothesis(self.filter.pose.mirrored(), float("nan") if match is None else match.mean_distance_m)

    def _line_points(self, frame: Frame) -> LinePoints:
        """Section 4.1: line points of the panoramic image."""
        if self.detector is not None:
            return self.detector.detect(frame)
        assert frame.points is not None, "a frame without points needs a camera"
        return frame.points

    def _predict(self, frame: Frame) -> None:
        """Section 4.2: the odometry carries the pose on to this frame."""
        self.odometry.add(frame.odometry)
        self.compass.add(frame.compass, frame.gyro)
        if self.stamp_ns is not None:
            motion = self.odometry.between(self.stamp_ns, frame.stamp_ns)
            self.filter.predict(motion.pose, motion.covariance)
        self.stamp_ns = frame.stamp_ns
        self.rivals = ()

    def _track(self, points: LinePoints, weights: FloatArray, compass_rad: float | None) -> Match:
        """Section 4.2: matching from the odometry's prediction, then Kalman fusion."""
        good = self.settings.global_search.accepted_error
        positions_m = self.tilt.corrected(points.positions_m)
        pose, error, _ = self.matcher.descend(positions_m, weights, self.filter.pose.as_array())
        if error > good and compass_rad is not None:
            # a shove turns the robot, too; the compass feels what the odometry doesn't
            turned = self.filter.pose._replace(heading=self.correction.heading(compass_rad))
            other, other_error, _ = self.matcher.descend(positions_m, weights, turned.as_array())
            if other_error < error:
                pose, error = other, other_error
        match = self._upright(points, weights, pose, error)
        covariance = self._covariance_without_sliding(positions_m, weights, match)
        self.filter.update(match.pose, covariance, trusted=match.error < good)
        if compass_rad is not None:
            self.correction.update(match.mean_distance_m, match.pose.heading, compass_rad)
        return match

    def _covariance_without_sliding(self, positions_m: FloatArray, weights: FloatArray, match: Match) -> FloatArray:
        """Covariance of the match: that at the prediction, if the match went far away from it for nothing.

        Where a single line is seen, RPROP may slide along it to a place where the same points look unambiguous.
        """
        if self.filter.distance2_to(match.pose, match.covariance) <= self.settings.fusion.gate:
            return match.covariance
        predicted = self.filter.pose.as_array()
        error = self.matcher.error(positions_m, weights, predicted)
        if error > max(2.0 * match.error, match.error + 0.02):
            return match.covariance
        return self.matcher.assess(positions_m, weights, predicted, error).covariance

    def _upright(self, points: LinePoints, weights: FloatArray, pose: FloatArray, error: float) -> Match:
        """The match at a pose (3,) of this error, refined with this frame's own tilt of the mirror taken out."""
        if self.settings.mirror_tilt.enabled and error < self.settings.global_search.accepted_error:
            positions_m = self.tilt.corrected(points.positions_m, self.tilt.update(points, as_pose(pose)))
            refined, refined_error, _ = self.matcher.descend(positions_m, weights, pose)
            if refined_error <= error:
                return self.matcher.assess(positions_m, weights, refined, refined_error)
        return self.matcher.assess(self.tilt.corrected(points.positions_m), weights, pose, error)

    def _failed(self, match: Match | None, points: int, compass_rad: float | None) -> bool:
        """Section 4.2: mean deviation and heading against the compass, for several frames in a row."""
        if match is None:
            self.correction.interrupt()
            return self.failure.update(points, float("inf"), None)
        strays = None
        if compass_rad is not None:
            strays = wrap_angle(match.pose.heading - self.correction.heading(compass_rad))
        return self.failure.update(points, match.mean_distance_m, strays)

    def _localize(
        self, points: LinePoints, weights: FloatArray, compass_rad: float | None, tracked: Match | None
    ) -> Match | None:
        """Section 4.1: global localization; a pose that has just failed stays if no other fits the lines better."""
        positions_m = self.tilt.corrected(points.positions_m)
        headings = _ALL_HEADINGS if compass_rad is None else (self.correction.heading(compass_rad),)
        fixes = [self.search.locate(positions_m, weights, heading, self.region) for heading in headings]
        fix = min((f for f in fixes if f is not None), key=lambda f: f.match.error, default=None)
        if fix is None:
            return tracked
        accepted = fix.accepted
        match = self._upright(points, weights, fix.match.pose.as_array(), fix.match.error)
        if tracked is not None and tracked.error <= match.error:
            match, accepted = tracked, tracked.error < self.settings.global_search.accepted_error
        self.filter = PoseFilter(match.pose, match.covariance, self.settings.fusion)
        self.rivals = _rivals(fix)
        self.status = Status.TRACKING if accepted else Status.SEARCHING
        if accepted:
            self.side_known = compass_rad is not None or self.region is not None or not self.field.is_symmetric
            self.region = None
            self.failure.reset()
            self.correction.interrupt()
        return match


def _rivals(fix: GlobalFix) -> tuple[Hypothesis, ...]:
    """Refined samples elsewhere whose error comes near the best one's."""
    best = fix.match
    near: list[Hypothesis] = []
    for candidate in sorted(fix.rounds[-1].candidates, key=lambda c: c.error):
        elsewhere = all(candidate.pose.distance_to(p) > 0.5 for p in (best.pose, *(h.pose for h in near)))
        if elsewhere and candidate.error < 2.0 * best.error:
            near.append(Hypothesis(candidate.pose, candidate.error))
    return tuple(near)
