"""Constant errors that a pose hides: a camera that is turned or displaced on the robot, images that are stamped late.

Each of them fits every image. Only the motion tells them from the pose: a turned camera sees the robot drive aside, a
displaced one swing aside in turns, late images lag where the speed changes. A small filter follows the robot by its
odometry, knows nothing of the field, and takes each pose by an image alone as the robot's but for these errors. What
they are, and how large they could still be, widens the protection level. Where images jump, they may all have changed.
"""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.estimator.stamp_delay import Arrivals
from touchline.localization.estimator.step_noise import StepNoise
from touchline.localization.estimator.visual_motion import Sighting, difference
from touchline.matrices import add_to, applied, dot, inverse, plus, symmetrise, times
from touchline.motion import MotionHistory
from touchline.motion.samples import EXTRAPOLATION_S, NANOSECONDS, SampleHistory

TURNED, AHEAD, LATE = 3, 4, 6  # states, behind those of the pose: rad, m (ahead and left), s
AT_FIRST = np.array([0.08, 0.15, 0.15, 0.08])  # their standard deviations, as a robot is built
HEAD_M = 0.05  # of a humanoid's camera in the place of the displacement above
BLIND_LATE_S = 0.06  # of a delay that was refuted as the explanation of what contradicts
DRIFT = np.array([0.003, 0.004, 0.004, 0.003])  # in the root of a second
UNKNOWN = np.diag(np.square([3.0, 3.0, 1.0]))  # of a pose that only an image tells, about that
VISION = np.diag(np.square([0.01, 0.01, 0.005]))  # of a pose by an image, beside its covariance: what is common to many
SCALE = 0.03  # of the odometry
JUMP = 14.0  # squared Mahalanobis distance of an image from which anything may have changed
CHANGED = 0.16  # share of its square that these may be: a shove is likelier, but what is left covers the jump
MAX_LATE_S, MAX_ASIDE_M, MIN_SPEED_M_S = 0.6, 0.4, 0.3
MAX_GAP_S = 4.0  # between images, after which another pose is followed
FAR = 1.0  # (m, rad) from where the robot was expected: it was found elsewhere
MAX_TURN, MAX_LATE_M, MAX_LATE_RAD = 0.26, 0.5, 0.5  # (rad, m, rad) from which a pose is not tracked
MAX_VARIANCE_M2 = 1.0  # of a pose by an image that tells where the robot is
CHANGED_SPEED = 2.5  # standard deviations of the odometry's noise from which a change of speed is one
COVERED_NS = round(EXTRAPOLATION_S * NANOSECONDS)  # beyond the newest odometry, which still tells it
SIGMAS = 2.0  # of an error that is found beside its mean


@njit(cache=True, error_model="numpy")
def followed(state, joint, step, noise, drift2):  # type: ignore[no-untyped-def]
    """Move (in place) by a step told (3,), with its covariance (3, 3), robot frame before it."""
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    x, y = cosine * step[0] - sine * step[1], sine * step[0] + cosine * step[1]
    state[0] += x
    state[1] += y
    state[2] += step[2]
    move = np.eye(7)
    move[0, 2], move[1, 2] = -y, x
    moved = times(times(move, joint), move.T)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    add_to(moved, times(times(turn, noise), turn.T), 1.0)
    for a in range(7):
        for b in range(7):
            joint[a, b] = moved[a, b]
    for k in range(4):
        joint[3 + k, 3 + k] += drift2[k]


@njit(cache=True, error_model="numpy")
def corrected(state, joint, seen, covariance, velocity):  # type: ignore[no-untyped-def]
    """Take (in place) a pose (3,) by an image and its covariance (3, 3), at a velocity (3,), robot frame."""
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    vx, vy = cosine * velocity[0] - sine * velocity[1], sine * velocity[0] + cosine * velocity[1]
    dx, dy = cosine * state[4] - sine * state[5], sine * state[4] + cosine * state[5]
    by = np.zeros((3, 7))
    by[0, 0] = by[1, 1] = by[2, 2] = by[2, 3] = 1.0
    by[0, 2], by[0, 4], by[0, 5], by[0, 6] = -dy, cosine, -sine, -vx
    by[1, 2], by[1, 4], by[1, 5], by[1, 6] = dx, sine, cosine, -vy
    by[2, 6] = -velocity[2]
    off = np.array([
        seen[0] - state[0] - dx + state[6] * vx,
        seen[1] - state[1] - dy + state[6] * vy,
        seen[2] - state[2] - state[3] + state[6] * velocity[2],
    ])  # fmt: skip
    off[2] -= 2.0 * math.pi * math.floor(off[2] / (2.0 * math.pi) + 0.5)
    crossed = times(joint, by.T)
    weight = inverse(plus(times(by, crossed), covariance, 1.0))
    if dot(off, applied(weight, off)) > JUMP:
        way2, turn2 = off[0] ** 2 + off[1] ** 2, off[2] ** 2
        speed2 = velocity[0] ** 2 + velocity[1] ** 2
        late2 = min(way2 / speed2, MAX_LATE_S**2) if speed2 > MIN_SPEED_M_S**2 else 0.0
        aside2 = min(way2, MAX_ASIDE_M**2)
        more = (way2, way2, turn2, CHANGED * turn2, CHANGED * aside2, CHANGED * aside2, CHANGED * late2)
        for k in range(7):
            joint[k, k] += more[k]
        crossed = times(joint, by.T)
        weight = inverse(plus(times(by, crossed), covariance, 1.0))
    gain = times(crossed, weight)
    step = applied(gain, off)
    for k in range(7):
        state[k] += step[k]
    add_to(joint, times(gain, crossed.T), -1.0)
    symmetrise(joint)


class ConstantOffsets:
    """How far a pose may be off by errors that fit every image."""

    def __init__(self) -> None:
        self._late_s = self._clock_s = 0.0
        self.reset()

    def reset(self, start: Pose | None = None, covariance: FloatArray = UNKNOWN) -> None:
        """Nothing has been seen: the camera is as well known as one is at first. start: the pose that was given."""
        self._stamp_ns: int | None = None
        self._waiting: list[Sighting] = []  # for the odometry until then
        self._given = start is not None
        self._velocity: FloatArray = np.zeros(3)
        self._newest: FloatArray = np.zeros(3)  # velocity
        self._newest_ns = 0
        self._begin(np.zeros(3) if start is None else start.as_array(), covariance)

    def update(self, sighting: Sighting, history: MotionHistory, steps: StepNoise, late_s: float) -> None:
        """Take a pose by an image alone. steps: noise of the odometry; late_s: as how late images are corrected."""
        self._state[LATE] -= late_s - self._late_s
        self._late_s = late_s
        self._waiting.append(sighting._replace(stamp_ns=sighting.stamp_ns - round(late_s * NANOSECONDS)))
        odometry = history.odometry.samples
        comes = len(odometry) > 0 and odometry.last_ns != self._newest_ns
        self._newest_ns = odometry.last_ns if comes else self._newest_ns
        while self._waiting and not (comes and self._waiting[0].stamp_ns > odometry.last_ns + COVERED_NS):
            self._take(self._waiting.pop(0), history, steps)

    def blind(self, velocity: FloatArray) -> None:
        """The odometry is wrong: what it told of the camera says nothing. velocity (3,): by images, robot frame."""
        self.reset()
        self._joint[LATE, LATE] = BLIND_LATE_S**2
        self._velocity = velocity

    def _take(self, sighting: Sighting, history: MotionHistory, steps: StepNoise) -> None:
        before_ns, self._stamp_ns = self._stamp_ns, sighting.stamp_ns
        if before_ns is None and steps.walks:  # kinematics tell where a head is
            for axis in (AHEAD, AHEAD + 1):
                self._joint[axis, axis] = min(self._joint[axis, axis], HEAD_M**2)
        if not len(history.odometry.samples):
            return
        seconds = math.inf if before_ns is None else max(1e-9 * (sighting.stamp_ns - before_ns), 0.01)
        if seconds < MAX_GAP_S:
            assert before_ns is not None
            motion = history.between(before_ns, max(sighting.stamp_ns, before_ns))
            step = motion.pose.as_array()
            noise = steps.of(motion) + np.diag(np.square(SCALE * step))
            change = step / seconds - self._velocity
            if (change**2 > CHANGED_SPEED**2 * np.diag(noise) / seconds**2).any():  # noise says nothing of a delay
                late2 = self._joint[LATE, LATE] + self._state[LATE] ** 2  # and so late over a change of speed
                noise += np.diag(np.square(0.5 * late2 / seconds * change))
                self._velocity = step / seconds
            followed(self._state, self._joint, step, noise, DRIFT**2 * seconds)
        x, y, turn = difference(sighting.pose, self._state[:3]).tolist()
        known = self._given or seconds < MAX_GAP_S
        if not known or (sighting.begun and math.hypot(x, y) + abs(turn) > FAR and not self._given):
            self._found(sighting.pose)
        if float(np.trace(sighting.covariance[:2, :2])) > MAX_VARIANCE_M2:  # a lone line: the pose slides along it
            return
        self._given = False
        corrected(self._state, self._joint, sighting.pose, sighting.covariance + VISION, self._velocity)

    def _found(self, pose: FloatArray) -> None:
        """The robot was found elsewhere: that may be by any of the errors, and what was in doubt still is."""
        offsets, spread = self._state[3:].copy(), self._joint[3:, 3:].copy()
        self._begin(pose, UNKNOWN)
        self._state[3:] = offsets
        self._joint[3:, 3:] += spread

    def _begin(self, pose: FloatArray, covariance: FloatArray) -> None:
        self._state = np.concatenate((pose, np.zeros(4)))
        self._joint = np.diag(np.square([*3 * [0.0], *AT_FIRST]))
        self._joint[:3, :3] = covariance

    def arrive(self, arrivals: Arrivals, odometry: SampleHistory) -> None:
        """Take how an image has come: where a clock was set it may be stamped later or earlier by that."""
        self._clock_s = abs(arrivals.off_s)
        self._newest = odometry.slope(EXTRAPOLATION_S) if len(odometry) else np.zeros(3)
        if arrivals.change_s:  # the pose has followed since
            x, y, turn = self._velocity.tolist()
            cosine, sine = math.cos(self._state[2]), math.sin(self._state[2])
            along = np.array([cosine * x - sine * y, sine * x + cosine * y, turn, 0.0, 0.0, 0.0, 1.0])
            before2 = max(self._joint[LATE, LATE], 0.0)
            self._joint += ((math.sqrt(before2) + abs(arrivals.change_s)) ** 2 - before2) * np.outer(along, along)

    @property
    def doubt(self) -> str:
        """Why a pose may not be tracked; empty where it may."""
        turn = self._turn_bound
        late_s = self._late_bound_s
        if turn > MAX_TURN:
            return f"images that are turned by {math.degrees(turn):.0f}° would explain the motion, too"
        if late_s * self._speed > MAX_LATE_M or late_s * abs(self._newest[2]) > MAX_LATE_RAD:
            return f"images that are stamped {1e3 * late_s:.0f} ms late or early would explain the motion, too"
        return ""

    @property
    def _late_bound_s(self) -> float:
        return abs(float(self._state[LATE])) + self._clock_s + SIGMAS * math.sqrt(max(self._joint[LATE, LATE], 0.0))

    @property
    def _speed(self) -> float:
        return max(math.hypot(*self._velocity[:2].tolist()), math.hypot(*self._newest[:2].tolist()))

    @property
    def _turn_bound(self) -> float:
        turn = abs(wrap_angle(float(self._state[TURNED])))
        return turn + SIGMAS * math.sqrt(max(self._joint[TURNED, TURNED], 0.0))

    @property
    def bound(self) -> tuple[float, float, float]:
        """Of the position (m): the mean of its error, and `SIGMAS` of it; of the heading (rad), both together."""
        by = np.zeros((2, 7))
        by[0, AHEAD] = by[1, AHEAD + 1] = 1.0
        by[:, LATE] = -self._velocity[:2]
        x, y = (by @ self._state).tolist()
        (xx, xy), (_, yy) = (by @ self._joint @ by.T).tolist()
        major2 = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
        turn = self._turn_bound + self._clock_s * abs(float(self._newest[2]))
        return math.hypot(x, y) + self._clock_s * self._speed, SIGMAS * math.sqrt(major2), turn
