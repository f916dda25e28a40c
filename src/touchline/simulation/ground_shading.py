"""How bright the carpet and its paint are: lamps, sun, contact shadows, pile, wear and seams.

Rays whose cell holds no body and that end well within the carpet need no tracing (`sort_rays`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray
from touchline.simulation.compiled import uncounted
from touchline.simulation.illumination import (
    FLAGS_PER_M,
    HAS_PAINT,
    HAS_SEAM,
    NEAR_BODY,
    PAINT_AROUND,
    PAINT_NEAR,
    SUN_AROUND,
    SUN_EDGE,
    SUN_MARGIN_M,
    SUN_TIGHT_M,
    SUNLIT,
    contact_shadow,
    light_at,
    sun_at,
)
from touchline.simulation.paint import MARGIN_M, MIDDLE_MARGIN_M, TIGHT_MARGIN_M, paint_at
from touchline.simulation.pile import (
    FIRST_TEXEL_M,
    PILE,
    TONE_M,
    grain_at,
    past_seam,
    samples_apart,
    seam_share,
    two_levels,
)


@uncounted
def sort_rays(
    cast: npt.NDArray[np.float32],
    landing: npt.NDArray[np.float32],
    total: int,
    starts: npt.NDArray[np.int32],
    room: FloatArray,
    rest: npt.NDArray[np.int32],
    ground: npt.NDArray[np.int32],
) -> tuple[int, int]:
    """List which of the first `total` rays are to be traced (rest) and which surely end on the carpet; count both.

    cast (9, >= N): the rays, see `casting`; landing: see `bare_carpet.meet_ground`. starts: no body is near a
    ray whose cell is empty; room: see `trace_rays`.
    """
    count, ground_count = 0, 0
    half_length, half_width = np.float32(room[0]), np.float32(room[1])
    for i in range(total):
        cell, x, y, reach = np.uint32(cast[7, i]), abs(landing[0, i]), abs(landing[1, i]), landing[2, i]
        if x + reach < half_length and y + reach < half_width and starts[cell] == starts[cell + np.uint32(1)]:
            ground[ground_count] = i
            ground_count += 1
        else:
            rest[count] = i
            count += 1
    return count, ground_count


@uncounted
def shade_ground(
    ground: npt.NDArray[np.int32],
    landing: npt.NDArray[np.float32],
    cast: npt.NDArray[np.float32],
    extents: npt.NDArray[np.float32],
    texture: npt.NDArray[np.float32],
    flags: npt.NDArray[np.uint8],
    light: npt.NDArray[np.float32],
    light_frame: FloatArray,
    shapes: FloatArray,
    starts: npt.NDArray[np.int32],
    items: npt.NDArray[np.int16],
    paint_frame: FloatArray,
    paints: FloatArray,
    carpet: FloatArray,
    pyramid: npt.NDArray[np.float32],
    casters: FloatArray,
    caster_cells: npt.NDArray[np.int16],
    sun: FloatArray,
    windows: FloatArray,
    radiance: npt.NDArray[np.float32],
    edges: npt.NDArray[np.bool_],
) -> None:
    """Fill radiance (N, 3) of the rays that `ground` lists, all on the carpet, or set edges (N,) where one is near.

    landing (4, >= N), cast (9, >= N), extents (3, >= N), texture (5, >= N): the rays, see `bare_carpet.meet_ground`,
    `casting` and `sampling`. carpet (5,):
    colour, seam spacing, contrast; paints (P, 3) colours; the other arrays: see the functions that read them.
    """
    x0, y0 = paint_frame[0], paint_frame[1]
    for n in range(len(ground)):
        i = np.uint32(ground[n])
        s, ux, uy, stretch = float(cast[6, i]), float(cast[3, i]), float(cast[4, i]), float(cast[8, i])
        x, y, reach, square = float(landing[0, i]), float(landing[1, i]), float(landing[2, i]), float(landing[3, i])
        deep, long = float(extents[2, i]), texture[4, i] * stretch
        wide = reach - deep
        flag = flags[np.uint32((y - y0) * FLAGS_PER_M), np.uint32((x - x0) * FLAGS_PER_M)] & 0xFF
        if reach < MIDDLE_MARGIN_M:
            flag &= 0xFF - (PAINT_AROUND if reach >= TIGHT_MARGIN_M else PAINT_AROUND | PAINT_NEAR)
        paint, share, edge = -1, 1.0, reach >= MARGIN_M
        if square < 32.0 * FIRST_TEXEL_M**2 and deep > 0.0:
            edge = edge or two_levels(square / FIRST_TEXEL_M**2, 4.0 * s * deep / (stretch * cast[2, i]))
        sunlit = flag & SUNLIT != 0
        if flag & (HAS_PAINT | PAINT_NEAR | PAINT_AROUND):
            paint, near = paint_at(shapes, starts, items, paint_frame, x, y, ux, uy, deep, wide)
            edge = edge or near
        if flag & NEAR_BODY:
            share, near = contact_shadow(casters, caster_cells, paint_frame, x, y, reach)
            edge = edge or near
        if flag & (SUN_EDGE if reach < SUN_TIGHT_M else SUN_EDGE | SUN_AROUND) or (
            sun[0] > 0.0 and reach >= SUN_MARGIN_M
        ):
            sunlit, near = sun_at(sun, windows, casters, x, y, 0.0, np.sqrt(deep * deep + wide * wide))
            edge = edge or near
        aside = abs(ux) * deep + abs(uy) * wide
        if carpet[3] > 0.0 and aside > TONE_M:
            edge = edge or abs(past_seam(carpet, x)) < aside + TONE_M
        if edge and deep > 0.0:
            edges[i] = True
            continue
        px, py, qx, qy = 0.0, 0.0, 0.0, 0.0
        if long < FIRST_TEXEL_M or flag & HAS_SEAM:
            px, py, qx, qy = samples_apart(
                texture[0, i], texture[1, i], texture[2, i], texture[3, i], stretch, cast[2, i], ux, uy
            )
        grain = carpet[4] * PILE * grain_at(pyramid, x, y, square, px, py, qx, qy)
        if paint >= 0:
            level = light_at(light, light_frame, 0, x, y) * share + (sun[0] if sunlit else 0.0)
            level *= 1.0 + 0.25 * grain
            for c in range(3):
                radiance[i, c] = paints[paint, c] * level
            continue
        level = share + (sun[0] / light_at(light, light_frame, 0, x, y) if sunlit else 0.0)
        if flag & HAS_SEAM:
            level *= seam_share(carpet, x, abs(ux) * long + abs(uy) * s * texture[4, i], px, qx)
        level *= light_at(light, light_frame, 1, x, y) * (1.0 + grain)
        for c in range(3):
            radiance[i, c] = carpet[c] * level
