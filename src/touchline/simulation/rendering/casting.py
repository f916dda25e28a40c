"""Body rays -> rays in the field, all at once: plain arithmetic on rows of float32, which the compiler makes wide."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray

FAR_M = 1e6

Float32Array = npt.NDArray[np.float32]


@njit(cache=True, error_model="numpy")
def cast_rays(
    rays: Float32Array,
    rows: npt.NDArray[np.int32],
    poses: FloatArray,
    sectors: int,
    bins: int,
    cast: Float32Array,
    first: int = 0,
    count: int = -1,
) -> None:
    """Fill cast (9, >= N) for body rays (6, N): origin (m) and direction, of any length but not straight down.

    rows (N,) selects each ray's pose among poses (P, 12): rotation field_from_body by rows, then its translation (m);
    with a single pose it is not read. Rows of cast: origin (m, field frame), horizontal unit direction, height gained
    per metre, metres to the ground (1e6 where there is none), number of the cell (see `solids.sort_into_cells`), metres
    along the ground per radian of elevation. first, count: of the rays, if not all are meant; rows begin with them.
    """
    count = rays.shape[1] if count < 0 else count
    if len(poses) == 1:
        _cast_from(rays, first, count, poses[0].astype(np.float32), sectors, bins, cast, 0)
        return
    start = 0
    while start < count:  # runs of rays that share a pose: a row of the image each
        stop = start + 1
        while stop < count and rows[stop] == rows[start]:
            stop += 1
        pose = poses[rows[start]].astype(np.float32)
        _cast_from(rays, first + start, stop - start, pose, sectors, bins, cast, start)
        start = stop


@njit(cache=True, error_model="numpy")
def spread_rays(
    spread: Float32Array,
    cast: Float32Array,
    lean: float,
    shift: float,
    extents: Float32Array,
    first: int = 0,
    count: int = -1,
) -> None:
    """Fill three rows of extents (4, >= N): how far a pixel's samples reach from its middle, at most.

    spread (2, N): angles (rad) across and along the direction's elevation, of a body that stands upright; lean: its
    tilt (rad); shift (m): between the origins of a pixel's rays. Rows of extents: metres aside per metre, change of
    the height gained per metre, metres along the ground (of rays in `cast` that meet it). first, count: of the pixels.
    """  # fmt: skip
    n = spread.shape[1] if count < 0 else count
    across, along, rise = spread[0, first : first + n], spread[1, first : first + n], cast[5, :n]
    _reach_aside(across, along, rise, np.float32(lean), extents[0, :n])
    _reach_up(across, along, rise, np.float32(lean), extents[1, :n])
    _reach_out(rise, extents[1, :n], cast[6, :n], np.float32(shift), extents[2, :n])


@njit(cache=True, error_model="numpy")
def _reach_aside(
    across: Float32Array, along: Float32Array, rise: Float32Array, lean: np.float32, out: Float32Array
) -> None:
    one = np.float32(1.0)
    for i in range(len(out)):
        length = np.sqrt(one + rise[i] * rise[i])
        out[i] = (across[i] + min(one, lean * length) * along[i]) * length


@njit(cache=True, error_model="numpy")
def _reach_up(
    across: Float32Array, along: Float32Array, rise: Float32Array, lean: np.float32, out: Float32Array
) -> None:
    one = np.float32(1.0)
    for i in range(len(out)):
        square = one + rise[i] * rise[i]
        out[i] = (along[i] + min(one, lean * np.sqrt(square)) * across[i]) * square


@njit(cache=True, error_model="numpy")
def _reach_out(rise: Float32Array, up: Float32Array, fall: Float32Array, shift: np.float32, out: Float32Array) -> None:
    small = np.float32(1e-6)
    for i in range(len(out)):
        out[i] = (fall[i] * up[i] + shift) / max(-rise[i] - up[i], small) + shift


@njit(cache=True, error_model="numpy")
def _cast_from(
    rays: Float32Array, first: int, count: int, pose: Float32Array, sectors: int, bins: int, cast: Float32Array, at: int
) -> None:
    """One short loop for each quantity: more arrays in one loop would keep the compiler from making it wide.

    It takes rows of whole arrays alone for contiguous: no slice of several rows may stand between.
    """
    last, end = first + count, at + count
    qx, qy, qz = rays[0, first:last], rays[1, first:last], rays[2, first:last]
    rx, ry, rz = rays[3, first:last], rays[4, first:last], rays[5, first:last]
    x, y, z, ux, uy = cast[0, at:end], cast[1, at:end], cast[2, at:end], cast[3, at:end], cast[4, at:end]
    rise, fall, cell, stretch = cast[5, at:end], cast[6, at:end], cast[7, at:end], cast[8, at:end]
    none = np.float32(0.0)
    _weighted(qx, qy, qz, pose[0], pose[1], pose[2], pose[9], x)
    _weighted(qx, qy, qz, pose[3], pose[4], pose[5], pose[10], y)
    _weighted(qx, qy, qz, pose[6], pose[7], pose[8], pose[11], z)
    _weighted(rx, ry, rz, pose[0], pose[1], pose[2], none, ux)
    _weighted(rx, ry, rz, pose[3], pose[4], pose[5], none, uy)
    _weighted(rx, ry, rz, pose[6], pose[7], pose[8], none, rise)
    _normalise(ux, uy, rise)
    _fall(z, rise, fall)
    _stretch(z, fall, stretch)
    _number_cells(ux, uy, rise, np.float32(sectors), np.float32(bins), cell)


@njit(cache=True, error_model="numpy")
def _weighted(
    a: Float32Array,
    b: Float32Array,
    c: Float32Array,
    of_a: np.float32,
    of_b: np.float32,
    of_c: np.float32,
    constant: np.float32,
    out: Float32Array,
) -> None:
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
def _number_cells(
    x: Float32Array, y: Float32Array, rise: Float32Array, sectors: np.float32, bins: np.float32, out: Float32Array
) -> None:
    """Sector of the horizontal direction times `bins` plus the bin of the rise, as whole numbers."""
    one, three, tiny, none = np.float32(1.0), np.float32(3.0), np.float32(1e-18), np.float32(0.0)
    per_turn_number, per_share = np.float32(0.25) * sectors, np.float32(0.5) * bins
    for i in range(len(out)):
        share = x[i] / (abs(x[i]) + abs(y[i]) + tiny)
        sector = np.floor((one - share if y[i] >= none else three + share) * per_turn_number)
        level = np.floor((one + rise[i] / (one + abs(rise[i]))) * per_share)
        out[i] = min(sector, sectors - one) * bins + min(max(level, none), bins - one)
