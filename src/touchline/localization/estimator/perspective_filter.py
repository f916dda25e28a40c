"""The pose of a walking robot with what its camera and its odometry err by: an error-state Kalman filter.

States: x, y (m), heading (rad), field frame; roll and pitch (rad) that the camera has more than it is thought to have,
and the relative errors of its height and of the tangents that it sees (one over its focal length), all four for good;
drift of the odometry's heading (rad/s), as of a gyro's bias;
relative errors of its travel forward and sideways. Roll and pitch err anew in every image besides, and so does every
step of the odometry: both by amounts that are learned.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.registration.perspective_kernels import Known, LeanFit, SeenPoints
from touchline.localization.registration.perspective_registration import PerspectiveRegistration
from touchline.motion.odometry import Motion

MOUNT_RAD = 0.02  # how far a camera is mounted askew, in roll and in pitch: two degrees happen
HEIGHT_RATIO, FOCAL_RATIO = 0.02, 0.02  # how far its height and its focal length are off
TURN_DRIFT_RAD_S = 0.003  # of the heading: ten degrees a minute
TRAVEL_SCALE = 0.05  # of steps
MOUNT_DRIFT_RAD = 0.0003  # how much of it changes in the root of a second, and so on
HEIGHT_DRIFT, FOCAL_DRIFT = 0.0001, 0.00003
TURN_DRIFT_RAD_S_S = 0.0001
TRAVEL_DRIFT = 0.002
SLIP_RATIO, TURN_SLIP_RATIO, BEND_RAD_M = 0.1, 0.1, 0.05  # noise of steps beside the odometry's own
AT_REST_M, AT_REST_RAD = 0.007, 0.001
LEAN_RAD, MIN_LEAN_RAD, MAX_LEAN_RAD = 0.008, 0.002, 0.03  # error of roll and pitch in one image: at first, and limits
LEAN_GAIN = 0.03  # share of an image in what is learned of that
STEP_GAIN = 0.1  # and in how noisy steps are
MIN_STEP_NOISE, MAX_STEP_NOISE = 0.1, 6.0  # of their variance, as a multiple of the stated one
MAX_RATIO = 5.0  # of one image in that: it may be a slip
MIN_POSITION_M, MIN_HEADING_RAD = 0.005, 0.015  # what no image tells: how far a camera is turned aside turns all
ALLOWED = 16.3  # squared deviations from the prediction: 99.9 % of right poses are within
_STATES = 10
_SEEN = 7  # the first of them are those that an image shows
_LEANS = (3, 4)
_CAMERA = np.arange(3, 7)
_TURN, _AHEAD, _LEFT = 7, 8, 9  # of the odometry
_PRIOR = np.array([MOUNT_RAD, MOUNT_RAD, HEIGHT_RATIO, FOCAL_RATIO, TURN_DRIFT_RAD_S, TRAVEL_SCALE, TRAVEL_SCALE])
_DRIFT = np.array(
    [MOUNT_DRIFT_RAD, MOUNT_DRIFT_RAD, HEIGHT_DRIFT, FOCAL_DRIFT, TURN_DRIFT_RAD_S_S, TRAVEL_DRIFT, TRAVEL_DRIFT]
)
TINY = 1e-6  # of the variances of what is not learned


class Fitted(NamedTuple):
    """An image fitted to a filter's prediction; covariance (7, 7) of the fit's state.

    contradiction: squared distance of that state from the prediction, in the prediction's standard deviations;
    distance2: the same of the pose alone. narrowed: logarithm of how much smaller the state's spread has become.
    """

    fit: LeanFit
    covariance: FloatArray
    contradiction: float
    distance2: float
    narrowed: float


class PerspectiveFilter:
    """`state` (10,), `covariance_all` (10, 10) of it, `lean_rad`: standard deviation of roll and pitch in one image.

    `step_noise` (2,): how much larger the variance of the odometry's steps is than stated, of positions and headings.
    """

    def __init__(self, pose: Pose, covariance: FloatArray, learns_camera: bool = True) -> None:
        """covariance (3, 3): of the pose in (m, m, rad), field frame. learns_camera: how it is mounted; else that is
        taken for true.
        """
        self.learns_camera = learns_camera
        self.state = np.zeros(_STATES)
        self.state[:3] = pose
        self.covariance_all = np.diag(np.concatenate((np.zeros(3), _PRIOR**2)))
        self.covariance_all[:3, :3] = covariance
        if not learns_camera:
            self.covariance_all[_CAMERA, _CAMERA] *= TINY
        self.lean_rad = LEAN_RAD
        self.step_noise = np.ones(2)
        self._since_image = np.zeros((3, 3))  # what steps have added to the covariance

    @property
    def pose(self) -> Pose:
        """The best guess."""
        return Pose(float(self.state[0]), float(self.state[1]), wrap_angle(float(self.state[2])))

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of the pose, in (m, m, rad)."""
        floor = np.diag([MIN_POSITION_M, MIN_POSITION_M, MIN_HEADING_RAD]) ** 2
        stated: FloatArray = self.covariance_all[:3, :3] + floor
        return stated

    def placed(self, pose: Pose, covariance: FloatArray) -> PerspectiveFilter:
        """A filter that starts at another pose, and knows the camera and the odometry as this one does."""
        other = PerspectiveFilter(pose, covariance, self.learns_camera)
        other.state[3:], other.lean_rad, other.step_noise = self.state[3:], self.lean_rad, self.step_noise
        other.covariance_all[3:, 3:] = self.covariance_all[3:, 3:]
        return other

    def mirrored(self) -> PerspectiveFilter:
        """That of the twin, half a turn about the centre mark."""
        other = self.placed(self.pose.mirrored(), np.zeros((3, 3)))
        turn = np.diag([-1.0, -1.0, *np.ones(_STATES - 2)])
        other.covariance_all = turn @ self.covariance_all @ turn
        return other

    def starts(self) -> list[Pose]:
        """Poses all about a prediction that is unsure: a told one is off by some decimetres and degrees."""
        dx, dy, dh = 1.2 * np.sqrt(np.diag(self.covariance))
        steps = itertools.product((-dx, 0.0, dx), (-dy, 0.0, dy), (-dh, 0.0, dh))
        x, y, heading = self.pose
        return [Pose(x + ox, y + oy, wrap_angle(heading + oh)) for ox, oy, oh in steps]

    def allows(self, pose: Pose) -> bool:
        """Whether a pose is none that the prediction rules out."""
        away = pose.as_array() - self.state[:3]
        away[2] = wrap_angle(float(away[2]))
        return float(away @ np.linalg.solve(self._seen_covariance(None)[:3, :3], away)) < ALLOWED

    @property
    def known(self) -> Known:
        """What an image shows, before it is seen."""
        return Known(self.state[:_SEEN].copy(), np.linalg.inv(self._seen_covariance(None)))

    def predict(self, motion: Motion, seconds: float) -> None:
        """Move by the odometry over so many seconds."""
        move, heading = motion.pose, self.pose.heading
        ahead, left = move.x * (1.0 + self.state[_AHEAD]), move.y * (1.0 + self.state[_LEFT])
        turned = move.heading + self.state[_TURN] * seconds
        c, s = math.cos(heading), math.sin(heading)
        by_state = np.eye(_STATES)
        by_state[0, 2], by_state[1, 2] = -s * ahead - c * left, c * ahead - s * left
        by_state[0, _AHEAD:], by_state[1, _AHEAD:] = (c * move.x, -s * move.y), (s * move.x, c * move.y)
        by_state[2, _TURN] = seconds
        self.state[:3] = self.pose.compose(Pose(float(ahead), float(left), float(turned)))
        self.covariance_all = by_state @ self.covariance_all @ by_state.T
        travel_m = math.hypot(move.x, move.y)
        aside = (SLIP_RATIO * travel_m) ** 2 + AT_REST_M**2
        aslant = (TURN_SLIP_RATIO * move.heading) ** 2 + (BEND_RAD_M * travel_m) ** 2 + AT_REST_RAD**2
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        scale = np.sqrt(self.step_noise[[0, 0, 1]]) if motion.missing_s == 0.0 else np.ones(3)
        noise = turn @ ((motion.covariance + np.diag([aside, aside, aslant])) * np.outer(scale, scale)) @ turn.T
        self.covariance_all[:3, :3] += noise
        if motion.missing_s == 0.0:
            self._since_image = self._since_image + noise
        drifts = _DRIFT**2
        drifts[: len(_CAMERA)] *= 1.0 if self.learns_camera else TINY
        self.covariance_all[3:, 3:] += np.diag(seconds * drifts)

    def fitted(
        self,
        registration: PerspectiveRegistration,
        seen: SeenPoints,
        shove: FloatArray | None = None,
        start: Pose | None = None,
    ) -> Fitted:
        """An image registered from a start, by default the prediction. shove (3,): standard deviations by which the
        robot may have moved unfelt beside it.
        """
        spread = self._seen_covariance(shove)
        information = np.linalg.inv(spread)
        mean = self.state[:_SEEN]
        begin = mean.copy()
        if start is not None:
            begin[:3] = start.x, start.y, mean[2] + wrap_angle(start.heading - float(mean[2]))
        fit = registration.register(seen, begin, Known(mean, information))
        covariance = np.linalg.inv(information + fit.information)
        step = fit.state - mean
        distance2 = float(step[:3] @ np.linalg.solve(spread[:3, :3], step[:3]))
        narrowed = 0.5 * float(np.linalg.slogdet(spread)[1] - np.linalg.slogdet(covariance)[1])
        return Fitted(fit, covariance, float(step @ information @ step), distance2, narrowed)

    def take(self, fitted: Fitted, shove: FloatArray | None = None) -> None:
        """Fuse an image that was fitted with the same shove."""
        if shove is not None:
            self.covariance_all[:3, :3] += np.diag(shove**2)
        spread, step = self._seen_covariance(None), fitted.fit.state - self.state[:_SEEN]
        self._learn_lean(fitted)
        self._learn_steps(fitted, spread)
        gain = np.linalg.solve(spread, self.covariance_all[:_SEEN]).T
        self.state = self.state + gain @ step
        self.state[2] = wrap_angle(float(self.state[2]))
        after = self.covariance_all - gain @ (spread - fitted.covariance) @ gain.T
        self.covariance_all = 0.5 * (after + after.T)

    def _seen_covariance(self, shove: FloatArray | None) -> FloatArray:
        """(7, 7) of what an image shows before it is seen: its own lean error included."""
        spread = self.covariance_all[:_SEEN, :_SEEN].copy()
        for k in _LEANS:
            spread[k, k] += self.lean_rad**2
        if shove is not None:
            spread[:3, :3] += np.diag(shove**2)
        return spread

    def _learn_lean(self, fitted: Fitted) -> None:
        """How much the lean errs in one image: its squared error in this one, and what is unknown of that."""
        seen = 0.0
        for k in _LEANS:
            total = self.covariance_all[k, k] + self.lean_rad**2
            share = self.lean_rad**2 / total
            error = share * (fitted.fit.state[k] - self.state[k])
            seen += 0.5 * (error**2 + self.lean_rad**2 * (1.0 - share) + share**2 * fitted.covariance[k, k])
        learned = (1.0 - LEAN_GAIN) * self.lean_rad**2 + LEAN_GAIN * seen
        self.lean_rad = min(max(math.sqrt(learned), MIN_LEAN_RAD), MAX_LEAN_RAD)

    def _learn_steps(self, fitted: Fitted, spread: FloatArray) -> None:
        """How noisy steps are: their squared errors since the last image, and what is unknown of those."""
        noise, self._since_image = self._since_image, np.zeros((3, 3))
        if not noise[2, 2]:
            return
        share = np.linalg.solve(spread, np.eye(_SEEN)[:, :3] @ noise)  # (7, 3) of the image's step in these errors
        step = fitted.fit.state - self.state[:_SEEN]
        squares = noise + share.T @ (np.outer(step, step) - spread + fitted.covariance) @ share
        ratios = np.array([(squares[0, 0] + squares[1, 1]) / (noise[0, 0] + noise[1, 1]), squares[2, 2] / noise[2, 2]])
        learned = self.step_noise * (1.0 + STEP_GAIN * (np.minimum(ratios, MAX_RATIO) - 1.0))
        self.step_noise = np.clip(learned, MIN_STEP_NOISE, MAX_STEP_NOISE)
