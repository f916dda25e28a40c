"""Tracking: prediction by the odometry, matching from there, Kalman fusion of both.

Xiong et al., section 4.2; Lu et al. 2013, section 4.
"""

import math
from dataclasses import replace

import numpy as np

from touchline.geometry import FloatArray, Pose, as_pose, wrap_angle
from touchline.localization.registration.covariance import (
    MAX_DEVIATION_OF_POSITION_M,
    UNKNOWN_POSITION_M,
    is_observed,
    widest_m,
)
from touchline.localization.registration.learned_mirror import Expected
from touchline.motion import Motion, OdometrySettings
from touchline.motion.driven import EXACT_SCALES, Scales
from touchline.published.nubot.match_input import MatchInput, refine_with_tilt
from touchline.published.nubot.matcher import POOR_ERROR, Match, Matcher
from touchline.published.nubot.pose_filter import Fusion, FusionSettings, PoseFilter, equal_error
from touchline.types import Prior

SHOVE_POSITION_M = 0.3  # how far a shove moves the robot: 0.1 to 0.3 in matches
SHOVE_HEADING_RAD = 0.2  # how far a shove turns the robot: about ten degrees
# difference between corrected compass and predicted heading from which matching also starts with the compass heading:
# beyond its noise of half a degree, below the ten degrees of a shove
SHOVED_RAD = 0.05
# no shove moves or turns a robot farther than this, beyond three standard deviations of the prediction: that is another
# place, or points that are none
MAX_SHOVE_M = 0.6
MAX_SHOVE_RAD = 0.8
EXPECTED = (0.03, 0.03, 0.01)  # m, m, rad: what the prediction may be off by beside its covariance
MAX_UNSETTLED = 5  # frames in a row that are left out as their tilt can't be settled; more: the camera is a poor one
# frames in a row that contradict the prediction, after which a lone line that supports it again shows what a shove has
# left: nothing of it along the line
SHOVED_FRAMES = 2
SURE_M = 0.05  # standard deviation of a match in every direction, up to which it is no lone line that is seen
LONE_LINE_SHOVE = 0.3  # share of a usual shove that is believed where only one line is seen
# standard deviation of the prediction from which a match is compared with other places along its least known direction:
# the end of a lone line looks like that of the arc or the area beside it
UNSURE_M = 0.1
LONG = (
    0.3  # of its deviations the shorter by the longer up to which lines leave it one direction; without odometry: all
)
BESIDE_M = 0.2  # distance of such places: less than that of any two lines
MAX_BESIDE = 10  # places on either side: no robot in play is unsure by more than a metre for long


class Tracker:
    """Follows the robot from frame to frame.

    `filter`: its pose and covariance. `has_pose`: whether they are a pose that matching can start from.
    """

    def __init__(
        self, matcher: Matcher, settings: FusionSettings | None = None, odometry: OdometrySettings | None = None
    ) -> None:
        """odometry: how far its scales may be wrong; None where the motion's covariance holds that already."""
        self.matcher = matcher
        self.settings = settings or FusionSettings()
        self._scales = EXACT_SCALES
        if odometry is not None and self.settings.paper.learn_odometry_scale:
            self._scales = Scales(odometry.forward_scale, odometry.sideways_scale, odometry.turn_scale)
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        prior = prior or Prior()
        pose = prior.pose or Pose(0.0, 0.0, 0.0)
        self.filter = PoseFilter(pose, prior.covariance, self.settings, self._scales)
        self.has_pose = prior.pose is not None
        self._unsettled = 0
        self._contradicted = 0  # frames in a row

    def start_at(self, pose: Pose, covariance: FloatArray, has_pose: bool = True) -> None:
        """Go on from a pose with its covariance (3, 3); has_pose: whether matching may start from it."""
        self.filter = self.filter.placed(pose, covariance)
        self.has_pose = has_pose

    def predict(self, motion: Motion) -> None:
        """The odometry carries the pose on."""
        self.filter.predict(motion.pose, motion.covariance)

    def match(self, view: MatchInput) -> Match | None:
        """Matching that starts where the odometry says, and with the compass heading where that makes a difference.

        None without a pose to start from, or without usable points.
        """
        if not (self.has_pose and view.usable):
            return None
        predicted, positions_m = self.filter.pose, view.positions_m
        pose, error, _ = self.matcher.descend(positions_m, view.weights, predicted.as_array())
        heading = predicted.heading if view.heading_rad is None else view.heading_rad
        turn_rad = abs(wrap_angle(heading - predicted.heading))
        differs = turn_rad > SHOVED_RAD or (error > POOR_ERROR and turn_rad > 0.0)
        if differs and self.settings.paper.compass_start:
            # a shove turns the robot, too; the compass feels what the odometry doesn't
            turned = predicted._replace(heading=heading)
            other, other_error, _ = self.matcher.descend(positions_m, view.weights, turned.as_array())
            if other_error < error:
                pose, error = other, other_error
        match = refine_with_tilt(self.matcher, view, pose, error, self._expected(pose))
        if not self.settings.paper.shoves or widest_m(self.filter.covariance) < UNSURE_M:
            return match
        return replace(match, covariance=match.covariance + self._left_open(view, match))

    def _left_open(self, view: MatchInput, match: Match) -> FloatArray:
        """Covariance (3, 3) along the prediction's least known direction, if places along it fit as well as a match."""
        open_ = np.zeros((3, 3))
        variances, axes = np.linalg.eigh(self.filter.covariance[:2, :2])
        axis, deviation_m = axes[:, 1], math.sqrt(variances[1])
        told_m = math.sqrt(float(axis @ match.covariance[:2, :2] @ axis))
        if told_m > deviation_m or variances[0] > LONG**2 * variances[1]:
            return open_
        predicted, pose = self.filter.pose.as_array(), match.pose.as_array()
        sides = min(math.ceil(3.0 * deviation_m / BESIDE_M), MAX_BESIDE)
        for k in range(-sides, sides + 1):
            start = pose.copy()
            start[:2] += (float((predicted - pose)[:2] @ axis) + BESIDE_M * k) * axis
            other, error, _ = self.matcher.descend(view.positions_m, view.weights, start)
            apart = abs(float((other - pose)[:2] @ axis)) > max(3.0 * told_m, 0.5 * BESIDE_M)
            likely = self.filter.distance2_to(as_pose(other), match.covariance) <= self.settings.gate
            if apart and likely and error <= equal_error(match.error):
                open_[:2, :2] = UNKNOWN_POSITION_M**2 * np.outer(axis, axis)
                return open_
        return open_

    def _expected(self, pose: FloatArray) -> Expected | None:
        """The prediction, for a match at a pose (3,) that shows no shove."""
        predicted, more = self.filter.pose, np.diag(np.square(EXPECTED))
        turned_rad = abs(wrap_angle(float(pose[2]) - predicted.heading))
        away_m = math.hypot(float(pose[0]) - predicted.x, float(pose[1]) - predicted.y)
        if turned_rad > SHOVED_RAD or away_m > SHOVE_POSITION_M:
            return None
        unwrapped = np.array([predicted.x, predicted.y, pose[2] + wrap_angle(predicted.heading - float(pose[2]))])
        return Expected(unwrapped, np.ascontiguousarray(self.filter.covariance + more))

    def fuse(self, view: MatchInput, match: Match | None) -> Fusion:
        """Kalman fusion of prediction and match; without a match the prediction stays. What the match says of it."""
        if match is None or self._waits_for_a_better(match):
            return Fusion.SUPPORTS
        fusion = self._fused_with(view, match)
        if fusion is Fusion.CONTRADICTS:
            self._contradicted += 1
        else:
            if self._contradicted >= SHOVED_FRAMES and fusion is Fusion.SUPPORTS and self.settings.paper.shoves:
                self.filter = self.filter.loosened(_shoved_unseen(match.covariance))
            self._contradicted = 0
        return fusion

    def _fused_with(self, view: MatchInput, match: Match) -> Fusion:
        s = self.settings
        if not s.paper.shoves or self.filter.distance2_to(match.pose, match.covariance) <= s.gate:
            self.filter.update(match.pose, match.inflation * match.covariance)
            return Fusion.SUPPORTS
        there = self._seen_from_prediction(view, match)
        if not self._shows_a_shove(match, there):
            observed = self._fuse_observable_directions(view, match, there)
            if observed is not Fusion.CONTRADICTS:
                return observed
            error = self.matcher.error(view.positions_m, view.weights, self.filter.pose.as_array())
            if error <= equal_error(match.error):
                return Fusion.SUPPORTS
        # where the prediction sees a lone line, one frame's few points beside it are no proof of a shove along it
        proven = self._contradicted > 0 or is_observed(there) or widest_m(match.covariance) < SURE_M
        trusted = s.paper.any_shove or (proven and self._may_be_shove(match))
        self.filter.update(match.pose, match.covariance, trusted=trusted)
        return Fusion.SHOVED if trusted else Fusion.CONTRADICTS

    def _waits_for_a_better(self, match: Match) -> bool:
        """Whether a frame is left out, as a shaking mirror may have shifted it by decimetres; not many in a row."""
        self._unsettled = 0 if match.settled else self._unsettled + 1
        return 0 < self._unsettled <= MAX_UNSETTLED

    def follow(self, view: MatchInput, match: Match | None) -> Fusion:
        """`fuse`, and a match that does not contradict the odometry corrects the compass."""
        fusion = self.fuse(view, match)
        believed = None if fusion is Fusion.CONTRADICTS else match
        view.correction.learn(believed, view.compass_rad, moved=fusion is Fusion.SHOVED)
        return fusion

    def unseen(self, view: MatchInput) -> FloatArray | None:
        """Covariance (3, 3) that no number of matches shows, in (m, m, rad); None if that is not looked at."""
        return view.tilt.unseen if self.matcher.settings.uncertainty.paper.residuals else None

    def _may_be_shove(self, match: Match) -> bool:
        """Whether a shove may have moved the robot so far from the prediction, and the lines fix the pose there."""
        pose = match.pose
        predicted, variances = self.filter.pose, np.diag(self.filter.covariance)
        far_m = predicted.distance_to(pose) - 3.0 * math.sqrt(variances[0] + variances[1])
        turned_rad = abs(wrap_angle(pose.heading - predicted.heading)) - 3.0 * math.sqrt(variances[2])
        return far_m < MAX_SHOVE_M and turned_rad < MAX_SHOVE_RAD and is_observed(match.covariance)

    def _shows_a_shove(self, match: Match, there: FloatArray) -> bool:
        """Whether lines fix match and prediction, so that what lies between is no slide along a line but a shove.

        However short: points off the lines, as other robots' are, raise the error of both alike. there (3, 3): what the
        points leave open at the prediction.
        """
        fixed = max(widest_m(there), widest_m(match.covariance)) < SURE_M
        distance2 = self.filter.distance2_to(match.pose, match.inflation * match.covariance)
        return fixed and distance2 > self.settings.gate and self._may_be_shove(match)

    def _seen_from_prediction(self, view: MatchInput, match: Match) -> FloatArray:
        """Covariance (3, 3) that the points leave a pose where the prediction is, in (m, m, rad)."""
        predicted = self.filter.pose.as_array()
        there = self.matcher.assess(view.positions_m, view.weights, predicted, match.error).covariance
        return there + view.tilt.shaken if self.matcher.settings.uncertainty.paper.residuals else there

    def _fuse_observable_directions(self, view: MatchInput, match: Match, there: FloatArray) -> Fusion:
        """Fuse a match far from the prediction by what the points observe at the prediction, if that is enough.

        RPROP may slide along a lone line to where the same points look unambiguous. First the prediction is taken at
        its word, then as that of a robot that was shoved. there (3, 3): what the points leave open at the prediction.
        """
        positions_m = view.positions_m
        # where the lines fix the pose a match after a shove needs no help; along a lone line a long shove can't be told
        # from a line that is none
        shoves = (1.0,) if self.settings.paper.any_shove else () if is_observed(there) else (LONE_LINE_SHOVE,)
        for shove in (0.0, *shoves):
            grown = np.diag([SHOVE_POSITION_M, SHOVE_POSITION_M, SHOVE_HEADING_RAD]) ** 2 * shove**2
            fused = self.filter.loosened(grown)
            if fused.distance2_to(match.pose, there) > self.settings.gate:
                continue
            fused.update(match.pose, match.inflation * there)
            if self.matcher.error(positions_m, view.weights, fused.pose.as_array()) <= equal_error(match.error):
                self.filter = fused.loosened(_shoved_unseen(there)) if shove else fused
                return Fusion.SHOVED if shove else Fusion.SUPPORTS
        return Fusion.CONTRADICTS


def _shoved_unseen(there: FloatArray) -> FloatArray:
    """Covariance (3, 3) of a shove along what a covariance (3, 3) leaves open: a lone line shows only half of it."""
    variances, axes = np.linalg.eigh(there[:2, :2])
    more = np.zeros((3, 3))
    more[:2, :2] = (axes * np.where(variances > MAX_DEVIATION_OF_POSITION_M**2, SHOVE_POSITION_M**2, 0.0)) @ axes.T
    return more
