"""Body rays -> rays in the field, all at once: plain arithmetic on rows of float32, which the compiler makes wide."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.solids import SECTORS

# Rows of the result.
ORIGIN_X, ORIGIN_Y, ORIGIN_Z, ALONG_X, ALONG_Y, RISE, GROUND_S, SECTOR = range(8)
FAR_M = 1e6
_PER_TURN_NUMBER = np.float32(SECTORS / 4.0)


@njit(cache=True, error_model="numpy")
def cast_rays(
    rays: npt.NDArray[np.float32], rows: npt.NDArray[np.int32], poses: FloatArray, cast: npt.NDArray[np.float32]
) -> None:
    """Fill cast (8, >= N) for body rays (6, N): origin (m) and direction, of any length but not straight down.

    rows (N,) selects each ray's pose among poses (P, 12): rotation field_from_body by rows, then its translation (m); with
    a single pose it is not read. Rows of cast: origin (m, field frame), horizontal unit direction, height gained per metre,
    metres to the ground (1e6 where there is none), number of the sector (see `solids.sort_into_sectors`).
    """
    count = rays.shape[1]
    if len(poses) == 1:
        _cast_from(rays[:, :count], poses[0].astype(np.float32), cast)
        return
    start = 0
    while start < count:  # runs of rays that share a pose: a row of the image each
        stop = start + 1
        while stop < count and rows[stop] == rows[start]:
            stop += 1
        _cast_from(rays[:, start:stop], poses[rows[start]].astype(np.float32), cast[:, start:stop])
        start = stop


@njit(cache=True, error_model="numpy")
def _cast_from(rays: npt.NDArray[np.float32], pose: npt.NDArray[np.float32], cast: npt.NDArray[np.float32]) -> None:
    """One short loop for each quantity: more arrays in one loop would keep the compiler from making it wide."""
    n = rays.shape[1]
    qx, qy, qz, rx, ry, rz = rays[0, :n], rays[1, :n], rays[2, :n], rays[3, :n], rays[4, :n], rays[5, :n]
    _weighted(qx, qy, qz, pose[0], pose[1], pose[2], pose[9], cast[0, :n])
    _weighted(qx, qy, qz, pose[3], pose[4], pose[5], pose[10], cast[1, :n])
    _weighted(qx, qy, qz, pose[6], pose[7], pose[8], pose[11], cast[2, :n])
    none = np.float32(0.0)
    _weighted(rx, ry, rz, pose[0], pose[1], pose[2], none, cast[3, :n])
    _weighted(rx, ry, rz, pose[3], pose[4], pose[5], none, cast[4, :n])
    _weighted(rx, ry, rz, pose[6], pose[7], pose[8], none, cast[5, :n])
    _normalise(cast[3, :n], cast[4, :n], cast[5, :n])
    _fall(cast[2, :n], cast[5, :n], cast[6, :n])
    _number_sectors(cast[3, :n], cast[4, :n], cast[7, :n])


@njit(cache=True, error_model="numpy")
def _weighted(
    a: npt.NDArray[np.float32],
    b: npt.NDArray[np.float32],
    c: npt.NDArray[np.float32],
    of_a: np.float32,
    of_b: np.float32,
    of_c: np.float32,
    constant: np.float32,
    out: npt.NDArray[np.float32],
) -> None:
    for i in range(len(out)):
        out[i] = of_a * a[i] + of_b * b[i] + of_c * c[i] + constant


@njit(cache=True, error_model="numpy")
def _normalise(x: npt.NDArray[np.float32], y: npt.NDArray[np.float32], z: npt.NDArray[np.float32]) -> None:
    """Divide by the length of (x, y)."""
    one, tiny = np.float32(1.0), np.float32(1e-18)
    for i in range(len(x)):
        scale = one / np.sqrt(x[i] * x[i] + y[i] * y[i] + tiny)
        x[i] *= scale
        y[i] *= scale
        z[i] *= scale


@njit(cache=True, error_model="numpy")
def _fall(height: npt.NDArray[np.float32], rise: npt.NDArray[np.float32], out: npt.NDArray[np.float32]) -> None:
    """Metres to the ground."""
    level, far = np.float32(-1e-7), np.float32(FAR_M)
    for i in range(len(out)):
        falling = rise[i] < level
        down = rise[i] if falling else level
        out[i] = -height[i] / down if falling else far


@njit(cache=True, error_model="numpy")
def _number_sectors(x: npt.NDArray[np.float32], y: npt.NDArray[np.float32], out: npt.NDArray[np.float32]) -> None:
    one, three, tiny, none = np.float32(1.0), np.float32(3.0), np.float32(1e-18), np.float32(0.0)
    for i in range(len(out)):
        share = x[i] / (abs(x[i]) + abs(y[i]) + tiny)
        out[i] = (one - share if y[i] >= none else three + share) * _PER_TURN_NUMBER
