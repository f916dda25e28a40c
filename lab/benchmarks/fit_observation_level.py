"""Fits the figures of the observation level (`ObservationNoise`) to what the detector finds in rendered images.

    python lab/benchmarks/fit_observation_level.py [--seconds 60] [--seeds 3]

Scenarios are rendered; in each image the points of `LinePointDetector` are paired, scan path by scan path, with the
crossings of that path and the field's paint that `ObservedLines.crossings` works out from the true pose. What is paired
says how often a crossing is found and how far off, what is left over which points are false. The figures follow by
maximum likelihood (`found_ratio`, `error_px`), medians and counts; they are printed as they stand in `point_errors.py`.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np
from numba import njit
from scipy.optimize import minimize

from touchline.config import settings_rows
from touchline.field.model import Goal
from touchline.geometry import FloatArray, Pose
from touchline.perception import SelfLearningDetector, observe
from touchline.types import LinePoints
from touchline_lab.simulation.observation.crossings import COLUMNS, GRAZED, MIXED, PLAIN, inside_sector
from touchline_lab.simulation.observation.goal_clutter import NET_PLACES, PLACES, GoalClutter, seen_thread
from touchline_lab.simulation.observation.observed_lines import (
    NO_BODIES,
    NO_SECTORS,
    ObservedLines,
    occluders,
)
from touchline_lab.simulation.observation.point_errors import ObservationNoise, edge_shift, found_ratio
from touchline_lab.simulation.observation.runs import BAR, DISC, LINE
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

SCENARIOS = ("straight-tracks", "match", "tour-20", "occlusion-50")
FRAME, HIT, ERROR, CONFIDENCE, ON_RAY, RANGE, SHIFT = range(COLUMNS, COLUMNS + 7)  # columns behind those of a crossing
_NEAR_M, _NEAR_PX = 0.25, 3.0  # a point that far from a crossing of its path is another


@dataclass(frozen=True, eq=False)
class Comparison:
    """rows (N, COLUMNS + 7): crossings, whether and how well found; false points (M, 4): field frame x, y, distance to
    the nearest line, image; poses (F, 3) of the images (F,).
    """

    rows: FloatArray
    strays: FloatArray
    poses: FloatArray
    frames: FloatArray
    simulation: Simulation


def detected(simulation: Simulation) -> Iterator[LinePoints]:
    """What the detector finds in each image of a run, read with the camera that its eyes know."""
    camera = simulation._eyes.known or simulation.camera
    detector = SelfLearningDetector(camera, line_width_m=simulation.field.line_width)
    for frame in simulation:
        yield observe(frame, detector).points


def compare(simulation: Simulation, found: Iterator[LinePoints], every: int = 1) -> Comparison:
    """Pair the points of each image with the crossings that were there to be found."""
    observer = simulation._observed
    rows, strays, poses, frames = [], [], [], []
    for index, points in enumerate(found):
        time_s = float(simulation.image_times_s[index])
        if index % every or simulation.track.covered_at(time_s):
            continue
        pose = simulation.track.pose_at(time_s)
        crossings = observer.crossings(pose, simulation._bodies(time_s), simulation._black_rad)
        paired, left = _pair(observer, crossings, points)
        placed = pose.transform(points.positions_m[left])
        rows.append(np.column_stack((crossings, np.full(len(crossings), float(index)), paired)))
        frame = np.full(len(placed), float(index))
        strays.append(np.column_stack((placed, simulation.field.line_distances(placed), frame)))
        poses.append(pose.as_array())
        frames.append(float(index))
    return Comparison(np.concatenate(rows), np.concatenate(strays), np.array(poses), np.array(frames), simulation)


def _pair(observer: ObservedLines, crossings: FloatArray, points: LinePoints) -> tuple[FloatArray, FloatArray]:
    """(N, 6) hit, error, confidence, on a ray, range, shift by blur of each crossing; (M,) points that none has."""
    camera, rays, circles = observer.camera, observer._rays, observer._circles
    out = points.pixels - np.array(camera.center)
    radius = np.hypot(out[:, 0], out[:, 1])
    bearing = camera.mount_yaw_rad + camera.handedness * np.arctan2(out[:, 1], out[:, 0])
    off_ray = np.abs(_wrapped(bearing[:, None] - rays[None, :, 0])) * radius[:, None]
    off_circle = np.abs(radius[:, None] - circles[None, :, 1])
    of_ray = off_ray.min(axis=1) < 1e-3  # the middle of two edges on a circle lies a little inside it
    off = np.concatenate((off_ray, np.where(of_ray[:, None], np.inf, off_circle)), axis=1)
    free = np.ones(len(points), dtype=bool)
    table = np.zeros((len(crossings), 6))
    read_m = _as_read(observer, crossings[:, :2])
    ranges, bearings = np.hypot(*points.positions_m.T), np.arctan2(points.positions_m[:, 1], points.positions_m[:, 0])
    for row, crossing, (x, y) in zip(table, crossings, read_m, strict=True):
        path, scale, read = int(crossing[2]), crossing[4], math.hypot(x, y)
        row[1:4] = np.nan, np.nan, path < len(rays)
        row[4] = math.hypot(crossing[0], crossing[1])
        scales = observer._scales, observer._errors.read_scales
        row[5] = edge_shift(crossing, row[4], observer.noise.blur_px, *scales) if row[3] else 0.0
        near = np.flatnonzero(free & (off[:, path] < (1e-3 if path < len(rays) else 2.5)))
        if len(near) == 0:
            continue
        away = np.hypot(points.positions_m[near, 0] - x, points.positions_m[near, 1] - y)
        if away.min() > max(_NEAR_M, _NEAR_PX * scale):
            continue
        k = near[np.argmin(away)]
        free[k] = False
        along = ranges[k] - read if path < len(rays) else _wrapped(bearings[k] - math.atan2(y, x)) * read
        row[0], row[1], row[2] = 1.0, along / scale, points.confidences[k]
    return table, free


def _as_read(observer: ObservedLines, places_m: FloatArray) -> FloatArray:
    """Where ground points (N, 2) are read without any noise, by the camera that is known."""
    built = observer._built
    if built is None or built.known is None:
        return places_m
    return built.known.ground_from_image(built.project(places_m))


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.mod(angle + np.pi, 2.0 * np.pi) - np.pi


def minimised(cost: Callable[[FloatArray], float], start: FloatArray) -> FloatArray:
    """The lowest place of a smooth function (Powell's method)."""
    return np.atleast_1d(minimize(cost, start, method="Powell").x)


@njit(cache=True)
def _likelihood(rows, numbers):  # type: ignore[no-untyped-def]
    """Mean negative logarithm of the chance of what was found and missed."""
    total = 0.0
    for i in range(len(rows)):
        share = found_ratio(rows[i], rows[i, ON_RAY] > 0.0, rows[i, RANGE], numbers)
        share = min(max(share, 1e-3), 1.0 - 1e-3)
        total -= math.log(share if rows[i, HIT] > 0.0 else 1.0 - share)
    return total / len(rows)


def fit_names(rows: FloatArray, noise: ObservationNoise, names: Sequence[str]) -> ObservationNoise:
    """Fit shares (kept below 1), halves and slopes (kept above 0) to what was found."""

    def changed(values: FloatArray) -> ObservationNoise:
        tops = [0.999 if name.endswith("_ratio") else 1e3 for name in names]
        limited = np.clip(values, 1e-4, tops)
        return noise.model_copy(update={name: float(v) for name, v in zip(names, limited, strict=True)})

    start = np.array([getattr(noise, name) for name in names])
    best = minimised(lambda v: _likelihood(rows, changed(v).numbers(0.3, 0.01)), start)
    return changed(best)


def fit_errors(rows: FloatArray, noise: ObservationNoise) -> ObservationNoise:
    """Size, tails and growth of the errors by maximum likelihood under sinh(k z) / k, z normal."""
    hits = rows[(rows[:, HIT] > 0.0) & (rows[:, 5] != BAR)]
    error = hits[:, ERROR] - hits[:, SHIFT]
    sine, wide, odd = np.maximum(hits[:, 8], 0.05), hits[:, 7], hits[:, 10]

    def cost(logs: FloatArray) -> float:
        size, tail, oblique, thin, grazed, mixed = np.exp(logs)
        sigma = size / sine * (1.0 + (oblique / sine) ** 4) * np.sqrt(1.0 + (thin / wide) ** 2)
        sigma = sigma * np.where(odd == GRAZED, grazed, np.where(odd == MIXED, mixed, 1.0))
        z = np.arcsinh(tail * error / sigma) / tail
        return float(np.mean(0.5 * z**2 + np.log(sigma) + np.log(np.cosh(tail * z))))

    names = ("noise_px", "tail", "oblique_sine", "thin_px", "grazed_factor", "mixed_factor")
    start = np.log([getattr(noise, name) for name in names])
    best = np.exp(minimised(cost, start))
    return noise.model_copy(update=dict(zip(names, map(float, best), strict=True)))


def fit_contrast(rows: FloatArray, noise: ObservationNoise) -> ObservationNoise:
    """How wide a line looks white."""
    plain = (rows[:, HIT] > 0.0) & (rows[:, 5] == LINE) & (rows[:, 10] == PLAIN)
    wide, seen = rows[plain, 7], rows[plain, CONFIDENCE]
    contrast = minimised(lambda v: float(np.mean(np.abs(seen - 1.0 + np.exp(-wide / abs(v[0]))))), np.array([1.5]))
    return noise.model_copy(update={"contrast_px": float(abs(contrast[0]))})


def fit_repetition(tables: Sequence[FloatArray], noise: ObservationNoise) -> ObservationNoise:
    """What errors on one path share with those of the next images, near the same place and further along."""
    pairs: list[tuple[float, float, float]] = []
    for rows in tables:
        hits = rows[(rows[:, HIT] > 0.0) & (np.abs(rows[:, ERROR]) < 0.5) & (rows[:, 10] == PLAIN)]
        last: dict[int, FloatArray] = {}
        for row in hits[np.lexsort((hits[:, 9], hits[:, 2], hits[:, FRAME]))]:
            before = last.get(int(row[2]))
            if before is not None and before[FRAME] != row[FRAME] and abs(before[9] - row[9]) < 0.4:
                pairs.append((abs(before[9] - row[9]), before[ERROR] * before[8], row[ERROR] * row[8]))
            last[int(row[2])] = row
    way, one, other = np.array(pairs).T
    same, apart = way < 0.01, way > 0.15
    kept = float(np.corrcoef(one[same], other[same])[0, 1])
    left = float(np.corrcoef(one[apart], other[apart])[0, 1]) / kept
    phases = np.linspace(0.2, 3.0, 57)
    errors = [abs(_repetition(float(np.mean(way[apart])) / phase) - left) for phase in phases]
    return noise.model_copy(update={"kept_ratio": kept, "phase_px": float(phases[int(np.argmin(errors))])})


def _repetition(way: float) -> float:
    """Correlation of `phase_noise` at places `way` apart, over all phases."""
    starts = np.linspace(0.0, 1.0, 101)

    def weights(place: FloatArray) -> FloatArray:
        knots = np.arange(0, 8)[:, None]
        hat = np.maximum(1.0 - np.abs(place[None] - knots), 0.0)
        return hat / np.sqrt((hat**2).sum(axis=0))

    return float(np.mean((weights(starts) * weights(starts + min(way, 5.0))).sum(axis=0)))


def fit_strays(comparisons: Sequence[Comparison], noise: ObservationNoise) -> ObservationNoise:
    """Points that lie on no line: at the goals of each kind, and elsewhere."""
    groups: dict[str, list[Comparison]] = {"white_goals": [], "coloured_goals": [], "covered_goals": []}
    for c in comparisons:
        free = "white_goals" if c.simulation.field.goals[0].color == "white" else "coloured_goals"
        groups["covered_goals" if len(c.simulation._black_rad) else free].append(c)
    clutter = {
        name: fit_clutter(np.concatenate([goal_views(c) for c in group]), getattr(noise, name))
        for name, group in groups.items()
        if group
    }
    elsewhere = sum(int(strays_elsewhere(c).sum()) for c in comparisons)
    images = sum(len(c.poses) for c in comparisons)
    return noise.model_copy(update={**clutter, "false_points": elsewhere / images})


def strays_elsewhere(c: Comparison) -> np.ndarray:
    """(M,) which false points lie at no goal, line or mark."""
    far = c.strays[:, 2] > 0.15
    for disc in c.simulation.field.discs:
        far &= np.hypot(c.strays[:, 0] - disc[0], c.strays[:, 1] - disc[1]) > 0.3
    for goal in c.simulation.field.goals:
        far &= ~_near_goal(c.strays, goal)
    return far


def _near_goal(strays: FloatArray, goal: Goal) -> np.ndarray:
    x, y = math.copysign(1.0, goal.x) * strays[:, 0], strays[:, 1]
    return (x > abs(goal.x) - 0.1) & (y > min(goal.y_posts) - 2.0) & (y < max(goal.y_posts) + 2.0)


def goal_places(
    observer: ObservedLines, pose: Pose, bodies: FloatArray = NO_BODIES, black_rad: FloatArray = NO_SECTORS
) -> FloatArray:
    """(G, 2) share of each goal's places for false points that a pose can see: on the net behind, at the sides."""
    height_m, ground = observer.noise.height_m, observer._ground
    hiding, sectors = occluders(bodies, height_m), observer._sectors(black_rad)
    seen = np.zeros((len(observer._goals[0]), 2))
    for row, thread in enumerate(observer._threads):
        goal, net = row // PLACES, row % PLACES < NET_PLACES
        x, y = seen_thread(thread, net, pose.x, pose.y, (height_m, ground.mouth, hiding, ground.carpet, ground.scales))
        if not math.isnan(x) and not inside_sector(math.atan2(y - pose.y, x - pose.x) - pose.heading, sectors):
            seen[goal, 0 if net else 1] += 1.0
    return seen / (NET_PLACES, PLACES - NET_PLACES)


def goal_views(c: Comparison) -> FloatArray:
    """(V, 5) of each image and goal nearer than 8 m: distance, shares in view (net, sides), points (net, sides)."""
    observer, views = c.simulation._observed, []
    inside = c.strays[c.strays[:, 2] > 0.15]
    for pose, frame in zip(c.poses, c.frames, strict=True):
        time_s = float(c.simulation.image_times_s[int(frame)])
        shares = goal_places(observer, Pose(*pose), c.simulation._bodies(time_s), c.simulation._black_rad)
        mine = inside[inside[:, 3] == frame]
        for goal, share in zip(c.simulation.field.goals, shares, strict=True):
            middle = 0.5 * sum(goal.y_posts)
            away = math.hypot(goal.x - pose[0], middle - pose[1])
            if away > 8.0:
                continue
            at = mine[_near_goal(mine, goal)]
            half = 0.5 * abs(goal.y_posts[1] - goal.y_posts[0]) + 0.2
            net = (np.abs(at[:, 0]) > abs(goal.x) + goal.depth) & _behind(at, pose, goal, half)
            views.append((away, *share, net.sum(), len(at) - net.sum()))
    return np.array(views)


def _behind(at: FloatArray, pose: FloatArray, goal: Goal, half: float) -> np.ndarray:
    """(K,) whether places are seen through the net behind: the way there passes between the goal's sides."""
    net_x = goal.x + math.copysign(goal.depth, goal.x)
    share = (net_x - pose[0]) / (at[:, 0] - pose[0])
    return np.abs(pose[1] + share * (at[:, 1] - pose[1]) - 0.5 * sum(goal.y_posts)) < half


def fit_clutter(views: FloatArray, clutter: GoalClutter) -> GoalClutter:
    """Numbers that fall with the distance, by maximum likelihood of Poisson counts."""

    def limited(logs: FloatArray) -> FloatArray:
        return np.maximum(np.exp(logs), (0.0, 1.0, 0.05))  # nothing tells what is seen within 1 m

    def cost(logs: FloatArray, column: int) -> float:
        number, half, slope = limited(logs)
        mean = views[:, 1 + column] * number / (1.0 + np.exp((views[:, 0] - half) / slope))
        return float(np.mean(mean + 1e-3 - views[:, 3 + column] * np.log(mean + 1e-3)))

    values, numbers = list[float](), clutter.numbers()
    for column, start in enumerate((numbers[:3], numbers[4:])):
        starts = [each for each in (start, *([start[0], half_m, 0.5] for half_m in (1.5, 3.0, 4.5))) if min(each) > 0.0]
        found = [minimised(lambda logs, column=column: cost(logs, column), np.log(each)) for each in starts]
        best = limited(min(found, key=lambda logs, column=column: cost(logs, column)))
        values += [*map(float, best), *([0.0] if column == 0 else [])]
    return GoalClutter(**dict(zip(GoalClutter.model_fields, values, strict=True)))


def fit(comparisons: Sequence[Comparison], noise: ObservationNoise) -> ObservationNoise:
    """All figures but the gaps between lines, the coarseness of a body's outline and the head's height."""
    rows = np.concatenate([c.rows for c in comparisons])
    noise = fit_repetition([c.rows for c in comparisons], noise)
    noise = fit_errors(rows, fit_contrast(rows, noise))
    lines = rows[rows[:, 5] == LINE]
    for _ in range(2):
        noise = fit_names(
            lines, noise,
            ("found_ratio", "circle_ratio", "thin_half_px", "thin_slope_px", "coarse_half_m", "coarse_slope_m",
             "flat_half", "flat_slope", "blur_px", "long_slope_px", "grazed_ratio", "mixed_ratio"),
        )  # fmt: skip
    bars, marks = rows[rows[:, 5] == BAR], rows[rows[:, 5] == DISC]
    if len(bars) > 100:
        noise = fit_names(bars, noise, ("bar_ratio", "bar_half_m", "bar_slope_m"))
    if len(marks) > 100:
        noise = fit_names(marks, noise, ("mark_ratio",))
    return fit_strays(comparisons, noise)


def main() -> None:
    """Render, compare, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    before, comparisons = ObservationNoise(), []
    for name in SCENARIOS:
        for seed in range(1, arguments.seeds + 1):
            simulation = Simulation(open_scenario(name, seed, arguments.seconds, ["ideal=true"]))
            comparisons.append(compare(simulation, detected(simulation)))
            rows, strays = comparisons[-1].rows, comparisons[-1].strays
            images = len(comparisons[-1].poses)
            print(f"{name} {seed}: {images} images, {len(rows) / images:.1f} crossings each, of which "
                  f"{100 * rows[:, HIT].mean():.1f} % found, {len(strays) / images:.1f} other points")  # fmt: skip
    after = fit(comparisons, before)
    for name, _, _ in settings_rows(ObservationNoise):
        old, new = (attrgetter(name)(noise) for noise in (before, after))
        print(f"{name:30s} {old:8.4f} -> {new:8.4f}")


if __name__ == "__main__":
    main()
