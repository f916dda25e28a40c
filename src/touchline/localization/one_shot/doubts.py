"""What speaks against the pose of one observation although no other fits better: a wrong field, a wrong camera."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.localization.one_shot.certainty import CameraDoubt
from touchline.localization.one_shot.thinning import thinned_to
from touchline.localization.registration.covariance import is_observed

FAR_M = 0.25  # from every line: beyond the reach of the error function, such a point says nothing
MAX_FAR_RATIO = 0.2  # of the points: real robots' points on their own field have up to 0.17, on another 0.28 and more
MAX_MEAN_PER_MEDIAN, MAX_ROW_RATIO = 4.0, 0.065  # beyond both another line was seen: clutter lies in no row, up to 0.05
ROW_HALF_M, MIN_ROW_M, ROW_POINTS = 0.08, 1.0, 150  # of such a row; points that it is looked for in
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
    field: FieldModel, placed: FloatArray, distances_m: FloatArray, covariance: FloatArray, camera: CameraDoubt | None
) -> Judgement:
    """Judge a pose by where it puts the points: placed (N, 2) in m, field frame, distances_m (N,) from the lines.

    covariance (3, 3) in (m, m, rad): of the pose if field and points are what they are said to be. camera: what the
    lines say against it; None if its errors are fitted with the pose.
    """
    doubts = [] if is_observed(covariance) else [_open_direction(covariance)]
    far = float(np.mean(distances_m > FAR_M))
    mean_m, median_m = float(np.mean(distances_m)), float(np.median(distances_m))
    row = mean_m > MAX_MEAN_PER_MEDIAN * median_m and _row_ratio(placed, distances_m > FAR_M) > MAX_ROW_RATIO
    if far > MAX_FAR_RATIO or row:
        why = "another field, for many of them lie in one row" if row else "another field, or much clutter"
        doubts.append(
            f"{100 * far:.0f} % of the points lie more than {100 * FAR_M:.0f} cm from every line (the mean, "
            f"{100 * mean_m:.0f} cm, is far above the median, {100 * median_m:.0f} cm): {why}"
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
    if camera is None:
        return Judgement(covariance, tuple(doubts))
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


def _row_ratio(placed: FloatArray, far: NDArray[np.bool_]) -> float:
    """Share of the points (N, 2) that are far (N,) from every line and lie in one straight row, as on a line."""
    few = thinned_to(placed[far], ROW_POINTS)
    first, second = np.triu_indices(len(few), 1)
    along = few[second] - few[first]
    lengths = np.hypot(*along.T)
    long = lengths > MIN_ROW_M
    if not np.any(long):
        return 0.0
    start, along = few[first[long]], along[long] / lengths[long, np.newaxis]
    normals = np.column_stack((-along[:, 1], along[:, 0]))
    beside = np.abs(normals @ few.T - np.sum(normals * start, axis=1)[:, np.newaxis])
    most = int(np.max(np.count_nonzero(beside < ROW_HALF_M, axis=1)))
    return most / len(few) * float(np.mean(far))


def _open_direction(covariance: FloatArray) -> str:
    """Where the pose is not fixed, in words."""
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    along = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1])) % 180.0
    return (
        f"the points do not fix the pose: ± {math.sqrt(values[1]):.1f} m in the direction {along:.0f}° of the field, "
        f"± {math.degrees(math.sqrt(covariance[2, 2])):.0f}° of heading"
    )
