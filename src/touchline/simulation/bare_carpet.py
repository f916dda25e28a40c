"""Bare carpet, most of every image: rays that no paint, seam, body or edge of the light is near.

They are set apart (`sift_ground`) and shaded in short loops of float32 without branches, which the compiler makes wide.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.illumination import (
    FLAGS_PER_M,
    HAS_PAINT,
    HAS_SEAM,
    NEAR_BODY,
    PAINT_AROUND,
    PAINT_NEAR,
    SUN_EDGE,
    SUN_MARGIN_M,
    SUNLIT,
)
from touchline.simulation.paint import MARGIN_M, MIDDLE_MARGIN_M, TIGHT_MARGIN_M
from touchline.simulation.pile import FIRST_TEXEL_M, PILE, TILE_TEXELS, TONE_M, past_seam, reaches_texels, two_levels

Float32Array = npt.NDArray[np.float32]
POINT_ROWS, PLACE_ROWS = 4, 5  # of the work space of `shade_bare`


@njit(cache=True, error_model="numpy")
def sift_ground(
    ground: npt.NDArray[np.int32],
    cast: Float32Array,
    extents: Float32Array,
    shift: float,
    texture: Float32Array,
    flags: npt.NDArray[np.uint8],
    paint_frame: FloatArray,
    carpet: FloatArray,
    sun: FloatArray,
    bare: npt.NDArray[np.int32],
    places: Float32Array,
    points: Float32Array,
) -> tuple[int, int, int]:
    """Move those of the rays on the carpet (N,) that see nothing but carpet to `bare`; count the others, these, points.

    Rays: see `shade_ground`. places (5, N): x, y of each (m), 1 in the sun, its first point and how many. points
    (4, 4 N): x, y of points on the pile and the square (m^2) it is smoothed over there: one for each ray, or its
    pixel's four samples.
    """
    left, count, dots = 0, 0, 0
    x0, y0, sunny, first = paint_frame[0], paint_frame[1], sun[0] > 0.0, FIRST_TEXEL_M * FIRST_TEXEL_M
    for n in range(len(ground)):
        i = np.uint32(ground[n])
        s, ux, uy, stretch = float(cast[6, i]), float(cast[3, i]), float(cast[4, i]), float(cast[8, i])
        x, y = cast[0, i] + s * ux, cast[1, i] + s * uy
        deep, wide = float(extents[2, i]), s * extents[0, i] + shift
        reach, long = deep + wide, texture[4, i] * stretch
        square = 1.5 * long * long
        flag = flags[np.uint32((y - y0) * FLAGS_PER_M), np.uint32((x - x0) * FLAGS_PER_M)] & 0xFF
        watched = HAS_PAINT | NEAR_BODY | HAS_SEAM | SUN_EDGE
        if reach >= TIGHT_MARGIN_M:
            watched |= PAINT_NEAR if reach < MIDDLE_MARGIN_M else PAINT_NEAR | PAINT_AROUND
        other = flag & watched != 0 or reach >= MARGIN_M or (sunny and reach >= SUN_MARGIN_M)
        if deep > 0.0 and not other:
            aside = abs(ux) * deep + abs(uy) * wide
            other = (square < 32.0 * first and two_levels(square / first, 4.0 * s * deep / (stretch * cast[2, i]))) or (
                carpet[3] > 0.0 and aside > TONE_M and abs(past_seam(carpet, x)) < aside + TONE_M
            )
        if other:
            ground[left] = i
            left += 1
            continue
        bare[count] = i
        places[0, count], places[1, count], places[2, count] = x, y, 1.0 if flag & SUNLIT else 0.0
        places[3, count], places[4, count] = dots, 1.0
        points[0, dots], points[1, dots], points[2, dots] = x, y, square
        if square <= first and deep > 0.0:
            across = np.sqrt(stretch * cast[2, i])
            p, aside, q, off = (
                texture[0, i] * stretch, texture[1, i] * across, texture[2, i] * stretch, texture[3, i] * across
            )  # fmt: skip
            px, py, qx, qy = p * ux - aside * uy, p * uy + aside * ux, q * ux - off * uy, q * uy + off * ux
            if reaches_texels(px, py, qx, qy):
                points[0, dots], points[1, dots] = x + px + qx, y + py + qy
                points[0, dots + 1], points[1, dots + 1] = x + px - qx, y + py - qy
                points[0, dots + 2], points[1, dots + 2] = x - px + qx, y - py + qy
                points[0, dots + 3], points[1, dots + 3] = x - px - qx, y - py - qy
                points[2, dots : dots + 4] = 0.0
                places[4, count] = 4.0
                dots += 3
        dots += 1
        count += 1
    return left, count, dots


@njit(cache=True, error_model="numpy")
def shade_bare(
    bare: npt.NDArray[np.int32],
    places: Float32Array,
    points: Float32Array,
    dots: int,
    light: Float32Array,
    light_frame: FloatArray,
    carpet: FloatArray,
    pyramid: Float32Array,
    sun: FloatArray,
    radiance: Float32Array,
) -> None:
    """Fill radiance (N, 3) of the rays that `bare` (M,) lists, with places and points of `sift_ground`."""
    count = len(bare)
    look_up_pile(points[0, :dots], points[1, :dots], points[2, :dots], pyramid, points[3, :dots])
    frame = np.float32(light_frame[0]), np.float32(light_frame[1]), np.float32(light_frame[2])
    columns, rows, flat = np.float32(light.shape[1]), np.float32(light.shape[0]), light.reshape(-1)
    look_up_light(places[0, :count], places[1, :count], frame, columns, rows, flat, np.float32(sun[0]), places[2, :count])
    red, green, blue = np.float32(carpet[0]), np.float32(carpet[1]), np.float32(carpet[2])
    strength, one = np.float32(carpet[4] * PILE), np.float32(1.0)
    for n in range(count):
        dot, i = np.uint32(places[3, n]), np.uint32(bare[n])
        grain = points[3, dot]
        if places[4, n] > one:
            grain = (
                grain + points[3, dot + np.uint32(1)] + points[3, dot + np.uint32(2)] + points[3, dot + np.uint32(3)]
            ) * np.float32(0.25)
        level = places[2, n] * (one + strength * grain)
        radiance[i, 0], radiance[i, 1], radiance[i, 2] = red * level, green * level, blue * level


@njit(cache=True, error_model="numpy")
def look_up_pile(x: Float32Array, y: Float32Array, square: Float32Array, pyramid: Float32Array, out: Float32Array) -> None:
    """`pile.pile_at` for points (N,) at once, in float32.

    Numbers of texels are whole numbers below 2^24, so float32 holds them exactly, and wide registers work on them.
    """
    one, two, three, half = np.float32(1.0), np.float32(2.0), np.float32(3.0), np.float32(0.5)
    per_square, per_m = np.float32(1.0 / FIRST_TEXEL_M**2), np.float32(1.0 / FIRST_TEXEL_M)
    largest, all_finest = np.float32(TILE_TEXELS), np.float32(TILE_TEXELS * TILE_TEXELS)
    third = np.float32(4.0 / 3.0)
    for n in range(len(out)):
        texels = square[n] * per_square
        part = one if texels <= one else half
        part = part if texels <= np.float32(4.0) else np.float32(0.25)
        part = part if texels <= np.float32(16.0) else np.float32(0.125)
        part = part if texels <= np.float32(64.0) else np.float32(1.0 / 16.0)
        part = part if texels <= np.float32(256.0) else np.float32(1.0 / 32.0)
        part = part if texels <= np.float32(1024.0) else np.float32(1.0 / 64.0)
        part = part if texels <= np.float32(4096.0) else np.float32(1.0 / 128.0)
        part = part if texels <= np.float32(16384.0) else np.float32(1.0 / 256.0)
        size = largest * part
        start = np.floor((all_finest - size * size) * third + half)
        fx, fy, per_size = x[n] * per_m * part, y[n] * per_m * part, one / size
        i, j = np.floor(fx), np.floor(fy)
        a, b = fx - i, fy - j
        a, b = a * a * (three - two * a), b * b * (three - two * b)
        i, j = i - size * np.floor(i * per_size), j - size * np.floor(j * per_size)
        i1, j1 = i + one, j + one
        i1, j1 = i1 if i1 < size else i1 - size, j1 if j1 < size else j1 - size
        low, high = start + j * size, start + j1 * size
        top = pyramid[np.uint32(low + i)] * (one - a) + pyramid[np.uint32(low + i1)] * a
        bottom = pyramid[np.uint32(high + i)] * (one - a) + pyramid[np.uint32(high + i1)] * a
        out[n] = top * (one - b) + bottom * b


@njit(cache=True, error_model="numpy")
def look_up_light(
    x: Float32Array,
    y: Float32Array,
    frame: tuple[np.float32, np.float32, np.float32],
    columns: np.float32,
    rows: np.float32,
    light: Float32Array,
    sun: np.float32,
    sunlit: Float32Array,
) -> None:
    """Light on bare carpet (N,) at points (N,), into `sunlit`, which holds 1 where the sun shines with its level `sun`.

    light: the map of `illumination.light_at`, flat.
    """
    one, two, none = np.float32(1.0), np.float32(2.0), np.float32(0.0)
    last_x, last_y = columns - np.float32(1.001), rows - np.float32(1.001)
    for n in range(len(sunlit)):
        fx, fy = (x[n] - frame[0]) * frame[2], (y[n] - frame[1]) * frame[2]
        fx, fy = min(max(fx, none), last_x), min(max(fy, none), last_y)
        i, j = np.floor(fx), np.floor(fy)
        a, b = fx - i, fy - j
        low, high = two * (j * columns + i), two * (j * columns + columns + i)
        lamps = (light[np.uint32(low)] * (one - a) + light[np.uint32(low + two)] * a) * (one - b) + (
            light[np.uint32(high)] * (one - a) + light[np.uint32(high + two)] * a
        ) * b
        low, high = low + one, high + one
        carpet = (light[np.uint32(low)] * (one - a) + light[np.uint32(low + two)] * a) * (one - b) + (
            light[np.uint32(high)] * (one - a) + light[np.uint32(high + two)] * a
        ) * b
        sunlit[n] = carpet * (one + sunlit[n] * sun / lamps)
