"""The perspective camera: a pinhole with OpenCV's lens distortion (docs/how-to-recording.md).

A ray of the camera body frame (x along the optical axis, y left, z up) meets the plane at unit depth in x, y of
OpenCV's optical frame. The lens moves it there, radially by k1, k2, k3 and tangentially by p1, p2; the focal lengths
and the principal point make a pixel of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from touchline.camera.imu_correction import ImuCorrection, correction_from_mapping, correction_mapping
from touchline.camera.mounted import PerspectiveCamera
from touchline.camera.reading import naming_lines
from touchline.geometry import FloatArray

_MIN_DEPTH_M = 1e-6
_MAX_TANGENT = 12.0  # tangent of the angle to the optical axis: 85°
_NO_DISTORTION = 1e-12
_BEYOND_CORNERS = 1.05  # lines are drawn until they have left the image
_NEWTON_STEPS = 20  # 5 do for usual lenses
_CONVERGED = 1e-10


@dataclass(frozen=True, eq=False)
class PinholeCamera(PerspectiveCamera):
    """A perspective camera with an image plane. distortion: (5,) OpenCV's k1, k2, p1, p2, k3.

    imu_correction: what the IMU's roll and pitch do to undistorted pixels, where it has been learned (see
    `GroundView`). largest_radius: how far from the optical axis at unit depth the distortion is trusted: to the image's
    corners, and no farther than where it stops growing.
    """

    imu_correction: ImuCorrection | None = None
    largest_radius: float = field(init=False)
    model: ClassVar[str] = "pinhole"
    coefficients: ClassVar[tuple[str, ...]] = ("k1", "k2", "p1", "p2", "k3")
    scales_angles: ClassVar[bool] = False
    own_keys: ClassVar[tuple[str, ...]] = ("imu_correction",)
    ros_model: ClassVar[str] = "plumb_bob"

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "largest_radius", self._trusted_radius())

    def camera_rays(self, pixels: npt.ArrayLike) -> FloatArray:
        """Unit vectors (N, 3) of pixels (N, 2) in the camera body frame; NaN where the distortion is not trusted."""
        plane = self._undistorted(self.in_focal_lengths(pixels))
        rays = np.column_stack((np.ones(len(plane)), -plane))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays

    def undistorted(self, pixels: npt.ArrayLike) -> FloatArray:
        """Where a lens without distortion would show pixels (N, 2); NaN where the distortion is not trusted."""
        return self.in_pixels(self._undistorted(self.in_focal_lengths(pixels)))

    def distorted(self, pixels: npt.ArrayLike) -> FloatArray:
        """The inverse of `undistorted`."""
        return self._shown(self.in_focal_lengths(pixels))

    def image_from_camera(self, points: FloatArray) -> FloatArray:
        """Pixels (N, 2) u, v of points (N, 3) in the camera body frame; NaN behind it and far outside the image."""
        depth = np.where(points[:, 0] > _MIN_DEPTH_M, points[:, 0], np.nan)
        return self._shown(-points[:, 1:] / depth[:, np.newaxis])

    @classmethod
    def from_mapping(cls, tree: Mapping[str, Any], path: Path) -> "PinholeCamera":
        """A camera from the content of a camera.yaml; `path` is named in errors."""
        camera, learned = super().from_mapping(tree, path), tree.get("imu_correction")
        if learned is None:
            return camera
        with naming_lines(path):
            return replace(camera, imu_correction=correction_from_mapping(learned, path))

    def mapping(self) -> dict[str, Any]:
        """Its camera.yaml."""
        learned = self.imu_correction
        return super().mapping() | ({} if learned is None else {"imu_correction": correction_mapping(learned)})

    def _shown(self, plane: FloatArray) -> FloatArray:
        """Pixels (N, 2) of x, y (N, 2) at unit depth; NaN beyond `largest_radius`."""
        plane[~(np.hypot(*plane.T) <= self.largest_radius)] = np.nan
        return self.in_pixels(self._distorted(plane))

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
        corner = self.corner_radius()
        return min(float(radius[-1]), _BEYOND_CORNERS * float(np.interp(corner, distorted, radius)))
