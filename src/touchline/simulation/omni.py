"""A simulated omnidirectional camera: a camera that looks up at a mirror, given by its profile or by its range table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from touchline.camera import OmniCamera
from touchline.camera.omni import omni_from_mapping
from touchline.config import read_yaml_mapping
from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.simulation.camera_base import SimulatedCameraModel
from touchline.simulation.image_sensor import ImageSensor
from touchline.simulation.omni_head import head_layer
from touchline.simulation.rendering import RayGrid


class SimulatedOmniCamera(SimulatedCameraModel):
    """An omnidirectional camera of which only the range table is known (a recording's camera.yaml).

    Rays to the ground are the table's. Above the ground a table says nothing: all rays are taken to come from one point on
    the axis, `height_m` above the ground. The inverse of the ground range runs smoothly through zero at the horizon; beyond
    the table it continues with its last slope. For the recorded head 0.80 m puts the bands of the poles and the tops of the
    goals within half a pixel of where the images show them.
    """

    def __init__(
        self,
        design: OmniCamera,
        height_m: float = 0.80,
        sensor: ImageSensor | None = None,
        side: int = 2,
        blur_steps: int = 5,
        readout_s: float = 0.0,
    ) -> None:
        if not (math.isfinite(height_m) and height_m > 0.0):
            raise InputError(f"omni camera: a height of {height_m} m is not above the ground")
        self.design = design
        self.height_m = height_m
        still = head_layer(design)
        grid = RayGrid(_table_rays(design, height_m), 1.0 / design.outer_radius_px, 0.02, still)
        super().__init__(grid, sensor or ImageSensor(), side, blur_steps, readout_s)

    @classmethod
    def load(cls, path: str | Path, **options: Any) -> SimulatedOmniCamera:
        """From a camera.yaml with `model: omni`. Raises InputError naming file and key."""
        path = Path(path)
        return cls.from_mapping(read_yaml_mapping(path), path, **options)

    @classmethod
    def from_mapping(cls, tree: Mapping[str, Any], path: Path = Path("camera"), **options: Any) -> SimulatedOmniCamera:
        """From the content of a camera.yaml; `path` is named in errors."""
        return cls(omni_from_mapping(dict(tree), path), **options)

    def camera_yaml(self) -> dict[str, Any]:
        """The mapping that a recording's camera.yaml holds."""
        return omni_mapping(self.design)

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Pixels (N, 2) u, v of ground points (N, 2), base frame (m); NaN outside the table."""
        return self.design.image_from_ground(points)


def omni_mapping(design: OmniCamera) -> dict[str, Any]:
    """The camera.yaml of an omnidirectional camera (one table for all directions, or one row for each)."""
    table: dict[str, Any] = {"radius_px": [float(value) for value in design.radius_px]}
    if len(design.bearings_rad) > 1:
        table["bearing_rad"] = [float(value) for value in design.bearings_rad]
        table["range_m"] = [[round(float(value), 5) for value in row] for row in design.range_m]
    else:
        table["range_m"] = [round(float(value), 5) for value in design.range_m[0]]
    return {
        "model": "omni",
        "width": design.width,
        "height": design.height,
        "center": [float(value) for value in design.center],
        "inner_radius_px": float(design.inner_radius_px),
        "outer_radius_px": float(design.outer_radius_px),
        "handedness": design.handedness,
        "mount_yaw": float(design.mount_yaw_rad),
        "range_table": table,
    }


def _table_rays(design: OmniCamera, height_m: float) -> npt.NDArray[np.float32]:
    u, v = np.meshgrid(np.arange(design.width, dtype=np.float64), np.arange(design.height, dtype=np.float64))
    radius = np.hypot(u - design.center[0], v - design.center[1])
    bearing = design.mount_yaw_rad + design.handedness * np.arctan2(v - design.center[1], u - design.center[0])
    ground = design.ground_from_image(np.column_stack((u.ravel(), v.ravel())))
    distance = np.hypot(ground[:, 0], ground[:, 1]).reshape(u.shape)
    last, edge = design.range_m[:, -2:].mean(axis=0), design.radius_px[-2:]
    inverse = 1.0 / last[1] + (1.0 / last[1] - 1.0 / last[0]) * (radius - edge[1]) / (edge[1] - edge[0])
    beyond = radius > edge[1]
    outwards = np.where(beyond, 1.0, distance)
    down = np.where(beyond, -height_m * inverse, -height_m)
    rays = np.stack(
        (
            np.zeros_like(u),
            np.zeros_like(u),
            np.full_like(u, height_m),
            outwards * np.cos(bearing),
            outwards * np.sin(bearing),
            down,
        ),
        axis=-1,
    )
    rays[..., 3:] /= np.linalg.norm(rays[..., 3:], axis=-1, keepdims=True)
    return rays.astype(np.float32)
