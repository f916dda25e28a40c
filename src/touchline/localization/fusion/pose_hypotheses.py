"""The poses that a robot may have, each followed by its own filter and weighed by what it explains.

A Gaussian sum filter (Alspach and Sorenson 1972) whose members register the points each from its own prediction. The
weights are log-odds: a member that explains the points of a frame better than another gains on it. New members come
from a search with the odds of a robot that was carried away; so a wrong pose is left as soon as another place explains
clearly more, and a right one stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from touchline.geometry import FloatArray, Pose, mirrored_covariance, wrap_angle
from touchline.localization.fusion.pose_filter import PoseFilter
from touchline.localization.registration.pose_search import Mode
from touchline.localization.registration.registration import Registered, Registration
from touchline.motion import Motion
from touchline.types import LinePoints

REPEATED = 4.0  # so many points err together, neighbours on a line: a frame tells so much less
CARRIED_AWAY = -6.0  # logarithm of the odds that the robot was moved unfelt, in a frame that makes one search
SHOVE = -2.0  # and that it was shoved since the last frame, against the odometry being right
UNLIKELY = 9.0  # logarithm of odds against the best from which a member is dropped
MOST = 12  # members
SAME_M, SAME_RAD = 0.25, 0.1  # members nearer than this are one
MIN_EXPLAINED = 0.4  # share of the points that a pose has to explain to be corrected by them
MOST_NOISE = 10.0  # of squared residuals against the points' variances: what is more is no camera's noise


@dataclass(eq=False, slots=True)
class Member:
    """A pose hypothesis: its filter, log-odds, and the last registration of points from it; None before the first."""

    filter: PoseFilter
    log_odds: float
    registered: Registered | None = None

    @property
    def explained(self) -> float:
        """Share of the last frame's points that it explains."""
        return 0.0 if self.registered is None else self.registered.explained


class PoseHypotheses:
    """`members`, the likeliest first. start: a filter without a pose, from which those of new members are made.

    gate: squared Mahalanobis distance of a registration from the prediction beyond which the robot was shoved. reach_m,
    reach_rad: of such a shove.
    """

    def __init__(
        self, registration: Registration, start: PoseFilter, gate: float, reach_m: float, reach_rad: float
    ) -> None:
        self.registration = registration
        self.start = start
        self.gate = gate
        self.reach_m, self.reach_rad = reach_m, reach_rad
        self.members: list[Member] = []

    @property
    def best(self) -> Member | None:
        """The likeliest."""
        return self.members[0] if self.members else None

    @property
    def probability(self) -> float:
        """Of the best, its twin on a symmetric field not counted."""
        return 1.0 / sum(math.exp(one.log_odds - self.members[0].log_odds) for one in self.members)

    def predict(self, motion: Motion) -> None:
        """The odometry carries every member on."""
        for one in self.members:
            one.filter.predict(motion.pose, motion.covariance)

    def update(self, points: LinePoints) -> None:
        """Register the points from every member, correct it by that and weigh it."""
        for one in self.members:
            found = self.registration.register(points.positions_m, points.covariances_m2, one.filter.pose.as_array())
            one.registered = found
            one.log_odds += found.log_likelihood / REPEATED
            self._correct(one, found)
        self._settle()

    def add(self, modes: Sequence[Mode]) -> None:
        """Members for the modes that a search has found in the points that `update` has just taken.

        Modes that are members already are left out; the others are as likely as that the robot was carried away.
        """
        before = max((one.log_odds - _told(one) for one in self.members), default=-CARRIED_AWAY)
        known = self.members[0].filter if self.members else self.start  # of the odometry's scales
        for mode in modes:
            if any(_same(mode.pose, one.filter.pose) for one in self.members):
                continue
            log_odds = before + CARRIED_AWAY + mode.log_likelihood / REPEATED
            found = Registered(mode.pose.as_array(), mode.covariance, mode.explained, mode.noise, mode.log_likelihood)
            self.members.append(Member(known.placed(mode.pose, honest(found)), log_odds, found))
        self._settle()

    def turn(self) -> None:
        """Every member stands at the other end of a symmetric field."""
        for one in self.members:
            one.filter = one.filter.placed(one.filter.pose.mirrored(), mirrored_covariance(one.filter.covariance))

    def _correct(self, one: Member, found: Registered) -> None:
        """Fuse a registration with a member, or leave it as it was predicted if it explains too little."""
        pose, covariance = _pose(found), honest(found)
        if found.explained < MIN_EXPLAINED:
            return
        if one.filter.distance2_to(pose, covariance) <= self.gate:
            one.filter.update(pose, covariance)
        elif self._may_be_shove(one.filter.pose, pose):
            one.log_odds += SHOVE
            one.filter.update(pose, covariance, trusted=True)

    def _may_be_shove(self, before: Pose, after: Pose) -> bool:
        turned = abs(wrap_angle(after.heading - before.heading))
        return before.distance_to(after) < self.reach_m and turned < self.reach_rad

    def _settle(self) -> None:
        """Sort, drop the unlikely, take those that have come together for one."""
        self.members.sort(key=lambda one: -one.log_odds)
        kept: list[Member] = []
        for one in self.members:
            unlikely = bool(kept) and one.log_odds < kept[0].log_odds - UNLIKELY
            if len(kept) < MOST and not unlikely and not any(_same(one.filter.pose, k.filter.pose) for k in kept):
                kept.append(one)
        top = kept[0].log_odds if kept else 0.0
        for one in kept:  # only differences count; the frame's likelihood is kept for `add`
            one.log_odds -= top
        self.members = kept


def honest(found: Registered) -> FloatArray:
    """Covariance (3, 3) of a registration in (m, m, rad): as much larger as the residuals are, and as points repeat."""
    return found.covariance * (REPEATED * min(max(found.noise, 1.0), MOST_NOISE))


def _told(one: Member) -> float:
    """What the last frame has added to a member's log-odds."""
    return 0.0 if one.registered is None else one.registered.log_likelihood / REPEATED


def _pose(found: Registered) -> Pose:
    return Pose(float(found.pose[0]), float(found.pose[1]), wrap_angle(float(found.pose[2])))


def _same(one: Pose, other: Pose) -> bool:
    turned = abs(wrap_angle(one.heading - other.heading))
    return one.distance_to(other) < SAME_M and turned < SAME_RAD
