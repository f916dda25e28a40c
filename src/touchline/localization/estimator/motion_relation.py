"""Whether images and odometry tell the same motion; if not, the one fault that would explain both.

Over a window of some seconds each step of the robot is compared as the images alone tell it (`VisualMotion`) with what
the odometry tells. Half the squared Mahalanobis distance of the two, bounded, is a step's cost. A few explanations (a
wrong sign, another scale, turned or mirrored images, a lag) change the odometry's steps; one that saves far more cost
than it costs by its freedom is named (a generalised likelihood ratio: Willsky and Jones 1976).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.estimator.visual_motion import Sighting
from touchline.matrices import copy_row, inverse, times
from touchline.motion import MotionHistory
from touchline.motion.odometry import step_to
from touchline.motion.samples import interpolate
from touchline.types import Problem, ProblemCode

WINDOW = 32  # steps: three seconds
STEP_S, MAX_STEP_S = 0.09, 0.5  # time between the images of a step
STEP_M, STEP_RAD = 0.12, 0.12  # way or turn that makes one
MAX_WAIT_S = 1.0  # for the odometry of a step
SIGMA_M, SIGMA_RAD, SIGMA_RATIO, BEND_RAD_M = 0.02, 0.01, 0.06, 0.02  # by how much steps differ though all is well
MAX_COST = 9.0  # of one step, as in a shove
USUAL_COST = 0.75  # of a step, above which costs add up to an alarm
MAX_SUM, MAX_MEAN, MAX_GAIN = 40.0, 2.0, 30.0  # of such costs; of the window's; of an explanation, from where it counts
SUFFIXES = (6, 12, WINDOW)  # newest steps over which an explanation is tried: a fault begins within the window
SPINNING = Problem(ProblemCode.IMAGES_SPIN, "images turn while the robot does not")
_STILL = 0.002  # largest step (m + rad) of an odometry that stands still
MAX_LEFT = 1.0  # mean cost that a named explanation leaves
LAGS_S = np.arange(-0.6, 0.601, 0.05)
_LAGS_NS = np.rint(1e9 * LAGS_S).astype(np.int64)
NAMED_GAIN = 8.0  # from which an explanation is named
REFUTING_LOSS = 20.0  # cost by which a delay that is corrected is refuted
REFUTED = 8.0  # cost that the fault of an alarm would have by now, from which it is over
OUTLIER_COST = 3.0  # of a step that waits: one in nine does where all is Gaussian, and only waits
CLEARLY = 4.0  # gain by which the odometry's fault must explain more than one of the images
FREEDOM = 4.0  # cost of a parameter that is fitted
FREE_TURN = 0.5  # mean cost of a step's turn, for an explanation that takes it as the images have it
ARRIVED = 10.0  # log-odds for a lag by which images come otherwise than before
BACKWARDS = 10.0  # log-odds against images in which a camera that shows what lies ahead would look back
CONFIRMING = 3  # steps that confirm a pose
WORTH = 15.0  # cost of a window in which there is anything to explain
AGREEING = 10  # newest steps that must agree after an alarm
ON_WHEELS = StepNoise(walks=False)
STATISTICS = "motion", "motion of late", "explanation"  # names
TELLING_M, TELLING_RAD = 0.3, 0.3  # way and turns from which steps that agree show that all is well


SIDES_EXCHANGED = Problem(ProblemCode.IMAGES_MIRRORED, "images are mirrored: left and right are exchanged")
# multipliers of the odometry's (ahead, aside, turn) that make it what the images show
SIGNS = {
    (1, 1, -1): Problem(ProblemCode.ODOMETRY_TURN_SIGN, "odometry turns the wrong way: its theta has the wrong sign"),
    (-1, 1, 1): Problem(ProblemCode.ODOMETRY_X_SIGN, "odometry drives backwards: its x has the wrong sign"),
    (1, -1, 1): Problem(ProblemCode.ODOMETRY_Y_SIGN, "odometry drives to the wrong side: its y has the wrong sign"),
    (-1, -1, 1): Problem(
        ProblemCode.ODOMETRY_WAY_SIGN, "odometry drives the wrong way: its x and y have the wrong sign"
    ),
    (-1, -1, -1): Problem(
        ProblemCode.ODOMETRY_ALL_SIGNS, "odometry moves the wrong way: x, y and theta have the wrong sign"
    ),
    (1, -1, -1): SIDES_EXCHANGED,
    (-1, 1, -1): Problem(ProblemCode.IMAGES_MIRRORED, "images are mirrored: ahead and behind are exchanged"),
}
_MULTIPLIERS, _SUFFIXES = np.array(list(SIGNS), dtype=np.float64), np.array(SUFFIXES)
SCALE, TURN_SCALE, ROTATION, DRIFT, STILL_ODOMETRY, STILL_IMAGES, PANNED, GYRO, FIRST_LAG = range(
    len(SIGNS), len(SIGNS) + 9
)
MIRRORED, BACK_TO_FRONT = (list(SIGNS).index(signs) for signs in ((1, -1, -1), (-1, 1, -1)))
_FITTED = 5  # of these, from SCALE on, have a parameter
_BY_IMAGES = np.array(
    [one.at_fault == "images" for one in SIGNS.values()] + [False, False, True, False, False, True, True]
)


@njit(cache=True, error_model="numpy")
def _cost(seen, driven, weights, i):  # type: ignore[no-untyped-def]
    """Half the squared Mahalanobis distance of step i from a step driven (3,), bounded; NaN is no cost."""
    x, y, turn = seen[i, 0] - driven[0], seen[i, 1] - driven[1], seen[i, 2] - driven[2]
    turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
    w = weights[i]
    half = 0.5 * (w[0, 0] * x * x + w[1, 1] * y * y + w[2, 2] * turn * turn)
    half += w[0, 1] * x * y + w[0, 2] * x * turn + w[1, 2] * y * turn
    return min(half, MAX_COST) if half == half else 0.0


@njit(cache=True, error_model="numpy")
def _change(step, seen, gyro, signs, e, value):  # type: ignore[no-untyped-def]
    """The odometry's step (3,), in place, as explanation e with its parameter changes it, but for lags."""
    fitted = e - signs.shape[0]
    if fitted < 0:
        for k in range(3):
            step[k] *= signs[e, k]
    elif fitted == 0:
        step[0] *= value
        step[1] *= value
    elif fitted == 1:
        step[2] *= value
    elif fitted == 2:
        cosine, sine = math.cos(value), math.sin(value)
        step[0], step[1] = cosine * step[0] - sine * step[1], sine * step[0] + cosine * step[1]
    elif fitted == 3:
        step[2] += value
    elif fitted == 4 and value < _STILL:
        copy_row(seen, step)  # odometry that stands still tells nothing
    elif fitted == 5:
        step[0] = step[1] = step[2] = 0.0
    elif fitted == 6:
        step[2] = seen[2]
    elif fitted == 7:
        step[2] = gyro


@njit(cache=True, error_model="numpy")
def _parameters(seen, driven, count):  # type: ignore[no-untyped-def]
    """(count,) of the explanations after the signs, over some steps."""
    dot = cross = square = turns = turned2 = moved = 0.0
    for i in range(seen.shape[0]):
        dot += seen[i, 0] * driven[i, 0] + seen[i, 1] * driven[i, 1]
        cross += driven[i, 0] * seen[i, 1] - driven[i, 1] * seen[i, 0]
        square += driven[i, 0] ** 2 + driven[i, 1] ** 2
        turns += seen[i, 2] * driven[i, 2]
        turned2 += driven[i, 2] ** 2
        moved = max(moved, abs(driven[i, 0]) + abs(driven[i, 1]) + abs(driven[i, 2]))
    values = np.zeros(count)
    values[0] = min(max(dot / max(square, 1e-9), 0.0), 3.0)
    values[1] = min(max(turns / max(turned2, 1e-9), 0.0), 3.0)
    values[2] = math.atan2(cross, dot)
    values[3] = np.median(seen[:, 2] - driven[:, 2])
    values[4] = moved
    return values


@njit(cache=True, error_model="numpy")
def saved(steps, signs, e, value, first):  # type: ignore[no-untyped-def]
    """By how much an explanation lowers the cost of the steps from the first on."""
    total, column = 0.0, e if e < signs.shape[0] else e - _FITTED
    if not signs.shape[0] <= e < signs.shape[0] + _FITTED:
        for i in range(first, steps.seen.shape[0]):
            total += steps.gains[i, column]
        return total
    step = np.zeros(3)
    for i in range(first, steps.seen.shape[0]):
        copy_row(steps.driven[i], step)
        _change(step, steps.seen[i], steps.gyro[i], signs, e, value)
        total += steps.costs[i] - _cost(steps.seen, step, steps.weights, i)
    return total


@njit(cache=True, error_model="numpy")
def gains_of(steps, signs, suffixes):  # type: ignore[no-untyped-def]
    """(E,) by how much each explanation lowers the cost of the newest steps, most of all suffixes; its parameter (E,);
    and the mean cost that it leaves (E,). steps: `_Steps`.
    """
    count, others = steps.seen.shape[0], steps.gains.shape[1] + _FITTED - signs.shape[0]
    gains = np.full(signs.shape[0] + others, -1e9)
    values, left = np.zeros(len(gains)), np.zeros(len(gains))
    for s in range(suffixes.shape[0]):
        first = max(count - suffixes[s], 0)
        if count - first < 3:
            continue
        fitted = _parameters(steps.seen[first:], steps.driven[first:], others)
        every = steps.costs[first:].sum()
        for e in range(len(gains)):
            value = fitted[e - signs.shape[0]] if e >= signs.shape[0] else 0.0
            total = saved(steps, signs, e, value, first)
            free = FREE_TURN * (count - first) if e == PANNED else 0.0
            if total - free > gains[e]:
                gains[e], values[e], left[e] = total - free, value, (every - total) / (count - first)
    return gains, values, left


class _Steps(NamedTuple):
    """N steps, robot frame before each: seen, driven (N, 3); inverse covariances (N, 3, 3) of their differences;
    turns by the gyro (N,), NaN where it tells none; costs (N,); gains (N, E): of these what each explanation without
    a fitted parameter saves, 0 where that is not known; lags_known (N,): 1 where it is, of lags;
    spans_ns (N, 2): their stamps.
    """

    seen: FloatArray
    driven: FloatArray
    weights: FloatArray
    gyro: FloatArray
    costs: FloatArray
    gains: FloatArray
    lags_known: FloatArray
    spans_ns: IntArray


@njit(cache=True, error_model="numpy")
def _compared(last, last_covariance, pose, covariance, driven):  # type: ignore[no-untyped-def]
    """The step (3,) by two images, robot frame before it, and the inverse covariance (3, 3) of its difference from what
    the odometry tells (3,).
    """
    cosine, sine = math.cos(last[2]), math.sin(last[2])
    back = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    step = pose - last
    x, y = step[0], step[1]
    step[0], step[1] = cosine * x + sine * y, cosine * y - sine * x
    step[2] -= 2.0 * math.pi * math.floor(step[2] / (2.0 * math.pi) + 0.5)
    spread = times(times(back, last_covariance + covariance), back.T)
    aside = np.array([step[1], -step[0], 0.0])
    for a in range(3):
        for b in range(3):
            spread[a, b] += last_covariance[2, 2] * aside[a] * aside[b]
    way2, turn = driven[0] * driven[0] + driven[1] * driven[1], driven[2]
    spread[0, 0] += SIGMA_M**2 + SIGMA_RATIO**2 * way2
    spread[1, 1] += SIGMA_M**2 + SIGMA_RATIO**2 * way2
    spread[2, 2] += SIGMA_RAD**2 + (SIGMA_RATIO * turn) ** 2 + BEND_RAD_M**2 * way2
    return step, inverse(spread)


@njit(cache=True, error_model="numpy")
def _driven(stamps, rows, begin_ns, end_ns):  # type: ignore[no-untyped-def]
    """(3,) the step by samples of odometry, stamps (N,), rows (N, 3), robot frame before it; none beyond their ends."""
    begin, end = np.empty(3), np.empty(3)
    interpolate(stamps, rows, begin_ns, begin)
    interpolate(stamps, rows, end_ns, end)
    return step_to(begin, end)


@njit(cache=True, error_model="numpy")
def _push(steps, signs, ends, way, span_ns, late_ns, gyro):  # type: ignore[no-untyped-def]
    """Add a step behind all others, in place; the first is forgotten. ends: poses (3,) and covariances (3, 3) by the
    images at its ends; way: stamps and rows of the odometry's samples; late_ns: by which images are corrected. Its
    costs as driven between its stamps, and as that much earlier.
    """
    driven = delayed = _driven(way[0], way[1], span_ns[0], span_ns[1])
    if late_ns:
        delayed = _driven(way[0], way[1], span_ns[0] - late_ns, span_ns[1] - late_ns)
    last = steps.costs.shape[0] - 1
    for i in range(last):
        copy_row(steps.seen[i + 1], steps.seen[i])
        copy_row(steps.driven[i + 1], steps.driven[i])
        copy_row(steps.gains[i + 1], steps.gains[i])
        copy_row(steps.spans_ns[i + 1], steps.spans_ns[i])
        for a in range(3):
            copy_row(steps.weights[i + 1, a], steps.weights[i, a])
        steps.gyro[i], steps.costs[i], steps.lags_known[i] = (
            steps.gyro[i + 1],
            steps.costs[i + 1],
            steps.lags_known[i + 1],
        )
    seen, weights = _compared(ends[0], ends[1], ends[2], ends[3], driven)
    copy_row(seen, steps.seen[last])
    copy_row(driven, steps.driven[last])
    steps.spans_ns[last, 0], steps.spans_ns[last, 1] = span_ns
    for a in range(3):
        copy_row(weights[a], steps.weights[last, a])
    raw, late = _cost(steps.seen, driven, steps.weights, last), _cost(steps.seen, delayed, steps.weights, last)
    steps.gyro[last], steps.costs[last], steps.lags_known[last] = gyro, min(raw, late), 0.0
    step, count = np.empty(3), signs.shape[0]
    for e in range(steps.gains.shape[1]):
        steps.gains[last, e] = 0.0
    for e in range(count + 3):
        copy_row(driven, step)
        _change(step, seen, gyro, signs, e if e < count else e + _FITTED, 0.0)
        if step[0] == step[0] and step[2] == step[2]:
            steps.gains[last, e] = steps.costs[last] - _cost(steps.seen, step, steps.weights, last)
    return raw, late


@njit(cache=True, error_model="numpy")
def _fill_lags(steps, begin, lags_ns, known_ns, stamps, rows):  # type: ignore[no-untyped-def]
    """What each lag saves of those steps from one on of which that is not known, by samples of odometry, stamps (N,),
    rows (N, 3); 0 where they don't reach. known_ns: before the newest step, from where all lags can be tried; later, a
    step speaks against lags alone.
    """
    first = steps.gains.shape[1] - len(lags_ns)
    for i in range(begin, len(steps.costs)):
        if steps.lags_known[i]:
            continue
        known = steps.spans_ns[-1, 1] - steps.spans_ns[i, 1] >= known_ns
        steps.lags_known[i] = known
        for k in range(len(lags_ns)):
            begin_ns, end_ns = steps.spans_ns[i, 0] - lags_ns[k], steps.spans_ns[i, 1] - lags_ns[k]
            if len(stamps) == 0 or begin_ns < stamps[0] or end_ns > stamps[-1]:
                steps.gains[i, first + k] = 0.0
                continue
            step = _driven(stamps, rows, begin_ns, end_ns)
            gain = steps.costs[i] - _cost(steps.seen, step, steps.weights, i)
            steps.gains[i, first + k] = gain if known else min(gain, 0.0)


class MotionRelation:
    """Costs of the newest steps. `mean`, `sum`: of their costs, the sum above what is usual."""

    def __init__(self) -> None:
        self.all_round = True  # whether the camera shows what lies behind the robot, too
        self.reset()

    def reset(self) -> None:
        """No step is known."""
        self._last: Sighting | None = None
        self._since_alarm = 0  # steps since the newest alarm
        self._unbroken = 0  # steps since the chain of images began
        self._held: tuple[Sighting, Sighting] | None = None  # a step that waits for the next image
        self._held_cost = 0.0
        self._count = 0  # of the steps in the window
        self._pending: list[tuple[Sighting, Sighting]] = []
        self._every = _Steps(
            np.zeros((WINDOW, 3)), np.zeros((WINDOW, 3)), np.zeros((WINDOW, 3, 3)), np.zeros(WINDOW),
            np.zeros(WINDOW), np.zeros((WINDOW, len(SIGNS) + 3 + len(LAGS_S))), np.zeros(WINDOW),
            np.zeros((WINDOW, 2), dtype=np.int64),
        )  # fmt: skip
        self.sum = self.mean = 0.0
        self.gain, self.parameter, self._best, self._left = 0.0, 0.0, -1, 0.0
        self._delay_loss = 0.0  # of late, by a delay that is corrected
        self._alarmed: tuple[int, float] | None = None  # explanation and parameter
        self._named: tuple[int, str] | None = None  # explanation, and what is at fault, until its alarm is over
        self.clock_s = 0.0  # by how much later images are stamped since they come otherwise
        self._since_clock = 0  # steps since then

    @property
    def _steps(self) -> _Steps:
        """Those that are known."""
        first = WINDOW - self._count
        return self._every if first == 0 else _Steps._make(each[first:] for each in self._every)

    @property
    def agrees(self) -> bool:
        """Whether the newest steps agree, and would not if the fault of the alarm were there still."""
        newest = self._steps.costs[-AGREEING:]
        if self._since_alarm < AGREEING or float(newest.mean()) >= USUAL_COST or not self._is_telling:
            return False
        if self._alarmed is None:
            return True
        first = max(len(self._steps.costs) - self._since_alarm, 0)
        return float(saved(self._steps, _MULTIPLIERS, *self._alarmed, first)) < -REFUTED

    @property
    def statistics(self) -> dict[str, float]:
        """Of the alarm's three criteria, as a share of their thresholds."""
        return dict(zip(STATISTICS, self._shares, strict=True))

    @property
    def worst(self) -> float:
        """The largest of `statistics`."""
        return max(self._shares)

    @property
    def _shares(self) -> tuple[float, float, float]:
        return self.mean / MAX_MEAN, self.sum / MAX_SUM, max(self.gain, 0.0) / MAX_GAIN

    @property
    def _is_telling(self) -> bool:
        return self._tells(AGREEING)

    def _tells(self, newest: int) -> bool:
        x, y, turn = np.abs(self._steps.driven[-newest:]).sum(axis=0).tolist()
        return bool(x + y > TELLING_M or turn > TELLING_RAD)

    @property
    def turns(self) -> bool:
        """Whether the robot has turned of late."""
        return float(np.add.reduce(np.abs(self._steps.driven[-AGREEING:, 2]))) > TELLING_RAD

    @property
    def confirms(self) -> bool:
        """Whether a few steps agree, over which the robot has moved enough to tell."""
        costs = self._steps.costs
        if len(costs) < CONFIRMING:
            return False
        if float(costs[-SUFFIXES[0] :].mean()) < USUAL_COST and self._is_telling:
            return True
        # a first pose of an unknown camera may be off: those after it count by themselves
        return float(costs[-CONFIRMING:].mean()) < USUAL_COST and self._tells(CONFIRMING)

    def update(
        self, sighting: Sighting, history: MotionHistory, late_s: float, jumped: bool, steps: StepNoise = ON_WHEELS
    ) -> None:
        """Take a pose by an image. late_s: how late it is believed to be stamped; jumped: not from where it was; steps:
        noise of motions, which on legs is no fault.
        """
        last, held = self._last, self._held
        if jumped:
            self._unbroken = 0
        if held is not None and (sighting.begun or sighting.stamp_ns - held[1].stamp_ns > 1e9 * MAX_WAIT_S):
            self._held = None
            self._add(*held, history, late_s, steps)
        if last is None or sighting.begun:
            self._last = sighting
            return
        if _is_step(last, sighting, history):
            self._last = sighting
            self._pending.append((last, sighting))
        samples = history.odometry.samples
        while self._pending and len(samples) and samples.last_ns >= self._pending[0][1].stamp_ns:
            begin, end = self._pending.pop(0)
            if samples.first_ns <= begin.stamp_ns:
                self._add_or_hold(begin, end, history, late_s, steps)
        self._pending = [each for each in self._pending if sighting.stamp_ns - each[1].stamp_ns < 1e9 * MAX_WAIT_S]

    def _add_or_hold(
        self, last: Sighting, sighting: Sighting, history: MotionHistory, late_s: float, steps: StepNoise
    ) -> None:
        """Add a step; one that an image makes of which the few things may have been taken for others waits for the next
        image: if that fits the rest without it, it is left out.
        """
        held, self._held = self._held, None
        if held is not None:
            first, middle = held
            for begin, doubted in (first, middle), (middle, first):
                may_be_outlier = middle is last and doubted.blurred and (doubted is middle or first.begun)
                if may_be_outlier and self._cost(begin, sighting, history, steps) < USUAL_COST:
                    self._add(begin, sighting, history, late_s, steps)
                    return
            self._add(first, middle, history, late_s, steps)
        if sighting.blurred or (last.begun and last.blurred):
            self._held_cost = self._cost(last, sighting, history, steps)
            if self._held_cost > OUTLIER_COST:
                self._held = last, sighting
                return
        self._add(last, sighting, history, late_s, steps)

    def _cost(self, last: Sighting, sighting: Sighting, history: MotionHistory, steps: StepNoise) -> float:
        """Of a step as it was driven."""
        driven = _driven(*history.odometry.samples.arrays, last.stamp_ns, sighting.stamp_ns)
        seen, weights = _compared(*_ends(last, sighting, history, steps), driven)
        return float(_cost(seen[None], driven, weights[None], 0))

    def _add(self, last: Sighting, sighting: Sighting, history: MotionHistory, late_s: float, steps: StepNoise) -> None:
        span_ns, odometry = (last.stamp_ns, sighting.stamp_ns), history.odometry.samples.arrays
        late_ns, gyro = round(1e9 * late_s), history.gyro.turn_rad(*span_ns)
        ends = _ends(last, sighting, history, steps)
        raw, late = _push(self._every, _MULTIPLIERS, ends, odometry, span_ns, late_ns, gyro)
        cost = min(raw, late)
        if late_s:
            self._delay_loss = max(self._delay_loss + late - raw, 0.0)
        self._unbroken += 1
        self._since_alarm += 1
        self._since_clock += 1
        self._count = min(self._count + 1, WINDOW)
        self.sum = min(max(self.sum + self._excess(cost, last, sighting), 0.0), 1.1 * MAX_SUM)
        self._explain(history)

    def _excess(self, cost: float, last: Sighting, sighting: Sighting) -> float:
        """Of a step's cost above what is usual, as much as it adds to the sum."""
        seconds = 1e-9 * (sighting.stamp_ns - last.stamp_ns)
        more = (cost - USUAL_COST) * min(seconds / 0.1, 2.0)
        return min(more, MAX_COST - USUAL_COST) if self.all_round else more  # a shove is one, however long its step

    def _fill_lags(self) -> None:
        """The odometry's steps at other times; of a new step those before it alone are known."""
        if self._count:
            odometry = self._history.odometry.samples.arrays
            _fill_lags(self._every, WINDOW - self._count, _LAGS_NS, 1e9 * LAGS_S[-1], *odometry)

    def _explain(self, history: MotionHistory) -> None:
        """Try every explanation, if there is anything to explain."""
        self.gain = 0.0
        self._history = history
        if self._take_mean() < WORTH:
            return
        self._fill_lags()
        gains, values, left = gains_of(self._steps, _MULTIPLIERS, _SUFFIXES)
        gains[: len(SIGNS)] -= FREEDOM - 1.0
        gains[len(SIGNS) :] -= FREEDOM
        gains[FIRST_LAG:] -= 1.0
        if self.clock_s:
            gains[FIRST_LAG + int(np.argmin(np.abs(LAGS_S - self.clock_s)))] += ARRIVED
        gains[GYRO] -= CLEARLY  # it says what turns otherwise, not why: a sign or a scale says more
        if not self.all_round:
            gains[BACK_TO_FRONT] -= BACKWARDS
            gains[ROTATION] -= BACKWARDS * (abs(values[ROTATION]) > 0.5 * math.pi)
        best = self._likeliest(gains, left)
        self._best = best
        self.gain, self.parameter, self._left = (float(each[best]) for each in (gains, values, left))

    def _take_mean(self) -> float:
        """The sum of all costs, of which it is."""
        total = float(np.add.reduce(self._every.costs))
        self.mean = total / max(self._count, WINDOW // 2)
        return total

    def _likeliest(self, gains: FloatArray, left: FloatArray) -> int:
        """The explanation that saves most. Where odometry and images might be to blame alike, the gyro tells; or images
        that are turned or mirrored suddenly, whose chain of poses breaks, as that of an odometry does not. What was
        named stays so: mirrored images of a robot that drives straight on are an odometry with a wrong sign, too. That
        images turn for themselves is for the gyro to say, and refutes an odometry that tells no turn.
        """
        images, odometry = self._gyro_agrees()
        by_gyro = odometry < images if self._gyro_tells(images, odometry) else None
        if not by_gyro:
            gains[PANNED] = -np.inf
        elif left[PANNED] < MAX_LEFT:  # nothing else contradicts
            gains[[TURN_SCALE, STILL_ODOMETRY]] = -np.inf
        best, count = int(np.argmax(gains)), len(_BY_IMAGES)
        if self._named is not None:
            named, at_fault = self._named
            if gains[named] > gains[best] - CLEARLY and by_gyro in (None, at_fault == "images"):
                return named
        if best >= count:
            return best
        by_images = self._unbroken < WINDOW if by_gyro is None else by_gyro
        of_culprit = np.where(by_images == _BY_IMAGES, gains[:count], -np.inf)
        other = int(np.argmax(of_culprit))
        return other if of_culprit[other] > gains[best] - CLEARLY else best

    @property
    def refutes_delay(self) -> bool:
        """Whether the delay that is corrected explains less than none."""
        return self._delay_loss > REFUTING_LOSS

    @property
    def may_contradict(self) -> bool:
        """Whether the mean or the sum would make an alarm if the step that waits for the next image counted."""
        if self._held is None:
            return False
        mean = self.mean + self._held_cost / max(self._count, WINDOW // 2)
        return mean > MAX_MEAN or self.sum + self._excess(self._held_cost, *self._held) > MAX_SUM

    @property
    def contradicts(self) -> bool:
        """Whether the very newest steps do."""
        return float(self._steps.costs[-SUFFIXES[0] :].mean()) > USUAL_COST if len(self._steps.costs) else False

    @property
    def is_explained(self) -> bool:
        """Whether one explanation accounts for what contradicts. One by the odometry, after which images count alone,
        has to leave little, unless its signs are put right.
        """
        if self._left < MAX_LEFT:
            return self.gain > NAMED_GAIN
        by_odometry = self._best < len(_BY_IMAGES) and not _BY_IMAGES[self._best]  # what the gyro says has a witness
        return self.gain > MAX_GAIN and (not by_odometry or self.signs is not None)

    @property
    def signs(self) -> tuple[int, int, int] | None:
        """Of the odometry's (ahead, aside, turn), where the newest steps clearly show that they are wrong."""
        by_odometry = 0 <= self._best < len(SIGNS) and not _BY_IMAGES[self._best]
        if not by_odometry or self.gain < MAX_GAIN or self._left > MAX_MEAN or not self.contradicts:
            return None
        return list(SIGNS)[self._best]

    def forget_fault(self) -> None:
        """Only the newest steps, which agree, count from now on."""
        self._count = min(self._count, AGREEING)
        self._every.costs[:-AGREEING] = 0.0
        self.sum = self.gain = 0.0
        self._take_mean()

    def end_alarm(self) -> None:
        """What was named is over."""
        self._alarmed = self._named = None

    def suspect(self, index: int, parameter: float) -> None:
        """Take a fault of the images to last until the motion refutes it."""
        self._alarmed, self._named, self._since_alarm = (index, parameter), (index, "images"), 0

    def set_clock(self, change_s: float) -> None:
        """Images come stamped later by so much from now on."""
        self.clock_s += change_s
        self._since_clock = -1  # the step under way is of both clocks

    def refutes_lag(self, late_s: float) -> bool:
        """Whether the newest steps would not agree if images were stamped so late: the robot has changed its speed."""
        return self._refutes(late_s, 0)

    @property
    def refutes_clock(self) -> bool:
        """Whether the steps since the clock was set would not agree if it were the camera's."""
        return self._refutes(self.clock_s, max(self._count - max(self._since_clock, 0), 0))

    def _refutes(self, late_s: float, first: int) -> bool:
        index = FIRST_LAG + int(np.argmin(np.abs(LAGS_S - late_s)))
        self._fill_lags()
        return float(saved(self._steps, _MULTIPLIERS, index, 0.0, first)) < -REFUTED

    def blame(self) -> Problem:
        """What explains the contradiction, as far as anything does; until `agrees` it is taken to last."""
        lasts = self.is_explained and (self._best <= ROTATION or self._best >= FIRST_LAG)
        self._alarmed, self._since_alarm = (self._best, self.parameter) if lasts else None, 0
        problem = self._explained()
        self._named = (self._best, problem.at_fault) if self.is_explained else None
        return problem

    def _explained(self) -> Problem:
        if not self.is_explained:
            return self._unexplained()
        if self._best < len(SIGNS):
            return list(SIGNS.values())[self._best]
        if self._best >= FIRST_LAG:
            late_s = float(LAGS_S[self._best - FIRST_LAG])
            code = ProblemCode.STAMPS_LATE if late_s > 0.0 else ProblemCode.STAMPS_EARLY
            when = "too late" if late_s > 0.0 else "too early"
            return Problem(code, f"images are stamped {1e3 * abs(late_s):.0f} ms {when}")
        return {
            SCALE: Problem(
                ProblemCode.ODOMETRY_SCALE, f"odometry tells {self._times_more} the way: wheels slip, or its scale"
            ),
            TURN_SCALE: Problem(
                ProblemCode.ODOMETRY_TURN_SCALE, f"odometry tells {self._times_more} the turn: its scale is wrong"
            ),
            ROTATION: Problem(
                ProblemCode.IMAGES_TURNED,
                f"images are turned by {math.degrees(self.parameter):.0f}° against the wheels",
            ),
            DRIFT: self._drifting(),
            STILL_ODOMETRY: Problem(ProblemCode.ODOMETRY_FROZEN, "odometry stands still while the images move"),
            PANNED: SPINNING,
            STILL_IMAGES: Problem(ProblemCode.IMAGES_REPEAT, "the image has not changed while the wheels turned"),
            GYRO: Problem(ProblemCode.ODOMETRY_AGAINST_GYRO, "odometry turns otherwise than images and gyro"),
        }[self._best]

    @property
    def late_s(self) -> float | None:
        """How late images are stamped, where that explains it."""
        if self._best < FIRST_LAG or not self.is_explained:
            return None
        return float(LAGS_S[self._best - FIRST_LAG])

    @property
    def _times_more(self) -> str:
        return f"{1.0 / max(self.parameter, 0.01):.2g} times" if self.parameter > 0.01 else "far more than"

    def _gyro_agrees(self) -> tuple[float, float]:
        """Mean differences (rad) of the gyro's turns from the images' and from the odometry's; infinite without."""
        s = self._steps
        known = ~np.isnan(s.gyro)
        if known.sum() < 3:
            return math.inf, math.inf
        by_images = np.abs(np.sin(0.5 * (s.gyro - s.seen[:, 2])))[known].mean()
        return float(by_images), float(np.abs(np.sin(0.5 * (s.gyro - s.driven[:, 2])))[known].mean())

    @staticmethod
    def _gyro_tells(images: float, odometry: float) -> bool:
        """Whether it agrees clearly better with one of them, by the mean differences from its turns."""
        return min(images, odometry) < 0.5 * max(images, odometry) and max(images, odometry) > SIGMA_RAD

    @property
    def refutes_gyro(self) -> bool:
        """Whether the gyro has turned otherwise than the images, and than the odometry."""
        nearest = min(self._gyro_agrees())
        return SIGMA_RAD < nearest < math.inf

    @property
    def is_guess(self) -> bool:
        """Whether neither an explanation nor the gyro tells which of images and odometry is to blame."""
        return not self.is_explained and not self._gyro_tells(*self._gyro_agrees())

    def _drifting(self) -> Problem:
        images, odometry = self._gyro_agrees()
        if images < odometry:
            return Problem(ProblemCode.ODOMETRY_DRIFT, "odometry's heading drifts")
        return SPINNING

    def _unexplained(self) -> Problem:
        images, odometry = self._gyro_agrees()
        if images < 0.5 * odometry and odometry > SIGMA_RAD:
            return Problem(ProblemCode.ODOMETRY_AGAINST_GYRO, "odometry contradicts images and gyro")
        return Problem(ProblemCode.IMAGES_AGAINST_ODOMETRY, "images contradict odometry")


def _ends(
    last: Sighting, sighting: Sighting, history: MotionHistory, steps: StepNoise
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Poses (3,) and covariances (3, 3) by the images of a step; the noise of its motion in the second."""
    covariance = sighting.covariance
    if steps.walks:
        turn = rotated(float(last.pose[2]))
        covariance = covariance + turn @ steps.of(history.between(last.stamp_ns, sighting.stamp_ns)) @ turn.T
    return last.pose, last.covariance, sighting.pose, covariance


def rotated(heading_rad: float) -> FloatArray:
    """(3, 3) that turns x and y of (m, m, rad) by a heading."""
    cosine, sine = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _is_step(last: Sighting, sighting: Sighting, history: MotionHistory) -> bool:
    """Whether enough has happened between two images: of a slow robot short steps show nothing but noise."""
    seconds = 1e-9 * (sighting.stamp_ns - last.stamp_ns)
    if seconds < STEP_S or seconds >= MAX_STEP_S:
        return seconds >= MAX_STEP_S
    x, y, turn = (sighting.pose - last.pose).tolist()
    if max(abs(x), abs(y)) >= STEP_M or abs(turn) >= STEP_RAD:
        return True
    if not len(history.odometry.samples):
        return False
    x, y, turn = _driven(*history.odometry.samples.arrays, last.stamp_ns, sighting.stamp_ns).tolist()
    return math.hypot(x, y) >= STEP_M or abs(turn) >= STEP_RAD
