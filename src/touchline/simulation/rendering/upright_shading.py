"""How bright upright bodies, walls and floor are, and the nets in front of everything. All of it is matt."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray
from touchline.simulation.compiled import uncounted
from touchline.simulation.rendering.illumination import light_at, sun_at
from touchline.simulation.rendering.meeting import RIM_M
from touchline.simulation.rendering.tracing import BOARD, CARPET, CEILING, FLOOR

_WALL_NORMALS = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])  # east, west, north, south
_NET_REFLECTANCE = 0.72
_BLOTCH = 0.10  # contrast of blotches on walls and bodies, where `grain` is 1
_BLOTCHES = 512 * 512 + 256 * 256 + 128 * 128  # where the level of 64 x 64 texels starts in the pyramid


@uncounted
def shade_upright(
    rest: npt.NDArray[np.int32],
    hits: npt.NDArray[np.float32],
    codes: npt.NDArray[np.int32],
    solids: FloatArray,
    palette: FloatArray,
    room: FloatArray,
    room_colours: FloatArray,
    light: npt.NDArray[np.float32],
    light_frame: FloatArray,
    pyramid: npt.NDArray[np.float32],
    casters: FloatArray,
    sun: FloatArray,
    windows: FloatArray,
    marking: bool,
    radiance: npt.NDArray[np.float32],
    edges: npt.NDArray[np.bool_],
) -> None:
    """Fill radiance (N, 3) of the rays in rest that end on no carpet, then lay nets over everything.

    room_colours (4, 3): floor, board, walls, ceiling. hits, codes: see `trace_rays`. marking: also set edges (N,) of
    pixels where sunlight begins or bends round a body.
    """
    nobody = casters[:0]
    for n in range(len(rest)):
        i, code = np.uint32(rest[n]), codes[n]
        x, y, z = float(hits[n, 0]), float(hits[n, 1]), float(hits[n, 2])
        gaps = float(hits[n, 7])
        level = light_at(light, light_frame, 0, x, y)
        if code != CARPET:
            nx, ny, colour, grain = 0.0, 0.0, 0, 0.25
            if code >= 0:
                nx, ny, colour = _face(solids, code, x, y, z)
                grain = 0.05
            elif code == BOARD:
                nx, ny = float(-hits[n, 4]), float(-hits[n, 5])
            elif code == CEILING:
                level = 0.6 * level
            elif code != FLOOR:
                nx, ny = _WALL_NORMALS[-4 - code, 0], _WALL_NORMALS[-4 - code, 1]
            if nx != 0.0 or ny != 0.0:
                level *= 0.75 + 0.10 * (0.5 * nx + 0.87 * ny)
            facing = nx * sun[1] + ny * sun[2] if nx != 0.0 or ny != 0.0 else sun[3]
            if sun[0] > 0.0 and (facing > 0.0 or marking):
                slant, bent = 0.1, 0.0
                if code == BOARD:
                    across_x = abs(abs(x) - room[0]) < abs(abs(y) - room[1])
                    slant = max(abs(hits[n, 4] if across_x else hits[n, 5]), 0.05)
                elif nx != 0.0 or ny != 0.0:
                    slant = max(abs(nx * hits[n, 4] + ny * hits[n, 5]), 0.05)
                reach = 2.0 * hits[n, 6] / slant if marking else 0.0
                if code >= 0 and solids[code, 0] != 1.0:
                    bent = reach / solids[code, 9]
                if facing > -bent:
                    lit, edge = sun_at(sun, windows, nobody, x, y, z, reach)
                    if lit:
                        level += sun[0] * min(max(facing, 0.0) / max(sun[3], 0.2), 2.0)
                    edges[i] = edge or (lit and bent > 0.0)
            blotch = (int(z * 20.0 + 4096.0) & 63) * 64 + (int((x + y) * 14.0 + 4096.0) & 63)
            level *= 1.0 + grain * _BLOTCH * pyramid[_BLOTCHES + blotch]
            for c in range(3):
                shade = palette[colour, c] if code >= 0 else room_colours[_room_row(code), c]
                radiance[i, c] = shade * level
        if gaps < 1.0:
            for c in range(3):
                radiance[i, c] = gaps * radiance[i, c] + (1.0 - gaps) * _NET_REFLECTANCE * level


@uncounted
def _room_row(code: int) -> int:
    if code == FLOOR:
        return 0
    if code == BOARD:
        return 1
    return 3 if code == CEILING else 2


@uncounted
def _face(solids: FloatArray, k: int, x: float, y: float, z: float) -> tuple[float, float, int]:
    """Horizontal normal (0, 0 on top) and colour number of a point on solid k."""
    ex, ey = x - solids[k, 1], y - solids[k, 2]
    c, s = solids[k, 3], solids[k, 4]
    bottom, top = solids[k, 7], solids[k, 8]
    bands = int(solids[k, 11])
    band = min(max(int((z - bottom) / (top - bottom) * bands), 0), bands - 1)
    colour = int(solids[k, 10]) + band
    kind = solids[k, 0]
    if kind == 2.0:
        radius = solids[k, 9]
        return ex / radius, ey / radius, colour
    if z > top - RIM_M or (bottom > 0.0 and z < bottom + RIM_M):
        return 0.0, 0.0, colour
    if kind == 0.0:
        return ex / solids[k, 9], ey / solids[k, 9], colour
    lx, ly = ex * c + ey * s, ey * c - ex * s
    if solids[k, 6] - abs(ly) < solids[k, 5] - abs(lx):
        side = 1.0 if ly > 0.0 else -1.0
        middle = 0.5 * (bottom + top)
        if solids[k, 12] >= 0.0 and abs(lx) < 0.5 * solids[k, 5] and abs(z - middle) < 0.17 * (top - bottom):
            return -side * s, side * c, int(solids[k, 12])
        return -side * s, side * c, colour
    side = 1.0 if lx > 0.0 else -1.0
    return side * c, side * s, colour
