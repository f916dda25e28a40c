"""How the robot moved by its images alone: each is registered near the one before, whatever the odometry says."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, wrap_angle
from touchline.localization.estimator.bank import Image
from touchline.localization.registration.attitudes import fit_leaning
from touchline.localization.registration.covariance import widest_m
from touchline.localization.registration.joint import StateFit, StatePrior
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.registration import FOLLOWING, UNSETTLED, Registration
from touchline.matrices import add_to, applied, inverse, plus

LOOSE_M, LOOSE_RAD = 0.5, 0.5  # standard deviations of a motion that only images know
MAX_GAP_S = 0.3  # between images that show something, over which a velocity holds
MAX_SPARSE_S = 3.0  # between images all round, over which they are still steps of one chain
MIN_EXPLAINED = 0.8  # share of an image from which no other start is tried
MAX_STEP_M, MAX_STEP_RAD = 0.02, 0.01  # from a fit to the pose by its image alone, which one step finds
# of where the image before and its velocity put the robot, from where a registration comes to the same
NEAR_M, NEAR_RAD = 0.15, 0.1
FAR_M, FAR_RAD = 0.6, 0.6  # between two images no robot moves so
LOST = 5.0  # log-likelihood by which another start is better, from which the chain of images begins anew there
BLURRED_M = 0.04  # standard deviation of a pose from which a sector shows little
SECTOR_RATIO = 2.0  # of the variance of a pose by a few things, each of which may be taken for another
# of an image all round: along an axis that it tells worse it tells nothing; where the pose explains so much of it, only
# along one that it tells so many times worse than the other, or hardly better than was expected
MAX_SIGMA_M, WELL, LONE_RATIO, MAX_TOLD_M, UNKNOWN_M = 0.03, 0.85, 1.5, 0.15, 3.0
LEARNING_S, LEARNED_Z = 4.0, 2.0  # after the first image, and by how many standard deviations of one image
_ANY = np.diag(1.0 / np.square([LOOSE_M, LOOSE_M, LOOSE_RAD]))  # inverse covariance of such a motion


Velocity = tuple[float, float, float]
"""Robot frame (m/s, m/s, rad/s)."""


class Sighting(NamedTuple):
    """A pose (3,) by one image, field frame, and its covariance (3, 3); begun: whether it follows from none before;
    blurred: whether it shows a sector with little in it, which may have been taken for other lines: its error then is
    larger than the covariance knows; learned: whether it has taught that those before were seen by another camera.
    """

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray
    explained: float
    log_likelihood: float
    begun: bool
    blurred: bool = False
    learned: bool = False


class Camera(NamedTuple):
    """Errors (K,) of the camera, and the covariance (K, K) of what those of one image differ by; all_round: whether it
    shows so much of the field that an image fits nowhere else nearby.
    """

    errors: FloatArray
    covariance: FloatArray
    all_round: bool


class VisualMotion:
    """`last`: the newest sighting."""

    def __init__(self, registration: Registration) -> None:
        self._registration = registration
        self.reset()

    def reset(self) -> None:
        """No image was seen."""
        self.last: Sighting | None = None
        self._velocity: FloatArray = np.zeros(3)
        self._first_ns: int | None = None
        self._errors: FloatArray = np.zeros(0)  # of the camera, where the chain of images began

    @property
    def velocity(self) -> Velocity:
        """Of late."""
        heading = 0.0 if self.last is None else float(self.last.pose[2])
        x, y, turn = self._velocity.tolist()
        cosine, sine = math.cos(heading), math.sin(heading)
        return cosine * x + sine * y, cosine * y - sine * x, turn

    def update(self, stamp_ns: int, image: Image, camera: Camera, fit: StateFit, elsewhere: bool) -> Sighting:
        """Take an image. fit: the system's, at whose pose the chain begins, or begins anew; elsewhere: whether it was
        found anew.
        """
        last, found = self.last, fit.state[:3]
        seconds = math.inf if last is None else 1e-9 * (stamp_ns - last.stamp_ns)
        if last is None or seconds > MAX_GAP_S:
            begun = seconds > MAX_SPARSE_S or elsewhere or not camera.all_round
            best = self._registered(stamp_ns, image, camera, found)._replace(begun=begun)
            self._velocity = np.zeros(3)
        else:
            start = last.pose + seconds * self._velocity
            # a stamp that wanders widens the fit along the motion
            alone = _alone(stamp_ns, camera, fit, start) if image.stamp_shift is None else None
            best = alone or self._registered(stamp_ns, image, camera, start, FOLLOWING)
            if alone is None and (best.explained < MIN_EXPLAINED or not camera.all_round):
                moving, still = best, self._registered(stamp_ns, image, camera, last.pose)
                best = max(moving, still, key=lambda one: one.log_likelihood)
                other = self._registered(stamp_ns, image, camera, found)
                if other.log_likelihood > best.log_likelihood + (LOST if camera.all_round else 0.0):
                    best = other._replace(begun=is_far(other.pose, last.pose))
                if not camera.all_round:
                    best = _mixed(best, (moving, still, other))
            if seconds > 0.0:
                self._velocity = difference(best.pose, last.pose) / seconds
        learned = self._learns(stamp_ns, camera)
        if best.begun or learned:
            best = best._replace(begun=True, learned=learned)
            self._errors, self._velocity = camera.errors, np.zeros(3)
        self.last = best
        return best

    def _learns(self, stamp_ns: int, camera: Camera) -> bool:
        """Whether the first images have just taught what a camera differs by: that moves the pose, not the robot."""
        self._first_ns = stamp_ns if self._first_ns is None else self._first_ns
        if camera.all_round or stamp_ns - self._first_ns > 1e9 * LEARNING_S or len(self._errors) != len(camera.errors):
            return False
        off = np.abs(camera.errors - self._errors)
        return bool((off > LEARNED_Z * np.sqrt(np.diag(camera.covariance)))[:2].any())

    def _registered(
        self, stamp_ns: int, image: Image, camera: Camera, start: FloatArray, plan: Plan = UNSETTLED
    ) -> Sighting:
        state, size = np.concatenate((start, camera.errors)), 3 + len(camera.errors)
        expected = StatePrior(state, np.zeros((size, size)))
        _expect(camera.covariance, expected.information)
        joint = fit_leaning(self._registration, image.seen, state, expected, plan, image.response)
        covariance: FloatArray = np.empty((3, 3))
        _spread(joint.information, expected.information, covariance)
        covariance = _told_alone(covariance, joint.explained) if camera.all_round else SECTOR_RATIO * covariance
        blurred = not camera.all_round and widest_m(covariance) > BLURRED_M
        return Sighting(stamp_ns, joint.state[:3], covariance, joint.explained, joint.log_likelihood, False, blurred)


def _alone(stamp_ns: int, camera: Camera, fit: StateFit, start: FloatArray) -> Sighting | None:
    """The pose by an image alone: one Gauss-Newton step from the system's fit, without its prior, which is millimetres
    nearly always. None where the step is larger, where it ends elsewhere than a registration from the image before
    would, where a sector shows little, or where an image all round hardly shows one direction, whose information the
    fit may have less of (`downweight_sparse_direction`).
    """
    if fit.explained < MIN_EXPLAINED:
        return None
    pose, covariance = np.empty(3), np.empty((3, 3))
    image_fit = fit.state, fit.information, fit.gradient
    if not _step_alone(*image_fit, start, camera.errors, camera.covariance, pose, covariance):
        return None
    covariance *= 1.0 if camera.all_round else SECTOR_RATIO
    if widest_m(covariance) > (MAX_SIGMA_M if camera.all_round else BLURRED_M):
        return None
    return Sighting(stamp_ns, pose, covariance, fit.explained, fit.log_likelihood, False)


@njit(cache=True)
def _step_alone(state, information, gradient, start, errors, spread, pose, covariance):  # type: ignore[no-untyped-def]
    """Fill the pose (3,) and its covariance (3, 3) to which one step leads from a fit's state (S,), as if it had begun
    at `start` (3,); whether the step is small and ends near that start. errors (S - 3,), spread: of the camera.
    """
    expected, off = np.zeros(information.shape), np.empty(len(state))
    _expect(spread, expected)
    for a in range(len(state)):
        off[a] = (start[a] if a < 3 else errors[a - 3]) - state[a]
    off[2] -= 2.0 * math.pi * round(off[2] / (2.0 * math.pi))
    step = applied(inverse(plus(information, expected, 1.0)), gradient + applied(expected, off))
    _spread(information, expected, covariance)
    for a in range(3):
        pose[a] = start[a] - off[a] + step[a]
    is_small = math.hypot(step[0], step[1]) <= MAX_STEP_M and abs(step[2]) <= MAX_STEP_RAD
    return is_small and math.hypot(off[0], off[1]) <= NEAR_M and abs(off[2]) <= NEAR_RAD


@njit(cache=True)
def _expect(errors, information):  # type: ignore[no-untyped-def]
    """Fill an inverse covariance (S, S), zeros before, of any motion and of camera errors (S - 3, S - 3)."""
    known = inverse(plus(errors, np.eye(len(errors)), 1e-12))
    add_to(information, _ANY, 1.0)
    for a in range(len(errors)):
        for b in range(len(errors)):
            information[3 + a, 3 + b] = known[a, b]


@njit(cache=True)
def _spread(information, expected, covariance):  # type: ignore[no-untyped-def]
    """Fill the covariance (3, 3) of the pose by an image's information (S, S) and what was expected."""
    spread = inverse(plus(information, expected, 1.0))
    for a in range(3):
        for b in range(3):
            covariance[a, b] = spread[a, b]


def _mixed(best: Sighting, fits: Sequence[Sighting]) -> Sighting:
    """The mean and covariance of fits near the best, by their likelihoods: a few points that may lie on either of two
    lines fit at several places, and each place's own covariance knows nothing of the others.
    """
    near = [one for one in fits if not is_far(one.pose, best.pose)]
    weights = np.exp([one.log_likelihood - best.log_likelihood for one in near])
    weights /= weights.sum()
    offsets = np.array([difference(one.pose, best.pose) for one in near])
    mean = weights @ offsets
    offsets -= mean
    covariance = np.einsum("k,kij->ij", weights, np.array([one.covariance for one in near]))
    return best._replace(pose=best.pose + mean, covariance=covariance + (weights * offsets.T) @ offsets)


def _told_alone(covariance: FloatArray, explained: float) -> FloatArray:
    """Of a pose (3, 3) that explains so much of an image, without what was expected: along a lone line that is all."""
    if widest_m(covariance) <= MAX_SIGMA_M:  # nearly always
        return covariance
    variances, axes = np.linalg.eigh(covariance[:2, :2])
    least2 = max(MAX_SIGMA_M**2, LONE_RATIO**2 * variances[0]) if explained >= WELL else MAX_SIGMA_M**2
    along = axes[:, variances > min(least2, MAX_TOLD_M**2)]
    told = covariance.copy()
    told[:2, :2] += UNKNOWN_M**2 * along @ along.T
    return told


def is_far(one: FloatArray, other: FloatArray) -> bool:
    """Whether no robot moves so from one image to the next."""
    x, y, turn = difference(one, other).tolist()
    return math.hypot(x, y) > FAR_M or abs(turn) > FAR_RAD


def difference(one: FloatArray, other: FloatArray) -> FloatArray:
    """(3,) of two poses, the angle wrapped."""
    off: FloatArray = one - other
    off[2] = wrap_angle(float(off[2]))
    return off
