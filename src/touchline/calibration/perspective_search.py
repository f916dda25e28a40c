"""Perspective cameras that may be, from nothing but lines in images of one camera.

Lines of a field are parallel or at right angles: over all images that leaves few focal lengths, pitches and rolls. Then
each height gives the ground a scale, and the places at which the line points lie on the field's lines tell how good
it is. The likelihood is one of pixels: a lower camera draws all ground together, and would else seem to fit better.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.calibration.perspective_bundle import DISTORTION, FOCAL, HEIGHT, NAMES, PITCH, ROLL, camera_at
from touchline.geometry import FloatArray, IndexArray, Pose
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


class Start(NamedTuple):
    """A camera's state (10,), as of `perspective_bundle`, and its log-likelihood."""

    state: FloatArray
    log_likelihood: float


def find_cameras(seen: Sequence[Observation], model: str, size: tuple[int, int], search: PoseSearch) -> list[Start]:
    """The likeliest cameras, the best first; none for fewer than `MIN_LINES` lines."""
    most = np.argsort([-len(one.points) for one in seen])[:_SEARCHED_IMAGES]
    found: list[Start] = []
    for cost, state in _square_cameras(seen, model, size):
        for height_m in HEIGHTS_M:
            at = state.copy()
            at[HEIGHT] = math.log(height_m)
            likely = sum(place(seen[k], model, size, at, search)[1] for k in most)
            found.append(Start(at, likely - cost))
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
) -> tuple[Pose | None, float]:
    """The likeliest pose of an image with a camera's state (10,), and the log-likelihood of its points, per pixel."""
    camera, pixels = camera_at(model, size, state), one.points.pixels
    ground = camera.ground_from_image(pixels)
    near = np.hypot(*np.nan_to_num(ground, nan=np.inf).T) < _REACH_M
    covariances = camera.ground_covariances(pixels[near], noise_px, _NOISE_M)
    modes = search.everywhere(np.ascontiguousarray(ground[near]), covariances)
    if not modes:
        return None, 0.0
    beyond = float(np.count_nonzero(~near)) * math.log(CLUTTER_PER_M)
    return modes[0].pose, modes[0].log_likelihood + beyond + len(pixels) * float(state[HEIGHT])


def _square_cameras(seen: Sequence[Observation], model: str, size: tuple[int, int]) -> list[tuple[float, FloatArray]]:
    """Cameras with which lines are parallel or at right angles: costs, the least first, and states (10,)."""
    from scipy.optimize import minimize

    ends = np.concatenate([np.zeros((0, 2, 2)), *(one.lines.pixels for one in seen)])
    image = np.repeat(np.arange(len(seen)), [len(one.lines) for one in seen])
    along = ends[:, 1] - ends[:, 0]
    length = np.hypot(*along.T)
    ends, along, image = (each[length > _MIN_LINE_PX] for each in (ends, along / length[:, np.newaxis], image))
    if len(ends) < MIN_LINES:
        return []
    aside = np.stack((along[:, 1], -along[:, 0]), axis=1)
    moved = np.stack((ends, ends, ends))
    moved[1, :, 0] += aside
    moved[2, :, 1] += aside
    state = np.zeros(len(NAMES))

    def cost(at: FloatArray) -> float:
        state[[ROLL, PITCH, FOCAL, DISTORTION]] = at
        camera = camera_at(model, size, state)
        rays = camera.camera_rays(moved.reshape(-1, 2)).reshape(*moved.shape[:-1], 3)
        return _squareness_cost(rays @ camera.base_from_camera.rotation.T, image)

    low, high = FOCAL_RATIOS[model]
    grid = np.stack(
        np.meshgrid(
            np.radians(_ROLLS_DEG),
            np.radians(PITCHES_DEG),
            np.log(size[0] * np.geomspace(low, high, _FOCALS)),
            DISTORTIONS[model],
        ),
        axis=-1,
    ).reshape(-1, 4)
    costs = np.array([cost(at) for at in grid])
    kept: list[FloatArray] = []
    for k in np.argsort(costs, kind="stable"):
        if all(np.any(np.abs(grid[k] - other) > _SAME) for other in kept):
            kept.append(grid[k])
        if len(kept) == 2 * _SQUARE:
            break
    steps = np.vstack((np.zeros(4), np.diag(0.5 * _SAME)))
    fits = [
        minimize(cost, at, method="Nelder-Mead", options={"maxfev": 120, "initial_simplex": at + steps}) for at in kept
    ]
    found: list[tuple[float, FloatArray]] = []
    for fit in sorted(fits, key=lambda one: float(one.fun))[:_SQUARE]:
        square = np.zeros(len(NAMES))
        square[[ROLL, PITCH, FOCAL, DISTORTION]] = fit.x
        found.append((float(fit.fun), square))
    return found


def _squareness_cost(rays: FloatArray, image: IndexArray) -> float:
    """What lines of images (M,) lack of being parallel or at right angles: rays (3, M, 2, 3) to both ends, as seen and
    with the first and the second a pixel aside.
    """
    falling = rays[..., 2] < -0.02
    ends = rays[..., :2] / np.where(falling, -rays[..., 2], 1.0)[..., np.newaxis]
    along = ends[:, :, 1] - ends[:, :, 0]
    angles = np.arctan2(along[..., 1], along[..., 0])
    turned = np.mod(angles[1:] - angles[0] + math.pi, 2.0 * math.pi) - math.pi
    sigmas = np.sqrt(np.maximum((turned**2).sum(axis=0), 1e-6))
    off = np.mod(angles[0][:, np.newaxis] - _DIRECTIONS_RAD + 0.25 * math.pi, 0.5 * math.pi) - 0.25 * math.pi
    costs = np.minimum(0.5 * (off / sigmas[:, np.newaxis]) ** 2, _MAX_COST)
    costs[~falling.all(axis=(0, 2))] = _MAX_COST
    sums = np.zeros((int(image.max()) + 1, len(_DIRECTIONS_RAD)))
    np.add.at(sums, image, costs)
    return float(sums.min(axis=1).sum())
