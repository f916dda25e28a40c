"""Egocentric coordinates of one image: pixel <-> ground, with all that is known of the camera's lean at that moment.

Schulz and Behnke 2012, section 4.4. In this order: the pose of the camera that the frame brings (a head that pans and
tilts); the learned correction of the IMU, on the image of a level robot; the lean of the body under the camera's mount.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy.typing as npt

from touchline.camera.base import Camera, ground_jacobian, pixel_covariances, pose_in_base
from touchline.camera.imu_correction import ImuCorrection
from touchline.camera.mounted import PerspectiveCamera
from touchline.camera.pinhole import PinholeCamera
from touchline.errors import InputError
from touchline.geometry import BoolArray, FloatArray, Pose3

MAX_LEAN_RAD = math.radians(60.0)  # a robot that leans more has fallen, and its lines are no lines on the ground


@dataclass(frozen=True, eq=False, slots=True)
class GroundView:
    """The camera at one image. base_from_camera: where it was; None as camera.yaml has it.

    correction, roll_rad, pitch_rad: what takes the lean off undistorted pixels instead; None where the pose holds it.
    Pixels are (N, 2) u, v; ground points (N, 2) in the robot frame (m); NaN where nothing is seen.
    """

    camera: Camera
    base_from_camera: Pose3 | None = None
    correction: ImuCorrection | None = None
    roll_rad: float = 0.0
    pitch_rad: float = 0.0

    @property
    def pose(self) -> Pose3:
        """`base_from_camera`, as measured or of camera.yaml; of a level robot where a correction is in use."""
        return self.base_from_camera or self.camera.base_from_camera

    def ground_from_image(self, pixels: npt.ArrayLike) -> FloatArray:
        """Ground points (N, 2) of pixels (N, 2)."""
        return self.camera.ground_from_image(self._level(pixels), self.base_from_camera)

    def image_from_ground(self, points: npt.ArrayLike) -> FloatArray:
        """Pixels (N, 2) of ground points (N, 2); they may lie outside the image."""
        return self._leaning(self.camera.image_from_ground(points, self.base_from_camera))

    def image_from_base(self, points: npt.ArrayLike) -> FloatArray:
        """Pixels (N, 2) of any points (N, 3) in the robot frame (m), of posts and poles.

        Raises InputError for a camera that looks at a mirror.
        """
        if not isinstance(self.camera, PerspectiveCamera):
            raise InputError(f"what stands upright is sought with a perspective camera; this one is a {self.model}")
        return self._leaning(self.camera.image_from_base(points, self.base_from_camera))

    def sees(self, pixels: FloatArray) -> BoolArray:
        """Whether pixels (N, 2) lie in the part of the image that shows the field; False for NaN."""
        return self.camera.sees(pixels)

    def covariances(self, pixels: npt.ArrayLike, noise_px: float, noise_m: float) -> FloatArray:
        """(N, 2, 2) covariances (m²) of ground points: the pixels' noise on the ground, and the ground's own."""
        return pixel_covariances(ground_jacobian(self.ground_from_image, pixels), noise_px, noise_m)

    @property
    def model(self) -> str:
        """The camera's."""
        return self.camera.model

    def _level(self, pixels: npt.ArrayLike) -> npt.ArrayLike:
        if self.correction is None:
            return pixels
        camera = self._pinhole()
        return camera.distorted(self.correction.level(camera.undistorted(pixels), self.roll_rad, self.pitch_rad))

    def _leaning(self, pixels: FloatArray) -> FloatArray:
        if self.correction is None:
            return pixels
        camera = self._pinhole()
        return camera.distorted(self.correction.leaning(camera.undistorted(pixels), self.roll_rad, self.pitch_rad))

    def _pinhole(self) -> PinholeCamera:
        assert isinstance(self.camera, PinholeCamera)  # others have no correction
        return self.camera


def ground_view(
    camera: Camera,
    base_from_camera: Pose3 | None = None,
    roll_rad: float | None = None,
    pitch_rad: float | None = None,
) -> GroundView:
    """The camera at an image: as the frame has its pose, else with the lean that the IMU tells.

    Raises InputError, one sentence, for a camera that heeds the lean and is told none, and for a lean beyond 60°.
    """
    return _ground_view(camera, base_from_camera, roll_rad, pitch_rad)  # type: ignore[arg-type]  # mypy: no hash


@lru_cache(maxsize=4)  # a system asks several times an image
def _ground_view(
    camera: Camera, base_from_camera: Pose3 | None, roll_rad: float | None, pitch_rad: float | None
) -> GroundView:
    if base_from_camera is not None:
        _check_lean(abs(base_from_camera.roll_pitch_yaw()[0]))  # the head pans and tilts as it likes
        return GroundView(camera, base_from_camera)
    if not camera.use_attitude:
        return GroundView(camera)
    if roll_rad is None or pitch_rad is None:
        raise InputError(
            "nothing tells how the camera leans at this image: give roll and pitch (imu.csv) or the camera's pose "
            "(camera_pose.csv), or write use_attitude: false into camera.yaml for a robot that does not lean"
        )
    _check_lean(math.acos(math.cos(roll_rad) * math.cos(pitch_rad)))
    correction = camera.imu_correction if isinstance(camera, PinholeCamera) else None
    if correction is not None:
        return GroundView(camera, None, correction, roll_rad, pitch_rad)
    return GroundView(camera, pose_in_base(camera, None, roll_rad, pitch_rad))


def _check_lean(lean_rad: float) -> None:
    if not lean_rad <= MAX_LEAN_RAD:
        raise InputError(
            f"the robot leans by {math.degrees(lean_rad):.0f}°, more than {math.degrees(MAX_LEAN_RAD):.0f}°: it has "
            "fallen, or roll and pitch are not in radians"
        )
