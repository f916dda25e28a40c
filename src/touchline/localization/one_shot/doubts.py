"""What speaks against the pose of one observation although no other fits better: a wrong field, a wrong camera."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.localization.matching.covariance import is_observed
from touchline.localization.one_shot.certainty import CameraDoubt

FAR_M = 0.25  # from every line: beyond the reach of the error function, such a point says nothing
MAX_FAR_RATIO = 0.2  # of the points: real robots' points on their own field have up to 0.17, on another 0.28 and more
MAX_MEDIAN_M = 0.08  # distance from the lines: real robots have 2 to 5 cm, 8 with a poor calibration
MAX_OUTSIDE_RATIO = 0.05  # of the points beyond the carpet, where no line can be
MIN_SCALE, MIN_SCALE_DEVIATIONS = 0.015, 4.0  # of a scale error that is told: calibrations are good to a per cent
MIN_MOVED_M, MIN_BEND_DEVIATIONS = 0.08, 4.0  # by what a bend must move the pose to be told
DEGREES_PER_BEND = math.degrees(0.75 / 2.0)  # of a mirror that leans, at the height of a robot's


class Judgement(NamedTuple):
    """covariance (3, 3): of the pose, wide where the points don't fit. doubts: a sentence each, for people."""

    covariance: FloatArray
    doubts: tuple[str, ...]


def judge(
    field: FieldModel, placed: FloatArray, distances_m: FloatArray, covariance: FloatArray, camera: CameraDoubt
) -> Judgement:
    """Judge a pose by where it puts the points: placed (N, 2) in m, field frame, distances_m (N,) from the lines.

    covariance (3, 3) in (m, m, rad): of the pose if field and points are what they are said to be.
    """
    doubts = [] if is_observed(covariance) else [_open_direction(covariance)]
    far = float(np.mean(distances_m > FAR_M))
    mean_m, median_m = float(np.mean(distances_m)), float(np.median(distances_m))
    if far > MAX_FAR_RATIO:
        doubts.append(
            f"{100 * far:.0f} % of the points lie more than {100 * FAR_M:.0f} cm from every line (the mean, "
            f"{100 * mean_m:.0f} cm, is far above the median, {100 * median_m:.0f} cm): another field, or much clutter"
        )
        spread_m = float(np.sqrt(np.mean((placed - placed.mean(axis=0)) ** 2)))
        covariance = covariance + np.diag([mean_m, mean_m, mean_m / max(spread_m, mean_m)]) ** 2
    elif median_m > MAX_MEDIAN_M:
        doubts.append(
            f"half of the points lie more than {100 * median_m:.0f} cm from the lines; with a good calibration it is 2 "
            "to 5 cm"
        )
    sides = 0.5 * np.array([field.length, field.width]) + field.border
    outside = float(np.mean(np.any(np.abs(placed) > sides, axis=1)))
    if outside > MAX_OUTSIDE_RATIO:
        doubts.append(
            f"{100 * outside:.0f} % of the points lie outside the carpet, {field.border:g} m and more beside the field"
        )
    if abs(camera.scale) > max(MIN_SCALE, MIN_SCALE_DEVIATIONS * camera.scale_deviation):
        doubts.append(
            f"the ranges look {100 * abs(camera.scale):.1f} ± {100 * camera.scale_deviation:.1f} % too "
            f"{'short' if camera.scale > 0 else 'long'}: another field, or another robot's camera"
        )
    if camera.moved_m > MIN_MOVED_M and camera.bend_per_m > MIN_BEND_DEVIATIONS * camera.bend_deviation:
        doubts.append(
            f"straight lines look bent, as by a mirror {DEGREES_PER_BEND * camera.bend_per_m:.1f}° askew or pixels off "
            f"its centre: without that the pose lies {100 * camera.moved_m:.0f} cm away"
        )
    return Judgement(covariance, tuple(doubts))


def _open_direction(covariance: FloatArray) -> str:
    """Where the pose is not fixed, in words."""
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    along = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1])) % 180.0
    return (
        f"the points do not fix the pose: ± {math.sqrt(values[1]):.1f} m in the direction {along:.0f}° of the field, "
        f"± {math.degrees(math.sqrt(covariance[2, 2])):.0f}° of heading"
    )
