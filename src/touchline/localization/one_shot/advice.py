"""Where a pose is refused or in doubt: which other field, or which scale of the ranges, the points would fit better."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field, preset_names
from touchline.geometry import FloatArray, Pose
from touchline.localization.one_shot.doubts import FAR_M
from touchline.localization.one_shot.locate import LocateSettings
from touchline.localization.one_shot.point_search import PointSearch
from touchline.localization.one_shot.scale import Scale, fit_scale, quick_pose

_BETTER = 0.7  # of the robust error: what is better than this is worth telling


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


def _error(points: FloatArray, field: FieldModel, pose: Pose) -> float:
    """Mean of d² / (d² + c²): what is off by metres counts as much as what is off by two."""
    squares = field.line_distances(pose.transform(points)) ** 2
    return float(np.mean(squares / (squares + FAR_M**2)))
