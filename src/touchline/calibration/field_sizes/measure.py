"""`touchline fields measure`: which sizes of a field the line points of many places want otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from touchline.calibration.field_sizes.fit import USUAL_SCALE, SizeFit, fit_sizes
from touchline.calibration.field_sizes.places import MAX_M, MIN_POINTS, better_preset, find_places
from touchline.calibration.field_sizes.sizes import FieldSizes, Size, sizes_of
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.types import LinePoints

MAX_DEVIATION_M = 0.06  # of a size that is told: a size known no better than this was not observed
SURE, MIN_CHANGE_M = 3.0, 0.015  # standard deviations and metres beyond which a size is otherwise
UNSURE = 1.5  # standard deviations beyond which it may be
SURE_FLOOR_M = 0.004  # of every size: carpets and lines are not straight
SURE_FLOOR_RATIO = 0.0005
MIN_PLACES = 4  # from fewer, what a mirror does in one direction is not told from a size
MIN_FITTING_RATIO = 0.75  # of the observations that show enough: 0.9 on their own field, up to 0.6 on another
MAX_MEDIAN_M = 0.1  # of the points' distances after the fit


class Verdict(Enum):
    """What the observations say of a size."""

    OTHERWISE = "otherwise"
    AS_GIVEN = "as given"
    UNSURE = "perhaps otherwise"
    NOT_OBSERVED = "not observed"


@dataclass(frozen=True, slots=True)
class MeasuredSize:
    """A size, by how much the observations want it larger (m), how surely (m), and what that means."""

    size: Size
    change_m: float
    deviation_m: float
    verdict: Verdict


@dataclass(frozen=True, eq=False, slots=True)
class FieldMeasurement:
    """sizes: one for each of the field. field: with those that are surely otherwise. seen: observations looked at."""

    sizes: tuple[MeasuredSize, ...]
    field: FieldModel
    fit: SizeFit
    places: int
    seen: int


def measure_field(
    seen: Sequence[LinePoints], field: FieldModel, scale: float = USUAL_SCALE, name: str | None = None
) -> FieldMeasurement:
    """Measure a field by the line points of several places.

    scale: by what share all ranges may be wrong in common (a standard deviation). name: of the field that is made.
    Raises NoFitError where they don't tell, with the reason.
    """
    places = find_places(seen, field)
    told = [points for points in seen if len(points.usable(MAX_M)) >= MIN_POINTS]
    if not places or len(places) < MIN_FITTING_RATIO * len(told):
        raise NoFitError(_misfit(len(places), seen, field))
    sizes = sizes_of(field)
    fit = fit_sizes(places, sizes, scale)
    median_m = float(np.median(fit.residuals_m))
    if median_m > MAX_MEDIAN_M:
        raise NoFitError(
            f"the points lie {100 * median_m:.0f} cm from the lines with the best sizes: is it this field, and is the "
            "camera calibrated?"
        )
    measured = tuple(_judged(size, fit, j, len(places)) for j, size in enumerate(sizes.sizes))
    if all(one.verdict is Verdict.NOT_OBSERVED for one in measured):
        raise NoFitError(
            f"{len(places)} places tell no size of the field to {100 * MAX_DEVIATION_M:.0f} cm: take more, where "
            "opposite lines are seen at once"
        )
    return FieldMeasurement(measured, _changed(sizes, measured, name), fit, len(places), len(seen))


def _misfit(places: int, seen: Sequence[LinePoints], field: FieldModel) -> str:
    """In words, that most observations don't fit the field, and which one they fit."""
    many = f"only {places} of {len(seen)} observations fit" if places else f"none of {len(seen)} observations fits"
    better = better_preset(seen, field)
    advice = f"The preset {better} fits them far better: --field {better}. " if better is not None else ""
    return (
        f"{many} {field.name} with points that fix the place: is it this field, and is the camera calibrated? "
        f"{advice}touchline locate says what one observation says"
    )


def _judged(size: Size, fit: SizeFit, j: int, places: int) -> MeasuredSize:
    change, own = float(fit.change_m[j]), float(fit.deviation_m[j])
    deviation = float(np.hypot(own, SURE_FLOOR_M + SURE_FLOOR_RATIO * size.value_m))
    if not deviation < MAX_DEVIATION_M:
        verdict = Verdict.NOT_OBSERVED
    elif places >= MIN_PLACES and abs(change) > max(SURE * deviation, MIN_CHANGE_M):
        verdict = Verdict.OTHERWISE
    elif abs(change) > max(UNSURE * deviation, MIN_CHANGE_M):
        verdict = Verdict.UNSURE
    else:
        verdict = Verdict.AS_GIVEN
    return MeasuredSize(size, change, deviation, verdict)


def _changed(sizes: FieldSizes, measured: Sequence[MeasuredSize], name: str | None) -> FieldModel:
    """The field with the sizes that are surely otherwise; their changes rounded to millimetres."""
    change = [round(one.change_m, 3) if one.verdict is Verdict.OTHERWISE else 0.0 for one in measured]
    return sizes.field(np.array(change), name)
