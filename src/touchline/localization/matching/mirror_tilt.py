"""The mirror's tilt, from how the lines bend: measured in every frame, so that a vibrating head does no harm.

A mirror tilted by a little turns every reflected ray by a little about one horizontal axis. For rays from the height h
that moves a ground point, to first order, p -> p + (g·p) p + h² g, with g (1/m) towards the side that is seen too near:
a bend that grows with the square of the range. Lines that should be straight, parallel and in their known places show
g next to the pose. The shift h² g can't be seen in one image; it follows from g.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numba import njit
from pydantic import Field

from touchline.config import Settings, added, constants_now
from touchline.field import FieldModel
from touchline.field.distances import nearest_line_point
from touchline.geometry import FloatArray, Pose
from touchline.types import LinePoints

MAX_ERROR = 0.1  # mean error of most points above which the lines are too uncertain to tell a tilt
MOST_POINTS = 0.75  # of the points, the nearest to lines, are those; the others may be nets, or lines of a field beside
UNKNOWN_PER_M = 0.015  # standard deviation of g before the first frame: a mirror 0.3 degrees off
VIBRATION_PER_M = 0.003  # standard deviation of g about its mean from frame to frame: vibration of 0.06 degrees
DRIFT_PER_M = 0.0001  # drift of the mean g per frame: a loosening mount
WIDTH_M = 0.1  # distance to the line from which a point loses influence; the pose is already matched
FIRST_WIDTH_M = 0.25  # the same in the first steps: 0.3 degrees move a line 7 m off by so much; Lauer's c
MIN_NOISE_M = 0.01  # standard deviation that no point falls below: carpet, calibration
LOOSE_POSITION_M = 0.2  # how far the pose may move from the match meanwhile: what an unknown tilt may have shifted it
LOOSE_HEADING_RAD = 0.1  # how far the heading may turn from the match meanwhile: as loose_position_m
FIRST_ITERATIONS = 3  # Gauss-Newton steps per frame with the first width: from the mean of the frames before
ITERATIONS = 2  # those after them
# how unsure the pose's shift is that goes with g (m² per unit of g), which no image shows: h² g if the mirror turns
# about its focus, two or three times that about its apex, and a mirror that leans is mostly displaced as well
SHIFT_M2 = 1.2
_LOOSE = np.diag([LOOSE_POSITION_M**-2.0, LOOSE_POSITION_M**-2.0, LOOSE_HEADING_RAD**-2.0, 0.0, 0.0])
SHAKING_GAIN = 0.05  # share of a new image in how far the bend of single images lies from the mean


class MirrorTiltPaper(Settings):
    """Switches to the papers' exact form."""

    enabled: bool = added(
        True,
        paper=False,
        description="estimate the tilt; without it, as in the papers, a mirror 0.2 degrees off costs 5 cm",
    )


class MirrorTiltSettings(Settings):
    """How much tilt is expected, and how fast it may change. None of this is in the paper."""

    renamed: ClassVar[Mapping[str, str]] = {"enabled": "paper.enabled"}
    removed: ClassVar[Mapping[str, str]] = constants_now(
        __name__,
        "most_error",
        "unknown_per_m",
        "vibration_per_m",
        "drift_per_m",
        "width_m",
        "first_width_m",
        "least_noise_m",
        "loose_position_m",
        "loose_heading_rad",
        "iterations",
    )

    height_m: float = Field(0.75, ge=0, description="height of the mirror (m): MSL robots may be 0.8 m high")
    paper: MirrorTiltPaper = MirrorTiltPaper()


class MirrorTilt:
    """The bend g (2,) in 1/m, robot frame: this frame's, and the mean over the frames with its covariance."""

    def __init__(self, field: FieldModel, settings: MirrorTiltSettings | None = None) -> None:
        self.settings = settings or MirrorTiltSettings()
        self._field, self._lines = field, field.line_tables
        self.reset()

    def reset(self) -> None:
        """Back to an upright mirror of unknown error."""
        self.mean_per_m = np.zeros(2)
        self.covariance = np.eye(2) * UNKNOWN_PER_M**2
        self._shaking = 0.0

    def corrected(self, positions_m: FloatArray, bend_per_m: FloatArray | None = None) -> FloatArray:
        """Points (N, 2) as an upright mirror would have seen them; with the mean bend, or the one given."""
        bend = self.mean_per_m if bend_per_m is None else bend_per_m
        return bent(positions_m, bend, self.settings.height_m)

    @property
    def is_unknown(self) -> bool:
        """Whether hardly any frame has told the mean yet."""
        return float(np.trace(self.covariance)) > 0.1 * UNKNOWN_PER_M**2

    def is_told(self, positions_m: FloatArray, pose: Pose) -> bool:
        """Whether points (N, 2), robot frame, at a pose that fits them but for the tilt, can tell it."""
        squares = np.sort(np.square(self._field.line_distances(pose.transform(self.corrected(positions_m)))))
        nearest = squares[: max(int(MOST_POINTS * len(squares)), 1)]
        return float(np.mean(nearest / (nearest + FIRST_WIDTH_M**2))) < MAX_ERROR

    @property
    def unseen(self) -> FloatArray:
        """Covariance (3, 3) of what the tilt does to every pose alike, in (m, m, rad): no number of images shows it."""
        variance_m2 = SHIFT_M2**2 * float(self.mean_per_m @ self.mean_per_m + np.trace(self.covariance))
        return np.diag([variance_m2, variance_m2, 0.0])

    @property
    def shaken(self) -> FloatArray:
        """Covariance (3, 3) of what a shaking head does to the pose of one image, as `unseen`."""
        variance_m2 = SHIFT_M2**2 * self._shaking
        return np.diag([variance_m2, variance_m2, 0.0])

    def update(self, points: LinePoints, pose: Pose) -> FloatArray:
        """This frame's bend (2,), from points as seen and a pose that fits them but for the bend."""
        s = self.settings
        prior = self.covariance + np.eye(2) * VIBRATION_PER_M**2
        information = _LOOSE.copy()
        information[3:, 3:] = np.linalg.inv(prior)
        start = np.array([*pose, *self.mean_per_m])
        state = start.copy()
        widths = [FIRST_WIDTH_M] * FIRST_ITERATIONS + [WIDTH_M] * ITERATIONS
        covariances_m2 = np.ascontiguousarray(points.covariances_m2)  # another layout would be compiled for again
        for width_m in widths:
            matrix, vector = normal_equations(
                points.positions_m, covariances_m2, state, s.height_m, width_m, MIN_NOISE_M, self._lines
            )
            state = state + np.linalg.solve(matrix + information, vector + information @ (start - state))
        bend = state[3:]
        if not np.all(np.isfinite(bend)):
            return self.mean_per_m
        posterior = np.linalg.inv(matrix + information)[3:, 3:]
        self._shaking += SHAKING_GAIN * (float(np.square(bend - self.mean_per_m).sum()) - self._shaking)
        self._learn(bend, posterior, information[3:, 3:])
        return np.asarray(bend)

    def _learn(self, bend: FloatArray, posterior: FloatArray, prior_information: FloatArray) -> None:
        """Kalman update of the mean by what this frame alone has said (the posterior without its prior)."""
        information = np.linalg.inv(posterior)
        own = information - prior_information + np.eye(2) * 1e-3
        measured = self.mean_per_m + np.linalg.solve(own, information @ (bend - self.mean_per_m))
        spread = np.linalg.inv(own) + np.eye(2) * VIBRATION_PER_M**2
        gain = self.covariance @ np.linalg.inv(self.covariance + spread)
        self.mean_per_m = self.mean_per_m + gain @ (measured - self.mean_per_m)
        self.covariance = (np.eye(2) - gain) @ self.covariance + np.eye(2) * DRIFT_PER_M**2


def bent(positions_m: FloatArray, bend_per_m: FloatArray, height_m: float) -> FloatArray:
    """Points (N, 2) moved by (g·p) p + h² g, g (2,) in 1/m, h in m."""
    moved: FloatArray = positions_m * (1.0 + positions_m @ bend_per_m)[:, np.newaxis] + height_m**2 * bend_per_m
    return moved


@njit(cache=True)
def normal_equations(points, covariances, state, height_m, width_m, least_noise_m, lines):  # type: ignore[no-untyped-def]
    """Robust Gauss-Newton equations of the distances to the lines: matrix (5, 5) and vector (5,) of a step.

    points (N, 2) and covariances (N, 2, 2): as seen, robot frame, m. state: x, y, heading (field frame; m, rad) and the
    bend g (1/m). height_m: of the mirror. width_m: c of the error function. lines: LineTables.
    """
    matrix = np.zeros((5, 5))
    vector = np.zeros(5)
    row = np.empty(5)
    square = height_m * height_m
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    for i in range(len(points)):
        px, py = points[i, 0], points[i, 1]
        stretch = 1.0 + state[3] * px + state[4] * py
        bx, by = stretch * px + square * state[3], stretch * py + square * state[4]
        fx, fy = state[0] + cosine * bx - sine * by, state[1] + sine * bx + cosine * by
        distance, line_x, line_y = nearest_line_point(lines, fx, fy)
        if distance < 1e-7:
            continue
        nx, ny = (fx - line_x) / distance, (fy - line_y) / distance
        rx, ry = cosine * nx + sine * ny, -sine * nx + cosine * ny  # the normal in the robot frame
        radial = rx * px + ry * py
        row[0], row[1] = nx, ny
        row[2] = ry * bx - rx * by
        row[3], row[4] = radial * px + square * rx, radial * py + square * ry
        variance = least_noise_m * least_noise_m + (
            rx * rx * covariances[i, 0, 0] + 2.0 * rx * ry * covariances[i, 0, 1] + ry * ry * covariances[i, 1, 1]
        )
        influence = width_m * width_m / (width_m * width_m + distance * distance)
        weight = influence * influence / variance
        for a in range(5):
            vector[a] -= weight * row[a] * distance
            for b in range(5):
                matrix[a, b] += weight * row[a] * row[b]
    return matrix, vector
