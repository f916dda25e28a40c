"""How bright the carpet and its paint are: lamps, sun, contact shadows, pile, wear and seams.

Rays whose cell holds no body and that end well within the carpet need no tracing (`sort_rays`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray
from touchline.simulation.compiled import uncounted
from touchline.simulation.rendering.illumination import (
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
from touchline.simulation.rendering.paint import MARGIN_M, MIDDLE_MARGIN_M, TIGHT_MARGIN_M, paint_at
from touchline.simulation.rendering.pile import (
    FIRST_TEXEL_M,
    PILE,
    TONE_M,
    grain_at,
    past_seam,
    reaches_texels,
    samples_apart,
    samples_within,
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
    plain: npt.NDArray[np.int32],
    rest: npt.NDArray[np.int32],
    ground: npt.NDArray[np.int32],
    bare: npt.NDArray[np.int32],
) -> tuple[int, int, int]:
    """List which of the first `total` rays are to be traced (rest) and which surely end on the carpet: where it is
    plain (bare), or elsewhere (ground). Counts all three.

    cast (9, >= N): the rays, see `casting`; landing, plain: see `bare_carpet`. starts: no body is near a ray whose
    cell is empty; room: see `trace_rays`.
    """
    count, ground_count, bare_count = 0, 0, 0
    half_length, half_width = np.float32(room[0]), np.float32(room[1])
    for i in range(total):
        cell, x, y, reach = np.uint32(cast[7, i]), abs(landing[0, i]), abs(landing[1, i]), landing[2, i]
        if x + reach < half_length and y + reach < half_width and starts[cell] == starts[cell + np.uint32(1)]:
            if plain[i] != 0:
                bare[bare_count] = i
                bare_count += 1
            else:
                ground[ground_count] = i
                ground_count += 1
        else:
            rest[count] = i
            count += 1
    return count, ground_count, bare_count


@uncounted
def sift_ground(
    ground: npt.NDArray[np.int32],
    landing: npt.NDArray[np.float32],
    cast: npt.NDArray[np.float32],
    extents: npt.NDArray[np.float32],
    texture: npt.NDArray[np.float32],
    upright: bool,
    flags: npt.NDArray[np.int32],
    shapes: FloatArray,
    starts: npt.NDArray[np.int32],
    items: npt.NDArray[np.int16],
    paint_frame: FloatArray,
    carpet: FloatArray,
    casters: FloatArray,
    caster_cells: npt.NDArray[np.int16],
    sun: FloatArray,
    windows: FloatArray,
    marks: npt.NDArray[np.float32],
    bare: npt.NDArray[np.int32],
    places: npt.NDArray[np.float32],
    points: npt.NDArray[np.float32],
    count: int,
    edges: npt.NDArray[np.bool_],
) -> tuple[int, int, int]:
    """Look closely at rays on the carpet (N,): those that see nothing but pile join the first `count` of `bare`, those
    that see paint, a seam or two strips stay; edges (N,) is set where a pixel's samples may see different things.
    Counts those that stay, the bare ones and their points.

    landing (4, >= N), flags (N,), cast (9, >= N), extents (3, >= N), texture (5, >= N): the rays, see `bare_carpet`,
    `casting` and `sampling`; upright: whether the camera stands so; shapes, ... windows: see the functions that read
    them. marks (4, N), of those that stay: number of the paint or -1, share of the lamps' light beside bodies, 1 in the
    sun, 1 where strips meet. places (8, N): x, y of each bare one (m), 1 in the sun, its first point and how many,
    share of the lamps' light.
    points (7, 4 N): x, y of points on the pile and the square (m^2) it is smoothed over there: one for each ray, or its
    pixel's four samples.
    """
    left, dots, sunny, first = 0, count, sun[0] > 0.0, FIRST_TEXEL_M * FIRST_TEXEL_M
    for n in range(len(ground)):
        i = np.uint32(ground[n])
        x, y, reach, square = float(landing[0, i]), float(landing[1, i]), float(landing[2, i]), float(landing[3, i])
        deep, flag = float(extents[2, i]), flags[i]
        edge, tone, share, paint, sunlit = reach >= MARGIN_M, False, 1.0, -1, flag & SUNLIT != 0
        if square < 32.0 * first and deep > 0.0:
            edge = edge or two_levels(square / first, 4.0 * cast[6, i] * deep / (cast[8, i] * cast[2, i]))
        if carpet[3] > 0.0 and reach > TONE_M:
            aside = abs(cast[3, i]) * deep + abs(cast[4, i]) * (reach - deep)
            tone = aside > TONE_M and abs(past_seam(carpet, x)) < aside + TONE_M
            edge = edge or (tone and texture[0, i] == 0.0 and texture[1, i] == 0.0)  # no samples at +-p +-q
        if flag & NEAR_BODY:
            share, near = contact_shadow(casters, caster_cells, paint_frame, x, y, reach)
            edge = edge or near
        may_be_painted, may_be_crossed = HAS_PAINT, SUN_EDGE if reach < SUN_TIGHT_M else SUN_EDGE | SUN_AROUND
        if reach >= TIGHT_MARGIN_M:
            may_be_painted |= PAINT_NEAR if reach < MIDDLE_MARGIN_M else PAINT_NEAR | PAINT_AROUND
        painted, crossed = flag & may_be_painted != 0, flag & may_be_crossed != 0 or (sunny and reach >= SUN_MARGIN_M)
        if (painted or crossed) and not edge:
            px, py, qx, qy = 0.0, 0.0, 0.0, 0.0
            if deep > 0.0:
                px, py, qx, qy = samples_within(
                    texture[0, i], texture[1, i], texture[2, i], texture[3, i], deep, reach - deep, cast[3, i],
                    cast[4, i], upright,
                )  # fmt: skip
            if painted:
                paint, edge = paint_at(shapes, starts, items, paint_frame, x, y, px, py, qx, qy)
            if crossed:
                sunlit, near = sun_at(sun, windows, casters, x, y, 0.0, 0.0, px, py, qx, qy)
                edge = edge or near
        if edge and deep > 0.0:
            edges[i] = True
            continue
        if paint >= 0 or tone or flag & HAS_SEAM:
            ground[left] = i
            marks[0, left], marks[1, left] = paint, share
            marks[2, left], marks[3, left] = 1.0 if sunlit else 0.0, 1.0 if tone else 0.0
            left += 1
            continue
        bare[count] = i
        places[0, count], places[1, count], places[2, count] = x, y, 1.0 if sunlit else 0.0
        places[3, count], places[4, count], places[5, count] = dots, 1.0, share
        points[0, dots], points[1, dots], points[2, dots] = x, y, square
        if square <= first and deep > 0.0:
            px, py, qx, qy = samples_apart(
                texture[0, i], texture[1, i], texture[2, i], texture[3, i], cast[8, i], cast[2, i], cast[3, i],
                cast[4, i],
            )  # fmt: skip
            if reaches_texels(px, py, qx, qy):
                points[0, dots], points[1, dots] = x + px + qx, y + py + qy
                points[0, dots + 1], points[1, dots + 1] = x + px - qx, y + py - qy
                points[0, dots + 2], points[1, dots + 2] = x - px + qx, y - py + qy
                points[0, dots + 3], points[1, dots + 3] = x - px - qx, y - py - qy
                points[2, dots : dots + 4] = 0.0
                places[4, count] = 4.0
                dots += 3
        dots += 1
        count += 1
    return left, count, dots


@uncounted
def shade_marked(
    ground: npt.NDArray[np.int32],
    marks: npt.NDArray[np.float32],
    landing: npt.NDArray[np.float32],
    cast: npt.NDArray[np.float32],
    texture: npt.NDArray[np.float32],
    flags: npt.NDArray[np.int32],
    light: npt.NDArray[np.float32],
    light_frame: FloatArray,
    paints: FloatArray,
    carpet: FloatArray,
    pyramid: npt.NDArray[np.float32],
    sun: float,
    radiance: npt.NDArray[np.float32],
) -> None:
    """Fill radiance (N, 3) of the rays that `sift_ground` left in `ground`, with their marks.

    carpet (5,): colour, seam spacing, contrast; paints (P, 3) colours; sun: its level.
    """
    for n in range(len(ground)):
        i = np.uint32(ground[n])
        ux, uy, stretch = float(cast[3, i]), float(cast[4, i]), float(cast[8, i])
        x, y, square = float(landing[0, i]), float(landing[1, i]), float(landing[3, i])
        paint, tone, direct = int(marks[0, n]), marks[3, n] > 0.0, sun * float(marks[2, n])
        px, py, qx, qy = samples_apart(
            texture[0, i], texture[1, i], texture[2, i], texture[3, i], stretch, cast[2, i], ux, uy
        )
        grain = carpet[4] * PILE * grain_at(pyramid, x, y, square, px, py, qx, qy)
        if paint >= 0:
            level = (light_at(light, light_frame, 0, x, y) * marks[1, n] + direct) * (1.0 + 0.25 * grain)
            for c in range(3):
                radiance[i, c] = paints[paint, c] * level
            continue
        level = float(marks[1, n])
        if direct > 0.0:
            level += direct / light_at(light, light_frame, 0, x, y)
        if flags[i] & HAS_SEAM:
            width = texture[4, i] * (abs(ux) * stretch + abs(uy) * cast[6, i])
            level *= seam_share(carpet, x, width, px, qx)
        if tone:  # it changes from strip to strip
            level *= 0.25 * (
                light_at(light, light_frame, 1, x + px + qx, y + py + qy)
                + light_at(light, light_frame, 1, x + px - qx, y + py - qy)
                + light_at(light, light_frame, 1, x - px + qx, y - py + qy)
                + light_at(light, light_frame, 1, x - px - qx, y - py - qy)
            )
        else:
            level *= light_at(light, light_frame, 1, x, y)
        level *= 1.0 + grain
        for c in range(3):
            radiance[i, c] = carpet[c] * level
