"""Where light falls: lamps as a map over the hall, sun through windows with hard edges, shadows of bodies."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray


@njit(cache=True)
def light_at(light: npt.NDArray[np.float32], frame: FloatArray, x: float, y: float) -> tuple[float, float]:
    """Light level and carpet's brightness (bilinear) at a point (m, field frame); light (ny, nx, 2); frame: x, y, 1/step."""
    fx = min(max((x - frame[0]) * frame[2], 0.0), light.shape[1] - 1.001)
    fy = min(max((y - frame[1]) * frame[2], 0.0), light.shape[0] - 1.001)
    i, j = int(fx), int(fy)
    a, b = fx - i, fy - j
    w00, w10, w01, w11 = (1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b
    level = light[j, i, 0] * w00 + light[j, i + 1, 0] * w10 + light[j + 1, i, 0] * w01 + light[j + 1, i + 1, 0] * w11
    wear = light[j, i, 1] * w00 + light[j, i + 1, 1] * w10 + light[j + 1, i, 1] * w01 + light[j + 1, i + 1, 1] * w11
    return level, wear


@njit(cache=True)
def sun_at(sun: FloatArray, windows: FloatArray, casters: FloatArray, x: float, y: float, z: float) -> bool:
    """Whether the sun shines on a point (m, field frame) through a window and past all casters.

    sun (5,): level, horizontal direction towards it, tangent of its elevation, unused. windows (W, 9): axis (0: wall across
    x, 1: across y), signed distance of the wall, start, end, bottom, top, bars along, bars up, width of a bar. casters (M, 4):
    x, y, radius, height.
    """
    if sun[0] <= 0.0:
        return False
    lit = False
    for k in range(len(windows)):
        w = windows[k]
        towards = sun[1] if w[0] == 0.0 else sun[2]
        run = (w[1] - (x if w[0] == 0.0 else y)) / (towards if towards != 0.0 else 1e-9)
        if run <= 0.0:
            continue
        along = (y + run * sun[2] if w[0] == 0.0 else x + run * sun[1]) - w[2]
        height = z + run * sun[3] - w[4]
        if 0.0 < along < w[3] - w[2] and 0.0 < height < w[5] - w[4]:
            lit = not (_on_bar(along, w[3] - w[2], w[6], w[8]) or _on_bar(height, w[5] - w[4], w[7], w[8]))
            if lit:
                break
    if not lit:
        return False
    for m in range(len(casters)):
        ex, ey = casters[m, 0] - x, casters[m, 1] - y
        run = ex * sun[1] + ey * sun[2]
        if run > casters[m, 2] and abs(ex * sun[2] - ey * sun[1]) < casters[m, 2] and z + run * sun[3] < casters[m, 3]:
            return False
    return True


@njit(cache=True)
def _on_bar(position: float, size: float, bars: float, width: float) -> bool:
    pane = size / (bars + 1.0)
    nearest = np.round(position / pane)
    return 0.5 < nearest < bars + 0.5 and abs(position - nearest * pane) < 0.5 * width


@njit(cache=True)
def contact_shadow(casters: FloatArray, cells: npt.NDArray[np.int16], frame: FloatArray, x: float, y: float) -> float:
    """Share of the light that reaches the ground beside bodies; cells (ny, nx, 3): casters near each 0.5 m square."""
    i = min(max(int((x - frame[0]) * 2.0), 0), cells.shape[1] - 1)
    j = min(max(int((y - frame[1]) * 2.0), 0), cells.shape[0] - 1)
    share = 1.0
    for n in range(3):
        m = cells[j, i, n]
        if m < 0:
            break
        ex, ey = x - casters[m, 0], y - casters[m, 1]
        square = (ex * ex + ey * ey) / (casters[m, 2] * casters[m, 2])
        if square < 9.0:
            fade = 1.0 - square / 9.0
            share *= 1.0 - 0.55 * fade * fade * fade
    return share


@njit(cache=True)
def place_casters(casters: FloatArray, frame: FloatArray) -> npt.NDArray[np.int16]:
    """For each 0.5 m square of the ground up to three bodies within three radii of it, -1 for none."""
    cells = np.full((int(frame[3]) // 2 + 1, int(frame[2]) // 2 + 1, 3), -1, dtype=np.int16)
    for m in range(len(casters)):
        reach = 3.0 * casters[m, 2]
        low_i, high_i = int((casters[m, 0] - reach - frame[0]) * 2.0), int((casters[m, 0] + reach - frame[0]) * 2.0)
        low_j, high_j = int((casters[m, 1] - reach - frame[1]) * 2.0), int((casters[m, 1] + reach - frame[1]) * 2.0)
        for j in range(max(low_j, 0), min(high_j + 1, cells.shape[0])):
            for i in range(max(low_i, 0), min(high_i + 1, cells.shape[1])):
                for n in range(3):
                    if cells[j, i, n] < 0:
                        cells[j, i, n] = m
                        break
    return cells
