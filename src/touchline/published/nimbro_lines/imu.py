"""`touchline calibrate imu`: what roll and pitch do to the image, from marks that a robot sees while it walks in place.

Schulz and Behnke 2012, section 4.4, equation (2) and what it leaves out (`ImuCorrection`): neither the places of the
marks nor the robot's kinematics need be known.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from touchline.calibration.marks import MARKS, read_marks
from touchline.camera.imu_correction import (
    CONSTANT,
    PAPER_SHAPE,
    PITCH,
    ROLL,
    SHAPE,
    ImuCorrection,
    levelled,
    monomials,
)
from touchline.camera.pinhole import PinholeCamera
from touchline.errors import InputError
from touchline.geometry import BoolArray, FloatArray, IndexArray
from touchline.motion import LeanFilter
from touchline.sources import Recording

MIN_IMAGES = 20
MIN_LEAN_RAD = 0.005  # standard deviation of roll or pitch below which nothing can be learned of it
_STILL_RAD_S = 0.05  # rates of a robot that stands
_CUT_SIGMAS = 3.5  # marks that lie farther off were marked wrongly
_OF_LEAN = [*range(CONSTANT), *range(CONSTANT + 1, SHAPE[1])]  # the monomials but the constant
_NOISE_PX, _COEFFICIENT = 1.0, 2.0  # of a mark; size of a coefficient in focal lengths: rotations have 1 and less


@dataclass(frozen=True, eq=False, slots=True)
class ImuCalibration:
    """correction: what was learned; before_px, after_px: how far the marks wander (root mean square), without and with.

    marks, images: how many there were. standing: images of a robot that stands, at whose reading marks are true; 0 if
    the reading 0 was taken for upright. left_out: sightings that fit far worse than most, and count in neither figure.
    seen_px, corrected_px: (N, 2) all marks without distortion, as seen and corrected.
    """

    correction: ImuCorrection
    before_px: float
    after_px: float
    marks: int
    images: int
    standing: int
    left_out: int
    seen_px: FloatArray
    corrected_px: FloatArray


def calibrate_imu(recording: Recording, camera: PinholeCamera, paper: bool = False) -> ImuCalibration:
    """The matrix C by least squares; paper: of equation (2) alone. Raises InputError for a recording without marks,
    IMU or lean.
    """
    path = recording.folder / MARKS
    if not path.exists():
        raise InputError(f"{recording.folder}: has no {MARKS} (file,name,u,v) of marks before a robot that walks")
    marks = read_marks(recording.file(MARKS))
    leans, still = _leans(recording)
    rows = [i for i, name in enumerate(marks.files) if name in leans]
    images = {marks.files[i] for i in rows}
    if len(images) < MIN_IMAGES:
        raise InputError(
            f"{recording.folder}: {len(images)} images have marks and a reading of the IMU (imu.csv); "
            f"at least {MIN_IMAGES} are needed"
        )
    lean = np.array([leans[marks.files[i]] for i in rows])
    if max(lean.std(axis=0)) < MIN_LEAN_RAD:
        raise InputError(f"{recording.folder}: the robot hardly leans; let it walk in place before the marks")
    standing = _standing(recording, images, still)
    upright = np.mean([leans[name] for name in standing], axis=0) if standing else np.zeros(2)
    names, mark = np.unique([marks.names[i] for i in rows], return_inverse=True)
    initial = np.isin([marks.files[i] for i in rows], standing)
    seen = _Sightings(camera.undistorted(marks.pixels[rows]), mark, len(names), lean - upright, initial)
    return _fitted(seen, upright, camera, paper, (len(images), len(standing)))


class _Sightings(NamedTuple):
    """Marks in images, N sightings of so many marks.

    pixels (N, 2): undistorted. mark (N,): which one of `marks`. lean (N, 2): roll and pitch (rad) less those while
    upright. initial (N,): by a robot that stands.
    """

    pixels: FloatArray
    mark: IndexArray
    marks: int
    lean: FloatArray
    initial: BoolArray


class _Fit(NamedTuple):
    """matrix: that of `ImuCorrection`. true (K, 2): the initial coordinates c* of the marks, pixels."""

    matrix: FloatArray
    true: FloatArray


def _leans(recording: Recording) -> tuple[dict[str, FloatArray], dict[str, bool]]:
    """Roll and pitch (2,) at each image, and whether the robot stood still since the one before."""
    leaning, leans, still = LeanFilter(), {}, {}
    for frame in recording:
        leaning.add(frame)
        now = leaning.lean(frame.stamp_ns)
        if now is not None:
            leans[frame.name] = np.array(now)
        gyro = None if frame.gyro is None else frame.gyro.values[:, :2]
        still[frame.name] = gyro is not None and len(gyro) > 0 and bool(np.abs(gyro).max() < _STILL_RAD_S)
    return leans, still


def _standing(recording: Recording, images: set[str], still: dict[str, bool]) -> list[str]:
    """The images with marks before the robot began to walk."""
    found = []
    for name in still:
        if not still[name]:
            break
        if name in images:
            found.append(name)
    return found


def _fitted(
    seen: _Sightings, upright: FloatArray, camera: PinholeCamera, paper: bool, images: tuple[int, int]
) -> ImuCalibration:
    """By least squares, thrice, without what the fit before shows to be marked wrongly; images: all, and standing."""
    pixels = seen.pixels
    kept: BoolArray = np.asarray(np.isfinite(pixels).all(axis=1))
    f = monomials(pixels, seen.lean[:, 0], seen.lean[:, 1])
    for _ in range(3):
        fit = _equation_2(seen, kept, f[:, : PAPER_SHAPE[1]]) if paper else _homography(seen, kept, camera)
        corrected = levelled(fit.matrix, pixels, f)
        off = np.hypot(*(fit.true[seen.mark] - corrected).T)
        spread = float(np.sqrt(np.median(off[kept] ** 2)))
        kept = kept & (off < _CUT_SIGMAS * max(spread, 0.1))
    centres = np.array([pixels[kept & (seen.mark == k)].mean(axis=0) for k in range(seen.marks)])
    before = np.hypot(*(pixels - centres[seen.mark])[kept].T)
    correction = ImuCorrection(fit.matrix, (float(upright[1]), float(upright[0])))
    rms = [float(np.sqrt(np.mean(values**2))) for values in (before, off[kept])]
    left_out = int(np.count_nonzero(~kept))
    return ImuCalibration(correction, rms[0], rms[1], seen.marks, *images, left_out, pixels, corrected)


def _equation_2(seen: _Sightings, kept: BoolArray, f: FloatArray) -> _Fit:
    """Equation (2). Initial coordinates c* that are not known, of a robot that never stood, are estimated with C."""
    pixels, mark, initial = seen.pixels, seen.mark, seen.initial & kept
    if all(initial[mark == k].any() for k in range(seen.marks)):
        true = np.array([pixels[initial & (mark == k)].mean(axis=0) for k in range(seen.marks)])
        return _Fit(np.linalg.lstsq(f[kept], (true[mark] - pixels)[kept], rcond=None)[0].T, true)
    # x* - C f = c, both unknown; the constant is in x*
    design = np.column_stack((np.eye(seen.marks)[mark], -f[:, :CONSTANT]))
    solved = np.linalg.lstsq(design[kept], pixels[kept], rcond=None)[0]
    return _Fit(np.column_stack((solved[seen.marks :].T, np.zeros(2))), solved[: seen.marks])


def _homography(seen: _Sightings, kept: BoolArray, camera: PinholeCamera) -> _Fit:
    """x* (1 + C₃ f) - C f = c, x* and C unknown; the constant is in x*.

    In focal lengths from the principal point, where a camera's rotation has coefficients of order one: so those that
    the marks don't tell are held near 0.
    """
    from scipy.optimize import least_squares

    k = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    q = (seen.pixels[kept] - k[:2, 2]) / np.diag(k)[:2]
    mark, lean = seen.mark[kept], seen.lean[kept]
    f = monomials(q, lean[:, 0], lean[:, 1])[:, _OF_LEAN]
    ends = [2 * seen.marks, 2 * seen.marks + 2 * f.shape[1]]

    def parts(unknown: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        true, rows, third = np.split(unknown, ends)
        return true.reshape(-1, 2), rows.reshape(2, -1), third

    def residuals(unknown: FloatArray) -> FloatArray:
        true, rows, third = parts(unknown)
        off = true[mark] * (1.0 + f[:, :CONSTANT] @ third)[:, np.newaxis] - f @ rows.T - q
        return np.concatenate((off.ravel(), _NOISE_PX / camera.fx / _COEFFICIENT * unknown[ends[0] :]))

    true, rows, third = parts(least_squares(residuals, np.zeros(ends[1] + CONSTANT)).x)
    c, matrix = np.zeros(SHAPE), np.zeros(SHAPE)
    c[:2, _OF_LEAN], c[2, :CONSTANT] = rows, third
    for part in (PITCH, ROLL):
        matrix[:, part] = k @ c[:, part] @ np.linalg.inv(k)
    return _Fit(matrix, true * np.diag(k)[:2] + k[:2, 2])
