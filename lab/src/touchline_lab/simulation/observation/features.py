"""Lines, crossings and landmarks at the observation level: what nimbro-lines' detector would deliver.

What a humanoid's camera shows of the field is worked out with its real image: lines thinner there than a pixel are not
seen, crossings need the ground about them. How often the rest is found and how well it is placed comes from rendered
images. For a camera with a mirror no such detector exists; its crossings were measured
on the line points of `LinePointDetector`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from touchline.camera import Camera
from touchline.field import Crossing, FieldModel
from touchline.geometry import BoolArray, FloatArray, Pose, longest_run, wrap_angle, wrap_angles
from touchline.types import Colors, CrossingKind, Crossings, LandmarkKind, Landmarks, Lines, Observation
from touchline_lab.simulation.observation.crossings import hidden
from touchline_lab.simulation.observation.feature_noise import FeatureNoise, LandmarkNoise
from touchline_lab.simulation.observation.observed_lines import NO_BODIES, NO_SECTORS, occluders

_STEP_M = 0.05
_FALSE_M, _FALSE_RAD, _FALSE_LENGTH_M = 6.0, 0.65, (0.4, 2.0)  # of false lines: how far, how far aside, how long
_THREAD_M = 0.12  # height of a net's lowest thread
_ON_RING = 8  # places about a crossing that must be in view
_ON_CIRCLE, _MIN_ON_CIRCLE = 24, 7  # places on the centre circle, and how many of these the detector needs


class _Mark(NamedTuple):
    """place: x, y, field frame. goal: of a post, which of the field's goals it belongs to."""

    kind: LandmarkKind
    place: tuple[float, float]
    colors: Colors
    noise: LandmarkNoise
    goal: int | None = None


class ObservedFeatures:
    """A virtual detector of features for one camera and one field."""

    def __init__(
        self, camera: Camera, field: FieldModel, noise: FeatureNoise | None = None, view_rad: float = math.pi
    ) -> None:
        """view_rad: how far to each side the camera sees."""
        self.camera, self.field = camera, field
        self.noise = noise or FeatureNoise()
        self.view = FeatureView(camera, self.noise.farthest_m, self.noise.tail, view_rad)
        self._along = [_steps_along(segment) for segment in field.segments]  # of each straight line
        coloured = [goal for goal in field.goals if goal.color != "white"] if self.noise.net_ratio > 0.0 else []
        backs = [(goal.x + math.copysign(goal.depth, goal.x), *goal.y_posts) for goal in coloured]
        self._nets = [_steps_along(np.array((x, ys[0], x, ys[-1]))) for x, *ys in backs]
        ratios = [self.noise.line_ratio] * len(self._along) + [self.noise.net_ratio] * len(self._nets)
        self._line_ratios = np.array(ratios)
        self._places = np.array([(c.x, c.y) for c in field.crossings]).reshape(-1, 2)
        self._arms = np.array([_arms(c) for c in field.crossings]).reshape(-1, 2, 2)
        turns = 2.0 * math.pi * np.arange(_ON_RING) / _ON_RING
        self._ring = self.noise.ring_m * np.column_stack((np.cos(turns), np.sin(turns)))
        self._landmarks = _landmarks(field, self.noise)

    def observe(
        self,
        pose: Pose,
        rng: np.random.Generator,
        bodies: FloatArray = NO_BODIES,
        black_rad: FloatArray = NO_SECTORS,
        stamp_ns: int = 0,
    ) -> Observation:
        """What is seen from a pose; bodies (K, 4), black_rad (B, 2) as of `ObservedLines`."""
        looking = Looking(pose, occluders(bodies, self.noise.height_m), black_rad)
        crossings, landmarks = self._crossings(looking, rng), self._marks(looking, rng)
        seen = Observation(stamp_ns, lines=self._lines(looking, rng), crossings=crossings, landmarks=landmarks)
        if self.noise.lean_deg == 0.0:
            return seen
        roll, pitch = math.radians(self.noise.lean_deg) * rng.standard_normal(2)
        return leaning(seen, float(roll), float(pitch), self.noise.height_m, self.noise.lean_deg)

    def visible_crossings(self, looking: Looking) -> BoolArray:
        """(C,) which of the field's crossings are in view, with the ground about them."""
        visible = self.view.shows(looking, self._places, self.noise.farthest_crossing_m)
        if self.noise.ring_m > 0.0 and visible.any():
            about = (self._places[visible, np.newaxis] + self._ring).reshape(-1, 2)
            nothing = looking._replace(hiding=looking.hiding[:0])
            visible[visible] = self.view.shows(nothing, about).reshape(-1, _ON_RING).all(axis=1)
        return visible

    def arm_widths(self, pose: Pose) -> FloatArray:
        """(C,) how wide (px) the thinner arm of each of the field's crossings looks."""
        widths = [self.view.widths(pose, self._places, self._arms[:, k], self.field.line_width) for k in (0, 1)]
        return np.minimum(*widths)

    def _crossings(self, looking: Looking, rng: np.random.Generator) -> Crossings:
        kinds, orientations = [], []
        noise, pose = self.noise, looking.pose
        distances_m = np.hypot(*(self._places - (pose.x, pose.y)).T)
        shares = noise.found_ratio * logistic((noise.found_half_m - distances_m) / noise.found_slope_m)
        if noise.found_half_px > 0.0:
            shares *= _by_size(self.arm_widths(pose), noise.found_half_px, noise.found_log_slope)
        chosen = np.flatnonzero(self.visible_crossings(looking) & (rng.random(len(shares)) < shares))
        sizes = np.tile((noise.outwards_px, noise.across_px), (len(chosen), 1))
        seen = self._seen(pose, self._places[chosen], sizes, rng)
        for index in chosen:
            crossing = self.field.crossings[index]
            kind = crossing.kind
            if rng.random() < noise.wrong_kind_ratio:
                kind = [k for k in CrossingKind if k is not kind][int(rng.integers(2))]
            turned = crossing.orientation_rad - pose.heading
            turned += math.radians(noise.orientation_deg) * float(self.view.tailed(rng.standard_normal(1))[0])
            kinds.append(kind.value)
            orientations.append(turned % (0.5 * math.pi) if kind is CrossingKind.X else wrap_angle(turned))
        found, turns = np.array(kinds, dtype="U1"), np.array(orientations, dtype=np.float64)
        return Crossings(found, seen.positions_m, turns, seen.covariances_m2, np.ones(len(chosen)), seen.pixels)

    def _marks(self, looking: Looking, rng: np.random.Generator) -> Landmarks:
        """Posts, poles, penalty marks and the circle; and goals, both of whose posts are seen."""
        pose, marks = looking.pose, self._landmarks
        places = np.array([mark.place for mark in marks]).reshape(-1, 2)
        distances_m = np.hypot(*(places - (pose.x, pose.y)).T)
        noises = [mark.noise for mark in marks]
        found = np.array([(n.found_ratio, n.found_half_m, n.found_slope_m) for n in noises]).reshape(-1, 3)
        ratio, half, slope = found.T
        visible = self.view.shows(looking, places)
        of_circle = np.array([mark.kind is LandmarkKind.CIRCLE for mark in marks], dtype=np.bool_)
        if of_circle.any():
            visible[of_circle] = self.shows_circle(looking)
        chosen = np.flatnonzero(visible & (rng.random(len(marks)) < ratio * logistic((half - distances_m) / slope)))
        sizes = np.array([(noises[k].outwards_px, noises[k].across_px) for k in chosen]).reshape(-1, 2)
        seen = self._seen(pose, places[chosen], sizes, rng)
        placed = np.isfinite(seen.positions_m).all(axis=1)  # the circle's centre may lie behind the camera
        chosen, seen = chosen[placed], Seen(*(each[placed] for each in seen))
        shown = [marks[k] for k in chosen]
        pairs = [(k, [i for i, mark in enumerate(shown) if mark.goal == k]) for k in range(len(self.field.goals))]
        pairs = [(k, pair) for k, pair in pairs if len(pair) == len({*self.field.goals[k].y_posts})]
        middles = [seen.positions_m[pair].mean(axis=0) for _, pair in pairs]
        spreads = [seen.covariances_m2[pair].sum(axis=0) / len(pair) ** 2 for _, pair in pairs]
        return Landmarks(
            np.array([mark.kind.value for mark in shown] + [LandmarkKind.GOAL.value] * len(pairs), dtype="U12"),
            np.concatenate((seen.positions_m, np.reshape(middles, (-1, 2)))),
            np.concatenate((seen.covariances_m2, np.reshape(spreads, (-1, 2, 2)))),
            np.ones(len(shown) + len(pairs)),
            tuple(mark.colors for mark in shown) + tuple((self.field.goals[k].color,) for k, _ in pairs),
            np.concatenate((seen.pixels, np.full((len(pairs), 2), np.nan))),
        )

    def shows_circle(self, looking: Looking) -> bool:
        """Whether as much of the centre circle is in view as the detector needs."""
        cx, cy, radius = self.field.circles[0]
        turns = 2.0 * math.pi * np.arange(_ON_CIRCLE) / _ON_CIRCLE
        places = np.array([cx, cy]) + radius * np.column_stack((np.cos(turns), np.sin(turns)))
        return int(self.view.shows(looking, places, self.noise.farthest_crossing_m).sum()) >= _MIN_ON_CIRCLE

    def visible_lines(self, looking: Looking) -> list[FloatArray]:
        """Of each straight line, then of each net's lowest thread, the ends (2, 2), field frame, of the longest stretch
        in view; (0, 2) where it is too short.
        """
        threads = [self._above(looking.pose, places, _THREAD_M) for places in self._nets]
        paths = [*self._along, *threads]
        in_view = self.view.shows(looking, np.concatenate([np.zeros((0, 2)), *paths]))
        if self.noise.thinnest_px > 0.0 and in_view.any():
            directions = np.concatenate([np.tile(_direction(places), (len(places), 1)) for places in paths])
            places = np.concatenate(paths)
            widths = self.view.widths(looking.pose, places[in_view], directions[in_view], self.field.line_width)
            in_view[in_view] = widths >= self.noise.thinnest_px
        stretches = []
        parts = np.split(in_view, np.cumsum([len(places) for places in paths]))
        for places, visible in zip(paths, parts, strict=False):
            first, last = longest_run(visible)
            ends = places[[first, last - 1]] if last > first else places[:0]
            long_enough = len(ends) > 0 and math.hypot(*(ends[1] - ends[0])) >= self.noise.shortest_line_m
            stretches.append(ends if long_enough else ends[:0])
        return stretches

    def _above(self, pose: Pose, places: FloatArray, height_m: float) -> FloatArray:
        """Where on the ground (N, 2) it seems to be what is at a height above places; field frame."""
        farther = self.noise.height_m / (self.noise.height_m - height_m)
        return (pose.x, pose.y) + farther * (places - (pose.x, pose.y))

    def lengths(self, pose: Pose, ends: FloatArray) -> FloatArray:
        """(L,) lengths in the image (px) of stretches (L, 2, 2), field frame."""
        pixels = self.camera.image_from_ground(pose.inverse().transform(ends.reshape(-1, 2))).reshape(-1, 2, 2)
        return np.hypot(*(pixels[:, 1] - pixels[:, 0]).T)

    def _lines(self, looking: Looking, rng: np.random.Generator) -> Lines:
        """Of each straight line the longest stretch in view, and threads of nets that are taken for lines."""
        noise, stretches = self.noise, self.visible_lines(looking)
        long_enough = np.array([len(stretch) > 0 for stretch in stretches], dtype=np.bool_)
        ends = np.array([stretch for stretch in stretches if len(stretch)]).reshape(-1, 2, 2)
        shares = self._line_ratios[long_enough]
        if noise.line_half_px > 0.0:
            shares *= _by_size(self.lengths(looking.pose, ends), noise.line_half_px, noise.line_log_slope)
        ends = np.concatenate((ends[rng.random(len(ends)) < shares], self._false_lines(looking, rng)))
        seen = self._off_along(looking.pose, ends, rng)
        return Lines(
            seen.positions_m.reshape(-1, 2, 2),
            seen.covariances_m2.reshape(-1, 2, 2, 2),
            np.ones(len(ends)),
            seen.pixels.reshape(-1, 2, 2),
        )

    def _false_lines(self, looking: Looking, rng: np.random.Generator) -> FloatArray:
        """(F, 2, 2) ends, field frame, of lines that are none: anywhere in view, in any direction."""
        count = int(rng.poisson(self.noise.false_lines)) if self.noise.false_lines > 0.0 else 0
        ranges, bearings = _FALSE_M * np.sqrt(rng.random(count)), rng.uniform(-_FALSE_RAD, _FALSE_RAD, count)
        turns, halves = rng.uniform(-math.pi, math.pi, count), 0.5 * rng.uniform(*_FALSE_LENGTH_M, count)
        middles = np.column_stack((ranges * np.cos(bearings), ranges * np.sin(bearings)))
        reach = halves[:, np.newaxis] * np.column_stack((np.cos(turns), np.sin(turns)))
        ends = looking.pose.transform(np.stack((middles - reach, middles + reach), axis=1).reshape(-1, 2))
        in_view = self.view.shows(looking, ends).reshape(-1, 2).all(axis=1)
        return ends.reshape(-1, 2, 2)[in_view]

    def _off_along(self, pose: Pose, stretches: FloatArray, rng: np.random.Generator) -> Seen:
        """The ends (2 L, 2) of stretches (L, 2, 2), field frame: off along their lines by metres, across by pixels."""
        noise = self.noise
        ground = pose.inverse().transform(stretches.reshape(-1, 2)).reshape(-1, 2, 2)
        step = ground[:, 1] - ground[:, 0]
        along = step / np.hypot(step[:, 0], step[:, 1])[:, np.newaxis]
        shifts_m = noise.line_end_m * self.view.tailed(rng.standard_normal((len(ground), 2, 1)))
        ground = ground + shifts_m * along[:, np.newaxis]
        ends, along = ground.reshape(-1, 2), np.repeat(along, 2, axis=0)
        pixels = self.camera.image_from_ground(ends).reshape(-1, 2, 2)
        in_image = pixels[:, 1] - pixels[:, 0]
        in_image = in_image / np.maximum(np.hypot(in_image[:, 0], in_image[:, 1]), 1e-9)[:, np.newaxis]
        sizes = np.tile((0.0, noise.line_px), (len(ends), 1))
        seen = self.view.perturbed(ends, np.repeat(in_image, 2, axis=0), sizes, rng)
        beyond = tail_variance(noise.tail) * noise.line_end_m**2 * along[:, :, np.newaxis] * along[:, np.newaxis]
        return seen._replace(covariances_m2=seen.covariances_m2 + beyond)

    def _seen(self, pose: Pose, places: FloatArray, sizes_px: FloatArray, rng: np.random.Generator) -> Seen:
        """Places (N, 2), field frame, with errors outwards and across."""
        ground = pose.inverse().transform(places)
        return self.view.perturbed(ground, self.view.outwards(ground), sizes_px, rng)


def leaning(seen: Observation, roll: float, pitch: float, height: float, known_deg: float = 0.0) -> Observation:
    """Features as a view at a height (m) sees them that leans by an unknown roll and pitch (rad).

    known_deg: size of such errors that the features' covariances tell of.
    """
    lean_rad = math.radians(known_deg)

    def moved(ground: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y = ground[..., 0], ground[..., 1]
        by_roll = np.stack((-x * y / height, -height - y * y / height), axis=-1)
        by_pitch = np.stack((height + x * x / height, x * y / height), axis=-1)
        shared = sum(axis[..., :, np.newaxis] * axis[..., np.newaxis, :] for axis in (by_roll, by_pitch))
        return ground + roll * by_roll + pitch * by_pitch, covariances + lean_rad**2 * shared

    return _moved(seen, moved)


def turned(seen: Observation, angle_rad: float, scale: float = 1.0, flipped: bool = False) -> Observation:
    """What is seen in a frame in which what saw it stands turned by an angle to the left.

    scale: so many times as far away; flipped: left for right, before it is turned.
    """
    c, s = scale * math.cos(angle_rad), scale * math.sin(angle_rad)
    matrix = np.array([[c, s], [s, -c]]) if flipped else np.array([[c, -s], [s, c]])
    found = _moved(seen, lambda ground, covariances: (ground @ matrix.T, matrix @ covariances @ matrix.T))
    orientations = (-1.0 if flipped else 1.0) * found.crossings.orientations_rad + angle_rad
    of_x = found.crossings.kinds == CrossingKind.X.value
    orientations = np.where(of_x, orientations % (0.5 * math.pi), wrap_angles(orientations))
    return replace(found, crossings=replace(found.crossings, orientations_rad=orientations))


def _moved(seen: Observation, move: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]) -> Observation:
    """What is seen elsewhere. move: new places (..., 2) and covariances (..., 2, 2) of the old."""
    points, lines, crossings, landmarks = seen.points, seen.lines, seen.crossings, seen.landmarks
    spots, of_spots = move(points.positions_m, points.covariances_m2)
    ends, of_ends = move(lines.ends_m, lines.covariances_m2)
    corners, of_corners = move(crossings.positions_m, crossings.covariances_m2)
    feet, of_feet = move(landmarks.positions_m, landmarks.covariances_m2)
    return replace(
        seen,
        points=replace(points, positions_m=spots, covariances_m2=of_spots),
        lines=replace(lines, ends_m=ends, covariances_m2=of_ends),
        crossings=replace(crossings, positions_m=corners, covariances_m2=of_corners),
        landmarks=replace(landmarks, positions_m=feet, covariances_m2=of_feet),
    )


def _landmarks(field: FieldModel, noise: FeatureNoise) -> list[_Mark]:
    """The field's posts, poles, penalty marks and centre circle."""
    marks = []
    for post in field.posts:
        of_post = noise.poles if post.kind != "goal" else noise.posts
        if post.colors_from_ground == ("white",):
            of_post = noise.white_posts
        goals = [k for k, goal in enumerate(field.goals) if post.kind == "goal" and goal.x == post.x]
        kind = LandmarkKind.POST if post.kind == "goal" else LandmarkKind.POLE
        marks.append(_Mark(kind, (post.x, post.y), post.colors_from_ground, of_post, goals[0] if goals else None))
    apart = field.line_distances(field.discs[:, :2]) > field.line_width
    marks += [_Mark(LandmarkKind.PENALTY_MARK, (x, y), (), noise.marks) for x, y in field.discs[apart, :2].tolist()]
    marks += [_Mark(LandmarkKind.CIRCLE, (x, y), (), noise.circle) for x, y, _ in field.circles[:1].tolist()]
    return marks


def _direction(places: FloatArray) -> FloatArray:
    """(2,) unit vector from the first of places (N, 2) to the last."""
    step = places[-1] - places[0]
    return step / math.hypot(step[0], step[1])


def _arms(crossing: Crossing) -> FloatArray:
    """(2, 2) unit vectors along both lines of a crossing."""
    first = crossing.orientation_rad + (0.25 * math.pi if crossing.kind is CrossingKind.L else 0.0)
    return np.array([[math.cos(first), math.sin(first)], [-math.sin(first), math.cos(first)]])


def _by_size(sizes: FloatArray, half: float, slope: float) -> FloatArray:
    """(N,) share of what is found of these sizes (px): logistic in the logarithm."""
    return logistic(np.log(np.maximum(sizes, 1e-6) / half) / slope)


def _steps_along(segment: FloatArray) -> FloatArray:
    """Places (N, 2) along a straight line, from end to end."""
    x1, y1, x2, y2 = segment.tolist()
    steps = max(2, math.ceil(math.hypot(x2 - x1, y2 - y1) / _STEP_M) + 1)
    return np.linspace((x1, y1), (x2, y2), steps)


# --- what is in view --------------------------------------------------------------------------------------------------


_NUDGE_M = 0.02  # by which a place is moved to see where a direction leads in the image
_PX_PER_M = 300.0  # where the image does not show a place itself: the middle of a circle


class Seen(NamedTuple):
    """Places as they are seen. positions_m: (N, 2) robot frame; covariances_m2: (N, 2, 2); pixels: (N, 2)."""

    positions_m: FloatArray
    covariances_m2: FloatArray
    pixels: FloatArray


class Looking(NamedTuple):
    """From where, and past what. hiding: (K, 4) of `occluders`; black: (B, 2) sectors (rad) that show nothing."""

    pose: Pose
    hiding: FloatArray
    black: FloatArray


class FeatureView:
    """One camera's view of the ground. Places are (N, 2) in the field frame (m) where nothing else is said."""

    def __init__(self, camera: Camera, farthest_m: float, tail: float, view_rad: float = math.pi) -> None:
        """tail: of all errors, as of `FeatureNoise`. view_rad: how far to each side the camera sees."""
        self.camera, self.farthest_m, self.tail, self.view_rad = camera, farthest_m, tail, view_rad

    def shows(self, looking: Looking, places: FloatArray, farthest_m: float = math.inf) -> BoolArray:
        """(N,) whether places are near enough, inside the image, and hidden by nothing."""
        pose = looking.pose
        ground = pose.inverse().transform(places)
        ranges, bearings = np.hypot(ground[:, 0], ground[:, 1]), np.arctan2(ground[:, 1], ground[:, 0])
        seen = (ranges <= min(self.farthest_m, farthest_m)) & (np.abs(bearings) <= self.view_rad)
        seen &= self.camera.sees(self.camera.image_from_ground(ground))
        for start, end in looking.black:
            seen &= np.mod(bearings - start, 2.0 * math.pi) > (end - start) % (2.0 * math.pi)
        for index in np.flatnonzero(seen):
            seen[index] = not hidden(pose.x, pose.y, places[index, 0], places[index, 1], looking.hiding)
        return np.asarray(seen)

    def widths(self, pose: Pose, places: FloatArray, directions: FloatArray, width_m: float) -> FloatArray:
        """(N,) how wide (px) lines of a width (m) that run along directions (N, 2) look at these places."""
        aside = np.column_stack((-directions[:, 1], directions[:, 0]))
        moved = np.concatenate((places, places + _NUDGE_M * directions, places + width_m * aside))
        here, on, beside = np.split(self.camera.image_from_ground(pose.inverse().transform(moved)), 3)
        along, across = on - here, beside - here
        area = np.abs(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0])
        return area / np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-12)

    def outwards(self, ground: FloatArray) -> FloatArray:
        """(N, 2) unit vectors in the image in which the range of ground points (N, 2), robot frame, grows."""
        farther = ground * (1.0 + _NUDGE_M / np.maximum(np.hypot(*ground.T), _NUDGE_M))[:, np.newaxis]
        here, there = np.split(self.camera.image_from_ground(np.concatenate((ground, farther))), 2)
        step = there - here
        return step / np.maximum(np.hypot(*step.T), 1e-12)[:, np.newaxis]

    def perturbed(
        self, ground: FloatArray, directions: FloatArray, sizes_px: FloatArray, rng: np.random.Generator
    ) -> Seen:
        """Ground points (N, 2), robot frame, as they are seen: errors along directions (N, 2) in the image and across.

        sizes_px: (N, 2) of both.
        """
        pixels, jacobians = self._projected(ground)
        axes = np.stack((directions, directions[:, ::-1] * (-1.0, 1.0)), axis=-1) * sizes_px[:, np.newaxis]
        error = np.einsum("nij,nj->ni", axes, self.tailed(rng.standard_normal((len(ground), 2))))
        usable = np.isfinite(jacobians).all(axis=(1, 2), keepdims=True)
        inverse = np.linalg.inv(np.where(usable, jacobians, _PX_PER_M * np.eye(2)))
        spread = inverse @ axes
        covariances: FloatArray = tail_variance(self.tail) * spread @ spread.transpose(0, 2, 1)
        moved = ground + np.einsum("nij,nj->ni", inverse, error)
        return Seen(moved, covariances, pixels + error)

    def _projected(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (N, 2) of ground points (N, 2), robot frame, and their derivatives (N, 2, 2) by these (px per m)."""
        steps = 0.5 * _NUDGE_M * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        points = (ground + steps[:, np.newaxis]).reshape(-1, 2)
        here, ahead, behind, left, right = self.camera.image_from_ground(points).reshape(5, -1, 2)
        return here, np.stack((ahead - behind, left - right), axis=-1) / _NUDGE_M

    def tailed(self, chance: FloatArray) -> FloatArray:
        """Standard normal numbers with heavier tails."""
        return np.sinh(self.tail * chance) / self.tail


def tail_variance(tail: float) -> float:
    """Variance of `FeatureView.tailed`."""
    return math.expm1(2.0 * tail**2) / (2.0 * tail**2)


def logistic(value: FloatArray) -> FloatArray:
    """1 / (1 + exp(-value))."""
    return 0.5 + 0.5 * np.tanh(0.5 * value)
