"""Stretches of a ray or a circle that lie on paint: lines, arcs, marks and the goals' bars on the ground."""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray

LINE, BAR, DISC = 0.0, 1.0, 2.0  # kinds of paint
MAX_PER_PATH = 64


@njit(cache=True, error_model="numpy")
def _add(runs, count, start, end, sine, kind):  # type: ignore[no-untyped-def]
    """Append (start, end, sine of a plain crossing's angle or 0, kind) and return the new count."""
    if count < len(runs):
        runs[count, 0], runs[count, 1], runs[count, 2], runs[count, 3] = start, end, sine, kind
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def turned(angle):  # type: ignore[no-untyped-def]
    """An angle (rad) in [0, 2 pi), as % gives it, which takes five times as long."""
    if not -12.0 < angle < 12.0:
        return angle % (2.0 * math.pi)
    while angle < 0.0:
        angle += 2.0 * math.pi
    while angle >= 2.0 * math.pi:
        angle -= 2.0 * math.pi
    return angle


@njit(cache=True, error_model="numpy")
def _on_arc(angle, start, sweep):  # type: ignore[no-untyped-def]
    return turned(angle - start) <= sweep


@njit(cache=True, error_model="numpy")
def near_paint(x, y, paint, width, farthest):  # type: ignore[no-untyped-def]
    """The paint of `ray_runs` that a place x, y could see within `farthest` (m); the rest need not be looked at."""
    segments, rounds, discs = paint
    gaps = np.empty(len(segments) + len(rounds) + len(discs))
    for i in range(len(segments)):
        ax, ay = x - segments[i, 0], y - segments[i, 1]
        beyond = abs(ax * segments[i, 2] + ay * segments[i, 3]) - segments[i, 4]
        beside = abs(-ax * segments[i, 3] + ay * segments[i, 2]) - segments[i, 5]
        gaps[i] = max(beyond, beside)
    for i in range(len(rounds)):
        ox, oy = rounds[i, 0] - x, rounds[i, 1] - y
        gaps[len(segments) + i] = abs(math.sqrt(ox * ox + oy * oy) - rounds[i, 2]) - 0.5 * width
    for i in range(len(discs)):
        ox, oy = discs[i, 0] - x, discs[i, 1] - y
        gaps[len(segments) + len(rounds) + i] = math.sqrt(ox * ox + oy * oy) - 0.5 * discs[i, 2]
    first, second = len(segments), len(segments) + len(rounds)
    near = gaps <= farthest
    return segments[near[:first]], rounds[near[first:second]], discs[near[second:]]


@njit(cache=True, error_model="numpy")
def ray_runs(x, y, cx, sx, paint, width, farthest, runs):  # type: ignore[no-untyped-def]
    """Paint on a ray from x, y along (cx, sx), as stretches (m) into runs (K, 4); returns how many.

    paint: segments (S, 8) of `segment_table`; rounds (R, 5): cx, cy, radius, start, sweep (rad); discs (D, 3): cx, cy,
    diameter; all m, field frame. width: of round lines (m). farthest: where the ray ends (m).
    """
    segments, rounds, discs = paint
    half, count = 0.5 * width, 0
    for i in range(len(segments)):
        ax, ay = x - segments[i, 0], y - segments[i, 1]
        along, across = ax * segments[i, 2] + ay * segments[i, 3], -ax * segments[i, 3] + ay * segments[i, 2]
        fast, slow = cx * segments[i, 2] + sx * segments[i, 3], -cx * segments[i, 3] + sx * segments[i, 2]
        aside = abs(across) - segments[i, 5]
        if abs(slow) < 1e-6 or (aside > 0.0 and (across * slow > 0.0 or aside >= farthest * abs(slow))):
            continue  # along the line, away from it, or too far from it
        first, last = (-segments[i, 5] - across) / slow, (segments[i, 5] - across) / slow
        if first > last:
            first, last = last, first
        if last <= 0.0 or first >= farthest:
            continue
        full = last - first
        if abs(fast) > 1e-9:
            begin, end = (-segments[i, 4] - along) / fast, (segments[i, 4] - along) / fast
            first, last = max(first, min(begin, end)), min(last, max(begin, end))
        elif abs(along) > segments[i, 4]:
            continue
        if last > max(first, 0.0):
            count = _add(runs, count, first, last, abs(slow) if last - first > 0.99 * full else 0.0, segments[i, 6])
    for i in range(len(rounds)):
        ox, oy, radius = rounds[i, 0] - x, rounds[i, 1] - y, rounds[i, 2]
        middle = ox * cx + oy * sx
        off2 = max(ox * ox + oy * oy - middle * middle, 0.0)
        outer = (radius + half) ** 2 - off2
        if outer <= 0.0 or middle + math.sqrt(outer) <= 0.0:
            continue
        outer, inner = math.sqrt(outer), (radius - half) ** 2 - off2
        inner = math.sqrt(inner) if inner > 0.0 else 0.0
        sine = math.sqrt(max(1.0 - off2 / (radius * radius), 0.0)) if inner > 0.0 else 0.0
        for sign in (-1.0, 1.0):
            near, far = middle + sign * inner, middle + sign * outer
            place = middle if inner == 0.0 else 0.5 * (near + far)
            if max(near, far) <= 0.0 or (inner == 0.0 and sign > 0.0):
                continue
            angle = math.atan2(place * sx - oy, place * cx - ox)
            if rounds[i, 4] > 6.2831 or _on_arc(angle, rounds[i, 3], rounds[i, 4]):
                end = middle + outer if inner == 0.0 else max(near, far)
                count = _add(runs, count, min(near, far), end, sine, LINE)
    for i in range(len(discs)):
        ox, oy, radius = discs[i, 0] - x, discs[i, 1] - y, 0.5 * discs[i, 2]
        middle = ox * cx + oy * sx
        square = radius * radius - (ox * ox + oy * oy - middle * middle)
        if square > 0.0 and middle > 0.0:
            chord = math.sqrt(square)
            count = _add(runs, count, middle - chord, middle + chord, 1.0, DISC)
    return count


@njit(cache=True, error_model="numpy")
def _two(low, high, turn, flip, sine, kind, runs, count):  # type: ignore[no-untyped-def]
    """The stretches from low to high (rad) and, mirrored, from flip - high to flip - low, both turned by `turn`."""
    start = turned(low + turn)
    count = _add(runs, count, start, start + high - low, sine, kind)
    start = turned(flip - high + turn)
    return _add(runs, count, start, start + high - low, sine, kind)


@njit(cache=True, error_model="numpy")
def circle_runs(x, y, reach, paint, width, runs):  # type: ignore[no-untyped-def]
    """Paint on a circle of the radius `reach` about x, y, as directions (rad, field frame); else as `ray_runs`."""
    segments = paint[0]
    count = 0
    for i in range(len(segments)):
        ax, ay = x - segments[i, 0], y - segments[i, 1]
        along, across = ax * segments[i, 2] + ay * segments[i, 3], -ax * segments[i, 3] + ay * segments[i, 2]
        low, high = (-segments[i, 5] - across) / reach, (segments[i, 5] - across) / reach
        if low >= 1.0 or high <= -1.0 or abs(along) > segments[i, 4] + reach:
            continue
        turn, middle = segments[i, 7], 0.5 * (low + high)
        before = count
        if low > -1.0 and high < 1.0:
            sine = math.sqrt(1.0 - middle * middle)
            count = _two(math.asin(low), math.asin(high), turn, math.pi, sine, segments[i, 6], runs, count)
        elif high >= 1.0:
            start = turned(math.asin(max(low, -1.0)) + turn)
            count = _add(runs, count, start, start + math.pi - 2.0 * math.asin(max(low, -1.0)), 0.0, segments[i, 6])
        else:
            start = turned(math.pi - math.asin(high) + turn)
            count = _add(runs, count, start, start + math.pi + 2.0 * math.asin(high), 0.0, segments[i, 6])
        if abs(along) + reach <= segments[i, 4]:
            continue
        kept = before
        for k in range(before, count):  # beyond the line's ends there is none
            place = along + reach * math.cos(0.5 * (runs[k, 0] + runs[k, 1]) - turn)
            if abs(place) <= segments[i, 4]:
                runs[kept] = runs[k]
                kept += 1
        count = kept
    return _on_rounds(x, y, reach, paint, width, runs, count)


@njit(cache=True, error_model="numpy")
def _on_rounds(x, y, reach, paint, width, runs, count):  # type: ignore[no-untyped-def]
    """`circle_runs` of arcs, circles and discs, behind the `count` runs that there are."""
    _, rounds, discs = paint
    half = 0.5 * width
    for i in range(len(rounds) + len(discs)):
        disc = i >= len(rounds)
        ox = (discs[i - len(rounds), 0] if disc else rounds[i, 0]) - x
        oy = (discs[i - len(rounds), 1] if disc else rounds[i, 1]) - y
        outer = 0.5 * discs[i - len(rounds), 2] if disc else rounds[i, 2] + half
        apart = math.sqrt(ox * ox + oy * oy)
        if apart < 1e-9:
            continue
        far = (reach * reach + apart * apart - outer * outer) / (2.0 * reach * apart)
        if not -1.0 < far < 1.0:
            continue
        turn, far = math.atan2(oy, ox), math.acos(far)
        near = 1.0
        if not disc:
            near = (reach * reach + apart * apart - (rounds[i, 2] - half) ** 2) / (2.0 * reach * apart)
            if near <= -1.0:
                continue
        if near >= 1.0:
            if disc or rounds[i, 4] > 6.2831:
                start = turned(turn - far)
                count = _add(runs, count, start, start + 2.0 * far, 1.0 if disc else 0.0, DISC if disc else LINE)
            continue
        near = math.acos(near)
        before = count
        between = (reach * reach + rounds[i, 2] ** 2 - apart * apart) / (2.0 * reach * rounds[i, 2])
        sine = math.sqrt(max(1.0 - between * between, 0.0))
        count = _two(near, far, turn, 0.0, sine, LINE, runs, count)
        kept = before
        for k in range(before, count):
            angle = 0.5 * (runs[k, 0] + runs[k, 1])
            place = math.atan2(reach * math.sin(angle) - oy, reach * math.cos(angle) - ox)
            if rounds[i, 4] > 6.2831 or _on_arc(place, rounds[i, 3], rounds[i, 4]):
                runs[kept] = runs[k]
                kept += 1
        count = kept
    return count


def segment_table(segments: FloatArray, width: float, kind: float = LINE) -> FloatArray:
    """(S, 8) of segments (S, 4): middle, direction, half length (half a width beyond the ends), half width, kind,
    direction as an angle (rad).
    """
    rows = np.asarray(segments, dtype=np.float64).reshape(-1, 4)
    step = rows[:, 2:] - rows[:, :2]
    length = np.hypot(step[:, 0], step[:, 1])
    half = np.full(len(rows), 0.5 * width)
    return np.column_stack(
        (0.5 * (rows[:, :2] + rows[:, 2:]), step / length[:, np.newaxis], 0.5 * length + half, half,
         np.full(len(rows), kind), np.arctan2(step[:, 1], step[:, 0]))
    )  # fmt: skip


def round_table(circles: FloatArray, arcs: FloatArray) -> FloatArray:
    """(C + A, 5) cx, cy, radius, start, sweep of circles (C, 3) and arcs (A, 5) with start and end angle (rad)."""
    whole = np.column_stack((circles, np.zeros(len(circles)), np.full(len(circles), 2.0 * math.pi)))
    sweeps = np.mod(arcs[:, 4] - arcs[:, 3], 2.0 * math.pi)
    sweeps[sweeps < 1e-5] = 2.0 * math.pi
    parts = np.column_stack((arcs[:, :4], sweeps))
    return np.ascontiguousarray(np.concatenate((whole.reshape(-1, 5), parts.reshape(-1, 5))))
