"""Image -> points on white lines, in metres, each with the covariance that its place in the image deserves.

After section 4.1 of Xiong et al. and section 4 of Lu et al. (2013): colour classes from a look-up table, scan lines,
green-white-green transitions. Colours are learned from the recording's own first images.
"""

import math
from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np
from numba import njit
from pydantic import Field

from touchline.camera import Camera, require_omni
from touchline.camera.omni import covariances_of_pixels
from touchline.config import Settings, added
from touchline.errors import TouchlineError
from touchline.geometry import BoolArray, FloatArray
from touchline.perception.colour import (
    GREEN,
    SMOOTH_NOISE,
    WHITE,
    ColourModel,
    colour_model,
    learn_carpet,
    pixel_noise,
    signal_noise,
    smoothed,
    smoothing_for,
)
from touchline.perception.detector import check_size
from touchline.perception.field_boundary import gap_lengths, keep_within_green
from touchline.perception.path_samples import fetch, no_samples, sample_paths
from touchline.perception.profiles import (
    COLUMNS,
    ProfileLimits,
    dim_carpet,
    find_line_profiles,
)
from touchline.perception.scan_lines import FILL_FROM, MAX_STEP_PX, ScanLines, build_scan_lines, usable_radius
from touchline.perception.stages import (
    BODY_PAINT,
    BOUNDARY_PAINT,
    CIRCLE_PAINT,
    GREEN_PAINT,
    RAY_PAINT,
    WHITE_PAINT,
    draw_paths,
    enlarged,
    painted,
    points_picture,
)
from touchline.perception.tint import Tint, tinted_model
from touchline.perception.transitions import find_transitions
from touchline.types import ImageArray, LinePoints

# least height of a line over its green in standard deviations of the noise on it: one sample in 30 000 reaches 4 by
# chance
MIN_SIGMAS = 4.0
# least cosine between a line's excess over its green and white's: tinted light changes it little, a ball or a marker
# fails it
MIN_WHITENESS = 0.8
MAX_RUN_PX = 60  # longest way from green through white to green at the robot's foot: twice what a line takes there
# longest way through a line, in line widths: 2.2 is a crossing at 27°; circles find the flatter
STEEPEST_CROSSING = 2.2
BLUR_PX = 3.5  # how much wider blur may make a line: lens, motion and demosaicing together
# nothing is looked for where a pixel is longer than this on the ground: a point there would be good to 8 cm at best
COARSEST_PX_M = 0.25
# a quarter of the chords near the robot are shorter than so many widths of the paint: crossed at right angles, blurred
SHORT_CHORD = 1.3
WIDER_PAINT = 1.4  # so many times the width that is set the paint must look before it is taken to be wider
BAND = 2.2  # white beside the robot so many times longer than wide is a line, if it is not wider than two: no panel
NEAR_SHARE = 0.65  # of the reach: nearer it is mostly carpet
TINT_PIXELS = 350  # of these, at least (where there are as many), tell the light's tint
NEAR_M = 3.0  # where blur adds little to a line's width
FIELD_GAP_M = 0.6  # a gap in the green longer than this ends the field: wider than any line in blur and shadow
NOISE_M = 0.01  # standard deviation of a point on the ground that comes from no pixel: carpet, calibration


class LinePointPaper(Settings):
    """Switches to the papers' exact form."""

    detector: Literal["profiles", "transitions"] = added(
        "profiles",
        paper="transitions",
        description="transitions as in the papers: where the colour class changes from green to white and back, to "
        "whole pixels; profiles: two edges at half height on the ground, a width, and green beside them",
    )
    more_scan_lines: bool = added(
        True,
        paper=False,
        description="circles about the robot, and short rays between the others in the outer half; false as in the "
        "papers: the radial scan lines alone",
    )
    within_green: bool = added(
        True, paper=False, description="points beyond the end of the green are left out; false: wherever they lie"
    )
    dark_floor: bool = added(
        True,
        paper=False,
        description="a line may have a floor darker than the carpet on one side, where several such points lie in a "
        "row; false: carpet on both",
    )


class LinePointSettings(Settings):
    """Detection of line points. Lengths in the image are in pixels, so they hold for images of about 500 pixels."""

    radial_scan_lines: int = Field(
        72, ge=8, le=10_000, description="rays from the robot outwards; both NuBot papers use 72"
    )
    circles: int = Field(
        24,
        ge=0,
        le=10_000,
        description="circles about the robot, for lines that point at it: 6 px apart, about as close as the rays are",
    )
    line_width_m: float | None = Field(None, gt=0, description="width of the paint (m); none: that of the field")
    min_contrast: float = Field(
        0.2,
        gt=0,
        lt=1,
        description="least height of a line over its green, as a share of learned white over green: blur takes most of "
        "the height of a far line, seams and shadow edges of the carpet stay lower",
    )
    noise_px: float = Field(
        0.3, gt=0, description="standard deviation of a point in the image (px): two edges at half height"
    )
    paper: LinePointPaper = LinePointPaper()


class LinePointDetector:
    """Finds line points in the images of one camera. `learn` first, then `detect` each image.

    `follow` before it takes on the tint of an image's light: `colours` are the learned ones in that light.
    """

    def __init__(self, camera: Camera, settings: LinePointSettings | None = None, line_width_m: float = 0.125) -> None:
        """Raises InputError for a camera that does not look at a mirror."""
        self.camera = mirror = require_omni(camera, "line points are found along rays and circles in images of")
        self.settings = settings or LinePointSettings()
        s = self.settings
        self.line_width_m = self._paint_m = s.line_width_m or line_width_m
        self.outer_px = usable_radius(mirror, COARSEST_PX_M)
        circles, fill_from = (s.circles, FILL_FROM) if s.paper.more_scan_lines else (0, 1.0)
        self.scan_lines: ScanLines = build_scan_lines(
            mirror, s.radial_scan_lines, circles, mirror.inner_radius_px, self.outer_px, fill_from,
            self.line_width_m if s.paper.detector == "profiles" else 0.0,
        )  # fmt: skip
        self._see_body(np.zeros((mirror.height, mirror.width), dtype=np.bool_))
        self.colours: ColourModel | None = None
        self._learned: ColourModel | None = None
        self._tint = Tint(warmth=True)
        ring = (self._radius_px > mirror.inner_radius_px) & (self._radius_px < NEAR_SHARE * self.outer_px)
        every = max(math.isqrt(np.count_nonzero(ring) // TINT_PIXELS), 1)
        self._carpet = every * np.argwhere(ring[::every, ::every])
        self.green_ends_px = np.full(s.radial_scan_lines, self.outer_px)
        self._gaps = gap_lengths(mirror, self.scan_lines.radii_px, FIELD_GAP_M)
        self._smoothing_px = 0.0
        self._noise = self._learned_noise = 0.0
        self._greens = 0  # of the samples
        self._samples = no_samples(len(self.scan_lines.samples))
        self._found = np.empty((2048, COLUMNS))

    def learn(self, images: Sequence[ImageArray]) -> None:
        """Learn green, white and the robot's own body from a few images (H, W, 3), B, G, R, of this camera.

        Raises NoCarpetError where no green carpet is seen, InputError for an image of another size.
        """
        for image in images:
            check_size(image, self.camera)
        radius_px = self._radius_px
        beyond = radius_px > self.camera.inner_radius_px
        near, around = (beyond & (radius_px < share * self.outer_px) for share in (NEAR_SHARE, 0.9))
        noise = pixel_noise(images, near)
        smoothing_px = smoothing_for(noise)
        smooth = [smoothed(image, smoothing_px) for image in images]
        carpet = learn_carpet(smooth, near, around, noise)  # raises before anything has changed
        self._smoothing_px = smoothing_px
        self._see_body(np.zeros_like(self.body))
        self.colours, self._paint_m = colour_model(carpet), self.line_width_m
        found = [self._crossings(image).copy() for image in smooth]
        self._paint_m = self._paint_width(np.concatenate(found))
        if self._paint_m > self.line_width_m:
            found = [self._crossings(image).copy() for image in smooth]
        white = self._white_on_lines(smooth, found)
        if white is not None:
            self.colours = colour_model(carpet, white)
        self._see_body(self._own_body(smooth))
        self._know(self.colours, signal_noise(smooth, near, self.colours))

    def use_colours(self, colours: ColourModel, images: Sequence[ImageArray] = ()) -> None:
        """Take a learned or loaded colour table instead of learning one; `learn` would replace it.

        images: of this camera, to learn the robot's own body from; without any only what lies within
        inner_radius_px is left out.
        """
        for image in images:
            check_size(image, self.camera)
        self._know(colours, float(np.linalg.norm(colours.signal)) * min(colours.noise, SMOOTH_NOISE))
        self._smoothing_px = smoothing_for(colours.noise)
        smooth = [smoothed(image, self._smoothing_px) for image in images]
        self._see_body(self._own_body(smooth) if smooth else np.zeros_like(self.body))

    def forget(self) -> None:
        """Forget colours and body."""
        self._know(None)
        self._smoothing_px = 0.0
        self._see_body(np.zeros_like(self.body))

    def fetch(self, image: ImageArray) -> None:
        """Have an image (H, W, 3) of this camera in the processor's caches, where `follow` and `detect` read it in no
        order: nothing else changes. Raises InputError for one of another size.
        """
        check_size(image, self.camera)
        fetch(image, self.scan_lines)

    def follow(self, image: ImageArray) -> None:
        """Take on the tint that an image (H, W, 3) gives the carpet. Raises InputError for one of another size."""
        check_size(image, self.camera)
        learned = self._learned
        if learned is not None and self._tint.follow(image, self._carpet, learned.green):
            self.colours = tinted_model(learned, self._tint.value)
            longer = float(np.linalg.norm(self.colours.signal) / np.linalg.norm(learned.signal))
            self._noise = longer * self._learned_noise

    def _know(self, colours: ColourModel | None, noise: float = 0.0) -> None:
        """Take on colours, with the standard deviation of their signal."""
        self.colours = self._learned = colours
        self._noise = self._learned_noise = noise
        self._tint.forget()

    def detect(self, image: ImageArray) -> LinePoints:
        """Line points of an image (H, W, 3), B, G, R. Raises TouchlineError before `learn`."""
        check_size(image, self.camera)
        found = self._crossings(smoothed(image, self._smoothing_px), self.settings.paper.detector == "transitions")
        camera, noise = self.camera, (self.settings.noise_px**2, NOISE_M**2)
        return LinePoints(*_points_of(found, noise, camera.lookup_constants, camera.bearings_rad, camera.lookup_table))

    def stages(self, image: ImageArray) -> dict[str, ImageArray]:
        """Title -> picture (H, W, 3), B, G, R, of each step of `detect` on an image."""
        pixels = self.detect(image).pixels
        assert self.colours is not None, "detect raises without"
        smooth, model = smoothed(image, self._smoothing_px), self.colours
        classes = model.classify(smooth)
        level = (smooth @ model.signal) - float(model.green @ model.signal)
        grey = np.clip(64.0 + 160.0 * level, 0, 255).astype(np.uint8)
        layers = (classes == GREEN, GREEN_PAINT), (classes == WHITE, WHITE_PAINT), (self.body, BODY_PAINT)
        return {
            "colour classes": painted(smooth, *layers),
            "white against this green": np.repeat(grey[..., np.newaxis], 3, axis=2),
            "scan lines": self._scan_lines_picture(smooth),
            "field boundary": self._boundary_picture(smooth),
            "line points": points_picture(smooth, pixels),
        }

    def _scan_lines_picture(self, image: ImageArray) -> ImageArray:
        picture, lines = enlarged(image), self.scan_lines
        paths = np.split(lines.samples, lines.starts[1:-1])
        for is_closed, paint in ((False, RAY_PAINT), (True, CIRCLE_PAINT)):
            chosen = [path for path, samples in zip(paths, lines.closed, strict=True) if bool(samples) == is_closed]
            draw_paths(picture, chosen, paint, is_closed)
        return picture

    def _boundary_picture(self, image: ImageArray) -> ImageArray:
        picture = enlarged(image)
        angles = 2.0 * np.pi * np.arange(len(self.green_ends_px)) / len(self.green_ends_px)
        ends = np.column_stack((np.cos(angles), np.sin(angles))) * self.green_ends_px[:, np.newaxis]
        draw_paths(picture, [ends + self.camera.center], BOUNDARY_PAINT, closed=True, width=2)
        return picture

    @property
    def green_share(self) -> float:
        """Share of the last image's samples that were green."""
        return self._greens / len(self._samples.classes)

    def _crossings(self, image: ImageArray, transitions: bool = False) -> FloatArray:
        model, lines, s, camera = self.colours, self.scan_lines, self.settings, self.camera
        if model is None:
            raise TouchlineError("the detector has learned no colours yet: call learn() with a few images first")
        self._greens = sample_paths(
            image, lines, self._own, model.signal.astype(np.float32), model.table, self._samples
        )  # fmt: skip
        if transitions:
            found = find_transitions(lines, self._samples.classes, camera, MAX_RUN_PX)
        else:
            found = self._profiles(model)
        if not s.paper.within_green:
            return found
        rays = lines.starts, s.radial_scan_lines, self._samples, lines.radii_px
        return found[: keep_within_green(found, rays, self._gaps, camera.center, self.green_ends_px)]

    def _profiles(self, model: ColourModel) -> FloatArray:
        lines, s, camera = self.scan_lines, self.settings, self.camera
        limits = ProfileLimits(
            min_contrast=max(s.min_contrast, MIN_SIGMAS * self._noise),
            max_run=int(MAX_RUN_PX / MAX_STEP_PX),
            min_chord_m=0.5 * self.line_width_m,
            max_chord_m=STEEPEST_CROSSING * self._paint_m,
            blur_px=BLUR_PX,
            min_cosine=MIN_WHITENESS,
            carpet=dim_carpet(model),
            dark_floor=s.paper.dark_floor,
        )
        count = find_line_profiles(
            lines.samples, lines.starts, lines.closed, self._samples, (model.green, model.white), limits,
            (camera.lookup_constants, camera.bearings_rad, camera.lookup_table), self._found,
        )  # fmt: skip
        return self._found[:count]

    def _see_body(self, body: BoolArray) -> None:
        self.body, self._own = body, np.flatnonzero(self.scan_lines.at_samples(body))

    @property
    def _radius_px(self) -> FloatArray:
        """(H, W) distance of each pixel from the mirror's centre."""
        v, u = np.ogrid[0 : self.camera.height, 0 : self.camera.width]
        return np.hypot(u - self.camera.center[0], v - self.camera.center[1])

    def _paint_width(self, found: FloatArray) -> float:
        """The paint's width (m): the one that is set, or that of the crossings (M, COLUMNS) if those are far wider."""
        chords = found[np.hypot(found[:, 0], found[:, 1]) < NEAR_M, 5]
        if len(chords) < 20:
            return self.line_width_m
        seen = float(np.quantile(chords, 0.25)) / SHORT_CHORD
        return seen if seen > WIDER_PAINT * self.line_width_m else self.line_width_m

    def _white_on_lines(self, images: Sequence[ImageArray], crossings: Sequence[FloatArray]) -> FloatArray | None:
        """B, G, R (3,) of the paint, from the clearest half of the lines that a guessed white has found."""
        colours = []
        for image, found in zip(images, crossings, strict=True):
            u, v = np.rint(found[:, 2:4]).astype(int).T
            colours.append(np.column_stack((image[v, u], found[:, 4])))
        rows = np.concatenate(colours)
        if len(rows) < 20:
            return None
        clear = rows[rows[:, 3] >= np.median(rows[:, 3])]
        return np.median(clear[:, :3], axis=0)

    def _own_body(self, images: Sequence[ImageArray]) -> BoolArray:
        """Pixels near the centre that are green in none of the images and hang together with the robot.

        What is as narrow as a line is left out, and what is white and as narrow as two: the robot may stand on one.
        """
        assert self.colours is not None
        classes = [self.colours.classify(image) for image in images]
        inner = self.camera.inner_radius_px
        radius_px = self._radius_px
        disc = radius_px < inner
        solid = radius_px < 2.2 * inner
        white = ~disc
        for each in classes:
            solid &= (each != GREEN) | disc
            white &= each == WHITE
        metres_per_px = float(np.diff(self.camera.range_m.mean(axis=0)).min() / np.diff(self.camera.radius_px).max())
        paint_px = self._paint_m / max(metres_per_px, 1e-3)
        size = int(1.3 * paint_px) | 1
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        solid &= ~_bands(white, 2.6 * paint_px)
        opened = cv2.morphologyEx((solid | disc).astype(np.uint8), cv2.MORPH_OPEN, kernel)
        _, labels = cv2.connectedComponents(opened)
        u0, v0 = (round(c) for c in self.camera.center)
        own = (labels == labels[v0, u0]).astype(np.uint8)
        whole = cv2.dilate(own, kernel).astype(np.bool_) & (solid | disc)  # opening has cut the corners
        return cv2.dilate(whole.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(np.bool_)


def _bands(mask: BoolArray, widest_px: float) -> BoolArray:
    """What of a mask (H, W) is no wider than that and hangs together over a way far longer than it is wide."""
    size = int(widest_px) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    narrow = mask & ~cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, kernel).astype(np.bool_)
    depth = cv2.distanceTransform(narrow.astype(np.uint8), cv2.DIST_L2, 3)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(narrow.astype(np.uint8))
    width = np.zeros(count)
    np.maximum.at(width, labels[narrow].astype(np.intp), 2.0 * depth[narrow])
    long = stats[:, cv2.CC_STAT_AREA] >= BAND * width**2
    long[0] = False
    return long[labels]


@njit(cache=True)
def _points_of(crossings, noise, constants, bearings, table):  # type: ignore[no-untyped-def]
    """Positions (N, 2), covariances (N, 2, 2), confidences (N,) and pixels (N, 2) of crossings (N, COLUMNS).

    noise: variances of a pixel (px²) and of the ground (m²); the arrays are those of an OmniCamera.
    """
    positions, pixels = crossings[:, :2].copy(), crossings[:, 2:4].copy()
    confidences = np.minimum(np.maximum(crossings[:, 4], 0.0), 1.0)
    return positions, covariances_of_pixels(pixels, noise, constants, bearings, table), confidences, pixels
