"""marker-search: where most new humanoid teams begin. Random search over labelled crossings and posts of an image.

Two markers are drawn and taken for two of the field's of their kinds; the pose that they give is kept if more markers
fit than with any other draw. Between such images the odometry goes on. Humanoids only: a mirror's detector
labels nothing.

python lab/benchmarks/baselines/marker_search.py INPUTS RESULTS/marker-search
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from exchange import Answer, Drive, Seen, composed, moved, run_all, wrapped


@dataclass(frozen=True)
class Settings:
    """Chosen by random search on robots 0 and 1 of ten rows of the suite."""

    draws: int = 200
    fits_m: float = 0.12  # a marker fits within so much, and so much more per metre of distance
    fits_per_m: float = 0.07
    min_markers: int = 2
    near_m: float = 2.6  # farther from the odometry than this only where nothing is known
    lost_s: float = 7.5  # without a fit for so long the pose is no longer believed
    gain: float = 0.1  # of the new pose in the old one


def markers_of(field: dict[str, Any]) -> dict[str, np.ndarray]:
    """Places (N, 2) of the field's crossings by kind, and of its posts."""
    found: dict[str, list[tuple[float, float]]] = {"L": [], "T": [], "X": [], "post": []}
    segments = [tuple(map(float, row)) for row in field.get("segments") or []]
    for one, other in combinations(segments, 2):
        along, across = (one, other) if one[1] == one[3] else (other, one)
        if along[1] != along[3] or across[0] != across[2]:
            continue
        x, y = across[0], along[1]
        ends_x, ends_y = sorted((along[0], along[2])), sorted((across[1], across[3]))
        if not (ends_x[0] - 0.05 <= x <= ends_x[1] + 0.05 and ends_y[0] - 0.05 <= y <= ends_y[1] + 0.05):
            continue
        at_ends = (min(abs(x - end) for end in ends_x) < 0.05) + (min(abs(y - end) for end in ends_y) < 0.05)
        found["XTL"[at_ends]].append((x, y))
    for cx, cy, radius in field.get("circles") or []:
        found["X"] += [(cx, cy - radius), (cx, cy + radius)]
    for goal in field.get("goals") or []:
        found["post"] += [(float(goal["x"]), float(y)) for y in goal["y_posts"]]
    return {kind: np.array(places).reshape(-1, 2) for kind, places in found.items()}


def follow(drive: Drive, settings: Settings | None = None) -> Iterator[Answer]:
    """Poses of a drive."""
    s, rng, places = settings or Settings(), np.random.default_rng(crc32(drive.name.encode())), markers_of(drive.field)
    pose, before = drive.start, drive.images[0].odometry
    found_s, way_m = float(drive.images[0].t), 0.3
    for seen in drive.images:
        motion = moved(before, seen.odometry)
        before, at_s = seen.odometry, float(seen.t)
        way_m += 0.1 * math.hypot(*motion[:2]) + 0.02 * abs(motion[2])
        pose = None if pose is None else composed(pose, motion)
        expected = pose if at_s - found_s < s.lost_s else None
        found = search(seen, places, expected, s, rng)
        if found is not None:
            gain = s.gain if expected is not None else 1.0
            off = found - (found if pose is None else pose)
            off[2] = wrapped(off[2])
            pose = found - (1.0 - gain) * off
            found_s, way_m = at_s, 0.1
        shown = np.zeros(3) if pose is None else pose
        yield shown, np.diag([way_m**2, way_m**2, way_m**2]), pose is not None and at_s - found_s < s.lost_s


def search(
    seen: Seen, places: dict[str, np.ndarray], expected: np.ndarray | None, s: Settings, rng: np.random.Generator
) -> np.ndarray | None:
    """The pose that most markers of an image fit with."""
    markers = [(kind, np.array([x, y])) for kind, x, y in seen.markers if kind in places and len(places[kind])]
    if len(markers) < 2:
        return None
    best, most = None, (s.min_markers - 1, 0.0)
    for _ in range(s.draws):
        (kind, one), (other_kind, other) = (markers[k] for k in rng.choice(len(markers), 2, replace=False))
        at, other_at = (places[k][rng.integers(len(places[k]))] for k in (kind, other_kind))
        apart, field_apart = other - one, other_at - at
        limit = 2.0 * (s.fits_m + s.fits_per_m * math.hypot(*one))
        if abs(math.hypot(*apart) - math.hypot(*field_apart)) > limit or math.hypot(*apart) < 0.5:
            continue
        heading = math.atan2(field_apart[1], field_apart[0]) - math.atan2(apart[1], apart[0])
        c, sine = math.cos(heading), math.sin(heading)
        turn = np.array([[c, -sine], [sine, c]])
        x, y = 0.5 * (at + other_at) - turn @ (0.5 * (one + other))
        if expected is not None and (
            math.hypot(x - expected[0], y - expected[1]) > s.near_m or abs(wrapped(heading - expected[2])) > 0.7
        ):
            continue
        fit = (0, 0.0)
        for each, place in markers:
            off_m = float(np.hypot(*(places[each] - (turn @ place + [x, y])).T).min())
            if off_m < s.fits_m + s.fits_per_m * math.hypot(*place):
                fit = (fit[0] + 1, fit[1] - off_m)
        if fit > most:
            best, most = np.array([x, y, heading]), fit
    return best


if __name__ == "__main__":
    run_all(Path(sys.argv[1]), Path(sys.argv[2]), follow, "humanoid-")
