"""When the field's end is known and when it is open: what was given at the start, and a compass, at each pose found."""

import math
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.estimator.bank import ALLOWED, Bank, Member, could_be_shove
from touchline.localization.estimator.compass_fault import StuckCompass
from touchline.localization.estimator.field_end import FieldEnd, OwnHalf
from touchline.localization.estimator.watch import Ends
from touchline.localization.search.pose_search import Known, contradiction
from touchline.motion import MotionHistory
from touchline.motion.delayed import Delayed
from touchline.types import Frame, Prior, Problem

ZONE = 0.6  # standard deviation (m, rad) of a given pose from which it is a zone: registration reaches no farther
GIVEN_S = 10.0  # for which a pose has to be tracked until the half that was given says no more of where one is found
# covariances (m, m, rad) of a prediction, beside its own: by sensors that agree; and by some of which one is at fault,
# whose first images have moved the pose before the alarm, or whose odometry carries it
AGREED = np.diag(np.square([0.02, 0.02, 0.01]))
MISTRUSTED = np.diag(np.square([0.7, 0.7, 0.35]))
CLEARLY = 2.0  # logarithm of the odds of one end from which a zone decides it


class Predicted(NamedTuple):
    """The pose before an image, and how wide that is (3, 3); extra_covariance (3, 3): what is added to that."""

    pose: Pose
    covariance: FloatArray
    extra_covariance: FloatArray

    @classmethod
    def of(cls, followed: Member, trusted: bool) -> Self:
        """As the filter of the pose that is followed has it. trusted: whether all sensors are."""
        return cls(followed.filter.pose, followed.filter.covariance, AGREED if trusted else MISTRUSTED)

    def allows(self, found: Pose) -> bool:
        """Whether a robot that was predicted there may stand here, shoved or known so widely, and not at the twin."""
        if could_be_shove(found, self.pose):
            return True
        here2, there2 = self.distances2(found)
        return here2 < ALLOWED and there2 - here2 > 2.0 * CLEARLY

    def distances2(self, found: Pose) -> tuple[float, float]:
        """Squared Mahalanobis distances of a pose and of its twin."""
        return self._distance2(found), self._distance2(found.mirrored())

    def _distance2(self, pose: Pose) -> float:
        off = pose.minus(self.pose)
        distance2 = float(off @ np.linalg.solve(self.covariance + self.extra_covariance, off))
        return distance2 if math.isfinite(distance2) else math.inf


class EndJudge:
    """Wires a start and a compass to the belief in the end. `ends`: for a search. `zone`: given, and not used up."""

    def __init__(self, end: FieldEnd, compass_counts: bool, compass_sigma_rad: float) -> None:
        """compass_sigma_rad: standard deviation of a heading by the compass."""
        self.end, self._compass_counts = end, compass_counts
        self._information = np.diag([0.0, 0.0, 1.0 / compass_sigma_rad**2])
        self._stuck = StuckCompass()
        self.reset(Prior())

    def reset(self, prior: Prior) -> None:
        """Know the prior alone."""
        self._half, self._tracked_s = OwnHalf() if prior.own_half else None, 0.0
        self.zone: Known | None = None
        if prior.pose is not None and prior.covariance is not None and np.diag(prior.covariance).max() > ZONE**2:
            self.zone = Known(prior.pose.as_array(), np.linalg.inv(prior.covariance))
        self._stuck.reset()
        self.end.reset(known=prior.pose is not None)

    def forget_start(self) -> None:
        """The robot was moved since."""
        self.zone = self._half = None

    @property
    def ends(self) -> Ends:
        """What a search knows of them."""
        return Ends(self.end.symmetric, self._half)

    def predict(self, moved: Delayed) -> None:
        """Propagate by the odometry."""
        if self._half is not None:
            self._half.predict(moved.motion.pose)

    def take(self, frame: Frame) -> None:
        """Take the compass readings of a frame."""
        self._stuck.update(frame.compass)

    def compass(self, stamp_ns: int, history: MotionHistory) -> float | None:
        """The compass heading (rad) at a time; None where none counts."""
        return history.compass.heading_at(stamp_ns) if self._compass_counts and not self._stuck.sticks else None

    def known(self, compass_rad: float | None) -> tuple[Known, ...]:
        """The heading by a compass, and the zone that was given."""
        zone = () if self.zone is None else (self.zone,)
        if compass_rad is None or self.end.compass.is_suspect:
            return zone
        return (Known(np.array([0.0, 0.0, compass_rad]), self._information), *zone)

    def follow(
        self,
        bank: Bank,
        followed: Member | None,
        predicted: Predicted | None,
        compass_rad: float | None,
        refereed: bool,
    ) -> None:
        """Whether the likeliest pose goes on from its prediction, has jumped, or was found anew. refereed: nobody
        carries a robot without a word; found elsewhere, it was lost, and with it its end.
        """
        best = bank.best
        assert best is not None
        if predicted is None or not predicted.allows(best.filter.pose):
            known = refereed and followed is not None and (self.end.log_odds > CLEARLY or self.end.undecided)
            self._begin(bank, best, followed is None, compass_rad)
            self.end.undecided |= self.end.symmetric and known and self.end.log_odds < CLEARLY
        elif best.shoved or best is not followed:
            self.end.jumped()

    def _begin(self, bank: Bank, best: Member, found: bool, compass_rad: float | None) -> None:
        """A pose was found anew, or elsewhere. The half that was given holds until a pose was tracked for long."""
        half = self._half
        if half is not None and self.end.symmetric and half.log_odds(best.filter.pose) < 0.0:
            self.swap_ends(bank)
        self.end.begin(found and self._is_in_zone(best.filter.pose), compass_error(best.filter.pose, compass_rad))
        if half is not None:
            self.end.prior_log_odds = half.log_odds(best.filter.pose)
        self.zone = None
        if self.end.symmetric and self.end.log_odds < 0.0:  # the compass has probably failed
            self.swap_ends(bank)

    def refute(self, bank: Bank) -> tuple[Problem, ...]:
        """Take the twin where it is clearly likelier; the problem to report."""
        if not self.end.is_refuted:
            return ()
        refutation = self.end.refutation
        self.swap_ends(bank)
        return (refutation,)

    def swap_ends(self, bank: Bank) -> None:
        """The twin is the pose from now on."""
        bank.swap_ends()
        self.end.swap_ends()

    def tracked(self, seconds: float) -> tuple[Problem, ...]:
        """A pose is tracked, for so long since the last image; the problem to report."""
        self._tracked_s += seconds
        if self._tracked_s >= GIVEN_S:
            self._half = None
        return self.end.report_undecided(seconds)

    def _is_in_zone(self, pose: Pose) -> bool:
        """Whether a pose is in the zone that was given, and its twin clearly is not."""
        if self.zone is None:
            return False
        return contradiction(pose.mirrored(), self.zone) - contradiction(pose, self.zone) > CLEARLY


def compass_error(pose: Pose, compass_rad: float | None) -> float | None:
    """Of a compass, by the heading of a pose (rad); None: no reading."""
    return None if compass_rad is None else wrap_angle(compass_rad - pose.heading)
