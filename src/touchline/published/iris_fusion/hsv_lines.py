"""Image -> line points by thresholds on HSV and HSL, after figures 6 and 7 of the IRIS paper.

M. A. Ismail, D. Purwanto, A. Arifin: Soccer robot localization based on sensor fusion from odometry and omnivision,
section II.B.

    image ─┬─▶ HSV threshold ─▶ convex hull ─┬─▶ AND ─▶ distances along rays every 2.5° ─▶ pixels to centimetres
           └─▶ HSL threshold ────────────────┘
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from pydantic import Field

from touchline.camera import Camera, OmniCamera, open_camera, require_omni
from touchline.config import Settings, added
from touchline.errors import InputError
from touchline.geometry import BoolArray, ByteArray, FloatArray
from touchline.perception.colour import NoCarpetError, pixel_noise, smoothed, smoothing_for
from touchline.perception.detector import check_size, image_of, with_lean
from touchline.perception.ray_runs import RUN_COLUMNS, RayPictures, Rays, RunLimits, white_runs
from touchline.perception.scan_lines import usable_radius
from touchline.perception.stages import (
    BOUNDARY_PAINT,
    GREEN_PAINT,
    RAY_PAINT,
    WHITE_PAINT,
    draw_paths,
    enlarged,
    painted,
    points_picture,
)
from touchline.published.iris_fusion.hsv_thresholds import (
    AutomaticThresholds,
    FixedThresholds,
    Thresholds,
    automatic_thresholds,
    fixed_thresholds,
)
from touchline.types import Frame, ImageArray, LinePoints, Observation

_MAX_RUNS = 2048
_COARSE = 2  # the hull is looked for at half the resolution
_ROWS = 8  # every eighth row tells the noise
_THIN = 4  # every fourth pixel both ways is plenty for a histogram


# gaps in the green up to this wide are closed before the field is looked for: lines at the robot's foot are 12 wide
CLOSING_PX = 13
OPENING_PX = 5  # specks of green up to this wide are left out: posters, robots
SMOOTHING_PX = 0.8  # least blur before the thresholds (standard deviation, px); a noisy image gets more
GAP_PX = 1  # gap within a run of white that is bridged: noise
FLANK_PX = 4  # how far beyond a run its edge and the green are looked for
MAX_RUN = 6.0  # longest run on the ground, in line widths: 6 is a crossing at 10°
COARSEST_PX_M = 0.25  # nothing is looked for where a pixel is longer than this on the ground
NOISE_M = 0.01  # standard deviation of a point on the ground that comes from no pixel


class HsvLinePaper(Settings):
    """Switches to the paper's exact form."""

    min_green: int = added(
        1,
        paper=0,
        ge=0,
        le=1_000,
        description="least green samples within flank_px on each side of a run; 0 as in the paper, which takes every "
        "white run in the hull: goals, nets and robots, too",
    )
    short_runs: bool = added(
        True, paper=False, description="runs longer than six line widths are none; false as in the paper: all are"
    )
    thresholds: Literal["automatic", "fixed"] = added(
        "automatic",
        paper="fixed",
        description="automatic: taken from every image's own histograms; fixed: set by hand for one lighting, as the "
        "paper does and names as its weakness",
    )


class HsvLineSettings(Settings):
    """Detection of lines by thresholds. Lengths in the image are in pixels, for images of about 500 pixels."""

    fixed: FixedThresholds = FixedThresholds()
    automatic: AutomaticThresholds = AutomaticThresholds()
    ray_step_deg: float = Field(2.5, ge=0.036, le=45, description="angle between rays (degrees); the paper's 2.5")
    paper: HsvLinePaper = HsvLinePaper()
    range_file: str | None = Field(
        None,
        description="camera.yaml that touchline calibrate range has written; none: the range table of the recording's",
    )
    noise_px: float = Field(0.4, gt=0, description="standard deviation of a point in the image (px)")


@dataclass(frozen=True, eq=False, slots=True)
class Masks:
    """What figure 6 makes of an image, each (H, W): HSL lightness, and 255 where it is green, inside the hull of the
    green, white, and white inside the hull.
    """

    lightness: ImageArray
    green: ImageArray
    field: ImageArray
    white: ImageArray
    lines: ImageArray


class HsvLineDetector:
    """A `Detector` of line points by thresholds; nothing has to be learned."""

    learns_colours = False

    def __init__(self, camera: Camera, settings: HsvLineSettings | None = None, line_width_m: float = 0.125) -> None:
        """Raises InputError for a camera that does not look at a mirror, and if the settings' range_file can't be read
        or is of another image size.
        """
        self.settings = s = settings or HsvLineSettings()
        mirror = require_omni(camera, "line points are found along rays in images of")
        self.camera = _with_ranges(mirror, s.range_file)
        self.line_width_m = line_width_m
        self.outer_px = usable_radius(self.camera, COARSEST_PX_M)
        angles = np.radians(np.arange(0.0, 360.0, s.ray_step_deg))
        self.rays = np.column_stack((np.cos(angles), np.sin(angles)))
        v, u = np.mgrid[0 : mirror.height, 0 : mirror.width]
        radius = np.hypot(u - mirror.center[0], v - mirror.center[1])
        self._seen = np.where(radius <= mirror.outer_radius_px, 255, 0).astype(np.uint8)
        self._body = (radius <= mirror.inner_radius_px)[::_COARSE, ::_COARSE]
        ring: BoolArray = (radius > mirror.inner_radius_px) & (radius < 0.8 * self.outer_px)
        self._noise_rows = np.ascontiguousarray(ring[::_ROWS])
        self._ring = np.flatnonzero(ring[::_THIN, ::_THIN])
        self._closing, self._opening = (
            cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (px // _COARSE | 1, px // _COARSE | 1))
            for px in (CLOSING_PX, OPENING_PX)
        )
        self._found = np.empty((_MAX_RUNS, RUN_COLUMNS))
        self.thresholds: Thresholds | None = None
        """Of the last image."""

    def reset(self) -> None:
        """Nothing is to be forgotten: every image is looked at by itself."""

    def observe(self, frame: Frame) -> Observation:
        """Line points of a frame's image, none where no carpet is seen. Raises InputError for one of another size."""
        try:
            points = self.detect(image_of(frame, self.camera))
        except NoCarpetError as error:
            return Observation(frame.stamp_ns, problem=str(error))
        return Observation(frame.stamp_ns, with_lean(points, frame, self.camera, self.settings.noise_px, NOISE_M))

    def detect(self, image: ImageArray) -> LinePoints:
        """Line points of an image (H, W, 3), B, G, R, uint8. Raises NoCarpetError where no green is seen."""
        found = self._distances(self.masks(image))
        covariances = self.camera.ground_covariances(found[:, 2:4], self.settings.noise_px, NOISE_M)
        confidences = np.clip(found[:, 4] / 100.0, 0.0, 1.0)
        return LinePoints(found[:, :2].copy(), covariances, confidences, found[:, 2:4].copy())

    def masks(self, image: ImageArray) -> Masks:
        """Figure 6: two thresholds, hull and AND of an image (H, W, 3)."""
        check_size(image, self.camera)
        noise = pixel_noise([image[::_ROWS]], self._noise_rows)
        smooth = smoothed(image, max(SMOOTHING_PX, smoothing_for(noise)))
        hsv = np.asarray(cv2.cvtColor(smooth, cv2.COLOR_BGR2HSV), dtype=np.uint8)
        hls = np.asarray(cv2.cvtColor(smooth, cv2.COLOR_BGR2HLS), dtype=np.uint8)
        lightness = np.ascontiguousarray(hls[..., 1])
        self.thresholds = limits = self._choose(hsv, lightness)
        green = limits.green(hsv) & self._seen
        field = self._field(green)
        white = limits.white(hls) & ~green
        return Masks(lightness, green, field, white, white & field)

    def stages(self, image: ImageArray) -> dict[str, ImageArray]:
        """Title -> picture (H, W, 3), B, G, R, of each step of figures 6 and 7 on an image."""
        pixels, masks = self.detect(image).pixels, self.masks(image)
        return {
            "HSV threshold": painted(image, (masks.green > 0, GREEN_PAINT)),
            "convex hull": _hull_picture(image, masks.field),
            "HSL threshold": painted(image, (masks.white > 0, WHITE_PAINT)),
            "bitwise AND": painted(image, (masks.lines > 0, WHITE_PAINT)),
            "distances along rays": self._rays_picture(masks, pixels),
            "line points": points_picture(image, pixels),
        }

    def _rays_picture(self, masks: Masks, pixels: FloatArray) -> ImageArray:
        """A stroke from the robot's rim to every point, over the white that the rays cross."""
        black = np.zeros((*masks.lines.shape, 3), dtype=np.uint8)
        picture = enlarged(painted(black, (masks.lines > 0, WHITE_PAINT)))
        center = np.array(self.camera.center)
        offset = pixels - center
        rims = center + offset * (self.camera.inner_radius_px / np.hypot(*offset.T))[:, np.newaxis]
        draw_paths(picture, np.stack((rims, pixels), axis=1), RAY_PAINT, closed=False)
        return picture

    def _choose(self, hsv: ImageArray, lightness: ImageArray) -> Thresholds:
        if self.settings.paper.thresholds == "fixed":
            return fixed_thresholds(self.settings.fixed)
        thin = hsv[::_THIN, ::_THIN].reshape(-1, 3)[self._ring], lightness[::_THIN, ::_THIN].reshape(-1)[self._ring]
        return automatic_thresholds(*thin, self.settings.automatic)

    def _field(self, green: ByteArray) -> ByteArray:
        """(H, W) 255 inside the convex hull of the carpet: the largest green area, what divides it closed."""
        coarse = np.ascontiguousarray(green[::_COARSE, ::_COARSE])
        coarse[self._body] = 255
        closed = cv2.morphologyEx(coarse, cv2.MORPH_CLOSE, self._closing)
        opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, self._opening)
        outlines, _ = cv2.findContours(opened, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        field = np.zeros_like(green)
        if outlines:
            hull = cv2.convexHull(max(outlines, key=cv2.contourArea))
            cv2.fillConvexPoly(field, _COARSE * hull, 255)
        return field

    def _distances(self, masks: Masks) -> FloatArray:
        """Figure 7: the runs of white along every ray, (M, RUN_COLUMNS)."""
        s, camera = self.settings, self.camera
        pictures = RayPictures(masks.lines, masks.green, masks.lightness)
        u0, v0 = camera.center
        rays = Rays(self.rays, float(u0), float(v0), float(camera.inner_radius_px), self.outer_px)
        longest_m = MAX_RUN * self.line_width_m if s.paper.short_runs else math.inf
        limits = RunLimits(FLANK_PX, GAP_PX, longest_m, s.paper.min_green)
        lookup = camera.lookup_constants, camera.bearings_rad, camera.lookup_table
        count = white_runs(pictures, rays, limits, lookup, self._found)
        return self._found[:count]


def _with_ranges(camera: OmniCamera, file: str | None) -> OmniCamera:
    if file is None:
        return camera
    ranged = require_omni(open_camera(Path(file)), f"{file}: the setting range_file has to name")
    if (ranged.width, ranged.height) != (camera.width, camera.height):
        raise InputError(
            f"{file}: is for images of {ranged.width} x {ranged.height} pixels, the recording's have "
            f"{camera.width} x {camera.height}"
        )
    return ranged


def _hull_picture(image: ImageArray, field: ImageArray) -> ImageArray:
    outlines, _ = cv2.findContours(field, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    picture = enlarged(image)
    draw_paths(
        picture, [outline[:, 0].astype(np.float64) for outline in outlines], BOUNDARY_PAINT, closed=True, width=2
    )
    return picture
