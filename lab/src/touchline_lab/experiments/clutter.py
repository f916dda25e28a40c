"""What is seen instead of the field's lines, or besides: blobs, rings, garbage, robots, nets, another field's lines.

A thing is drawn once, when a fault begins, and then tells where points on it are seen from each pose.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from touchline.geometry import BoolArray, FloatArray, Pose
from touchline.types import Crossings, Frame, LinePoints, Lines, Observation, generic_covariances, points_at
from touchline_lab.experiments.drives import Drive
from touchline_lab.experiments.injections import Change, Random, seen_as
from touchline_lab.simulation.observation.feature_noise import PINHOLE_FEATURES

NEAR_LINE_M = 0.2  # line points this near a line belong to it
GARBAGE_POINTS = 100
GAP_M, VIEW_M = 3.0, 7.0  # from a field to the next; how far its lines are seen
SIDE_RAD = 0.65  # as far to either side walking robots see
EYES_M = 0.8  # height from which things that stand up hide the carpet behind them
MAX_SHADOW_M = 3.0
NET_THREADS, NET_M = 60, 0.56  # on each goal's net; up to this height
FALSE_CROSSINGS = 5  # where nothing else is seen

Points: TypeAlias = Callable[[Pose], FloatArray]  # (N, 2) in the robot frame, of the robot's pose
Thing: TypeAlias = Callable[[Drive, int, Random], Points]  # drawn at the first frame
Shape: TypeAlias = Callable[[Random], FloatArray]  # (N, 2) in the robot frame


def shown(thing: Thing, besides: bool = True, ratio: tuple[float, float] | None = None) -> Change:
    """A thing is seen besides what is there, or instead. ratio: of all points so many are on it, drawn between."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        points, poses = thing(drive, int(np.argmax(wrong)), rng), _poses(drive)
        share = None if ratio is None else float(rng.uniform(*ratio))

        def with_it(frame: Frame, seen: Observation) -> Observation:
            found = points(poses[frame.stamp_ns])
            if drive.setup.walks:
                found = found[np.abs(np.arctan2(found[:, 1], found[:, 0])) < SIDE_RAD]
            if share is not None and len(found):
                found = rng.choice(found, round(share / (1.0 - share) * len(seen.points)))
            false = points_at(found + 0.01 * rng.standard_normal(found.shape))
            if besides:
                return replace(seen, points=LinePoints.joined([seen.points, false]))
            return Observation(frame.stamp_ns, false)

        return seen_as(drive, with_it, wrong)

    return change


def _poses(drive: Drive) -> dict[int, Pose]:
    """The true pose at each frame's stamp."""
    return {frame.stamp_ns: Pose(*row) for frame, row in zip(drive.frames, drive.truth.tolist(), strict=True)}


# --- things: where they are -------------------------------------------------------------------------------------------


def standing(shape: Shape) -> Thing:
    """What is about the robot at the first frame stays there in the field."""

    def drawn(drive: Drive, first: int, rng: Random) -> Points:
        placed = Pose(*drive.truth[first].tolist()).transform(_in_view(drive, shape(rng)))
        return lambda pose: pose.inverse().transform(placed)

    return drawn


def riding(shape: Shape) -> Thing:
    """What is seen of the robot itself, always at the same place."""

    def drawn(drive: Drive, first: int, rng: Random) -> Points:
        found = _in_view(drive, shape(rng))
        return lambda pose: found

    return drawn


def _in_view(drive: Drive, points_m: FloatArray) -> FloatArray:
    """Points (N, 2), their middle ahead of a robot that sees nothing else."""
    x, y = points_m.mean(axis=0).tolist()
    return Pose(0.0, 0.0, -math.atan2(y, x)).transform(points_m) if drive.setup.walks else points_m


def anew(shape: Shape) -> Thing:
    """Other points in every image."""
    return lambda drive, first, rng: lambda pose: shape(rng)


def all_of(*things: Thing) -> Thing:
    """Several things."""

    def drawn(drive: Drive, first: int, rng: Random) -> Points:
        each = [thing(drive, first, rng) for thing in things]
        return lambda pose: np.concatenate([points(pose) for points in each])

    return drawn


# --- shapes -----------------------------------------------------------------------------------------------------------


def _anywhere(rng: Random, nearest_m: float, farthest_m: float) -> Pose:
    away_m, bearing = rng.uniform(nearest_m, farthest_m), rng.uniform(-math.pi, math.pi)
    return Pose(away_m * math.cos(bearing), away_m * math.sin(bearing), rng.uniform(-math.pi, math.pi))


def blob(nearest_m: float, farthest_m: float) -> Shape:
    """A heap of 100 to 400 points at a distance between."""

    def points(rng: Random) -> FloatArray:
        spread_m, count = rng.uniform(0.1, 0.4), int(rng.integers(100, 401))
        return _anywhere(rng, nearest_m, farthest_m).transform(spread_m * rng.standard_normal((count, 2)))

    return points


def ring(radius_m: float) -> Shape:
    """A circle about the robot: its own edge."""

    def points(rng: Random) -> FloatArray:
        bearing = rng.uniform(-math.pi, math.pi, GARBAGE_POINTS)
        return radius_m * np.column_stack((np.cos(bearing), np.sin(bearing)))

    return points


def uniform(rng: Random) -> FloatArray:
    """Points anywhere within 6 m."""
    return rng.uniform(-6.0, 6.0, (GARBAGE_POINTS, 2))


def bars(rng: Random) -> FloatArray:
    """Three to six short straight things on the carpet: bars of nets, cables, boards."""
    along = np.linspace(-0.5, 0.5, 40)
    each = [np.column_stack((rng.uniform(0.5, 2.5) * along, 0.0 * along)) for _ in range(rng.integers(3, 7))]
    return np.concatenate([_anywhere(rng, 1.0, 5.0).transform(bar) for bar in each])


# --- things that are more than a shape --------------------------------------------------------------------------------


def false_line(drive: Drive, first: int, rng: Random) -> Points:
    """A straight line that goes with the robot, 1.5 m from it, and does not turn."""
    line = np.column_stack((np.linspace(-3.0, 3.0, 60), np.full(60, 1.5)))
    return lambda pose: Pose(0.0, 0.0, 0.5 - pose.heading).transform(line)


def robots(drive: Drive, first: int, rng: Random) -> Points:
    """Outlines of three to six robots, as white pixels are laid on the ground: the foot, and both sides behind it."""
    places = np.array([_anywhere(rng, 0.8, 5.0)[:2] for _ in range(rng.integers(3, 7))])
    feet = Pose(*drive.truth[first].tolist()).transform(places)
    radii, heights = rng.uniform(0.1, 0.28, len(feet)), rng.uniform(0.3, 0.8, len(feet))
    arc, along = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 15), np.linspace(0.0, 1.0, 25)

    def outline(x: float, y: float, radius_m: float, height_m: float) -> FloatArray:
        away_m = max(math.hypot(x, y), 0.3)
        shadow = min(height_m / max(EYES_M - height_m, 0.05), MAX_SHADOW_M / away_m) * along
        foot = np.column_stack((away_m - radius_m * np.cos(arc), radius_m * np.sin(arc)))
        sides = [np.column_stack((away_m + away_m * shadow, side * (1.0 + shadow))) for side in (-radius_m, radius_m)]
        return Pose(0.0, 0.0, math.atan2(y, x)).transform(np.concatenate((foot, *sides)))

    def points(pose: Pose) -> FloatArray:
        seen = np.column_stack((pose.inverse().transform(feet), radii, heights))
        return np.concatenate([outline(*row) for row in seen.tolist()])

    return points


def nets(drive: Drive, first: int, rng: Random) -> Points:
    """Threads of the goals' nets, which stand up and are seen farther behind the goal line than they are."""
    feet, up = [np.zeros((0, 2))], rng.uniform(0.0, NET_M, NET_THREADS * len(drive.field.goals))
    for goal in drive.field.goals:
        x = goal.x + math.copysign(1.0, goal.x) * rng.uniform(0.4, 0.6, NET_THREADS)
        feet.append(np.column_stack((x, rng.uniform(min(goal.y_posts), max(goal.y_posts), NET_THREADS))))
    places, farther = np.concatenate(feet), EYES_M / (EYES_M - up[:, np.newaxis])

    def points(pose: Pose) -> FloatArray:
        seen = farther * pose.inverse().transform(places)
        return np.asarray(seen[np.hypot(*seen.T) < VIEW_M])

    return points


def next_field(drive: Drive, first: int, rng: Random) -> Points:
    """Lines of a field like this one on a side of it that is drawn."""
    side = np.array(((0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0))[rng.integers(4)])
    away_m = side * (np.array([drive.field.length, drive.field.width]) + GAP_M)
    places = np.concatenate(drive.field.polylines(0.1)) + away_m

    def points(pose: Pose) -> FloatArray:
        seen = pose.inverse().transform(places)
        range_m = np.hypot(*seen.T)
        kept = (range_m < VIEW_M) & (rng.random(len(seen)) < 1.5 / np.maximum(range_m, 1.5))
        return np.asarray(seen[kept] * (1.0 + 0.02 * rng.standard_normal((np.count_nonzero(kept), 1))))

    return points


# --- less than there is -----------------------------------------------------------------------------------------------


def thinned(kept: Callable[[FloatArray, Random], BoolArray]) -> Change:
    """Of what is seen only some is left. kept: which, of places (N, 2) in the robot frame."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        def left(frame: Frame, seen: Observation) -> Observation:
            return replace(
                seen,
                points=seen.points.rows(kept(seen.points.positions_m, rng)),
                lines=seen.lines.rows(kept(seen.lines.ends_m.mean(axis=1), rng)),
                crossings=seen.crossings.rows(kept(seen.crossings.positions_m, rng)),
                landmarks=seen.landmarks.rows(kept(seen.landmarks.positions_m, rng)),
            )

        return seen_as(drive, left, wrong)

    return change


def one_line(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
    """Of the true points only those of one line: the one that showed most of them when it began."""
    first, poses = int(np.argmax(wrong)), _poses(drive)

    def on_line(frame: Frame, segment: FloatArray) -> BoolArray:
        seen = frame.observation or Observation(frame.stamp_ns)
        placed = poses[frame.stamp_ns].transform(seen.points.positions_m)
        return np.asarray(distances_to_segment(placed, segment) < NEAR_LINE_M)

    most = max(drive.field.segments, key=lambda segment: np.count_nonzero(on_line(drive.frames[first], segment)))
    return seen_as(
        drive, lambda frame, seen: Observation(frame.stamp_ns, seen.points.rows(on_line(frame, most))), wrong
    )


def distances_to_segment(points: FloatArray, segment: FloatArray) -> FloatArray:
    """(N,) distances of points (N, 2) from a segment (x1, y1, x2, y2)."""
    start, along = segment[:2], segment[2:4] - segment[:2]
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
    return np.hypot(*(points - start - share[:, None] * along).T)


# --- features that are none -------------------------------------------------------------------------------------------


def false_crossings(ratio: float) -> Change:
    """So many of all crossings are none: even in the view, of random kinds, turned anyhow; 1: nothing else is seen."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        def with_false(frame: Frame, seen: Observation) -> Observation:
            true, n = seen.crossings, FALSE_CROSSINGS
            count = int(rng.poisson(len(true) * ratio / (1.0 - ratio))) if ratio < 1.0 else n
            ranges = PINHOLE_FEATURES.farthest_m * np.sqrt(rng.random(count))
            bearings = rng.uniform(-SIDE_RAD, SIDE_RAD, count)
            places = np.column_stack((ranges * np.cos(bearings), ranges * np.sin(bearings)))
            kinds, turns = rng.choice(["L", "T", "X"], count), rng.uniform(-math.pi, math.pi, count)
            unknown = np.full((count, 2), np.nan)
            false = Crossings(kinds, places, turns, generic_covariances(places), np.ones(count), unknown)
            if ratio < 1.0:
                return replace(seen, crossings=Crossings.joined([true, false]))
            return Observation(frame.stamp_ns, crossings=false)

        return seen_as(drive, with_false, wrong)

    return change


def false_lines(count: int, besides: bool = True) -> Change:
    """So many straight things of 1.4 m that are no lines stand in the field from the first wrong frame on."""

    def change(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
        origin, poses = Pose(*drive.truth[int(np.argmax(wrong))].tolist()), _poses(drive)
        half = np.array([[-0.7, 0.0], [0.7, 0.0]])
        bars_m = np.concatenate([_anywhere(rng, 1.0, 4.0).transform(half) for _ in range(count)])
        placed = origin.transform(_in_view(drive, bars_m))

        def with_them(frame: Frame, seen: Observation) -> Observation:
            ends = poses[frame.stamp_ns].inverse().transform(placed).reshape(-1, 2, 2)
            ends = ends[(ends[:, :, 0] > 0.3).all(axis=1)]
            covariances = generic_covariances(ends.reshape(-1, 2)).reshape(-1, 2, 2, 2)
            false = Lines(ends, covariances, np.ones(len(ends)), np.full((len(ends), 2, 2), np.nan))
            if besides:
                return replace(seen, lines=Lines.joined([seen.lines, false]))
            return Observation(frame.stamp_ns, lines=false)

        return seen_as(drive, with_them, wrong)

    return change
