"""Lines, crossings and posts at the observation level: what a detector of such features would deliver.

No detector of these stands behind the figures yet: each is a pixel's noise, taken to the ground by the camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field

from touchline.camera import OmniCamera
from touchline.config import Settings
from touchline.field import FieldModel
from touchline.field.crossings import CrossingKind
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.simulation.crossings import hidden
from touchline.simulation.observation import occluders

_STEP_M = 0.05


class FeatureNoise(Settings):
    """How well features are seen."""

    noise_px: float = Field(1.0, ge=0, description="standard deviation of a feature's place in the image, u and v")
    orientation_deg: float = Field(3.0, ge=0, description="standard deviation of a crossing's orientation")
    found_share: float = Field(0.85, ge=0, le=1, description="share of the features in view that are found")
    wrong_kind_share: float = Field(0.03, ge=0, le=1, description="share of crossings taken for another kind")
    farthest_m: float = Field(5.5, gt=0, description="range beyond which nothing is found")
    shortest_line_m: float = Field(0.6, gt=0, description="visible length below which a line is not found")
    height_m: float = Field(0.8, gt=0, description="height of the view: how far bodies hide the ground")


@dataclass(frozen=True, eq=False, slots=True)
class SeenCrossing:
    """position_m: (2,), covariance_m2: (2, 2), orientation_rad as of `touchline.field.Crossing`; robot frame."""

    kind: CrossingKind
    position_m: FloatArray
    covariance_m2: FloatArray
    orientation_rad: float


@dataclass(frozen=True, eq=False, slots=True)
class SeenPost:
    """The foot of a goal post or pole. position_m: (2,), covariance_m2: (2, 2), robot frame."""

    kind: str
    position_m: FloatArray
    covariance_m2: FloatArray
    colors_from_ground: tuple[str, ...]


@dataclass(frozen=True, eq=False, slots=True)
class SeenLine:
    """The visible part of a straight line. ends_m: (2, 2), covariances_m2: (2, 2, 2) of each end; robot frame."""

    ends_m: FloatArray
    covariances_m2: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class SeenFeatures:
    """Everything beside line points that was seen in one frame."""

    lines: tuple[SeenLine, ...]
    crossings: tuple[SeenCrossing, ...]
    posts: tuple[SeenPost, ...]


class ObservedFeatures:
    """A virtual detector of features for one camera and one field."""

    def __init__(
        self, camera: OmniCamera, field: FieldModel, noise: FeatureNoise | None = None, view_rad: float = math.pi
    ) -> None:
        """view_rad: how far to each side the camera sees."""
        self.camera, self.field, self.view_rad = camera, field, view_rad
        self.noise = noise or FeatureNoise()

    def observe(
        self,
        pose: Pose,
        rng: np.random.Generator,
        bodies: FloatArray | None = None,
        black_rad: FloatArray | None = None,
    ) -> SeenFeatures:
        """Features seen from a pose; bodies (K, 4) and black_rad (B, 2) as of `ObservedLines.observe`."""
        hiding = occluders(np.zeros((0, 4)) if bodies is None else bodies, self.noise.height_m)
        black = np.zeros((0, 2)) if black_rad is None else black_rad
        crossings = tuple(self._crossings(pose, rng, hiding, black))
        posts = tuple(self._posts(pose, rng, hiding, black))
        return SeenFeatures(tuple(self._lines(pose, rng, hiding, black)), crossings, posts)

    def _crossings(
        self, pose: Pose, rng: np.random.Generator, hiding: FloatArray, black: FloatArray
    ) -> list[SeenCrossing]:
        seen = []
        places = np.array([(c.x, c.y) for c in self.field.crossings]).reshape(-1, 2)
        for index, position, covariance in self._found(pose, places, rng, hiding, black):
            crossing = self.field.crossings[index]
            kind = crossing.kind
            if rng.random() < self.noise.wrong_kind_share:
                kind = [k for k in CrossingKind if k is not kind][int(rng.integers(2))]
            turned = crossing.orientation_rad - pose.heading
            turned += math.radians(self.noise.orientation_deg) * float(rng.standard_normal())
            turned = turned % (0.5 * math.pi) if kind is CrossingKind.X else wrap_angle(turned)
            seen.append(SeenCrossing(kind, position, covariance, turned))
        return seen

    def _posts(self, pose: Pose, rng: np.random.Generator, hiding: FloatArray, black: FloatArray) -> list[SeenPost]:
        posts = self.field.posts
        places = np.array([(p.x, p.y) for p in posts]).reshape(-1, 2)
        found = self._found(pose, places, rng, hiding, black)
        return [SeenPost(posts[i].kind, at, covariance, posts[i].colors_from_ground) for i, at, covariance in found]

    def _lines(self, pose: Pose, rng: np.random.Generator, hiding: FloatArray, black: FloatArray) -> list[SeenLine]:
        """Of each straight line the longest stretch in view."""
        seen = []
        for x1, y1, x2, y2 in self.field.segments:
            steps = max(2, math.ceil(math.hypot(x2 - x1, y2 - y1) / _STEP_M) + 1)
            places = np.linspace((x1, y1), (x2, y2), steps)
            first, last = _longest_run(self._in_view(pose, places, hiding, black))
            ends = places[[first, last - 1]] if last > first else places[:0]
            if len(ends) == 0 or math.hypot(*(ends[1] - ends[0])) < self.noise.shortest_line_m:
                continue
            if rng.random() < self.noise.found_share:
                position, covariance = self._perturbed(pose.inverse().transform(ends), rng)
                seen.append(SeenLine(position, covariance))
        return seen

    def _found(
        self, pose: Pose, places: FloatArray, rng: np.random.Generator, hiding: FloatArray, black: FloatArray
    ) -> list[tuple[int, FloatArray, FloatArray]]:
        """Index, perturbed position and covariance of the places (N, 2), field frame, that are in view and found."""
        seen = self._in_view(pose, places, hiding, black) & (rng.random(len(places)) < self.noise.found_share)
        chosen = np.flatnonzero(seen)
        positions, covariances = self._perturbed(pose.inverse().transform(places[chosen]), rng)
        return [(int(i), positions[k], covariances[k]) for k, i in enumerate(chosen)]

    def _in_view(self, pose: Pose, places: FloatArray, hiding: FloatArray, black: FloatArray) -> np.ndarray:
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

    def _perturbed(self, ground: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Positions (N, 2) and covariances (N, 2, 2) of ground points (N, 2) seen with the noise of a pixel."""
        pixels = self.camera.image_from_ground(ground)
        moved = self.camera.ground_from_image(pixels + self.noise.noise_px * rng.standard_normal(pixels.shape))
        jacobians = self.camera.ground_jacobian(pixels)
        covariances: FloatArray = self.noise.noise_px**2 * jacobians @ jacobians.transpose(0, 2, 1)
        return np.where(np.isfinite(moved), moved, ground), covariances


def _longest_run(flags: np.ndarray) -> tuple[int, int]:
    """First index and end of the longest run of true flags (N,); (0, 0) if there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    if len(edges) == 0:
        return 0, 0
    best = int(np.argmax(edges[1::2] - edges[::2]))
    return int(edges[2 * best]), int(edges[2 * best + 1])
