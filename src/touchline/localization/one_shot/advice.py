"""Where a pose is refused or in doubt: which other field, or which scale of the ranges, the points would fit better.

A scale is fitted together with the pose.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from touchline.camera import Camera
from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field, preset_names
from touchline.geometry import FloatArray, Pose, as_pose
from touchline.localization.one_shot.certainty import Spread, camera_fit
from touchline.localization.one_shot.doubts import FAR_M
from touchline.localization.one_shot.locate import SAMPLE_POINTS, LocateSettings, locate
from touchline.localization.one_shot.location import Location
from touchline.localization.one_shot.point_search import C_M, PointSearch
from touchline.localization.one_shot.thinning import different, thinned_to
from touchline.types import Observation

_BETTER = 0.7  # of the robust error: what is better than this is worth telling
SCALES = (0.8, 0.84, 0.88, 0.92, 0.96, 1.0, 1.04, 1.08, 1.13, 1.18, 1.24)  # tried: one within 3 % is found from there
_STARTS = 40  # poses refined at each
_ROUNDS = 4
_LOOSE = 0.1  # standard deviation of the scale in each round


class Scale(NamedTuple):
    """factor: what all ranges are to be multiplied by. deviation: its standard deviation, if the field is right."""

    factor: float
    deviation: float


def quick_pose(search: PointSearch, points: FloatArray) -> Pose:
    """The best pose of points (N, 2) in m, robot frame, all alike, from a few of them and without any test of it."""
    return search.refined(thinned_to(points, SAMPLE_POINTS), _STARTS)[0][0]


def fit_scale(
    points: FloatArray, field: FieldModel, heading: float | None = None, settings: LocateSettings | None = None
) -> Scale:
    """The factor of line points (N, 2) in m, robot frame, that lets them fit the field's lines best.

    heading: from a compass (rad, field frame), or None. A cloud shrunk to a point lies on a line, so distances are
    compared in the points' own measure, and nothing beyond SCALES is tried. Raises NoFitError if the best factor is
    the first or the last of them.
    """
    s = settings or LocateSettings()
    seen = np.asarray(points, dtype=np.float64)
    seen = np.ascontiguousarray(seen[different(seen)])
    search = PointSearch(field, heading, s.heading_tolerance_rad)
    best_error, factor, pose = np.inf, 1.0, Pose(0.0, 0.0, 0.0)
    for tried in SCALES:
        at = quick_pose(search, tried * seen)
        squares = (field.line_distances(at.transform(tried * seen)) / tried) ** 2
        error = float(np.mean(squares / (squares + C_M**2)))
        if error < best_error:
            best_error, factor, pose = error, tried, at
    if factor in (SCALES[0], SCALES[-1]):
        raise NoFitError(
            f"no scale between {SCALES[1]:g} and {SCALES[-2]:g} fits best: is the unit the metre, and is it this field?"
        )
    deviation = 0.0
    for _ in range(_ROUNDS):
        fit = camera_fit(field, factor * seen, pose, Spread(scale=_LOOSE))
        if fit is None:
            break
        pose, factor = as_pose(fit.pose), factor * (1.0 + float(fit.errors[4]))
        deviation = factor * float(np.sqrt(fit.covariance[7, 7]))
    return Scale(factor, deviation)


class Better(NamedTuple):
    """What fits better: the name of a preset or a scale, and the mean distance (m) that it leaves."""

    preset: str | None
    scale: Scale | None
    mean_distance_m: float


def better_fits(
    points: FloatArray, field: FieldModel, pose: Pose, heading: float | None, settings: LocateSettings | None = None
) -> tuple[Better, ...]:
    """The preset that line points (N, 2) in m, robot frame, fit best, if it is not the field, and the scale.

    pose: the best one on the field, which the others must beat by far. heading: as of `locate_points`.
    """
    s = settings or LocateSettings()
    points = np.asarray(points, dtype=np.float64)
    limit = _BETTER * _error(points, field, pose)
    found = []
    for name in preset_names():
        other = open_field(name)
        if other != field:
            best = quick_pose(PointSearch(other, heading, s.heading_tolerance_rad), points)
            if (error := _error(points, other, best)) < limit:
                mean_m = float(np.mean(other.line_distances(best.transform(points))))
                found.append((error, Better(name, None, mean_m)))
    fits = [min(found, key=lambda one: one[0])[1]] if found else []
    try:
        scale = fit_scale(points, field, heading, s)
    except NoFitError:
        return tuple(fits)
    scaled = scale.factor * points
    best = quick_pose(PointSearch(field, heading, s.heading_tolerance_rad), scaled)
    if _error(scaled, field, best) < limit:
        fits.append(Better(None, scale, float(np.mean(field.line_distances(best.transform(scaled))))))
    return tuple(fits)


def better_field(
    observe: Callable[[FieldModel], Observation], field: FieldModel, found: Location | None, heading: float | None,
    camera: Camera,
) -> tuple[Better, ...]:  # fmt: skip
    """The preset on which all that an image shows fits best, its camera's errors fitted, too; none if it is the field.

    observe: what it shows to a detector for a field. found: on the field, whose mean distance the other must beat by
    far; None where nothing was.
    """
    fits = []
    for name in preset_names():
        if (other := open_field(name)) != field:
            try:
                there = locate(observe(other), other, heading, camera=camera)
            except NoFitError:
                continue
            if found is None or there.mean_distance_m < _BETTER * found.mean_distance_m:
                fits.append((len(there.doubts), there.mean_distance_m, name))
    return tuple(Better(name, None, mean_m) for _, mean_m, name in sorted(fits)[:1])


def _error(points: FloatArray, field: FieldModel, pose: Pose) -> float:
    """Mean of d² / (d² + c²): what is off by metres counts as much as what is off by two."""
    squares = field.line_distances(pose.transform(points)) ** 2
    return float(np.mean(squares / (squares + FAR_M**2)))
