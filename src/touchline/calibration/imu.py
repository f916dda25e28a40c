"""`touchline calibrate imu`: what roll and pitch do to the image, from marks that a robot sees while it walks in place.

Schulz and Behnke 2012, section 4.4, equation (2): neither the places of the marks nor the robot's kinematics need be
known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from touchline.calibration.marks import MARKS, Marks, read_marks
from touchline.camera.imu_correction import ImuCorrection, monomials
from touchline.camera.pinhole import PinholeCamera
from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.motion import LeanFilter
from touchline.sources import Recording

MIN_IMAGES = 20
MIN_LEAN_RAD = 0.005  # standard deviation of roll or pitch below which nothing can be learned of it
_STILL_RAD_S = 0.05  # rates of a robot that stands
_CUT_SIGMAS = 3.5  # marks that lie farther off were marked wrongly


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


def calibrate_imu(recording: Recording, camera: PinholeCamera) -> ImuCalibration:
    """The matrix C by least squares. Raises InputError for a recording without marks, IMU or lean."""
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
    return _fitted(marks, np.array(rows), lean - upright, upright, camera, standing)


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
    marks: Marks, rows: FloatArray, lean: FloatArray, upright: FloatArray, camera: PinholeCamera, standing: list[str]
) -> ImuCalibration:
    """Equation (2). Initial coordinates c* that are not known, of a robot that never stood, are estimated with C."""
    pixels = camera.undistorted(marks.pixels[rows])
    names = np.array([marks.names[i] for i in rows])
    files = np.array([marks.files[i] for i in rows])
    kinds, mark = np.unique(names, return_inverse=True)
    f = monomials(pixels, lean[:, 0], lean[:, 1])
    kept = np.isfinite(pixels).all(axis=1)
    initial = np.isin(files, standing) & kept
    for _ in range(3):
        if all(initial[mark == k].any() for k in range(len(kinds))):
            true = np.array([pixels[initial & (mark == k)].mean(axis=0) for k in range(len(kinds))])
            matrix = np.linalg.lstsq(f[kept], (true[mark] - pixels)[kept], rcond=None)[0].T
        else:  # x* - C f = c, both unknown; the constant is in x*
            design = np.column_stack((np.eye(len(kinds))[mark], -f[:, :4]))
            solved = np.linalg.lstsq(design[kept], pixels[kept], rcond=None)[0]
            true = solved[: len(kinds)]
            matrix = np.column_stack((solved[len(kinds) :].T, np.zeros(2)))
        off = np.hypot(*(true[mark] - pixels - f @ matrix.T).T)
        spread = float(np.sqrt(np.median(off[kept] ** 2)))
        kept = kept & (off < _CUT_SIGMAS * max(spread, 0.1))
    centres = np.array([pixels[kept & (mark == k)].mean(axis=0) for k in range(len(kinds))])
    before = np.hypot(*(pixels - centres[mark])[kept].T)
    correction = ImuCorrection(matrix, (float(upright[1]), float(upright[0])))
    rms = [float(np.sqrt(np.mean(values**2))) for values in (before, off[kept])]
    counts = (len(kinds), len(set(files.tolist())), len(standing), int(np.count_nonzero(~kept)))
    return ImuCalibration(correction, rms[0], rms[1], *counts, pixels, pixels + f @ matrix.T)
