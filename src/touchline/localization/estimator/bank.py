"""The poses that a robot may have, each followed by its own filter and weighed by what it explains.

A Gaussian sum filter (Alspach and Sorenson 1972) whose members register each image from their own predictions. The
weights are log-odds: a member that explains an image better than another gains on it, one that predicts lines where
none was seen loses. New members come from a search with the odds of a robot that was carried away; so a wrong pose is
left as soon as another place explains clearly more, and a right one stays.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from touchline.field.distances import LineTables
from touchline.geometry import FloatArray, Pose, as_pose, wrap_angle
from touchline.localization.camera_errors.base import Response, placed_points
from touchline.localization.estimator.filter import Filter
from touchline.localization.estimator.measurement import Measurement
from touchline.localization.estimator.statistics import CameraErrorStatistics
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.registration.attitudes import fit_leaning
from touchline.localization.registration.covariance import ANYWHERE
from touchline.localization.registration.joint import Seen, StateFit, StatePrior
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.line_share import share_at
from touchline.localization.registration.registration import SHAKEN, Registration
from touchline.localization.registration.unseen import UNSEEN, unseen, view_of
from touchline.localization.search.pose_search import Mode
from touchline.motion.delayed import Delayed
from touchline.types import Evidence, Frame

CARRIED_AWAY = -8.0  # logarithm of the odds that the robot was moved unfelt, in an image that makes one search
CARRIED_BLIND = -3.0  # the same after seconds in which nothing was seen: it may have fallen
SHOVE = -5.0  # and that it was shoved since the last image, against the odometry being right: every twenty seconds
SHOVE_ON = -1.0  # the same in the image after one: a shove lasts longer than a tenth of a second
MAX_SHOVE_M, MAX_SHOVE_RAD = 0.6, 0.8  # how far a shove moves and turns the robot
SHOVED = np.diag(np.square([0.15, 0.15, 0.12]))  # covariance of what one does
SHOVE_BELOW = 0.7  # share explained below which a shove is tried though the prediction is met
MAX_LOG_ODDS_BEHIND = 10.0  # of a member behind the best: one further behind is dropped
MAX_MEMBERS = 12
REPEATED_IMAGES = 10.0  # over which the evidence of others repeats itself
MAX_MEASURED_GAIN = 4.0  # largest log-odds that a further measurement takes from a member
SAME_M, SAME_RAD = 0.25, 0.12  # members nearer than this are one
SPARSE = 5.0  # points that alone show a direction, whose information counts half
FEATURE_POINTS = 20.0  # as so many points a crossing or a landmark shows where it is
PLAIN = 0.9  # share explained from which a pose that was predicted is not doubted: a closer look tells nothing
MIN_EXPLAINED = 0.4  # share of what is seen that a pose has to explain to be corrected by it
CONTESTED = 0.15  # share by which another pose explains more of an image from which the likeliest one is in doubt
START_STEP = 1.2  # standard deviations from a given pose to the starts about it
# deviations of a prediction between which lines that are alike may be mixed up: other starts, so far apart, are tried
MIN_WIDE_M, MAX_WIDE_M, STARTS_M, MAX_STARTS = 0.1, 1.0, 0.3, 4
ALLOWED = 16.3  # squared Mahalanobis distance within which 99.9 % of right poses are


@dataclass(eq=False, slots=True)
class Member:
    """A pose hypothesis: its filter, log-odds, and the last image's fit with the prior that it was given.

    log_evidence: of that image. shoved: whether the robot was, as far as it knows, since the image before. images: so
    many have been explained by it since it was found.
    """

    filter: Filter
    log_odds: float
    images: int = 0
    fit: StateFit | None = None
    expected: StatePrior | None = None
    log_evidence: float = 0.0
    shoved: bool = False

    @property
    def explained(self) -> float:
        """Share of what the last image showed that lies where it should."""
        return 0.0 if self.fit is None else self.fit.explained


@dataclass(eq=False, slots=True)
class Image:
    """What one image shows to the bank. stamp_shift (3,): standard deviation by which its pose is off, robot frame.
    has_lines: whether its line points are laid on lines of which the ends were seen.
    """

    seen: Seen
    response: Response
    stamp_shift: FloatArray | None = None
    has_lines: bool = False


class Jump(NamedTuple):
    """How far an image by itself lies from a prediction: step (3,), its squared Mahalanobis distance, and how much more
    of its line points the pose explains that they have alone, in logarithm of a likelihood ratio.
    """

    step: FloatArray | tuple[float, float, float]
    distance2: float
    gain: float


class ShoveTest:
    """Whether a robot may have been shoved since the last image: an image that a looser prediction explains better."""

    def __init__(self, gate: float) -> None:
        """gate: squared Mahalanobis distance of an image from the prediction beyond which a shove is tried."""
        self.gate = gate

    def apply(self, one: Member, jump: Jump, fitted: Callable[[Filter, FloatArray, Plan], Member]) -> None:
        """Let a member have been shoved, if its image is explained better so. fitted: what a filter makes of it."""
        odds = SHOVE_ON if one.shoved else SHOVE
        one.shoved = False
        if jump.distance2 <= self.gate and jump.gain <= -odds and one.explained >= SHOVE_BELOW:
            return
        predicted, loose = one.filter.pose.as_array(), one.filter.loosened(SHOVED)
        tried = [fitted(loose, predicted + step, SHAKEN) for step in (jump.step, np.zeros(3))]
        near = [
            each for each in tried if each.fit is not None and could_be_shove(as_pose(each.fit.state), one.filter.pose)
        ]
        best = max(near, key=lambda each: each.log_evidence, default=None)
        if best is not None and best.log_evidence + odds > one.log_evidence:
            one.filter, one.fit, one.expected, one.shoved = loose, best.fit, best.expected, True
            one.log_evidence = best.log_evidence + odds


class Bank:
    """`members`, the likeliest first; `share`: of the last image, that the likeliest explains (`line_share`).

    start: a filter without a pose, to make new ones from. lines: of the field.
    """

    def __init__(
        self, registration: Registration, lines: LineTables, statistics: CameraErrorStatistics, start: Filter,
        steps: StepNoise, shoves: ShoveTest,
    ) -> None:  # fmt: skip
        self.registration, self._lines, self.statistics = registration, lines, statistics
        self.trust, self.start, self.steps, self.shoves = statistics.errors.trust, start, steps, shoves
        self.max_members = MAX_MEMBERS
        self.guessed = False  # the motion since the last image: there was no odometry
        self.reset()

    def reset(self, start: Filter | None = None) -> None:
        """Follow this pose alone, or none."""
        self.follow([] if start is None else [Member(start, 0.0, self.trust.confirming_images)], self.start)
        self.statistics.reset()
        self.steps.reset()

    def follow(self, members: Sequence[Member], learned: Filter) -> None:
        """Follow these, none of them confirmed. learned: what is known of odometry and camera until one is."""
        self.members: list[Member] = []
        self.confirmed, self._learned, self.share = False, learned, 0.0
        self._settle(members)

    @property
    def best(self) -> Member | None:
        """The likeliest."""
        return self.members[0] if self.members else None

    @property
    def probabilities(self) -> list[float]:
        """Of the members, their twins on a symmetric field not counted."""
        if len(self.members) == 1:
            return [1.0]
        odds = [math.exp(one.log_odds - self.members[0].log_odds) for one in self.members]
        total = sum(odds)
        return [each / total for each in odds]

    @property
    def is_confirmed(self) -> bool:
        """Whether enough images support the likeliest pose, and no other one explains more of the last."""
        best = self.best
        if best is None or best.images < self.trust.confirming_images:
            return False
        others = [one.explained for one in self.members[1:] if one.log_odds > CARRIED_AWAY + 1.0]
        return best.explained + CONTESTED >= max(others, default=0.0)

    @property
    def knowing(self) -> Filter:
        """The filter whose camera errors and odometry scales are used: a wrong pose has learned wrong ones."""
        return self.members[0].filter if self.members and self.confirmed else self._learned

    def predict(self, moved: Delayed, seconds: float) -> None:
        """Propagate every member by the odometry."""
        noise, self.guessed = self.steps.of(moved.motion), moved.motion.missing_s > 0.0
        for one in self.members:
            one.filter.predict(moved, seconds, noise)

    def measure(self, frame: Frame, measurements: Sequence[Measurement]) -> None:
        """Correct and weigh every member by further measurements, those that contradict its prediction left out."""
        for one, measurement in itertools.product(self.members, measurements):
            evidence = measurement.of(frame, one.filter.pose)
            if evidence is None:
                continue
            one.log_odds += max(evidence.log_likelihood, -MAX_MEASURED_GAIN)
            if one.filter.distance2_to(evidence) < ALLOWED:
                one.filter.correct_pose(evidence)
        if measurements:
            self._settle(self.members)

    def register(self, image: Image) -> None:
        """Fit an image from every member, whether the robot was shoved or not; what a wide prediction leaves open is
        followed, too, and what the first image of a sector does.
        """
        others: list[Member] = []
        for one in self.members:
            first = one.fit is None
            tried = [self._fitted(one.filter, image, start) for start in self._starts(one.filter, first)]
            if len(tried) > 1:
                tried.sort(key=lambda each: -each.log_evidence)
            one.fit, one.expected, one.log_evidence = tried[0].fit, tried[0].expected, tried[0].log_evidence
            if not (first and self.trust.free_fit):
                least = tried[0].log_evidence - self.trust.max_gain if first else -math.inf
                others += _elsewhere(one, [each for each in tried[1:] if each.log_evidence > least])
            jump = self._jump_of(one, image)
            self.shoves.apply(one, jump, lambda loose, start, plan: self._fitted(loose, image, start, plan))
        self.members += others
        if self.members:
            self.members.sort(key=lambda each: -(each.log_odds + each.log_evidence))

    def update(
        self, image: Image, modes: Sequence[Mode], carried: Sequence[float], evidence: Sequence[Evidence] = ()
    ) -> None:
        """Fuse the image that was registered, and weigh the members; modes: poses that a search has found in it.

        carried: logarithm of the odds, for each of them, that the robot was moved there unfelt. evidence: of others.
        """
        each = [
            (mode, odds) for mode, odds in zip(modes, carried, strict=True) if not self._is_followed(mode.pose, image)
        ]
        new = [self._found(mode, image) for mode, _ in each]
        if not self.members and not new:
            return
        if new or len(self.members) > 1:
            self._weigh(new, [odds for _, odds in each], image)
        self._fuse(image)
        self._update_from_team(evidence)
        self.share = self._share_of(self.members[0], image)

    def _weigh(self, new: Sequence[Member], carried: Sequence[float], image: Image) -> None:
        """Weigh the members and new ones, with the log-odds that the robot was moved there, by an image."""
        every, before = [*self.members, *new], max((one.log_odds for one in self.members), default=0.0)
        self._weigh_unseen(every, image)
        top = max((one.log_evidence for one in self.members), default=math.inf)
        trust = self.trust.of(image.seen.crude)
        for one, odds in zip(new, carried, strict=True):
            one.log_odds = before + odds
            one.log_evidence = min(one.log_evidence, top + trust.found_gain)
        top = max(one.log_evidence for one in every)
        for one in every:
            one.log_odds += max(one.log_evidence - top, -trust.max_gain)
        self.members = sorted(every, key=lambda each: -each.log_odds)  # those that come together are one after that

    def excuse(self, ratio: float) -> None:
        """What the likeliest pose does not explain counts as so much: it is clutter."""
        self.share = 1.0 - ratio * (1.0 - self.share)

    def swap_ends(self) -> None:
        """Every member stands at the other end of a symmetric field."""
        for one in self.members:
            one.filter = one.filter.mirrored()

    def take_delay(self, delay_s: float, deviation_s: float) -> None:
        """Take a stamp delay that another measurement than the odometry has given."""
        for one in (self.start, self._learned, *(member.filter for member in self.members)):
            one.take_delay(delay_s, deviation_s)

    def upright(self, image: Image) -> FloatArray:
        """Line points (N, 2) without the camera's errors that are known (robot frame, m)."""
        return placed_points(image.seen.positions_m, self.knowing.errors, image.response)

    def _starts(self, one: Filter, first: bool) -> list[FloatArray | None]:
        """The prediction (None); without odometry others along the way that the robot may have gone; of a given pose,
        off by some decimetres and degrees, starts all about it.
        """
        if not first:
            steps = _steps_along(one.covariance) if self.guessed else ()
            return [None, *(one.pose.as_array() + step for step in steps)]
        pose, deviations = one.pose.as_array(), START_STEP * np.sqrt(np.diag(one.covariance))
        if deviations.max() > 1.0:
            return [None]
        return [pose + deviations * step for step in itertools.product((0.0, -1.0, 1.0), repeat=3)]

    def _fitted(self, one: Filter, image: Image, start: FloatArray | None, plan: Plan | None = None) -> Member:
        """What a filter makes of an image, registered from a pose (3,); None: from its prediction. plan: None: as
        widely as it is unsure.

        Where that explains too little, other attitudes of the camera are tried.
        """
        shift = self._shift_of(one, image)
        expected = one.prior(self.statistics.per_image, shift)
        state = expected.mean
        if start is not None:
            state = np.concatenate((start, one.errors))
            state[2] = expected.mean[2] + wrap_angle(float(state[2] - expected.mean[2]))
        wide = self.statistics.plan_of(one) if plan is None else plan
        fit = fit_leaning(self.registration, image.seen, state, expected, wide, image.response)
        log_evidence = fit.log_likelihood - fit.contradiction
        fit = downweight_sparse_direction(fit, len(image.seen.positions_m) + FEATURE_POINTS * len(image.seen.raw_m))
        fit = fit if shift is None else inflate_along_motion(fit, shift)
        return Member(one, 0.0, 0, fit, expected, log_evidence)

    def _jump_of(self, one: Member, image: Image) -> Jump:
        """How far the image that a member was fitted to lies from its prediction."""
        assert one.fit is not None
        step, distance2 = one.filter.innovation(one.fit, self.statistics.per_image)
        seen, plain = image.seen, one.explained >= PLAIN and distance2 <= self.shoves.gate and not self.guessed
        if plain or not self.trust.free_fit or len(seen.raw_m) or not len(seen.positions_m):
            return Jump(step, distance2, 0.0)
        predicted = one.filter.pose.as_array()
        pose, log_likelihood = self.registration.fit_placed(seen, one.filter.errors, image.response, predicted)
        gain = float(np.add.reduce(seen.shares)) / len(seen.shares) * log_likelihood - one.fit.log_likelihood
        return Jump(pose - predicted if gain > 0.0 else step, distance2, gain)

    def _shift_of(self, one: Filter, image: Image) -> FloatArray | None:
        """(3,) in the field frame, at a filter's heading."""
        if image.stamp_shift is None:
            return None
        x, y, turn = image.stamp_shift.tolist()
        cosine, sine = math.cos(one.pose.heading), math.sin(one.pose.heading)
        return np.array([cosine * x - sine * y, sine * x + cosine * y, turn])

    def _is_followed(self, pose: Pose, image: Image) -> bool:
        """Whether a pose is where a member was fitted; those whose prediction allows it are fitted from there, too."""
        start, followed = pose.as_array(), False
        for one in self.members:
            off = start - one.filter.pose.as_array()
            off[2] = wrap_angle(float(off[2]))
            if float(off @ np.linalg.solve(one.filter.covariance, off)) < ALLOWED:
                other = self._fitted(one.filter, image, start)
                if other.log_evidence > one.log_evidence:
                    one.fit, one.expected, one.log_evidence = other.fit, other.expected, other.log_evidence
            followed |= one.fit is not None and is_same(pose, as_pose(one.fit.state))
        return followed

    def _found(self, mode: Mode, image: Image) -> Member:
        """A new member at a pose that a search has found."""
        return self._fitted(self.knowing.placed(mode.pose, ANYWHERE), image, mode.pose.as_array())

    def _weigh_unseen(self, members: Sequence[Member], image: Image) -> None:
        """Lines that members predict in view and that were not seen count against them; only differences count."""
        if self.trust.unseen == 0.0 or len(members) < 2 or not len(image.seen.positions_m):
            return
        poses = np.array([one.filter.pose.as_array() if one.fit is None else one.fit.state[:3] for one in members])
        counts = unseen(self._lines, view_of(self.upright(image)), poses)
        for one, count in zip(members, counts.tolist(), strict=True):
            one.log_evidence -= self.trust.unseen * UNSEEN * count

    def _fuse(self, image: Image) -> None:
        """Correct every member by its fit; learn from the likeliest."""
        per_image = self.statistics.per_image
        for one in self.members:
            fit = one.fit
            if fit is None or one.explained < MIN_EXPLAINED:
                continue
            if one is self.members[0] and one.expected is not None:
                self.steps.learn(one.filter, fit, per_image)
            one.filter.correct(fit, per_image)
            one.images += 1
        best = self.members[0]
        if best.fit is not None and best.expected is not None and best.explained >= MIN_EXPLAINED:
            self.statistics.learn(best.fit, best.expected, image.seen)
        self._settle(self.members)

    def _share_of(self, best: Member, image: Image) -> float:
        """What registration explains; of line points more, where what it does not explain are things, no lines."""
        seen, fit = image.seen, best.fit
        if fit is None or best.explained >= PLAIN or seen.crude or image.has_lines or len(seen.raw_m):
            return best.explained
        table = self.registration.table
        return max(best.explained, share_at(seen.positions_m, seen.covariances_m2, fit.state, image.response, table))

    def _update_from_team(self, evidence: Sequence[Evidence]) -> None:
        """Weigh the members by the evidence of others, a pose and its twin alike; all who are unknown count as one."""
        if not evidence:
            return
        for one in self.members:
            ends = (one.filter.pose, one.filter.pose.mirrored())
            each = [(max(said.log_likelihood(end) for end in ends), said.known) for said in evidence]
            unknown = [gain for gain, known in each if not known]
            gain = sum(gain for gain, known in each if known) + (sum(unknown) / len(unknown) if unknown else 0.0)
            one.log_odds += gain / REPEATED_IMAGES
        self._settle(self.members)

    def _settle(self, members: Iterable[Member]) -> None:
        """The likeliest, those that have come together taken for one. The log-odds of the first are 0 then."""
        kept: list[Member] = []
        for one in sorted(members, key=lambda each: -each.log_odds):
            hopeless = bool(kept) and one.log_odds < kept[0].log_odds - MAX_LOG_ODDS_BEHIND
            followed = any(is_same(one.filter.pose, other.filter.pose) for other in kept)
            if len(kept) < self.max_members and not hopeless and not followed:
                kept.append(one)
        top = kept[0].log_odds if kept else 0.0
        for one in kept:
            one.log_odds -= top
        self.members = kept


def _elsewhere(one: Member, tried: Sequence[Member]) -> list[Member]:
    """Copies of a member at the other places (the likeliest first) to which its image fits, too."""
    found: list[Member] = []
    if not tried:  # nearly always
        return found
    poses = [as_pose(each.fit.state) for each in (one, *tried) if each.fit is not None]
    for k, each in enumerate(tried, 1):
        if not any(is_same(poses[k], pose) for pose in poses[:k]):
            copy = one.filter.loosened(np.zeros((3, 3)))
            found.append(Member(copy, one.log_odds, one.images, each.fit, each.expected, each.log_evidence))
    return found


def _steps_along(covariance: FloatArray) -> list[FloatArray]:
    """Steps (3,) to other starts of a registration, along the direction in which a prediction is unsure by more than
    registration reaches.
    """
    (xx, xy), (_, yy) = covariance[:2, :2].tolist()
    deviation = math.sqrt(0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy))
    if not MIN_WIDE_M < deviation < MAX_WIDE_M:
        return []
    count = min(math.ceil(3.0 * deviation / STARTS_M), MAX_STARTS)
    turned = 0.5 * math.atan2(2.0 * xy, xx - yy)
    step = STARTS_M * np.array([math.cos(turned), math.sin(turned), 0.0])
    return [many * step for many in range(-count, count + 1) if many]


def could_be_shove(found: Pose, predicted: Pose) -> bool:
    """Whether a robot may have been shoved from one to the other: points may slide farther along a lone line."""
    turn = abs(wrap_angle(found.heading - predicted.heading))
    return found.distance_to(predicted) < MAX_SHOVE_M and turn < MAX_SHOVE_RAD


def is_same(one: Pose, other: Pose) -> bool:
    """Whether two poses are one hypothesis."""
    return one.distance_to(other) < SAME_M and abs(wrap_angle(one.heading - other.heading)) < SAME_RAD


def downweight_sparse_direction(fit: StateFit, count: float) -> StateFit:
    """A fit of so many points with less information along the direction that only few of them show: those may be none
    of the line's, and of the next image's, too. All other information stays.
    """
    information = fit.information
    (xx, xy), (_, yy) = information[:2, :2].tolist()
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    few = count * fit.explained * max(middle - half, 0.0) / max(middle + half, 1e-9)  # if all show the other direction
    if few > 10.0 * SPARSE or middle - half < 1e-9:
        return fit
    turned = 0.5 * math.atan2(2.0 * xy, xx - yy)
    measured = information[:, 1] * math.cos(turned) - information[:, 0] * math.sin(turned)
    less = SPARSE**2 / (few**2 + SPARSE**2) / (middle - half) * measured
    pull = float(fit.gradient[1]) * math.cos(turned) - float(fit.gradient[0]) * math.sin(turned)
    return fit._replace(information=information - np.outer(less, measured), gradient=fit.gradient - less * pull)


def inflate_along_motion(fit: StateFit, shift: FloatArray) -> StateFit:
    """A fit with less information along the way (3,) by which the image was taken earlier or later than stamped."""
    measured = fit.information[:, :3] @ shift
    less = measured / (1.0 + float(measured[:3] @ shift))
    pull = float(fit.gradient[:3] @ shift)
    return fit._replace(information=fit.information - np.outer(less, measured), gradient=fit.gradient - less * pull)
