"""What registration takes of an observation: line points, or points laid on lines, crossings and landmarks."""

import numpy as np
from numba import njit

from touchline.geometry import FloatArray
from touchline.localization.registration.features import NO_POINTS, Features
from touchline.localization.registration.joint import Seen
from touchline.localization.registration.line_likeness import count_points
from touchline.types import LinePoints, Lines, Observation

REPEATED = 2.6  # of so many points one counts in the information: neighbours err together, and again in the next image
FEW = 20  # of so few points twice as many: the ends of a lone line weigh most, and may be none
MIN_CONFIDENCE = 0.1
POINT_SHARE = 0.25  # as so many a point counts in the likelihood of a pose: clutter repeats itself, too
LINE_SHARE = 2.0  # as so many points both ends of a line count of which only these are known
FEATURE_SHARE = 1.0  # so much a crossing or a landmark beside the line points that run into it
SPACING_M = 0.25  # between points that are laid on such a line


def repeated(count: float) -> float:
    """Of so many points one counts, where they err as they state."""
    return REPEATED * (1.0 + FEW / max(count, 1.0))


def points_that_count(positions_m: FloatArray, shares: FloatArray, crude: bool) -> float:
    """As how many line points those of `Seen` count: a heap's left-overs are some, and count as hardly one."""
    return float(shares.sum()) / POINT_SHARE if crude else len(positions_m)


def seen_of(observation: Observation, features: Features, noise: float) -> Seen:
    """noise: ratio of the variances of line points, as learned, to those that they state."""
    crude = False
    if len(observation.points):
        points = observation.points
        arrays = points.positions_m, points.covariances_m2, points.confidences
        positions_m, covariances_m2, shares = map(np.ascontiguousarray, arrays)
        if len(observation.lines):
            shares = POINT_SHARE * np.minimum(np.maximum(shares, MIN_CONFIDENCE), 1.0)
        else:
            positions_m, covariances_m2, shares, crude = _counted(positions_m, covariances_m2, shares)
        noise *= POINT_SHARE * repeated(points_that_count(positions_m, shares, crude))
    else:
        points, shares = points_on(observation.lines)
        positions_m, covariances_m2 = points.positions_m, points.covariances_m2
    found = features.points_of(observation)
    return Seen(
        positions_m,
        covariances_m2,
        shares,
        noise,
        found._replace(positions_m=found.positions_m.copy()) if len(found.positions_m) else found,
        np.ascontiguousarray(found.positions_m),
        FEATURE_SHARE,
        crude,
    )


@njit(cache=True)
def _counted(positions_m, covariances_m2, confidences):  # type: ignore[no-untyped-def]
    """Positions, covariances and weights of `count_points` by their confidences (N,), and whether they are crude;
    weights are shares of a pose's likelihood.
    """
    shares = np.minimum(np.maximum(confidences, MIN_CONFIDENCE), 1.0)
    found = count_points(positions_m, covariances_m2, shares)
    for i in range(len(found.weights)):
        found.weights[i] *= POINT_SHARE
    return found.positions_m, found.covariances_m2, found.weights, found.crude


def evenly_counted(seen: Seen) -> Seen:
    """The same with line points that all count alike: of a crude cloud as many as it counts, drawn by their shares."""
    if not seen.crude:
        return seen
    summed = np.cumsum(seen.shares) / POINT_SHARE
    rows = np.unique(np.searchsorted(summed, np.arange(0.5, summed[-1]))) if len(summed) else np.zeros(0, dtype=np.intp)
    return seen._replace(
        positions_m=seen.positions_m[rows],
        covariances_m2=seen.covariances_m2[rows],
        shares=np.full(len(rows), POINT_SHARE),
    )


def seen_points(points: LinePoints, share: float) -> Seen:
    """Line points alone, each of which counts as so many independent ones."""
    positions_m = np.ascontiguousarray(points.positions_m)
    shares, covariances_m2 = np.full(len(positions_m), share), np.ascontiguousarray(points.covariances_m2)
    return Seen(positions_m, covariances_m2, shares, 1.0, NO_POINTS, NO_POINTS.positions_m, 0.0, False)


def points_on(lines: Lines) -> tuple[LinePoints, FloatArray]:
    """Points evenly on lines of which the ends are known, and how much each counts (N,)."""
    positions, covariances, shares = [np.zeros((0, 2))], [np.zeros((0, 2, 2))], [np.zeros(0)]
    for ends, spreads, sure in zip(lines.ends_m, lines.covariances_m2, lines.confidences, strict=True):
        count = max(2, int(np.hypot(*(ends[1] - ends[0])) / SPACING_M) + 1)
        along = np.linspace(0.0, 1.0, count)[:, np.newaxis]
        positions.append(ends[0] + along * (ends[1] - ends[0]))
        along = along[..., np.newaxis]
        covariances.append((1.0 - along) * spreads[0] + along * spreads[1])
        shares.append(np.full(count, LINE_SHARE * float(np.clip(sure, MIN_CONFIDENCE, 1.0)) * 2.0 / count))
    places = np.concatenate(positions)
    unknown = np.full((len(places), 2), np.nan)
    sure_of = np.concatenate(shares)
    return LinePoints(places, np.concatenate(covariances), np.minimum(sure_of, 1.0), unknown), sure_of
