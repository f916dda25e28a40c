"""Where to look: the direction of the head whose view would tell the most of where the robot stands.

Two things count, both in nats: by how much the lines, crossings, posts and marks that would be seen shrink the pose's
covariance, and how clearly they would tell the pose from the other hypotheses.
"""

import math

import numpy as np
from numba import njit

from touchline.field import FieldModel
from touchline.types import Estimate, Look

BEARINGS = np.radians(np.arange(-90.0, 91.0, 15.0))  # ahead first where two are worth the same
HALF_VIEW_RAD = math.radians(32.0)
NEAR_M, REACH_M = 0.6, 6.0
NOISE_M, NOISE_RATIO = 0.05, 0.06  # of where something is seen: at no distance, and more of it
STEP_M = 0.6  # between places along lines; each counts as one measurement across the line
MAX_MISMATCH, MAX_TELLING = 3.0, 12.0  # nats of one thing that another hypothesis does not show, and of a whole view
MAX_HYPOTHESES, MAX_NAMED = 6, 4
MIN_SPREAD = np.square([0.02, 0.02, 0.01])
_LINE, _MARK, _POST = 0, 1, 2  # kinds of things; crossings come behind


class Gaze:
    """Of one field; `of` takes well under 0.2 ms."""

    def __init__(self, field: FieldModel) -> None:
        rows, self._names = [], []
        kinds = sorted({crossing.kind for crossing in field.crossings})
        for one in field.crossings:
            rows.append((one.x, one.y, _POST + 1 + kinds.index(one.kind), 0.0, 0.0))
            self._names.append(f"{one.kind.name} crossing at {one.x:.1f}, {one.y:.1f}")
        for post in field.posts:
            rows.append((post.x, post.y, _POST, 0.0, 0.0))
            self._names.append(f"{post.kind} at {post.x:.1f}, {post.y:.1f}")
        for x, y, _ in field.discs:
            rows.append((float(x), float(y), _MARK, 0.0, 0.0))
            self._names.append(f"mark at {x:.1f}, {y:.1f}")
        for line in field.polylines(STEP_M):
            along = np.diff(line, axis=0)
            length = np.hypot(*along.T)
            middle, known = 0.5 * (line[1:] + line[:-1]), length > 0.1
            normal = np.column_stack((-along[:, 1], along[:, 0]))[known] / length[known, None]
            rows += [(*place, _LINE, *across) for place, across in zip(middle[known], normal, strict=True)]
        self._things = np.array(rows, dtype=np.float64).reshape(-1, 5)

    def of(self, estimate: Estimate) -> Look | None:
        """The best direction for what is believed now; None where no pose is."""
        others = [other for other in estimate.hypotheses if other.probability][:MAX_HYPOTHESES]
        poses = np.array([estimate.pose, *(other.pose for other in others)])
        weights = np.array([estimate.probability or 0.0, *(other.probability for other in others)])
        covariance = np.asarray(estimate.covariance) + np.diag(MIN_SPREAD)
        scores, seen = view_scores(self._things, poses, weights, covariance, BEARINGS)
        best = int(np.argmax(scores - 0.01 * np.abs(BEARINGS)))
        if scores[best] <= 0.0:
            return None
        shown = np.flatnonzero(seen[: len(self._names)] & (1 << best))
        near = sorted(
            shown, key=lambda k: (self._things[k, 0] - poses[0, 0]) ** 2 + (self._things[k, 1] - poses[0, 1]) ** 2
        )
        return Look(float(BEARINGS[best]), tuple(self._names[k] for k in near[:MAX_NAMED]), float(scores[best]))


@njit(cache=True)
def view_scores(things, poses, weights, covariance, bearings):  # type: ignore[no-untyped-def]
    """Nats (B,) that looking at each bearing (B,) tells, and by bits (T,) at which of them a thing is seen.

    things (T, 5): x, y, kind, normal of a line. poses (H, 3) with weights (H,): the first is the pose, with its
    covariance (3, 3).
    """
    count, many = len(things), len(bearings)
    information = np.zeros((many, 3, 3))
    telling = np.zeros(many)
    seen = np.zeros(count, dtype=np.int64)
    x0, y0, heading = poses[0]
    for i in range(count):
        x, y, kind = things[i, 0], things[i, 1], things[i, 2]
        dx, dy = x - x0, y - y0
        away = math.hypot(dx, dy)
        if not NEAR_M < away < REACH_M:
            continue
        bearing = math.atan2(dy, dx) - heading
        bearing -= 2.0 * math.pi * round(bearing / (2.0 * math.pi))
        sigma = NOISE_M + NOISE_RATIO * away
        apart = 0.0
        for h in range(1, len(poses)) if kind != _LINE else range(0):
            # where in the field the thing would be, were the robot there
            turn = poses[h, 2] - heading
            cosine, sine = math.cos(turn), math.sin(turn)
            there_x, there_y = poses[h, 0] + cosine * dx - sine * dy, poses[h, 1] + sine * dx + cosine * dy
            nearest2 = 1e9
            for j in range(count):
                if things[j, 2] == kind:
                    nearest2 = min(nearest2, (things[j, 0] - there_x) ** 2 + (things[j, 1] - there_y) ** 2)
            apart += weights[h] * min(0.5 * nearest2 / sigma**2, MAX_MISMATCH)
        for b in range(many):
            if abs(bearing - bearings[b]) > HALF_VIEW_RAD:
                continue
            seen[i] |= 1 << b
            telling[b] += apart
            for axis in range(2):  # a line shows one direction alone
                if kind == _LINE:
                    if axis == 1:
                        break
                    nx, ny = things[i, 3], things[i, 4]
                else:
                    nx, ny = 1.0 - axis, float(axis)
                row = np.array([nx, ny, ny * dx - nx * dy])
                for r in range(3):
                    for c in range(3):
                        information[b, r, c] += row[r] * row[c] / sigma**2
    scores = np.zeros(many)
    for b in range(many):
        shrunk = np.eye(3) + covariance @ information[b]
        scores[b] = 0.5 * math.log(max(np.linalg.det(shrunk), 1.0)) + min(telling[b], MAX_TELLING)
    return scores, seen
