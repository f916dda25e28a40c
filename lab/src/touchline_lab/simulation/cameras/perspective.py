"""A simulated camera with a lens, pinhole or fisheye, on a body that leans."""

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from touchline.camera import FisheyeCamera, PerspectiveCamera, PinholeCamera, leaning
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3
from touchline_lab.simulation.cameras.base import SimulatedCameraModel, with_glare
from touchline_lab.simulation.rendering.rendering import RayGrid


class SimulatedPerspectiveCamera(SimulatedCameraModel):
    """A perspective camera, pinhole or fisheye; by default `humanoid_camera`.

    Raises InputError if its lens maps no ray to some pixel of the image.
    """

    def __init__(self, design: PerspectiveCamera | None = None, **options: Any) -> None:
        """options: of `SimulatedCameraModel`."""
        self.design = design or humanoid_camera()
        _check_lens(self.design)
        super().__init__(lambda: _ray_grid(self.design), **options)

    def project(self, points: npt.ArrayLike, attitude: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
        """Pixels (N, 2) u, v of points (N, 2) on the ground or (N, 3), base frame (m); NaN behind the camera.

        attitude: roll, pitch of the body.
        """
        table = np.asarray(points, dtype=np.float64)
        if table.shape[1] == 2:
            table = np.column_stack((table, np.zeros(len(table))))
        return self.design.image_from_base(table, leaning(self.design, *attitude))


def humanoid_camera(
    roll: float = 0.0,
    pitch: float = 0.488692,
    yaw: float = 0.0,
    place_m: tuple[float, float, float] = (0.05, 0.0, 1.1),
    distortion: tuple[float, float, float, float, float] = (-0.25, 0.06, 0.0006, -0.0004, 0.0),
) -> PinholeCamera:
    """A teen-size humanoid's wide-angle camera of 752 x 480 pixels; roll, pitch, yaw and place: its mount (rad, m)."""
    mount = Pose3.from_roll_pitch_yaw(roll, pitch, yaw, place_m)
    return PinholeCamera(752, 480, 493.0, 493.0, 377.3, 238.6, np.array(distortion), mount)


def kid_size_camera() -> FisheyeCamera:
    """A kid-size humanoid's fisheye camera of 640 x 480 pixels, 0.52 m high: 128° wide, 160° from corner to corner."""
    mount = Pose3.from_roll_pitch_yaw(0.0, 0.55, 0.0, (0.04, 0.0, 0.52))
    lens = np.array([-0.02, 0.003, -0.001, 0.0002])
    return FisheyeCamera(640, 480, 285.0, 285.0, 321.4, 238.2, lens, mount)


def _check_lens(design: PerspectiveCamera) -> None:
    """Raises InputError if no ray is mapped to some pixel of the edges, which the lens bends most."""
    v, u = np.indices((design.height, design.width), dtype=np.float64)
    edge = (u == 0.0) | (u == design.width - 1.0) | (v == 0.0) | (v == design.height - 1.0)
    if not np.isfinite(design.ray(np.column_stack((u[edge], v[edge])))).all():
        raise InputError(f"{design.model} camera: its distortion maps no ray to some pixels of the image")


def _ray_grid(design: PerspectiveCamera) -> RayGrid:
    shape = (design.height, design.width)
    lens = (design.fx, design.fy, design.cx, design.cy, *design.distortion.tolist())
    directions = _camera_rays(type(design), shape, lens) @ design.base_from_camera.rotation.T
    place = design.base_from_camera.translation_m
    rays = np.hstack((np.broadcast_to(place, directions.shape), directions)).reshape(*shape, 6).astype(np.float32)
    still = with_glare(np.zeros((*shape, 4), dtype=np.float32), rays)
    return RayGrid(rays, 1.0 / design.fx, place, 0.01, still)


@lru_cache(maxsize=2)
def _camera_rays(kind: type[PerspectiveCamera], shape: tuple[int, int], lens: tuple[float, ...]) -> FloatArray:
    """Unit vectors (H * W, 3) of all pixels in the camera body frame; lens: fx, fy, cx, cy, distortion."""
    fx, fy, cx, cy, *distortion = lens
    height, width = shape
    upright = Pose3(np.eye(3), np.array([0.0, 0.0, 1.0]))
    v, u = np.indices(shape, dtype=np.float64)
    camera = kind(width, height, fx, fy, cx, cy, np.array(distortion), upright)
    return camera.camera_rays(np.column_stack((u.ravel(), v.ravel())))
