"""The learned correction of pixels by roll and pitch (Schulz and Behnke 2012, section 4.4, equation 2).

A robot whose kinematics nobody knows walks in place before marks on the ground; where their images go for a reading of
the IMU is learned, and taken off before the camera of a level robot puts them on the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from touchline.camera.reading import read_numbers
from touchline.errors import InputError
from touchline.geometry import FloatArray

_MONOMIALS = 5


@dataclass(frozen=True, eq=False, slots=True)
class ImuCorrection:
    """matrix (2, 5): the C of equation (2), for undistorted pixels. reference_rad: pitch and roll while upright.

    Raises InputError for another shape.
    """

    matrix: FloatArray
    reference_rad: tuple[float, float]

    def __post_init__(self) -> None:
        if np.shape(self.matrix) != (2, _MONOMIALS):
            raise InputError(f"imu_correction: matrix needs 2 rows of {_MONOMIALS} numbers")

    def level(self, pixels: FloatArray, roll_rad: float, pitch_rad: float) -> FloatArray:
        """Where a level robot would see what a leaning one sees at undistorted pixels (N, 2): c + C f(c, φ)."""
        linear, constant = self._parts(roll_rad, pitch_rad)
        moved: FloatArray = pixels @ linear.T + constant
        return moved

    def leaning(self, pixels: FloatArray, roll_rad: float, pitch_rad: float) -> FloatArray:
        """The inverse of `level`; f is linear in c."""
        linear, constant = self._parts(roll_rad, pitch_rad)
        moved: FloatArray = np.linalg.solve(linear, (pixels - constant).T).T
        return moved

    def _parts(self, roll_rad: float, pitch_rad: float) -> tuple[FloatArray, FloatArray]:
        """c + C f(c, φ) as a matrix (2, 2) times c and a constant (2,)."""
        pitch, roll = pitch_rad - self.reference_rad[0], roll_rad - self.reference_rad[1]
        c = self.matrix
        by_u = pitch * c[:, 0] + roll * c[:, 3]
        by_v = roll * c[:, 1] + pitch * c[:, 2]
        return np.eye(2) + np.column_stack((by_u, by_v)), c[:, 4]


def monomials(pixels: FloatArray, roll_rad: FloatArray, pitch_rad: FloatArray) -> FloatArray:
    """The f of equation (2), (N, 5), of undistorted pixels (N, 2); roll and pitch (N,) less those while upright."""
    u, v = pixels.T
    return np.column_stack((pitch_rad * u, roll_rad * v, pitch_rad * v, roll_rad * u, np.ones(len(pixels))))


def correction_from_mapping(tree: Any, path: Path) -> ImuCorrection:
    """The entry `imu_correction` of a camera.yaml; `path` is named in errors."""
    if not isinstance(tree, dict) or set(tree) != {"matrix", "reference"}:
        raise InputError(f"{path}: 'imu_correction' needs matrix (2 rows of 5 numbers) and reference (pitch, roll)")
    matrix = read_numbers(tree["matrix"], path, "imu_correction: matrix", 2)
    reference = read_numbers(tree["reference"], path, "imu_correction: reference", 1)
    if matrix.shape != (2, _MONOMIALS) or reference.shape != (2,):
        raise InputError(f"{path}: 'imu_correction' needs matrix (2 rows of 5 numbers) and reference (pitch, roll)")
    return ImuCorrection(matrix, (float(reference[0]), float(reference[1])))


def correction_mapping(correction: ImuCorrection) -> dict[str, Any]:
    """The entry of a camera.yaml."""
    return {"matrix": correction.matrix.tolist(), "reference": [float(value) for value in correction.reference_rad]}
