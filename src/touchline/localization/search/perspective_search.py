"""Search for the pose of an image without a start: pairs of features propose poses, registration decides."""

from __future__ import annotations

import numpy as np

from touchline.geometry import FloatArray, wrap_angles
from touchline.localization.particles.feature_model import FeatureView
from touchline.localization.registration.perspective_kernels import Known, LeanFit, SeenPoints
from touchline.localization.registration.perspective_registration import PerspectiveRegistration
from touchline.localization.search.feature_poses import PoseProposals

STARTS = 24  # proposed poses that are registered
START_M, START_RAD = 0.3, 0.2  # proposals nearer than this are one
SAME_M, SAME_RAD = 0.3, 0.15  # and poses
UNLIKELY = 12.0  # logarithm of odds against the best from which a pose is dropped
ANYWHERE = np.array([10.0, 10.0, 3.0])  # standard deviations of a pose that is not known (m, m, rad)
REACH_M = 1.0  # a robot stands so far beyond the field's lines at most


class PerspectiveSearch:
    """Finds the poses that explain an image."""

    def __init__(self, proposals: PoseProposals, registration: PerspectiveRegistration) -> None:
        self.proposals, self.registration = proposals, registration

    def everywhere(self, seen: SeenPoints, view: FeatureView, lean: Known) -> list[LeanFit]:
        """The registered poses, the likeliest first; none of an image that tells no position.

        view: the same as `seen`, less the lean that is known. lean: what is known of the camera; its pose is not used.
        """
        proposed = self.proposals.of(view)
        information = lean.information.copy()
        information[:3], information[:, :3] = 0.0, 0.0
        information[:3, :3] = np.diag(ANYWHERE**-2.0)
        found: list[LeanFit] = []
        order = np.argsort(-proposed.log_likelihoods, kind="stable")
        for index in distinct(proposed.poses[order], STARTS, START_M, START_RAD):
            start = lean.mean.copy()
            start[:3] = proposed.poses[order[index]]
            found.append(self.registration.register(seen, start, Known(start, information)))
        found.sort(key=lambda fit: -fit.log_likelihood)
        states = np.array([fit.state[:3] for fit in found]).reshape(-1, 3)
        kept = [found[k] for k in distinct(states, STARTS, SAME_M, SAME_RAD)]
        return [fit for fit in kept if fit.log_likelihood > kept[0].log_likelihood - UNLIKELY]


def distinct(poses: FloatArray, count: int, apart_m: float, apart_rad: float) -> list[int]:
    """Indices of poses (N, 3), up to a count, that are none of those before them."""
    free = np.ones(len(poses), dtype=np.bool_)
    kept: list[int] = []
    while len(kept) < count and free.any():
        k = int(np.argmax(free))
        kept.append(k)
        away = poses - poses[k]
        free &= (np.hypot(away[:, 0], away[:, 1]) > apart_m) | (np.abs(wrap_angles(away[:, 2])) > apart_rad)
        free[k] = False
    return kept
