"""Bundle adjustment of a perspective camera from line points in images taken at places that nobody measured.

What all images share: focal length, principal point, a lens's distortion, roll, pitch and height, and how far each of
the field's lines lies beside where the field's file has it. Each image has its pose, and a lean and a height of its
own: a body that steps bobs, and one height for all would bend the focal length. Residuals are the distances of line
points from the nearest line, in units of what a pixel is on the ground there; robust steps begin wide and narrow (as in
`registration`). How noisy points are, how much the body sways from image to image and how well the field is drawn is
learned on the way.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.bundle import Block, NormalEquations, entries, prior_block, residual_block
from touchline.calibration.nearest_line import nearest_line, outward
from touchline.camera import FisheyeCamera, PerspectiveCamera, PinholeCamera
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray, IndexArray, Pose, Pose3, as_pose

NAMES = (
    "roll", "pitch", "height", "focal length", "distortion", "centre u", "centre v", "second distortion",
    "third distortion", "fourth distortion",
)  # fmt: skip
ROLL, PITCH, HEIGHT, FOCAL, DISTORTION, CENTER_U, CENTER_V, LENS = range(8)
_CAMERA = len(NAMES)
_GROUND_M = 0.002  # of the carpet
_CENTER_RATIO = 0.01  # deviation of the centre, per image width, before anything is seen: of cameras as bought
# ... of the distortion: k1, k2 (a pinhole's less k1²), then p1, p2 of a pinhole, k3, k4 of a fisheye
_DISTORTIONS = {"pinhole": (0.2, 0.1, 0.001, 0.001), "fisheye": (0.2, 0.05, 0.02, 0.005)}
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
_DOUBT = 4.0  # an image whose points are off by more than others', squared, counts as much less: its pose may be wrong
_DAMPING, _TRIALS = 1e-4, 4  # of Levenberg and Marquardt, at first; steps that are tried at one width
_FAR_M = 0.05  # width below which noise, lean and paint are learned
_STEP = 1e-5
_LEAN, _LEANS, _OWN = 3, 3, 6  # an image's own entries: where its lean begins, of how many it is, and all


class Stand(NamedTuple):
    """Where an image was taken, about, and how the body leant then: roll, pitch, logarithm of the height ratio (3,)."""

    pose: Pose
    lean: FloatArray


class PerspectiveView(NamedTuple):
    """An image's line points, pixels (N, 2), and where it was taken."""

    pixels: FloatArray
    stand: Stand


class Learned(NamedTuple):
    """Standard deviations that are learned: of images' own rolls, pitches, heights, points, lines beside the file's."""

    roll_rad: float
    pitch_rad: float
    height_ratio: float
    noise_px: float
    paint_m: float


_AT_FIRST, _AT_LEAST = Learned(0.006, 0.006, 0.006, 0.5, 0.01), Learned(0.001, 0.001, 0.0005, 0.1, 0.001)


class PerspectiveFit(NamedTuple):
    """state (10,): NAMES, focal length and height as logarithms. covariance (10, 10). stands: of all views. on_lines
    (V,): share of each view's points that lie on lines. cost: mean robust squared residual, 0 to 1.
    """

    state: FloatArray
    covariance: FloatArray
    stands: list[Stand]
    on_lines: FloatArray
    cost: float
    learned: Learned


def camera_at(
    model: str, size: tuple[int, int], state: FloatArray, lean: FloatArray | None = None
) -> PerspectiveCamera:
    """The camera of a state (10,) for images of a size (width, height), its body leaning as of `Stand` (3,)."""
    roll, pitch, height, focal, bent, u, v, second, third, fourth = state.tolist()
    own_roll, own_pitch, higher = (0.0, 0.0, 0.0) if lean is None else lean.tolist()
    mount = Pose3.from_roll_pitch_yaw(roll + own_roll, pitch + own_pitch, 0.0, (0.0, 0.0, math.exp(height + higher)))
    f, (cx, cy) = math.exp(focal), 0.5 * (np.array(size) - 1.0) + (u, v)
    if model == "fisheye":
        return FisheyeCamera(*size, f, f, float(cx), float(cy), np.array([bent, second, third, fourth]), mount)
    lens = np.array([bent, bent**2 + second, third, fourth, 0.0])
    return PinholeCamera(*size, f, f, float(cx), float(cy), lens, mount)


class _Seen(NamedTuple):
    """A view's points. off: of all, how far they are off, squared, in units of what a point on a line may be. cost:
    twice the negative log-likelihood of all. Of those that lie on the ground: pixels (N, 2), ground (N, 2) (field
    frame), normal (N, 2) of the nearest line, aside (N, L + 1): distances' derivatives by paint, distances_m, weights,
    squares (N,): squared residuals.
    """

    off: FloatArray
    cost: float
    pixels: FloatArray
    ground: FloatArray
    normal: FloatArray
    aside: FloatArray
    distances_m: FloatArray
    weights: FloatArray
    squares: FloatArray


class _Linearised(NamedTuple):
    """All views' points at a state, by what each view counts less (V,), the normal equations and the cost."""

    seen: list[_Seen]
    doubts: FloatArray
    blocks: list[Block]
    cost: float


class _Bundle:
    """mean (P,): the state that is expected. camera: the camera's entries. own (V, 6): each view's pose and lean. paint
    (L + 1,): how far (m) a line lies to its normal's side, the last of all to their outer edges.
    """

    def __init__(
        self,
        views: Sequence[PerspectiveView],
        start: FloatArray,
        field: FieldModel,
        model: str,
        size: tuple[int, int],
    ) -> None:
        self.views, self.model, self.size, self._tables = views, model, size, field.line_tables
        self.outward = outward(field.line_tables)
        self.shared, self.own = entries(_CAMERA + len(self.outward) + 1, len(views), _OWN)
        self.camera, self.paint = self.shared[:_CAMERA], self.shared[_CAMERA:]
        self.mean = np.zeros(self.own[-1, -1] + 1)
        self.mean[list(_START)] = start[list(_START)]
        self.mean[self.own[:, :_LEAN]] = [one.stand.pose.as_array() for one in views]
        self._known = np.full(len(self.mean), _ANYWHERE)
        self._known[list(_START)] = np.power(list(_START.values()), -2.0)
        self._known[[DISTORTION, *range(LENS, _CAMERA)]] = np.power(_DISTORTIONS[model], -2.0)
        self._known[[CENTER_U, CENTER_V]] = (_CENTER_RATIO * size[0]) ** -2.0
        self._known[self.paint[-1]] = (0.5 * field.line_width) ** -2.0

    def known(self, learned: Learned) -> FloatArray:
        """Information (P,) on the state's entries before anything is seen."""
        known = self._known.copy()
        known[self.own[:, _LEAN:]] = np.power(learned[:_LEANS], -2.0)
        known[self.paint[:-1]] = learned.paint_m**-2.0
        return known

    def linearise(self, state: FloatArray, learned: Learned, width_m: float) -> _Linearised:
        """What a step is taken from, and judged by."""
        seen = self.look(state, learned, width_m)
        medians = np.array([np.median(one.off) for one in seen])
        doubts = np.maximum(medians / (_DOUBT * np.median(medians)), 1.0)
        prior = prior_block(np.arange(len(state)), self.known(learned), state - self.mean)
        blocks = [prior, *self._blocks(seen, doubts, state)]
        return _Linearised(seen, doubts, blocks, self.cost(seen, doubts, state, learned))

    def cost(self, seen: Sequence[_Seen], doubts: FloatArray, state: FloatArray, learned: Learned) -> float:
        """Twice the negative log-likelihood of all points and of a state (P,)."""
        points = sum(one.cost / doubt for one, doubt in zip(seen, doubts, strict=True))
        return float(points + self.known(learned) @ (state - self.mean) ** 2)

    def learn(self, state: FloatArray, learned: Learned, at: _Linearised) -> Learned:
        """The deviations that make what is seen, and what the entries that are drawn alike came to, most probable."""
        squares = np.concatenate([one.squares for one in at.seen])
        if not len(squares):
            raise NoFitError("no line point lies on the ground")
        equations = NormalEquations(at.blocks)
        found = [
            *(_spread(equations, self.own[:, _LEAN + k], state, _AT_FIRST[k]) for k in range(_LEANS)),
            learned.noise_px * math.sqrt(float(np.median(squares)) / _MEDIAN),
            _spread(equations, self.paint[:-1], state),
        ]
        return Learned(*np.maximum(found, _AT_LEAST).tolist())

    def ground(self, pixels: FloatArray, state: FloatArray) -> FloatArray:
        """Ground points (N, 2) of pixels; state (16,): pose, lean, camera."""
        camera = camera_at(self.model, self.size, state[_OWN:], state[_LEAN:_OWN])
        return Pose(*state[:_LEAN].tolist()).transform(camera.ground_from_image(pixels))

    def look(self, state: FloatArray, learned: Learned, width_m: float) -> list[_Seen]:
        """All views' points at a state."""
        paint = state[self.paint]
        return [
            self._seen(view.pixels, state[[*mine, *self.camera]], paint, learned.noise_px, width_m)
            for view, mine in zip(self.views, self.own, strict=True)
        ]

    def _seen(self, pixels: FloatArray, state: FloatArray, paint: FloatArray, noise_px: float, width_m: float) -> _Seen:
        placed = self.ground(pixels, state)
        seen = np.isfinite(placed).all(axis=1)
        off = np.full(len(pixels), _NOWHERE)
        pixels, placed = pixels[seen], placed[seen]
        near = nearest_line(self._tables, placed)
        aside = np.zeros((len(placed), len(paint)))
        aside[np.arange(len(placed)), near.line] = np.where(near.is_beyond, 0.0, -1.0)
        aside[:, -1] = aside[:, :-1] @ self.outward
        distances_m = near.distance_m + aside @ paint
        on_ground = np.stack([self.ground(pixels + step, state) - placed for step in np.eye(2)], axis=-1)
        per_px2 = np.square(np.nan_to_num(np.einsum("ni,nij->nj", near.normal, on_ground), nan=1.0)).sum(axis=1)
        off[seen] = distances_m**2 / (_ON_LINE_M**2 + _ON_LINE_PX**2 * per_px2)
        variances = _GROUND_M**2 + noise_px**2 * per_px2
        squares = distances_m**2 / variances
        robust = 1.0 + squares * variances / (width_m**2 + _GATE2 * variances)
        cost = float((squares / robust).sum() + _GATE2 * np.count_nonzero(~seen)) / _REPEATED
        weights = 1.0 / (robust**2 * variances * _REPEATED)
        return _Seen(off, cost, pixels, placed, near.normal, aside, distances_m, weights, squares)

    def _blocks(self, seen: Sequence[_Seen], doubts: FloatArray, state: FloatArray) -> list[Block]:
        """The views' normal equations at a state."""
        blocks = []
        for one, mine, doubt in zip(seen, self.own, doubts, strict=True):
            rows = self._rows(one, state[[*mine, *self.camera]])
            at = np.concatenate((mine, self.shared))
            blocks.append(residual_block(at, rows, one.distances_m, one.weights).divided(float(doubt)))
        return blocks

    def _rows(self, one: _Seen, state: FloatArray) -> FloatArray:
        """Derivatives (N, 16 + L + 1) of distances at a state as of `ground`, and by paint."""
        rows = np.empty((len(one.ground), len(state)))
        aside = one.ground - state[:2]
        rows[:, :2], rows[:, 2] = one.normal, one.normal[:, 1] * aside[:, 0] - one.normal[:, 0] * aside[:, 1]
        for j in range(_OWN, len(state)):
            moved = state.copy()
            moved[j] += _STEP
            rows[:, j] = np.nan_to_num(((self.ground(one.pixels, moved) - one.ground) * one.normal).sum(axis=1)) / _STEP
        rows[:, _LEAN:_OWN] = rows[:, [_OWN + ROLL, _OWN + PITCH, _OWN + HEIGHT]]
        return np.hstack((rows, one.aside))


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
    bundle = _Bundle(views, start, field, model, size)
    state, damping = bundle.mean.copy(), _DAMPING
    state[bundle.camera] = start
    state[bundle.own[:, _LEAN:]] = leans = np.array([one.stand.lean for one in views])
    swayed = np.maximum(np.sqrt(np.mean(leans**2, axis=0)), _AT_FIRST[:_LEANS]).tolist()
    learned = Learned(*swayed, *_AT_FIRST[_LEANS:])
    for width_m in [width for width in _WIDTHS_M if not again or width <= _NEAR_M]:
        now = bundle.linearise(state, learned, width_m)
        next_learned = bundle.learn(state, learned, now) if width_m < _FAR_M else learned
        for _ in range(_TRIALS):
            trial = state + NormalEquations(now.blocks, damping).step()
            if bundle.cost(bundle.look(trial, learned, width_m), now.doubts, trial, learned) < now.cost:
                state, damping = trial, 0.1 * damping
                break
            damping *= 10.0
        learned = next_learned
    last = bundle.linearise(state, learned, _WIDTHS_M[-1])
    off = np.concatenate([one.off for one in last.seen])
    return PerspectiveFit(
        state[bundle.camera],
        NormalEquations(last.blocks).covariance(bundle.camera),
        [Stand(as_pose(own[:_LEAN]), own[_LEAN:]) for own in state[bundle.own]],
        np.array([np.mean(one.off < 1.0) for one in last.seen]),
        float(np.mean(off / (1.0 + off))),
        learned,
    )


def _spread(equations: NormalEquations, at: IndexArray, state: FloatArray, usual: float = 0.0) -> float:
    """The standard deviation of entries that are drawn alike, from what they came to. usual: as of two entries more,
    since few may be alike by chance; the variance is then the mean of its posterior: few may be large by chance, too.
    """
    variances = state[at] ** 2 + np.diag(equations.covariance(at))
    return math.sqrt(float(variances.sum() + 2.0 * usual**2) / len(at))
