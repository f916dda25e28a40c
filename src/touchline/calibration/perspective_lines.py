"""`touchline calibrate lines --model pinhole|fisheye`: a perspective camera from images at places nobody measured.

Lines are found through a usual camera, cameras that may be from them (`perspective_search`), the best by bundle
adjustment (`perspective_bundle`); then lines are found again with that camera, and all is fitted once more.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from touchline.calibration.perspective_bundle import (
    DISTORTION,
    FOCAL,
    HEIGHT,
    NAMES,
    PITCH,
    ROLL,
    PerspectiveFit,
    PerspectiveView,
    camera_at,
    fit_perspective,
)
from touchline.calibration.perspective_search import find_cameras, place
from touchline.camera import GroundView, PerspectiveCamera
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, as_pose
from touchline.localization.registration.registration import Registration
from touchline.localization.search.pose_search import PoseSearch
from touchline.perception.line_graph.patches import line_graph_detector
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.types import ImageArray, Observation

MIN_POINTS, MIN_ON_LINES = 20, 0.85  # of an image that takes part; share of the points that must lie on lines
RIGHT = 0.9  # share of an image's points on lines from which its pose is kept
# standard deviations of what is written: roll, pitch (rad), height, focal length (ratios)
MAX_DEVIATIONS = {ROLL: math.radians(0.5), PITCH: math.radians(0.7), HEIGHT: 0.04, FOCAL: 0.04}
_USUAL = {"pinhole": (0.8, -0.1), "fisheye": (0.45, 0.0)}  # focal length per image width, distortion
_USUAL_PITCH, _USUAL_HEIGHT_M = 0.42, 0.7
_TRIED, _LOOKS = 3, 1


@dataclass(frozen=True, eq=False)
class PerspectiveLines:
    """A camera with the fit that it comes from; used: which images took part; seen: what these show."""

    camera: PerspectiveCamera
    fit: PerspectiveFit
    used: tuple[int, ...]
    seen: tuple[Observation, ...]

    @property
    def deviations(self) -> FloatArray:
        """Of the state (7,)."""
        return np.sqrt(np.diag(self.fit.covariance))


def calibrate_perspective_lines(images: Sequence[ImageArray], field: FieldModel, model: str) -> PerspectiveLines:
    """The camera of images (H, W, 3), B, G, R, all of one size. Raises NoFitError with the reason."""
    size = (images[0].shape[1], images[0].shape[0])
    state = np.zeros(len(NAMES))
    focal, state[DISTORTION] = _USUAL[model]
    state[[PITCH, HEIGHT, FOCAL]] = _USUAL_PITCH, math.log(_USUAL_HEIGHT_M), math.log(focal * size[0])
    search = PoseSearch(field, Registration(field.distance_map()))

    def look(state: FloatArray) -> list[Observation]:
        camera = camera_at(model, size, state)
        detector = line_graph_detector(camera, LineGraphSettings(), field)
        seen = []
        for image in images:
            detector.reset()  # each has its own light
            seen.append(detector.detect(image, GroundView(camera)))
        return seen

    def fitted(seen: Sequence[Observation], state: FloatArray, poses: Mapping[int, Pose]) -> _Fitted:
        views = {}
        for k, one in enumerate(seen):
            if len(one.points) >= MIN_POINTS:
                pose = poses.get(k) or place(one, model, size, state, search)[0]
                if pose is not None:
                    views[k] = PerspectiveView(one.points.pixels, pose)
        if not views:
            raise NoFitError("no image shows enough of the field's lines")
        fit = fit_perspective(list(views.values()), state, field, model, size, bool(poses))
        return _Fitted(fit, tuple(views), seen)

    seen = look(state)
    starts = find_cameras([one for one in seen if len(one.points) >= MIN_POINTS], model, size, search)
    fits = [min((fitted(seen, one.state, {}) for one in starts[:_TRIED]), key=lambda each: each.fit.cost)]
    for looks in range(1 + _LOOKS):  # some of the poses were found with a camera that is percents off
        best = min(fits, key=lambda each: each.fit.cost)
        fits.append(fitted(look(best.fit.state) if looks else seen, best.fit.state, best.right_poses()))
    best = min(fits, key=lambda each: each.fit.cost)
    found = PerspectiveLines(
        camera_at(model, size, best.fit.state), best.fit, best.images, tuple(best.seen[k] for k in best.images)
    )
    _check(found)
    return found


class _Fitted(NamedTuple):
    """A fit, the numbers of the images that took part, and what all show."""

    fit: PerspectiveFit
    images: tuple[int, ...]
    seen: Sequence[Observation]

    def right_poses(self) -> dict[int, Pose]:
        """Of the images whose points lie on lines."""
        rows = zip(self.images, self.fit.poses, self.fit.on_lines, strict=True)
        return {k: as_pose(pose) for k, pose, on_lines in rows if on_lines >= RIGHT}


def _check(found: PerspectiveLines) -> None:
    """Raises NoFitError, naming what the images leave open."""
    on_lines = float(np.mean(found.fit.on_lines))
    if on_lines < MIN_ON_LINES:
        raise NoFitError(
            f"no camera puts the points on this field's lines: {100 * on_lines:.0f} % lie on them, "
            f"{100 * MIN_ON_LINES:.0f} % are needed. Is it the right field, and the right model?"
        )
    open_ones = [NAMES[k] for k, limit in MAX_DEVIATIONS.items() if found.deviations[k] > limit]
    if open_ones:
        raise NoFitError(
            f"these images don't tell the camera's {' and '.join(open_ones)}: add images from other places, with the "
            "centre circle, a penalty area or a corner in view"
        )
