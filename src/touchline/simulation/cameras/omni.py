"""A simulated omnidirectional camera: one that looks up at a mirror, given by its profile or by its range table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from touchline.camera import OmniCamera
from touchline.camera.omni import omni_from_mapping
from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.simulation.cameras.base import SimulatedCameraModel, with_glare
from touchline.simulation.cameras.image_sensor import ImageSensor
from touchline.simulation.cameras.mirror import MirrorProfile
from touchline.simulation.cameras.mirror_rays import MirrorMount, design_range_table, ground_of_rays, mirror_rays
from touchline.simulation.rendering.rendering import RayGrid
from touchline.yaml_files import read_yaml_mapping

_RIM_PX = 11.5  # the recorded head's mirror reaches this far beyond its outer radius, then the rim begins
_RODS_RAD = (0.019, 2.107, -2.065)
_SAMPLES = 4


class SimulatedOmniCamera(SimulatedCameraModel):
    """An omnidirectional camera: through a mirror's profile, or from a range table alone (a recording's camera.yaml).

    With a profile (`from_mirror`) each ray is traced through the mirror as mounted; `design` is the camera.yaml of the
    mirror as designed. From a table, rays to the ground are the table's; above the ground it says nothing: all rays are
    taken to come from one point on the axis, height_m above the ground. The inverse of the ground range runs smoothly
    through zero at the horizon and beyond the table goes on with its last slope. For the recorded head 0.80 m puts the
    bands of the poles and the tops of the goals within half a pixel of where the images show them.
    """

    def __init__(
        self,
        design: OmniCamera,
        height_m: float = 0.80,
        sensor: ImageSensor | None = None,
        side: int = 2,
        blur_steps: int = 5,
        readout_s: float = 0.0,
        mirror: tuple[MirrorProfile, MirrorMount] | None = None,
    ) -> None:
        if not (math.isfinite(height_m) and height_m > 0.0):
            raise InputError(f"omni camera: a height of {height_m} m is not above the ground")
        self.design = design
        self.height_m = height_m
        self.mirror = mirror
        rays = self._rays().astype(np.float32)
        slack = 0.01 if mirror is None else 0.01 + float(mirror[0].radius_m[-1])
        origin = np.array([0.0, 0.0, height_m])
        edge = None if mirror is None else mirror[0].head.outer_px
        grid = RayGrid(rays, 1.0 / design.outer_radius_px, origin, slack, with_glare(_head_layer(design, edge), rays))
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

    @classmethod
    def from_mirror(
        cls,
        profile: MirrorProfile,
        mount: MirrorMount | None = None,
        size: tuple[int, int] = (480, 480),
        center: tuple[float, float] = (239.5, 239.5),
        inner_radius_px: float = 52.0,
        handedness: int = -1,
        mount_yaw_rad: float = -0.5 * math.pi,
        **options: Any,
    ) -> SimulatedOmniCamera:
        """Through a solved mirror, tilted and displaced as `mount` says (not at all by default)."""
        radii, ranges = design_range_table(profile)
        if len(radii) < 2 or np.any(np.diff(ranges) <= 0.0):
            raise InputError("omni camera: the mirror's ground range does not grow with the pixel radius")
        design = OmniCamera(
            *size,
            center,
            inner_radius_px,
            float(radii[-1]),
            handedness,
            mount_yaw_rad,
            radii,
            np.zeros(1),
            ranges[None],
        )
        height = profile.head.camera_height_m + profile.head.apex_m
        return cls(design, height, mirror=(profile, mount or MirrorMount()), **options)

    def camera_yaml(self) -> dict[str, Any]:
        """The mapping that a recording's camera.yaml holds: the camera as designed."""
        return omni_mapping(self.design)

    def ground_from_image(self, pixels: npt.ArrayLike) -> FloatArray:
        """Where pixels (N, 2) u, v truly see the ground (N, 2), base frame (m); NaN where they do not."""
        table = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        if self.mirror is None:
            return self.design.ground_from_image(table)
        return ground_of_rays(mirror_rays(*self.mirror, *self._polar(table)))

    def project(self, points: npt.ArrayLike) -> FloatArray:
        """Pixels (N, 2) u, v of ground points (N, 2), base frame (m); NaN where they are not seen.

        Of an ideal head the table's closed form; of a mirror mounted askew Newton's method about it (to 1e-6 px).
        """
        pixels = self.design.image_from_ground(points)
        if self.mirror is None or self.mirror[1].is_ideal:
            return pixels
        wanted = np.asarray(points, dtype=np.float64)
        for _ in range(12):
            error = self.ground_from_image(pixels) - wanted
            steps = [np.array([0.05, 0.0]), np.array([0.0, 0.05])]
            columns = [
                (self.ground_from_image(pixels + step) - self.ground_from_image(pixels - step)) / 0.1 for step in steps
            ]
            jacobian = np.stack(columns, axis=-1)
            seen = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(error).all(axis=1)
            pixels[~seen] = np.nan
            pixels[seen] -= np.linalg.solve(jacobian[seen], error[seen][..., np.newaxis])[..., 0]
        return pixels

    def _polar(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radius (px) and bearing (rad, base frame) of pixels (N, 2)."""
        du, dv = pixels[:, 0] - self.design.center[0], pixels[:, 1] - self.design.center[1]
        return np.hypot(du, dv), self.design.mount_yaw_rad + self.design.handedness * np.arctan2(dv, du)

    def _rays(self) -> FloatArray:
        """Rays (H, W, 6) in the body frame."""
        shape = (self.design.height, self.design.width)
        v, u = np.indices(shape, dtype=np.float64)
        pixels = np.column_stack((u.ravel(), v.ravel()))
        radius, bearing = self._polar(pixels)
        if self.mirror is not None:
            return mirror_rays(*self.mirror, radius, bearing).reshape(*shape, 6)
        return _table_rays(self.design, self.height_m, pixels, radius, bearing).reshape(*shape, 6)


def omni_mapping(design: OmniCamera) -> dict[str, Any]:
    """The camera.yaml of an omnidirectional camera (one table for all directions, or one row for each)."""
    table: dict[str, Any] = {"radius_px": [float(value) for value in design.radius_px]}
    if len(design.bearings_rad) > 1:
        table["bearing_rad"] = [float(value) for value in design.bearings_rad]
        table["range_m"] = [[round(float(value), 5) for value in row] for row in design.range_m]
        if design.bearing_offset_rad is not None:
            table["bearing_offset_rad"] = [
                [round(float(value), 6) for value in row] for row in design.bearing_offset_rad
            ]
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


def _table_rays(
    design: OmniCamera, height_m: float, pixels: FloatArray, radius: FloatArray, bearing: FloatArray
) -> FloatArray:
    last, edge = design.range_m[:, -2:].mean(axis=0), design.radius_px[-2:]
    beyond = radius > edge[1]
    center = np.array(design.center)
    inwards = np.where(beyond, (edge[1] - 1e-9) / np.maximum(radius, 1e-9), 1.0)  # beyond the table: as at its end
    ground = design.ground_from_image(center + (pixels - center) * inwards[:, np.newaxis])
    distance = np.hypot(ground[:, 0], ground[:, 1])
    if design.bearing_offset_rad is not None:
        bearing = np.where(distance > 0.0, np.arctan2(ground[:, 1], ground[:, 0]), bearing)
    inverse = 1.0 / last[1] + (1.0 / last[1] - 1.0 / last[0]) * (radius - edge[1]) / (edge[1] - edge[0])
    outwards = np.where(beyond, 1.0, distance)
    down = np.where(beyond, -height_m * inverse, -height_m)
    rays = np.zeros((len(pixels), 6))
    rays[:, 2] = height_m
    rays[:, 3:] = np.column_stack((outwards * np.cos(bearing), outwards * np.sin(bearing), down))
    rays[:, 3:] /= np.linalg.norm(rays[:, 3:], axis=1, keepdims=True)
    return rays


def _head_layer(design: OmniCamera, edge_px: float | None = None) -> npt.NDArray[np.float32]:
    """Reflectance red, green, blue (premultiplied) and share of the pixel, (H, W, 4), of what turns with the robot.

    An octagonal body a little smaller than the inner radius, three rods half a hundredth of the radius thick on each
    side at the body and twice that at the rim, a dark rim at edge_px and darkness beyond. 4 x 4 samples each pixel.
    """
    edge = design.outer_radius_px + _RIM_PX if edge_px is None else edge_px
    layer = np.zeros((design.height, design.width, 4))
    offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    u, v = np.meshgrid(np.arange(design.width, dtype=np.float64), np.arange(design.height, dtype=np.float64))
    for dv in offsets:
        for du in offsets:
            x, y = u + du - design.center[0], v + dv - design.center[1]
            layer += _head_colours(x, y, design.inner_radius_px, edge)
    return (layer / _SAMPLES**2).astype(np.float32)


def _head_colours(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], inner: float, outer: float
) -> npt.NDArray[np.float64]:
    radius = np.hypot(x, y)
    colours = np.zeros((*x.shape, 4))
    for angle in _RODS_RAD:
        along = x * np.cos(angle) + y * np.sin(angle)
        across = np.abs(y * np.cos(angle) - x * np.sin(angle))
        colours[(along > 0.0) & (across < 0.006 * radius + 0.5 + 0.008 * np.maximum(radius - inner, 0.0))] = (
            0.006,
            0.006,
            0.006,
            1.0,
        )
    unit = inner / 52.0
    side = 41.0 * unit
    body = (np.maximum(np.abs(x), np.abs(y)) < side) & (np.abs(x) + np.abs(y) < side * 1.414)
    colours[body] = (0.046, 0.044, 0.050, 1.0)
    colours[(np.abs(x) < 15.5 * unit) & (np.abs(y + 18.5 * unit) < 6.5 * unit)] = (0.16, 0.15, 0.16, 1.0)
    colours[(np.abs(x + 9.0 * unit) < 13.0 * unit) & (np.abs(y - 25.5 * unit) < 9.5 * unit)] = (0.062, 0.057, 0.09, 1.0)
    colours[np.hypot(x - 27.0 * unit, y) < 8.0 * unit] = (0.03, 0.50, 0.60, 1.0)
    colours[radius > outer] = (0.034, 0.031, 0.030, 1.0)
    colours[radius > outer + 4.0] = (0.0, 0.0, 0.0, 1.0)
    return colours
