"""Search for the pose of line points without a start: every heading and position, coarse to fine, every mode kept.

Coarse: the mean error of every pose of a grid, by look-ups in a table (`CoarseSearch`). Fine: registration from the
best of them. What is left are the modes of the likelihood; each one's probability is its share of the whole, by
Laplace's approximation (the likelihood at the top times the volume of its covariance). Lines that a pose predicts where
none was seen (`unseen`) count against it: half a view fits many places, until what else should be there is compared.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from touchline.field import FieldModel
from touchline.geometry import FloatArray, IndexArray, Pose, mirrored_covariance, wrap_angle
from touchline.localization.registration.kernels import Fits
from touchline.localization.registration.registration import FINISHING, SEARCHING, Registration, covariances_of
from touchline.localization.registration.unseen import UNSEEN, View, unseen, view_of
from touchline.localization.search.coarse_search import CoarseSearch, Window
from touchline.localization.search.distinct import distinct, overlaps
from touchline.localization.search.pose_grid import PoseGrid

SPACING_M, SPACING_RAD = 0.4, math.radians(7.5)  # of the grid; a registration begins half of that off at most
BEYOND_M = 0.5  # the grid reaches so far beyond the lines
WIDTH_M = 0.25  # of the coarse error function
# poses of the grid that are registered, and of those the likeliest distinct ones that are registered to the end; of a
# whole view, and as many times more of a narrower one, which fits more places
STARTS, FINISHED = 50, 24
MIN_VIEW_RATIO = 0.25  # of the whole view, beyond which there are no more of them
CLOSE_STARTS = 30  # so many of the starts may be neighbours on the grid
NEAR_STARTS = 25  # of a search near a pose
UNLIKELY = 7.0  # logarithm of odds against the best from which a mode is dropped
SAME = 0.1, 0.05  # m, rad: poses nearer than this are one mode
COARSE_POINTS = 90  # so many at most, evenly taken, give the coarse errors
SEARCH_POINTS = 60  # and so many, of a narrower view as many times fewer, which starts are worth more
MIN_POINTS = 20  # at least for that
HOPELESS = 25.0  # logarithm of odds against the best from which a start is not
# so much more of log-likelihood may a start have once it is registered to the end: 95 of 100 that come to the pose that
# is followed gain less, and others beside them come to it, too
UNFINISHED = 150.0
# so many points count as one: what the likelihoods leave out is shared between points. Fitted to how often modes of
# half views and sectors of 120 degrees are right (temperature scaling: Guo et al. 2017)
TEMPERATURE = 1.5
MAX_CONTRADICTION = 4.0  # largest contradiction by something known: one compass in fifty is false


class Known(NamedTuple):
    """What is known of the pose beside the points: pose (3,) and inverse covariance (3, 3), 0 for what is not known."""

    pose: FloatArray
    information: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Mode:
    """A pose that explains the points, its covariance (3, 3) in (m, m, rad), field frame, and its probability.

    log_likelihood: of the points, and of the lines that were not seen. explained, noise: as of `Registered`.
    errors (K,): of the camera there, of a mode of features.
    """

    pose: Pose
    covariance: FloatArray
    probability: float
    log_likelihood: float
    explained: float
    noise: float
    errors: FloatArray | None = None

    def mirrored(self) -> Mode:
        """The same at the other end of a symmetric field."""
        return replace(self, pose=self.pose.mirrored(), covariance=mirrored_covariance(self.covariance))


class Wanted(NamedTuple):
    """Of a search while a pose (3,) is followed: other poses that explain an image as well, or nearly so. of_points,
    of_all: log-likelihood, of line points and of all that is seen, below which one is not wanted.
    """

    followed: FloatArray
    of_points: float
    of_all: float

    def excludes(self, pose: Sequence[float], twins: bool) -> bool:
        """Whether a pose is the one that is followed, or, with twins, that at the other end of the field."""
        x, y, heading = self.followed.tolist()
        for side, turned in ((1.0, heading), (-1.0, heading + math.pi))[: 1 + twins]:
            off = math.hypot(pose[0] - side * x, pose[1] - side * y)
            if off < SAME[0] and abs(wrap_angle(pose[2] - turned)) < SAME[1]:
                return True
        return False


class PoseSearch:
    """Finds all poses that explain line points; arguments as `Registration` takes them."""

    def __init__(self, field: FieldModel, registration: Registration) -> None:
        self.registration = registration
        self.symmetric = field.is_symmetric
        self._lines = field.line_tables
        self._grid = PoseGrid(field.length, field.width, SPACING_M, BEYOND_M, SPACING_RAD)
        self._coarse = CoarseSearch(field.distance_map(), self._grid, WIDTH_M)

    def everywhere(
        self,
        positions_m: FloatArray,
        covariances_m2: FloatArray,
        known: Sequence[Known] = (),
        part: tuple[int, int] = (0, 1),
        wanted: Wanted | None = None,
    ) -> tuple[Mode, ...]:
        """Modes on the whole field, the likeliest first; () without points.

        part: which of so many parts of the headings, so that a search can be shared out among images. wanted: None:
        every mode.
        """
        (index, parts), headings = part, self._grid.headings
        headings = headings[index * len(headings) // parts : (index + 1) * len(headings) // parts]
        rows, columns = self._grid.shape
        # on a symmetric field one half shows all, and a pose of the other is one's twin
        first = rows // 2 if self.symmetric else 0
        window, most = Window(first, rows - first, 0, columns, headings), (STARTS // parts, FINISHED // parts)
        return self._modes(positions_m, covariances_m2, window, most, known, self.symmetric, wanted)

    def facing(
        self, positions_m: FloatArray, covariances_m2: FloatArray, heading_rad: float, sigma_rad: float
    ) -> tuple[Mode, ...]:
        """Modes on the whole field with about a heading: within three of its standard deviations."""
        headings = _around(heading_rad, 3.0 * sigma_rad + SPACING_RAD)
        window = Window(0, self._grid.shape[0], 0, self._grid.shape[1], headings)
        known = Known(np.array([0.0, 0.0, heading_rad]), np.diag([0.0, 0.0, 1.0 / sigma_rad**2]))
        return self._modes(positions_m, covariances_m2, window, (STARTS, FINISHED), (known,))

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
        return self._modes(positions_m, covariances_m2, window, (NEAR_STARTS, FINISHED))

    def starts(self, points: FloatArray, count: int, heading: tuple[float, float] | None = None) -> FloatArray:
        """The poses of the grid (up to count, 3) at which points (N, 2), all alike, lie nearest to the lines, no two of
        them neighbours; of a symmetric field one half. heading: and how far from it (rad); None: any.
        """
        rows, columns = self._grid.shape
        first = rows // 2 if self.symmetric and heading is None else 0
        headings = self._grid.headings if heading is None else _around(*heading)
        return self._coarse.best(points, count, Window(first, rows - first, 0, columns, headings))

    def _modes(
        self,
        points: FloatArray,
        covariances: FloatArray,
        window: Window,
        most: tuple[int, int],
        known: Sequence[Known] = (),
        twins: bool = False,
        wanted: Wanted | None = None,
    ) -> tuple[Mode, ...]:
        if len(points) == 0:
            return ()
        view: View = view_of(points)
        share = max(float(view.looked.mean()), MIN_VIEW_RATIO)
        most_starts, most_finished = (round(count / share) for count in most)
        starts = self._starts(points, window, most_starts)
        few = max(round(SEARCH_POINTS * share), MIN_POINTS)
        some, spreads = _some(points, few), _some(covariances, few)
        first = self.registration.register_all(some, spreads, starts, SEARCHING)
        if wanted is not None:
            of_points = len(points) / len(some) * first.log_likelihoods
            rows = np.flatnonzero(of_points > wanted.of_points - UNFINISHED).tolist()
            rows = [row for row in rows if not wanted.excludes(first.poses[row].tolist(), twins)]
            if not rows:
                return ()
            first = _picked(first, np.array(rows))
        first = self._likely(first, view, len(some) / len(points))
        kept = distinct(first.poses, first.information, SAME, twins, most_finished)
        fits = self.registration.register_all(points, covariances, first.poses[kept], FINISHING)
        fits = self._likely(fits, view, 1.0)
        kept = distinct(fits.poses, fits.information, SAME, twins, len(fits.poses))
        modes = _with_probabilities(_picked(fits, kept), known, twins)
        if wanted is None:
            return modes
        modes = tuple(mode for mode in modes if mode.log_likelihood > wanted.of_points)
        return tuple(mode for mode in modes if not wanted.excludes(mode.pose, twins))

    def _likely(self, fits: Fits, view: View, share: float) -> Fits:
        """Those that are not hopeless, the likeliest first, by the points and by what was not seen of the lines.

        share: of the points, that the fits are to; what was not seen counts no more.
        """
        hopeful = fits.log_likelihoods > fits.log_likelihoods.max() - HOPELESS
        fits = _picked(fits, np.flatnonzero(hopeful))
        fits = fits._replace(
            log_likelihoods=fits.log_likelihoods - share * UNSEEN * unseen(self._lines, view, fits.poses)
        )
        return _picked(fits, np.argsort(-fits.log_likelihoods))

    def _starts(self, points: FloatArray, window: Window, count: int) -> FloatArray:
        """The likeliest of the grid (K, 3): some of them close together, as many again apart from each other."""
        errors = self._coarse.errors(_some(points, COARSE_POINTS), window)
        close = min(count, CLOSE_STARTS)
        together = self._coarse.smallest(errors, close, window, neighbours=0)
        if close == count:
            return together
        return np.concatenate((together, self._coarse.smallest(errors, count - close, window, neighbours=1)))


def _picked(fits: Fits, rows: IndexArray) -> Fits:
    return Fits(*(values[rows] for values in fits))


def _some(rows: FloatArray, count: int) -> FloatArray:
    """Every k-th of the rows, so that at most a count of them is left."""
    return rows if len(rows) <= count else np.ascontiguousarray(rows[:: -(-len(rows) // count)])


def _around(heading_rad: float, reach_rad: float) -> FloatArray:
    """Headings from a reach on one side to that on the other, as far apart as the grid's."""
    each_side = math.ceil(reach_rad / SPACING_RAD)
    return heading_rad + np.linspace(-reach_rad, reach_rad, 2 * each_side + 1)


def _with_probabilities(fits: Fits, known: Sequence[Known], twins: bool) -> tuple[Mode, ...]:
    """Modes with their shares of the likelihood, the unlikely ones left out; twins: each one's twin among them."""
    covariances = covariances_of(fits)
    volumes = 0.5 * np.linalg.slogdet(covariances)[1] - np.log(overlaps(fits.poses, fits.information, twins))
    candidates = []
    for k, log_odds in enumerate((fits.log_likelihoods / TEMPERATURE + volumes).tolist()):
        x, y, heading = fits.poses[k].tolist()
        pose = Pose(x, y, wrap_angle(heading))
        both = [(pose, covariances[k]), (pose.mirrored(), mirrored_covariance(covariances[k]))]
        for place, covariance in both if twins else both[:1]:
            candidates.append((log_odds - sum(contradiction(place, one) for one in known), place, covariance, k))
    best = max(log_odds for log_odds, *_ in candidates)
    kept = [each for each in candidates if each[0] > best - UNLIKELY]
    total = sum(math.exp(each[0] - best) for each in kept)
    judged = np.column_stack((fits.log_likelihoods, fits.explained, fits.noise)).tolist()
    modes = [
        Mode(pose, covariance, math.exp(log_odds - best) / total, *judged[k]) for log_odds, pose, covariance, k in kept
    ]
    return tuple(sorted(modes, key=lambda mode: -mode.probability))


def contradiction(pose: Pose, known: Known) -> float:
    """How much something known contradicts a pose: logarithm of a likelihood ratio."""
    away = pose.as_array() - known.pose
    away[2] = wrap_angle(float(away[2]))
    return min(0.5 * float(away @ known.information @ away), MAX_CONTRADICTION)
