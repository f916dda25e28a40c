"""The Cramér-Rao bound: how exact the best possible estimate of a pose is, on average over the noise.

No unbiased estimate has a covariance below the inverse of the Fisher information, which for points on known lines with
normal noise is the sum of u uᵀ / σ², u the derivative of a point's distance from its line by the pose, σ² its variance
across the line (van Trees 1968, section 2.4; Censi 2007 for registration).
"""

import math

import numpy as np

from touchline.field import FieldModel
from touchline.field.distances import nearest_line_points
from touchline.geometry import FloatArray, Pose

_ON_THE_LINE_M = 1e-6


def bound_covariance(field: FieldModel, positions_m: FloatArray, covariances_m2: FloatArray, truth: Pose) -> FloatArray:
    """Covariance (3, 3) in (m, m, rad), field frame, that no unbiased estimate falls below.

    positions_m (N, 2), covariances_m2 (N, 2, 2): points of lines, without clutter, robot frame; truth: where the robot
    stood. Raises ValueError if the points leave the pose open.
    """
    seen = truth.transform(positions_m)
    offsets = seen - nearest_line_points(field.line_tables, seen)
    distances = np.hypot(offsets[:, 0], offsets[:, 1])
    off_line = distances > _ON_THE_LINE_M
    normals = offsets[off_line] / distances[off_line, np.newaxis]
    cosine, sine = math.cos(truth.heading), math.sin(truth.heading)
    in_robot = normals @ np.array([[cosine, -sine], [sine, cosine]])
    variances = np.einsum("ni,nij,nj->n", in_robot, covariances_m2[off_line], in_robot)
    lever = seen[off_line] - np.array([truth.x, truth.y])
    turns = normals[:, 1] * lever[:, 0] - normals[:, 0] * lever[:, 1]
    slopes = np.column_stack((normals, turns))
    information = (slopes / variances[:, np.newaxis]).T @ slopes
    if not np.linalg.cond(information) < 1e12:
        raise ValueError("the points leave the pose open: no bound")
    return np.asarray(np.linalg.inv(information))


def mean_errors(covariance: FloatArray) -> tuple[float, float]:
    """Mean distance (m) and mean absolute turn (rad) of normal errors of a covariance (3, 3)."""
    longer, shorter = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[:2, :2])[::-1], 0.0))
    around = np.linspace(0.0, 0.5 * math.pi, 65)
    # mean length of a normal vector: sqrt(pi / 2) times the mean of its spread over all directions
    spread = np.sqrt((longer * np.cos(around)) ** 2 + (shorter * np.sin(around)) ** 2)
    mean_spread = float(np.mean(0.5 * (spread[1:] + spread[:-1])))
    return math.sqrt(0.5 * math.pi) * mean_spread, math.sqrt(2.0 / math.pi * float(covariance[2, 2]))
