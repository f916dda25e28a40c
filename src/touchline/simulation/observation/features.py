"""Lines, crossings and posts at the observation level: what a detector of such features would deliver.

No detector of these exists yet. How well crossings can be placed was measured: `benchmarks/fit_features.py` lays
straight lines through the line points that `LinePointDetector` finds around them in rendered images, and crosses these.
Posts and the ends of lines are given the same noise; what is set and not measured says so.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from touchline.camera import OmniCamera
from touchline.config import Settings
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, wrap_angle, wrap_angles
from touchline.simulation.observation.crossings import hidden
from touchline.simulation.observation.observed_lines import occluders
from touchline.types import CrossingKind, Crossings, LandmarkKind, Landmarks, Lines, Observation

Table = FloatArray | None
_STEP_M = 0.05
_LANDMARKS = {"goal": LandmarkKind.POST.value, "pole": LandmarkKind.POLE.value}  # by the kinds of the field's posts


class FeatureNoise(Settings):
    """How well features are seen."""

    outwards_px: float = Field(
        0.137,
        ge=0,
        description="size of a feature's error in the image (pixels), outwards; measured of crossings",
    )
    across_px: float = Field(0.283, ge=0, description="the same at right angles to that; measured of crossings")
    tail: float = Field(
        1.4, gt=0, description="how much heavier than normal the errors' tails are: k of sinh(k z) / k; measured"
    )
    orientation_deg: float = Field(0.56, ge=0, description="size of the error of a crossing's orientation; measured")
    found_ratio: float = Field(0.59, ge=0, le=1, description="share of the crossings near by that are found; measured")
    found_half_m: float = Field(5.5, gt=0, description="range at which half of these are found; measured")
    found_slope_m: float = Field(0.37, gt=0, description="how fast that changes with the range (logistic); measured")
    line_ratio: float = Field(0.95, ge=0, le=1, description="share of the lines in view that are found; set")
    post_ratio: float = Field(0.85, ge=0, le=1, description="share of the posts in view that are found; set")
    wrong_kind_ratio: float = Field(0.03, ge=0, le=1, description="share of crossings taken for another kind; set")
    lean_deg: float = Field(
        0.0, ge=0, description="error of roll and of pitch that all features of an image share; measured on the IMU"
    )
    farthest_m: float = Field(6.5, gt=0, description="range beyond which nothing is found; measured")
    shortest_line_m: float = Field(0.6, gt=0, description="visible length below which a line is not found")
    height_m: float = Field(0.8, gt=0, description="height of the view: how far bodies hide the ground")


class _Seen(NamedTuple):
    """Places as they are seen. positions_m: (N, 2) robot frame; covariances_m2: (N, 2, 2); pixels: (N, 2)."""

    positions_m: FloatArray
    covariances_m2: FloatArray
    pixels: FloatArray


class ObservedFeatures:
    """A virtual detector of features for one camera and one field."""

    def __init__(
        self, camera: OmniCamera, field: FieldModel, noise: FeatureNoise | None = None, view_rad: float = math.pi
    ) -> None:
        """view_rad: how far to each side the camera sees."""
        self.camera, self.field, self.view_rad = camera, field, view_rad
        self.noise = noise or FeatureNoise()
        self._along = [_steps_along(segment) for segment in field.segments]  # of each straight line

    def observe(
        self, pose: Pose, rng: np.random.Generator, bodies: Table = None, black_rad: Table = None, stamp_ns: int = 0
    ) -> Observation:
        """Lines, crossings, posts and poles seen from a pose; bodies (K, 4), black_rad (B, 2) as of `ObservedLines`."""
        hiding = occluders(np.zeros((0, 4)) if bodies is None else bodies, self.noise.height_m)
        black = np.zeros((0, 2)) if black_rad is None else black_rad
        crossings, landmarks = self._crossings(pose, rng, hiding, black), self._posts(pose, rng, hiding, black)
        lines = self._lines(pose, rng, hiding, black)
        seen = Observation(stamp_ns, lines=lines, crossings=crossings, landmarks=landmarks)
        if self.noise.lean_deg == 0.0:
            return seen
        roll, pitch = math.radians(self.noise.lean_deg) * rng.standard_normal(2)
        return leaning(seen, float(roll), float(pitch), self.noise.height_m, self.noise.lean_deg)

    def _crossings(self, pose: Pose, rng: np.random.Generator, hiding: FloatArray, black: FloatArray) -> Crossings:
        kinds, orientations = [], []
        places = np.array([(c.x, c.y) for c in self.field.crossings]).reshape(-1, 2)
        noise = self.noise
        away = np.hypot(*(places - (pose.x, pose.y)).T)
        shares = noise.found_ratio / (1.0 + np.exp((away - noise.found_half_m) / noise.found_slope_m))
        chosen, seen = self._found(pose, places, shares, rng, hiding, black)
        for index in chosen:
            crossing = self.field.crossings[index]
            kind = crossing.kind
            if rng.random() < noise.wrong_kind_ratio:
                kind = [k for k in CrossingKind if k is not kind][int(rng.integers(2))]
            turned = crossing.orientation_rad - pose.heading
            turned += math.radians(noise.orientation_deg) * float(self._tailed(rng.standard_normal()))
            kinds.append(kind.value)
            orientations.append(turned % (0.5 * math.pi) if kind is CrossingKind.X else wrap_angle(turned))
        return Crossings(
            np.array(kinds, dtype="U1"),
            seen.positions_m,
            np.array(orientations, dtype=np.float64),
            seen.covariances_m2,
            np.ones(len(chosen)),
            seen.pixels,
        )

    def _posts(self, pose: Pose, rng: np.random.Generator, hiding: FloatArray, black: FloatArray) -> Landmarks:
        posts = self.field.posts
        places = np.array([(p.x, p.y) for p in posts]).reshape(-1, 2)
        chosen, seen = self._found(pose, places, self.noise.post_ratio, rng, hiding, black)
        return Landmarks(
            np.array([_LANDMARKS[posts[i].kind] for i in chosen], dtype="U4"),
            seen.positions_m,
            seen.covariances_m2,
            np.ones(len(chosen)),
            tuple(posts[i].colors_from_ground for i in chosen),
            seen.pixels,
        )

    def _lines(self, pose: Pose, rng: np.random.Generator, hiding: FloatArray, black: FloatArray) -> Lines:
        """Of each straight line the longest stretch in view."""
        seen = []
        in_view = self.in_view(pose, np.concatenate([np.zeros((0, 2)), *self._along]), hiding, black)
        parts = np.split(in_view, np.cumsum([len(places) for places in self._along]))
        for places, visible in zip(self._along, parts, strict=False):
            first, last = _longest_run(visible)
            ends = places[[first, last - 1]] if last > first else places[:0]
            if len(ends) == 0 or math.hypot(*(ends[1] - ends[0])) < self.noise.shortest_line_m:
                continue
            if rng.random() < self.noise.line_ratio:
                seen.append(self._perturbed(pose.inverse().transform(ends), rng))
        return Lines(
            np.array([line.positions_m for line in seen]).reshape(-1, 2, 2),
            np.array([line.covariances_m2 for line in seen]).reshape(-1, 2, 2, 2),
            np.ones(len(seen)),
            np.array([line.pixels for line in seen]).reshape(-1, 2, 2),
        )

    def _found(
        self,
        pose: Pose,
        places: FloatArray,
        shares: FloatArray | float,
        rng: np.random.Generator,
        hiding: FloatArray,
        black: FloatArray,
    ) -> tuple[list[int], _Seen]:
        """Indices of the places (N, 2), field frame, that are in view and found, and how they are seen.

        shares: how many of them are found, (N,) or all alike.
        """
        seen = self.in_view(pose, places, hiding, black) & (rng.random(len(places)) < shares)
        chosen = np.flatnonzero(seen)
        return chosen.tolist(), self._perturbed(pose.inverse().transform(places[chosen]), rng)

    def in_view(self, pose: Pose, places: FloatArray, hiding: FloatArray, black: FloatArray) -> np.ndarray:
        """(N,) whether places (N, 2), field frame, are near enough, inside the view, and hidden by nothing."""
        ground = pose.inverse().transform(places)
        ranges, bearings = np.hypot(ground[:, 0], ground[:, 1]), np.arctan2(ground[:, 1], ground[:, 0])
        pixels = self.camera.image_from_ground(ground)
        radius = np.hypot(*(pixels - np.array(self.camera.center)).T)
        seen = (ranges <= self.noise.farthest_m) & (np.abs(bearings) <= self.view_rad)
        seen &= (radius >= self.camera.inner_radius_px) & (radius <= self.camera.outer_radius_px)
        for start, end in black:
            seen &= np.mod(bearings - start, 2.0 * math.pi) > (end - start) % (2.0 * math.pi)
        for index in np.flatnonzero(seen):
            seen[index] = not hidden(pose.x, pose.y, places[index, 0], places[index, 1], hiding)
        return np.asarray(seen)

    def _perturbed(self, ground: FloatArray, rng: np.random.Generator) -> _Seen:
        """Ground points (N, 2) as they are seen with the noise of a pixel."""
        n = self.noise
        pixels = self.camera.image_from_ground(ground)
        out = pixels - np.array(self.camera.center)
        out /= np.maximum(np.hypot(out[:, 0], out[:, 1]), 1e-9)[:, np.newaxis]
        axes = np.stack((n.outwards_px * out, n.across_px * out[:, ::-1] * (-1.0, 1.0)), axis=-1)
        chance = self._tailed(rng.standard_normal((len(ground), 2)))
        seen = pixels + np.einsum("nij,nj->ni", axes, chance)
        moved = self.camera.ground_from_image(seen)
        variance = math.expm1(2.0 * n.tail**2) / (2.0 * n.tail**2)
        spread = self.camera.ground_jacobian(pixels) @ axes
        covariances: FloatArray = variance * spread @ spread.transpose(0, 2, 1)
        return _Seen(np.where(np.isfinite(moved), moved, ground), covariances, seen)

    def _tailed(self, chance: Any) -> Any:
        """Standard normal numbers with heavier tails."""
        return np.sinh(self.noise.tail * chance) / self.noise.tail


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

    lines, crossings, landmarks = seen.lines, seen.crossings, seen.landmarks
    ends, end_covariances = moved(lines.ends_m, lines.covariances_m2)
    corners, corner_covariances = moved(crossings.positions_m, crossings.covariances_m2)
    feet, foot_covariances = moved(landmarks.positions_m, landmarks.covariances_m2)
    return replace(
        seen,
        lines=replace(lines, ends_m=ends, covariances_m2=end_covariances),
        crossings=replace(crossings, positions_m=corners, covariances_m2=corner_covariances),
        landmarks=replace(landmarks, positions_m=feet, covariances_m2=foot_covariances),
    )


def turned(seen: Observation, angle_rad: float) -> Observation:
    """Lines, crossings and landmarks in a frame in which what saw them stands turned by an angle to the left."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    matrix = np.array([[c, -s], [s, c]])
    lines, crossings, landmarks = seen.lines, seen.crossings, seen.landmarks

    def spread(covariances: FloatArray) -> FloatArray:
        rotated: FloatArray = matrix @ covariances @ matrix.T
        return rotated

    x_lines, orientations = crossings.kinds == CrossingKind.X.value, crossings.orientations_rad + angle_rad
    orientations = np.where(x_lines, orientations % (0.5 * math.pi), wrap_angles(orientations))
    return replace(
        seen,
        lines=replace(lines, ends_m=lines.ends_m @ matrix.T, covariances_m2=spread(lines.covariances_m2)),
        crossings=replace(
            crossings,
            positions_m=crossings.positions_m @ matrix.T,
            orientations_rad=orientations,
            covariances_m2=spread(crossings.covariances_m2),
        ),
        landmarks=replace(
            landmarks,
            positions_m=landmarks.positions_m @ matrix.T,
            covariances_m2=spread(landmarks.covariances_m2),
        ),
    )


def _steps_along(segment: FloatArray) -> FloatArray:
    """Places (N, 2) along a straight line, from end to end."""
    x1, y1, x2, y2 = segment.tolist()
    steps = max(2, math.ceil(math.hypot(x2 - x1, y2 - y1) / _STEP_M) + 1)
    return np.linspace((x1, y1), (x2, y2), steps)


def _longest_run(flags: np.ndarray) -> tuple[int, int]:
    """First index and end of the longest run of true flags (N,); (0, 0) if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    if len(edges) == 0:
        return 0, 0
    best = int(np.argmax(edges[1::2] - edges[::2]))
    return int(edges[2 * best]), int(edges[2 * best + 1])
