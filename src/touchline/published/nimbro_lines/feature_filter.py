"""A pose by least squares on features, about a mode of the particles: an iterated Kalman filter that knows the lean.

An addition of ours to Schulz and Behnke 2012. All features of a frame share the error of the camera's roll and pitch,
so it is estimated with the pose, from a slow part that stays from frame to frame (a camera that is mounted a little
askew) and a fast one (an IMU that is late). Each feature counts by how likely it is one of the field's (section 5.3).
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field.association import AssociationTables
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.registration.feature_model import FeatureView, best_line, best_place, line_table
from touchline.motion.driven import EXACT_SCALES, driven
from touchline.motion.odometry import Motion

_ITERATIONS = 3
NEW_RATIO = 0.5  # how much of a frame's features is new: errors of lens and paint come again in the next one
MIN_POSITION_M = 0.02  # smallest believed standard deviation of x and y
MIN_HEADING_RAD = 0.02  # the same of the heading: nothing tells by how much a camera is mounted aside
MOUNT_RAD = 0.012  # how far a camera is mounted askew: 0.7° at a robot of today
MOUNT_DRIFT_RAD = 0.0003  # how much of that changes from frame to frame


class Explained(NamedTuple):
    """How much of a frame's features a pose explains: their number by confidence and probability, of how many.

    residual_m: their mean error (m), by the same weights; NaN without any. information: (3, 3) that they alone hold on
    x, y (m), heading (rad), field frame.
    """

    features: float
    of: float
    residual_m: float
    information: FloatArray


class FeatureFilter:
    """Pose and covariance (3, 3) in (m, m, rad), field frame; `lean` (2,): roll and pitch that stay (rad)."""

    def __init__(
        self,
        tables: AssociationTables,
        lines: FloatArray,
        height_m: float,
        lean_rad: float,
    ) -> None:
        """lines: (S, 5), `field_lines`. height_m: of the camera. lean_rad: fast error of its roll and pitch."""
        self.tables, self.lines = tables, lines
        self.height_m, self.lean_rad = height_m, lean_rad
        self.start(Pose(0.0, 0.0, 0.0), np.eye(3))
        self.forget_lean()

    def start(self, pose: Pose, covariance: FloatArray) -> None:
        """Start anew from a pose; what is known of the lean stays."""
        self.pose = pose
        self.covariance = np.array(covariance, dtype=np.float64)

    def forget_lean(self) -> None:
        """Nothing is known of the lean."""
        self.lean, self.lean_covariance = np.zeros(2), np.eye(2) * MOUNT_RAD**2

    def predict(self, motion: Motion, deviations: FloatArray) -> None:
        """Move by the odometry; deviations (3,): of the motion, robot frame (m, m, rad)."""
        step = driven(self.pose, EXACT_SCALES, motion.pose)
        self.pose, turn = step.pose, step.by_motion
        self.covariance = step.by_pose @ self.covariance @ step.by_pose.T + (turn * deviations**2) @ turn.T
        self.lean_covariance = self.lean_covariance + np.eye(2) * MOUNT_DRIFT_RAD**2

    def update(self, view: FeatureView, near: Pose | None = None) -> Explained:
        """Fuse the features of a frame, each taken for what it most likely is from a pose near the prediction.

        near: that pose, by default the prediction, which may be too far off to tell what is what.
        """
        if view.size == 0:
            return self.explained(view, self.pose)
        prior = np.zeros((5, 5))
        lean_prior = self.lean_covariance + np.eye(2) * self.lean_rad**2
        prior[:3, :3] = np.linalg.inv(self.covariance)
        prior[3:, 3:] = np.linalg.inv(lean_prior)
        before = np.array([*self.pose, 0.0, 0.0])  # the view knows the lean so far
        state = before.copy()
        if near is not None:
            state[:3] = near.x, near.y, self.pose.heading + wrap_angle(near.heading - self.pose.heading)
        for _ in range(_ITERATIONS):
            normal, right, explained = self._sum(state, view)
            off = before - state
            off[2] = wrap_angle(off[2])
            information = NEW_RATIO * normal + prior
            state += np.linalg.solve(information, NEW_RATIO * right + prior @ off)
        self._take(state, np.linalg.inv(information), lean_prior)
        return Explained(*explained, NEW_RATIO * normal[:3, :3])

    def explained(self, view: FeatureView, pose: Pose) -> Explained:
        """How much of a frame's features another pose explains."""
        normal, _, explained = self._sum(np.array([*pose, 0.0, 0.0]), view)
        return Explained(*explained, NEW_RATIO * normal[:3, :3])

    def _sum(self, state: FloatArray, view: FeatureView) -> tuple[FloatArray, FloatArray, tuple[float, float, float]]:
        normal, right, found = np.zeros((5, 5)), np.zeros(5), np.zeros(3)
        if len(view.points.positions_m):
            add_points(state, view.points, self.tables, self.height_m, normal, right, found)
        if len(view.lines.ends_m) and len(self.lines):
            add_lines(state, view.lines, self.lines, self.height_m, normal, right, found)
        count = float(view.points.trust.sum() + view.lines.trust.sum())
        return normal, right, (found[0], count, found[1] / found[2] if found[2] > 0.0 else math.nan)

    def _take(self, state: FloatArray, covariance: FloatArray, lean_prior: FloatArray) -> None:
        self.pose = Pose(float(state[0]), float(state[1]), wrap_angle(float(state[2])))
        floor = np.array([MIN_POSITION_M, MIN_POSITION_M, MIN_HEADING_RAD]) ** 2
        self.covariance = covariance[:3, :3] + np.diag(np.maximum(floor - np.diag(covariance)[:3], 0.0))
        gain = self.lean_covariance @ np.linalg.inv(lean_prior)
        self.lean = self.lean + gain @ state[3:]
        self.lean_covariance = self.lean_covariance - gain @ (lean_prior - covariance[3:, 3:]) @ gain.T


@numba.njit(cache=True)
def add_row(row, residual, information, normal, right):  # type: ignore[no-untyped-def]
    """Add a residual with its derivative row (5,) to the normal equations (5, 5), (5,)."""
    for a in range(5):
        right[a] -= information * row[a] * residual
        for b in range(5):
            normal[a, b] += information * row[a] * row[b]


@numba.njit(cache=True)
def lean_moves(x, y, height):  # type: ignore[no-untyped-def]
    """By how much a ground point moves per rad of roll and of pitch: x and y of each (m)."""
    return -x * y / height, -height - y * y / height, height + x * x / height, x * y / height


@numba.njit(cache=True)
def add_points(state, points, tables, height, normal, right, found):  # type: ignore[no-untyped-def]
    """Add the point features, seen from state (5,): x, y, heading, roll, pitch.

    found (3,): explained features, sum of weighted errors (m), sum of weights.
    """
    row_x, row_y = np.empty(5), np.empty(5)
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    pose = (state[0], state[1], state[2], cosine, sine)
    for i in range(points.positions_m.shape[0]):
        place, least, total = best_place(points, i, tables, False, pose)
        if place < 0:
            continue
        likely = points.peaks[i] * math.exp(-least)
        weight = likely / (points.peaks[i] * total + points.floors[i])  # less where it may be another one as well
        x, y = points.positions_m[i, 0], points.positions_m[i, 1]
        rx, ry, px, py = lean_moves(x, y, height)
        dx, dy = tables.places_m[place, 0] - state[0], tables.places_m[place, 1] - state[1]
        ahead, left = cosine * dx + sine * dy, cosine * dy - sine * dx
        off_x = x - state[3] * rx - state[4] * px - ahead
        off_y = y - state[3] * ry - state[4] * py - left
        row_x[0], row_x[1], row_x[2], row_x[3], row_x[4] = cosine, sine, -left, -rx, -px
        row_y[0], row_y[1], row_y[2], row_y[3], row_y[4] = -sine, cosine, ahead, -ry, -py
        # whiten by the Cholesky factor of the information
        w = points.own_information[i]
        a = math.sqrt(w[0, 0])
        b = w[0, 1] / a
        c = math.sqrt(max(w[1, 1] - b * b, 0.0))
        add_row(a * row_x + b * row_y, a * off_x + b * off_y, weight, normal, right)
        add_row(c * row_y, c * off_y, weight, normal, right)
        found[0] += points.trust[i] * likely / (likely + points.floors[i])
        found[1] += weight * math.sqrt(off_x * off_x + off_y * off_y)
        found[2] += weight


@numba.njit(cache=True)
def add_lines(state, lines, field, height, normal, right, found):  # type: ignore[no-untyped-def]
    """Add the lines; arguments as of `add_points`."""
    row, turn_row = np.empty(5), np.empty(5)
    cosine, sine = math.cos(state[2]), math.sin(state[2])
    pose = (state[0], state[1], state[2], cosine, sine)
    seen = line_table(lines)
    for i in range(lines.ends_m.shape[0]):
        k, least = best_line(seen, i, field, False, pose)
        if k < 0:
            continue
        likely = lines.peaks[i] * math.exp(-least)
        weight = likely / (likely + lines.floors[i])
        x1, y1, x2, y2 = lines.ends_m[i, 0, 0], lines.ends_m[i, 0, 1], lines.ends_m[i, 1, 0], lines.ends_m[i, 1, 1]
        ax, ay, bx, by = lean_moves(x1, y1, height)
        cx, cy, ex, ey = lean_moves(x2, y2, height)
        x1, y1 = x1 - state[3] * ax - state[4] * bx, y1 - state[3] * ay - state[4] * by
        x2, y2 = x2 - state[3] * cx - state[4] * ex, y2 - state[3] * cy - state[4] * ey
        x, y, dx, dy = 0.5 * (x1 + x2), 0.5 * (y1 + y2), x2 - x1, y2 - y1
        length = math.sqrt(dx * dx + dy * dy)
        # the field line's normal in the robot frame
        ux, uy = field[k, 0], field[k, 1]
        nx, ny = -cosine * uy + sine * ux, sine * uy + cosine * ux
        off = ux * state[1] - uy * state[0] - field[k, 2] + nx * x + ny * y
        row[0], row[1], row[2] = -uy, ux, ny * x - nx * y
        row[3] = -0.5 * (nx * (ax + cx) + ny * (ay + cy))
        row[4] = -0.5 * (nx * (bx + ex) + ny * (by + ey))
        add_row(row, off, weight / lines.own_sigmas[i, 0] ** 2, normal, right)
        # sine of the angle between both, the same whichever end is first
        facing = 1.0 if dx * ny - dy * nx > 0.0 else -1.0
        turned = facing * (nx * dx + ny * dy) / length
        turn_row[0], turn_row[1], turn_row[2] = 0.0, 0.0, facing * (ny * dx - nx * dy) / length
        turn_row[3] = -facing * (nx * (cx - ax) + ny * (cy - ay)) / length
        turn_row[4] = -facing * (nx * (ex - bx) + ny * (ey - by)) / length
        add_row(turn_row, turned, weight / lines.own_sigmas[i, 1] ** 2, normal, right)
        found[0] += lines.trust[i] * weight
        found[1] += weight * abs(off)
        found[2] += weight
