"""What all cameras with a lens on a body share, whatever the lens does: mount, ground, camera.yaml, correction.

A camera's own file holds its lens: pixel <-> direction in the camera body frame (x along the optical axis, y left, z
up). The first six functions here are methods of all of them.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from touchline.camera.base import Camera, ground_jacobian, ground_of_rays, pixel_covariances
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
from touchline.geometry import BoolArray, FloatArray, Pose3

LENS_KEYS = ("fx", "fy", "cx", "cy")
_KEYS = ("width", "height", *LENS_KEYS, "mount")
_MOUNT_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
_NUMBERS = ("no", "one", "two", "three", "four", "five")
_MAX_DISTORTION = 1e6
_TRIED = 25  # focal lengths, where one is corrected


class LensCamera(Camera, Protocol):
    """A camera with a lens: focal lengths and principal point (px), OpenCV's distortion, its mount."""

    @property
    def fx(self) -> float: ...
    @property
    def fy(self) -> float: ...
    @property
    def cx(self) -> float: ...
    @property
    def cy(self) -> float: ...
    @property
    def distortion(self) -> FloatArray: ...

    def camera_rays(self, pixels: npt.ArrayLike) -> FloatArray:
        """Unit vectors (N, 3) of pixels (N, 2) in the camera body frame; NaN where the lens is not trusted."""

    def image_from_camera(self, points: FloatArray) -> FloatArray:
        """Pixels (N, 2) of points or directions (N, 3) in the camera body frame; NaN where the lens is not trusted."""

    def plane_radius(self, angles_rad: FloatArray) -> FloatArray:
        """What a lens without distortion and with a focal length of 1 makes of angles (N,) to the optical axis."""


Lens = TypeVar("Lens", bound=LensCamera)


def ray(camera: LensCamera, pixels: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
    """Unit vectors (N, 3) of what pixels (N, 2) see, in the base frame, from the camera on."""
    return camera.camera_rays(pixels) @ (base_from_camera or camera.base_from_camera).rotation.T


def ground_from_image(camera: LensCamera, pixels: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
    """Ground points (N, 2) in the base frame (m) of pixels (N, 2) u, v; NaN at and above the horizon."""
    origin = (base_from_camera or camera.base_from_camera).translation_m
    return ground_of_rays(origin, ray(camera, pixels, base_from_camera))


def image_from_ground(camera: LensCamera, points: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
    """Pixels (N, 2) u, v of ground points (N, 2) in the base frame (m); NaN behind the camera and far outside the
    image.
    """
    xy = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return image_from_base(camera, np.column_stack((xy, np.zeros(len(xy)))), base_from_camera)


def image_from_base(camera: LensCamera, points: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
    """Pixels (N, 2) u, v of any points (N, 3) in the base frame (m); NaN as of `image_from_ground`."""
    xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    return camera.image_from_camera((base_from_camera or camera.base_from_camera).inverse().transform(xyz))


def ground_covariances(
    camera: LensCamera,
    pixels: npt.ArrayLike,
    noise_px: float,
    noise_m: float,
    base_from_camera: Pose3 | None = None,
) -> FloatArray:
    """(N, 2, 2) covariances (m²) of ground points: the pixels' noise on the ground, and the ground's own."""
    jacobians = ground_jacobian(lambda uv: ground_from_image(camera, uv, base_from_camera), pixels)
    return pixel_covariances(jacobians, noise_px, noise_m)


def sees(camera: LensCamera, pixels: FloatArray) -> BoolArray:
    """Whether pixels (N, 2) lie in the image; False for NaN."""
    u, v = pixels[:, 0], pixels[:, 1]
    return (u >= -0.5) & (u <= camera.width - 0.5) & (v >= -0.5) & (v <= camera.height - 0.5)


def in_focal_lengths(camera: LensCamera, pixels: npt.ArrayLike) -> FloatArray:
    """Pixels (N, 2) from the principal point, in focal lengths: where the lens shows them on its plane."""
    uv = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    return np.asarray((uv - (camera.cx, camera.cy)) / (camera.fx, camera.fy))


def in_pixels(camera: LensCamera, plane: FloatArray) -> FloatArray:
    """The inverse of `in_focal_lengths`."""
    return np.asarray(plane * (camera.fx, camera.fy) + (camera.cx, camera.cy))


def check_lens(camera: LensCamera, coefficients: str) -> None:
    """Raises InputError for a size or focal length that is not positive and for a camera at or below the ground.

    coefficients: names of those of the distortion, with commas between.
    """
    if not (camera.fx > 0.0 and camera.fy > 0.0):
        raise InputError(f"fx and fy, the focal lengths, must be positive (px), found {camera.fx:g}, {camera.fy:g}")
    if not (0.0 <= camera.cx < camera.width and 0.0 <= camera.cy < camera.height):
        raise InputError(
            f"cx, cy ({camera.cx:g}, {camera.cy:g}) lie outside the image of {camera.width}×{camera.height} pixels"
        )
    count = len(coefficients.split(", "))
    if np.shape(camera.distortion) != (count,):
        raise InputError(f"distortion needs {_NUMBERS[count]} numbers: {coefficients}")
    height_m = float(camera.base_from_camera.translation_m[2])
    if not height_m > 0.0:
        raise InputError(f"mount: z, the camera's height, must be positive (m), found {height_m:g}")


def corner_radius(camera: LensCamera) -> float:
    """How far the image's farthest corner is from the principal point, in focal lengths."""
    corners = [(u, v) for u in (-0.5, camera.width - 0.5) for v in (-0.5, camera.height - 0.5)]
    return float(np.hypot(*in_focal_lengths(camera, corners).T).max())


def corrected(camera: Lens, errors: FloatArray, angles_rad: FloatArray) -> Lens:
    """The camera without errors (4,): roll, pitch (rad) about its own forward and left that it has more than its mount
    says, relative errors of its height and of `plane_radius`. angles_rad (N,): to the optical axis, at which it saw
    something; a lens with distortion widens them by more than its focal length shrinks.
    """
    roll, pitch, height, wide = errors.tolist()
    pose = camera.base_from_camera
    place = pose.translation_m * np.array([1.0, 1.0, 1.0 + height])
    facing = Pose3.from_roll_pitch_yaw(0.0, 0.0, math.atan2(pose.rotation[1, 0], pose.rotation[0, 0])).rotation
    mount = Pose3(facing @ _turn(roll, pitch) @ facing.T @ pose.rotation, place)
    middle, known = np.array([camera.cx, camera.cy]), camera.plane_radius(angles_rad)
    directions = np.column_stack((np.cos(angles_rad), -np.sin(angles_rad), np.zeros(len(angles_rad))))
    offsets = camera.image_from_camera(directions) - middle
    shorter = np.linspace(1.0 - 1.2 * abs(wide), 1.0 + 1.2 * abs(wide), _TRIED)
    wider = []
    for ratio in shorter:
        seen = camera.plane_radius(np.arccos(np.clip(camera.camera_rays(middle + ratio * offsets)[:, 0], -1.0, 1.0)))
        good = np.isfinite(seen)
        wider.append(float(seen[good] @ known[good] / (known[good] @ known[good])))
    ratio = float(np.interp(1.0 + wide, wider, shorter))
    changes: dict[str, Any] = {"fx": camera.fx / ratio, "fy": camera.fy / ratio, "base_from_camera": mount}
    return dataclasses.replace(camera, **changes)  # type: ignore[type-var]


def _turn(roll: float, pitch: float) -> FloatArray:
    """Rx(roll) Ry(pitch), (3, 3)."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    x_turn = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return x_turn @ np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])


def lens_camera(
    kind: Callable[..., Lens],
    tree: Mapping[str, Any],
    path: Path,
    what: str,
    coefficients: int,
    optional: tuple[str, ...] = (),
) -> Lens:
    """A camera from the content of a camera.yaml; `path` is named in errors. coefficients: of the distortion.

    optional: keys that are read elsewhere.
    """
    with naming_lines(path):
        values = _read_lens(tree, path, what, coefficients, optional)
        try:
            return kind(*values)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None


def _read_lens(tree: Mapping[str, Any], path: Path, what: str, coefficients: int, optional: tuple[str, ...]) -> Any:
    """width, height, fx, fy, cx, cy, distortion, mount and use_attitude."""
    check_keys(tree, _KEYS, ("distortion", "use_attitude", *optional), path, what)
    width, height = read_image_size(tree, path)
    numbers = (read_number(tree[key], path, key) for key in LENS_KEYS)
    distortion = read_numbers(tree.get("distortion", [0.0] * coefficients), path, "distortion", 1)
    if not np.all(np.abs(distortion) < _MAX_DISTORTION):
        raise InputError(f"{path}: 'distortion' holds a number beyond ±{_MAX_DISTORTION:g}; no lens has that")
    mount = tree["mount"]
    if not isinstance(mount, dict) or any(key not in mount for key in _MOUNT_KEYS):
        raise InputError(f"{path}: 'mount' needs {', '.join(_MOUNT_KEYS)} (m, rad): the camera's pose in the body")
    check_inner_keys(mount, _MOUNT_KEYS, path, "mount")
    x, y, z, roll, pitch, yaw = (read_number(mount[key], path, f"mount: {key}") for key in _MOUNT_KEYS)
    pose = Pose3.from_roll_pitch_yaw(roll, pitch, yaw, (x, y, z))
    return (width, height, *numbers, distortion, pose, read_switch(tree, "use_attitude", True, path))


def lens_mapping(camera: LensCamera) -> dict[str, Any]:
    """The camera.yaml of a camera with a lens."""
    pose = camera.base_from_camera
    numbers = (*pose.translation_m, *pose.roll_pitch_yaw())
    return {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": [float(value) for value in camera.distortion],
        "mount": {key: round(float(value), 12) for key, value in zip(_MOUNT_KEYS, numbers, strict=True)},
        **({} if camera.use_attitude else {"use_attitude": False}),
    }
