"""Bundle adjustment of a perspective camera from line points in images taken at places that nobody measured.

What all images share: focal length, principal point, a lens's distortion, roll, pitch and height, and how far each of
the field's lines lies beside where the field's file has it. Each image has its pose, and a lean of its own. Residuals
are the distances of line points from the nearest line, in units of what a pixel is on the ground there; robust steps
begin wide and narrow (as in `registration`). How noisy points are, how much the body leans from image to image and how
well the field is drawn is learned on the way.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.bundle import NormalEquations, entries, prior_block, residual_block
from touchline.calibration.nearest_line import nearest_line
from touchline.camera import FisheyeCamera, PerspectiveCamera, PinholeCamera
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray, IndexArray, Pose, Pose3

NAMES = (
    "roll", "pitch", "height", "focal length", "distortion", "centre u", "centre v", "second distortion",
    "third distortion", "fourth distortion",
)  # fmt: skip
ROLL, PITCH, HEIGHT, FOCAL, DISTORTION, CENTER_U, CENTER_V, LENS = range(8)
_CAMERA = len(NAMES)
_NOISE_PX, _MIN_NOISE_PX, _GROUND_M = 0.5, 0.1, 0.002  # of a line point, at first and at least; and of the carpet
_CENTER_RATIO = 0.0025  # deviation of the centre, per image width, before anything is seen
# ... of the distortion: k1, k2 (a pinhole's less k1²), then p1, p2 of a pinhole, k3, k4 of a fisheye
_DISTORTIONS = {"pinhole": (0.2, 0.1, 0.001, 0.001), "fisheye": (0.2, 0.05, 0.02, 0.005)}
_LEAN_RAD, _MIN_LEAN_RAD = 0.006, 0.001  # of an image's own roll and pitch, at first and at least
_PAINT_M, _MIN_PAINT_M = 0.01, 0.001  # of a line's place beside the drawing's, at first and at least
_ANYWHERE = 1e-6  # information of what nothing is known of
_WIDTHS_M = (0.4, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0)
_NEAR_M = 0.1  # the first width from a start that has been fitted before
# how far a start may be off (standard deviations): wrong poses of a few images must not take the camera with them
_START = {ROLL: 0.05, PITCH: 0.05, HEIGHT: 0.1, FOCAL: 0.1}
_GATE2 = 9.0  # squared standard deviations at which a point counts a quarter
_MEDIAN = 0.455  # of squares of standard normal numbers
_REPEATED = 3.0  # neighbours on a line err together: of so many points one counts
_NOWHERE = 1e9  # squared distance of a point above the horizon
_ON_LINE_M, _ON_LINE_PX = 0.03, 1.5  # within either (together: their hypotenuse) a point lies on a line
_STEP = 1e-5
_OWN = 5


class PerspectiveView(NamedTuple):
    """An image's line points, pixels (N, 2), and the pose that it was taken at, about."""

    pixels: FloatArray
    pose: Pose


class PerspectiveFit(NamedTuple):
    """state (10,): NAMES, focal length and height as logarithms. covariance (10, 10). poses (V, 3). on_lines (V,):
    share of each view's points that lie on lines. cost: mean robust squared residual, 0 to 1. Standard deviations that
    were learned: lean_rad of an image's own roll and pitch, noise_px of points, paint_m of lines beside the file's.
    """

    state: FloatArray
    covariance: FloatArray
    poses: FloatArray
    on_lines: FloatArray
    cost: float
    lean_rad: float
    noise_px: float
    paint_m: float


def camera_at(
    model: str, size: tuple[int, int], state: FloatArray, lean: FloatArray | None = None
) -> PerspectiveCamera:
    """The camera of a state (10,) for images of a size (width, height), its body leaning by roll and pitch (2,)."""
    roll, pitch, height, focal, bent, u, v, second, third, fourth = state.tolist()
    own_roll, own_pitch = (0.0, 0.0) if lean is None else lean.tolist()
    mount = Pose3.from_roll_pitch_yaw(roll + own_roll, pitch + own_pitch, 0.0, (0.0, 0.0, math.exp(height)))
    f, (cx, cy) = math.exp(focal), 0.5 * (np.array(size) - 1.0) + (u, v)
    if model == "fisheye":
        return FisheyeCamera(*size, f, f, float(cx), float(cy), np.array([bent, second, third, fourth]), mount)
    lens = np.array([bent, bent**2 + second, third, fourth, 0.0])
    return PinholeCamera(*size, f, f, float(cx), float(cy), lens, mount)


class _Bundle:
    """paint: entries (L + 1,) of how far (m) a line lies to its normal's side, the last of all to their outer edges."""

    def __init__(self, views: Sequence[PerspectiveView], field: FieldModel, model: str, size: tuple[int, int]) -> None:
        self.views, self.model, self.size, self._tables = views, model, size, field.line_tables
        self.outward = _outward(field)
        self.shared, self.own = entries(_CAMERA + len(self.outward) + 1, len(views), _OWN)
        self.camera, self.paint = self.shared[:_CAMERA], self.shared[_CAMERA:]

    def ground(self, pixels: FloatArray, state: FloatArray) -> FloatArray:
        """Ground points (N, 2) of pixels; state (15,): pose, lean, camera."""
        camera = camera_at(self.model, self.size, state[_OWN:], state[3:_OWN])
        return Pose(*state[:3].tolist()).transform(camera.ground_from_image(pixels))

    def linear(
        self, view: PerspectiveView, state: FloatArray, paint: FloatArray, noise_px: float, width_m: float
    ) -> tuple[FloatArray, ...]:
        """Of a view's points: derivatives (N, 15 + L + 1), distances (N,) (m), weights (N,), squared residuals (N,), of
        those that lie on the ground; of all how far they are off, squared, in units of what a point on a line may be.
        """
        placed = self.ground(view.pixels, state)
        seen = np.isfinite(placed).all(axis=1)
        pixels, placed = view.pixels[seen], placed[seen]
        near = nearest_line(self._tables, placed)
        rows = np.zeros((len(placed), len(state) + len(paint)))
        for j in range(len(state)):
            moved = state.copy()
            moved[j] += _STEP
            rows[:, j] = np.nan_to_num(((self.ground(pixels, moved) - placed) * near.normal).sum(axis=1)) / _STEP
        aside = np.where(near.is_beyond, 0.0, -1.0)
        rows[np.arange(len(placed)), len(state) + near.line] = aside
        rows[:, -1] = aside * self.outward[near.line]
        distances_m = near.distance_m + rows[:, len(state) :] @ paint
        on_ground = np.stack([self.ground(pixels + step, state) - placed for step in np.eye(2)], axis=-1)
        per_px2 = np.square(np.nan_to_num(np.einsum("ni,nij->nj", near.normal, on_ground), nan=1.0)).sum(axis=1)
        variances = _GROUND_M**2 + noise_px**2 * per_px2
        squares = distances_m**2 / variances
        robust = np.square(1.0 + squares * variances / (width_m**2 + _GATE2 * variances))
        off = np.full(len(view.pixels), _NOWHERE)
        off[seen] = distances_m**2 / (_ON_LINE_M**2 + _ON_LINE_PX**2 * per_px2)
        return rows, distances_m, 1.0 / (robust * variances * _REPEATED), squares, off


def _outward(field: FieldModel) -> FloatArray:
    """(L,) to which side of its normal (1, -1) each line's outer edge is: that of the field, an area or a circle."""
    x1, y1, x2, y2 = field.segments.T
    across = np.abs(x2 - x1) < np.abs(y2 - y1)
    front = across & (np.abs(x1) < np.abs(x1).max(initial=0.0) - 1e-6)  # of an area: outside is towards the middle
    side = np.sign(np.round((y1 - y2) * (x1 + x2) + (x2 - x1) * (y1 + y2), 6))
    return np.concatenate((np.where(front, -side, side), np.ones(len(field.circles) + len(field.arcs))))


def fit_perspective(
    views: Sequence[PerspectiveView],
    start: FloatArray,
    field: FieldModel,
    model: str,
    size: tuple[int, int],
    again: bool = False,
) -> PerspectiveFit:
    """The camera at which all views' points lie best on the field's lines, from a state (10,) that is near; again: and
    has been fitted before.
    """
    bundle = _Bundle(views, field, model, size)
    shared, own, camera, paint = bundle.shared, bundle.own, bundle.camera, bundle.paint
    state, lean_rad, noise_px, paint_m = np.zeros(own[-1, -1] + 1), _LEAN_RAD, _NOISE_PX, _PAINT_M
    state[camera] = start
    state[own[:, :3]] = [one.pose.as_array() for one in views]
    known, mean = np.zeros(_CAMERA), np.zeros(_CAMERA)
    for k, deviation in _START.items():
        known[k], mean[k] = deviation**-2.0, start[k]
    known[[DISTORTION, *range(LENS, _CAMERA)]] = np.power(_DISTORTIONS[model], -2.0)
    known[[CENTER_U, CENTER_V]] = (_CENTER_RATIO * size[0]) ** -2.0
    for width_m in [width for width in _WIDTHS_M if not again or width <= _NEAR_M]:
        own_known = np.array([_ANYWHERE] * 3 + [lean_rad**-2.0] * 2)
        drawn = np.full(len(paint), paint_m**-2.0)
        drawn[-1] = (0.5 * field.line_width) ** -2.0
        blocks = [prior_block(camera, known, state[camera] - mean), prior_block(paint, drawn, state[paint])]
        squares, offs = [], []
        for view, mine in zip(views, own, strict=True):
            at = np.concatenate((mine, shared))
            *parts, square, off = bundle.linear(view, state[at[: _OWN + _CAMERA]], state[paint], noise_px, width_m)
            squares.append(square)
            offs.append(off)
            blocks.append(residual_block(at, *parts))
            blocks.append(prior_block(mine, own_known, state[mine] * (own_known > _ANYWHERE)))
        equations = NormalEquations(blocks)
        state = state + np.clip(equations.step(), -0.2, 0.2)
        if width_m < 0.05:
            flat = np.concatenate(squares)
            if not len(flat):
                raise NoFitError("no line point lies on the ground")
            noise_px = max(noise_px * math.sqrt(float(np.median(flat)) / _MEDIAN), _MIN_NOISE_PX)
            lean_rad = _spread(equations, own[:, 3:].ravel(), state, _MIN_LEAN_RAD)
            paint_m = _spread(equations, paint[:-1], state, _MIN_PAINT_M)
    on_lines = np.array([np.mean(off < 1.0) for off in offs])
    flat = np.concatenate(offs)
    cost = float(np.mean(flat / (1.0 + flat)))
    return PerspectiveFit(
        state[camera], equations.covariance(camera), state[own[:, :3]], on_lines, cost, lean_rad, noise_px, paint_m
    )


def _spread(equations: NormalEquations, at: IndexArray, state: FloatArray, least: float) -> float:
    """The standard deviation of entries that are drawn alike, which makes what they came to most probable."""
    variances = state[at] ** 2 + np.diag(equations.covariance(at))
    return max(math.sqrt(float(variances.mean())), least)
