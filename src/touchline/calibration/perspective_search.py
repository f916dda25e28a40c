"""Perspective cameras that may be, from nothing but lines in images of one camera.

Lines of a field are parallel or at right angles: over all images that leaves few focal lengths, pitches and rolls; as a
body sways, each image has a roll of its own beside. Then each height gives the ground a scale, and the places at which
the line points lie on the field's lines tell how good it is. The likelihood is one of pixels: a lower camera draws all
ground together, and would else seem to fit better.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.perspective_bundle import DISTORTION, FOCAL, HEIGHT, NAMES, PITCH, ROLL, camera_at
from touchline.geometry import FloatArray, Pose, tilt_rotation
from touchline.localization.registration.registration import CLUTTER_PER_M
from touchline.localization.search.pose_search import PoseSearch
from touchline.types import Observation

FOCAL_RATIOS = {"pinhole": (0.5, 1.6), "fisheye": (0.3, 0.8)}  # of the image's width
HEIGHTS_M = np.geomspace(0.3, 1.7, 30)
MIN_LINES = 6  # of all images
DISTORTIONS = {"pinhole": (0.0, -0.12, -0.25), "fisheye": (0.0,)}
_FOCALS, PITCHES_DEG, _ROLLS_DEG = 14, np.arange(6.0, 60.0, 2.0), np.arange(-6.0, 6.1, 1.5)
_MIN_LINE_PX, _MAX_COST = 40.0, 4.5  # a line's share of the cost, at most: one of a circle's arc is none
_DIRECTIONS_RAD = np.radians(np.arange(0.0, 90.0, 1.5))
# roll, pitch, log focal length, distortion: nearer ones are one
_SAME = np.array([math.radians(3.0), math.radians(3.0), 0.1, 0.1])
_APART = np.full(len(NAMES), np.inf)
_APART[[ROLL, PITCH, HEIGHT, FOCAL, DISTORTION]] = 0.05, 0.05, 0.15, 0.1, 0.1
_SQUARE, _SEARCHED_IMAGES = 6, 4  # cameras that are square enough, and images (those with most points) for heights
_NOISE_PX, _NOISE_M, _REACH_M = 0.7, 0.01, 12.0
_SWAY_RAD = math.radians(2.5)  # by which images' rolls differ, a standard deviation: a body that steps sways so
_OWN_DEG, _OWN_FINE_DEG = np.arange(-5.0, 5.1, 1.0), np.arange(-6.0, 6.1, 0.25)


class Start(NamedTuple):
    """A camera's state (10,), as of `perspective_bundle`, its log-likelihood, and by how much images lean (V, 3)."""

    state: FloatArray
    log_likelihood: float
    leans: FloatArray


def find_cameras(seen: Sequence[Observation], model: str, size: tuple[int, int], search: PoseSearch) -> list[Start]:
    """The likeliest cameras, the best first; none for fewer than `MIN_LINES` lines."""
    most = np.argsort([-len(one.points) for one in seen], kind="stable")[:_SEARCHED_IMAGES]
    found: list[Start] = []
    for cost, state, leans in _square_cameras(seen, model, size):
        for height_m in HEIGHTS_M:
            at = state.copy()
            at[HEIGHT] = math.log(height_m)
            likely = sum(place(seen[k], model, size, at, search, lean=leans[k])[1] for k in most)
            found.append(Start(at, likely - cost, leans))
    kept: list[Start] = []
    for one in sorted(found, key=lambda one: -one.log_likelihood):
        if all(np.any(np.abs(one.state - other.state) > _APART) for other in kept):
            kept.append(one)
    return kept


def place(
    one: Observation,
    model: str,
    size: tuple[int, int],
    state: FloatArray,
    search: PoseSearch,
    noise_px: float = _NOISE_PX,
    lean: FloatArray | None = None,
) -> tuple[Pose | None, float]:
    """The likeliest pose of an image with a camera's state (10,) and a lean of its own (3,), and the log-likelihood of
    its points, per pixel.
    """
    camera, pixels = camera_at(model, size, state, lean), one.points.pixels
    ground = camera.ground_from_image(pixels)
    near = np.hypot(*np.nan_to_num(ground, nan=np.inf).T) < _REACH_M
    covariances = camera.ground_covariances(pixels[near], noise_px, _NOISE_M)
    modes = search.everywhere(np.ascontiguousarray(ground[near]), covariances)
    if not modes:
        return None, 0.0
    beyond = float(np.count_nonzero(~near)) * math.log(CLUTTER_PER_M)
    return modes[0].pose, modes[0].log_likelihood + beyond + len(pixels) * float(state[HEIGHT])


class _Squareness:
    """Lines of images, and what they lack of being parallel or at right angles through a camera.

    shown (I,): numbers of the images that have lines.
    """

    def __init__(self, seen: Sequence[Observation], model: str, size: tuple[int, int]) -> None:
        self._model, self._size, self._state = model, size, np.zeros(len(NAMES))
        ends = np.concatenate([np.zeros((0, 2, 2)), *(one.lines.pixels for one in seen)])
        image = np.repeat(np.arange(len(seen)), [len(one.lines) for one in seen])
        along = ends[:, 1] - ends[:, 0]
        length = np.hypot(*along.T)
        long = length > _MIN_LINE_PX
        ends, image = ends[long], image[long]
        along = along[long] / length[long, np.newaxis]
        aside = np.stack((along[:, 1], -along[:, 0]), axis=1)
        self._moved = np.stack((ends, ends, ends))  # as seen, and with the first and the second end a pixel aside
        self._moved[1, :, 0] += aside
        self._moved[2, :, 1] += aside
        self._first = np.flatnonzero(np.diff(image, prepend=-1))
        self.lines, self.shown = len(ends), image[self._first]

    def costs(self, rolls: FloatArray, pitch: float, focal: float, distortion: float) -> FloatArray:
        """Of each image at each roll (R, I)."""
        self._state[[FOCAL, DISTORTION]] = focal, distortion
        rays = camera_at(self._model, self._size, self._state).camera_rays(self._moved.reshape(-1, 2))
        turns = np.stack([tilt_rotation(roll, pitch) for roll in rolls.tolist()])
        turned = (rays @ turns.transpose(0, 2, 1)).reshape(-1, *self._moved.shape[:-1], 3)
        falling = turned[..., 2] < -0.02
        ends = turned[..., :2] / np.where(falling, -turned[..., 2], 1.0)[..., np.newaxis]
        along = ends[..., 1, :] - ends[..., 0, :]
        angles = np.arctan2(along[..., 1], along[..., 0])
        moves = np.mod(angles[:, 1:] - angles[:, :1] + math.pi, 2.0 * math.pi) - math.pi
        sigmas = np.sqrt(np.maximum((moves**2).sum(axis=1), 1e-6))[..., np.newaxis]
        off = np.mod(angles[:, 0, :, np.newaxis] - _DIRECTIONS_RAD + 0.25 * math.pi, 0.5 * math.pi) - 0.25 * math.pi
        costs = np.minimum(0.5 * (off / sigmas) ** 2, _MAX_COST)
        costs[~falling.all(axis=(1, 3))] = _MAX_COST
        return np.add.reduceat(costs, self._first, axis=1).min(axis=2)


def _square_cameras(
    seen: Sequence[Observation], model: str, size: tuple[int, int]
) -> list[tuple[float, FloatArray, FloatArray]]:
    """Cameras with which lines are parallel or at right angles: costs, the least first, states (10,), leans (V, 3)."""
    from scipy.optimize import minimize

    square = _Squareness(seen, model, size)
    if square.lines < MIN_LINES:
        return []
    low, high = FOCAL_RATIOS[model]
    focals = np.log(size[0] * np.geomspace(low, high, _FOCALS))
    rolls, pitches = np.radians(_ROLLS_DEG), np.radians(PITCHES_DEG)
    rests = np.stack(np.meshgrid(pitches, focals, DISTORTIONS[model], indexing="ij"), axis=-1).reshape(-1, 3)
    of_own = 0.5 * ((rolls[:, np.newaxis] - rolls) / _SWAY_RAD) ** 2
    costs = np.stack(  # (rolls, rests)
        [(square.costs(rolls, *rest) + of_own[..., np.newaxis]).min(axis=1).sum(axis=1) for rest in rests.tolist()],
        axis=1,
    )
    grid = np.array([(roll, *rest) for roll in rolls for rest in rests])
    kept: list[FloatArray] = []
    for k in np.argsort(costs.ravel(), kind="stable"):
        if all(np.any(np.abs(grid[k] - other) > _SAME) for other in kept):
            kept.append(grid[k])
        if len(kept) == 2 * _SQUARE:
            break

    def own(at: FloatArray, more_deg: FloatArray) -> FloatArray:
        """(R, I) with rolls that are larger by so much."""
        more = np.radians(more_deg)
        return square.costs(at[0] + more, *at[1:].tolist()) + 0.5 * (more[:, np.newaxis] / _SWAY_RAD) ** 2

    steps = np.vstack((np.zeros(4), np.diag(0.5 * _SAME)))
    fits = [
        minimize(
            lambda at: float(own(at, _OWN_DEG).min(axis=0).sum()),
            start,
            method="Nelder-Mead",
            options={"maxfev": 120, "initial_simplex": start + steps},
        )
        for start in kept
    ]
    found: list[tuple[float, FloatArray, FloatArray]] = []
    for fit in sorted(fits, key=lambda one: float(one.fun))[:_SQUARE]:
        state, leans = np.zeros(len(NAMES)), np.zeros((len(seen), 3))
        state[[ROLL, PITCH, FOCAL, DISTORTION]] = fit.x
        leans[square.shown, 0] = np.radians(_OWN_FINE_DEG[own(fit.x, _OWN_FINE_DEG).argmin(axis=0)])
        found.append((float(fit.fun), state, leans))
    return found
