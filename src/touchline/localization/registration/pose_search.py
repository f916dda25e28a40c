"""Search for the pose of line points without a start: every heading and position, coarse to fine, every mode kept.

Coarse: the mean error of every pose of a grid, by look-ups in a table (`CoarseSearch`). Fine: registration from the
best of them. What is left are the modes of the likelihood; each one's probability is its share of the whole, by
Laplace's approximation (the likelihood at the top times the volume of its covariance).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, mirrored_covariance, wrap_angle
from touchline.localization.matching.coarse_search import CoarseSearch, Window
from touchline.localization.matching.pose_grid import PoseGrid
from touchline.localization.registration.registration import FINISHING, SEARCHING, Registered, Registration

SPACING_M, SPACING_RAD = 0.4, math.radians(7.5)  # of the grid; a registration begins half of that off at most
BEYOND_M = 0.5  # the grid reaches so far beyond the lines
WIDTH_M = 0.25  # of the coarse error function
STARTS = 40  # poses of the grid that are registered
NEAR_STARTS = 25  # and so many of a search near a pose
FINISHED = 10  # of those, the likeliest distinct ones that are registered to the end
UNLIKELY = 9.0  # logarithm of odds against the best from which a mode is dropped
SAME_M, SAME_RAD = 0.1, 0.05  # poses nearer than this are one mode
COARSE_POINTS = 90  # so many at most, evenly taken, tell the coarse errors
SEARCH_POINTS = 60  # and so many which of the starts are worth registering to the end
HOPELESS = 25.0  # logarithm of odds against the best from which a start is not
MOST_CONTRADICTION = 4.0  # what something known speaks against a pose, at most: one compass in fifty is false


class Known(NamedTuple):
    """What is known of the pose beside the points: pose (3,) and inverse covariance (3, 3), 0 for what is not known."""

    pose: FloatArray
    information: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Mode:
    """A pose that explains the points, its covariance (3, 3) in (m, m, rad), field frame, and its probability.

    log_likelihood, explained, noise: as of `Registered`.
    """

    pose: Pose
    covariance: FloatArray
    probability: float
    log_likelihood: float
    explained: float
    noise: float


class PoseSearch:
    """Finds all poses that explain line points; arguments as `Registration` takes them."""

    def __init__(self, field: FieldModel, registration: Registration) -> None:
        self.registration = registration
        self.symmetric = field.is_symmetric
        self._grid = PoseGrid(field.length, field.width, SPACING_M, BEYOND_M, SPACING_RAD)
        self._coarse = CoarseSearch(field.distance_map(), self._grid, WIDTH_M)

    def everywhere(
        self, positions_m: FloatArray, covariances_m2: FloatArray, known: Known | None = None
    ) -> tuple[Mode, ...]:
        """Modes on the whole field, the likeliest first; () without points."""
        rows, columns = self._grid.shape
        # on a symmetric field one half shows all, and a pose of the other is one's twin
        first = rows // 2 if self.symmetric else 0
        window = Window(first, rows - first, 0, columns, self._grid.headings)
        return self._modes(positions_m, covariances_m2, window, STARTS, known, self.symmetric)

    def facing(
        self, positions_m: FloatArray, covariances_m2: FloatArray, heading_rad: float, sigma_rad: float
    ) -> tuple[Mode, ...]:
        """Modes on the whole field with about a heading: within three of its standard deviations."""
        headings = _around(heading_rad, 3.0 * sigma_rad + SPACING_RAD)
        window = Window(0, self._grid.shape[0], 0, self._grid.shape[1], headings)
        known = Known(np.array([0.0, 0.0, heading_rad]), np.diag([0.0, 0.0, 1.0 / sigma_rad**2]))
        return self._modes(positions_m, covariances_m2, window, STARTS, known)

    def near(
        self, positions_m: FloatArray, covariances_m2: FloatArray, start: FloatArray, reach_m: float, reach_rad: float
    ) -> tuple[Mode, ...]:
        """Modes within reach of a pose (3,)."""
        low, high = (
            np.rint((start[:2] - self._grid.positions[0] + side * reach_m) / SPACING_M).astype(int) for side in (-1, 1)
        )
        last = np.array(self._grid.shape) - 1
        low, high = np.clip(low, 0, last), np.clip(high, 0, last)
        rows, columns = (int(size) for size in high - low + 1)
        window = Window(int(low[0]), rows, int(low[1]), columns, _around(float(start[2]), reach_rad))
        return self._modes(positions_m, covariances_m2, window, NEAR_STARTS)

    def _modes(
        self,
        points: FloatArray,
        covariances: FloatArray,
        window: Window,
        most_starts: int,
        known: Known | None = None,
        twins: bool = False,
    ) -> tuple[Mode, ...]:
        if len(points) == 0:
            return ()
        starts = self._coarse.best(_some(points, COARSE_POINTS), most_starts, window, neighbours=0)
        some, spreads = _some(points, SEARCH_POINTS), _some(covariances, SEARCH_POINTS)
        poses, likelihoods = self.registration.register_all(some, spreads, starts, SEARCHING)
        order = np.argsort(-likelihoods)
        order = order[likelihoods[order] > likelihoods[order[0]] - HOPELESS]
        picked = _distinct(poses[order], FINISHED, twins)
        found = [self.registration.register(points, covariances, pose, FINISHING) for pose in poses[order][picked]]
        found = [found[k] for k in _distinct(np.array([one.pose for one in found]), FINISHED, twins)]
        return _with_probabilities(found, known, twins)


def _some(rows: FloatArray, count: int) -> FloatArray:
    """Every k-th of the rows, so that at most a count of them is left."""
    return rows if len(rows) <= count else np.ascontiguousarray(rows[:: -(-len(rows) // count)])


def _around(heading_rad: float, reach_rad: float) -> FloatArray:
    """Headings from a reach on one side to that on the other, as far apart as the grid's."""
    each_side = math.ceil(reach_rad / SPACING_RAD)
    return heading_rad + np.linspace(-reach_rad, reach_rad, 2 * each_side + 1)


def _distinct(poses: FloatArray, count: int, twins: bool) -> list[int]:
    """Indices of poses (N, 3), up to count, that are none of those before them; twins: nor the twin of one."""
    same = _same(poses, poses)
    if twins:
        same |= _same(poses * np.array([-1.0, -1.0, 1.0]) + np.array([0.0, 0.0, math.pi]), poses)
    free = np.ones(len(poses), dtype=np.bool_)
    kept: list[int] = []
    for k in range(len(poses)):
        if free[k] and len(kept) < count:
            kept.append(k)
            free &= ~same[k]
    return kept


def _same(poses: FloatArray, others: FloatArray) -> npt.NDArray[np.bool_]:
    """(N, M) whether poses (N, 3) and others (M, 3) are one."""
    away = np.abs(poses[:, np.newaxis] - others)
    turned = np.abs(np.remainder(away[:, :, 2] + math.pi, 2.0 * math.pi) - math.pi)
    same: npt.NDArray[np.bool_] = (away[:, :, 0] < SAME_M) & (away[:, :, 1] < SAME_M) & (turned < SAME_RAD)
    return same


def _with_probabilities(found: list[Registered], known: Known | None, twins: bool) -> tuple[Mode, ...]:
    """Modes with their shares of the likelihood, the unlikely ones left out; twins: each one's twin among them."""
    candidates = []
    for one in found:
        volume = 0.5 * float(np.linalg.slogdet(one.covariance)[1])
        pose = Pose(float(one.pose[0]), float(one.pose[1]), wrap_angle(float(one.pose[2])))
        both = [(pose, one.covariance), (pose.mirrored(), mirrored_covariance(one.covariance))]
        for place, covariance in both if twins else both[:1]:
            log_odds = one.log_likelihood + volume - _contradiction(place, known)
            candidates.append((log_odds, place, covariance, one))
    best = max(log_odds for log_odds, *_ in candidates)
    kept = [each for each in candidates if each[0] > best - UNLIKELY]
    total = sum(math.exp(each[0] - best) for each in kept)
    modes = [
        Mode(pose, covariance, math.exp(log_odds - best) / total, one.log_likelihood, one.explained, one.noise)
        for log_odds, pose, covariance, one in kept
    ]
    return tuple(sorted(modes, key=lambda mode: -mode.probability))


def _contradiction(pose: Pose, known: Known | None) -> float:
    """How much something known speaks against a pose: logarithm of a likelihood ratio."""
    if known is None:
        return 0.0
    away = pose.as_array() - known.pose
    away[2] = wrap_angle(float(away[2]))
    return min(0.5 * float(away @ known.information @ away), MOST_CONTRADICTION)
