"""The perspective camera: a pinhole with OpenCV's lens distortion (docs/how-to-recording.md).

A ray of the camera body frame (x along the optical axis, y left, z up) meets the plane at unit depth in x, y of
OpenCV's optical frame. The lens moves it there, radially by k1, k2, k3 and tangentially by p1, p2; the focal lengths
and the principal point make a pixel of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from touchline.camera.base import Mask, ground_jacobian, ground_of_rays, pixel_covariances
from touchline.camera.imu_correction import ImuCorrection, correction_from_mapping, correction_mapping
from touchline.camera.reading import (
    check_inner_keys,
    check_keys,
    naming_lines,
    read_image_size,
    read_number,
    read_numbers,
    read_switch,
)
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3

_KEYS = ("width", "height", "fx", "fy", "cx", "cy", "mount")
_OPTIONAL = ("distortion", "use_attitude", "imu_correction")
_MOUNT_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
_MIN_DEPTH_M = 1e-6
_MAX_TANGENT = 12.0  # tangent of the angle to the optical axis: 85°
_NO_DISTORTION, _MAX_DISTORTION = 1e-12, 1e6
_BEYOND_CORNERS = 1.05  # lines are drawn until they have left the image
_NEWTON_STEPS = 20  # 5 do for usual lenses
_CONVERGED = 1e-10


@dataclass(frozen=True, eq=False)
class PinholeCamera:
    """A perspective camera on a body that leans.

    fx, fy, cx, cy: focal lengths and principal point (px). distortion: (5,) OpenCV's k1, k2, p1, p2, k3.
    base_from_camera: its mount, on a body that does not lean. use_attitude: whether the IMU's roll and pitch are used.
    imu_correction: what they do to undistorted pixels, where it has been learned (see `GroundView`).
    largest_radius: how far from the optical axis at unit depth the distortion is trusted: to the image's corners, and
    no farther than where it stops growing.
    Raises InputError for a size or focal length that is not positive and for a camera at or below the ground.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: FloatArray
    base_from_camera: Pose3
    use_attitude: bool = True
    imu_correction: ImuCorrection | None = None
    largest_radius: float = field(init=False)

    def __post_init__(self) -> None:
        if not (self.fx > 0.0 and self.fy > 0.0):
            raise InputError(f"fx and fy, the focal lengths, must be positive (px), found {self.fx:g}, {self.fy:g}")
        if not (0.0 <= self.cx < self.width and 0.0 <= self.cy < self.height):
            raise InputError(
                f"cx, cy ({self.cx:g}, {self.cy:g}) lie outside the image of {self.width}×{self.height} pixels"
            )
        if np.shape(self.distortion) != (5,):
            raise InputError("distortion needs five numbers: k1, k2, p1, p2, k3")
        height_m = float(self.base_from_camera.translation_m[2])
        if not height_m > 0.0:
            raise InputError(f"mount: z, the camera's height, must be positive (m), found {height_m:g}")
        object.__setattr__(self, "largest_radius", self._trusted_radius())

    @property
    def model(self) -> str:
        """`pinhole`."""
        return "pinhole"

    def camera_rays(self, pixels: npt.ArrayLike) -> FloatArray:
        """Unit vectors (N, 3) of pixels (N, 2) in the camera body frame; NaN where the distortion is not trusted."""
        uv = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        seen = (uv - (self.cx, self.cy)) / (self.fx, self.fy)
        plane = self._undistorted(seen)
        rays = np.column_stack((np.ones(len(plane)), -plane))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays

    def undistorted(self, pixels: npt.ArrayLike) -> FloatArray:
        """Where a lens without distortion would show pixels (N, 2); NaN where the distortion is not trusted."""
        uv = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        moved: FloatArray = self._undistorted((uv - (self.cx, self.cy)) / (self.fx, self.fy))
        return moved * (self.fx, self.fy) + (self.cx, self.cy)

    def distorted(self, pixels: npt.ArrayLike) -> FloatArray:
        """The inverse of `undistorted`."""
        uv = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        plane = (uv - (self.cx, self.cy)) / (self.fx, self.fy)
        plane[~(np.hypot(*plane.T) <= self.largest_radius)] = np.nan
        moved: FloatArray = self._distorted(plane) * (self.fx, self.fy) + (self.cx, self.cy)
        return moved

    def ray(self, pixels: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Unit vectors (N, 3) of what pixels (N, 2) see, in the base frame, from the camera on."""
        rays: FloatArray = self.camera_rays(pixels) @ (base_from_camera or self.base_from_camera).rotation.T
        return rays

    def ground_from_image(self, pixels: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Ground points (N, 2) in the base frame (m) of pixels (N, 2) u, v; NaN at and above the horizon."""
        origin = (base_from_camera or self.base_from_camera).translation_m
        return ground_of_rays(origin, self.ray(pixels, base_from_camera))

    def image_from_ground(self, points: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Pixels (N, 2) u, v of ground points (N, 2) in the base frame (m); NaN behind the camera and far outside the
        image.
        """
        xy = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        return self.image_from_base(np.column_stack((xy, np.zeros(len(xy)))), base_from_camera)

    def image_from_base(self, points: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Pixels (N, 2) u, v of any points (N, 3) in the base frame (m); NaN as of `image_from_ground`."""
        xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        seen = (base_from_camera or self.base_from_camera).inverse().transform(xyz)
        depth = np.where(seen[:, 0] > _MIN_DEPTH_M, seen[:, 0], np.nan)
        plane = -seen[:, 1:] / depth[:, np.newaxis]
        plane[~(np.hypot(*plane.T) <= self.largest_radius)] = np.nan
        pixels: FloatArray = self._distorted(plane) * (self.fx, self.fy) + (self.cx, self.cy)
        return pixels

    def ground_covariances(
        self, pixels: npt.ArrayLike, noise_px: float, noise_m: float, base_from_camera: Pose3 | None = None
    ) -> FloatArray:
        """(N, 2, 2) covariances (m²) of ground points: the pixels' noise on the ground, and the ground's own."""
        jacobians = ground_jacobian(lambda uv: self.ground_from_image(uv, base_from_camera), pixels)
        return pixel_covariances(jacobians, noise_px, noise_m)

    def sees(self, pixels: FloatArray) -> Mask:
        """Whether pixels (N, 2) lie in the image; False for NaN."""
        u, v = pixels[:, 0], pixels[:, 1]
        inside: Mask = (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)
        return inside

    def _distorted(self, plane: FloatArray) -> FloatArray:
        """Where the lens puts x, y (N, 2) at unit depth."""
        k1, k2, p1, p2, k3 = self.distortion
        x, y = plane[:, 0], plane[:, 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.column_stack(
            (
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            )
        )

    def _undistorted(self, seen: FloatArray) -> FloatArray:
        """The inverse of `_distorted`, by Newton's method; NaN beyond `largest_radius`."""
        k1, k2, p1, p2, k3 = self.distortion
        plane = seen.copy()
        for _ in range(_NEWTON_STEPS):
            x, y = plane[:, 0], plane[:, 1]
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)  # of the radial factor by r2
            xx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
            xy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
            yy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
            off = self._distorted(plane) - seen
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                step = np.column_stack((yy * off[:, 0] - xy * off[:, 1], xx * off[:, 1] - xy * off[:, 0]))
                step /= (xx * yy - xy * xy)[:, np.newaxis]
            plane = plane - step
            if not np.any(np.abs(step) > _CONVERGED):
                break
        good = (np.abs(self._distorted(plane) - seen) < 1e-6).all(axis=1) & (np.hypot(*plane.T) <= self.largest_radius)
        return np.where(good[:, np.newaxis], plane, np.nan)

    def _trusted_radius(self) -> float:
        k1, k2, _, _, k3 = self.distortion
        # the distorted radius r (1 + k1 r² + k2 r⁴ + k3 r⁶) stops growing at its derivative's first root
        factors = np.array([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
        squares = np.roots(np.where(np.abs(factors) < _NO_DISTORTION, 0.0, factors))
        turns = [float(s.real) for s in squares if abs(s.imag) < 1e-9 and s.real > 0.0]
        radius = np.linspace(0.0, min([_MAX_TANGENT, *np.sqrt(turns)]), 4001)
        distorted = radius * (1.0 + k1 * radius**2 + k2 * radius**4 + k3 * radius**6)
        corners = np.array([(u, v) for u in (-0.5, self.width - 0.5) for v in (-0.5, self.height - 0.5)])
        farthest = np.hypot(*((corners - (self.cx, self.cy)) / (self.fx, self.fy)).T).max()
        return min(float(radius[-1]), _BEYOND_CORNERS * float(np.interp(farthest, distorted, radius)))


def pinhole_from_mapping(tree: Mapping[str, Any], path: Path) -> PinholeCamera:
    """A PinholeCamera from the content of a camera.yaml; `path` is named in errors."""
    with naming_lines(path):
        return _from_mapping(tree, path)


def _from_mapping(tree: Mapping[str, Any], path: Path) -> PinholeCamera:
    check_keys(tree, _KEYS, _OPTIONAL, path, "a pinhole camera")
    width, height = read_image_size(tree, path)
    fx, fy, cx, cy = (read_number(tree[key], path, key) for key in ("fx", "fy", "cx", "cy"))
    distortion = read_numbers(tree.get("distortion", [0.0] * 5), path, "distortion", 1)
    if not np.all(np.abs(distortion) < _MAX_DISTORTION):
        raise InputError(f"{path}: 'distortion' holds a number beyond ±{_MAX_DISTORTION:g}; no lens has that")
    mount = tree["mount"]
    if not isinstance(mount, dict) or any(key not in mount for key in _MOUNT_KEYS):
        raise InputError(f"{path}: 'mount' needs {', '.join(_MOUNT_KEYS)} (m, rad): the camera's pose in the body")
    check_inner_keys(mount, _MOUNT_KEYS, path, "mount")
    x, y, z, roll, pitch, yaw = (read_number(mount[key], path, f"mount: {key}") for key in _MOUNT_KEYS)
    use_attitude = read_switch(tree, "use_attitude", True, path)
    pose = Pose3.from_roll_pitch_yaw(roll, pitch, yaw, (x, y, z))
    learned = tree.get("imu_correction")
    correction = None if learned is None else correction_from_mapping(learned, path)
    try:
        return PinholeCamera(width, height, fx, fy, cx, cy, distortion, pose, use_attitude, correction)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def pinhole_mapping(camera: PinholeCamera) -> dict[str, Any]:
    """The camera.yaml of a pinhole camera."""
    pose, learned = camera.base_from_camera, camera.imu_correction
    numbers = (*pose.translation_m, *pose.roll_pitch_yaw())
    return {
        "model": "pinhole",
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": [float(value) for value in camera.distortion],
        "mount": {key: round(float(value), 12) for key, value in zip(_MOUNT_KEYS, numbers, strict=True)},
        **({} if camera.use_attitude else {"use_attitude": False}),
        **({} if learned is None else {"imu_correction": correction_mapping(learned)}),
    }
