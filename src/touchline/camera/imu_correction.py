"""The learned correction of pixels by roll and pitch (Schulz and Behnke 2012, section 4.4, equation 2).

A robot whose kinematics nobody knows walks in place before marks on the ground; where their images go for a reading of
the IMU is learned, and taken off before the camera of a level robot puts them on the ground.

A camera that leans by small angles sees the plane of the field through a homography that is linear in them. Equation
(2) holds no term of pitch or roll alone, and nothing of the third row, so that it is right about the rows of the marks
alone. Ours is all of it: c* = (c + C f) / (1 + C₃ f), C₃ the third row, f with pitch and roll at its end.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from touchline.camera.reading import read_numbers
from touchline.errors import InputError
from touchline.geometry import FloatArray

PAPER_SHAPE, SHAPE = (2, 5), (3, 7)
PITCH, ROLL, CONSTANT = (0, 2, 5), (3, 1, 6), 4  # the monomials of pitch with u, v and alone, of roll; and that of none


@dataclass(frozen=True, eq=False, slots=True)
class ImuCorrection:
    """matrix, for undistorted pixels: (3, 7), or (2, 5), the C of equation (2) alone. reference_rad: pitch and roll
    while upright.

    Raises InputError for another shape.
    """

    matrix: FloatArray
    reference_rad: tuple[float, float]

    def __post_init__(self) -> None:
        if np.shape(self.matrix) not in (PAPER_SHAPE, SHAPE):
            raise InputError("imu_correction: matrix needs 3 rows of 7 numbers, or 2 of 5")

    def level(self, pixels: FloatArray, roll_rad: float, pitch_rad: float) -> FloatArray:
        """Where a level robot would see what a leaning one sees at undistorted pixels (N, 2); NaN for no place."""
        return _through(self.homography(roll_rad, pitch_rad), pixels)

    def leaning(self, pixels: FloatArray, roll_rad: float, pitch_rad: float) -> FloatArray:
        """The inverse of `level`."""
        return _through(np.linalg.inv(self.homography(roll_rad, pitch_rad)), pixels)

    def homography(self, roll_rad: float, pitch_rad: float) -> FloatArray:
        """(3, 3) by which `level` moves undistorted pixels."""
        pitch, roll = pitch_rad - self.reference_rad[0], roll_rad - self.reference_rad[1]
        c = np.zeros(SHAPE)
        rows, columns = self.matrix.shape
        c[:rows, :columns] = self.matrix
        h = np.eye(3) + pitch * c[:, PITCH] + roll * c[:, ROLL]
        h[:, 2] += c[:, CONSTANT]
        return h


def _through(homography: FloatArray, pixels: FloatArray) -> FloatArray:
    lifted = pixels @ homography[:, :2].T + homography[:, 2]
    depth = np.where(lifted[:, 2:] > 0.0, lifted[:, 2:], np.nan)
    return lifted[:, :2] / depth


def monomials(pixels: FloatArray, roll_rad: FloatArray, pitch_rad: FloatArray) -> FloatArray:
    """f (N, 7) of undistorted pixels (N, 2): the five of equation (2), then pitch and roll. roll_rad, pitch_rad (N,):
    less those while upright.
    """
    u, v = pixels.T
    one = np.ones(len(pixels))
    return np.column_stack((pitch_rad * u, roll_rad * v, pitch_rad * v, roll_rad * u, one, pitch_rad, roll_rad))


def levelled(matrix: FloatArray, pixels: FloatArray, f: FloatArray) -> FloatArray:
    """`ImuCorrection.level` of undistorted pixels (N, 2) with monomials f (N, 7), each of a lean of its own."""
    rows, columns = matrix.shape
    c = f[:, :columns] @ matrix.T
    moved: FloatArray = pixels + c[:, :2]
    return moved / (1.0 + c[:, 2:]) if rows == SHAPE[0] else moved


def correction_from_mapping(tree: Any, path: Path) -> ImuCorrection:
    """The entry `imu_correction` of a camera.yaml; `path` is named in errors."""
    wanted = f"{path}: 'imu_correction' needs matrix (3 rows of 7 numbers, or 2 of 5) and reference (pitch, roll)"
    if not isinstance(tree, dict) or set(tree) != {"matrix", "reference"}:
        raise InputError(wanted)
    matrix = read_numbers(tree["matrix"], path, "imu_correction: matrix", 2)
    reference = read_numbers(tree["reference"], path, "imu_correction: reference", 1)
    if matrix.shape not in (PAPER_SHAPE, SHAPE) or reference.shape != (2,):
        raise InputError(wanted)
    return ImuCorrection(matrix, (float(reference[0]), float(reference[1])))


def correction_mapping(correction: ImuCorrection) -> dict[str, Any]:
    """The entry of a camera.yaml."""
    return {"matrix": correction.matrix.tolist(), "reference": [float(value) for value in correction.reference_rad]}
