"""Measures how well crossings can be seen in a mirror's rendered images: the defaults of `FeatureNoise`.

    python lab/benchmarks/fit_crossings.py [--seconds 20] [--seeds 2]

No detector of crossings exists for a camera with a mirror. What can be measured is what `LinePointDetector` delivers:
through the points on each of the two lines within 1 m of a crossing a straight line is laid, robustly, and both are
crossed. How far that lies from the true crossing, in pixels outwards from the robot and across, and how often there are
points enough, are what a detector of crossings could make of these images; finding which points are a line's is left to
it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable

import numpy as np
from fit_observation_level import detected, minimised

from touchline.field import Crossing, FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.types import LinePoints
from touchline_lab.simulation.observation.feature_noise import FeatureNoise
from touchline_lab.simulation.observation.features import Looking, ObservedFeatures
from touchline_lab.simulation.observation.observed_lines import occluders
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

SCENARIOS = ("straight-tracks", "match", "tour-20")
_NEAR_M, _BESIDE_M, _FREE_M = 1.0, 0.15, 0.12  # along a line, off it, and clear of the other
_MIN_POINTS, _MIN_M = 3, 0.25  # on each line, and how far they reach


def crossing_errors(simulation: Simulation, found: Iterable[LinePoints]) -> FloatArray:
    """(N, 5) of each straight crossing in view: range (m), whether it could be placed, and if so its error outwards and
    across (pixels) and that of its direction (rad).
    """
    lines = simulation._observed
    view = ObservedFeatures(lines.camera, simulation.field, FeatureNoise(farthest_m=8.0), lines.view_rad)
    crossings = [c for c in simulation.field.crossings if not c.curved]
    places, rows = np.array([(c.x, c.y) for c in crossings]), []
    for index, points in enumerate(found):
        pose = Pose(*simulation._poses[index].tolist())
        hiding = occluders(simulation._bodies(float(simulation.image_times_s[index])), view.noise.height_m)
        placed = pose.transform(points.positions_m)
        for k in np.flatnonzero(view.view.shows(Looking(pose, hiding, simulation._black_rad), places)):
            distance = math.hypot(places[k, 0] - pose.x, places[k, 1] - pose.y)
            fitted = _placed(simulation.field, crossings[k], placed)
            if fitted is None:
                rows.append((distance, 0.0, 0.0, 0.0, 0.0))
                continue
            ends = lines.camera.image_from_ground(pose.inverse().transform(np.array([places[k], fitted[:2]])))
            out = ends[0] - np.array(lines.camera.center)
            out /= np.hypot(*out)
            step = ends[1] - ends[0]
            rows.append((distance, 1.0, float(step @ out), float(step @ (-out[1], out[0])), fitted[2]))
    return np.array(rows)


def _placed(field: FieldModel, crossing: Crossing, points: FloatArray) -> tuple[float, float, float] | None:
    """x, y (field frame) and error of the direction (rad) of a crossing from points (N, 2); None with too few."""
    at, laid, turns = np.array([crossing.x, crossing.y]), [], []
    directions = _directions(field, at)
    for direction, other in zip(directions, directions[::-1], strict=True):
        normal, beyond = np.array([-direction[1], direction[0]]), np.array([-other[1], other[0]])
        along, off, clear = (points - at) @ direction, (points - at) @ normal, (points - at) @ beyond
        mine = (np.abs(along) < _NEAR_M) & (np.abs(off) < _BESIDE_M) & (np.abs(clear) > _FREE_M)
        if mine.sum() < _MIN_POINTS or np.ptp(along[mine]) < _MIN_M:
            return None
        slope, offset = _straight(along[mine], off[mine])
        turns.append(math.atan(slope))
        laid.append((normal - slope * direction, offset))
    matrix = np.array([row for row, _ in laid])
    if abs(np.linalg.det(matrix)) < 0.3:
        return None
    x, y = at + np.linalg.solve(matrix, np.array([offset for _, offset in laid]))
    return float(x), float(y), 0.5 * sum(turns)


def _straight(along: FloatArray, off: FloatArray) -> tuple[float, float]:
    """Slope and offset of a straight line through points, those far off counting little."""
    weights = np.ones(len(along))
    for _ in range(6):
        slope, offset = np.polyfit(along, off, 1, w=np.sqrt(weights))
        weights = 1.0 / (1.0 + ((off - slope * along - offset) / 0.02) ** 2)
    return float(slope), float(offset)


def _directions(field: FieldModel, at: FloatArray) -> list[FloatArray]:
    """Unit vectors of the two straight lines that meet at a place."""
    found: list[FloatArray] = []
    for x1, y1, x2, y2 in field.segments:
        length = math.hypot(x2 - x1, y2 - y1)
        direction = np.array([x2 - x1, y2 - y1]) / length
        along, off = (at - (x1, y1)) @ direction, (at - (x1, y1)) @ (-direction[1], direction[0])
        parallel = any(abs(direction @ other) > 0.9 for other in found)
        if -0.1 < along < length + 0.1 and abs(off) < 0.1 and not parallel:
            found.append(direction)
    return found


def fit_ratio(rows: FloatArray) -> tuple[float, float, float]:
    """Share, range (m) of half and slope (m) of a logistic fall, by maximum likelihood."""

    def cost(v: FloatArray) -> float:
        share = np.clip(v[0], 0.01, 0.999) / (1.0 + np.exp((rows[:, 0] - v[1]) / max(abs(v[2]), 0.05)))
        share = np.clip(share, 1e-4, 1.0 - 1e-4)
        return -float(np.mean(np.where(rows[:, 1] > 0.0, np.log(share), np.log(1.0 - share))))

    share, half, slope = minimised(cost, np.array([0.9, 5.0, 0.5]), np.array([0.05, 0.5, 0.1]))
    return float(min(share, 0.999)), float(half), max(abs(float(slope)), 0.05)


def spread(values: FloatArray) -> float:
    """Standard deviation from the middle 68 %: of a normal distribution with some errors far out."""
    low, high = np.percentile(values, (15.87, 84.13))
    return 0.5 * float(high - low)


def tail_of(values: FloatArray) -> float:
    """The k at which sinh(k z) / k, z normal, has the ratio of standard deviation to the middle 68 % of values (N,)."""
    ratio, low, high = float(values.std()) / spread(values), 0.01, 3.0
    for _ in range(40):
        k = 0.5 * (low + high)
        if math.sqrt(0.5 * math.expm1(2.0 * k**2)) / math.sinh(k) < ratio:
            low = k
        else:
            high = k
    return low


def report(rows: FloatArray) -> None:
    """Print the figures as they stand in `FeatureNoise`."""
    placed = rows[rows[:, 1] > 0.0]
    share, half, slope = fit_ratio(rows)
    tail = math.exp(np.mean([math.log(tail_of(placed[:, column])) for column in (2, 3, 4)]))
    size = tail / math.sinh(tail)
    print(f"{len(rows)} crossings in view, {len(placed)} placed")
    outwards, across, turned = (size * spread(placed[:, column]) for column in (2, 3, 4))
    print(f"tail {tail:.2f}, outwards_px {outwards:.3f}, across_px {across:.3f}")
    print(f"orientation_deg {math.degrees(turned):.2f}")
    print(f"found_ratio {share:.3f}, half at {half:.2f} m, slope {slope:.2f} m")
    for low in range(8):
        near = rows[(rows[:, 0] >= low) & (rows[:, 0] < low + 1)]
        good = near[near[:, 1] > 0.0]
        if len(good) > 20:
            print(f"  {low} to {low + 1} m: {len(near)} in view, {100 * near[:, 1].mean():.0f} % placed, outwards "
                  f"{spread(good[:, 2]):.2f} px, across {spread(good[:, 3]):.2f} px, direction "
                  f"{math.degrees(spread(good[:, 4])):.2f} degrees")  # fmt: skip


def main() -> None:
    """Render, detect, cross, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seeds", type=int, default=2)
    arguments = parser.parse_args()
    tables = []
    for name in SCENARIOS:
        for seed in range(1, arguments.seeds + 1):
            simulation = Simulation(open_scenario(name, seed, arguments.seconds, ["ideal=true"]))
            tables.append(crossing_errors(simulation, detected(simulation)))
    report(np.concatenate(tables))


if __name__ == "__main__":
    main()
