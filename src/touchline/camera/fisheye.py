"""The fisheye camera: equidistant with OpenCV's fisheye distortion (docs/how-to-recording.md), up to 220° wide.

A direction at an angle θ to the optical axis is shown θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) from the principal point,
in focal lengths (Kannala and Brandt 2006). There is no image plane: what is beside the camera, or a little behind it,
is seen as well.
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from touchline.camera.mounted import PerspectiveCamera
from touchline.geometry import FloatArray

_MAX_ANGLE_RAD = math.radians(110.0)
_BEYOND_CORNERS = 1.05  # lines are drawn until they have left the image
_ANGLES = 4001  # of the table in which Newton's method begins
_NEWTON_STEPS = 3  # from there on to 1e-12


@dataclass(frozen=True, eq=False)
class FisheyeCamera(PerspectiveCamera):
    """A fisheye camera. fx, fy: px per rad, on the axis. distortion: (4,) OpenCV's k1 to k4.

    largest_angle_rad: to the optical axis, up to which the distortion is trusted: to the image's corners, and no
    farther than where it stops growing.
    """

    largest_angle_rad: float = field(init=False)
    model: ClassVar[str] = "fisheye"
    coefficients: ClassVar[tuple[str, ...]] = ("k1", "k2", "k3", "k4")
    scales_angles: ClassVar[bool] = True
    ros_model: ClassVar[str] = "equidistant"

    def __post_init__(self) -> None:
        super().__post_init__()
        angles = np.linspace(0.0, _MAX_ANGLE_RAD, _ANGLES)
        radii = self._distorted(angles)
        growing = int(np.argmin(np.append(np.diff(radii) > 0.0, False)))  # steps up to the first that does not
        corner = float(np.interp(self.corner_radius(), radii[: growing + 1], angles[: growing + 1]))
        object.__setattr__(self, "largest_angle_rad", min(float(angles[growing]), _BEYOND_CORNERS * corner))

    def camera_rays(self, pixels: npt.ArrayLike) -> FloatArray:
        """Unit vectors (N, 3) of pixels (N, 2) in the camera body frame; NaN where the distortion is not trusted."""
        seen = self.in_focal_lengths(pixels)
        radii = np.hypot(*seen.T)
        angles = self._undistorted(radii)
        aside = np.where(radii > 0.0, np.sin(angles) / np.where(radii > 0.0, radii, 1.0), 1.0)
        return np.column_stack((np.cos(angles), -aside[:, np.newaxis] * seen))

    def image_from_camera(self, points: FloatArray) -> FloatArray:
        """Pixels (N, 2) u, v of points (N, 3) in the camera body frame; NaN far outside the image."""
        aside = np.hypot(points[:, 1], points[:, 2])
        angles = np.arctan2(aside, points[:, 0])
        angles = np.where(angles <= self.largest_angle_rad, angles, np.nan)
        ratios = np.where(aside > 0.0, self._distorted(angles) / np.where(aside > 0.0, aside, 1.0), 0.0 * angles)
        return self.in_pixels(-points[:, 1:] * ratios[:, np.newaxis])

    def _distorted(self, angles: FloatArray) -> FloatArray:
        """How far from the principal point angles (N,) are shown, in focal lengths."""
        k1, k2, k3, k4 = self.distortion
        t2 = angles * angles
        return angles * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))

    def _undistorted(self, radii: FloatArray) -> FloatArray:
        """The inverse of `_distorted`, by Newton's method; NaN beyond `largest_angle_rad`."""
        k1, k2, k3, k4 = self.distortion
        table = np.linspace(0.0, self.largest_angle_rad, _ANGLES)
        shown = self._distorted(table)
        angles = np.interp(radii, shown, table)
        for _ in range(_NEWTON_STEPS):
            t2 = angles * angles
            slope = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
            step = (self._distorted(angles) - radii) / np.maximum(slope, 1e-6)
            angles = np.clip(angles - step, 0.0, self.largest_angle_rad)
        return np.where(radii <= shown[-1], angles, np.nan)
