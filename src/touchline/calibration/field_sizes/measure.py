"""`touchline fields measure`: which sizes of a field the line points of many places want otherwise.

Each place, of a recording's images or of single ones, is found by itself on the whole field.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from touchline.calibration.field_sizes.fit import USUAL_SCALE, Place, SizeFit, fit_sizes
from touchline.calibration.field_sizes.sizes import FieldSizes, Size, sizes_of
from touchline.camera import Camera, require_omni
from touchline.errors import InputError, NoFitError
from touchline.field import FieldModel, open_field, preset_names
from touchline.geometry import FloatArray
from touchline.localization.one_shot.advice import quick_pose
from touchline.localization.one_shot.certainty import points_covariance
from touchline.localization.one_shot.point_search import PointSearch
from touchline.localization.one_shot.thinning import thinned_to
from touchline.localization.registration.covariance import is_observed
from touchline.localization.registration.weights import normalized
from touchline.perception import LinePointDetector
from touchline.perception.colour import NoCarpetError
from touchline.perception.covered import is_covered
from touchline.sources import Recording
from touchline.types import ImageArray, LinePoints

MAX_DEVIATION_M = 0.06  # of a size that is told: a size known no better than this was not observed
SURE, MIN_CHANGE_M = 3.0, 0.015  # standard deviations and metres beyond which a size is otherwise
UNSURE = 1.5  # standard deviations beyond which it may be
SURE_FLOOR_M = 0.004  # of every size: carpets and lines are not straight
SURE_FLOOR_RATIO = 0.0005
MIN_PLACES = 4  # from fewer, what a mirror does in one direction is not told from a size
MIN_FITTING_RATIO = 0.75  # of the observations that show enough: 0.9 on their own field, up to 0.6 on another
MAX_MEDIAN_M = 0.1  # of the points' distances after the fit
MAX_PLACES = 60  # spread over a recording: more only take longer
MIN_POINTS = 20
MAX_POINTS = 200  # of a place, evenly over the ground
MAX_M = 8.0  # points farther than this say more about the mirror than about the field
NEAR_M, MIN_NEAR_RATIO = 0.35, 0.7  # share of a place's points that must lie so near to lines of the field as given
_TRIED_ON = 10  # observations that other fields are tried on
_BETTER = 1.25  # times as many places make another field worth naming
_LEARNED_FROM = 5  # images that a detector learns the carpet from


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
    usable = [points for points in seen if len(points.usable(MAX_M)) >= MIN_POINTS]
    if not places or len(places) < MIN_FITTING_RATIO * len(usable):
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


def recording_points(recording: Recording) -> list[LinePoints]:
    """Line points of up to MAX_PLACES frames of a recording, its own or found in its images."""
    if recording.has_observations:
        seen = [frame.observation.points.usable() for frame in recording if frame.observation is not None]
        return [seen[k] for k in _spread(len(seen))]
    images = (recording.image(k) for k in _spread(len(recording)))
    shown = [image for image in images if image is not None and not is_covered(image)]
    if not shown:
        raise InputError(f"{recording.path}: has no images that show anything, and no line points")
    return image_points(shown, recording.camera, recording.field.line_width)


def image_points(images: Sequence[ImageArray], camera: Camera, line_width_m: float) -> list[LinePoints]:
    """Line points of images (H, W, 3), B, G, R, of one mirror camera. Raises InputError where they show no carpet."""
    detector = LinePointDetector(
        require_omni(camera, "a field is measured by line points in images of"), None, line_width_m
    )
    step = max(len(images) // _LEARNED_FROM, 1)
    try:
        detector.learn(images[::step])
    except NoCarpetError as error:
        raise InputError(f"no line points can be found: {error}") from None
    return [detector.detect(image).usable() for image in images]


def find_places(seen: Iterable[LinePoints], field: FieldModel) -> list[Place]:
    """The places that points tell: on this field, near its lines, and fixed by them; the others are left out."""
    search = PointSearch(field)
    places = []
    for points in seen:
        near = points.usable(MAX_M)
        if len(near) < MIN_POINTS:
            continue
        kept = thinned_to(near.positions_m, MAX_POINTS)
        pose = quick_pose(search, kept)
        fits = np.mean(field.line_distances(pose.transform(kept)) < NEAR_M) >= MIN_NEAR_RATIO
        weights = normalized(np.ones(len(kept)))
        if fits and is_observed(points_covariance(search, kept, weights, pose)):
            places.append(Place(kept, _deviations(near, kept), pose.as_array()))
    return places


def better_preset(seen: Sequence[LinePoints], field: FieldModel) -> str | None:
    """The preset on which most of the observations tell their place, if they are far more than on the field."""
    tried = [seen[k] for k in np.linspace(0, len(seen) - 1, min(len(seen), _TRIED_ON)).round().astype(int)]
    found = {name: len(find_places(tried, open_field(name))) for name in preset_names()}
    best = max(found, key=lambda name: found[name])
    return best if found[best] > _BETTER * len(find_places(tried, field)) else None


def _deviations(points: LinePoints, kept: FloatArray) -> FloatArray:
    """Standard deviations (M,) in m of those of the points that were kept (M, 2), in any direction."""
    index = {tuple(row): k for k, row in enumerate(points.positions_m.tolist())}
    chosen = [index[tuple(row)] for row in kept.tolist()]
    return np.sqrt(0.5 * np.trace(points.covariances_m2[chosen], axis1=1, axis2=2))


def _spread(count: int) -> list[int]:
    """Up to MAX_PLACES of so many indices, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, MAX_PLACES)).round().astype(int)).tolist() if count else []
