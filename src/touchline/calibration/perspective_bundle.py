"""Bundle adjustment of a perspective camera from line points in images taken at places that nobody measured.

What all images share: focal length, principal point, a lens's first coefficient of distortion, roll, pitch and height.
Each image has its pose, and a lean of its own. Residuals are the distances of line points from the nearest line,
in units of what a pixel is on the ground there; robust steps begin wide and narrow (as in `registration`).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.bundle import NormalEquations, entries, prior_block, residual_block
from touchline.camera import FisheyeCamera, PerspectiveCamera, PinholeCamera
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, Pose3

NAMES = "roll", "pitch", "height", "focal length", "distortion", "centre u", "centre v"
ROLL, PITCH, HEIGHT, FOCAL, DISTORTION, CENTER_U, CENTER_V = range(len(NAMES))
_NOISE_PX, PAINT_M = 0.5, 0.01  # of a line point; how far paint lies beside where the field's drawing has it
_CENTER_RATIO, _DISTORTION = 0.003, 0.2  # deviations before: of the centre per image width, of the distortion
_LEAN_RAD, _MIN_LEAN_RAD = 0.006, 0.001  # of an image's own roll and pitch, at first and at least
_ANYWHERE = 1e-6  # information of what nothing is known of
_WIDTHS_M = (0.4, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0)
_NEAR_M = 0.1  # the first width from a start that has been fitted before
# how far a start may be off (standard deviations): wrong poses of a few images must not take the camera with them
_START = {ROLL: 0.05, PITCH: 0.05, HEIGHT: 0.1, FOCAL: 0.1}
_GATE2 = 9.0  # squared standard deviations at which a point counts a quarter
_REPEATED = 3.0  # neighbours on a line err together: of so many points one counts
_ON_LINE = 3.0  # standard deviations within which a point lies on a line
_STEP = 1e-5
_OWN = 5


class PerspectiveView(NamedTuple):
    """An image's line points, pixels (N, 2), and the pose that it was taken at, about."""

    pixels: FloatArray
    pose: Pose


class PerspectiveFit(NamedTuple):
    """state (7,): NAMES, focal length and height as logarithms. covariance (7, 7). poses (V, 3). on_lines (V,): share
    of each view's points that lie on lines. cost: mean robust squared residual. lean_rad: of an image's own roll and
    pitch.
    """

    state: FloatArray
    covariance: FloatArray
    poses: FloatArray
    on_lines: FloatArray
    cost: float
    lean_rad: float


def camera_at(
    model: str, size: tuple[int, int], state: FloatArray, lean: FloatArray | None = None
) -> PerspectiveCamera:
    """The camera of a state (7,) for images of a size (width, height), its body leaning by roll and pitch (2,)."""
    roll, pitch, height, focal, bent, u, v = state.tolist()
    own_roll, own_pitch = (0.0, 0.0) if lean is None else lean.tolist()
    mount = Pose3.from_roll_pitch_yaw(roll + own_roll, pitch + own_pitch, 0.0, (0.0, 0.0, math.exp(height)))
    f, (cx, cy) = math.exp(focal), 0.5 * (np.array(size) - 1.0) + (u, v)
    if model == "fisheye":
        return FisheyeCamera(*size, f, f, float(cx), float(cy), np.array([bent, 0.0, 0.0, 0.0]), mount)
    return PinholeCamera(*size, f, f, float(cx), float(cy), np.array([bent, bent**2, 0.0, 0.0, 0.0]), mount)


class _Bundle:
    def __init__(self, views: Sequence[PerspectiveView], field: FieldModel, model: str, size: tuple[int, int]) -> None:
        self.views, self.model, self.size, self._map = views, model, size, field.distance_map()
        self.shared, self.own = entries(len(NAMES), len(views), _OWN)

    def ground(self, pixels: FloatArray, state: FloatArray) -> FloatArray:
        """Ground points (N, 2) of pixels; state (12,): pose, lean, shared."""
        camera = camera_at(self.model, self.size, state[_OWN:], state[3:_OWN])
        return Pose(*state[:3].tolist()).transform(camera.ground_from_image(pixels))

    def linear(self, view: PerspectiveView, state: FloatArray, width_m: float) -> tuple[FloatArray, ...]:
        """Of a view's points: derivatives (N, 12), distances (N,) (m), weights (N,) and squared residuals (N,)."""
        placed = self.ground(view.pixels, state)
        seen = np.isfinite(placed).all(axis=1)
        pixels, placed = view.pixels[seen], placed[seen]
        distances_m, slopes = self._map.look_up(placed)
        rows = np.empty((len(placed), len(state)))
        for j in range(len(state)):
            moved = state.copy()
            moved[j] += _STEP
            rows[:, j] = np.nan_to_num(((self.ground(pixels, moved) - placed) * slopes).sum(axis=1)) / _STEP
        on_ground = np.stack([self.ground(pixels + step, state) - placed for step in np.eye(2)], axis=-1)
        per_px = np.nan_to_num(np.einsum("ni,nij->nj", slopes, on_ground), nan=1.0)
        variances = PAINT_M**2 + _NOISE_PX**2 * (per_px**2).sum(axis=1)
        squares = distances_m**2 / variances
        robust = np.square(1.0 + squares * variances / (width_m**2 + _GATE2 * variances)) if width_m < math.inf else 1.0
        return rows, distances_m, 1.0 / (robust * variances * _REPEATED), squares


def fit_perspective(
    views: Sequence[PerspectiveView],
    start: FloatArray,
    field: FieldModel,
    model: str,
    size: tuple[int, int],
    again: bool = False,
) -> PerspectiveFit:
    """The camera at which all views' points lie best on the field's lines, from a state (7,) that is near; again: and
    has been fitted before.
    """
    bundle = _Bundle(views, field, model, size)
    shared, own = bundle.shared, bundle.own
    state, lean_rad, noise = np.zeros(own[-1, -1] + 1), _LEAN_RAD, 1.0
    state[shared] = start
    state[own[:, :3]] = [one.pose.as_array() for one in views]
    known, mean = np.zeros(len(NAMES)), np.zeros(len(NAMES))
    for k, deviation in _START.items():
        known[k], mean[k] = deviation**-2.0, start[k]
    known[DISTORTION], known[CENTER_U:] = _DISTORTION**-2.0, (_CENTER_RATIO * size[0]) ** -2.0
    for width_m in [width for width in _WIDTHS_M if not again or width <= _NEAR_M]:
        own_known = np.array([_ANYWHERE] * 3 + [lean_rad**-2.0] * 2)
        blocks = [prior_block(shared, known, state[shared] - mean)]
        squares = []
        for view, mine in zip(views, own, strict=True):
            at = np.concatenate((mine, shared))
            *parts, square = bundle.linear(view, state[at], width_m)
            squares.append(square)
            blocks.append(residual_block(at, *parts).divided(noise))
            blocks.append(prior_block(mine, own_known, state[mine] * (own_known > _ANYWHERE)))
        equations = NormalEquations(blocks)
        state = state + np.clip(equations.step(), -0.2, 0.2)
        leans = state[own[:, 3:]]
        if width_m < 0.05:
            flat = np.concatenate(squares)
            noise = max(float(np.mean(flat[flat < _ON_LINE**2])), 0.2)
            spread = [np.diag(equations.covariance(mine[3:])) for mine in own]
            lean_rad = max(math.sqrt(float(np.mean(leans**2 + spread))), _MIN_LEAN_RAD)
    flat = np.concatenate(squares)
    on_lines = np.array([np.mean(one < _ON_LINE**2 * max(noise, 1.0)) for one in squares])
    cost = float(np.mean(flat / (1.0 + flat / _GATE2)))
    covariance = equations.covariance(shared)
    return PerspectiveFit(state[shared], covariance, state[own[:, :3]], on_lines, cost, lean_rad)
