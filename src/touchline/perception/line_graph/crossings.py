"""Crossings (section 4.1): candidates from key nodes and lines, verified by the colours on circles about them.

A state machine walks round the candidate and confirms the transitions from green to white and back: so many arms of
paint leave it, in these directions. On the ground, so that a circle in the image is an ellipse.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, wrap_angle
from touchline.perception.line_graph.image_plane import (
    ImagePlane,
    ground_covariances,
    pixel_from_ground,
    pixels_from_grounds,
)
from touchline.perception.line_graph.profiles import Pixels, signal_at
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.line_graph.structure import Structure
from touchline.types import Crossings, Lines, no_crossings

_SAMPLES = 96
_MOST_ARMS = 6
_WHITE, _GREEN = 0.45, 0.35  # signal above which paint and below which carpet is seen
_STRAIGHT_RAD = math.radians(24.0)  # two arms that go straight on, or stand at right angles, do so to within this
_RIGHT_RAD = math.radians(60.0)  # lines that meet at less are no candidates
_SLACK_M = 0.25  # how far beyond a line's visible end it may meet another
_SAME_WIDTHS = 4.0  # candidates closer than so many line widths are one crossing
_CIRCLES = (3.0, 5.0)  # radii about a candidate, in line widths


class _Found(NamedTuple):
    kind: str
    place: FloatArray
    orientation_rad: float
    confidence: float


def find_crossings(
    structure: Structure, lines: Lines, pixels: Pixels, plane: ImagePlane, settings: LineGraphSettings
) -> Crossings:
    """Crossings of an image: where lines meet and at key nodes, each verified."""
    found: list[_Found] = []
    for place in _meetings(lines.ends_m, settings.crossing_m):
        crossing = _verified(place, pixels, plane)
        if crossing is None:
            continue
        if all(np.hypot(*(crossing.place - other.place)) > _SAME_WIDTHS * pixels.width_m for other in found):
            found.append(crossing)
    if not found:
        return no_crossings()
    places = np.stack([each.place for each in found])
    uv = pixels_from_grounds(plane, places)
    covariances = ground_covariances(plane, uv, settings.noise_px, settings.noise_m)
    return Crossings(
        np.array([each.kind for each in found], dtype="U1"),
        places,
        np.array([each.orientation_rad for each in found]),
        covariances,
        np.array([each.confidence for each in found]),
        uv,
    )


def _meetings(ends_m: FloatArray, farthest_m: float) -> list[FloatArray]:
    """Ground points where two lines (L, 2, 2) that are roughly at right angles meet, or would if a little longer."""
    places = []
    for a, b in itertools.combinations(ends_m, 2):
        da, db = a[1] - a[0], b[1] - b[0]
        la, lb = float(np.hypot(*da)), float(np.hypot(*db))
        cross = float(da[0] * db[1] - da[1] * db[0])
        if abs(cross) < math.sin(_RIGHT_RAD) * la * lb:
            continue
        offset = b[0] - a[0]
        along_a = float(offset[0] * db[1] - offset[1] * db[0]) / cross
        along_b = float(offset[0] * da[1] - offset[1] * da[0]) / cross
        slack_a, slack_b = _SLACK_M / la, _SLACK_M / lb
        place = a[0] + along_a * da
        if (
            -slack_a <= along_a <= 1.0 + slack_a
            and -slack_b <= along_b <= 1.0 + slack_b
            and np.hypot(*place) <= farthest_m
        ):
            places.append(place)
    return places


def _verified(place: FloatArray, pixels: Pixels, plane: ImagePlane) -> _Found | None:
    """The crossing at a candidate, if circles about it all show the same one."""
    judged = []
    arms = np.empty((_MOST_ARMS, 3))
    for radius in _CIRCLES:
        count = walk_round(pixels, plane, place[0], place[1], radius * pixels.width_m, arms)
        kind = judge_arms(arms[:count, 0]) if count > 0 else None
        if kind is None:
            return None
        judged.append(kind)
    if len({kind for kind, _ in judged}) > 1:
        return None
    return _Found(judged[0][0], place, judged[-1][1], 0.9)


@njit(cache=True, error_model="numpy")
def walk_round(pixels: Pixels, plane: ImagePlane, x: float, y: float, radius_m: float, arms: FloatArray) -> int:
    """Walk round a ground point; writes angle, x and y of the middle of each white arc into arms (MOST, 3).

    Returns how many there are, or -1 where the circle leaves the image or shows something that is neither paint nor
    carpet, or an arc is wider or narrower than a line.
    """
    width, height = plane.size[0], plane.size[1]
    values = np.empty(_SAMPLES)
    for k in range(_SAMPLES):
        angle = 2.0 * math.pi * k / _SAMPLES
        u, v = pixel_from_ground(plane, x + radius_m * math.cos(angle), y + radius_m * math.sin(angle))
        if not (0.0 <= u <= width - 1.0 and 0.0 <= v <= height - 1.0):
            return -1
        values[k] = signal_at(pixels, u, v)
    start = int(np.argmin(values))
    if values[start] > _GREEN:
        return -1
    count, inside, begin = 0, False, 0.0
    for k in range(1, _SAMPLES + 1):
        here, before = values[(start + k) % _SAMPLES], values[(start + k - 1) % _SAMPLES]
        if not inside and here > _WHITE:
            inside = True
            begin = k - (here - 0.5 * (_WHITE + _GREEN)) / max(here - before, 1e-6)
        elif inside and here < _GREEN:
            inside = False
            end = k - 1 + (before - 0.5 * (_WHITE + _GREEN)) / max(before - here, 1e-6)
            if count == _MOST_ARMS:
                return -1
            angle = 2.0 * math.pi * (start + 0.5 * (begin + end)) / _SAMPLES
            arc = (end - begin) * 2.0 * math.pi * radius_m / _SAMPLES
            if arc > 2.6 * pixels.width_m:
                return -1
            arms[count, 0] = angle
            arms[count, 1], arms[count, 2] = x + radius_m * math.cos(angle), y + radius_m * math.sin(angle)
            count += 1
    return count


def judge_arms(angles_rad: FloatArray) -> tuple[str, float] | None:
    """Kind and orientation (rad) of the crossing that such arms make; None where it is none.

    Orientation as `Crossings` has it: of L the bisector, of T the stem, of X an arm modulo pi/2.
    """
    angles = sorted(wrap_angle(float(a)) for a in angles_rad)
    gaps = [wrap_angle(b - a) % (2.0 * math.pi) for a, b in zip(angles, angles[1:] + angles[:1], strict=True)]
    quarter, half = 0.5 * math.pi, math.pi
    if len(angles) == 2 and abs(min(gaps) - quarter) < _STRAIGHT_RAD:
        first = angles[gaps.index(min(gaps))]
        return "L", wrap_angle(first + 0.5 * min(gaps))
    if len(angles) == 3 and abs(max(gaps) - half) < _STRAIGHT_RAD and min(gaps) > quarter - _STRAIGHT_RAD:
        # the stem is the arm between the two small gaps
        at = gaps.index(max(gaps))
        return "T", angles[(at + 2) % 3]
    if len(angles) == 4 and all(abs(gap - quarter) < _STRAIGHT_RAD for gap in gaps):
        mean = math.atan2(sum(math.sin(4.0 * a) for a in angles), sum(math.cos(4.0 * a) for a in angles)) / 4.0
        return "X", mean % quarter
    return None
