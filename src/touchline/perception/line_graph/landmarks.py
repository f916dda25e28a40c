"""Goal posts, goals and poles (section 4.3): sums of their colours along the directions in which they appear.

What stands upright lies at one azimuth of the camera's rays, whatever the lens and the lean: every cell contributes to
the sum of its azimuth. Maxima are looked at more closely: where they stand, how high and wide they are, in which order
their colours come.
"""

from __future__ import annotations

import math
from itertools import combinations, groupby
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.perception.line_graph.colour_classes import BLUE, CELL_PX, FULL, YELLOW, CountArray
from touchline.perception.line_graph.graph import IntArray
from touchline.perception.line_graph.image_plane import (
    ImagePlane,
    ground_covariances,
    grounds_from_pixels,
    plane_from_pixel,
    transformed,
)
from touchline.perception.line_graph.penalty_marks import find_penalty_marks
from touchline.perception.line_graph.profiles import Pixels
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.line_graph.structure import Structure
from touchline.perception.line_graph.white_posts import find_white_posts
from touchline.types import Colors, LandmarkKind, Landmarks, Lines, no_landmarks

_COLOURS = {"yellow": YELLOW, "blue": BLUE}
_OFF_LINES_PX = 12.0  # penalty marks lie farther from all lines
_WHITE: Colors = ("white",)
_BIN_PX = 6.0
_FILLED = 0.25  # share of colour from which on a cell counts
_FEWEST_CELLS = 3
_NEARBY = 10  # bins to each side of which one stands out
_GAP_CELLS = 1
_LEAST_HEIGHT, _MOST_WIDTH = 0.5, 2.2  # of what is expected
_MOST_BESIDE = 0.4  # of its rows: the colour may go on there, a crossbar or something behind
_EQUAL_BANDS = 2.0
_ONE_BAND = 1.4  # of a band's height: what is of one colour beyond it is no pole
_SAME_M = 0.4  # two uprights closer than this are one
_GOAL_M = 0.35  # how far the distance between two posts of a goal may be off, and more with the range
_FOOT_PX = 3.0  # standard deviation of a foot


class Upright(NamedTuple):
    """Something upright: where it stands (m, robot frame), the pixel of its foot, its colours from the ground up.

    cut: whether it leaves the image at the top. seen_m: how much of its height is seen.
    """

    place: FloatArray
    pixel: FloatArray
    colors: Colors
    cut: bool = False
    seen_m: float = 0.0


class _Landmark(NamedTuple):
    """One row of `Landmarks`; its error in the image (px) and on the ground (m)."""

    kind: LandmarkKind
    upright: Upright
    confidence: float
    noise: tuple[float, float] = (_FOOT_PX, 0.03)


def find_landmarks(
    structure: Structure,
    pixels: Pixels,
    lines: Lines,
    plane: ImagePlane,
    field: FieldModel,
    settings: LineGraphSettings,
) -> Landmarks:
    """Posts, goals and poles in colour; white posts, their goals, and penalty marks. lines: of the same image."""
    found = _coloured(structure, plane, field, settings)
    if settings.paper.white_marks:
        found += _white_posts(pixels, lines, plane, field, settings)
        found += _penalty_marks(structure, lines, plane, field)
    found += _goals([one.upright for one in found if one.kind == LandmarkKind.POST], field)
    if not found:
        return no_landmarks()
    noise = np.stack([_covariance(one, plane) for one in found])
    return Landmarks(
        np.array([str(one.kind) for one in found]),
        np.stack([one.upright.place for one in found]),
        noise,
        np.array([one.confidence for one in found]),
        tuple(one.upright.colors for one in found),
        np.stack([one.upright.pixel for one in found]),
    )


def _covariance(one: _Landmark, plane: ImagePlane) -> FloatArray:
    """(2, 2) m²."""
    if one.kind == LandmarkKind.GOAL:
        return np.eye(2) * (0.05 + 0.03 * float(np.hypot(*one.upright.place))) ** 2
    covariance: FloatArray = ground_covariances(plane, one.upright.pixel[np.newaxis], *one.noise)[0]
    return covariance


def _coloured(
    structure: Structure, plane: ImagePlane, field: FieldModel, settings: LineGraphSettings
) -> list[_Landmark]:
    if not {color for post in field.posts for color in post.colors_from_ground} & set(_COLOURS):
        return []
    found: list[_Landmark] = []
    for upright in _uprights(structure.counts, structure.ends, plane, field, settings):
        kind = _kind(upright, field)
        if kind is not None:
            found.append(_Landmark(kind[0], upright._replace(colors=kind[1]), 0.8))
    return found


def _white_posts(
    pixels: Pixels, lines: Lines, plane: ImagePlane, field: FieldModel, settings: LineGraphSettings
) -> list[_Landmark]:
    white = [post for post in field.posts if post.colors_from_ground == _WHITE]
    if not white:
        return []
    return [
        _Landmark(LandmarkKind.POST, Upright(ridge.place, ridge.pixel, _WHITE), ridge.share, (2.0, 0.03))
        for ridge in find_white_posts(pixels, lines, plane, white[0], settings.farthest_m)
    ]


def _penalty_marks(structure: Structure, lines: Lines, plane: ImagePlane, field: FieldModel) -> list[_Landmark]:
    sizes = [size for x, y, size in field.discs if not _on_a_line(field, x, y)]
    if not sizes:
        return []
    middles = find_penalty_marks(structure.counts, structure.ends, plane, float(sizes[0]))
    middles = np.array([middle for middle in middles if not _near_a_line(middle, lines)]).reshape(-1, 2)
    places = grounds_from_pixels(plane, middles)
    return [
        _Landmark(LandmarkKind.PENALTY_MARK, Upright(place, middle, ()), 0.7, (1.5, 0.02))
        for place, middle in zip(places, middles, strict=True)
    ]


def _near_a_line(pixel: FloatArray, lines: Lines) -> bool:
    """Whether a pixel (2,) lies so near to a line that was found that it may be a piece of its paint."""
    for start, end in lines.pixels:
        along = end - start
        share = float(np.clip((pixel - start) @ along / max(float(along @ along), 1.0), 0.0, 1.0))
        if np.hypot(*(pixel - start - share * along)) < _OFF_LINES_PX:
            return True
    return False


def _on_a_line(field: FieldModel, x: float, y: float) -> bool:
    return bool(field.line_distances(np.array([[x, y]]))[0] < field.line_width)


def joined(one: Landmarks, other: Landmarks) -> Landmarks:
    """All landmarks of both."""
    if not len(one) or not len(other):
        return other if not len(one) else one
    return Landmarks(
        np.concatenate((one.kinds, other.kinds)),
        np.concatenate((one.positions_m, other.positions_m)),
        np.concatenate((one.covariances_m2, other.covariances_m2)),
        np.concatenate((one.confidences, other.confidences)),
        one.colors + other.colors,
        np.concatenate((one.pixels, other.pixels)),
    )


def _uprights(
    counts: CountArray, ends: FloatArray, plane: ImagePlane, field: FieldModel, settings: LineGraphSettings
) -> list[Upright]:
    """Everything upright in the colours of posts and poles."""
    coloured = counts[YELLOW].astype(np.int64) + counts[BLUE]
    if not (coloured > _FILLED * FULL).any():
        return []
    bins, azimuths = azimuth_bins(plane, coloured.shape[0], coloured.shape[1], _BIN_PX / plane.lens.pinhole[0])
    sums = np.bincount(bins.ravel(), weights=coloured.ravel(), minlength=len(azimuths)) / FULL
    nearby = np.lib.stride_tricks.sliding_window_view(np.pad(sums, _NEARBY), 2 * _NEARBY + 1).max(axis=1)
    strong = sums > np.maximum(_FEWEST_CELLS, 0.3 * nearby)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], strong, [False])).astype(np.int8)))
    found: list[Upright] = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        cells = (bins >= first) & (bins < last) & (coloured > _FILLED * FULL)
        upright = _look_closer(cells, counts, ends, plane, field)
        if upright is None or np.hypot(*upright.place) > settings.farthest_m:
            continue
        if all(np.hypot(*(upright.place - other.place)) > _SAME_M for other in found):
            found.append(upright)
    return found


@njit(cache=True, error_model="numpy")
def azimuth_bins(plane: ImagePlane, rows: int, columns: int, step: float) -> tuple[IntArray, FloatArray]:
    """Which bin (rows, columns) of azimuth each cell lies in, and the azimuth (B,) of each bin, robot frame."""
    azimuths = np.empty((rows, columns))
    h, foot = plane.ground, plane.foot
    middle = math.atan2(h[1, 2] - foot[1] * h[2, 2], h[0, 2] - foot[0] * h[2, 2])
    for row in range(rows):
        for column in range(columns):
            centre = 0.5 * (CELL_PX - 1)
            x, y = plane_from_pixel(plane.lens, CELL_PX * column + centre, CELL_PX * row + centre)
            w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
            ahead = h[0, 0] * x + h[0, 1] * y + h[0, 2] - foot[0] * w
            aside = h[1, 0] * x + h[1, 1] * y + h[1, 2] - foot[1] * w
            off = math.atan2(aside, ahead) - middle
            azimuths[row, column] = math.atan2(math.sin(off), math.cos(off))
    least, most = np.inf, -np.inf
    for azimuth in azimuths.ravel():  # min and max ignore what is no number
        least, most = min(least, azimuth), max(most, azimuth)
    bins = np.zeros((rows, columns), dtype=np.int64)
    count = int((most - least) / step) + 1
    for row in range(rows):
        for column in range(columns):
            if not math.isnan(azimuths[row, column]):
                bins[row, column] = int((azimuths[row, column] - least) / step)
    return bins, middle + least + step * (np.arange(count) + 0.5)


def _look_closer(
    cells: np.ndarray, counts: CountArray, ends: FloatArray, plane: ImagePlane, field: FieldModel
) -> Upright | None:
    """The upright thing that coloured cells (rows, columns) of neighbouring azimuths show, from its foot upwards."""
    rows = cells.shape[0]
    lines = np.flatnonzero(cells.any(axis=1))[::-1]
    if not len(lines):
        return None
    gaps = np.flatnonzero(np.diff(lines) < -1 - _GAP_CELLS)
    lines = lines[: gaps[0] + 1] if len(gaps) else lines
    bottom = lines[0]
    coloured = (counts[YELLOW].astype(np.int64) + counts[BLUE]) * cells
    low = coloured[lines[: min(3, len(lines))]]
    column = float((low.sum(axis=0) * np.arange(cells.shape[1])).sum() / max(low.sum(), 1))
    share = coloured[bottom].sum() / max(coloured[lines[min(1, len(lines) - 1)]].sum(), 1)
    pixel = np.array([CELL_PX * column + 0.5 * (CELL_PX - 1), CELL_PX * (bottom + min(1.0, float(share))) - 0.5])
    x, y = plane_from_pixel(plane.lens, float(pixel[0]), float(pixel[1]))
    place = np.array(transformed(plane.ground, x, y))
    away = float(np.hypot(*(place - plane.foot)))
    if not np.isfinite(away) or rows - bottom > ends[round(column)] + 1.0 or bottom >= rows - 1:
        return None  # above the horizon, or it stands beyond the field, or its foot is below the image
    focal_cells = plane.lens.pinhole[0] / CELL_PX
    posts = field.posts
    cut = bool(lines[-1] == 0)
    expected = min(post.height for post in posts) * focal_cells / away
    widest = max(post.diameter for post in posts) * focal_cells / away
    width = float(cells[lines].sum() / len(lines))
    if width > _MOST_WIDTH * widest + 2.0 or (len(lines) < _LEAST_HEIGHT * expected and not cut):
        return None
    if len(lines) < max(_FEWEST_CELLS, 1.5 * width) or _goes_on_beside(counts, cells, lines):
        return None
    place = place * (1.0 + 0.5 * min(post.diameter for post in posts) / max(np.hypot(*place), 0.1))
    top = CELL_PX * float(lines[-1])
    return Upright(place, pixel, _bands(counts, cells, lines), cut, _height_of(plane, float(pixel[0]), top, away))


def _height_of(plane: ImagePlane, u: float, v: float, away: float) -> float:
    """How high (m) above the ground a pixel shows what is so far (m) from the camera's foot."""
    x, y = plane_from_pixel(plane.lens, u, v)
    h, foot = plane.ground, plane.foot
    w = float(h[2] @ (x, y, 1.0))  # of the ray's slope downwards
    beyond = math.hypot(*(h[:2] @ (x, y, 1.0) - foot * w))  # of its length along the ground
    above = math.sqrt(float(np.sum((h[0] - foot[0] * h[2]) ** 2)))
    return above * (1.0 - away * w / max(beyond, 1e-9))


def _goes_on_beside(counts: CountArray, cells: np.ndarray, lines: IntArray) -> bool:
    """Whether the colour of cells (rows, columns) is found beside them, too, as a poster's is."""
    coloured = (counts[YELLOW].astype(np.int64) + counts[BLUE]) > _FILLED * FULL
    beside = 0
    for line in lines:
        inside = np.flatnonzero(cells[line])
        for column in (inside[0] - 2, inside[-1] + 2):
            beside += bool(0 <= column < cells.shape[1] and coloured[line, column])
    return beside > _MOST_BESIDE * len(lines)


def _bands(counts: CountArray, cells: np.ndarray, lines: IntArray) -> Colors:
    """The colours from the ground up, empty where they are of unequal heights."""
    named = []
    for line in lines:
        yellow, blue = counts[YELLOW, line][cells[line]].sum(), counts[BLUE, line][cells[line]].sum()
        named.append("yellow" if yellow >= blue else "blue")
    least = 1 if len(lines) < 9 else 2
    bands: list[str] = []
    sizes: list[int] = []
    for name, group in groupby(named):
        size = len(list(group))
        if size >= least and (not bands or bands[-1] != name):
            bands.append(name)
            sizes.append(size)
        elif bands and bands[-1] == name:
            sizes[-1] += size
    if len(sizes) > 1 and max(sizes) > _EQUAL_BANDS * min(sizes) + 1:
        return ()  # a poster behind a post, say: the bands of a pole are of one height
    return tuple(bands)


def _kind(upright: Upright, field: FieldModel) -> tuple[LandmarkKind, Colors] | None:
    """What of the field this is: the colours in their order tell; None where they tell nothing."""
    seen = upright.colors
    poles = {pole.bands_from_ground for pole in field.poles if pole.bands_from_ground[: len(seen)] == seen}
    if len(seen) > 1:
        complete = [bands for bands in poles if len(bands) == len(seen) or upright.cut]
        return (LandmarkKind.POLE, complete[0]) if len(complete) == 1 else None
    band_m = max([pole.height / len(pole.bands_from_ground) for pole in field.poles], default=0.0)
    if seen and any(goal.color == seen[0] for goal in field.goals):
        return (
            (LandmarkKind.POST, seen) if not (poles and upright.cut and upright.seen_m < _ONE_BAND * band_m) else None
        )
    return None


def _goals(posts: list[Upright], field: FieldModel) -> list[_Landmark]:
    """Middles of goals of which both posts are seen, as far apart as they should be."""
    found: list[_Landmark] = []
    for a, b in combinations(posts, 2):
        apart = float(np.hypot(*(a.place - b.place)))
        slack = _GOAL_M + 0.05 * max(np.hypot(*a.place), np.hypot(*b.place))
        wide = [abs(goal.y_posts[0] - goal.y_posts[-1]) for goal in field.goals if (goal.color,) == a.colors]
        if a.colors == b.colors and wide and abs(apart - wide[0]) < slack:
            middle = Upright(0.5 * (a.place + b.place), np.full(2, np.nan), a.colors)
            found.append(_Landmark(LandmarkKind.GOAL, middle, 0.8))
    return found
