"""Body rays -> rays in the field, a row of the image at once.

One short loop for each quantity on rows of float32: the compiler auto-vectorises these (SIMD), but not a loop over
many arrays.
"""

import numpy as np
from numba import njit

from touchline.geometry import Float32Array

FAR_M = 1e6
SECTORS, BINS = 512, 128  # of the directions in which bodies are looked for, see `solids.sort_into_cells`
CAST_ROWS = 9

Weights = tuple[np.float32, np.float32, np.float32, np.float32]


@njit(cache=True, error_model="numpy")
def cast_rays(rays: Float32Array, first: int, count: int, pose: Float32Array, cast: Float32Array) -> None:
    """Fill the first `count` columns of cast (9, >= count) from body rays (6, N), those from `first` on.

    rays: origin (m) and direction, of any length but not straight down. pose (12,): rotation field_from_body by rows,
    then its translation (m). Rows of cast: origin (m, field frame), horizontal unit direction, height gained per
    metre, metres to the ground (1e6 where there is none), number of the cell (see `solids.sort_into_cells`), metres
    along the ground per radian of elevation.
    """
    last = first + count
    qx, qy, qz = rays[0, first:last], rays[1, first:last], rays[2, first:last]
    rx, ry, rz = rays[3, first:last], rays[4, first:last], rays[5, first:last]
    z, ux, uy, rise, fall = cast[2, :count], cast[3, :count], cast[4, :count], cast[5, :count], cast[6, :count]
    none = np.float32(0.0)
    _weighted(qx, qy, qz, (pose[0], pose[1], pose[2], pose[9]), cast[0, :count])
    _weighted(qx, qy, qz, (pose[3], pose[4], pose[5], pose[10]), cast[1, :count])
    _weighted(qx, qy, qz, (pose[6], pose[7], pose[8], pose[11]), z)
    _weighted(rx, ry, rz, (pose[0], pose[1], pose[2], none), ux)
    _weighted(rx, ry, rz, (pose[3], pose[4], pose[5], none), uy)
    _weighted(rx, ry, rz, (pose[6], pose[7], pose[8], none), rise)
    _normalise(ux, uy, rise)
    _fall(z, rise, fall)
    _number_cells(ux, uy, rise, cast[7, :count])
    _stretch(z, fall, cast[8, :count])


@njit(cache=True, error_model="numpy")
def _weighted(a: Float32Array, b: Float32Array, c: Float32Array, weights: Weights, out: Float32Array) -> None:
    of_a, of_b, of_c, constant = weights
    for i in range(len(out)):
        out[i] = of_a * a[i] + of_b * b[i] + of_c * c[i] + constant


@njit(cache=True, error_model="numpy")
def _normalise(x: Float32Array, y: Float32Array, z: Float32Array) -> None:
    """Divide by the length of (x, y)."""
    one, tiny = np.float32(1.0), np.float32(1e-18)
    for i in range(len(x)):
        scale = one / np.sqrt(x[i] * x[i] + y[i] * y[i] + tiny)
        x[i] *= scale
        y[i] *= scale
        z[i] *= scale


@njit(cache=True, error_model="numpy")
def _fall(height: Float32Array, rise: Float32Array, out: Float32Array) -> None:
    """Metres to the ground."""
    level, far = np.float32(-1e-7), np.float32(FAR_M)
    for i in range(len(out)):
        falling = rise[i] < level
        down = rise[i] if falling else level
        out[i] = -height[i] / down if falling else far


@njit(cache=True, error_model="numpy")
def _stretch(height: Float32Array, s: Float32Array, out: Float32Array) -> None:
    """How much further along the ground a ray ends per radian."""
    for i in range(len(out)):
        out[i] = (s[i] * s[i] + height[i] * height[i]) / height[i]


@njit(cache=True, error_model="numpy")
def _number_cells(x: Float32Array, y: Float32Array, rise: Float32Array, out: Float32Array) -> None:
    """Sector of the horizontal direction times BINS plus the bin of the rise, as whole numbers."""
    one, three, tiny, none = np.float32(1.0), np.float32(3.0), np.float32(1e-18), np.float32(0.0)
    sectors, bins = np.float32(SECTORS), np.float32(BINS)
    for i in range(len(out)):
        part = x[i] / (abs(x[i]) + abs(y[i]) + tiny)
        sector = np.floor((one - part if y[i] >= none else three + part) * (np.float32(0.25) * sectors))
        level = np.floor((one + rise[i] / (one + abs(rise[i]))) * (np.float32(0.5) * bins))
        out[i] = min(sector, sectors - one) * bins + min(max(level, none), bins - one)
