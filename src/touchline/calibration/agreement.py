"""What all images together know better than one: edges that a rod or a line spoilt, white that is too bright."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.camera.model_free import lagrange
from touchline.geometry import FloatArray

Mask = npt.NDArray[np.bool_]
_HARMONICS = (6, 10, 18)  # directions that it takes to tell the first, second, ... harmonic of what a mirror does
_ROUNDS = 4
_FAR = 3.0  # standard deviations
_NEAR = 5  # edges of an image, next to each other


def around(angles_rad: FloatArray, values: FloatArray, least: float, keep: Mask | None = None) -> FloatArray:
    """What harmonics of the direction make of values (S,) at angles (S,): (S,). What lies far off them does not count.

    least: deviation that is never far. keep: (S,), what may count at first. NaN never counts.
    """
    orders = np.arange(1, 1 + max(1, int(np.searchsorted(_HARMONICS, np.isfinite(values).sum(), side="right"))))
    phases = angles_rad[:, np.newaxis] * orders
    waves = np.column_stack((np.ones(len(values)), np.cos(phases), np.sin(phases)))
    keep = np.isfinite(values) if keep is None else keep
    for _ in range(_ROUNDS):
        fit: FloatArray = waves @ np.linalg.lstsq(waves[keep], values[keep], rcond=None)[0]
        off = np.abs(values - fit)
        keep = off <= max(_FAR * 1.4826 * float(np.nanmedian(off)), least)
    return fit


def healed(angles_rad: FloatArray, values: FloatArray, least: FloatArray, of_its_own: bool) -> tuple[FloatArray, Mask]:
    """Values (S, E) of E edges in S images, where single ones that contradict the other directions, or are NaN, are
    replaced by what those say; and which (S, E). least: (E,) deviation that is never a contradiction.

    of_its_own: whether each value was measured by itself. What the nearest edges of an image have in common is then the
    mirror's, and only what differs from them is in doubt.
    """
    fits = np.column_stack([around(angles_rad, values[:, k], float(least[k])) for k in range(values.shape[1])])
    if of_its_own:
        rest, n = values - fits, values.shape[1]
        near = [np.arange(_NEAR) + np.clip(k - _NEAR // 2, 0, n - _NEAR) for k in range(n)]
        fits = fits + np.column_stack([np.nanmedian(rest[:, chosen], axis=1) for chosen in near])
    off = np.abs(values - fits)
    spoilt = (off > np.maximum(_FAR * 1.4826 * np.nanmedian(off, axis=0), least)) | np.isnan(values)
    return np.where(spoilt, fits, values), spoilt


def white_excess(radii_px: FloatArray, ranges_m: FloatArray, signs: npt.NDArray[np.int64]) -> FloatArray:
    """How far (E,) px white reaches into black at each edge, as it is seen; from edges at radii (S, E).

    Where the camera's response isn't known, or white is overexposed, every white rectangle looks too long and every
    black one too short. Smooth mirrors have no such zigzag, so it is measured as one: by how much each edge is off the
    interpolation between the two on either side. 0 unless a zigzag that changes evenly with the radius explains most.
    """
    middle, logs = np.median(radii_px, axis=0), np.log(ranges_m)
    inner = np.arange(2, len(middle) - 2)
    off, share = np.empty(len(inner)), np.empty(len(inner))
    for i, k in enumerate(inner):
        others = np.array([k - 2, k - 1, k + 1, k + 2])
        between = np.column_stack((middle[others], signs[others]))
        expected = lagrange(logs[others], between, logs[[k]])[0]
        off[i], share[i] = expected[0] - middle[k], signs[k] - expected[1]
    terms = np.column_stack((share, share * (middle[inner] - middle.mean())))
    solution = np.linalg.lstsq(terms, off, rcond=None)[0]
    if np.sum((terms @ solution - off) ** 2) > 0.25 * np.sum(off**2):
        return np.zeros(len(middle))
    excess: FloatArray = solution[0] + solution[1] * (middle - middle.mean())
    excess[[0, -1]] *= (signs[0] > 0, signs[-2] > 0)  # black beside carpet has no white
    return excess
