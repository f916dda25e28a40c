"""Poses of an observation with lines, crossings and landmarks: search and joint fit of our own system.

Pose and errors of the camera are fitted to all that is seen, so that a corner, a post or a penalty mark settles what
line points leave open, and a camera that leans otherwise than it is thought to does not bend the lines.
"""

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from touchline.camera import Camera
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, as_pose, wrap_angles
from touchline.localization.camera_errors import camera_errors
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.camera_errors.perspective import HEIGHT_M
from touchline.localization.registration.attitudes import KNOWN_RAD
from touchline.localization.registration.covariance import ANYWHERE_INFORMATION, widest_m
from touchline.localization.registration.feature_model import FeatureView, best_place
from touchline.localization.registration.joint import StateFit, StatePrior
from touchline.localization.registration.registration import TRACKING
from touchline.localization.registration.seen import seen_of
from touchline.localization.search.field_search import FieldSearch, Searched
from touchline.localization.search.pose_search import Known
from touchline.types import Observation

ATTITUDES = 49  # of a perspective camera that are searched: all of the grid
EXACT2 = 1e-14  # variance of an error of the camera that is known exactly
MIN_CONFIDENCE = 0.5  # of a feature that contradicts a pose
MAX_CHI2 = (
    9.5  # of the camera's errors: the 95 % quantile with 4 degrees of freedom; right poses leave 3, wrong ones 11
)
MIN_EXPLAINED = 0.9  # share of what is seen; right poses in photographs leave 0.97
TURN, MAX_TURN = 0.25, 3.0  # deviations of roll and pitch: step, and how far from a fit they are turned
MAX_LOG_RATIO = 4.5  # of how likely the fit is and how likely a turned one: three standard deviations
FIXED_INFORMATION = 1e9  # of a turn, 1/rad²
OPEN_M = 0.2  # standard deviation of the place by roll and pitch above which the pose is doubted


_search_of = functools.lru_cache(maxsize=4)(FieldSearch)  # of a field: 10 ms of each further observation


class JointFit(NamedTuple):
    """A pose with its covariance (3, 3) in (m, m, rad), the camera's errors (K,), the covariance (3 + K, 3 + K) of pose
    and errors, the log-likelihood of all that is seen and of these, and the share of what is seen that lies where it
    should.

    open_m: by how much roll and pitch of the camera leave the place open, where `opened` has looked.
    """

    pose: Pose
    covariance: FloatArray
    errors: FloatArray
    joint: FloatArray
    log_likelihood: float
    explained: float
    open_m: float = 0.0


class JointSearch:
    """Searches a field for the pose of one observation, and says what contradicts it."""

    def __init__(self, field: FieldModel, observation: Observation, camera: Camera | None) -> None:
        """camera: None if it is unknown; with line points that of a mirror, else a perspective one."""
        self._search = search = _search_of(field)
        self.errors = camera_errors(camera, HEIGHT_M if camera is None and not len(observation.points) else None)
        self._features = search.features_at(self.errors.height_m)
        self._observation, self._response = observation, self.errors.response()
        self.seen = seen_of(observation, self._features, 1.0)
        variances = np.diag(self.errors.prior).copy()
        variances[:2] += self.errors.lean.first**2
        self._deviations = np.sqrt(np.maximum(variances, EXACT2))
        information = np.diag(np.concatenate((np.diag(ANYWHERE_INFORMATION), self._deviations**-2.0)))
        self._prior = StatePrior(np.zeros(len(information)), information)

    def fits(self, starts: Sequence[Pose], known: Known | None = None) -> list[JointFit]:
        """From the poses that the search finds and from starts, the likeliest first. known: of the pose."""
        seen, all_round = self.seen, self.errors.trust.free_fit
        prior, response = self._prior, self._response
        searched = Searched(seen, self._view_at, seen.positions_m, prior, response, all_round, ATTITUDES)
        modes = self._search.modes(searched, () if known is None else (known,))
        from_modes = [(mode.pose, self._prior.mean[3:] if mode.errors is None else mode.errors) for mode in modes]
        found = (*from_modes, *self._by_points(searched), *((pose, self._prior.mean[3:]) for pose in starts))
        fits = [self._fit(*start) for start in found]
        return sorted(fits, key=lambda one: -one.log_likelihood)

    def _by_points(self, searched: Searched) -> Iterator[tuple[Pose, FloatArray]]:
        """Poses at which line points lie on lines with the camera at each attitude, and that as errors (K,) of it."""
        if searched.all_round:
            return
        for errors in self._search.attitudes(searched):
            points = placed_points(self.seen.positions_m, errors, self._response)
            for mode in self._search.points.everywhere(points, self.seen.covariances_m2):
                yield mode.pose, errors

    def _view_at(self, errors: FloatArray) -> FeatureView:
        """The features without errors (K,) of the camera."""
        return self._features.of(self._observation, lambda points: placed_points(points, errors, self._response))

    def refits(self, fits: Sequence[JointFit]) -> list[JointFit]:
        """From fits to another observation of the same image, the likeliest first."""
        return sorted((self._fit(one.pose, one.errors) for one in fits), key=lambda one: -one.log_likelihood)

    def opened(self, fit: JointFit, allowed: Callable[[Pose], bool] = lambda pose: True) -> JointFit:
        """A fit whose covariance holds the places that other rolls and pitches of the camera leave as likely.
        allowed: whether a pose may be it.

        Few lines fit along a ridge that is bent: the covariance at one place on it tells its width, but not how far it
        goes. So the camera is turned step by step, both ways along both axes of what is known of its roll and pitch,
        and all else is fitted from the step before.
        """
        if self.errors.trust.free_fit or self._deviations[:2].max() < KNOWN_RAD:
            return fit
        leans, across = fit.joint[3:5, 3:5], fit.joint[:3, 3:5]
        gaussian, spread = across @ np.linalg.solve(leans, across.T), np.zeros((3, 3))
        for axis in np.linalg.eigh(leans)[1].T:
            turned = [fit, *self._turned(fit, axis, allowed), *self._turned(fit, -axis, allowed)]
            shares = np.exp([min(one.log_likelihood - fit.log_likelihood, 0.0) for one in turned])
            moved = np.array([[*one.pose] for one in turned]) - [*fit.pose]
            moved[:, 2] = wrap_angles(moved[:, 2])
            spread += (shares / shares.sum() * moved.T) @ moved
        if widest_m(spread) <= widest_m(gaussian):  # the covariance holds it already
            return fit
        return fit._replace(covariance=fit.covariance - gaussian + spread, open_m=widest_m(spread))

    def _turned(self, fit: JointFit, axis: FloatArray, allowed: Callable[[Pose], bool]) -> Iterator[JointFit]:
        """Fits with the camera turned further and further along an axis (2,) of roll and pitch, as long as likely."""
        step = TURN * axis * float(np.hypot(*(self._deviations[:2] * axis)))
        information, last = self._prior.information.copy(), fit
        information[3:5, 3:5] += FIXED_INFORMATION * np.outer(axis, axis)
        for k in range(1, round(MAX_TURN / TURN) + 1):
            mean, errors = np.zeros(len(information)), last.errors.copy()
            pull = FIXED_INFORMATION * axis * float(axis @ (fit.errors[:2] + k * step))
            mean[3:5] = np.linalg.solve(information[3:5, 3:5], pull)
            errors[:2] += step
            last = self._fit(last.pose, errors, StatePrior(mean, information))
            if last.log_likelihood < fit.log_likelihood - MAX_LOG_RATIO or not allowed(last.pose):
                return
            yield last

    def corrected(self, fit: JointFit) -> FloatArray:
        """The line points (N, 2), robot frame, as a camera without the errors of a fit would have seen them."""
        return self.placed(self.seen.positions_m, fit)

    def placed(self, points_m: FloatArray, fit: JointFit) -> FloatArray:
        """Points (N, 2), robot frame, as a camera without the errors of a fit would have seen them."""
        return placed_points(points_m, fit.errors, self._response)

    def doubts(self, fit: JointFit) -> tuple[str, ...]:
        """What contradicts a fit, a sentence each: features that are none of the field's there, a camera far off."""
        return (*self._contradicting(fit), *self._of_camera(fit))

    def _fit(self, start: Pose, errors: FloatArray, prior: StatePrior | None = None) -> JointFit:
        """From a pose and errors (K,) of the camera. prior: of the errors; none: what is known of them."""
        prior = prior or self._prior
        prior = prior._replace(mean=np.array([*start, *prior.mean[3:]]))
        state = np.array([*start, *errors])
        fit: StateFit = self._search.registration.fit_state(self.seen, state, prior, TRACKING, self._response)
        every = np.linalg.inv(fit.information + prior.information)
        covariance = every[:3, :3] + np.diag(np.square(self.errors.floor))
        strain = 0.5 * float(np.sum(np.square(fit.state[3:] / self._deviations)))
        likelihood = fit.log_likelihood - strain
        return JointFit(as_pose(fit.state), covariance, fit.state[3:].copy(), every, likelihood, fit.explained)

    def _contradicting(self, fit: JointFit) -> list[str]:
        pose, points, found = fit.pose, self.seen.features, []
        placed = placed_points(self.seen.raw_m, fit.errors, self._response)
        points = points._replace(positions_m=placed)
        turned = (*pose, math.cos(pose.heading), math.sin(pose.heading))
        for i, kind in enumerate(self._features.kinds_of(self._observation)):
            place, least, _ = best_place(points, i, self._search.places.tables, False, turned)
            likely = points.peaks[i] * math.exp(-least) if place >= 0 else 0.0
            if points.trust[i] >= MIN_CONFIDENCE and likely < points.floors[i]:
                found.append(
                    f"the {kind} seen {np.hypot(*placed[i]):.1f} m away at "
                    f"{math.degrees(math.atan2(placed[i, 1], placed[i, 0])):.0f}° is none of the field's"
                )
        return found

    def _of_camera(self, fit: JointFit) -> list[str]:
        """Errors of the camera that are larger than they should be, and what is explained in spite of them."""
        found, ratios = [], fit.errors / self._deviations
        if fit.open_m > OPEN_M:
            found.append(
                "so few lines do not tell the camera's roll and pitch, and without these leave the place open by "
                f"± {fit.open_m:.1f} m"
            )
        if float(ratios @ ratios) > MAX_CHI2:
            k = int(np.argmax(np.abs(ratios)))
            found.append(f"what is seen fits only if the camera's {self.errors.names[k]} is {fit.errors[k]:+.3f} off")
        if fit.explained < MIN_EXPLAINED:
            found.append(
                f"{100.0 * (1.0 - fit.explained):.0f} % of what is seen lies beside the field's lines and marks"
            )
        return found
