"""Pose and mirror errors that put the points of one image on the lines, jointly; compiled.

Five errors e = (g, c, s) of a mirror move a ground point p, at the range r in the direction u, base frame:

    p' = (1 + s) p + J c                  s: ranges that are too short by a share; c (px): displacement, an offset of
                                          the image's centre; J: the ground's derivative by the pixel, which is dr/dρ
                                          along u and r/ρ across it
    p" = (p' + h² g) / (1 - g·p')         g (1/m): tilt, towards the side that is seen too near, of rays from the height
                                          h; to first order by (g·p) p + h² g

 The errors of one image are those of the head, which change slowly, and
what a shaking head adds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.field.distances import nearest_line_point
from touchline.geometry import FloatArray
from touchline.matrices import inverse, times

ERRORS = 5
STATE = 3 + ERRORS
MIN_DEPTH = 0.2  # of 1 - g·p: beyond it is the horizon
SCALE_STEP_M = 0.1  # between the rows of a table of scales


class Known(NamedTuple):
    """What is known of the errors before an image: mean (5,), its covariance (5, 5), and what shaking adds (5, 5).

    believed (5,): the mean, or what is taken for it as long as it is not sure that the camera is wrong at all.
    """

    mean: FloatArray
    believed: FloatArray
    covariance: FloatArray
    swing: FloatArray


class Mirror(NamedTuple):
    """What the errors do: height_m of the mirror; scales (K, 2): dr/dρ and r/ρ (m/px) at ranges of SCALE_STEP_M each,
    none where no camera is known.
    """

    height_m: float
    scales: FloatArray


class FitPlan(NamedTuple):
    """widths_m (W,): distance from the line at which a point loses influence, of each Gauss-Newton step. floor_m:
    standard deviation of a point beside its own. noise: by how much larger variances are than that. loose (3,):
    standard deviations (m, m, rad) of the pose about its start. images: so many images err together.
    """

    widths_m: FloatArray
    floor_m: float
    noise: float
    loose: FloatArray
    images: float


class Expected(NamedTuple):
    """Where the robot should be by what is known beside the image: pose (3,) and covariance (3, 3) (m, m, rad)."""

    pose: FloatArray
    covariance: FloatArray


class MirrorFit(NamedTuple):
    """pose (3,) by the lines alone, where the errors (5,) of one image are taken out.

    mean (5,), covariance (5, 5): of the head's errors after it. lever (3, 5): derivative of the pose by errors that are
    not taken out, field frame. image (5, 5): how unsure the image's own errors are where the head's are known.
    noise: squared residuals in the unit of the points' variances.
    """

    pose: FloatArray
    errors: FloatArray
    mean: FloatArray
    covariance: FloatArray
    lever: FloatArray
    image: FloatArray
    noise: float


@njit(cache=True)
def scales_at(scales, reach):  # type: ignore[no-untyped-def]
    """dr/dρ and r/ρ at a range (m); zeros without a table."""
    if len(scales) == 0:
        return 0.0, 0.0
    place = min(reach / SCALE_STEP_M, len(scales) - 1.000001)
    i = int(place)
    f = place - i
    return (1.0 - f) * scales[i, 0] + f * scales[i + 1, 0], (1.0 - f) * scales[i, 1] + f * scales[i + 1, 1]


@njit(cache=True)
def moved(points, errors, mirror):  # type: ignore[no-untyped-def]
    """Points (N, 2) as seen, robot frame (m), without errors (5,)."""
    height_m, scales = mirror
    square = height_m * height_m
    out = np.empty_like(points)
    for i in range(len(points)):
        px, py = points[i, 0], points[i, 1]
        reach = math.sqrt(px * px + py * py)
        along, across = scales_at(scales, reach)
        share = (along - across) * (errors[2] * px + errors[3] * py) / max(reach * reach, 1e-9)
        stretch = 1.0 + errors[4] + share
        qx, qy = stretch * px + across * errors[2], stretch * py + across * errors[3]
        nearer = 1.0 / max(1.0 - errors[0] * qx - errors[1] * qy, MIN_DEPTH)
        out[i, 0], out[i, 1] = nearer * (qx + square * errors[0]), nearer * (qy + square * errors[1])
    return out


@njit(cache=True)
def normal_equations(points, covariances, state, mirror, plan, width_m, lines):  # type: ignore[no-untyped-def]
    """Robust Gauss-Newton equations of the distances to the lines: matrix (8, 8), vector (8,) of a step, and noise.

    points (N, 2) and covariances (N, 2, 2): as seen, robot frame, m. state (8,): x, y, heading (field frame; m, rad)
    and the errors. width_m: c of the error function.
    """
    height_m, scales = mirror
    floor_m, noise = plan.floor_m, plan.noise
    square = height_m * height_m
    matrix, vector, row = np.zeros((STATE, STATE)), np.zeros(STATE), np.empty(STATE)
    squares = total = 0.0
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    for i in range(len(points)):
        px, py = points[i, 0], points[i, 1]
        reach2 = max(px * px + py * py, 1e-9)
        along, across = scales_at(scales, math.sqrt(reach2))
        oblong = (along - across) / reach2
        stretch = 1.0 + state[7] + oblong * (state[5] * px + state[6] * py)
        qx, qy = stretch * px + across * state[5], stretch * py + across * state[6]
        nearer = 1.0 / max(1.0 - state[3] * qx - state[4] * qy, MIN_DEPTH)
        bx, by = nearer * (qx + square * state[3]), nearer * (qy + square * state[4])
        fx, fy = state[0] + cosine * bx - sine * by, state[1] + sine * bx + cosine * by
        distance, line_x, line_y = nearest_line_point(lines, fx, fy)
        if distance < 1e-7:
            continue
        nx, ny = (fx - line_x) / distance, (fy - line_y) / distance
        rx, ry = cosine * nx + sine * ny, -sine * nx + cosine * ny  # the normal in the robot frame
        row[0], row[1] = nx, ny
        row[2] = ry * bx - rx * by
        outward = rx * bx + ry * by
        row[3], row[4] = nearer * (outward * qx + square * rx), nearer * (outward * qy + square * ry)
        mx, my = nearer * (rx + outward * state[3]), nearer * (ry + outward * state[4])  # before the tilt
        row[7] = mx * px + my * py
        row[5], row[6] = oblong * row[7] * px + across * mx, oblong * row[7] * py + across * my
        variance = floor_m * floor_m + (
            rx * rx * covariances[i, 0, 0] + 2.0 * rx * ry * covariances[i, 0, 1] + ry * ry * covariances[i, 1, 1]
        )
        influence = width_m * width_m / (width_m * width_m + distance * distance)
        influence *= influence
        squares += influence * distance * distance / variance
        total += influence
        weight = influence / (variance * noise)
        for a in range(STATE):
            vector[a] -= weight * row[a] * distance
            for b in range(a + 1):
                matrix[a, b] += weight * row[a] * row[b]
    for a in range(STATE):
        for b in range(a):
            matrix[b, a] = matrix[a, b]
    return matrix, vector, squares / max(total, 1e-9)


@njit(cache=True)
def _updated(mean, spread, information, said):  # type: ignore[no-untyped-def]
    """Mean (5,) and covariance (5, 5) once a prior, which may be singular, has met information (5, 5) times what it
    says: said (5,)."""
    keep = times(spread, inverse(np.eye(ERRORS) + times(information, spread)))
    keep = 0.5 * (keep + keep.T)
    step = np.empty((ERRORS, 1))
    for i in range(ERRORS):
        step[i, 0] = said[i]
        for j in range(ERRORS):
            step[i, 0] -= information[i, j] * mean[j]
    return mean + times(keep, step)[:, 0], keep


@njit(cache=True)
def fit_mirror(points, covariances, pose, expected, known, mirror, plan, lines):  # type: ignore[no-untyped-def]
    """`MirrorFit` of points as seen, from a pose (3,) that is close."""
    prior, loose = np.zeros((STATE, STATE)), np.zeros((3, 3))
    for k in range(3):
        loose[k, k] = 1.0 / (plan.loose[k] * plan.loose[k])
    prior[:3, :3] = inverse(expected.covariance)
    spread = known.covariance + known.swing
    apart = spread.copy()
    for k in range(ERRORS):
        apart[k, k] += 1e-14  # errors that are known exactly
    prior[3:, 3:] = inverse(apart)
    start = np.empty(STATE)
    start[:3], start[3:] = expected.pose, known.believed
    state, last = start.copy(), start.copy()
    state[:3] = pose
    matrix, vector, noise = np.zeros((STATE, STATE)), np.zeros(STATE), 1.0
    for width_m in plan.widths_m:
        matrix, vector, noise = normal_equations(points, covariances, state, mirror, plan, width_m, lines)
        last[:] = state
        pull = np.empty((STATE, 1))
        for a in range(STATE):
            pull[a, 0] = vector[a]
            for b in range(STATE):
                pull[a, 0] += prior[a, b] * (start[b] - state[b])
        state = state + times(inverse(matrix + prior), pull)[:, 0]
    own = inverse(matrix[:3, :3] + loose)
    lever = -times(own, np.ascontiguousarray(matrix[:3, 3:]))
    information = matrix[3:, 3:] + times(np.ascontiguousarray(matrix[3:, :3]), lever)
    said = np.empty(ERRORS)
    for i in range(ERRORS):
        said[i] = vector[3 + i]
        for k in range(3):
            said[i] += lever[k, i] * (vector[k] + loose[k, k] * (pose[k] - last[k]))
        for j in range(ERRORS):
            said[i] += information[i, j] * last[3 + j]
    free = last[:3].copy()  # the pose that the lines want with these errors, whatever is expected
    for i in range(3):
        for k in range(3):
            free[i] += own[i, k] * (vector[k] + loose[k, k] * (pose[k] - last[k]))
        for j in range(ERRORS):
            free[i] += lever[i, j] * (state[3 + j] - last[3 + j])
    image = _updated(known.mean, known.swing, information, said)[1]
    share = inverse(plan.images * np.eye(ERRORS) + times(information, known.swing))
    mean, covariance = _updated(
        known.mean, known.covariance, times(share, information), times(share, said.reshape(ERRORS, 1))[:, 0]
    )
    return MirrorFit(free, state[3:], mean, covariance, lever, image, noise)
