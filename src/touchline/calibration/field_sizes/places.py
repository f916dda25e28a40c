"""Where line points were seen from: a recording's, or single images', each place found by itself on the whole field."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from touchline.calibration.field_sizes.fit import Place
from touchline.camera import Camera, require_omni
from touchline.errors import InputError
from touchline.field import FieldModel, open_field, preset_names
from touchline.geometry import FloatArray
from touchline.localization.one_shot.certainty import points_covariance
from touchline.localization.one_shot.point_search import PointSearch
from touchline.localization.one_shot.scale import quick_pose
from touchline.localization.one_shot.thinning import thinned_to
from touchline.localization.registration.covariance import is_observed
from touchline.localization.registration.weights import normalized
from touchline.perception import LinePointDetector
from touchline.perception.colour import NoCarpetError
from touchline.perception.covered import is_covered
from touchline.sources import Recording
from touchline.types import ImageArray, LinePoints

MAX_PLACES = 60  # spread over a recording: more only take longer
MIN_POINTS = 20
MAX_POINTS = 200  # of a place, evenly over the ground
MAX_M = 8.0  # points farther than this say more about the mirror than about the field
NEAR_M, MIN_NEAR_RATIO = 0.35, 0.7  # share of a place's points that must lie so near to lines of the field as given
_TRIED_ON = 10  # observations that other fields are tried on
_BETTER = 1.25  # times as many places make another field worth naming
_LEARNED_FROM = 5  # images that a detector learns the carpet from


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
    deviations: FloatArray = np.sqrt(0.5 * np.trace(points.covariances_m2[chosen], axis1=1, axis2=2))
    return deviations


def _spread(count: int) -> list[int]:
    """Up to MAX_PLACES of so many indices, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, MAX_PLACES)).round().astype(int)).tolist() if count else []
