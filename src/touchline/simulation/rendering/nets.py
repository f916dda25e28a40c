"""Goal nets: threads in front of what a ray meets, filtered over a sample's width, and over a pixel's samples in place.

A net is nine numbers: x, y of its middle from the ray's origin, cos and sin of its heading, half length, bottom, top
(m), mesh and thread (m). Rays as in `meeting`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.rendering.casting import cast_rays
from touchline.simulation.rendering.sampling import fill_samples

Net = tuple[float, float, float, float, float, float, float, float, float]
OVER_SAMPLES = -1.0  # share of a pixel whose threads are to be averaged over its samples: `average_nets`
_NET = 3.0


@njit(cache=True, error_model="numpy", inline="always")
def beside_net(
    net: Net,
    oz: float,
    ux: float,
    uy: float,
    rise: float,
    across: float,
    steep: float,
    shift: float,
    net_angle: float,
    limit: float,
    behind: float,
) -> tuple[bool, bool]:
    """Whether a pixel holds threads of a net or its outline, and whether the net is as near as what the ray meets.

    Threads are box-filtered over net_angle (rad). What the ray meets is at `limit`, and reaches `behind` (m) further.
    """
    ex, ey, c, s, half = net[0], net[1], net[2], net[3], net[4]
    lx, ly, vx, vy = ex * c + ey * s, ey * c - ex * s, ux * c + uy * s, uy * c - ux * s
    aside = across * (np.sqrt(ex * ex + ey * ey) + half) + shift
    if half * abs(vy) < 2.0 * aside:  # seen from the edge
        return False, abs(ux * ey - uy * ex) < 3.0 * aside
    if vy == 0.0:
        return False, False
    far = ly / vy
    aside = across * far + shift
    wide = aside / abs(vy)
    if not 0.0 < far < limit + wide + behind:
        return False, False
    up = far * steep + shift + abs(rise * vx) * wide
    along, height = far * vx - lx, oz + far * rise
    past, level = half - abs(along), min(height - net[5], net[6] - height)
    if past < -wide or level < -up:
        return False, False
    if far > limit - wide - behind:
        return False, True
    width = far * net_angle
    over_side, over_level = wide + 0.5 * width / max(abs(vy), 0.1), up + 0.5 * width
    threads = _off_thread(along, net[7], net[8]) < over_side or _off_thread(height, net[7], net[8]) < over_level
    return threads or past < wide or level < up, False


@njit(cache=True, error_model="numpy", inline="always")
def net_share(net: Net, oz: float, ux: float, uy: float, rise: float, net_angle: float, limit: float) -> float:
    """Share of a ray, net_angle (rad) wide, that passes between the threads of a net before it ends at `limit` (m)."""
    c, s, half = net[2], net[3], net[4]
    lx, ly = net[0] * c + net[1] * s, net[1] * c - net[0] * s
    vx, vy = ux * c + uy * s, uy * c - ux * s
    if vy == 0.0:
        return 1.0
    far = ly / vy
    along, height = far * vx - lx, oz + far * rise
    if not 0.0 < far < limit or abs(along) > half or height < net[5] or height > net[6]:
        return 1.0
    width = far * net_angle
    upright = _grating(along, net[7], net[8], width / max(abs(vy), 0.1))
    return (1.0 - upright) * (1.0 - _grating(height, net[7], net[8], width))


@njit(cache=True, error_model="numpy")
def average_nets(
    rest: npt.NDArray[np.int32],
    hits: npt.NDArray[np.float32],
    cast: npt.NDArray[np.float32],
    pixels: npt.NDArray[np.int32],
    rays: npt.NDArray[np.float32],
    side: int,
    rows: npt.NDArray[np.int32],
    poses: FloatArray,
    solids: FloatArray,
    starts: npt.NDArray[np.int32],
    items: npt.NDArray[np.int16],
    net_angle: float,
) -> None:
    """Replace `OVER_SAMPLES` in hits (M, 8) of the rays that `rest` (M,) lists by the mean over their pixels' samples.

    cast (9, N): the middles of pixels (N,), flat indices into the camera's rays (H, W, 6); rows (N,) selects each one's
    pose among poses (P, 12), unless there is but one. What lies behind the net holds no edge (`beside_net`), so a
    thread's share is all that differs between the side x side samples. solids, starts, items: see `solids`.
    """
    listed, count, each = np.empty(len(rest), dtype=np.int32), 0, side * side
    for n in range(len(rest)):
        if hits[n, 7] == OVER_SAMPLES:
            listed[count] = n
            count += 1
    if count == 0:
        return
    netted, chosen = np.empty(count, dtype=np.int32), np.zeros(count * each, dtype=np.int32)
    samples, beside = np.empty((6, count * each), dtype=np.float32), np.empty((9, count * each), dtype=np.float32)
    for m in range(count):
        netted[m] = pixels[rest[listed[m]]]
        if len(poses) > 1:
            chosen[m * each : (m + 1) * each] = rows[rest[listed[m]]]
    fill_samples(rays, netted, side, samples)
    cast_rays(samples, chosen, poses, 1, 1, beside)
    for m in range(count):
        hit = listed[m]
        cell, limit, total = np.uint32(cast[7, np.uint32(rest[hit])]), float(hits[hit, 3]), 0.0
        for j in range(m * each, (m + 1) * each):
            share = 1.0
            for entry in range(starts[cell], starts[cell + np.uint32(1)]):
                b = np.uint32(items[entry])
                if solids[b, 0] == _NET:
                    net = (
                        solids[b, 1] - beside[0, j], solids[b, 2] - beside[1, j], solids[b, 3], solids[b, 4],
                        solids[b, 5], solids[b, 7], solids[b, 8], solids[b, 11], solids[b, 12],
                    )  # fmt: skip
                    share *= net_share(net, beside[2, j], beside[3, j], beside[4, j], beside[5, j], net_angle, limit)
            total += share
        hits[hit, 7] = total / each


@njit(cache=True, error_model="numpy", inline="always")
def _off_thread(position: float, mesh: float, thread: float) -> float:
    """How far (m) a position on a net is from the nearest thread; negative within it."""
    return float(abs(position - mesh * np.floor(position / mesh + 0.5)) - 0.5 * thread)


@njit(cache=True, error_model="numpy", inline="always")
def _grating(position: float, period: float, line: float, width: float) -> float:
    """Mean over [position - width / 2, position + width / 2] of a grating: 1 on lines of that width at each period."""
    if width >= period:
        return line / period
    offset = position - period * np.floor(position / period + 0.5)
    low, high = max(offset - 0.5 * width, -0.5 * line), min(offset + 0.5 * width, 0.5 * line)
    return float(max(0.0, high - low) / width)
