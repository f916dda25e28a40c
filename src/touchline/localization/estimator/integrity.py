"""Whether the model of the world holds: statistics of consistency, whose threshold each stands for a rate of false
alarms, and which sensor contradicts the rest.

A pose can fit its image perfectly and be wrong: where the image is mirrored, old or of another field, where the
odometry has a wrong sign. Residuals do not show that. What shows it is whether images and odometry tell the same
motion, whether the field explains what is seen better than chance, and whether camera.yaml explains the camera.
"""

import math
from typing import NamedTuple

import numpy as np

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.estimator.bank import MIN_EXPLAINED, Bank, Image, Member
from touchline.localization.estimator.constant_offsets import ConstantOffsets
from touchline.localization.estimator.field_proof import SHOWN_M, FieldProof
from touchline.localization.estimator.line_coverage import LineCoverage
from touchline.localization.estimator.motion_relation import (
    LAGS_S,
    MIRRORED,
    SIDES_EXCHANGED,
    STATISTICS,
    STEP_S,
    MotionRelation,
)
from touchline.localization.estimator.stamp_delay import CLOCK_S, Arrivals
from touchline.localization.estimator.visual_motion import Camera, Sighting, Velocity, VisualMotion
from touchline.localization.registration.attitudes import GOOD
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.line_share import on_lines
from touchline.localization.registration.registration import TRACKING, Registration
from touchline.localization.registration.unseen import seen_ratio
from touchline.motion import MotionHistory
from touchline.motion.odometry import halt_of
from touchline.types import Problem, ProblemCode
from touchline.types.estimate import UNCONFIRMED

SHARE_MEMORY, MIN_IMAGES = 10, 3  # images that a mean share is of, and with which it begins to count
CHANCE_EVERY = 3  # images in which the chance level is found once
# of the newest few images; after a jump of the pose; after more than MAX_JUMPS
MIN_SHARE_NOW, MIN_SHARE_JUMPED, MIN_SHARE_JUMPING = 0.6, 0.75, 0.9
# of poses that were consistent and jumped, as a field does that fits here and there; how soon one no longer counts
MAX_JUMPS, JUMPS_PER_S = 1.3, 0.05
GOOD_IMAGES = (
    2  # in a row, in which a pose found in the own half is as good as the right one is (`GOOD`), until it counts
)
JUMP_M, JUMP_RAD = 0.25, 0.1  # of the pose, after which that holds for some images
# by how much gyro and odometry are apart at most (rad, and of what the pose turned) where they deny that it turned
UNFELT_RAD, UNFELT_RATIO = 0.02, 0.3
FOREIGN_S, FORGOTTEN_PER_S = 1.0, 0.02  # time for which images lay on no line, from where a pose is on probation
PROBATION_S, GOOD_SHARE = 3.0, 0.8  # how long it then has to explain so much, ten images in the mean
MIN_SHARE = 0.65  # mean share of what is seen that the pose explains
BESIDES = 0.4  # as how much what lies on no line counts once the field is known
USUAL_SHARE, MAX_DEFICIT = 0.75, 3.0  # share below which deficits add up, and the sum that is too much
MIN_ABOVE_CHANCE = 0.3  # share explained beyond what the same points at other bearings explain
CAMERA, CAMERA_EVERY = "camera", 200  # the statistic that names a problem and distrusts nothing: the error is learned
OF_IMAGES = "share", "chance", "carpet", "repetition"  # those that distrust images
MAX_ERROR_Z = 3.3  # standard deviations of its prior by which a camera error is believable
OUTSIDE_M = 0.3  # beyond the carpet no robot stands
REPEATED_S = 0.4  # time over which the same points may be seen, to the bit, while the wheels turn
MIRRORED_M, MIRRORED_RAD = 0.4, 0.2  # near where a mirrored image would put the robot
MAX_LATE_M = 0.4  # by which a pose may be off if the camera's clock was set, and still be tracked
MIN_LAG_M, MIN_SPEED_M_S = 0.04, 0.3  # jump and speed from which a clock may have been set
LAG_ASIDE_M, LAG_ASIDE_RATIO = 0.04, 0.15  # beside its own way
PROTECTION_SIGMAS, PROTECTION_M, PROTECTION_RAD = 6.0, 0.02, 0.01  # tails are not Gaussian: 3.7 sigma are not enough
CONSISTENT, EXCESS = 0.3, 2.0  # statistic from which a bound is wider, and by how much
DOUBTED = 0.4  # statistic of the motion from which an odometry does not carry a pose far unseen
VISION_ALONE = 0.8  # statistic that counts while the odometry does not
LIKELY = 0.9  # probability from which a pose teaches what a robot usually sees: as from which it is tracked
SETTLED = 0.7  # statistic below which a pose is one to come back to
MAX_PROTECTED = 0.85  # statistic of the images from which no bound can be given
ALERT_M, ALERT_RAD = 1.0, 0.45  # bound from which a pose is of no use
# at the first image through a camera of which roll and pitch are known to worse than so much: the next one shows
FIRST_ALERT_M, ASKEW_RAD = 0.5, 0.035
ALERT_UNPROVED_M = 0.4  # while no images have confirmed the odometry, and the newest contradict it
# way without an image from which a bound grows, and by how much for it: by an odometry whose sign is wrong a pose is
# off by twice the way
UNSEEN_M, UNSEEN_RATIO = 0.05, 2.0
GYRO_RAD, GYRO_RATIO = 0.05, 0.15  # within which the gyro confirms an unseen turn of the odometry
DENIED_RAD, DENIED_RATIO = 0.15, 0.5  # and beyond which it denies it: a late odometry is nearer
_NO_STEPS = Plan(np.zeros(0), TRACKING.gate2, TRACKING.floor_m2, TRACKING.clutter_per_m)
_GOLDEN = 2.399963
NOWHERE = Pose(0.0, 0.0, 0.0)


class Verdict(NamedTuple):
    """Whether images, and the odometry, are trusted; the problem, None where both are; how late images are stamped,
    where that explains everything; since_ns: when the fault began, where that is known; is_guess: whether nothing says
    which of images and odometry is to blame.
    """

    images: bool
    odometry: bool
    problem: Problem | None = None
    late_s: float | None = None
    since_ns: int | None = None
    is_guess: bool = False

    @property
    def reason(self) -> str:
        """The problem in words, or ""."""
        return "" if self.problem is None else self.problem.sentence


class Jump(NamedTuple):
    """Where the pose was expected, None if it was not followed; elsewhere: whether it was found farther off than a
    shove moves it; keeps_end: whether a robot that was expected there may be here, and not at the twin.
    """

    predicted: Pose | None
    elsewhere: bool
    keeps_end: bool = False


ALL_WELL = Verdict(True, True)


class Integrity:
    """`verdict`; `statistics`: each as a share of its threshold, an alarm from 1 on; `confirmed`: whether the motion
    has confirmed a pose that was not given; `lag_s`: by which images may be late since the pose jumped, else 0.
    """

    def __init__(self, registration: Registration, field: FieldModel) -> None:
        self._registration = registration
        self._reach_m = tuple(0.5 * side + field.border + OUTSIDE_M for side in (field.length, field.width))
        self._field = field
        self.motion = VisualMotion(registration)
        self.relation = MotionRelation()
        self.unbounded = ""  # why the newest pose has no bound
        self.offsets = ConstantOffsets()
        self.arrivals = Arrivals()
        self._coverage = LineCoverage()
        self._proof = FieldProof(field.length)
        self.reset()

    def reset(self, confirmed: bool = False, own_half: bool = False, given: bool = False) -> None:
        """Nothing has been seen. confirmed: something was given; own_half: only that the robot stands there; given: its
        pose.
        """
        self.confirmed, self._proved, self._own_half = confirmed, False, own_half
        self._prior_given = confirmed  # or taken to be
        self._given = given  # whether the pose was, and the images agreed
        self._moves_proved = self._turns_proved = False  # by the odometry, as the images show them
        self._good_images = 0  # in a row that agree with a pose found in the own half
        self.motion.reset()
        self.relation.reset()
        self.offsets.reset()
        self.arrivals.reset()
        self._coverage.reset()
        self._proof.reset()
        self._knows_field = False  # whether what lies on no line is clutter: the motion raises no doubt, either
        self._jumps, self._jumped_ns, self._held_up = 0.0, 0, True  # whether the pose was consistent since it was found
        self.verdict = ALL_WELL
        self._seen_ns = 0  # of the newest image that the pose explains
        self._halt_m_s = self._halted_m = 0.0  # speed before the odometry halted, and the way since, unseen
        self._velocity: Velocity = (0.0, 0.0, 0.0)  # of late
        self._camera_images = 0  # in a row in which the camera's errors were larger than camera.yaml states
        self._contradicted = False  # whether it was followed by a jump that led far, before the motion proved a pose
        self.statistics: dict[str, float] = {}
        self._worst = 0.0  # of those that distrust something
        self._shares: list[float] = []
        self._shares_of_points: list[float] = []  # which is what chance explains, too
        self._since_jump = SHARE_MEMORY  # images
        self.lag_s = 0.0  # by which images may be stamped late since a jump
        self._chance, self._since_chance = 0.0, CHANCE_EVERY
        self._deficit = self._error_z = self._outside_m = 0.0
        self._is_askew = False  # whether nobody knows the camera's roll and pitch
        self._foreign_s, self._good_s, self._before_ns = 0.0, 0.0, 0  # of images that lay on no lines; of good ones
        self._points, self._same_since_ns = b"", 0
        self._repeated_s = 0.0
        self._sees_marks = self._lines_alone = False  # crossings or landmarks, ever; none since the pose jumped unfelt

    @property
    def share(self) -> float:
        """Mean share of what the newest images showed that the pose explains."""
        return sum(self._shares) / len(self._shares) if self._shares else 1.0

    @property
    def is_believed(self) -> bool:
        """Whether a pose may be tracked."""
        least = MIN_SHARE_JUMPED if self._since_jump < SHARE_MEMORY else MIN_SHARE_NOW
        if not self._knows_field:
            least = MIN_SHARE_JUMPING if self._jumps > MAX_JUMPS and self._good_s < PROBATION_S else least
            if self.relation.all_round and not self._given and self.share < USUAL_SHARE:
                return False
        return self.confirmed and not self._doubt and self.is_consistent(least)

    @property
    def _doubt(self) -> str:
        """Why a pose that is consistent may not be tracked; empty where it may."""
        if self._lines_alone:
            return "the pose has jumped, which neither gyro nor odometry felt, and explains no crossing or mark"
        if not self._coverage.shown:
            return "found elsewhere, where more lines would be seen than are"
        if self._foreign_s > FOREIGN_S and self._good_s < PROBATION_S and not self._knows_field:
            return "what was seen of late lay on no line: another field, clutter, or camera.yaml"
        return "the newest image contradicts the odometry" if self.relation.may_contradict else self.offsets.doubt

    def is_consistent(self, min_share: float) -> bool:
        """Whether nothing contradicts the pose, which explains at least this share of what is seen."""
        newest = self._shares[-min(MIN_IMAGES, self._since_jump + 1) :]
        late_m = abs(self.lag_s) * math.hypot(*self._velocity[:2]) if self.lag_s else 0.0
        return self.verdict.images and sum(newest) >= min_share * len(newest) and late_m < MAX_LATE_M

    @property
    def is_settled(self) -> bool:
        """Whether all has been well for some images: a pose to come back to."""
        seen = len(self._shares) == SHARE_MEMORY and self.verdict is ALL_WELL
        return seen and self._worst < SETTLED

    def report_camera(self) -> Problem | None:
        """That the errors which were learned are more than camera.yaml states; at first, and now and then. Once an
        image.
        """
        self._camera_images = self._camera_images + 1 if self.statistics.get(CAMERA, 0.0) >= 1.0 else 0
        if self._camera_images % CAMERA_EVERY != 1:
            return None
        sentence = "the camera differs from camera.yaml by more than that states: learned from the lines"
        return Problem(ProblemCode.CAMERA_DIFFERS, sentence)

    @property
    def reason(self) -> str:
        """Why a pose may not be tracked."""
        if self.verdict.problem or self.is_believed:
            return self.verdict.reason
        if not self.confirmed:
            return UNCONFIRMED
        if self._doubt:
            return self._doubt
        if self._jumps > MAX_JUMPS:
            return "the pose has jumped more than once, and explains too little: another field, or camera.yaml"
        jumped = self._since_jump < SHARE_MEMORY
        return "the pose has jumped" if jumped else "the pose explains too little of what is seen"

    def _measured(self) -> dict[str, float]:
        """Each statistic as a share of its threshold."""
        share = chance = 0.0
        if len(self._shares) >= MIN_IMAGES:
            share = max((1.0 - self.share) / (1.0 - MIN_SHARE), self._deficit / MAX_DEFICIT)
            of_points = sum(self._shares_of_points) / len(self._shares_of_points)
            above = (of_points - self._chance) / (1.0 - self._chance)
            chance = (1.0 - above) / (1.0 - MIN_ABOVE_CHANCE)
        return {
            **self.relation.statistics,
            "share": share,
            "chance": chance,
            CAMERA: self._error_z / MAX_ERROR_Z,
            "carpet": self._outside_m / OUTSIDE_M,
            "repetition": self._repeated_s / REPEATED_S,
        }

    def protection(self, covariance: FloatArray, stamp_ns: int, history: MotionHistory) -> tuple[float, float] | None:
        """Bounds (m, rad) that the errors of a tracked pose exceed in one of a thousand images at most; None: none of
        use can be given, `unbounded` says why, and the pose is not tracked. covariance (3, 3): of the pose; history:
        since the last image that showed something, the odometry is not checked by anything.
        """
        known, trusted = self.statistics.get, self.verdict.odometry
        images, motion = [known(name, 0.0) for name in OF_IMAGES], [known(name, 0.0) for name in STATISTICS]
        of_images, of_motion = max(images), max(motion)
        if of_images > MAX_PROTECTED or not self.verdict.images or self._repeated_s:
            name = OF_IMAGES[images.index(of_images)] if self.statistics else "nothing"
            self.unbounded = f"no bound can be given: {name} is {100.0 * of_images:.0f} % of an alarm"
            return None
        # by vision alone the motion's statistics tell of the odometry, which does not count
        worst = max(of_motion if trusted else VISION_ALONE, of_images, known(CAMERA, 0.0))
        wider = PROTECTION_SIGMAS * (1.0 + EXCESS * max(worst - CONSISTENT, 0.0))
        (xx, xy), (_, yy) = covariance[:2, :2].tolist()
        major2 = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
        offset_m, turn = self.offsets.bound
        unseen = history.between(self._seen_ns, stamp_ns).pose if self._seen_ns < stamp_ns else NOWHERE
        unseen_m = math.hypot(unseen.x, unseen.y)
        position_m = math.hypot(wider * math.sqrt(major2), offset_m) + PROTECTION_M
        heading_rad = wider * math.sqrt(covariance[2, 2]) + PROTECTION_RAD + turn
        first = self._is_askew and len(self._shares) == 1
        if position_m > (FIRST_ALERT_M if first else ALERT_M) or heading_rad > ALERT_RAD:
            self.unbounded = f"the pose may be off by {position_m:.1f} m, {math.degrees(heading_rad):.0f}°"
            return None
        doubt = max(of_motion - DOUBTED, 0.0) if trusted else 0.0
        halted_m = self._halted(stamp_ns, history)
        unseen_m += halted_m
        position_m += UNSEEN_RATIO * (1.0 + EXCESS * doubt) * unseen_m
        turns_proved = self._turns_proved
        if unseen.heading:
            apart = history.gyro_apart_rad(self._seen_ns, stamp_ns)
            heading_rad += _unseen_rad(unseen.heading, apart)
            # proved until a gyro denies the turn that images have not refuted
            turns_proved &= not apart > DENIED_RAD + DENIED_RATIO * abs(unseen.heading) or self.relation.refutes_gyro
        alert_m = ALERT_M if doubt or halted_m else math.inf
        if not self._moves_proved and self.relation.contradicts:  # an odometry may have been wrong from the start
            alert_m = ALERT_UNPROVED_M
        if (unseen_m > UNSEEN_M and position_m > alert_m) or (heading_rad > ALERT_RAD and not turns_proved):
            turn = math.degrees(abs(unseen.heading))
            self.unbounded = f"unseen for {unseen_m:.1f} m and {turn:.0f}°, the odometry alone tells the pose"
            return None
        return position_m, heading_rad

    def _halted(self, stamp_ns: int, history: MotionHistory) -> float:
        """The way (m) since the last image that showed something on which the odometry may have failed: it halted."""
        halt = halt_of(history.odometry.samples)
        if halt is None:
            self._halt_m_s = 0.0
        elif not math.isnan(halt.speed):
            self._halt_m_s = halt.speed
        if self._seen_ns >= stamp_ns:
            self._halted_m = 0.0
        elif halt is not None:  # one that goes on again has not come back by itself
            way_m = 1e-9 * (stamp_ns - max(halt.stamp_ns, self._seen_ns)) * self._halt_m_s
            self._halted_m = max(self._halted_m, way_m)
        return self._halted_m

    def excuse(self) -> None:
        """What explains everything is corrected: begin anew."""
        self.relation.reset()
        self.offsets.reset()
        self.verdict, self.lag_s = ALL_WELL, 0.0

    def update(
        self, stamp_ns: int, image: Image, bank: Bank, history: MotionHistory, late_s: float, jump: Jump
    ) -> Verdict:
        """Take an image that shows something, after the bank has. late_s: how late it is believed to be stamped."""
        best = bank.best
        if best is None or best.fit is None:
            return self.verdict
        if not bank.trust.free_fit:
            self._take_jump(stamp_ns, len(image.seen.raw_m) > 0, best, history, jump)
        if best.explained >= MIN_EXPLAINED:
            self._seen_ns = stamp_ns
        self.relation.all_round = bank.trust.free_fit
        last = self.motion.last
        if last is not None and not last.begun:
            self._velocity = self._velocity_since(last, stamp_ns, history)
        due = last is None or stamp_ns - last.stamp_ns >= 1e9 * STEP_S
        if due and not image.seen.is_one_thing:  # which tells no motion
            knowing = bank.knowing
            spread = knowing.error_covariance + bank.statistics.per_image
            camera = Camera(knowing.errors, spread, bank.trust.free_fit)
            sighting = self.motion.update(stamp_ns, image, camera, best.fit, jump.elsewhere)
            if sighting.learned and not self.relation.clock_s:  # the images before were seen by an unknown camera
                self.relation.reset()
                self._moves_proved = self._turns_proved = False
                if self.offsets.doubt:
                    self.offsets.reset()
            self.relation.update(sighting, history, late_s, jump.elsewhere, bank.steps)
            if self.verdict.odometry:
                self.offsets.update(sighting, history, bank.steps, late_s)
            else:  # what a wrong odometry told of the camera says nothing
                self.offsets.blind(self._velocity)
        self.arrivals.update(stamp_ns, history.odometry.samples)
        self.offsets.arrive(self.arrivals, history.odometry.samples, self._clock_lag(late_s))
        self._confirm(jump, len(history.odometry.samples) > 0, bank.trust.free_fit, best)
        self._take_proof(stamp_ns, best, jump, len(history.odometry.samples) > 0)
        self._take_share(image, bank)
        self._take_coverage(stamp_ns, image, bank, jump)
        off_m = math.inf if jump.predicted is None else best.filter.pose.distance_to(jump.predicted)
        self._since_jump = 0 if off_m > JUMP_M and bank.trust.free_fit else self._since_jump + 1
        variances = best.filter.initial.errors.diagonal().tolist()
        self._is_askew = not self.relation.all_round and max(variances[:2], default=0.0) > ASKEW_RAD**2
        # plain floats: NumPy takes longer for five
        errors = zip(best.filter.errors.tolist(), variances, bank.statistics.errors.seeming, strict=True)
        self._error_z = max(
            [abs(error) / math.sqrt(max(of + more**2, 1e-12)) for error, of, more in errors], default=0.0
        )
        (x, y, _), (reach_x, reach_y) = best.filter.pose, self._reach_m
        self._outside_m = max(max(abs(x) - reach_x, abs(y) - reach_y) + OUTSIDE_M, 0.0)
        self._take_repetition(stamp_ns, image, last, history)
        self._judge()
        self._take_probation(stamp_ns, jump)
        if self.lag_s and self.relation.refutes_lag(self.lag_s):
            self.lag_s = 0.0
        if jump.predicted is not None and self.verdict is ALL_WELL:
            pose, predicted = best.filter.pose, jump.predicted
            if not self.suspect_mirror(stamp_ns, pose, predicted) and pose.distance_to(predicted) > MIN_LAG_M:
                self._take_lag(pose, predicted)
        return self.verdict

    def _velocity_since(self, last: Sighting, stamp_ns: int, history: MotionHistory) -> Velocity:
        """Since a sighting: two images of a sector are too noisy to tell it."""
        seconds = 1e-9 * (stamp_ns - last.stamp_ns)
        if self.relation.all_round or not self.verdict.odometry or not seconds or not len(history.odometry.samples):
            return self.motion.velocity
        x, y, turn = history.between(last.stamp_ns, stamp_ns).pose
        return x / seconds, y / seconds, turn / seconds

    def _confirm(self, jump: Jump, moves: bool, all_round: bool, best: Member) -> None:
        """A pose that was given holds where the image agrees; one that contradicts it by far is to be shown by turns,
        too: a robot that drives ahead looks the same in mirrored images. One found in the own half by the few things
        that a sector shows holds where the next images agree. moves: whether there is an odometry.
        """
        if self._own_half and not all_round:
            good = not jump.elsewhere and best.explained >= GOOD
            self._good_images = self._good_images + 1 if good else 0
            self.confirmed = not jump.elsewhere and (self.confirmed or self._good_images >= GOOD_IMAGES)
        elif jump.elsewhere and jump.predicted is not None and not self._proved and self._prior_given:
            self.confirmed = False
            self._contradicted |= not _is_near(best.filter.pose, jump.predicted)
        self._given &= not jump.elsewhere
        if jump.elsewhere and not self._proved:  # what a wrong start explained says nothing of the pose that was found
            self._shares, self._shares_of_points, self._deficit = [], [], 0.0
        self._moves_proved = self._moves_proved or self.relation.confirms
        self._turns_proved = self._turns_proved or (self.relation.turns and self.relation.confirms)
        self._proved = self._proved or (self.relation.confirms and (self.relation.turns or not self._contradicted))
        self.confirmed = self.confirmed or self._proved or not moves

    def suspect_mirror(self, stamp_ns: int, pose: Pose, predicted: Pose) -> bool:
        """Whether a pose has jumped to just where mirrored images would put it; they are distrusted then."""
        if _is_near(pose, predicted):
            return False
        x, y, heading = predicted
        for at in (Pose(x, -y, -heading), Pose(-x, y, math.pi - heading)):
            if pose.distance_to(at) < MIRRORED_M and abs(wrap_angle(pose.heading - at.heading)) < MIRRORED_RAD:
                self.verdict = Verdict(False, True, SIDES_EXCHANGED, since_ns=stamp_ns)
                self.relation.suspect(MIRRORED, 0.0)
                return True
        return False

    def _take_jump(self, stamp_ns: int, marked: bool, best: Member, history: MotionHistory, jump: Jump) -> None:
        """Of a sector: where its pose jumps, and no shove has turned the robot, its lines may be bars, nets or cables,
        which move as a field would, but hardly cross. marked: whether crossings or landmarks are seen.
        """
        self._sees_marks |= marked
        if jump.predicted is not None and self._sees_marks and self._seen_ns < stamp_ns:
            pose = best.filter.pose
            off_m, turn = pose.distance_to(jump.predicted), abs(wrap_angle(pose.heading - jump.predicted.heading))
            if off_m > JUMP_M or turn > JUMP_RAD:
                apart = history.gyro_apart_rad(self._seen_ns, stamp_ns)
                self._lines_alone |= apart < UNFELT_RAD + UNFELT_RATIO * turn
        self._lines_alone &= not (marked and best.explained >= GOOD_SHARE)

    def _take_lag(self, pose: Pose, predicted: Pose) -> None:
        """A pose that jumps along its own way: so it does when the camera's clock is set."""
        velocity = self._velocity[:2]
        speed, step = math.hypot(*velocity), predicted.inverse().compose(pose)
        if speed < MIN_SPEED_M_S:
            return
        along = (step.x * velocity[0] + step.y * velocity[1]) / speed
        aside = abs(step.y * velocity[0] - step.x * velocity[1]) / speed
        if aside < LAG_ASIDE_M + LAG_ASIDE_RATIO * abs(along) and abs(along) < LAGS_S[-1] * speed:
            self.lag_s = -along / speed

    def _take_proof(self, stamp_ns: int, best: Member, jump: Jump, moves: bool) -> None:
        """With a mirror, whose lines show all round, and an odometry that is trusted."""
        motion = self.relation.worst
        followed = self.relation.all_round and moves and self.verdict.odometry and not jump.elsewhere and motion < 1.0
        seconds = 1e-9 * (stamp_ns - self._before_ns)
        self._proof.update(best.filter.pose, jump.predicted if followed else None, seconds)
        self._knows_field = self._proof.given and motion < SETTLED

    def _take_share(self, image: Image, bank: Bank) -> None:
        best = bank.best
        assert best is not None
        assert best.fit is not None
        if image.seen.is_one_thing:
            return
        trust = bank.trust.of(image.seen.crude)
        of_points = trust.share(best.explained)
        if self._knows_field and bank.share < GOOD_SHARE and self._shows_lines(image, best):
            of_points = trust.share(bank.share)
            bank.excuse(BESIDES)
        explained = trust.share(bank.share)
        self._shares = [*self._shares[-SHARE_MEMORY + 1 :], explained]
        self._shares_of_points = [*self._shares_of_points[-SHARE_MEMORY + 1 :], of_points]
        self._deficit = min(max(self._deficit + USUAL_SHARE - explained, 0.0), 1.1 * MAX_DEFICIT)
        self._since_chance += 1
        if self._since_chance < CHANCE_EVERY or len(image.seen.positions_m) < 10:
            return
        self._since_chance = 0
        upright = placed_points(image.seen.positions_m, best.filter.errors, image.response)
        turns = _GOLDEN * np.arange(len(upright))
        cosine, sine = np.cos(turns), np.sin(turns)
        x, y = upright.T
        scattered = np.empty_like(upright)
        scattered[:, 0], scattered[:, 1] = cosine * x - sine * y, sine * x + cosine * y
        fit = self._registration.fit(scattered, image.seen.covariances_m2, best.fit.state[:3].copy(), _NO_STEPS)
        self._chance += 0.3 * (min(fit.explained, 0.9) - self._chance)

    def _shows_lines(self, image: Image, best: Member) -> bool:
        """Whether points lie on most of the near lines."""
        assert best.fit is not None
        upright = placed_points(image.seen.positions_m, best.fit.state[3:], image.response)
        pose = best.fit.state[:3].copy()
        on_line, _, _ = on_lines(upright, image.seen.covariances_m2, pose, self._registration.table)
        return self._proof.shows(seen_ratio(self._field.line_tables, upright[on_line], pose, SHOWN_M))

    def _take_coverage(self, stamp_ns: int, image: Image, bank: Bank, jump: Jump) -> None:
        best = bank.best
        if best is None or best.fit is None or not bank.trust.free_fit or len(image.seen.raw_m):
            return
        self._jumps = max(self._jumps - JUMPS_PER_S * 1e-9 * (stamp_ns - self._jumped_ns), 0.0)
        self._jumped_ns = stamp_ns
        if jump.elsewhere:
            self._jumps = min(self._jumps + (self._held_up and jump.predicted is not None), 2.0 * MAX_JUMPS)
            self._held_up = False
        well = self.is_settled and bank.probabilities[0] > LIKELY and self.is_believed
        if self._coverage.begins_image(jump.elsewhere, well):
            upright = placed_points(image.seen.positions_m, best.filter.errors, image.response)
            self._coverage.update(self._field.line_tables, upright, best.fit.state[:3])
        self._held_up |= self._coverage.shown and self.is_consistent(MIN_SHARE_JUMPED)

    def _take_probation(self, stamp_ns: int, jump: Jump) -> None:
        """Take whether an image lay on no line, and for how long the pose has been a good one: a field of another size
        fits for moments only.
        """
        seconds = min(1e-9 * (stamp_ns - self._before_ns), 1.0) if self._before_ns else 0.0
        self._before_ns = stamp_ns
        if not self.relation.all_round:
            return
        foreign = max(self.statistics["share"], self.statistics["chance"]) >= 1.0
        self._foreign_s += seconds * (foreign - FORGOTTEN_PER_S * self._foreign_s)
        good = not (foreign or jump.elsewhere) and self.share >= GOOD_SHARE
        self._good_s = self._good_s + seconds if good else 0.0

    def _clock_lag(self, late_s: float) -> float:
        """By how much images may be stamped wrongly since their clock was set (s), until the motion refutes that."""
        if self.arrivals.change_s:
            self.relation.set_clock(self.arrivals.change_s)
        lag_s = self.relation.clock_s
        if abs(lag_s - late_s) < CLOCK_S:
            return 0.0
        if lag_s and self.relation.refutes_clock:
            self.relation.clock_s = 0.0
        return abs(self.relation.clock_s) + CLOCK_S * (self.relation.clock_s != 0.0)

    def _take_repetition(self, stamp_ns: int, image: Image, last: Sighting | None, history: MotionHistory) -> None:
        """Whether the same points are seen, to the bit, while the odometry moves."""
        points = image.seen.positions_m.tobytes()
        if points != self._points or last is None or not points:
            self._points, self._same_since_ns, self._repeated_s = points, stamp_ns, 0.0
            return
        moved = history.between(self._same_since_ns, stamp_ns).pose
        if math.hypot(moved.x, moved.y) + abs(moved.heading) > 0.02:
            self._repeated_s = 1e-9 * (stamp_ns - self._same_since_ns)

    def _judge(self) -> None:
        """Any statistic raises an alarm; it ends when all have come down and the robot has shown so by moving."""
        over = self.verdict.problem is not None and self.relation.agrees
        in_motion = self.relation.worst >= 1.0
        if over and in_motion and not self.relation.all_round:  # a mirror's window is over within seconds
            self.relation.forget_fault()
        statistics = self.statistics = self._measured()
        self._worst = max([value for name, value in statistics.items() if name != CAMERA])
        if self._worst >= 1.0:
            self._raise(statistics)
        elif over:
            self.verdict = ALL_WELL
            self.relation.end_alarm()

    def _raise(self, statistics: dict[str, float]) -> None:
        images = {name: statistics[name] for name in OF_IMAGES[:-1]}
        if statistics["repetition"] >= 1.0:
            sentence = f"the image has not changed for {self._repeated_s:.1f} s while the wheels turned"
            problem = Problem(ProblemCode.IMAGES_REPEAT, sentence)
            self.verdict = Verdict(False, True, problem, since_ns=self._same_since_ns)
        elif max(images.values()) >= 1.0:
            problem = self._image_problem(max(images, key=lambda one: images[one]))
            self.verdict = Verdict(False, self.verdict.odometry, problem)
        elif self.verdict.problem is None or (self.relation.is_explained and self.relation.contradicts):
            relation = self.relation
            problem = relation.blame()
            odometry, is_guess = problem.at_fault == "odometry", relation.is_guess
            self.verdict = Verdict(odometry, not odometry, problem, relation.late_s, is_guess=is_guess)

    def _image_problem(self, name: str) -> Problem:
        if name == "carpet":
            return Problem(ProblemCode.FIELD_OFF_CARPET, "the pose lies outside of the carpet")
        off = f"{100.0 * (1.0 - self.share):.0f} % of what is seen lies on no line of {self._field.name}"
        return Problem(ProblemCode.FIELD_OFF_LINES, f"{off}: clutter, another field, or camera.yaml")


def _is_near(pose: Pose, predicted: Pose) -> bool:
    """Whether a pose lies so near to the predicted one that it need not be that of mirrored images."""
    turn = abs(wrap_angle(pose.heading - predicted.heading))
    return pose.distance_to(predicted) <= 2.0 * MIRRORED_M and turn <= 2.0 * MIRRORED_RAD


def _unseen_rad(turn: float, apart: float) -> float:
    """By how much (rad) a turn that no image showed may put the heading off: the odometry's sign might be wrong, unless
    the gyro, which is so far `apart` (rad; NaN: it tells none), agrees.
    """
    return max(GYRO_RATIO * abs(turn), apart) if apart < _gyro_tolerance_rad(turn) else 2.0 * abs(turn)


def _gyro_tolerance_rad(turn: float) -> float:
    """From which difference (rad) on the gyro contradicts a turn."""
    return GYRO_RAD + GYRO_RATIO * abs(turn)
