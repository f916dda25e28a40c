"""A simulated omnidirectional camera: one that looks up at a mirror, given by its profile or by its range table."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from touchline.camera import OmniCamera
from touchline.errors import InputError
from touchline.geometry import Float32Array, FloatArray
from touchline_lab.simulation.cameras.base import SimulatedCameraModel, with_glare
from touchline_lab.simulation.cameras.mirror import MirrorProfile
from touchline_lab.simulation.cameras.mirror_rays import MirrorMount, design_range_table, ground_of_rays, mirror_rays
from touchline_lab.simulation.rendering.rendering import RayGrid

_RIM_PX = 11.5  # the recorded head's mirror reaches this far beyond its outer radius, then the rim begins
_RODS_RAD = (0.019, 2.107, -2.065)
_SAMPLES = 4
_SETTLED_PX = 1e-7
_SWING_RAD = 0.002  # between the leans that a swinging mirror's effect is worked out from, a tenth of a degree
_NODE_PX = 8  # between the pixels that it is worked out for


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
        mirror: tuple[MirrorProfile, MirrorMount] | None = None,
        **options: Any,
    ) -> None:
        """options: of `SimulatedCameraModel`."""
        if not (math.isfinite(height_m) and height_m > 0.0):
            raise InputError(f"omni camera: a height of {height_m} m is not above the ground")
        self.design = design
        self.height_m = height_m
        self.mirror = mirror
        super().__init__(self._ray_grid, **options)

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
    ) -> Self:
        """Through a solved mirror, tilted and displaced as `mount` says (not at all by default)."""
        radii, ranges = design_range_table(profile)
        if len(radii) < 2 or np.any(np.diff(ranges) <= 0.0):
            raise InputError("omni camera: the mirror's ground range does not grow with the pixel radius")
        image = (*size, center, inner_radius_px, float(radii[-1]))
        design = OmniCamera(*image, handedness, mount_yaw_rad, radii, np.zeros(1), ranges[None])
        height = profile.head.camera_height_m + profile.head.apex_m
        return cls(design, height, mirror=(profile, mount or MirrorMount()), **options)

    def ground_from_image(self, pixels: npt.ArrayLike) -> FloatArray:
        """Where pixels (N, 2) u, v truly see the ground (N, 2), base frame (m); NaN where they do not."""
        table = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        if self.mirror is None:
            return self.design.ground_from_image(table)
        return ground_of_rays(mirror_rays(*self.mirror, *self._polar(table)))

    def project(self, points: npt.ArrayLike, attitude: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """Pixels (N, 2) u, v of ground points (N, 2), base frame (m); NaN where they are not seen.

        attitude: of the body, which is taken for upright here. Of an ideal head the table's closed form; of a mirror
        mounted askew Newton's method from there on (to 1e-6 px).
        """
        pixels = self.design.image_from_ground(points)
        if self.mirror is None or self.mirror[1].is_ideal:
            return pixels
        wanted = np.asarray(points, dtype=np.float64)
        jacobian = self._jacobian(pixels)
        for k in range(16):
            error = self.ground_from_image(pixels) - wanted
            if k in (1, 8):  # else it hardly changes
                jacobian = self._jacobian(pixels)
            step = _solved(jacobian, error)
            pixels = pixels - step
            if not np.nanmax(np.abs(step), initial=0.0) > _SETTLED_PX:
                break
        return pixels

    def shift_by_swing(self, pixels: FloatArray) -> FloatArray:
        """(N, 2, 2) by how many pixels what is seen at pixels (N, 2) moves for each radian that the mirror leans more
        about x (first column) and about y. NaN where no ground is seen; zeros without a mirror.
        """
        if self.mirror is None:
            return np.zeros((len(pixels), 2, 2))
        jacobian, polar = self._jacobian(pixels), self._polar(pixels)
        columns = [-_solved(jacobian, ground_of_rays(ahead) - ground_of_rays(behind)) / (2.0 * _SWING_RAD)
                   for ahead, behind in self._swung(*polar)]  # fmt: skip
        return np.stack(columns, axis=-1)

    def bent_rays(self, swing_rad: tuple[float, float]) -> Float32Array | None:
        """(H, W, 6) by how much the rays differ where the mirror swings by so much about x and y; None: not at all."""
        if self.mirror is None or not any(swing_rad):
            return None
        return np.float32(swing_rad[0]) * self._rays_by_swing[0] + np.float32(swing_rad[1]) * self._rays_by_swing[1]

    @cached_property
    def _rays_by_swing(self) -> tuple[Float32Array, Float32Array]:
        """(H, W, 6) by how much each ray turns for each radian that the mirror leans more about x, and about y.

        Worked out on every _NODE_PX-th pixel, bilinear in between; nothing where a ray passes the mirror.
        """
        v, u = np.mgrid[0 : self.design.height + _NODE_PX : _NODE_PX, 0 : self.design.width + _NODE_PX : _NODE_PX]
        nodes = np.column_stack((u.ravel(), v.ravel())).astype(np.float64)
        size = (u.shape[1] * _NODE_PX, u.shape[0] * _NODE_PX)
        grids = []
        for ahead, behind in self._swung(*self._polar(nodes)):
            turned = np.nan_to_num((ahead - behind) / (2.0 * _SWING_RAD)).astype(np.float32).reshape(*u.shape, 6)
            to_nodes = np.array([[_NODE_PX, 0, 0], [0, _NODE_PX, 0]], dtype=np.float32)
            planes = [np.asarray(cv2.warpAffine(turned[..., k], to_nodes, size), dtype=np.float32) for k in range(6)]
            grids.append(np.stack(planes, axis=-1)[: self.design.height, : self.design.width])
        return grids[0], grids[1]

    def _swung(self, radius: FloatArray, bearing: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Rays (N, 6) with the mirror leaning a little more, and a little less, about x; then about y."""
        assert self.mirror is not None
        profile, mount = self.mirror
        for name in ("tilt_x", "tilt_y"):
            lean = float(getattr(mount, name))
            more, less = (replace(mount, **{name: lean + sign * _SWING_RAD}) for sign in (1.0, -1.0))
            yield mirror_rays(profile, more, radius, bearing), mirror_rays(profile, less, radius, bearing)

    def _jacobian(self, pixels: FloatArray) -> FloatArray:
        """(N, 2, 2) derivative of the ground point (m) by the pixel; NaN where no ground is seen."""
        seen = self.ground_from_image
        columns = [(seen(pixels + step) - seen(pixels - step)) / 0.1 for step in 0.05 * np.eye(2)]
        return np.stack(columns, axis=-1)

    def _ray_grid(self) -> RayGrid:
        rays = self._rays().astype(np.float32)
        slack = 0.01 if self.mirror is None else 0.01 + float(self.mirror[0].radius_m[-1])
        origin = np.array([0.0, 0.0, self.height_m])
        edge = None if self.mirror is None else self.mirror[0].head.outer_px
        d = self.design
        still = _head_layer((d.width, d.height), d.center, d.inner_radius_px, edge or d.outer_radius_px + _RIM_PX)
        return RayGrid(rays, 1.0 / d.outer_radius_px, origin, slack, with_glare(still.copy(), rays))

    def _polar(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Radius (px) and bearing (rad, base frame) of pixels (N, 2)."""
        du, dv = pixels[:, 0] - self.design.center[0], pixels[:, 1] - self.design.center[1]
        return np.hypot(du, dv), self.design.mount_yaw_rad + self.design.handedness * np.arctan2(dv, du)

    def _rays(self) -> FloatArray:
        """Rays (H, W, 6) in the body frame."""
        d, shape = self.design, (self.design.height, self.design.width)
        if self.mirror is not None:
            return _mirror_grid(*self.mirror, shape, (*d.center, float(d.handedness), d.mount_yaw_rad))
        v, u = np.indices(shape, dtype=np.float64)
        pixels = np.column_stack((u.ravel(), v.ravel()))
        return _table_rays(d, self.height_m, pixels, *self._polar(pixels)).reshape(*shape, 6)


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
    sure = design.stated_uncertainty
    return {
        "model": "omni",
        "width": design.width,
        "height": design.height,
        "center": [float(value) for value in design.center],
        "inner_radius_px": float(design.inner_radius_px),
        "outer_radius_px": float(design.outer_radius_px),
        "handedness": design.handedness,
        "mount_yaw": float(design.mount_yaw_rad),
        **({} if sure is None else {"uncertainty": sure.mapping()}),
        "range_table": table,
    }


def _solved(jacobian: FloatArray, error: FloatArray) -> FloatArray:
    """Steps (N, 2) that make good errors (N, 2), by Jacobians (N, 2, 2); NaN where either is."""
    steps = np.full(error.shape, np.nan)
    seen = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(error).all(axis=1)
    steps[seen] = np.linalg.solve(jacobian[seen], error[seen][..., np.newaxis])[..., 0]
    return steps


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


@lru_cache(maxsize=2)
def _mirror_grid(
    profile: MirrorProfile, mount: MirrorMount, shape: tuple[int, int], axes: tuple[float, float, float, float]
) -> FloatArray:
    """Rays (H, W, 6) through a mirror as mounted; axes: centre u, v, handedness, mount_yaw (rad). Not to be changed."""
    v, u = np.indices(shape, dtype=np.float64)
    du, dv = u.ravel() - axes[0], v.ravel() - axes[1]
    return mirror_rays(profile, mount, np.hypot(du, dv), axes[3] + axes[2] * np.arctan2(dv, du)).reshape(*shape, 6)


@lru_cache(maxsize=4)
def _head_layer(size: tuple[int, int], center: tuple[float, float], inner_px: float, edge_px: float) -> Float32Array:
    """Reflectance red, green, blue (premultiplied) and share of the pixel, (H, W, 4), of what turns with the robot.

    An octagonal body a little smaller than the inner radius, three rods half a hundredth of the radius thick on each
    side at the body and twice that at the rim, a dark rim at edge_px and darkness beyond. 4 x 4 samples each pixel.
    """
    width, height = size
    layer = np.zeros((height, width, 4))
    offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    for dv in offsets:
        for du in offsets:
            x, y = u + du - center[0], v + dv - center[1]
            layer += _head_colours(x, y, inner_px, edge_px)
    return (layer / _SAMPLES**2).astype(np.float32)


def _head_colours(x: FloatArray, y: FloatArray, inner: float, outer: float) -> FloatArray:
    radius = np.hypot(x, y)
    colours = np.zeros((*x.shape, 4))
    for angle in _RODS_RAD:
        along = x * np.cos(angle) + y * np.sin(angle)
        across = np.abs(y * np.cos(angle) - x * np.sin(angle))
        half = 0.006 * radius + 0.5 + 0.008 * np.maximum(radius - inner, 0.0)
        colours[(along > 0.0) & (across < half)] = (0.006, 0.006, 0.006, 1.0)
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
