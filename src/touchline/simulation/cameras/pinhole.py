"""A simulated perspective camera: a pinhole with lens distortion on a body that leans."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from touchline.config import read_yaml_mapping
from touchline.errors import InputError
from touchline.geometry import FloatArray, tilt_rotation
from touchline.messages import did_you_mean
from touchline.simulation.cameras.base import SimulatedCameraModel, with_glisten
from touchline.simulation.cameras.image_sensor import ImageSensor
from touchline.simulation.rendering.rendering import RayGrid


@dataclass(frozen=True, slots=True)
class Mount:
    """Pose of the camera in the body (m, rad); pitch is positive looking down."""

    x: float = 0.05
    y: float = 0.0
    z: float = 1.1
    roll: float = 0.0
    pitch: float = 0.488692
    yaw: float = 0.0


class SimulatedPinholeCamera(SimulatedCameraModel):
    """Pinhole camera with OpenCV's distortion k1, k2, p1, p2, k3. Defaults: a humanoid's wide-angle camera, 752 x 480.

    Raises InputError for a size or focal length that is not positive and for a mount at or below the ground.
    """

    def __init__(
        self,
        width: int = 752,
        height: int = 480,
        fx: float = 493.0,
        fy: float = 493.0,
        cx: float = 377.3,
        cy: float = 238.6,
        distortion: tuple[float, ...] = (-0.25, 0.06, 0.0006, -0.0004, 0.0),
        mount: Mount | None = None,
        sensor: ImageSensor | None = None,
        side: int = 2,
        blur_steps: int = 5,
        readout_s: float = 0.0,
    ) -> None:
        mount = mount or Mount()
        if width < 2 or height < 2 or not (fx > 0.0 and fy > 0.0) or len(distortion) != 5:
            raise InputError("pinhole camera: needs a positive size and focal length and five numbers of distortion")
        if not mount.z > 0.0:
            raise InputError(f"pinhole camera: mounted at a height of {mount.z} m, below the ground")
        self.matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        self.distortion = np.array(distortion, dtype=np.float64)
        self.mount = mount
        self._body_from_camera = body_from_camera(mount)
        super().__init__(self._ray_grid(width, height), sensor or ImageSensor(), side, blur_steps, readout_s)

    @classmethod
    def load(cls, path: str | Path, **options: Any) -> SimulatedPinholeCamera:
        """From a camera.yaml with `model: pinhole`. Raises InputError naming file and key."""
        path = Path(path)
        return cls.from_mapping(read_yaml_mapping(path), str(path), **options)

    @classmethod
    def from_mapping(cls, tree: Mapping[str, Any], name: str = "camera", **options: Any) -> SimulatedPinholeCamera:
        """From the content of a camera.yaml; `name` is named in errors."""
        for key in ("width", "height", "fx", "fy", "cx", "cy", "mount"):
            if key not in tree:
                raise InputError(f"{name}: '{key}' is missing ({did_you_mean(key, list(tree))})")
        try:
            mount = Mount(**{key: float(value) for key, value in dict(tree["mount"]).items()})
            fx, fy, cx, cy = (float(tree[key]) for key in ("fx", "fy", "cx", "cy"))
            distortion = tuple(float(value) for value in tree.get("distortion", (0.0,) * 5))
            return cls(int(tree["width"]), int(tree["height"]), fx, fy, cx, cy, distortion, mount, **options)
        except (TypeError, ValueError) as error:
            raise InputError(f"{name}: {error}") from None

    def camera_yaml(self) -> dict[str, Any]:
        """The mapping that a recording's camera.yaml holds."""
        m = self.matrix
        return {
            "model": "pinhole",
            "width": self.width,
            "height": self.height,
            "fx": float(m[0, 0]),
            "fy": float(m[1, 1]),
            "cx": float(m[0, 2]),
            "cy": float(m[1, 2]),
            "distortion": [float(value) for value in self.distortion],
            "mount": asdict(self.mount),
        }

    def project(self, points: npt.ArrayLike, attitude: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """Pixels (N, 2) u, v of points (N, 2) on the ground or (N, 3), base frame (m); NaN behind the camera.

        attitude: roll, pitch of the body. The closed form of docs/how-to-recording.md, not the rays of the renderer.
        """
        table = np.asarray(points, dtype=np.float64)
        if table.shape[1] == 2:
            table = np.column_stack((table, np.zeros(len(table))))
        body = table @ tilt_rotation(*attitude)
        m = self.mount
        seen = (body - np.array([m.x, m.y, m.z])) @ self._body_from_camera
        optical = np.column_stack((-seen[:, 1], -seen[:, 2], seen[:, 0]))
        pixels = np.full((len(table), 2), np.nan)
        front = optical[:, 2] > 1e-6
        if front.any():
            projected, _ = cv2.projectPoints(optical[front], np.zeros(3), np.zeros(3), self.matrix, self.distortion)
            pixels[front] = projected.reshape(-1, 2)
        return pixels

    def _ray_grid(self, width: int, height: int) -> RayGrid:
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        x, y = self._undistorted(u.ravel(), v.ravel())
        directions = np.column_stack((np.ones_like(x), -x, -y)) @ self._body_from_camera.T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        m = self.mount
        origins = np.broadcast_to(np.array([m.x, m.y, m.z]), directions.shape)
        rays = np.hstack((origins, directions)).reshape(height, width, 6).astype(np.float32)
        still = with_glisten(np.zeros((height, width, 4), dtype=np.float32), rays)
        return RayGrid(rays, 1.0 / float(self.matrix[0, 0]), origins[0], 0.01, still)

    def _undistorted(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coordinates at unit depth of pixels: OpenCV's distortion inverted by fixed-point iteration."""
        k1, k2, p1, p2, k3 = self.distortion
        seen_x, seen_y = (u - self.matrix[0, 2]) / self.matrix[0, 0], (v - self.matrix[1, 2]) / self.matrix[1, 1]
        x, y = seen_x, seen_y
        for _ in range(60):
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            x, y = (
                (seen_x - 2.0 * p1 * x * y - p2 * (r2 + 2.0 * x * x)) / radial,
                (seen_y - p1 * (r2 + 2.0 * y * y) - 2.0 * p2 * x * y) / radial,
            )
        return x, y


def body_from_camera(mount: Mount) -> FloatArray:
    """Rz(yaw) Ry(pitch) Rx(roll) of the camera's body frame, (3, 3)."""
    c, s = math.cos(mount.yaw), math.sin(mount.yaw)
    rotation: FloatArray = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ tilt_rotation(
        mount.roll, mount.pitch
    )
    return rotation
