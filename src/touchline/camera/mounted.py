"""What all cameras with a lens on a body share, whatever the lens does: mount, ground, camera.yaml, correction.

A camera's own file holds its lens: pixel <-> direction in the camera body frame (x along the optical axis, y left, z
up).
"""

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from touchline.camera.base import ground_jacobian, ground_of_rays, pixel_covariances
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

Lens = TypeVar("Lens", bound="PerspectiveCamera")


@dataclass(frozen=True, eq=False)
class PerspectiveCamera(ABC):
    """A camera with a lens and an optical axis, on a body that leans.

    fx, fy, cx, cy: focal lengths and principal point (px). distortion (K,): of the lens. base_from_camera: its mount,
    on a body that does not lean. use_attitude: whether the IMU's roll and pitch are used.
    Raises InputError for a size or focal length that is not positive and for a camera at or below the ground.

    A class of its own for each lens states: model, as camera.yaml has it; coefficients, names of those of its
    distortion; scales_angles, whether a focal length scales the angle to the axis, as that of a fisheye does, or the
    angle's tangent; own_keys of camera.yaml; ros_model, its distortion model in sensor_msgs/CameraInfo, "" for none.
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
    model: ClassVar[str]
    coefficients: ClassVar[tuple[str, ...]]
    scales_angles: ClassVar[bool]
    own_keys: ClassVar[tuple[str, ...]] = ()
    ros_model: ClassVar[str] = ""

    def __post_init__(self) -> None:
        if not (self.fx > 0.0 and self.fy > 0.0):
            raise InputError(f"fx and fy, the focal lengths, must be positive (px), found {self.fx:g}, {self.fy:g}")
        if not (0.0 <= self.cx < self.width and 0.0 <= self.cy < self.height):
            raise InputError(
                f"cx, cy ({self.cx:g}, {self.cy:g}) lie outside the image of {self.width}×{self.height} pixels"
            )
        count = len(self.coefficients)
        if np.shape(self.distortion) != (count,):
            raise InputError(f"distortion needs {_NUMBERS[count]} numbers: {', '.join(self.coefficients)}")
        height_m = float(self.base_from_camera.translation_m[2])
        if not height_m > 0.0:
            raise InputError(f"mount: z, the camera's height, must be positive (m), found {height_m:g}")

    @abstractmethod
    def camera_rays(self, pixels: npt.ArrayLike) -> FloatArray:
        """Unit vectors (N, 3) of pixels (N, 2) in the camera body frame; NaN where the lens is not trusted."""

    @abstractmethod
    def image_from_camera(self, points: FloatArray) -> FloatArray:
        """Pixels (N, 2) of points or directions (N, 3) in the camera body frame; NaN where the lens is not trusted."""

    def ray(self, pixels: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Unit vectors (N, 3) of what pixels (N, 2) see, in the base frame, from the camera on."""
        return self.camera_rays(pixels) @ (base_from_camera or self.base_from_camera).rotation.T

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
        return self.image_from_camera((base_from_camera or self.base_from_camera).inverse().transform(xyz))

    def ground_covariances(
        self, pixels: npt.ArrayLike, noise_px: float, noise_m: float, base_from_camera: Pose3 | None = None
    ) -> FloatArray:
        """(N, 2, 2) covariances (m²) of ground points: the pixels' noise on the ground, and the ground's own."""
        jacobians = ground_jacobian(lambda uv: self.ground_from_image(uv, base_from_camera), pixels)
        return pixel_covariances(jacobians, noise_px, noise_m)

    def sees(self, pixels: FloatArray) -> BoolArray:
        """Whether pixels (N, 2) lie in the image; False for NaN."""
        u, v = pixels[:, 0], pixels[:, 1]
        return (u >= -0.5) & (u <= self.width - 0.5) & (v >= -0.5) & (v <= self.height - 0.5)

    def in_focal_lengths(self, pixels: npt.ArrayLike) -> FloatArray:
        """Pixels (N, 2) from the principal point, in focal lengths: where the lens shows them on its plane."""
        uv = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        return np.asarray((uv - (self.cx, self.cy)) / (self.fx, self.fy))

    def in_pixels(self, plane: FloatArray) -> FloatArray:
        """The inverse of `in_focal_lengths`."""
        return np.asarray(plane * (self.fx, self.fy) + (self.cx, self.cy))

    def corner_radius(self) -> float:
        """How far the image's farthest corner is from the principal point, in focal lengths."""
        corners = [(u, v) for u in (-0.5, self.width - 0.5) for v in (-0.5, self.height - 0.5)]
        return float(np.hypot(*self.in_focal_lengths(corners).T).max())

    def corrected(self: Lens, errors: FloatArray, angles_rad: FloatArray) -> Lens:
        """The camera without errors (4,): roll, pitch (rad) about its own forward and left that it has more than its
        mount says, relative errors of its height and of the angles to the axis (or of their tangents: `scales_angles`).
        angles_rad (N,): at which it saw something; a lens with distortion widens them by more than its focal length
        shrinks.
        """
        roll, pitch, height, wide = errors.tolist()
        pose = self.base_from_camera
        place = pose.translation_m * np.array([1.0, 1.0, 1.0 + height])
        facing = Pose3.from_roll_pitch_yaw(0.0, 0.0, math.atan2(pose.rotation[1, 0], pose.rotation[0, 0])).rotation
        mount = Pose3(facing @ _turn(roll, pitch) @ facing.T @ pose.rotation, place)
        middle, known = np.array([self.cx, self.cy]), self._scaled(angles_rad)
        directions = np.column_stack((np.cos(angles_rad), -np.sin(angles_rad), np.zeros(len(angles_rad))))
        offsets = self.image_from_camera(directions) - middle
        shorter = np.linspace(1.0 - 1.2 * abs(wide), 1.0 + 1.2 * abs(wide), _TRIED)
        wider = []
        for ratio in shorter:
            seen = self._scaled(np.arccos(np.clip(self.camera_rays(middle + ratio * offsets)[:, 0], -1.0, 1.0)))
            good = np.isfinite(seen)
            wider.append(float(seen[good] @ known[good] / (known[good] @ known[good])))
        ratio = float(np.interp(1.0 + wide, wider, shorter))
        return dataclasses.replace(self, fx=self.fx / ratio, fy=self.fy / ratio, base_from_camera=mount)

    @classmethod
    def from_mapping(cls: type[Lens], tree: Mapping[str, Any], path: Path) -> Lens:
        """A camera from the content of a camera.yaml; `path` is named in errors."""
        with naming_lines(path):
            values = _read_lens(tree, path, cls)
            try:
                return cls(*values)
            except InputError as error:
                raise InputError(f"{path}: {error}") from None

    def mapping(self) -> dict[str, Any]:
        """Its camera.yaml."""
        pose = self.base_from_camera
        numbers = (*pose.translation_m, *pose.roll_pitch_yaw())
        return {
            "model": self.model,
            "width": self.width,
            "height": self.height,
            "fx": self.fx,
            "fy": self.fy,
            "cx": self.cx,
            "cy": self.cy,
            **({"distortion": [float(value) for value in self.distortion]} if self.coefficients else {}),
            "mount": {key: round(float(value), 12) for key, value in zip(_MOUNT_KEYS, numbers, strict=True)},
            **({} if self.use_attitude else {"use_attitude": False}),
        }

    def _scaled(self, angles_rad: FloatArray) -> FloatArray:
        """What a focal length scales of angles (N,) to the optical axis."""
        return angles_rad if self.scales_angles else np.tan(angles_rad)


def _turn(roll: float, pitch: float) -> FloatArray:
    """Rx(roll) Ry(pitch), (3, 3)."""
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    x_turn = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return x_turn @ np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])


def _read_lens(tree: Mapping[str, Any], path: Path, kind: type[PerspectiveCamera]) -> Any:
    """width, height, fx, fy, cx, cy, distortion, mount and use_attitude."""
    check_keys(tree, _KEYS, ("distortion", "use_attitude", *kind.own_keys), path, f"a {kind.model} camera")
    width, height = read_image_size(tree, path)
    numbers = (read_number(tree[key], path, key) for key in LENS_KEYS)
    distortion: FloatArray = np.zeros(len(kind.coefficients))
    if "distortion" in tree:
        distortion = read_numbers(tree["distortion"], path, "distortion", 1)
    if not np.all(np.abs(distortion) < _MAX_DISTORTION):
        raise InputError(f"{path}: 'distortion' holds a number beyond ±{_MAX_DISTORTION:g}; no lens has that")
    mount = tree["mount"]
    if not isinstance(mount, dict) or any(key not in mount for key in _MOUNT_KEYS):
        raise InputError(f"{path}: 'mount' needs {', '.join(_MOUNT_KEYS)} (m, rad): the camera's pose in the body")
    check_inner_keys(mount, _MOUNT_KEYS, path, "mount")
    x, y, z, roll, pitch, yaw = (read_number(mount[key], path, f"mount: {key}") for key in _MOUNT_KEYS)
    pose = Pose3.from_roll_pitch_yaw(roll, pitch, yaw, (x, y, z))
    return (width, height, *numbers, distortion, pose, read_switch(tree, "use_attitude", True, path))
