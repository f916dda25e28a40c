"""What the filter does about a contradiction: whichever sensor is to blame no longer counts.

Odometry distrusted: vision alone, with the motion that the images tell. Images distrusted: the pose of before the
fault, carried on by the odometry, until they are consistent again; then the pose that they show is taken at the end of
the field that is nearer to it. Stamps distrusted: the delay that explains them is taken, or none is learned.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from touchline.field import FieldModel
from touchline.geometry import FloatArray, as_pose
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
from touchline.types import Hypothesis, Status

KEPT_EVERY_S, BACK_S = 0.5, 3.0  # of poses that are kept, and how far back one is taken: an alarm comes so late
NAMED_DELAY_DEVIATION_S = 0.03  # of a delay that the motion relation names
CLOCK_S = 0.2  # of a delay that a jump of the pose may take back: a clock was set; a shove makes smaller ones
CLEARLY = 4.0  # squared Mahalanobis distance by which one end is nearer to the pose that was held
MAX_LOST_S = 5.0  # after which a pose that was lost says nothing of where one that is found may be
HELD_TWICE_S = 60.0  # for which a pose is carried until it may be off by twice as much as at first


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
        self._same_end = True  # as the held one: of all poses since by images that a guess distrusts

    @property
    def verdict(self) -> Verdict:
        """On images and odometry."""
        return self.integrity.verdict

    def motion(self, history: MotionHistory, span_ns: tuple[int, int], late_s: float) -> Delayed:
        """Since the last image: by the odometry; where that is distrusted, with its signs put right, if they explain
        all, or as the images told until then.
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
    ) -> tuple[str, ...]:
        """Take an image after the bank has; the problem to report."""
        before = self.verdict
        verdict = self.integrity.update(stamp_ns, image, bank, history, delay.corrected_s, jump)
        if jump.elsewhere and self.held is None:
            self._find(stamp_ns, bank, end, history, delay.corrected_s)
            verdict = self.verdict
        if verdict.late_s is not None and verdict.late_s > 0.0 and delay.take(verdict.late_s, NAMED_DELAY_DEVIATION_S):
            bank.take_delay(verdict.late_s, NAMED_DELAY_DEVIATION_S)
            self.integrity.excuse()
            return (f"{verdict.reason}: corrected",)
        back = abs(self.integrity.lag_s + delay.corrected_s) < 2.0 * NAMED_DELAY_DEVIATION_S
        back &= delay.corrected_s > CLOCK_S
        if delay.corrected_s and (back or self.integrity.relation.refutes_delay):
            delay.reset()
            bank.take_delay(0.0, NAMED_DELAY_DEVIATION_S)
            self.integrity.excuse()
            return ()
        self._same_end &= jump.keeps_end and (before.images or before.is_guess)
        if before.images and not verdict.images:
            self._hold(stamp_ns, bank, end, history, delay.corrected_s)
        elif before.odometry and not verdict.odometry:
            self._forget_odometry(bank)
        elif verdict.images and self.held is not None:
            self._release(stamp_ns, bank, end)
            if delay.corrected_s:
                bank.take_delay(delay.corrected_s, delay.deviation_s)
        camera = self.integrity.report_camera()
        return tuple(each for each in (verdict.reason, camera) if each)

    def instead_of(self, found: Believed) -> Believed:
        """The pose that is held, if there is one; what was found then is another hypothesis."""
        if self.held is None:
            return found
        doubted = Hypothesis(found.pose, found.residual_m, None, found.covariance)
        return Believed(self.held.pose, self.held.covariance, found.residual_m, [*found.others, doubted])

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

    def _find(self, stamp_ns: int, bank: Bank, end: FieldEnd, history: MotionHistory, late_s: float) -> None:
        """A pose is found elsewhere, soon after one was lost: it may be by mirrored images, and its end is that of the
        other if only there it is near where that would be by now.
        """
        # the first images of a fault may have moved the newest ones already
        kept = next((one for one in self._kept if stamp_ns - one.stamp_ns < 1e9 * MAX_LOST_S), None)
        if kept is None or bank.best is None:
            return
        carried = kept.filter.ahead(delayed(history, kept.stamp_ns, stamp_ns, late_s))
        found = bank.best.filter.pose
        if self.verdict is ALL_WELL and self.integrity.suspect_mirror(stamp_ns, found, carried.pose):
            return
        here, there = self._may_be(carried, 1e-9 * (stamp_ns - kept.stamp_ns)).distances2(found)
        if end.symmetric and min(here, there) < ALLOWED and abs(here - there) > CLEARLY:
            end.recall(kept.end)
            if there < here:
                bank.swap_ends()

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
            near = self._may_be(self.held, 0.0).allows(bank.best.filter.pose)
            self._same_end = self.verdict.is_guess and near
            end.recall(kept.end)
            self._kept.clear()

    def _release(self, stamp_ns: int, bank: Bank, end: FieldEnd) -> None:
        """Images are consistent again: at which end is the pose that they show?"""
        self.integrity.offsets.begin_again()
        held, best, self.held = self.held, bank.best, None
        if held is None or best is None:
            return
        if self.verdict.odometry or not self._same_end:  # else it was the odometry, and the images never to blame
            here, there = self._may_be(held, 1e-9 * (stamp_ns - self._held_since_ns)).distances2(best.filter.pose)
            if end.symmetric and there < here:
                bank.swap_ends()
            if min(here, there) > ALLOWED or (end.symmetric and abs(here - there) < CLEARLY):
                end.leave_open()
        assert bank.best is not None
        bank.reset(held.placed(bank.best.filter.pose, bank.best.filter.covariance))
        bank.confirmed = True

    @staticmethod
    def _may_be(held: Filter, seconds: float) -> Predicted:
        """Where the robot may be by a pose that has been carried for so long."""
        return Predicted(held.pose.as_array(), held.covariance + MISTRUSTED * (1.0 + seconds / HELD_TWICE_S) ** 2)

    def _forget_odometry(self, bank: Bank) -> None:
        """What the fault has taught of scales, delay and camera."""
        if self._kept:
            before = self._kept[0].filter
            for one in bank.members:
                one.filter = before.placed(one.filter.pose, one.filter.covariance)


def jump_of(best: Member | None, predicted: Predicted | None, expected: bool) -> Jump:
    """From the pose that was predicted, if one was followed. expected: something has moved the robot unseen."""
    elsewhere = best is None or predicted is None or not could_be_shove(best.filter.pose.as_array() - predicted.pose)
    if predicted is None or (elsewhere and expected):
        return Jump(None, True)
    return Jump(as_pose(predicted.pose), elsewhere, best is not None and predicted.allows(best.filter.pose))
