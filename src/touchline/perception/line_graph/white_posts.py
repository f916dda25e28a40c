"""White goal posts: nothing but their place tells them from walls, so they are looked for where they must stand.

A post stands on a line of the field. Along each line that was found, every place is asked whether a ridge rises from
it, as wide and as high as a post there would look, along the direction in which uprights appear (section 4.3), and
whiter than what is on both sides of it. Ours: the paper's goals are coloured.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.field import Post
from touchline.geometry import FloatArray
from touchline.matrices import uncounted
from touchline.perception.line_graph.image_plane import ImagePlane, Numbers, pixel_from_plane
from touchline.perception.line_graph.profiles import Pixels, is_carpet, signal_at
from touchline.types import Lines

_BEYOND_M = 0.3  # a line that was found may end short of a post
_STEP, _COARSE = 0.15, 4  # of a post's diameter; where one in so many of these places is not white, no post is
_SAMPLES = 32  # up the post
_MIN_HEIGHT, _FOOT, _MAX_HEIGHT = -0.25, 0.25, 1.3  # of its height: what is looked at, and the top of its foot
_MIN_FREE, _FIRST = 0.08, 0.05  # of its height below and above 0: there is the line
_GLANCE = 0.15  # of its height: where it is white at any rate
_GROUND = math.ceil(-_MIN_HEIGHT / (_MAX_HEIGHT - _MIN_HEIGHT) * (_SAMPLES - 1))  # the first at it or above
_ENOUGH = 0.7  # share of the samples that are a ridge
_MIN_M, _MIN_PX = 0.4, 24.0  # of a post that must be visible
_MIN_WIDTH_PX = 5.0
_WHITE, _CONTRAST = 0.4, 0.05  # whiteness of a post, and how much whiter than both its sides it is
_STRONG, _STRONG_SHARE = 0.15, 0.25  # and much whiter at some of the samples
_INSIDE = 0.2  # of the width to each side of the middle: white, too; the threads of a net are thinner
_BEHIND = 3  # samples before what is no carpet: a line that runs away from the robot ends with the carpet
_APART_M = 0.4  # places closer than this are of one post
_MAX_RIDGES = 64


class Ridge(NamedTuple):
    """place: (2,) m, robot frame. share: of the samples that rise. pixel: (2,) of its foot."""

    place: FloatArray
    share: float
    pixel: FloatArray


def find_white_posts(pixels: Pixels, lines: Lines, plane: ImagePlane, post: Post, max_range_m: float) -> list[Ridge]:
    """Posts like this one on the lines, the surest first."""
    found = np.empty((_MAX_RIDGES, 5))
    found = found[: _find(pixels, plane, lines.ends_m, (post.height, post.diameter), max_range_m, found)]
    kept: list[Ridge] = []
    for row in found[np.argsort(-found[:, 0], kind="stable")]:
        ridge = Ridge(row[1:3], float(row[0]), row[3:5])
        if all(np.hypot(*(ridge.place - other.place)) > _APART_M for other in kept):
            kept.append(ridge)
    return kept


@njit(cache=True, error_model="numpy")
def _find(
    pixels: Pixels, plane: ImagePlane, lines: FloatArray, size: tuple[float, float], max_range_m: float,
    found: FloatArray,
) -> int:  # fmt: skip
    """The middle of each run of places along lines (L, 2, 2) with enough of a ridge, into found (N, 5): share, x, y, u,
    v; returns how many. size: height and diameter of a post (m).
    """
    pixels, plane, lines, found = uncounted((pixels, plane, lines, found))
    count, step, row = 0, _STEP * size[1], np.empty(4)
    for ends in lines:
        dx, dy = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
        length, weight = math.hypot(dx, dy), 0.0
        ux, uy = dx / length, dy / length
        begin = (ends[0, 0] - _BEYOND_M * ux, ends[0, 1] - _BEYOND_M * uy)
        near = ahead = _is_white_at(pixels, plane, begin, _GLANCE * size[0])
        for k in range(math.ceil((length + 2.0 * _BEYOND_M) / step) + 2 if length > 0.0 else 0):
            along = k * step - _BEYOND_M
            x, y = ends[0, 0] + along * ux, ends[0, 1] + along * uy
            if k % _COARSE == 0:
                far = _COARSE * step
                near, ahead = ahead, _is_white_at(pixels, plane, (x + far * ux, y + far * uy), _GLANCE * size[0])
            good = (near or ahead) and along < length + _BEYOND_M and math.hypot(x, y) <= max_range_m
            if good and _ridge_at(pixels, plane, (x, y), size, row) and count < len(found):
                if weight == 0.0:
                    found[count] = 0.0
                found[count, 0], weight = max(found[count, 0], row[0]), weight + row[1]
                found[count, 1], found[count, 2] = found[count, 1] + row[1] * x, found[count, 2] + row[1] * y
                found[count, 3], found[count, 4] = found[count, 3] + row[1] * row[2], found[count, 4] + row[1] * row[3]
            elif weight > 0.0:
                for column in range(1, 5):
                    found[count, column] /= weight
                count, weight = count + 1, 0.0
    return count


@njit(cache=True, error_model="numpy")
def _ridge_at(
    pixels: Pixels, plane: ImagePlane, place: tuple[float, float], size: tuple[float, float], row: FloatArray
) -> bool:
    """Whether enough of the visible samples above a place are a ridge; their share, contrast and the foot's u, v into
    row (4,).
    """
    above, foot = plane.height, plane.foot
    u, v = _pixel_above(plane, above, place, 0.0)
    if not (0.0 <= u < plane.size[0] and 0.0 <= v < plane.size[1]):
        return False
    if not _is_white_at(pixels, plane, place, _GLANCE * size[0]):
        return False
    if math.isnan(_pixel_above(plane, above, place, size[0])[0]):
        return False
    distance = math.sqrt((place[0] - foot[0]) ** 2 + (place[1] - foot[1]) ** 2 + above**2)
    width = plane.lens.pinhole[0] * size[1] / distance
    if width < _MIN_WIDTH_PX:
        return False
    row[0], row[1] = _rising(pixels, plane, above, place, (size[0], width))
    row[2], row[3] = u, v
    return row[0] >= _ENOUGH


@njit(cache=True, error_model="numpy")
def _is_white_at(pixels: Pixels, plane: ImagePlane, place: tuple[float, float], z: float) -> bool:
    """Whether it is white at a height (m) above a place."""
    u, v = _pixel_above(plane, plane.height, place, z)
    return bool(_whiteness(pixels, u, v) > _WHITE)


@njit(cache=True, error_model="numpy")
def _rising(
    pixels: Pixels, plane: ImagePlane, above: float, place: tuple[float, float], size: tuple[float, float]
) -> tuple[float, float]:
    """Share of the visible samples above a place that are a ridge, and their contrast; size: height (m), width (px).

    0 where a ridge begins only higher up, as that of a post behind this line, or comes from below, or does not end.
    """
    seen, risen = np.zeros(4), np.zeros(4)  # below the foot, at it, higher up, beyond the top
    strong = behind = 0
    contrast, lowest, highest = 0.0, -1e9, 1e9
    for step in range(_SAMPLES):  # from the ground up, and what is below it last: hardly a place has a foot
        z = _MIN_HEIGHT + (_MAX_HEIGHT - _MIN_HEIGHT) * ((step + _GROUND) % _SAMPLES) / (_SAMPLES - 1)
        part = 0 if z < 0.0 else 1 if z < _FOOT else 2 if z < 1.0 else 3
        if -_MIN_FREE < z < _FIRST or 1.0 <= z < 1.1:
            continue
        if part == 2 and (seen[1] < 2 or risen[1] < _ENOUGH * seen[1]):
            return 0.0, 0.0
        u, v = _pixel_above(plane, above, place, z * size[0])
        rises, bare = _ridge(pixels, plane, above, place, (z * size[0], size[1], u, v))
        if math.isnan(rises):
            continue
        seen[part] += 1
        if 1 <= part <= 2:
            lowest, highest = max(lowest, v), min(highest, v)
        if rises > _CONTRAST:
            risen[part] += 1
            if 1 <= part <= 2:
                strong += rises > _STRONG
                behind += bare
                contrast += min(rises, 0.5)
    if seen[2] > 0 and 3 * risen[0] > seen[0]:
        return 0.0, 0.0
    total = seen[1] + seen[2]
    long_enough = total * size[0] * (_MAX_HEIGHT - _MIN_HEIGHT) / _SAMPLES >= _MIN_M and lowest - highest >= _MIN_PX
    if not long_enough or behind < _BEHIND or strong < _STRONG_SHARE * total or 2 * risen[3] > seen[3]:
        return 0.0, 0.0
    return (risen[1] + risen[2]) / total, contrast


@njit(cache=True, error_model="numpy")
def _ridge(pixels: Pixels, plane: ImagePlane, above: float, place: Numbers, at: Numbers) -> tuple[float, bool]:
    """How much whiter it is here than on both sides, and whether one of these is no carpet; at: z, width, u, v.

    Not above 0 where it is no ridge, NaN outside the image.
    """
    z, width, u, v = at
    au, av = _pixel_above(plane, above, place, z + 0.1)
    length = math.hypot(au - u, av - v)
    nu, nv = (v - av) / length, (au - u) / length
    aside = 0.5 * width + max(3.0, 0.25 * width)
    left, right = (u + aside * nu, v + aside * nv), (u - aside * nu, v - aside * nv)
    one, other = _whiteness(pixels, left[0], left[1]), _whiteness(pixels, right[0], right[1])
    middle = least = _whiteness(pixels, u, v)
    if math.isnan(middle + one + other):  # max() would hide a NaN
        return np.nan, False
    for part in (-_INSIDE, _INSIDE):
        value = _whiteness(pixels, u + part * width * nu, v + part * width * nv)
        least, middle = min(least, value), middle + value
    rises = middle / 3.0 - max(one, other)
    if not (least > _WHITE and rises > _CONTRAST):
        return min(rises, _CONTRAST), False
    bare = not (is_carpet(pixels, left[0], left[1]) and is_carpet(pixels, right[0], right[1]))
    return rises, bare


@njit(cache=True, error_model="numpy")
def _pixel_above(plane: ImagePlane, above: float, place: Numbers, z: float) -> tuple[float, float]:
    """Pixel of what is at a height z (m) above a place (2,), seen from a height above; NaN behind the camera."""
    h, foot = plane.plane, plane.foot
    w = above - z
    x, y = foot[0] * w + (place[0] - foot[0]) * above, foot[1] * w + (place[1] - foot[1]) * above
    depth = h[6] * x + h[7] * y + h[8] * w
    if depth <= 1e-9:
        return np.nan, np.nan
    a, b = (h[0] * x + h[1] * y + h[2] * w) / depth, (h[3] * x + h[4] * y + h[5] * w) / depth
    return pixel_from_plane(plane.lens, a, b)


@njit(cache=True, error_model="numpy")
def _whiteness(pixels: Pixels, u: float, v: float) -> float:
    """NaN outside the image."""
    height, width = pixels.image.shape[:2]
    return signal_at(pixels, u, v) if 0.0 <= u < width - 1 and 0.0 <= v < height - 1 else np.nan
