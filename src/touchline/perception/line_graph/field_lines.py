"""Field lines of an observation: from the graph's components to places on the ground, with their points."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import BoolArray, FloatArray
from touchline.matrices import copy_row, uncounted
from touchline.perception.line_graph.colour_classes import CELL_PX
from touchline.perception.line_graph.image_plane import (
    ImagePlane,
    measure_grounds,
    pixel_from_plane,
    planes_from_pixels,
    transformed,
)
from touchline.perception.line_graph.lines import split_and_merge
from touchline.perception.line_graph.nets import is_thread
from touchline.perception.line_graph.profiles import Pixels
from touchline.perception.line_graph.refine import (
    COVERED_PX,
    MIN_SAGITTA_PX,
    POINT_COLUMNS,
    is_bent,
    is_covered,
    refine_line,
)
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.line_graph.structure import Structure
from touchline.types import LinePoints, Lines

_MAX_POINTS = 2000
_ALL = 5  # times as many lines as the cells show, at most: at both ends and to both sides of each another one
_ASIDE_M = 0.4  # length of these that is tried
_ROUGH_M = 0.35  # a shorter line has no direction by the cells alone
# least mean of contrast times width against the expected: a net's threads are fainter and thinner. As a share of the
# strongest line's where that is below 1, as for narrow or worn lines and rough camera poses; and at all
_MIN_PAINT, _MIN_EVER = 0.65, 0.35


class LineLimits(NamedTuple):
    """Which lines are kept.

    subpixel: whether the pixels place and judge them. radius_m: of the field's circles, 0 if it has none. The others
    as in the settings.
    """

    subpixel: bool
    radius_m: float
    min_m: float
    min_px: float
    max_range_m: float


class FoundLines(NamedTuple):
    """planes: (L, 4) x0, y0, x1, y1 in the image plane. confidences: (L,). points: (P, 5) of `refine_line`."""

    planes: FloatArray
    confidences: FloatArray
    points: FloatArray


def find_lines(
    structure: Structure,
    pixels: Pixels,
    plane: ImagePlane,
    settings: LineGraphSettings,
    radius_m: float = 0.0,
) -> FoundLines:
    """The field lines, longest first. Short and far ones are left out, and bent ones.

    radius_m: of the field's circles; 0 if it has none.
    """
    nodes = planes_from_pixels(plane, cell_pixels(structure.graph.places))
    candidates = split_and_merge(
        nodes, structure.chains, settings.split_px / plane.lens.pinhole[0], settings.paper.corner_split
    )
    lengths = np.hypot(candidates[:, 2] - candidates[:, 0], candidates[:, 3] - candidates[:, 1])
    candidates = candidates[np.argsort(-lengths, kind="stable")]
    subpixel = settings.paper.subpixel
    least_m = max(settings.min_line_m, 0.0 if subpixel else _ROUGH_M)
    limits = LineLimits(subpixel, radius_m, least_m, settings.min_line_px, settings.max_range_m)
    room = _ALL * max(len(candidates), 1)
    found = FoundLines(np.empty((room, 4)), np.empty(room), np.empty((_MAX_POINTS, POINT_COLUMNS)))
    lines, total = _place_all(pixels, plane, candidates, limits, found)
    return _without_faint(FoundLines(found.planes[:lines], found.confidences[:lines], found.points[:total]))


def _without_faint(found: FoundLines) -> FoundLines:
    """The lines whose paint is about as strong as that of the strongest one."""
    if not len(found.points):
        return found
    kept = _are_strong(found.points)
    if kept.all():
        return found
    points = found.points[kept[found.points[:, 2].astype(np.int64)]]
    points[:, 2] = (np.cumsum(kept) - 1)[points[:, 2].astype(np.int64)]
    return FoundLines(found.planes[kept], found.confidences[kept], points)


@njit(cache=True, error_model="numpy")
def _are_strong(points: FloatArray) -> BoolArray:
    """(L,) whether lines are, by their points (P, 5), which follow one another."""
    paint = np.zeros(int(points[-1, 2]) + 1)
    count = np.zeros_like(paint)
    for point in points:
        paint[int(point[2])] += point[3] * point[4]
        count[int(point[2])] += 1.0
    paint /= count
    return paint >= _MIN_PAINT * min(1.0, paint.max())


def lines_on_ground(found: FoundLines, plane: ImagePlane, settings: LineGraphSettings) -> tuple[Lines, LinePoints]:
    """The lines and their points in the robot frame."""
    ends, count = 2 * len(found.planes), len(found.points)  # the ends of the lines, then the points
    uv, ground, covariances = np.empty((ends + count, 2)), np.empty((ends + count, 2)), np.empty((ends + count, 2, 2))
    _measure(plane, found, settings.noise_px, settings.noise_m, uv, ground, covariances)
    of_lines = ground[:ends].reshape(-1, 2, 2), covariances[:ends].reshape(-1, 2, 2, 2)
    lines = Lines(*of_lines, found.confidences, uv[:ends].reshape(-1, 2, 2))
    sure = np.minimum(np.maximum(found.points[:, 3], 0.0), 1.0)
    return lines, LinePoints(ground[ends:], covariances[ends:], sure, uv[ends:])


@njit(cache=True, error_model="numpy")
def _measure(plane, found, noise_px, noise_m, uv, ground, covariances):  # type: ignore[no-untyped-def]
    """Pixels of the ends of lines and of their points, into uv (N, 2), and what `measure_grounds` makes of them."""
    lens, ends = plane.lens, 2 * len(found.planes)
    for k in range(ends):
        line, end = found.planes[k // 2], 2 * (k % 2)
        uv[k, 0], uv[k, 1] = pixel_from_plane(lens, line[end], line[end + 1])
    for k in range(len(found.points)):
        uv[ends + k, 0], uv[ends + k, 1] = found.points[k, 0], found.points[k, 1]
    measure_grounds(plane, uv, noise_px, noise_m, ground, covariances)


def cell_pixels(places: FloatArray) -> FloatArray:
    """Pixels (N, 2) of the middles of places (N, 2) in cells."""
    return CELL_PX * places + 0.5 * (CELL_PX - 1)


@njit(cache=True, error_model="numpy")
def _at_ends(plane: ImagePlane, lines: FloatArray) -> FloatArray:
    """Candidates (4 L, 4) at right angles on the ground to lines (L, 4), to both sides of both ends.

    Two corners of a goal box, cells apart, leave the short line between them no nodes of its own.
    """
    candidates = np.full((4 * len(lines), 4), np.nan)
    for k in range(len(candidates)):
        line, near = lines[k // 4], 2 * (k % 2)
        ax, ay = transformed(plane.ground, line[near], line[near + 1])
        bx, by = transformed(plane.ground, line[2 - near], line[3 - near])
        step = (1.0 if k % 4 < 2 else -1.0) * _ASIDE_M / math.hypot(bx - ax, by - ay)
        x, y = transformed(plane.plane, ax - step * (by - ay), ay + step * (bx - ax))
        candidates[k, 0], candidates[k, 1], candidates[k, 2], candidates[k, 3] = line[near], line[near + 1], x, y
    return candidates


@njit(cache=True, error_model="numpy")
def _place_all(pixels, plane, candidates, limits, found):  # type: ignore[no-untyped-def]
    """Place candidates (L, 4), then those at the ends of the lines; how many lines and points are found."""
    pixels, plane, candidates, found = uncounted((pixels, plane, candidates, found))
    none = np.int64(0)  # a literal 0 is a type of its own: it would be compiled twice
    lines, total = _place_lines(pixels, plane, candidates, limits, found, (none, none))
    if limits.subpixel:
        ends = _at_ends(plane, found.planes[:lines])
        lines, total = _place_lines(pixels, plane, ends, limits, found, (lines, total))
    return lines, total


@njit(cache=True, error_model="numpy")
def _place_lines(pixels, plane, candidates, limits, found, before):  # type: ignore[no-untyped-def]
    """Place candidates (L, 4) by their pixels, behind those found `before`; how many lines and points there are."""
    kept, total = before
    lines, confidences, points = found
    covered = COVERED_PX / plane.lens.pinhole[0]
    for k in range(len(candidates)):
        line = candidates[k].copy()
        if not np.isfinite(line).all() or is_covered(line, lines[:kept], covered):
            continue
        if not limits.subpixel:
            if _is_long(line, plane, limits):
                confidences[kept] = 0.8
                copy_row(line, lines[kept])
                kept += 1
            continue
        confidence, count = refine_line(pixels, plane, line, (lines[:kept], limits.radius_m), points[total:])
        if confidence == 0.0 or is_covered(line, lines[:kept], covered):
            continue
        own, paint, contrast = points[total : total + count], 0.0, 0.0
        for point in own:
            point[2] = kept
            paint, contrast = paint + point[3] * point[4], contrast + point[3]
        if paint < _MIN_EVER * count or not _is_long(line, plane, limits):
            continue
        if is_bent(own[:, :2], line, plane, limits.radius_m, MIN_SAGITTA_PX):
            continue
        if is_thread(pixels, plane, line, contrast / count):
            continue
        confidences[kept] = confidence
        copy_row(line, lines[kept])
        kept, total = kept + 1, total + count
    return kept, total


@njit(cache=True, error_model="numpy")
def _is_long(line: FloatArray, plane: ImagePlane, limits: LineLimits) -> bool:
    """Whether a line (4,) is neither short nor far."""
    ax, ay = transformed(plane.ground, line[0], line[1])
    bx, by = transformed(plane.ground, line[2], line[3])
    focal = plane.lens.pinhole[0]
    long = math.hypot(bx - ax, by - ay) >= limits.min_m
    long = long and focal * math.hypot(line[2] - line[0], line[3] - line[1]) >= limits.min_px
    return bool(long and min(math.hypot(ax, ay), math.hypot(bx, by)) <= limits.max_range_m)
