"""The monitor beside any system: does the pose that it tracks agree with the field, the images and the odometry?

A system is judged by what it says, whatever it does inside: a bank of one member stands at each of its poses, registers
the image from there, and `Integrity` judges what comes of it. Nothing goes back into the system.
"""

import math
import time
from dataclasses import replace
from typing import Any

import numpy as np

from touchline.config import added
from touchline.field import FieldModel
from touchline.field.association import FieldAssociations
from touchline.geometry import Pose
from touchline.localization.camera_errors.base import CameraErrors
from touchline.localization.estimator.bank import Bank, Image, Member, ShoveTest, could_be_shove
from touchline.localization.estimator.filter import Filter, InitialUncertainty
from touchline.localization.estimator.integrity import MAX_LATE_M, MIN_SHARE_NOW, Integrity, Jump
from touchline.localization.estimator.safeguard import MAX_LOST_S
from touchline.localization.estimator.statistics import CameraErrorStatistics
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.registration.covariance import ANYWHERE
from touchline.localization.registration.features import Features
from touchline.localization.registration.registration import Registration
from touchline.localization.registration.seen import seen_of
from touchline.motion import MotionHistory
from touchline.motion.driven import Scales
from touchline.types import Estimate, Frame, Problem, ProblemCode, Status

MIN_POINTS = 10  # line points that an image shows, or it says nothing
SIGMA = np.diag(np.square([0.1, 0.1, 0.05]))  # covariance, at least, of a pose to its image: systems state less
PLACE_M = 0.01  # error of a crossing's place on the field


def monitored() -> Any:
    """The setting that switches a system's monitor."""
    text = (
        "a tracked pose that images, odometry or the field contradict is searching, and the sensor is named, by the "
        "monitor of touchline (docs/integrity.md); off: as in the paper"
    )
    return added(True, paper=False, description=text)


class NoMonitor:
    """Of a system in its paper's form."""

    def reset(self) -> None:
        """Nothing was known."""

    def judged(self, estimate: Estimate, frame: Frame, history: MotionHistory) -> Estimate:
        """The estimate as it is."""
        return estimate


class Monitor:
    """`judged`: an estimate with what contradicts it. One for each run, reset with its system."""

    def __init__(self, field: FieldModel, errors: CameraErrors, walks: bool) -> None:
        """walks: whether the robot has legs."""
        places = FieldAssociations(field)
        registration = Registration(field.distance_map(), places.tables)
        self.errors, self.features = errors, Features(places, None, errors.height_m, PLACE_M)
        initial = InitialUncertainty(Scales(0.0, 0.0, 0.0), errors.prior, errors.drift, errors.learned)
        self._start = Filter(Pose(0.0, 0.0, 0.0), ANYWHERE, initial)
        statistics = CameraErrorStatistics(errors)
        self.bank = Bank(
            registration, field.line_tables, statistics, self._start, StepNoise(walks), ShoveTest(math.inf)
        )
        self.integrity = Integrity(registration, field)
        self.reset()

    def reset(self) -> None:
        """Nothing has been seen."""
        self.bank.reset()
        self.integrity.reset(confirmed=True)
        self._before: Estimate | None = None
        self._late_s = 0.0

    def judged(self, estimate: Estimate, frame: Frame, history: MotionHistory) -> Estimate:
        """A tracked pose that is contradicted is searching, with the reason; problems name the sensor. frame: as its
        image was taken; history: with its samples.
        """
        seen, start_s = estimate.observation, time.perf_counter()
        if estimate.status is not Status.TRACKING or seen is None:
            return estimate
        shown = seen_of(seen, self.features, self.bank.statistics.noise)
        image = Image(shown, self.errors.response(frame), has_lines=len(seen.lines) > 0)
        if len(image.seen.positions_m) >= MIN_POINTS or len(image.seen.raw_m):
            self._take(estimate, image, history)
        self._before = estimate
        late = f"images are stamped {1e3 * self._late_s:.0f} ms too late" if self._late_s else ""
        delayed = Problem(ProblemCode.STAMPS_LATE, late) if late else None
        found = delayed, self.integrity.verdict.problem, self.integrity.report_camera()
        late_m = abs(self._late_s) * float(np.hypot(*self.integrity.motion.velocity[:2]))
        spent_ms = estimate.localization_ms + 1e3 * (time.perf_counter() - start_s)
        problems = (*estimate.problems, *filter(None, found))
        estimate = replace(estimate, problems=problems, statistics=self.integrity.statistics, localization_ms=spent_ms)
        # offsets that are not refuted would cost these systems poses that are right: they give no bound to widen
        if self.integrity.is_consistent(MIN_SHARE_NOW) and late_m < MAX_LATE_M:
            return estimate
        return estimate.unconfirmed(self.integrity.reason or late)

    def _take(self, estimate: Estimate, image: Image, history: MotionHistory) -> None:
        """Register an image from the system's pose, and judge what comes of it."""
        before, pose = self._before, estimate.pose
        known = self._start if self.bank.best is None else self.bank.best.filter
        there = known.placed(pose, estimate.covariance + SIGMA)
        if self.bank.best is None:
            self.bank.members = [Member(there, 0.0, self.bank.trust.confirming_images)]
            self.bank.confirmed = True
        self.bank.members[0].filter = there
        self.bank.register(image)
        self.bank.update(image, (), ())
        predicted = None
        if before is not None and estimate.stamp_ns - before.stamp_ns < 1e9 * MAX_LOST_S:
            predicted = before.pose.compose(history.between(before.stamp_ns, estimate.stamp_ns).pose)
        elsewhere = predicted is None or not could_be_shove(pose, predicted)
        jump = Jump(predicted, elsewhere)
        verdict, motion = self.integrity.verdict, self.integrity.relation.worst
        if elsewhere and not verdict.images and verdict.since_ns is None and motion < 1.0:
            self.integrity.reset(confirmed=True)  # what the pose before did not explain says nothing of this one
        verdict = self.integrity.update(estimate.stamp_ns, image, self.bank, history, self._late_s, jump)
        if verdict.late_s is not None:
            self._late_s = verdict.late_s
            self.integrity.excuse()
        elif self._late_s and self.integrity.relation.refutes_delay:
            self._late_s = 0.0
            self.integrity.excuse()
