"""Every pose that a robot with a perspective camera may have, each followed by a filter of its own, with log-odds.

On a field that looks the same from both ends all poses are told at one of them; which end it is, is another question
(`TwinOdds`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from touchline.geometry import Pose, wrap_angle
from touchline.localization.estimator.perspective_filter import Fitted, PerspectiveFilter
from touchline.localization.estimator.settling import settled
from touchline.localization.registration.perspective_kernels import LeanFit, SeenPoints
from touchline.localization.registration.perspective_registration import PerspectiveRegistration
from touchline.motion.odometry import Motion
from touchline.types import Evidence

MAX_GAIN = 4.0  # logarithm of the odds by which one image speaks at most: its features err together
CARRIED_AWAY = -8.0  # that the robot was moved unfelt, at an image that makes one search
FALLEN = -3.0  # the same after some seconds in which nothing was seen
SHOVE = -7.0  # that it was shoved, or has fallen, since the last image
SHOVED = np.array([0.4, 0.4, 0.5])  # and by how much: standard deviations (m, m, rad)
GATE = (
    16.3  # squared deviations of a pose from the prediction from which it was shoved: 99.9 % of right ones are within
)
POOR = 0.6  # share of what is seen below which a shove is tried
MIN_EXPLAINED = 0.4  # share below which an image says nothing of a pose
CONFIRMING = 1  # images beside the one that a pose was found in, until it is believed
CONTESTED = 0.15  # share by which another pose explains more of an image from which the likeliest one is in doubt
UNLIKELY = 12.0  # logarithm of odds against the best from which a hypothesis is dropped
MAX_HYPOTHESES = 10  # hypotheses
ANYWHERE = np.diag([0.1, 0.1, 0.3, 50.0, 50.0, 50.0, 50.0]) ** 2  # information of a pose that is not known, camera too
SAME_M, SAME_RAD = 0.25, 0.15  # hypotheses nearer than this are one


@dataclass(eq=False, slots=True)
class PerspectiveHypothesis:
    """A pose: its filter, its log-odds, and how the last image was fitted to it; None before the first.

    images: so many have been explained by it since it was found; a pose that was told needs none.
    """

    filter: PerspectiveFilter
    log_odds: float
    fit: LeanFit | None = None
    images: int = 0

    @property
    def explained(self) -> float:
        """Share of what the last image showed that lies where it should."""
        return 0.0 if self.fit is None else self.fit.explained


class PerspectiveHypotheses:
    """`members`, the likeliest first."""

    def __init__(self, registration: PerspectiveRegistration, symmetric: bool) -> None:
        """symmetric: whether the field looks the same from both ends, so that a pose stands for its twin, too."""
        self.registration, self.symmetric = registration, symmetric
        self.members: list[PerspectiveHypothesis] = []

    @property
    def best(self) -> PerspectiveHypothesis | None:
        """The likeliest."""
        return self.members[0] if self.members else None

    @property
    def probabilities(self) -> list[float]:
        """Of the members."""
        odds = [math.exp(one.log_odds - self.members[0].log_odds) for one in self.members]
        return [each / sum(odds) for each in odds]

    @property
    def is_confirmed(self) -> bool:
        """Whether more than the image that it was found in speaks for the likeliest pose."""
        return bool(self.members) and self.members[0].images >= CONFIRMING

    @property
    def is_contested(self) -> bool:
        """Whether another pose that has stood an image explains more of it than the likeliest one."""
        rivals = [one.explained for one in self.members[1:] if one.log_odds > CARRIED_AWAY + 1.0]
        return bool(rivals) and max(rivals) > self.members[0].explained + CONTESTED

    def start(self, start: PerspectiveFilter | None) -> None:
        """Follow this pose alone, or none."""
        self.members = [] if start is None else [PerspectiveHypothesis(start, 0.0, images=CONFIRMING)]

    def predict(self, motion: Motion, seconds: float) -> None:
        """The odometry carries every pose on."""
        for one in self.members:
            one.filter.predict(motion, seconds)

    def update(
        self, seen: SeenPoints, found: Sequence[LeanFit], known: PerspectiveFilter, moved: float = CARRIED_AWAY
    ) -> None:
        """Fuse an image with every pose and weigh them; found: poses that a search has found in it.

        known: a filter that knows camera and odometry. moved: logarithm of the odds that the robot was moved unfelt.
        """
        told: list[float] = []
        for one in self.members:
            told.append(self._fuse(one, seen, [_pose(fit) for fit in found]))
        followed = max(told, default=math.inf)
        before = max((one.log_odds for one in self.members), default=-moved)
        for fit in found:
            pose = _pose(fit)
            if any(self._is_known(pose, one.filter.pose) for one in self.members):
                continue
            covariance = np.linalg.inv(fit.information + ANYWHERE)[:3, :3]
            self.members.append(PerspectiveHypothesis(known.placed(pose, covariance), before + moved, fit))
            # the image that it was found in was fitted best of all places: that tells nothing against the others
            told.append(min(fit.log_likelihood, followed))
        if not told:
            return
        for one, evidence in zip(self.members, told, strict=True):
            one.log_odds += max(evidence - max(told), -MAX_GAIN)
        self._settle()

    def hear(self, evidence: Sequence[Evidence], share: float) -> None:
        """What others say weighs the poses, each and its twin alike; share: of it that is new."""
        for one in self.members:
            ends = (one.filter.pose, one.filter.pose.mirrored()) if self.symmetric else (one.filter.pose,)
            for said in evidence:
                one.log_odds += share * max(said.log_likelihood(end) for end in ends)
        if evidence and self.members:
            self._settle()

    def turn(self) -> None:
        """Every pose stands at the other end of a symmetric field."""
        for one in self.members:
            one.filter = one.filter.mirrored()

    def _fuse(self, one: PerspectiveHypothesis, seen: SeenPoints, starts: Sequence[Pose]) -> float:
        """Fuse an image with a pose; the logarithm of its likelihood there. starts: where else to begin, if the
        prediction allows it.
        """
        fitted, shove = one.filter.fitted(self.registration, seen), None
        if one.fit is None:
            starts = [*starts, *one.filter.starts()]
        for start in starts:
            if one.filter.allows(start):
                other = one.filter.fitted(self.registration, seen, start=start)
                fitted = max(fitted, other, key=_evidence)
        if fitted.fit.explained < POOR or fitted.distance2 > GATE:
            other = one.filter.fitted(self.registration, seen, SHOVED)
            if _evidence(other) - other.narrowed + SHOVE > _evidence(fitted) - fitted.narrowed:
                fitted, shove = other, SHOVED
        one.fit = fitted.fit
        if fitted.fit.explained >= MIN_EXPLAINED:
            one.filter.take(fitted, shove)
            one.images += 1
        return _evidence(fitted) + (SHOVE if shove is not None else 0.0)

    def _is_known(self, pose: Pose, known: Pose) -> bool:
        return _same(pose, known) or (self.symmetric and _same(pose.mirrored(), known))

    def _settle(self) -> None:
        """Sort, drop the unlikely, take those that have come together for one."""
        self.members = settled(
            self.members, MAX_HYPOTHESES, UNLIKELY, lambda one, other: _same(one.filter.pose, other.filter.pose)
        )


def _evidence(fitted: Fitted) -> float:
    """What an image says for a pose: that it fits, and that the pose is not far from the prediction."""
    return fitted.fit.log_likelihood - 0.5 * fitted.contradiction


def _pose(fit: LeanFit) -> Pose:
    return Pose(float(fit.state[0]), float(fit.state[1]), wrap_angle(float(fit.state[2])))


def _same(one: Pose, other: Pose) -> bool:
    return one.distance_to(other) < SAME_M and abs(wrap_angle(one.heading - other.heading)) < SAME_RAD
