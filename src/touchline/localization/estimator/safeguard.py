"""What the filter does about a contradiction: whichever sensor is to blame no longer counts.

Odometry distrusted: its signs are put right where that explains all; else vision alone, with the motion that the
images tell. Images distrusted: the pose of before the fault, carried on by the odometry, until they are consistent
again; then the pose that they show is taken at the end of the field where it is near to that, or at their own where the
odometry turns out to be to blame; else the end is open. Stamps distrusted: the delay that explains them is taken, or
none is learned.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.localization.estimator.bank import ALLOWED, Bank, Image, Member, could_be_shove
from touchline.localization.estimator.believed import Believed
from touchline.localization.estimator.end_judge import MISTRUSTED, Predicted
from touchline.localization.estimator.field_end import EndMemory, FieldEnd
from touchline.localization.estimator.filter import Filter
from touchline.localization.estimator.integrity import ALL_WELL, Integrity, Jump, Verdict
from touchline.localization.estimator.pose_status import PoseStatus
from touchline.localization.estimator.stamp_delay import StampDelay
from touchline.localization.registration.registration import Registration
from touchline.motion import MotionHistory
from touchline.motion.delayed import Delayed, delayed, moving, with_signs
from touchline.types import Hypothesis, Problem, ProblemCode, Status

KEPT_EVERY_S, BACK_S = 0.5, 3.0  # of poses that are kept, and how far back one is taken: an alarm comes so late
NAMED_DELAY_DEVIATION_S = 0.03  # of a delay that the motion relation names
CLOCK_S = 0.2  # of a delay that a jump of the pose may take back: a clock was set; a shove makes smaller ones
CLEARLY = 4.0  # squared Mahalanobis distance by which one end is nearer to the pose that was held
MAX_LOST_S = 5.0  # after which a pose that was lost says nothing of where one that is found may be
DOUBLED_S = 60.0  # for which a pose is carried until it may be off by twice as much as at first


class Kept(NamedTuple):
    """A pose that was tracked while all was well."""

    stamp_ns: int
    filter: Filter
    end: EndMemory


class Published(NamedTuple):
    """A status with its reason, "" where there is none, and the protection levels (m, rad) where a bound is given."""

    status: Status
    reason: str
    bound_m: float | None = None
    bound_rad: float | None = None


class Safeguard:
    """`held`: the filter that counts in the place of the bank, while images are distrusted; else None."""

    def __init__(self, registration: Registration, field: FieldModel) -> None:
        self.integrity = Integrity(registration, field)
        self.reset()

    def reset(self, start: Filter | None = None, confirmed: bool = False, own_half: bool = False) -> None:
        """All is well. start: the pose that was given. confirmed: whether anything was; own_half: that alone."""
        self.integrity.reset(confirmed, own_half, given=start is not None)
        if start is not None:
            self.integrity.offsets.reset(start.pose, start.covariance)
        self._kept: deque[Kept] = deque(maxlen=8)
        self.held: Filter | None = None
        self._held_since_ns = 0
        self._same_end = True  # whether poses by images have gone on from the held one, a guess alone against them

    @property
    def verdict(self) -> Verdict:
        """On images and odometry."""
        return self.integrity.verdict

    def motion(self, history: MotionHistory, span_ns: tuple[int, int], late_s: float) -> Delayed:
        """Since the last image: by the odometry; where that is distrusted, with its signs put right, if they explain
        all, or as the images have shown it until then.
        """
        if self.verdict.odometry:
            return delayed(history, *span_ns, late_s)
        signs = self.integrity.relation.signs
        if signs is not None:
            return with_signs(delayed(history, *span_ns, late_s), signs, 1e-9 * (span_ns[1] - span_ns[0]))
        return moving(self.integrity.motion.velocity, 1e-9 * (span_ns[1] - span_ns[0]), late_s)

    def carry(self, moved: Delayed, seconds: float) -> None:
        """The held pose by the same motion as the bank's."""
        if self.held is not None:
            self.held.predict(moved, seconds)

    def update(
        self,
        stamp_ns: int,
        image: Image,
        bank: Bank,
        end: FieldEnd,
        history: MotionHistory,
        delay: StampDelay,
        jump: Jump,
    ) -> tuple[Problem, ...]:
        """Take an image after the bank has; the problem to report."""
        before = self.verdict
        verdict = self.integrity.update(stamp_ns, image, bank, history, delay.corrected_s, jump)
        lost = self._before_loss(stamp_ns, history, delay.corrected_s) if jump.elsewhere else None
        if lost is not None and bank.best is not None and verdict is ALL_WELL:
            self.integrity.suspect_mirror(stamp_ns, bank.best.filter.pose, lost)
            verdict = self.verdict
        if verdict.late_s is not None and verdict.late_s > 0.0 and delay.take(verdict.late_s, NAMED_DELAY_DEVIATION_S):
            bank.take_delay(verdict.late_s, NAMED_DELAY_DEVIATION_S)
            self.integrity.excuse()
            self._release(stamp_ns, bank, end, delay)
            return (Problem(ProblemCode.STAMPS_LATE_CORRECTED, f"{verdict.reason}: corrected"),)
        back = abs(self.integrity.lag_s + delay.corrected_s) < 2.0 * NAMED_DELAY_DEVIATION_S
        back &= delay.corrected_s > CLOCK_S
        if delay.corrected_s and (back or self.integrity.relation.refutes_delay):
            delay.reset()
            bank.take_delay(0.0, NAMED_DELAY_DEVIATION_S)
            self.integrity.excuse()
            self._release(stamp_ns, bank, end, delay)
            return ()
        self._same_end &= jump.keeps_end and (before.images or before.is_guess)
        if before.images and not verdict.images:
            self._hold(stamp_ns, bank, end, history, delay.corrected_s)
        elif verdict.images:
            self._release(stamp_ns, bank, end, delay)
        if before.odometry and not verdict.odometry:
            self._forget_odometry(bank)
        return tuple(filter(None, (verdict.problem, self.integrity.report_camera())))

    def instead_of(self, found: Believed) -> Believed:
        """The pose that is held, if there is one; what was found then is another hypothesis."""
        if self.held is None:
            return found
        doubted = Hypothesis(found.pose, found.residual_m, None, found.covariance)
        return Believed(self.held.pose, self.held.covariance, found.residual_m, lambda: (*found.others(), doubted))

    def judge(
        self, judged: PoseStatus, unseen: str, covariance: FloatArray, stamp_ns: int, history: MotionHistory
    ) -> Published:
        """What a status and covariance (3, 3) are worth. unseen: why images have not confirmed the pose yet, or ""."""
        status = judged.status
        if unseen:
            return Published(Status.SEARCHING, unseen)
        if status is not Status.TRACKING:
            return Published(status, self.verdict.reason or judged.reason)
        if not self.integrity.is_believed:
            return Published(Status.SEARCHING, self.integrity.reason)
        bounds = self.integrity.protection(covariance, stamp_ns, history)
        if bounds is None:
            return Published(Status.SEARCHING, self.integrity.unbounded)
        return Published(status, self.verdict.reason, *bounds)

    def keep(self, stamp_ns: int, one: Filter, end: FieldEnd) -> None:
        """Remember a pose that is tracked, every now and then."""
        if not self.integrity.is_settled:
            return
        if not self._kept or stamp_ns - self._kept[-1].stamp_ns >= 1e9 * KEPT_EVERY_S:
            self._kept.append(Kept(stamp_ns, one.loosened(np.zeros((3, 3))), end.memory))

    def _before_loss(self, stamp_ns: int, history: MotionHistory, late_s: float) -> Pose | None:
        """Where the pose of before its loss would be by now: the first images of a fault may have moved it already."""
        kept = next((one for one in self._kept if stamp_ns - one.stamp_ns < 1e9 * MAX_LOST_S), None)
        return None if kept is None else kept.filter.ahead(delayed(history, kept.stamp_ns, stamp_ns, late_s)).pose

    def _hold(self, stamp_ns: int, bank: Bank, end: FieldEnd, history: MotionHistory, late_s: float) -> None:
        """Go back to before the fault, as far as it is known when that was."""
        if not self._kept:
            return
        since_ns = self.verdict.since_ns or stamp_ns - round(1e9 * BACK_S)
        old = [one for one in self._kept if one.stamp_ns < since_ns]
        kept = old[-1] if old else self._kept[0]
        if stamp_ns - kept.stamp_ns < 1e9 * MAX_LOST_S:
            self.held = kept.filter.ahead(delayed(history, kept.stamp_ns, stamp_ns, late_s))
            self._held_since_ns = stamp_ns
            assert bank.best is not None
            near = _expected(self.held, bank.best.filter, 0.0).allows(bank.best.filter.pose)
            self._same_end = self.verdict.is_guess and near
            end.recall(kept.end)
            self._kept.clear()

    def _release(self, stamp_ns: int, bank: Bank, end: FieldEnd, delay: StampDelay) -> None:
        """Images are trusted, again where a pose is held: at which end is the one that they show?"""
        held, best, self.held = self.held, bank.best, None
        if held is None or best is None:
            return
        self.integrity.offsets.begin_again()
        if self.verdict.odometry or not self._same_end:  # else it was the odometry, and the images never to blame
            expected = _expected(held, best.filter, 1e-9 * (stamp_ns - self._held_since_ns))
            here, there = expected.distances2(best.filter.pose)
            if end.symmetric and there < here:
                bank.swap_ends()
            exchanged = self._same_end and there < here  # by the odometry, against the images: one of them is wrong
            if min(here, there) > ALLOWED or (end.symmetric and (exchanged or abs(here - there) < CLEARLY)):
                end.leave_open()
        assert bank.best is not None
        bank.reset(held.placed(bank.best.filter.pose, bank.best.filter.covariance))
        bank.confirmed = True
        if delay.corrected_s:
            bank.take_delay(delay.corrected_s, delay.deviation_s)

    def _forget_odometry(self, bank: Bank) -> None:
        """What the fault has taught of scales, delay and camera."""
        if self._kept:
            before = self._kept[0].filter
            for one in bank.members:
                one.filter = before.placed(one.filter.pose, one.filter.covariance)


def _expected(held: Filter, seen: Filter, seconds: float) -> Predicted:
    """Where a pose that images show may be, by one that has been carried for so long."""
    may_be_off = MISTRUSTED * (1.0 + seconds / DOUBLED_S) ** 2
    return Predicted(held.pose, held.covariance + seen.covariance, may_be_off)


def jump_of(best: Member | None, predicted: Predicted | None, expected: bool) -> Jump:
    """From the pose that was predicted, if one was followed. expected: something has moved the robot unseen."""
    elsewhere = best is None or predicted is None or not could_be_shove(best.filter.pose, predicted.pose)
    if predicted is None or (elsewhere and expected):
        return Jump(None, True)
    keeps_end = best is not None and (not elsewhere or predicted.allows(best.filter.pose))
    return Jump(predicted.pose, elsewhere, keeps_end)
