"""How bright what a ray met is: carpet and paint, upright bodies, walls and floor, and nets before all. All is matt."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.rendering import solids as body
from touchline.simulation.rendering.carpet import PILE, pile_at, rubbed_off, seam_shade
from touchline.simulation.rendering.illumination import (
    FLAGS_PER_M,
    HAS_PAINT,
    HAS_SEAM,
    NEAR_BODY,
    SUN_EDGE,
    SUNLIT,
    contact_shadow,
    light_at,
    sun_at,
)
from touchline.simulation.rendering.paint import paint_at
from touchline.simulation.rendering.scene import SceneArrays
from touchline.simulation.rendering.tracing import BOARD, CARPET, CEILING, FLOOR, Hits

Float32Array = npt.NDArray[np.float32]
_NET_REFLECTANCE = 0.72
_RIM_M = 1e-4  # so near to its upper or lower end a side is shaded as the end is
_WALL_BLOTCH, _BODY_BLOTCH = 0.025, 0.005  # contrast of blotches on walls and on bodies
_BLOTCHES = 512 * 512 + 256 * 256 + 128 * 128  # where the level of 64 x 64 texels starts in the pyramid


@njit(cache=True, error_model="numpy")
def shade_rays(
    scene: SceneArrays, cast: Float32Array, hits: Hits, widths: Float32Array, each: int, radiance: Float32Array
) -> None:
    """Fill radiance (>= N each, 3) of cast rays (9, >= N each), see `casting`, that met `hits`.

    widths (N,): the angle (rad) of each pixel, of `each` rays, over which textures are smoothed.
    """
    _shade_ground(scene, cast, hits, widths, each, radiance)
    _shade_upright(scene, cast, hits, len(widths) * each, radiance)
    light, frame = scene.light, scene.light_frame
    for i in range(len(widths) * each):
        open_ratio = hits.places[3, i]
        if open_ratio < 1.0:
            level = light_at(light, frame, 0, hits.places[0, i], hits.places[1, i])
            for channel in range(3):
                net = (np.float32(1.0) - open_ratio) * _NET_REFLECTANCE * level
                radiance[i, channel] = open_ratio * radiance[i, channel] + net


@njit(cache=True, error_model="numpy")
def _shade_ground(
    scene: SceneArrays, cast: Float32Array, hits: Hits, widths: Float32Array, each: int, radiance: Float32Array
) -> None:
    """Rays that met the carpet: lamps, sun, contact shadows, pile, wear, seams and paint."""
    # Numba counts references to what a function takes out of a tuple or is given; so no tuple is handed on in the loop
    flags, x0, y0, sun, windows, casters = (
        scene.flags, scene.paint.frame[0], scene.paint.frame[1], scene.sun, scene.windows, scene.casters
    )  # fmt: skip
    carpet, pyramid, light, frame, paint_grid, paints, wear = (
        scene.carpet, scene.pyramid, scene.light, scene.light_frame, scene.paint, scene.paints, scene.wear
    )  # fmt: skip
    codes, places, worn = hits.codes, hits.places, scene.wear[0] + scene.wear[1] > 0.0
    for i in range(len(widths) * each):
        if codes[i] != CARPET:
            continue
        x, y = float(places[0, i]), float(places[1, i])
        flag = flags[np.int64((y - y0) * FLAGS_PER_M), np.int64((x - x0) * FLAGS_PER_M)]
        ratio, direct = 1.0, sun[0] if flag & SUNLIT else 0.0
        if flag & NEAR_BODY:
            ratio = contact_shadow(casters, x, y)
        if flag & SUN_EDGE:
            direct = sun[0] if sun_at(sun, windows, casters, x, y, 0.0) else 0.0
        width = widths[i // each]
        along = width * cast[8, i]  # how long a pixel is on the ground (m)
        grain = carpet[4] * PILE * pile_at(pyramid, x, y, 1.5 * along * along)
        level, lamps, paint = light_at(light, frame, 1, x, y) * ratio, 0.0, -1
        if direct > 0.0 or flag & HAS_PAINT:
            lamps = light_at(light, frame, 0, x, y) * ratio
            level *= 1.0 + direct / lamps
        if flag & HAS_PAINT:
            paint = paint_at(paint_grid, x, y)
        if flag & HAS_SEAM:
            level *= seam_shade(carpet, x, abs(cast[3, i]) * along + abs(cast[4, i]) * width * cast[6, i])
        level *= 1.0 + grain
        for channel in range(3):
            radiance[i, channel] = carpet[channel] * level
        if paint >= 0:
            level, bare = (lamps + direct) * (1.0 + 0.25 * grain), 0.0
            if worn and paint == 0:
                bare, dirt = rubbed_off(pyramid, wear, x, y)
                level *= 1.0 - dirt
            for channel in range(3):
                colour = paints[paint, channel] * level
                radiance[i, channel] = (1.0 - bare) * colour + bare * radiance[i, channel]


@njit(cache=True, error_model="numpy")
def _shade_upright(scene: SceneArrays, cast: Float32Array, hits: Hits, count: int, radiance: Float32Array) -> None:
    """Rays that met a body, wall, board, floor or ceiling."""
    solids, palette, colours, light, frame = (
        scene.solids, scene.palette, scene.room_colours, scene.light, scene.light_frame
    )  # fmt: skip
    pyramid, sun, windows, nobody = scene.pyramid, scene.sun, scene.windows, scene.casters[:0]
    codes, places = hits.codes, hits.places
    for i in range(count):
        code, x, y, z = codes[i], float(places[0, i]), float(places[1, i]), float(places[2, i])
        if code == CARPET:
            continue
        level = light_at(light, frame, 0, x, y)
        nx, ny, number, blotch = 0.0, 0.0, 0, _WALL_BLOTCH
        if code >= 0:
            nx, ny, number = _face(solids, code, x, y, z)
            blotch = _BODY_BLOTCH
        elif code == BOARD:
            nx, ny = -cast[3, i], -cast[4, i]
        elif code == CEILING:
            level *= 0.6
        elif code != FLOOR:
            nx = (-1.0 if code == -4 else 1.0) if code >= -5 else 0.0
            ny = (-1.0 if code == -6 else 1.0) if code < -5 else 0.0
        upright = nx != 0.0 or ny != 0.0
        if upright:
            level *= 0.75 + 0.10 * (0.5 * nx + 0.87 * ny)
        facing = nx * sun[1] + ny * sun[2] if upright else sun[3]
        if sun[0] > 0.0 and facing > 0.0 and sun_at(sun, windows, nobody, x, y, z):
            level += sun[0] * min(facing / max(sun[3], 0.2), 2.0)
        texel = (int(z * 20.0 + 4096.0) & 63) * 64 + (int((x + y) * 14.0 + 4096.0) & 63)
        level *= 1.0 + blotch * pyramid[_BLOTCHES + texel]
        row = 0 if code == FLOOR else (1 if code == BOARD else (3 if code == CEILING else 2))
        for channel in range(3):
            radiance[i, channel] = level * (palette[number, channel] if code >= 0 else colours[row, channel])


@njit(cache=True, error_model="numpy")
def _face(solids: FloatArray, k: int, x: float, y: float, z: float) -> tuple[float, float, int]:
    """Horizontal normal (0, 0 on top) and colour number of a point on solid k."""
    ex, ey = x - solids[k, body.X], y - solids[k, body.Y]
    bottom, top, radius = solids[k, body.BOTTOM], solids[k, body.TOP], solids[k, body.RADIUS]
    bands = int(solids[k, body.BANDS])
    colour = int(solids[k, body.COLOUR]) + min(max(int((z - bottom) / (top - bottom) * bands), 0), bands - 1)
    if solids[k, body.KIND] == body.BALL:
        return ex / radius, ey / radius, colour
    if z > top - _RIM_M or (bottom > 0.0 and z < bottom + _RIM_M):
        return 0.0, 0.0, colour
    if solids[k, body.KIND] == body.CYLINDER:
        return ex / radius, ey / radius, colour
    c, s, half_length = solids[k, body.COS], solids[k, body.SIN], solids[k, body.HALF_LENGTH]
    along, across = ex * c + ey * s, ey * c - ex * s
    if solids[k, body.HALF_WIDTH] - abs(across) < half_length - abs(along):
        side = 1.0 if across > 0.0 else -1.0
        high = abs(z - 0.5 * (bottom + top)) < 0.17 * (top - bottom)
        if solids[k, body.DECAL] >= 0.0 and abs(along) < 0.5 * half_length and high:
            colour = int(solids[k, body.DECAL])
        return -side * s, side * c, colour
    side = 1.0 if along > 0.0 else -1.0
    return side * c, side * s, colour
