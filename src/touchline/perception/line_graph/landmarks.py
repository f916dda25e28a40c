"""Landmarks (section 4.3): goal posts, goals, poles and penalty marks, told by what the field has of them."""

import math
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.field import FieldModel, Post
from touchline.geometry import BoolArray, FloatArray
from touchline.perception.line_graph.colour_classes import ColourClasses
from touchline.perception.line_graph.coloured_uprights import Upright, coloured_uprights
from touchline.perception.line_graph.image_plane import (
    ImagePlane,
    ground_covariances,
    grounds_from_pixels,
)
from touchline.perception.line_graph.penalty_marks import find_penalty_marks
from touchline.perception.line_graph.profiles import Pixels
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.line_graph.structure import Structure
from touchline.perception.line_graph.white_posts import find_white_posts
from touchline.types import Colors, LandmarkKind, Landmarks, Lines

_OFF_LINES_PX = 12.0  # penalty marks lie farther from all lines
_WHITE: Colors = ("white",)
_ONE_BAND = 1.4  # of a band's height: what is of one colour beyond it is no pole
_TIGHTEST, _LOOSEST = 0.5, 1.5  # of a post's diameter: how wide it may look
_SAME_M = 0.4  # two uprights closer than this are one
_GOAL_M = 0.35  # how far the distance between two posts of a goal may be off, and more with the range
_FOOT_PX = 3.0  # standard deviation of a foot


class _Landmark(NamedTuple):
    """One row of `Landmarks`; its error in the image (px) and on the ground (m)."""

    kind: LandmarkKind
    upright: Upright
    confidence: float
    noise: tuple[float, float] = (_FOOT_PX, 0.03)


def find_landmarks(
    structure: Structure,
    classes: ColourClasses,
    pixels: Pixels,
    lines: Lines,
    plane: ImagePlane,
    field: FieldModel,
    settings: LineGraphSettings,
) -> Landmarks:
    """Posts, goals and poles in colour; white posts, their goals, and penalty marks. lines: of the same image."""
    found = _coloured(coloured_uprights(pixels, classes, structure, plane, field), field, settings)
    if settings.paper.white_marks:
        found += _white_posts(pixels, lines, plane, field, settings)
        found += _penalty_marks(structure, lines, plane, field)
    found += _goals([one.upright for one in found if one.kind == LandmarkKind.POST], field)
    if not found:
        return Landmarks.none()
    noise = np.array([_covariance(one, plane) for one in found])
    return Landmarks(
        np.array([str(one.kind) for one in found]),
        np.array([one.upright.place for one in found]),
        noise,
        np.array([one.confidence for one in found]),
        tuple(one.upright.colors for one in found),
        np.array([one.upright.pixel for one in found]),
    )


def _covariance(one: _Landmark, plane: ImagePlane) -> FloatArray:
    """(2, 2) m²."""
    if one.kind == LandmarkKind.GOAL:
        return np.eye(2) * (0.05 + 0.03 * float(np.hypot(*one.upright.place))) ** 2
    return ground_covariances(plane, one.upright.pixel[np.newaxis], *one.noise)[0]


def _coloured(uprights: list[Upright], field: FieldModel, settings: LineGraphSettings) -> list[_Landmark]:
    """Those that the field has, by their middle: as far behind the foot that is seen as they are thick."""
    found: list[_Landmark] = []
    for upright in uprights:
        post = _post_like(upright, field)
        if post is None or not _TIGHTEST * post.diameter < upright.width_m < _LOOSEST * post.diameter:
            continue
        range_m = float(np.hypot(*upright.place))
        place = upright.place * (1.0 + 0.5 * post.diameter / max(range_m, 0.1))
        if range_m <= settings.max_range_m and all(np.hypot(*(place - one.upright.place)) > _SAME_M for one in found):
            kind = LandmarkKind.POST if post.kind == "goal" else LandmarkKind.POLE
            found.append(_Landmark(kind, upright._replace(place=place, colors=post.colors_from_ground), 0.8))
    return found


def _white_posts(
    pixels: Pixels, lines: Lines, plane: ImagePlane, field: FieldModel, settings: LineGraphSettings
) -> list[_Landmark]:
    white = [post for post in field.posts if post.colors_from_ground == _WHITE]
    if not white:
        return []
    return [
        _Landmark(LandmarkKind.POST, Upright(ridge.place, ridge.pixel, _WHITE), ridge.share, (2.0, 0.03))
        for ridge in find_white_posts(pixels, lines, plane, white[0], settings.max_range_m)
    ]


def _penalty_marks(structure: Structure, lines: Lines, plane: ImagePlane, field: FieldModel) -> list[_Landmark]:
    size = _mark_size(field)
    if size is None:
        return []
    middles = find_penalty_marks(structure.counts, structure.ends, plane, size)
    middles = middles[_off_lines(middles, np.ascontiguousarray(lines.pixels))]
    places = grounds_from_pixels(plane, middles)
    return [
        _Landmark(LandmarkKind.PENALTY_MARK, Upright(place, middle, ()), 0.7, (1.5, 0.02))
        for place, middle in zip(places, middles, strict=True)
    ]


@lru_cache(maxsize=16)
def _mark_size(field: FieldModel) -> float | None:
    """Diameter (m) of the marks that lie on no line."""
    return next((float(d) for x, y, d in field.discs if field.line_distances([[x, y]])[0] >= field.line_width), None)


@njit(cache=True)
def _off_lines(middles: FloatArray, lines: FloatArray) -> BoolArray:
    """(N,) which pixels (N, 2) lie so far from all lines (L, 2, 2) that were found that they are no piece of one."""
    off = np.ones(len(middles), dtype=np.bool_)
    for i in range(len(middles)):
        for line in lines:
            x, y = middles[i, 0] - line[0, 0], middles[i, 1] - line[0, 1]
            dx, dy = line[1, 0] - line[0, 0], line[1, 1] - line[0, 1]
            share = min(max((x * dx + y * dy) / max(dx * dx + dy * dy, 1.0), 0.0), 1.0)
            if math.hypot(x - share * dx, y - share * dy) < _OFF_LINES_PX:
                off[i] = False
    return off


def _post_like(upright: Upright, field: FieldModel) -> Post | None:
    """What of the field this is: the colours in their order tell; None where they tell nothing."""
    seen = upright.colors
    goal, poles, band_m = _posts_in(field, seen[:1])
    if upright.seen_m >= _ONE_BAND * band_m:
        return goal
    same = [pole for colors, pole in poles.items() if colors[: len(seen)] == seen and len(seen) > 1]
    complete = [pole for pole in same if len(pole.colors_from_ground) == len(seen) or upright.cut]
    return complete[0] if len(complete) == 1 else None


@lru_cache(maxsize=16)
def _posts_in(field: FieldModel, lowest: Colors) -> tuple[Post | None, dict[Colors, Post], float]:
    """A goal's post of a colour, the poles of which it is the lowest, by their colours, and the height of a band."""
    goal = next((post for post in field.posts if post.kind == "goal" and post.colors_from_ground == lowest), None)
    poles = {post.colors_from_ground: post for post in field.posts if post.kind == "pole"}
    poles = {colors: pole for colors, pole in poles.items() if colors[:1] == lowest}
    return goal, poles, max((pole.height / len(colors) for colors, pole in poles.items()), default=0.0)


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
