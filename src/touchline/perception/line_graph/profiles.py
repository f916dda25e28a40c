"""Profiles across a line in the whole image: where exactly the paint lies, how wide it is, and what is beside it.

"We use subpixel precision when possible": the cells find lines, the pixels place them. An addition of ours.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray
from touchline.matrices import uncounted
from touchline.perception.line_graph.colour_classes import CELL_PX
from touchline.perception.line_graph.image_plane import ImagePlane, pixel_from_ground
from touchline.types import ImageArray

OUTSIDE, NO_LINE, LINE = 0, 1, 2
"""What a profile shows: it leaves the image, no line, a line."""
NEAR_PX = 2.0
"""How far off a line that other profiles have placed is looked for."""
_MAX_SAMPLES = 160
_RESULTS = 5
PROFILE_ROOM = _RESULTS + _MAX_SAMPLES
"""Numbers that a profile needs room for: what it found, then its samples."""
_FLANK_PX = 3  # carpet looked at on each side
_PER_WIDTH = 6.0  # samples across a line, at least, where it is so many pixels wide
_FAINTEST = 0.25  # least contrast of a line
_BRIGHTEST = 1.5  # of paint, where edges lie at half height: what was learned of thin lines is half carpet
_PALE_FLANK = 0.3  # what is beside a line is no whiter than this share of its contrast


class Cut(NamedTuple):
    """A cut through the image at right angles to a line: its middle and unit direction (px), the line's width there."""

    u: float
    v: float
    du: float
    dv: float
    width_px: float


class Pixels(NamedTuple):
    """What profiles are read from.

    image: (H, W, 3). least_green: excess of G from which on a colour is green, as a share of B + G + R. signal:
    (3, 256) what each value of B, G, R adds: 0 on carpet, 1 on paint in the light that was learned. base: (rows,
    columns) of cells, signal of the carpet about each, above that of the learned one. paint: by how much that of paint
    exceeds it there. width_m: of a line. loosest, tightest: how much wider and narrower than expected a line may look.
    """

    image: ImageArray
    least_green: float
    signal: FloatArray
    paint: FloatArray
    base: FloatArray
    width_m: float
    loosest: float
    tightest: float


@njit(cache=True, error_model="numpy")
def signal_at(pixels: Pixels, u: float, v: float) -> float:
    """How white a place of the image is, 0 carpet to 1 paint in the light about it, bilinear; it must lie inside."""
    image, signal = pixels.image, pixels.signal
    height, width = image.shape[0], image.shape[1]
    column, row = min(int(u), width - 2), min(int(v), height - 2)
    a, b = u - column, v - row
    total = 0.0
    for dv in range(2):
        for du in range(2):
            share = (a if du else 1.0 - a) * (b if dv else 1.0 - b)
            r, c = np.uintp(row + dv), np.uintp(column + du)
            blue, green, red = image[r, c, 0], image[r, c, 1], image[r, c, 2]
            total += share * (signal[0, np.uintp(blue)] + signal[1, np.uintp(green)] + signal[2, np.uintp(red)])
    cell_row = min(int(v) // CELL_PX, pixels.paint.shape[0] - 1)
    cell_column = min(int(u) // CELL_PX, pixels.paint.shape[1] - 1)
    r, c = np.uintp(cell_row), np.uintp(cell_column)
    return float((total - pixels.base[r, c]) / pixels.paint[r, c])


@njit(cache=True, error_model="numpy")
def is_carpet(pixels: Pixels, u: float, v: float) -> bool:
    """Whether the pixel nearest to a place of the image is greenish, however pale beside paint."""
    column, row = int(u + 0.5), int(v + 0.5)
    b, g, r = 1.0 * pixels.image[row, column, 0], 1.0 * pixels.image[row, column, 1], 1.0 * pixels.image[row, column, 2]
    return bool(g - 0.5 * (b + r) > pixels.least_green * (b + g + r))


@njit(cache=True, error_model="numpy")
def cut_across(pixels: Pixels, plane: ImagePlane, x: float, y: float, nx: float, ny: float) -> Cut:
    """The cut at a ground point (x, y) of a line with normal (nx, ny); its width is NaN where it is not seen."""
    u, v = pixel_from_ground(plane, x, y)
    half = 0.5 * pixels.width_m
    ua, va = pixel_from_ground(plane, x - half * nx, y - half * ny)
    ub, vb = pixel_from_ground(plane, x + half * nx, y + half * ny)
    # at right angles to the line in the image, which is not where its normal on the ground points
    ta, sa = pixel_from_ground(plane, x + half * ny, y - half * nx)
    tb, sb = pixel_from_ground(plane, x - half * ny, y + half * nx)
    length = math.hypot(tb - ta, sb - sa)
    du, dv = -(sb - sa) / length, (tb - ta) / length
    width = du * (ub - ua) + dv * (vb - va)
    if width < 0.0:
        du, dv, width = -du, -dv, -width
    height, columns = pixels.image.shape[0], pixels.image.shape[1]
    if not (0.0 <= u <= columns - 1 and 0.0 <= v <= height - 1 and width > 0.0):
        width = np.nan
    return Cut(u, v, du, dv, width)


@njit(cache=True, error_model="numpy")
def read_profile(
    pixels: Pixels, plane: ImagePlane, x: float, y: float, nx: float, ny: float, found: FloatArray, reach_px: float
) -> int:
    """Read a profile across a line whose ground point (x, y) and normal (nx, ny) are known to within reach_px.

    Writes the middle's pixel u, v, its width (px), the width expected (px) and its contrast into found (PROFILE_ROOM,),
    whose other numbers it uses. Returns OUTSIDE, NO_LINE or LINE.
    """
    cut = cut_across(pixels, plane, x, y, nx, ny)
    if not cut.width_px > 0.0:
        return OUTSIDE
    height, width = pixels.image.shape[0], pixels.image.shape[1]
    pitch = max(1.0, math.floor(cut.width_px / _PER_WIDTH))  # pixels between samples: near lines are wide
    wide, reach = cut.width_px / pitch, reach_px / pitch
    steps = int(min(wide * 1.3 + 2.0 + reach, 0.5 * _MAX_SAMPLES - 2))
    near = min(_near(wide, reach), steps)
    samples, top = uncounted(found)[_RESULTS : _RESULTS + 2 * steps + 1], -np.inf
    samples[:] = np.nan
    for k in range(-near, near + 1):
        samples[steps + k] = _sample(pixels, cut, pitch * k)
        top = samples[steps + k] if samples[steps + k] > top else top
    if not top > _FAINTEST:
        return NO_LINE
    for way in (-1, 1):
        for k in range(near + 1, steps + 1):  # as far as there is paint, and its flank
            last = k - _FLANK_PX
            if last >= near and not samples[steps + way * last] >= 0.5 * min(top, _BRIGHTEST):
                break
            samples[steps + way * k] = _sample(pixels, cut, pitch * way * k)
    shown, middle, paint, top = find_paint(samples, wide, reach)
    if shown != LINE:
        return shown
    middle, paint = (middle - steps) * pitch, paint * pitch
    if paint > pixels.loosest * cut.width_px + 1.5 or paint < pixels.tightest * cut.width_px - 0.5:
        return NO_LINE
    for side in (-1.0, 1.0):
        green = False
        for k in range(1, _FLANK_PX + 2):
            t = middle + side * (0.5 * paint + k)
            u, v = cut.u + t * cut.du, cut.v + t * cut.dv
            green = green or (0.0 <= u <= width - 1 and 0.0 <= v <= height - 1 and is_carpet(pixels, u, v))
        if not green:
            return NO_LINE
    found[0], found[1] = cut.u + middle * cut.du, cut.v + middle * cut.dv
    found[2], found[3], found[4] = paint, cut.width_px, top
    return LINE


@njit(cache=True, error_model="numpy", inline="always")
def _sample(pixels: Pixels, cut: Cut, t: float) -> float:
    """How white it is t pixels along a cut; NaN beyond the image's edge."""
    u, v = cut.u + t * cut.du, cut.v + t * cut.dv
    inside = 0.0 <= u <= pixels.image.shape[1] - 1 and 0.0 <= v <= pixels.image.shape[0] - 1
    return signal_at(pixels, u, v) if inside else np.nan


@njit(cache=True)
def _near(width_px: float, reach_px: float) -> int:
    """Samples to each side of the middle among which the paint's brightest lies."""
    return int(0.6 * width_px + reach_px)


@njit(cache=True, error_model="numpy", inline="always")
def find_paint(samples: FloatArray, width_px: float, reach_px: float) -> tuple[int, float, float, float]:
    """The run of paint next to the middle of samples (N,), within reach_px and half a line; its edges at half height.

    Returns what is shown, and of a LINE its middle (samples from the first), its width and its contrast.
    """
    n, middle = len(samples), len(samples) // 2
    near = _near(width_px, reach_px)
    top, peak = -np.inf, middle
    for k in range(max(0, middle - near), min(n, middle + near + 1)):
        if samples[k] > top:
            top, peak = samples[k], k
    if not top > _FAINTEST:
        return NO_LINE, 0.0, 0.0, 0.0
    half = 0.5 * min(top, _BRIGHTEST)
    low, high = peak, peak
    while low > 0 and samples[low - 1] >= half:
        low -= 1
    while high < n - 1 and samples[high + 1] >= half:
        high += 1
    if low == 0 or high == n - 1:
        return NO_LINE, 0.0, 0.0, 0.0
    if np.isnan(samples[low - 1]) or np.isnan(samples[high + 1]):
        return OUTSIDE, 0.0, 0.0, 0.0
    before, after = np.inf, np.inf
    for k in range(1, _FLANK_PX + 1):
        if low - k >= 0 and samples[low - k] < before:
            before = samples[low - k]
        if high + k < n and samples[high + k] < after:
            after = samples[high + k]
    if not (before < _PALE_FLANK * top and after < _PALE_FLANK * top):
        return NO_LINE, 0.0, 0.0, 0.0
    lower = low - (samples[low] - half) / max(samples[low] - samples[low - 1], 1e-9)
    upper = high + (samples[high] - half) / max(samples[high] - samples[high + 1], 1e-9)
    return LINE, 0.5 * (lower + upper), upper - lower, top
