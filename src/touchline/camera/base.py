"""What the rooms above know of a camera: pixel <-> ground, whatever lies between the two.

The camera body frame has x along the optical axis, y to the left and z up; a camera that looks at a mirror has the
base frame's axes. `base_from_camera` places it in the base frame. Without one given, a camera stands as its camera.yaml
says, on a robot that does not lean.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from touchline.geometry import BoolArray, FloatArray, Pose3

# half a pixel to all sides of one, and itself
_AROUND = np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])


class Camera(Protocol):
    """A camera on a robot.

    Pixels are (N, 2) u, v; ground points are (N, 2) in the base frame (m). What is not seen, or where, is NaN: pixels
    at or above the horizon and outside what the calibration covers, points behind the camera.
    """

    @property
    def model(self) -> str:
        """`omni`, `pinhole` or `fisheye`, as camera.yaml has it."""

    @property
    def width(self) -> int:
        """Columns of the image."""

    @property
    def height(self) -> int:
        """Rows of the image."""

    @property
    def use_attitude(self) -> bool:
        """Whether the IMU's roll and pitch of the body place this camera better than none."""

    @property
    def base_from_camera(self) -> Pose3:
        """Where the camera is on a robot that does not lean. Raises InputError where camera.yaml does not say."""

    def ray(self, pixels: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Unit vectors (N, 3) of what pixels see, in the base frame, from `base_from_camera.translation_m` on.

        Raises InputError for a camera whose place in the base frame is not known.
        """

    def ground_from_image(self, pixels: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Ground points (N, 2) of pixels."""

    def image_from_ground(self, points: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Pixels (N, 2) of ground points; they may lie outside the image: see `sees`."""

    def ground_covariances(
        self, pixels: npt.ArrayLike, noise_px: float, noise_m: float, base_from_camera: Pose3 | None = None
    ) -> FloatArray:
        """(N, 2, 2) covariances (m²) of ground points: the pixels' noise on the ground, and the ground's own."""

    def sees(self, pixels: FloatArray) -> BoolArray:
        """Whether pixels (N, 2) lie in the part of the image that shows the field; False for NaN."""


def field_of_view(camera: Camera, base_from_camera: Pose3 | None = None) -> BoolArray:
    """(H, W): the pixels in which the camera can see the ground."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    pixels = np.column_stack((u.ravel(), v.ravel())).astype(np.float64)
    ground = camera.ground_from_image(pixels, base_from_camera)
    mask: BoolArray = camera.sees(pixels) & np.isfinite(ground).all(axis=1)
    return mask.reshape(camera.height, camera.width)


def leaning(camera: Camera, roll_rad: float, pitch_rad: float) -> Pose3:
    """`base_from_camera` on a robot whose body leans. Raises InputError where camera.yaml does not place the camera."""
    return Pose3.from_roll_pitch_yaw(roll_rad, pitch_rad).compose(camera.base_from_camera)


def pose_in_base(
    camera: Camera, measured: Pose3 | None, roll_rad: float | None, pitch_rad: float | None
) -> Pose3 | None:
    """Where the camera was: as measured (a head that moves), else on a body with this lean, if the camera heeds it.

    None where only camera.yaml tells. Raises InputError for a lean where camera.yaml does not place the camera.
    """
    if measured is not None or not camera.use_attitude or roll_rad is None or pitch_rad is None:
        return measured
    return leaning(camera, roll_rad, pitch_rad)


def ground_of_rays(origin: FloatArray, rays: FloatArray) -> FloatArray:
    """Where rays (N, 3) from a point (3,) above the ground meet it, (N, 2); NaN if they don't fall."""
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.where(rays[:, 2] < 0.0, -origin[2] / rays[:, 2], np.nan)
        points: FloatArray = origin[:2] + length[:, np.newaxis] * rays[:, :2]
    return points


def ground_jacobian(ground_from_image: Callable[[FloatArray], FloatArray], pixels: npt.ArrayLike) -> FloatArray:
    """(N, 2, 2) derivative of the ground point (m) by the pixel, from differences over one pixel.

    At the edges of what is seen the difference is one-sided, over half a pixel. NaN outside.
    """
    uv = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    around = (uv + _AROUND[:, np.newaxis]).reshape(-1, 2)
    here, right, left, down, up = ground_from_image(around).reshape(len(_AROUND), -1, 2)
    jacobians = np.empty((len(uv), 2, 2))
    for column, (after, before) in enumerate(((right, left), (down, up))):
        ahead, behind = 2.0 * (after - here), 2.0 * (here - before)
        central = 0.5 * (ahead + behind)
        if np.isnan(central).any():
            central = np.where(np.isnan(ahead), behind, np.where(np.isnan(behind), ahead, central))
        jacobians[:, :, column] = central
    return jacobians


def pixel_covariances(jacobians: FloatArray, noise_px: float, noise_m: float) -> FloatArray:
    """(N, 2, 2) covariances (m²) from `ground_jacobian` (N, 2, 2), the pixels' noise and the ground's own."""
    covariances: FloatArray = noise_px**2 * jacobians @ jacobians.transpose(0, 2, 1)
    return covariances + np.eye(2) * noise_m**2
