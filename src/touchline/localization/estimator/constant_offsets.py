"""Constant errors that a pose hides: a camera that is turned or displaced on the robot, images that are stamped late.

Each of them fits every image. Only the motion tells them from the pose: a turned camera sees the robot drive aside, a
displaced one swing aside in turns, late images lag where the speed changes. A small filter follows the robot by its
odometry, knows nothing of the field, and takes each pose by an image alone as the robot's but for these errors. What
they are, and how large they could still be, widens the protection level as far as they are likely at all: most robots
have none, and the filter's posterior density of none against its prior's says how likely they are by now (the ratio of
Savage and Dickey 1971). Where images jump, they may all have changed.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray, Pose, wrap_angle
from touchline.localization.estimator.stamp_delay import Arrivals
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.estimator.visual_motion import Sighting, Velocity, difference
from touchline.matrices import add_to, applied, copy_row, dot, inverse, plus, symmetrise, times
from touchline.motion import MotionHistory
from touchline.motion.odometry import odometry_pose, step_to
from touchline.motion.samples import EXTRAPOLATION_S, NANOSECONDS, SampleHistory

TURNED, AHEAD, LATE = 3, 4, 6  # states, behind those of the pose: rad, m (ahead and left), s
AT_FIRST = np.array([0.12, 0.15, 0.15, 0.08])  # their standard deviations, of a robot that has them
TURNED_ROBOTS, DISPLACED_ROBOTS, LATE_ROBOTS = 0.008, 0.002, 0.02  # shares of all robots that have one of them
USUAL_CAMERA = TURNED_ROBOTS, DISPLACED_ROBOTS
CLOCK_SET = 0.9  # probability of it where images come otherwise than usual
# probability of a turn where images turn at once, by more than TURN, about where the robot stands: shoves move it, too
TURNED_IN_PLACE, TURN, STANDS_M = 0.5, 0.05, 0.03
# and where they turn by so much more (rad) than gyro and odometry are apart, and than images do that are late by
# OFTEN_LATE_S, and move it no farther than a shove does; beyond MAX_UNFELT it was rather found elsewhere
TURNED_UNFELT, UNFELT, OFTEN_LATE_S, MAX_UNFELT, UNFELT_M = 0.9, 0.02, 0.3, 0.8, 0.7
FIRST_IMAGES = 5  # which may have been taken for others: nothing has turned since
# probability of a displacement where images of a robot on wheels jump by more than that and do not turn: a shove turns
CAMERA_DISPLACED, DISPLACED_M, UNTURNED = 0.3, 0.15, 0.03
RISK = 1e-3  # probability of an error beyond its bound
HEAD_M = 0.05  # of a humanoid's camera in the place of the displacement above
BLIND_LATE_S = 0.06  # of a delay that was refuted as the explanation of what contradicts
DRIFT = np.array([0.003, 0.004, 0.004, 0.003])  # in the root of a second
UNKNOWN = np.diag(np.square([3.0, 3.0, 1.0]))  # of a pose that only an image tells, about that
VISION = np.diag(np.square([0.01, 0.01, 0.005]))  # of a pose by an image, beside its covariance: what is common to many
SCALE = 0.1  # of the odometry
JUMP = 14.0  # squared Mahalanobis distance of an image from which anything may have changed
CHANGED = 0.16  # share of its square that these may be: a shove is likelier, but what is left covers the jump
MAX_LATE_S, MAX_ASIDE_M, MIN_SPEED_M_S = 0.6, 0.4, 0.3
MAX_GAP_S = 4.0  # between images, after which another pose is followed
KEPT_S, MAX_KEPT = 2.0, 3  # for which what is believed without images that may be outliers is kept
FAR = 1.0  # (m, rad) from where the robot was expected: it was found elsewhere
MAX_TURN, MAX_LATE_M, MAX_LATE_RAD = 0.26, 0.5, 0.5  # (rad, m, rad) from which a pose is not tracked
MAX_VARIANCE_M2 = 1.0  # of a pose by an image that tells where the robot is
MIN_SPREAD_S, MAX_SPREAD_S = 0.05, 0.3  # of a delay, over which the robot's way when the image was taken is averaged
COVERED_NS = round(EXTRAPOLATION_S * NANOSECONDS)  # beyond the newest odometry, which still tells it
BISECTIONS = 10
ACCELERATION = 3.0, 6.0  # of robots on wheels (m/s², rad/s²): a speed changes by that while nobody tells of it


class Felt(NamedTuple):
    """How far gyro and odometry are apart since the image before, NaN without a gyro; the rate of turn at that one."""

    apart_rad: float
    rate_rad_s: float


@njit(cache=True, error_model="numpy")
def followed(state, joint, step, noise, seconds, turn2):  # type: ignore[no-untyped-def]
    """Move (in place) by a step of the odometry (3,), with its covariance (3, 3), robot frame before it. turn2: of its
    turn, checked by the gyro, in the place of its own; NaN where there is none.
    """
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    x, y = cosine * step[0] - sine * step[1], sine * step[0] + cosine * step[1]
    state[0] += x
    state[1] += y
    state[2] += step[2]
    move, spread = np.eye(7), noise.copy()
    move[0, 2], move[1, 2] = -y, x
    for k in range(3):
        spread[k, k] += (SCALE * step[k]) ** 2
    if not math.isnan(turn2):
        spread[2] = spread[:, 2] = 0.0
        spread[2, 2] = turn2
    moved = times(times(move, joint), move.T)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    add_to(moved, times(times(turn, spread), turn.T), 1.0)
    for a in range(7):
        for b in range(7):
            joint[a, b] = moved[a, b]
    for k in range(4):
        joint[3 + k, 3 + k] += DRIFT[k] ** 2 * seconds


@njit(cache=True, error_model="numpy")
def corrected(state, joint, prior, seen, way, stamp_ns, felt, may_change):  # type: ignore[no-untyped-def]
    """Take (in place) a pose by an image: (3,) and its covariance (3, 3). way: times and table of the odometry's
    samples. prior (4,): standard deviations, of those that have grown anew. Returns the velocity of `taken`; (4,)
    by how much the variances of the way, heading and turn have grown, and the probability of a turn that this makes, 0
    for none; negative if the image lies elsewhere, may_change is not set, and nothing was taken.
    """
    (seen, covariance), (since, bend, velocity) = seen, taken(way, stamp_ns, state[LATE], joint[LATE, LATE])
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    vx, vy = cosine * velocity[0] - sine * velocity[1], sine * velocity[0] + cosine * velocity[1]
    c, s = math.cos(state[2] + since[2]), math.sin(state[2] + since[2])
    dx, dy = c * state[4] - s * state[5], s * state[4] + c * state[5]
    dx, dy = dx + cosine * since[0] - sine * since[1], dy + sine * since[0] + cosine * since[1]
    by, more, spread, grown = np.zeros((3, 7)), np.zeros(7), plus(covariance, VISION, 1.0), np.zeros(4)
    for a in range(3):
        for b in range(3):
            spread[a, b] += (2.0 * bend[a]) * (2.0 * bend[b])
    by[0, 0] = by[1, 1] = by[2, 2] = by[2, 3] = 1.0
    by[0, 2], by[0, 4], by[0, 5], by[0, 6] = -dy, c, -s, -vx
    by[1, 2], by[1, 4], by[1, 5], by[1, 6] = dx, s, c, -vy
    by[2, 6] = -velocity[2]
    off = np.array([seen[0] - state[0] - dx, seen[1] - state[1] - dy, seen[2] - state[2] - state[3] - since[2]])
    off[2] -= 2.0 * math.pi * math.floor(off[2] / (2.0 * math.pi) + 0.5)
    crossed = times(joint, by.T)
    expected = plus(times(by, crossed), spread, 1.0)
    off2, weight = expected[2, 2], inverse(expected)
    if dot(off, applied(weight, off)) > JUMP:
        if not may_change:
            return (velocity[0], velocity[1], velocity[2]), (-1.0, -1.0, -1.0, -1.0)
        # a lone line: the pose slides along it, but does not turn
        alone = spread[0, 0] + spread[1, 1] > MAX_VARIANCE_M2
        way2, turn2 = 0.0 if alone else off[0] ** 2 + off[1] ** 2, off[2] ** 2
        unfelt = is_unfelt(off[2], off2, way2, felt.apart_rad, velocity[2] - felt.rate_rad_s)
        if alone and not (unfelt and turn2 > TURN**2):
            return (velocity[0], velocity[1], velocity[2]), (0.0, 0.0, 0.0, 0.0)
        speed2 = velocity[0] ** 2 + velocity[1] ** 2
        late2 = min(way2 / speed2, MAX_LATE_S**2) if speed2 > MIN_SPEED_M_S**2 else 0.0
        aside2 = min(way2, MAX_ASIDE_M**2)
        more[0], more[1], more[2], more[3] = way2, way2, turn2, CHANGED * turn2
        if unfelt or (turn2 > TURN**2 and way2 < STANDS_M**2):
            more[3], grown[3] = turn2, TURNED_UNFELT if unfelt else TURNED_IN_PLACE
        for k in range(3):
            grown[k] = more[1 + k]
        more[4], more[5], more[6] = CHANGED * aside2, CHANGED * aside2, CHANGED * late2
        for k in range(7):
            joint[k, k] += more[k]
            if k >= 3 and more[k] > 0.0:
                prior[k - 3] = math.sqrt(joint[k, k])
        crossed = times(joint, by.T)
        weight = inverse(plus(times(by, crossed), spread, 1.0))
    gain = times(crossed, weight)
    step = applied(gain, off)
    for k in range(7):
        state[k] += step[k]
    add_to(joint, times(gain, crossed.T), -1.0)
    symmetrise(joint)
    return (velocity[0], velocity[1], velocity[2]), (grown[0], grown[1], grown[2], grown[3])


@njit(cache=True, error_model="numpy")
def is_unfelt(turn, variance, way2, apart, rate_change):  # type: ignore[no-untyped-def]
    """Whether images that turn at once by so much (rad, with its variance), and move the robot by a way (m², squared),
    show no shove: gyro and odometry would have felt one. apart: how far they are (rad); NaN: one of them is missing.
    rate_change (rad/s): since the image before, by which late images turn, too.
    """
    least2 = (UNFELT + 3.0 * apart + OFTEN_LATE_S * abs(rate_change)) ** 2 + 9.0 * variance
    return least2 < turn**2 < MAX_UNFELT**2 and way2 < UNFELT_M**2


@njit(cache=True, error_model="numpy")
def taken(way, stamp_ns, late_s, late2):  # type: ignore[no-untyped-def]
    """Where the robot was when an image was taken, by the mean delay, from where it was at the stamp (3,), and by how
    much its way bends there (3,); its velocity (3,) is the mean over the times at which that may have been.

    way: times and table of the odometry's samples; late2: variance of the delay.
    """
    times, table = way
    spread_s = min(max(math.sqrt(max(late2, 0.0)), MIN_SPREAD_S), MAX_SPREAD_S)
    mean_s = min(max(late_s, -MAX_LATE_S), MAX_LATE_S)
    here, at = odometry_pose(times, table, stamp_ns), np.empty((3, 3))
    for k in range(3):
        late_ns = np.int64(np.rint((mean_s + (1 - k) * spread_s) * NANOSECONDS))
        copy_row(step_to(here, odometry_pose(times, table, stamp_ns - late_ns)), at[k])
    return at[1].copy(), 0.5 * (at[0] + at[2]) - at[1], (at[2] - at[0]) / (2.0 * spread_s)


@njit(cache=True, error_model="numpy")
def exceeded_by(errors):  # type: ignore[no-untyped-def]
    """What errors (E, 3) exceed with a probability of RISK, of which one at most is there; by bisection. Each: its
    probability, the size of its mean, its standard deviation.
    """
    low = high = total = 0.0
    for e in range(errors.shape[0]):
        high, total = max(high, errors[e, 1] + 4.0 * errors[e, 2]), total + errors[e, 0]
    if total <= RISK:
        return 0.0
    for _ in range(BISECTIONS):
        middle, risk = 0.5 * (low + high), 0.0
        for e in range(errors.shape[0]):
            beyond = (middle - errors[e, 1]) / max(errors[e, 2], 1e-12)
            risk += errors[e, 0] * min(math.erfc(beyond / math.sqrt(2.0)), 1.0)
        if risk > RISK:
            low = middle
        else:
            high = middle
    return high


@njit(cache=True, error_model="numpy")
def exceeded_moving(sets, speed, rate):  # type: ignore[no-untyped-def]
    """Bounds (m, rad) of position and heading by sets of errors (7, 7), as of `errors_of`, at a speed and a rate."""
    of_position, of_heading = np.empty((len(sets), 3)), np.empty((len(sets), 3))
    for s in range(len(sets)):
        turn, displaced, late = sets[s, 1:3], sets[s, 3:5], sets[s, 5:7]
        of_position[s, 0] = of_heading[s, 0] = sets[s, 0]
        of_position[s, 1], of_position[s, 2] = displaced[0] + speed * late[0], math.hypot(displaced[1], speed * late[1])
        of_heading[s, 1], of_heading[s, 2] = turn[0] + rate * late[0], math.hypot(turn[1], rate * late[1])
    return exceeded_by(of_position), exceeded_by(of_heading)


# of an image, as `corrected` takes it
_Measured = tuple[tuple[FloatArray, FloatArray], tuple[IntArray, FloatArray], int, Felt]


class _Belief(NamedTuple):
    """A filter's mean (7,), covariance (7, 7), deviations of the errors before (4,), and the probabilities before of a
    camera that is turned, and displaced. stamp_ns: of the image that was left out.
    """

    stamp_ns: int
    state: FloatArray
    joint: FloatArray
    prior: FloatArray
    camera: tuple[float, float]


class ConstantOffsets:
    """How far a pose may be off by errors that fit every image."""

    def __init__(self) -> None:
        self._late_s = self._clock_s = self._lag_s = self._ahead_s = 0.0
        self._doubt: str | None = None  # None: not found yet
        self._clock_set = False  # whether images have come otherwise
        self._camera = USUAL_CAMERA  # probabilities that it is turned, and displaced, before what was seen since
        self._prior: FloatArray = AT_FIRST.copy()  # standard deviations of the errors before what was seen since
        self._state: FloatArray
        self._joint: FloatArray
        self._images: int  # that were taken
        self._first_blurred: bool  # whether the first may be an outlier
        self._others: list[_Belief]  # what is believed without the newest images, if they may be outliers
        self.reset()

    def reset(self, start: Pose | None = None, covariance: FloatArray = UNKNOWN) -> None:
        """Nothing has been seen: the camera is as well known as one is at first. start: the pose that was given."""
        self._stamp_ns: int | None = None
        self._waiting: list[Sighting] = []  # for the odometry until then
        self._given = start is not None
        self._velocity: Velocity = (0.0, 0.0, 0.0)
        self._newest: Velocity = (0.0, 0.0, 0.0)
        self._newest_ns = 0
        self._begin(np.zeros(3) if start is None else start.as_array(), covariance)

    def begin_again(self) -> None:
        """Images are trusted again: if less is known by now than at first, those before have taught nothing."""
        if (np.diag(self._joint)[TURNED:] > AT_FIRST**2).any():
            self._forget(AT_FIRST[LATE - TURNED] ** 2)

    def update(self, sighting: Sighting, history: MotionHistory, steps: StepNoise, late_s: float) -> None:
        """Take a pose by an image alone. steps: noise of the odometry; late_s: as how late images are corrected."""
        if self._stamp_ns is not None:
            self._state[LATE] -= late_s - self._late_s
        self._late_s = late_s
        if late_s:
            sighting = sighting._replace(stamp_ns=sighting.stamp_ns - round(late_s * NANOSECONDS))
        self._waiting.append(sighting)
        odometry = history.odometry.samples
        comes = len(odometry) > 0 and odometry.last_ns != self._newest_ns
        self._newest_ns = odometry.last_ns if comes else self._newest_ns
        early_ns = round(NANOSECONDS * min(max(-float(self._state[LATE]), 0.0), MAX_LATE_S))
        while self._waiting and not (comes and self._waiting[0].stamp_ns + early_ns > odometry.last_ns + COVERED_NS):
            self._take(self._waiting.pop(0), history, steps)

    def blind(self, velocity: Velocity) -> None:
        """The odometry is wrong: what was learned with it says nothing. velocity: by images."""
        self._forget(BLIND_LATE_S**2)
        self._velocity, self._doubt = velocity, None

    def _forget(self, late2: float) -> None:
        """Begin anew, with this variance (s²) of a delay; that a clock was set is known all the same."""
        clock_set = self._clock_set
        if clock_set:
            late2 = max(late2, self._joint[LATE, LATE] + self._state[LATE] ** 2)
        self.reset()
        self._joint[LATE, LATE], self._prior[LATE - 3], self._clock_set = late2, math.sqrt(late2), clock_set
        self._weigh()

    def _take(self, sighting: Sighting, history: MotionHistory, steps: StepNoise) -> None:
        before_ns, self._stamp_ns = self._stamp_ns, sighting.stamp_ns
        if before_ns is None and steps.walks:
            self._limit_head()
        if not len(history.odometry.samples):
            return
        seconds = math.inf if before_ns is None else max(1e-9 * (sighting.stamp_ns - before_ns), 0.01)
        others, self._others = self._others, []
        apart = math.nan
        if seconds < MAX_GAP_S:
            assert before_ns is not None
            span_ns = before_ns, max(sighting.stamp_ns, before_ns)
            motion, apart = history.between(*span_ns), history.gyro_apart_rad(*span_ns)
            turn2 = apart**2 + history.gyro.settings.variance(abs(motion.pose.heading), seconds)
            for each in (self._state, self._joint), *((one.state, one.joint) for one in others):
                followed(*each, motion.pose, steps.of(motion), seconds, turn2)
        known = self._given or seconds < MAX_GAP_S
        elsewhere = sighting.begun and self._lies_elsewhere(sighting, history, apart)
        if not known or (elsewhere and not self._given):
            self._found(sighting.pose, elsewhere=before_ns is not None)
            others = []
        self._given = False
        # what is believed without an outlier is by the camera that was unknown, too
        others = [one for one in others if sighting.stamp_ns - one.stamp_ns < 1e9 * KEPT_S and not sighting.learned]
        apart = apart if self._images >= FIRST_IMAGES else math.nan
        image = sighting.pose, sighting.covariance
        seen = (image, history.odometry.samples.arrays, sighting.stamp_ns, Felt(apart, self._velocity[2]))
        for one in others:
            self._velocity, more2 = corrected(one.state, one.joint, one.prior, *seen, False)
            if more2[0] >= 0.0:
                _, self._state, self._joint, self._prior, self._camera = one
                break
        else:
            self._correct(sighting, seen, steps.walks)
            self._others = [*others, *self._others][:MAX_KEPT]
        self._images += 1
        self._first_blurred = sighting.blurred if self._images == 1 else self._first_blurred
        self._weigh()

    def _lies_elsewhere(self, sighting: Sighting, history: MotionHistory, apart: float) -> bool:
        """Whether an image has the robot far from where it was expected, and not because the camera has turned."""
        x, y, turn = difference(sighting.pose, self._state[:3]).tolist()
        if not math.hypot(x, y) + abs(turn) > FAR:
            return False
        turn2 = self._joint[2, 2] + self._joint[3, 3] + 2.0 * self._joint[2, 3] + sighting.covariance[2, 2]
        change = float(history.odometry.samples.slope(EXTRAPOLATION_S)[2]) - self._velocity[2]
        turned = wrap_angle(turn - float(self._state[TURNED]))
        return not is_unfelt(turned, turn2, x * x + y * y, apart, change)

    def _correct(self, sighting: Sighting, seen: _Measured, walks: bool) -> None:
        """By an image; where one lies elsewhere that may be an outlier, or the first one of all that may be, what is
        believed without it is kept: the next images decide.
        """
        before = _Belief(sighting.stamp_ns, self._state.copy(), self._joint.copy(), self._prior.copy(), self._camera)
        self._velocity, more2 = corrected(self._state, self._joint, self._prior, *seen, True)
        way2, heading2, turn2, is_turned = more2
        if not (way2 or heading2 or turn2 or is_turned):
            return
        if sighting.learned and not self._clock_set:  # another camera saw the images before: nothing has turned
            self._begin(sighting.pose, UNKNOWN)
            if walks:
                self._limit_head()
            self._velocity, _ = corrected(self._state, self._joint, self._prior, *seen, True)
            return
        turned, displaced = self._camera
        if is_turned:
            self._camera = is_turned, displaced
        elif way2 > DISPLACED_M**2 and heading2 < UNTURNED**2 and not walks:
            self._camera = turned, CAMERA_DISPLACED
        if self._images == 1 and self._first_blurred:
            anew = before._replace(state=before.state.copy(), joint=before.joint.copy(), prior=before.prior.copy())
            anew.state[:3], anew.joint[:3], anew.joint[:, :3], anew.joint[:3, :3] = sighting.pose, 0.0, 0.0, UNKNOWN
            corrected(anew.state, anew.joint, anew.prior, *seen, True)
            self._others.append(anew)
        if sighting.blurred:
            self._others.append(before)

    def _limit_head(self) -> None:
        """Kinematics tell where a head is."""
        for axis in (AHEAD, AHEAD + 1):
            self._joint[axis, axis] = min(self._joint[axis, axis], HEAD_M**2)
        self._prior[1:3] = np.sqrt(np.diag(self._joint)[AHEAD:LATE])

    def _found(self, pose: FloatArray, elsewhere: bool) -> None:
        """The robot was found. elsewhere: that may be by any of the errors, and what was in doubt still is."""
        offsets, spread, before = self._state[3:].copy(), self._joint[3:, 3:].copy(), (self._clock_set, self._camera)
        self._begin(pose, UNKNOWN)
        self._state[3:], (self._clock_set, self._camera) = offsets, before
        self._joint[3:, 3:] = spread + (self._joint[3:, 3:] if elsewhere else 0.0)
        self._prior = np.sqrt(np.diag(self._joint)[3:])

    def _begin(self, pose: FloatArray, covariance: FloatArray) -> None:
        self._images, self._first_blurred = 0, False
        self._others = []
        self._state = np.concatenate((pose, np.zeros(4)))
        self._joint = np.diag(np.square([*3 * [0.0], *AT_FIRST]))
        self._joint[:3, :3] = covariance
        self._prior, self._clock_set, self._camera = AT_FIRST.copy(), False, USUAL_CAMERA
        self._weigh()

    def arrive(self, arrivals: Arrivals, odometry: SampleHistory, lag_s: float = 0.0) -> None:
        """Take how an image has come: where a clock was set it may be stamped later or earlier by that. lag_s: so much
        since one was, as far as it is neither refuted nor corrected: at one speed the filter learns nothing of it.
        """
        self._clock_s, self._lag_s, self._ahead_s = abs(arrivals.off_s), lag_s, arrivals.ahead_s
        self._doubt = None
        x, y, turn = odometry.slope(EXTRAPOLATION_S).tolist()
        self._newest = x, y, turn
        if arrivals.change_s:  # the pose has followed since
            x, y, turn = self._velocity
            cosine, sine = math.cos(self._state[2]), math.sin(self._state[2])
            along = np.array([cosine * x - sine * y, sine * x + cosine * y, turn, 0.0, 0.0, 0.0, 1.0])
            before2 = max(self._joint[LATE, LATE], 0.0)
            self._joint += ((math.sqrt(before2) + abs(arrivals.change_s)) ** 2 - before2) * np.outer(along, along)
            self._prior[LATE - 3], self._clock_set = math.sqrt(self._joint[LATE, LATE]), True
            self._weigh()

    @property
    def doubt(self) -> str:
        """Why a pose may not be tracked; empty where it may."""
        if self._doubt is None:  # it is asked for several times an image
            self._doubt = self._find_doubt()
        return self._doubt

    def _find_doubt(self) -> str:
        turn, late_s = self._turn, max(self._late, self._lag_s) + self._clock_s
        if turn > MAX_TURN:
            return f"images that are turned by {math.degrees(turn):.0f}° would explain the motion, too"
        if not late_s:
            return ""
        if late_s * self._speed > MAX_LATE_M or late_s * abs(self._newest[2]) > MAX_LATE_RAD:
            return f"images that are stamped {1e3 * late_s:.0f} ms late or early would explain the motion, too"
        return ""

    @property
    def _speed(self) -> float:
        (x, y, _), (newest_x, newest_y, _) = self._velocity, self._newest
        return max(math.hypot(x, y), math.hypot(newest_x, newest_y))

    @property
    def bound(self) -> tuple[float, float]:
        """By how much position (m) and heading (rad) may be off by them."""
        rate = max(abs(self._velocity[2]), abs(self._newest[2]))
        speed = self._speed
        position_m, heading_rad = exceeded_moving(self._sets, speed, rate)
        position_m, heading_rad = max(position_m, self._lag_s * speed), max(heading_rad, self._lag_s * rate)
        changed = 0.5 * max(self._lag_s, self._ahead_s, self._clock_s) ** 2  # way by an acceleration of 1
        position_m, heading_rad = position_m + changed * ACCELERATION[0], heading_rad + changed * ACCELERATION[1]
        return position_m + self._clock_s * speed, heading_rad + self._clock_s * rate

    def _weigh(self) -> None:
        """How large each of the errors may be, and how likely it is there."""
        self._state[TURNED] = wrap_angle(float(self._state[TURNED]))
        shares = *self._camera, CLOCK_SET if self._clock_set else LATE_ROBOTS
        self._sets, self._turn, self._late = errors_of(self._state, self._joint, self._prior, shares)
        self._doubt = None


@njit(cache=True, error_model="numpy")
def errors_of(state, joint, prior, shares):  # type: ignore[no-untyped-def]
    """(7, 7) of the sets of a turn, a displacement and a delay: the probability of each, and of the errors in it, one
    after the other, the size of the mean and the largest standard deviation; and what the turn and the delay exceed
    (`exceeded_by`). Set k - 1 holds the errors of the bits of k.

    state (7,) and joint (7, 7): a pose, then the errors; prior (4,): standard deviations before; shares (3,): of the
    robots that have each.
    """
    information, sets, likeliest = inverse(joint[3:, 3:].copy()), np.zeros((7, 7)), 0.0
    shown = applied(information, state[3:])
    for s in range(7):
        for k in range(3):
            if (s + 1) >> k & 1:
                speaks, size, sigma = _evidence(information.copy(), shown.copy(), prior, s + 1, k)
                sets[s, 1 + 2 * k], sets[s, 2 + 2 * k] = size, sigma
                sets[s, 0] += math.log(shares[k]) - math.log(1.0 - shares[k])
        sets[s, 0] += speaks
        likeliest = max(likeliest, sets[s, 0])
    total = math.exp(-likeliest)
    for s in range(7):
        sets[s, 0] = math.exp(sets[s, 0] - likeliest)
        total += sets[s, 0]
    for s in range(7):
        sets[s, 0] /= total
    return sets, exceeded_by(_only(sets, 0)), exceeded_by(_only(sets, 2))


@njit(cache=True, error_model="numpy")
def _only(sets, k):  # type: ignore[no-untyped-def]
    """(4, 3) of the sets that hold error k, as `exceeded_by` takes them."""
    rows, count = np.empty((4, 3)), 0
    for s in range(len(sets)):
        if (s + 1) >> k & 1:
            rows[count, 0], rows[count, 1], rows[count, 2] = sets[s, 0], sets[s, 1 + 2 * k], sets[s, 2 + 2 * k]
            count += 1
    return rows


@njit(cache=True, error_model="numpy")
def _evidence(information, shown, prior, chosen, k):  # type: ignore[no-untyped-def]
    """Logarithm of the ratio of densities for a set of errors against none, and what error k of them is then: the size
    of its mean, its largest standard deviation. information (4, 4) is changed, and shown (4,), that times the mean.
    """
    speaks = 0.0
    for e in (k + 1, k + 2, k):  # the others are eliminated first, so that what is left is known whatever they are
        e %= 3
        for i in range((0, 1, 3)[e], (1, 3, 4)[e]):
            if not chosen >> e & 1:
                continue
            speaks -= math.log(prior[i])
            if e == k:
                continue
            pivot = information[i, i]
            speaks += 0.5 * (shown[i] ** 2 / pivot - math.log(pivot))
            for j in range(4):
                if j != i:
                    factor = information[j, i] / pivot
                    shown[j] -= factor * shown[i]
                    for m in range(4):
                        information[j, m] -= factor * information[i, m]
    a, b = ((0, 0), (1, 2), (3, 3))[k]
    xx, yy, xy = information[a, a], information[b, b], information[a, b]
    if a == b:
        return speaks + 0.5 * (shown[a] ** 2 / xx - math.log(xx)), abs(shown[a]) / xx, 1.0 / math.sqrt(xx)
    det, least = xx * yy - xy * xy, 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    x, y = (yy * shown[a] - xy * shown[b]) / det, (xx * shown[b] - xy * shown[a]) / det
    speaks += 0.5 * (x * shown[a] + y * shown[b] - math.log(det))
    return speaks, math.hypot(x, y), 1.0 / math.sqrt(least)
