"""The poses that a robot may have, each followed by its own filter and weighed by what it explains.

A Gaussian sum filter (Alspach and Sorenson 1972) whose members register the points each from its own prediction. The
weights are log-odds: a member that explains the points of a frame better than another gains on it, one that predicts
lines where none was seen loses. New members come
from a search with the odds of a robot that was carried away; so a wrong pose is left as soon as another place explains
clearly more, and a right one stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from touchline.field.distance_map import MapTable
from touchline.field.distances import LineTables
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.camera_errors.mirror_head import MirrorHead
from touchline.localization.estimator.joint_filter import JointFilter
from touchline.localization.estimator.settling import settled
from touchline.localization.registration.mirror_kernels import StateFit, StatePrior
from touchline.localization.registration.registration import Registration
from touchline.localization.registration.unseen import UNSEEN, unseen, view_of
from touchline.localization.search.pose_search import Mode
from touchline.motion.delayed import Delayed
from touchline.types import Evidence, LinePoints

REPEATED = 4.0  # so many points err together, neighbours on a line: a frame tells so much less
CARRIED_AWAY = -6.0  # logarithm of the odds that the robot was moved unfelt, in a frame that makes one search
SHOVE = -5.0  # and that it was shoved since the last frame, against the odometry being right: every twenty seconds
SHOVE_ON = -1.0  # the same in the image after one: a shove lasts longer than a tenth of a second
SHOVE_M, SHOVE_RAD = 0.6, 0.8  # how far a shove moves and turns the robot at most
SHOVED = np.diag(np.square([0.15, 0.15, 0.12]))  # covariance of what one does
UNLIKELY = 9.0  # logarithm of odds against the best from which a member is dropped
MAX_HYPOTHESES = 12  # members
SAME_M, SAME_RAD = 0.25, 0.1  # members nearer than this are one
FEW = 5.0  # points that alone show a direction, of which half is believed
MIN_EXPLAINED = 0.4  # share of the points that a pose has to explain to be corrected by them
ANYWHERE = np.diag(np.square([10.0, 10.0, 3.0]))  # covariance of a pose of which nothing is known


@dataclass(eq=False, slots=True)
class Member:
    """A pose hypothesis: its filter, log-odds, the last fit of points from it (None before the first), and what that

    fit has told for it: the logarithm of the points' evidence. expected: what that fit was given. shoved: whether the
    robot was, as far as it knows, since the image before.
    """

    filter: JointFilter
    log_odds: float
    fit: StateFit | None = None
    told: float = 0.0
    expected: StatePrior | None = None
    shoved: bool = False

    @property
    def explained(self) -> float:
        """Share of the last frame's points that it explains."""
        return 0.0 if self.fit is None else self.fit.explained


class PoseHypotheses:
    """`members`, the likeliest first. lines: of the field. start: a filter without a pose, to make new ones from.

    gate: squared Mahalanobis distance of a registration from the prediction beyond which the robot was shoved. most:
    members, at most. sees_shoves: whether a robot may have been shoved at all.
    """

    def __init__(
        self, registration: Registration, lines: LineTables, start: JointFilter, head: MirrorHead, gate: float
    ) -> None:
        self.registration, self._lines = registration, lines
        self.start, self.head = start, head
        self.gate = gate
        self.most, self.sees_shoves = MAX_HYPOTHESES, True
        self.members: list[Member] = []
        self.confirmed = False
        self._wander: FloatArray | None = None  # (3,) by how much the image's pose is off, robot frame

    @property
    def best(self) -> Member | None:
        """The likeliest."""
        return self.members[0] if self.members else None

    @property
    def probability(self) -> float:
        """Of the best, its twin on a symmetric field not counted."""
        return 1.0 / sum(math.exp(one.log_odds - self.members[0].log_odds) for one in self.members)

    def predict(self, moved: Delayed, wandering_s: float) -> None:
        """The odometry carries every member on. wandering_s: standard deviation by which this image's stamp is late."""
        self._wander = wandering_s * moved.after if wandering_s > 0.0 else None
        for one in self.members:
            one.filter.predict(moved)

    def upright(self, points: LinePoints) -> FloatArray:
        """Points (N, 2) without the errors of the mirror that are known (robot frame, m)."""
        return self.head.upright(points.positions_m, self._knowing)

    @property
    def _knowing(self) -> JointFilter:
        """What knows the mirror and the odometry's scales: who was never right has learned them wrong."""
        return self.members[0].filter if self.members and self.confirmed else self.start

    def mean_distances_m(self, points: LinePoints, lines: MapTable) -> list[float]:
        """Of the points from the lines at each member (m), without the mirror's errors that the likeliest has found."""
        head, members = self.head, self.members
        return [head.mean_distance_m(points.positions_m, members[0].filter, lines, one.filter.pose) for one in members]

    def update(self, points: LinePoints) -> None:
        """Fit the points from every member, correct it by that and weigh it."""
        for one in self.members:
            self._correct(one, points)
        if len(self.members) > 1:  # only differences count
            self._tell_unseen(self.members, points)
        self._settle()
        best = self.best
        if best is not None and best.fit is not None and best.expected is not None and best.explained >= MIN_EXPLAINED:
            self.head.learn(best.fit, best.expected, len(points))

    def add(self, modes: Sequence[Mode], points: LinePoints) -> None:
        """Members for the modes that a search has found in the points that `update` has just taken.

        Modes that are members already are left out; the others are as likely as that the robot was carried away.
        """
        before = max((one.log_odds - one.told for one in self.members), default=-CARRIED_AWAY)
        weighed = len(self.members) if len(self.members) > 1 else 0  # by what was not seen
        known = self._knowing
        for mode in modes:
            if any(_same(mode.pose, one.filter.pose) for one in self.members):
                continue
            new = known.placed(mode.pose, ANYWHERE)
            fit, told = self._fitted(new, self._prior_of(new), points, mode.pose.as_array())
            new.correct(fit, self.head.swing)
            self.members.append(Member(new, before + CARRIED_AWAY + told, fit, told))
        if len(self.members) > max(weighed, 1):
            self._tell_unseen(self.members[weighed:], points)
        self._settle()

    def _tell_unseen(self, members: Sequence[Member], points: LinePoints) -> None:
        """What was not seen of the lines that members predict in view speaks against them."""
        poses = np.array([one.filter.pose for one in members])
        counts = unseen(self._lines, view_of(self.upright(points)), poses)
        for one, count in zip(members, counts.tolist(), strict=True):
            one.told -= UNSEEN * count / REPEATED
            one.log_odds -= UNSEEN * count / REPEATED

    def hear(self, evidence: Sequence[Evidence], share: float) -> None:
        """What others say weighs the members, a pose and its twin alike; share: of it that is new."""
        if not evidence:
            return
        for one in self.members:
            ends = (one.filter.pose, one.filter.pose.mirrored())
            for said in evidence:
                one.log_odds += share * max(said.log_likelihood(end) for end in ends)
        self._settle()

    def turn(self) -> None:
        """Every member stands at the other end of a symmetric field."""
        for one in self.members:
            one.filter = one.filter.mirrored()

    def _correct(self, one: Member, points: LinePoints) -> None:
        """Fit the points to a member, and correct it; not if they are explained too little."""
        swing, predicted = self.head.swing, one.filter.pose.as_array()
        upright = self.head.upright(points.positions_m, one.filter)
        found = self.registration.fit(upright, points.covariances_m2, predicted)
        one.expected = self._prior_of(one.filter)
        one.fit, one.told = self._fitted(one.filter, one.expected, points, predicted)
        away, distance2 = one.filter.innovation(one.fit, swing)
        gained = (found.log_likelihood - one.fit.log_likelihood) / REPEATED
        odds = SHOVE_ON if one.shoved else SHOVE
        one.shoved = False
        if self.sees_shoves and (distance2 > self.gate or gained > -odds):
            jump = found.pose - predicted if gained > 0.0 else away
            self._shove(one, points, jump, odds)
        one.log_odds += one.told
        if one.explained >= MIN_EXPLAINED:
            one.filter.correct(one.fit, swing)

    def _shove(self, one: Member, points: LinePoints, jump: FloatArray, odds: float) -> None:
        """Let a member have been shoved by a jump (3,), if the points are explained better so."""
        predicted, loose = one.filter.pose.as_array(), one.filter.loosened(SHOVED)
        expected = self._prior_of(loose)
        tried = [self._fitted(loose, expected, points, start) for start in (predicted + jump, predicted)]
        near = [found for found in tried if is_shove(found[0].state[:3] - predicted)]
        if not near:
            return
        fit, told = max(near, key=lambda found: found[1])
        if told + odds > one.told:
            one.filter, one.expected, one.fit, one.told, one.shoved = loose, expected, fit, told + odds, True

    def _fitted(
        self, one: JointFilter, prior: StatePrior, points: LinePoints, pose: FloatArray
    ) -> tuple[StateFit, float]:
        """Pose and mirror errors by the points and what a filter expects, from a pose (3,), and the log-evidence."""
        start = np.array([*pose, *one.errors])
        start[2] = prior.mean[2] + wrap_angle(float(start[2] - prior.mean[2]))
        fit = self.registration.fit_state(points, start, prior, self.head.plan_of(one), self.head.seeing(len(points)))
        told = _doubted(fit, len(points))
        wander = self._wander_of(one)
        if wander is not None:
            told = _unsteady(told, wander)
        return told, fit.log_likelihood / REPEATED - fit.contradiction

    def _wander_of(self, one: JointFilter) -> FloatArray | None:
        """(3,) in the field frame, at a filter's heading."""
        if self._wander is None:
            return None
        x, y, turn = self._wander.tolist()
        cosine, sine = math.cos(one.pose.heading), math.sin(one.pose.heading)
        return np.array([cosine * x - sine * y, sine * x + cosine * y, turn])

    def _prior_of(self, one: JointFilter) -> StatePrior:
        return one.prior(self.head.swing, self._wander_of(one))

    def _settle(self) -> None:
        """Sort, drop the unlikely, take those that have come together for one."""
        self.members = settled(
            self.members, self.most, UNLIKELY, lambda one, other: _same(one.filter.pose, other.filter.pose)
        )


def is_shove(jump: FloatArray) -> bool:
    """Whether a robot may have been shoved so (3,): points may slide farther along a lone line."""
    return math.hypot(jump[0], jump[1]) < SHOVE_M and abs(wrap_angle(float(jump[2]))) < SHOVE_RAD


def _doubted(fit: StateFit, count: int) -> StateFit:
    """A fit of so many points that says less along the direction that only few of them show: those may be none of the
    line's, and of the next image's, too. Everything else is said as before.
    """
    told = fit.information
    (xx, xy), (_, yy) = told[:2, :2].tolist()
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    few = count * fit.explained * max(middle - half, 0.0) / max(middle + half, 1e-9)  # if all show the other direction
    if few > 10.0 * FEW or middle - half < 1e-9:
        return fit
    turned = 0.5 * math.atan2(2.0 * xy, xx - yy)
    measured = told[:, 1] * math.cos(turned) - told[:, 0] * math.sin(turned)
    less = FEW**2 / (few**2 + FEW**2) / (middle - half) * measured
    said = float(fit.gradient[1]) * math.cos(turned) - float(fit.gradient[0]) * math.sin(turned)
    return fit._replace(information=told - np.outer(less, measured), gradient=fit.gradient - less * said)


def _unsteady(fit: StateFit, wander: FloatArray) -> StateFit:
    """A fit that says less along the way (3,) by which the image was taken earlier or later than its stamp says."""
    measured = fit.information[:, :3] @ wander
    less = measured / (1.0 + float(measured[:3] @ wander))
    said = float(fit.gradient[:3] @ wander)
    return fit._replace(information=fit.information - np.outer(less, measured), gradient=fit.gradient - less * said)


def _same(one: Pose, other: Pose) -> bool:
    turned = abs(wrap_angle(one.heading - other.heading))
    return one.distance_to(other) < SAME_M and turned < SAME_RAD
