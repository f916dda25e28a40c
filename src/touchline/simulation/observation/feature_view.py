"""What of the ground a camera shows at the observation level, and how places on it come out with a detector's noise."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.camera import Camera
from touchline.geometry import FloatArray, Pose
from touchline.simulation.observation.crossings import hidden

_STEP_M = 0.02  # by which a place is moved to see where a direction leads in the image
_PX_PER_M = 300.0  # where the image does not show a place itself: the middle of a circle
Mask = npt.NDArray[np.bool_]


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

    def shows(self, looking: Looking, places: FloatArray, farthest_m: float = math.inf) -> Mask:
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
        moved = np.concatenate((places, places + _STEP_M * directions, places + width_m * aside))
        here, on, beside = np.split(self.camera.image_from_ground(pose.inverse().transform(moved)), 3)
        along, across = on - here, beside - here
        area = np.abs(along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0])
        return area / np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-12)

    def outwards(self, ground: FloatArray) -> FloatArray:
        """(N, 2) unit vectors in the image in which the range of ground points (N, 2), robot frame, grows."""
        farther = ground * (1.0 + _STEP_M / np.maximum(np.hypot(*ground.T), _STEP_M))[:, np.newaxis]
        here, there = np.split(self.camera.image_from_ground(np.concatenate((ground, farther))), 2)
        step = there - here
        directions: FloatArray = step / np.maximum(np.hypot(*step.T), 1e-12)[:, np.newaxis]
        return directions

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
        steps = 0.5 * _STEP_M * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        points = (ground + steps[:, np.newaxis]).reshape(-1, 2)
        here, ahead, behind, left, right = self.camera.image_from_ground(points).reshape(5, -1, 2)
        return here, np.stack((ahead - behind, left - right), axis=-1) / _STEP_M

    def tailed(self, chance: FloatArray) -> FloatArray:
        """Standard normal numbers with heavier tails."""
        values: FloatArray = np.sinh(self.tail * chance) / self.tail
        return values


def tail_variance(tail: float) -> float:
    """Variance of `FeatureView.tailed`."""
    return math.expm1(2.0 * tail**2) / (2.0 * tail**2)


def logistic(value: FloatArray) -> FloatArray:
    """1 / (1 + exp(-value))."""
    share: FloatArray = 0.5 + 0.5 * np.tanh(0.5 * value)
    return share
