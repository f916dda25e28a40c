"""`touchline calibrate lines --model pinhole|fisheye`: a perspective camera from images at places nobody measured.

Lines are found through a usual camera, cameras that may be from them (`perspective_search`), the best by bundle
adjustment (`perspective_bundle`); then lines are found again with that camera, and all is fitted once more, until every
image's pose is right.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from touchline.calibration.perspective_bundle import (
    CENTER_V,
    DISTORTION,
    FOCAL,
    HEIGHT,
    NAMES,
    PITCH,
    ROLL,
    PerspectiveFit,
    PerspectiveView,
    Stand,
    camera_at,
    fit_perspective,
)
from touchline.calibration.perspective_search import FOCAL_RATIOS, MIN_LINES, find_cameras, place
from touchline.camera import GroundView, PerspectiveCamera
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.localization.camera_errors.perspective import DEVIATIONS
from touchline.localization.registration.registration import Registration
from touchline.localization.search.pose_search import PoseSearch
from touchline.messages import counted, listed
from touchline.perception.line_graph.patches import line_graph_detector
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.types import ImageArray, Observation

MIN_SIZE_PX = 64  # a few cells of the line graph each way
MIN_POINTS, MIN_ON_LINES = 20, 0.85  # of an image that takes part; share of the points that must lie on lines
RIGHT = 0.9  # share of an image's points on lines from which its pose is kept
# standard deviations of what the images tell: roll, pitch (rad), height, focal length (ratios)
MAX_DEVIATIONS = {ROLL: math.radians(0.5), PITCH: math.radians(0.7), HEIGHT: 0.04, FOCAL: 0.04}
# of the mean lean of a body that sways (rad): half of what localization expects of roll and pitch in any file
MAX_MEAN_LEAN_RAD = 0.5 * DEVIATIONS[0]
_USUAL = {"pinhole": (0.8, -0.1), "fisheye": (0.45, 0.0)}  # focal length per image width, distortion
# of cameras with which lines are first looked for: that focal length times, pitch (rad), height (m)
_USUAL_VIEWS = (1.0, 0.42, 0.7), (1.25, 0.5, 0.7), (0.8, 0.35, 1.0)
_SURE, _FITS = 0.02, 0.1  # cost at which a camera is the right one, and may be if no other fits better
MAX_PAINT_M = 0.015  # how far (a standard deviation) lines may lie beside the file's: more is a wrong camera, or field
_BEYOND = 0.5  # of the focal length's logarithm, from what is searched: a fit there has diverged
MIN_USED = 0.6  # share of the images that must take part
_NOISE_PX, _START_NOISE_PX = 0.7, 5.0  # of a point where a pose is looked for, and with a camera that is off
_TRIED, _LOOKS = 16, 4  # cameras that are fitted, and how often lines are found again at most


@dataclass(frozen=True, eq=False)
class PerspectiveLines:
    """A camera with the fit that it comes from; used: which images took part; seen: what these show."""

    camera: PerspectiveCamera
    fit: PerspectiveFit
    used: tuple[int, ...]
    seen: tuple[Observation, ...]

    @property
    def deviations(self) -> FloatArray:
        """Of the state (10,)."""
        return np.sqrt(np.diag(self.fit.covariance))

    @property
    def mean_lean_deviations(self) -> FloatArray:
        """What so few images leave open of a swaying body's means (3,): roll, pitch (rad), height (ratio)."""
        return np.array(self.fit.learned[:3]) / math.sqrt(len(self.used))

    @property
    def image_deviations(self) -> FloatArray:
        """What the images leave open (4,), without the sway: roll, pitch (rad), height, focal length (ratios). Pitch
        is that of the image's middle: images taken under one tilt hardly tell the principal point, but pitch makes up
        for it on the ground.
        """
        middle = np.eye(4, len(self.fit.state))
        middle[PITCH, CENTER_V] = -1.0 / self.camera.fy
        variances = np.einsum("ij,jk,ik->i", middle, self.fit.covariance, middle)
        variances[:3] -= self.mean_lean_deviations**2
        return np.sqrt(np.maximum(variances, 0.0))


def calibrate_perspective_lines(
    images: Sequence[ImageArray], field: FieldModel, model: str, report: Callable[[str], None] = lambda _: None
) -> PerspectiveLines:
    """The camera of images (H, W, 3), B, G, R, all of one size. report: takes how far it has come. Raises NoFitError
    with the reason.
    """
    height, width = images[0].shape[:2]
    if min(height, width) < MIN_SIZE_PX:
        raise NoFitError(f"images of {width} x {height} pixels show no lines: {MIN_SIZE_PX} each way are the least")
    work = _Calibration(images, field, model, report)
    best = work.first()
    for _ in range(_LOOKS):  # some of the poses were found with a camera that is percents off
        right = best.right()
        if not right:
            break
        state, seen = best.fit.state, work.look(best.fit.state)
        tried = work.tried(seen, state, right)
        if not tried or tried[0].rank()[0] < len(right):  # some of them were wrong: all are looked for again
            tried += work.tried(seen, state, {}, _leans_of(right, len(images)))
        if not tried:
            break
        best = max(tried, key=_Fitted.rank)
        if len(right) == len(best.right()) == len(best.images):
            break
    right = best.right()
    if MIN_USED * len(images) <= len(right) < len(best.images):  # a wrong pose would pull the camera
        best = work.fitted(
            [one if k in right else Observation(0) for k, one in enumerate(best.seen)], best.fit.state, right
        )
    camera = camera_at(model, work.size, best.fit.state)
    found = PerspectiveLines(camera, best.fit, best.images, tuple(best.seen[k] for k in best.images))
    check(found, len(images))
    return found


class _Fitted(NamedTuple):
    """A fit, the numbers of the images that took part, and what all show."""

    fit: PerspectiveFit
    images: tuple[int, ...]
    seen: Sequence[Observation]

    @property
    def cost(self) -> float:
        """0 to 1, and more of one that moves the field's lines."""
        return self.fit.cost + (self.fit.learned.paint_m > MAX_PAINT_M)

    def right(self) -> dict[int, Stand]:
        """Where the images were taken whose points lie on lines."""
        rows = zip(self.images, self.fit.stands, self.fit.on_lines, strict=True)
        return {k: stand for k, stand, on_lines in rows if on_lines >= RIGHT}

    def rank(self) -> tuple[int, float]:
        """The larger the better: one that puts more images right, then the one that costs less."""
        return (0 if self.cost > 1.0 else len(self.right())), -self.cost

    def good(self, cost: float, images: int) -> bool:
        """Whether it costs less, with enough of so many images."""
        return self.cost < cost and len(self.right()) >= MIN_USED * images


class _Calibration:
    """Images of a camera that is looked for."""

    def __init__(
        self, images: Sequence[ImageArray], field: FieldModel, model: str, report: Callable[[str], None]
    ) -> None:
        self.size = (images[0].shape[1], images[0].shape[0])
        self._images, self._field, self._model, self._report = images, field, model, report
        self._search = PoseSearch(field, Registration(field.distance_map()))

    def look(self, state: FloatArray) -> list[Observation]:
        """What the images show through the camera of a state (10,)."""
        camera = camera_at(self._model, self.size, state)
        detector = line_graph_detector(camera, LineGraphSettings(), self._field)
        seen = []
        for k, image in enumerate(self._images, start=1):
            self._report(f"looks for lines in image {k} of {len(self._images)}")
            detector.reset()  # each has its own light
            seen.append(detector.detect(image, GroundView(camera)))
        return seen

    def fitted(
        self,
        seen: Sequence[Observation],
        state: FloatArray,
        known: Mapping[int, Stand],
        leans: FloatArray | None = None,
    ) -> _Fitted:
        """The fit of what was seen from a state (10,); known: where images were taken; leans (V, 3): of all, else."""
        views, noise_px = {}, _NOISE_PX if known else _START_NOISE_PX
        leans = np.zeros((len(seen), 3)) if leans is None else leans
        for k, (one, lean) in enumerate(zip(seen, leans, strict=True)):
            if len(one.points) >= MIN_POINTS and k in known:
                views[k] = PerspectiveView(one.points.pixels, known[k])
            elif len(one.points) >= MIN_POINTS:
                pose, _ = place(one, self._model, self.size, state, self._search, noise_px, lean)
                if pose is not None:
                    views[k] = PerspectiveView(one.points.pixels, Stand(pose, lean))
        if not views:
            raise NoFitError("no image shows enough of the field's lines")
        fit = fit_perspective(list(views.values()), state, self._field, self._model, self.size, bool(known))
        low, high = (math.log(ratio * self.size[0]) for ratio in FOCAL_RATIOS[self._model])
        if not low - _BEYOND < fit.state[FOCAL] < high + _BEYOND:
            raise NoFitError("no camera that is usual puts the points on this field's lines")
        return _Fitted(fit, tuple(views), seen)

    def tried(
        self,
        seen: Sequence[Observation],
        state: FloatArray,
        known: Mapping[int, Stand],
        leans: FloatArray | None = None,
    ) -> list[_Fitted]:
        """The fit, if there is one."""
        self._report("fits the camera to what it shows itself")
        try:
            return [self.fitted(seen, state, known, leans)]
        except NoFitError:
            return []

    def first(self) -> _Fitted:
        """The first fit that is good, else the best: of what the usual cameras see, what sees most points first."""
        looks = [self.look(state) for state in _usual_states(self._model, self.size)]
        fits: list[_Fitted] = []
        failed: NoFitError | None = None
        for seen in sorted(looks, key=lambda each: -sum(len(one.points) for one in each)):
            self._report("searches for cameras through which lines are parallel or at right angles")
            starts = find_cameras(seen, self._model, self.size, self._search)[:_TRIED]
            for k, start in enumerate(starts, start=1):
                self._report(f"fits camera {k} of {len(starts)} that may be")
                try:
                    fits.append(self.fitted(seen, start.state, {}, start.leans))
                except NoFitError as error:
                    failed = error
                    continue
                if fits[-1].good(_SURE, len(seen)):
                    return fits[-1]
            if any(one.good(_FITS, len(seen)) for one in fits):
                break
        if not fits:
            raise failed or NoFitError(
                f"fewer than {MIN_LINES} lines are seen in {counted(len(looks[0]), 'image')}, twenty are better: add "
                "images from places where the centre circle, a penalty area or a corner is in view"
            )
        return max(fits, key=_Fitted.rank)


def _leans_of(known: Mapping[int, Stand], images: int) -> FloatArray:
    """(V, 3) of all images, 0 where nothing is known."""
    leans = np.zeros((images, 3))
    for k, stand in known.items():
        leans[k] = stand.lean
    return leans


def _usual_states(model: str, size: tuple[int, int]) -> FloatArray:
    """(3, 10) of usual cameras."""
    states = np.zeros((len(_USUAL_VIEWS), len(NAMES)))
    focal, states[:, DISTORTION] = _USUAL[model]
    focals, states[:, PITCH], heights_m = np.transpose(_USUAL_VIEWS)
    states[:, HEIGHT], states[:, FOCAL] = np.log(heights_m), np.log(focals * focal * size[0])
    return states


def _names(parameters: Sequence[int]) -> str:
    return listed([NAMES[k] for k in parameters])


def check(found: PerspectiveLines, images: int) -> None:
    """Raises NoFitError, naming what so many images leave open."""
    on_lines = float(np.mean(found.fit.on_lines))
    if on_lines < MIN_ON_LINES or len(found.used) < MIN_USED * images:
        raise NoFitError(
            f"no camera puts the points on this field's lines: {100 * on_lines:.0f} % lie on them in {len(found.used)} "
            f"of {images} images, {100 * MIN_ON_LINES:.0f} % in most images are needed. Is it the right field, "
            "and the right model?"
        )
    if (paint_m := found.fit.learned.paint_m) > MAX_PAINT_M:
        raise NoFitError(
            f"the field's lines would have to lie {100 * paint_m:.1f} cm beside where its file has them: "
            "measure its sizes, or add images from other places"
        )
    swaying = [k for k in (ROLL, PITCH) if found.mean_lean_deviations[k] > MAX_MEAN_LEAN_RAD]
    if swaying:
        lean_rad = max(found.fit.learned[k] for k in swaying)
        raise NoFitError(
            f"the body leans by {math.degrees(lean_rad):.1f}° from image to image (a standard deviation), so "
            f"{len(found.used)} images leave the camera's {_names(swaying)} open: let the robot stand still, or add "
            "images"
        )
    open_ones = [k for k, limit in MAX_DEVIATIONS.items() if found.image_deviations[k] > limit]
    if open_ones:
        raise NoFitError(
            f"these images don't tell the camera's {_names(open_ones)}: add images from other places, with the "
            "centre circle, a penalty area or a corner in view"
        )
