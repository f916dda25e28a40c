"""A camera that may be exactly that of its camera.yaml, or one as robots are built: two models, weighed by the images.

A file without a stated uncertainty may come from a simulator, or from a camera that was adjusted until no error was
visible; else it is the design of a mirror that leans and stands aside by what is usual. Both models are the
filter of pose and errors with a different prior; as all of it is linear, the one follows from the other by what their
priors differ by, and so does the ratio of their evidences (Bayes factor; nested models: Dickey 1971). The pose is the
mean of both, each as probable as the images make it (Bayesian model averaging: Hoeting et al. 1999).
"""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.camera_errors.base import CameraErrors
from touchline.localization.estimator.filter import Filter
from touchline.localization.estimator.filter_kernels import ERRORS
from touchline.matrices import applied, dot, inverse, log_determinant, plus, times

MAX_LOG_ODDS = 30.0


class ExactCamera:
    """Gives the pose of a filter under both models. Where the file states its uncertainty, that alone holds."""

    def __init__(self, errors: CameraErrors) -> None:
        self._more: FloatArray | None = None
        if errors.exact is not None:
            self._more = errors.exact - np.linalg.inv(errors.prior)
            # before the first image both are equally probable
            self._prior = float(np.linalg.slogdet(errors.prior)[1] + np.linalg.slogdet(errors.exact)[1])

    def pose_of(self, one: Filter) -> tuple[Pose, FloatArray]:
        """Pose and covariance (3, 3), (m, m, rad), field frame: the mean of both models."""
        if self._more is None or not one.initial.learned:
            return one.pose, one.covariance
        covariance = np.empty((3, 3))
        x, y, heading = mean_of_both(one.mean, one.joint, self._more, self._prior, covariance)
        return Pose(one.pose.x + x, one.pose.y + y, wrap_angle(one.pose.heading + heading)), covariance


@njit(cache=True)
def mean_of_both(mean, joint, more, prior, covariance):  # type: ignore[no-untyped-def]
    """Shift of a pose to the mean of both models; fills its covariance (3, 3). mean, joint: of a filter; more: as of
    `as_exact`. prior: logarithm of the determinants of both priors' information, one over the other.
    """
    # copies, as blocks of a matrix lie apart and would be another type to compile for
    pose, crossed, errors = joint[:3, :3].copy(), joint[:3, ERRORS:].copy(), joint[ERRORS:, ERRORS:].copy()
    shift, exact, evidence = as_exact(pose, crossed, errors, mean[ERRORS:], more)
    share = 1.0 / (1.0 + math.exp(-min(max(0.5 * prior + evidence, -MAX_LOG_ODDS), MAX_LOG_ODDS)))
    comparable = math.isfinite(evidence)  # else information is too close to singular
    for a in range(3):
        for b in range(3):
            between = share * (1.0 - share) * (shift[a] * shift[b])
            mixed = pose[a, b] + share * (exact[a, b] - pose[a, b]) + between
            covariance[a, b] = mixed if comparable else pose[a, b]
    return (share * shift[0], share * shift[1], share * shift[2]) if comparable else (0.0, 0.0, 0.0)


@njit(cache=True)
def as_exact(pose, crossed, errors, mean, more):  # type: ignore[no-untyped-def]
    """What follows if the prior of a filter's errors had held so much more information (E, E) of their being 0.

    pose (3, 3), crossed (3, E), errors (E, E): blocks of its covariance; mean (E,): the errors. Returns the shift (3,)
    of the pose, its covariance (3, 3), and the logarithm of how much better the images fit so, but for the share of the
    two priors' own normalisation.
    """
    known = inverse(errors)
    wanted = plus(known, more, 1.0)
    after, by_error = inverse(wanted), times(crossed, known)
    off = applied(after, applied(more, mean))  # of the errors, what of them is taken back: its negative
    for k in range(len(off)):
        off[k] = -off[k]
    fits = dot(applied(known, mean), off) + log_determinant(known) - log_determinant(wanted)
    narrower = times(times(by_error, plus(after, errors, -1.0)), by_error.T)
    return applied(by_error, off), plus(pose, narrower, 1.0), 0.5 * fits
