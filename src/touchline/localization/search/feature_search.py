"""Search for the pose of features without a start: pairs of them propose poses, registration decides."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray, Pose, as_pose, mirrored_covariance
from touchline.localization.camera_errors.base import Response
from touchline.localization.registration.covariance import ANYWHERE_INFORMATION
from touchline.localization.registration.feature_model import FeatureView
from touchline.localization.registration.joint import Seen, StateFit, StatePrior
from touchline.localization.registration.registration import TRACKING, Registration
from touchline.localization.search.feature_poses import PoseProposals
from touchline.localization.search.pose_search import Known, Mode, Wanted, contradiction

STARTS = 24  # proposed poses that are registered
START_M, START_RAD = 0.3, 0.2  # proposals nearer than this are one
SAME_M, SAME_RAD = 0.3, 0.15  # and poses
UNLIKELY = 12.0  # logarithm of odds against the best from which a pose is dropped
MAX_ERROR_Z = 3.3  # standard deviations by which a camera error is believable


class _Registered(NamedTuple):
    """A fit, its pose or that at the other end of the field, and how likely this is with what else is known."""

    fit: StateFit
    pose: Pose
    mirrored: bool
    log_likelihood: float

    def mode(self, probability: float, information: FloatArray) -> Mode:
        """The same as a mode. information: of the prior."""
        fit, covariance = self.fit, np.linalg.inv(self.fit.information + information)[:3, :3]
        covariance = mirrored_covariance(covariance) if self.mirrored else covariance
        return Mode(self.pose, covariance, probability, self.log_likelihood, fit.explained, fit.noise, fit.state[3:])


class FeatureSearch:
    """Finds the poses that explain lines, crossings and landmarks."""

    def __init__(self, proposals: PoseProposals, registration: Registration, symmetric: bool) -> None:
        """symmetric: of a pose and its twin the one that is known of is taken."""
        self.proposals, self.registration, self.symmetric = proposals, registration, symmetric

    def modes(
        self, seen: Seen, views: Sequence[tuple[FloatArray, FeatureView]], expected: StatePrior, response: Response,
        known: Sequence[Known] = (), part: tuple[int, int] = (0, 1), wanted: Wanted | None = None,
    ) -> tuple[Mode, ...]:  # fmt: skip
        """The registered poses, the likeliest first; none of an image that gives no position.

        views: errors (K,) that the camera may have, and the same as `seen` without them. expected: what is known of the
        camera; its pose is not used. known: of the pose. part: which of so many parts of the proposed poses, every nth,
        are registered. wanted: None: every pose.
        """
        information = expected.information.copy()
        information[:3], information[:, :3] = 0.0, 0.0
        information[:3, :3] = ANYWHERE_INFORMATION
        deviations = np.sqrt(np.diag(np.linalg.inv(information))[3:])
        found: list[_Registered] = []
        for errors, view in views:
            proposed = self.proposals.of(view)
            order = np.argsort(-proposed.log_likelihoods, kind="stable")
            for index in distinct(proposed.poses[order], STARTS, START_M, START_RAD)[part[0] :: part[1]]:
                pose = proposed.poses[order[index]]
                if wanted is not None and wanted.excludes(pose.tolist(), self.symmetric):
                    continue
                prior = StatePrior(np.concatenate((pose, expected.mean[3:])), information)
                start = np.concatenate((pose, errors))
                fit = self.registration.fit_state(seen, start, prior, TRACKING, response)
                if wanted is not None and (
                    fit.log_likelihood < wanted.of_all or wanted.excludes(fit.state.tolist(), self.symmetric)
                ):
                    continue
                off = fit.state[3:] - expected.mean[3:]
                if (np.abs(off) <= MAX_ERROR_Z * deviations).all():
                    found.append(self._registered(fit, known))
        if not found:
            return ()
        found.sort(key=lambda one: -one.log_likelihood)
        poses = np.array([(one.pose.x, one.pose.y, one.pose.heading) for one in found])
        kept = [found[k] for k in distinct(poses, STARTS, SAME_M, SAME_RAD)]
        top = kept[0].log_likelihood
        kept = [one for one in kept if one.log_likelihood > top - UNLIKELY]
        total = sum(math.exp(one.log_likelihood - top) for one in kept)
        return tuple(one.mode(math.exp(one.log_likelihood - top) / total, information) for one in kept)

    def _registered(self, fit: StateFit, known: Sequence[Known]) -> _Registered:
        pose = as_pose(fit.state)
        if not known:
            return _Registered(fit, pose, False, fit.log_likelihood)
        against = [sum(contradiction(each, one) for one in known) for each in (pose, pose.mirrored())]
        mirrored = self.symmetric and against[1] < against[0]
        log_likelihood = fit.log_likelihood - against[mirrored]
        return _Registered(fit, pose.mirrored() if mirrored else pose, mirrored, log_likelihood)


@njit(cache=True)
def distinct(poses: FloatArray, count: int, apart_m: float, apart_rad: float) -> IntArray:
    """Indices of poses (N, 3), up to a count, that are none of those before them."""
    kept, number = np.empty(min(count, len(poses)), dtype=np.int64), 0
    for i in range(len(poses)):
        if number == len(kept):
            break
        new = True
        for k in kept[:number]:
            off = poses[i, 2] - poses[k, 2]
            off -= 2.0 * math.pi * math.floor(off / (2.0 * math.pi) + 0.5)
            far = math.hypot(poses[i, 0] - poses[k, 0], poses[i, 1] - poses[k, 1]) > apart_m
            new = new and (far or abs(off) > apart_rad)
        if new:
            kept[number] = i
            number += 1
    return kept[:number]
