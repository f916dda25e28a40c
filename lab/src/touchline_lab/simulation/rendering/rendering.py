"""Body rays of a camera + a scene -> linear radiance of each pixel, the mean over 2 x 2 samples.

The rays of all samples are worked out once for a camera. An image is rendered row by row: the rays of a row are cast
into the field, traced to what they meet first, shaded and averaged.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import Float32Array, FloatArray, Int32Array, IntArray
from touchline_lab.simulation.rendering import solids as body
from touchline_lab.simulation.rendering.carpet import PILE, pile_at, rubbed_off, seam_shade
from touchline_lab.simulation.rendering.casting import CAST_ROWS, cast_rays
from touchline_lab.simulation.rendering.illumination import (
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
from touchline_lab.simulation.rendering.paint import paint_at
from touchline_lab.simulation.rendering.scene import Scene, SceneArrays
from touchline_lab.simulation.rendering.solids import sort_into_cells
from touchline_lab.simulation.rendering.tracing import BOARD, CARPET, CEILING, FLOOR, Hits, trace_rays

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
        if direct > 0.0 or flag & HAS_PAINT or carpet[5] + carpet[6] > 0.0:
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
        if carpet[5] > 0.0:  # a sheen: all of it at grazing angles, none from above, the sun's towards it
            steep = -cast[5, i] / np.sqrt(1.0 + cast[5, i] * cast[5, i])
            towards_sun = max(cast[3, i] * sun[1] + cast[4, i] * sun[2], 0.0)
            for channel in range(3):
                radiance[i, channel] += carpet[5] * (1.0 - steep) ** 2 * (lamps + direct * towards_sun)
        if carpet[6] > 0.0:
            for channel in range(3):
                tint = light_at(light, frame, 2 + channel, x, y)
                radiance[i, channel] *= (lamps * tint + direct) / (lamps + direct)


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
            tint = light_at(light, frame, 2 + channel, x, y) if scene.carpet[6] > 0.0 else 1.0
            radiance[i, channel] = level * tint * (palette[number, channel] if code >= 0 else colours[row, channel])


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


_WIDE = 1.3  # pixels so much wider than the camera's usual ones have their textures smoothed over their true width


@dataclass(frozen=True, eq=False)
class RayGrid:
    """What each pixel of a camera looks along, in the body frame.

    rays (H, W, 6) float32: origin (m) and direction; NaN where a pixel sees no part of the world. pixel_angle: rad from
    one pixel to the next. origin (3,): about where rays start (m, body frame); slack_m: how far from it at most.
    still (H, W, 4) float32: red, green, blue of what is fixed to the robot (reflectance, premultiplied) and its share
    of the pixel. Grids are equal where all their numbers are.
    """

    rays: Float32Array
    pixel_angle: float
    origin: FloatArray
    slack_m: float
    still: Float32Array

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self.rays.shape[0], self.rays.shape[1]

    def __hash__(self) -> int:
        return hash(self.rays.tobytes())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RayGrid) and self._content() == other._content()

    def _content(self) -> tuple[float | bytes, ...]:
        arrays = (self.rays, self.origin, self.still)
        return (self.pixel_angle, self.slack_m, *self.shape, *(array.tobytes() for array in arrays))


class SampleRays(NamedTuple):
    """The samples of all pixels that see the world, row by row of the image.

    rays (6, N * each): origin and direction, body frame; pixels (N,): flat indices; starts (H + 1,): where each row of
    the image begins among the pixels. widths (N,): angle (rad) over which textures are smoothed; open_ratio (N,): of a
    pixel, what nothing fixed to the robot covers. each: samples of a pixel.
    """

    rays: Float32Array
    pixels: Int32Array
    starts: IntArray
    widths: Float32Array
    open_ratio: Float32Array
    each: int


class Renderer:
    """Renders linear radiance (H, W, 3) float32, red green blue, of one camera's rays.

    side: samples along each side of a pixel.
    """

    def __init__(self, grid: RayGrid, side: int = 2) -> None:
        self.grid = grid
        self._upright, self._aside_m, self._heights_m = _prepared(grid, side)
        self._samples = self._upright
        self._still = np.ascontiguousarray(grid.still[..., :3])
        self._image = np.zeros((*grid.shape, 3), dtype=np.float32)

    def bend(self, change: Float32Array | None) -> None:
        """From now on let every pixel look along its ray plus a change (H, W, 6), a small one; None: along its ray."""
        if change is None:
            self._samples = self._upright
            return
        added = np.repeat(change.reshape(-1, 6)[self._upright.pixels], self._upright.each, axis=0)
        self._samples = self._upright._replace(rays=self._upright.rays + added.T)

    def render(self, scene: Scene, poses: FloatArray) -> Float32Array:
        """Radiance (H, W, 3) of a scene from poses (1 or H, 12): rotation field_from_body by rows, then translation.

        The array is the renderer's own and is overwritten by the next call.
        """
        np.multiply(self._still, np.float32(scene.light[::8, ::8, 0].mean()), out=self._image)
        _render_rows(self._arrays(scene, poses), self._samples, poses, self.grid.pixel_angle, self._image)
        return self._image

    def _arrays(self, scene: Scene, poses: FloatArray) -> SceneArrays:
        """The scene as seen from poses: bodies sorted by direction around the middle of the places of the camera."""
        grid = self.grid
        places = poses[:, :9].reshape(-1, 3, 3) @ grid.origin + poses[:, 9:]
        middle = places.mean(axis=0)
        moved = float(np.hypot(*(places - middle)[:, :2].T).max())
        lean = float(np.hypot(poses[:, 6], poses[:, 7]).max())
        tilted = lean * grid.slack_m + float(np.abs(places[:, 2] - middle[2]).max()) + 1e-3
        low, high = (middle[2] - grid.origin[2] + height for height in self._heights_m)
        reach = (self._aside_m + moved + tilted, grid.slack_m + moved)
        return scene.arrays(sort_into_cells(scene.solids, middle, reach, (low - tilted, high + tilted)))


@lru_cache(maxsize=2)
def _prepared(grid: RayGrid, side: int) -> tuple[SampleRays, float, tuple[float, float]]:
    """The samples of a camera, how far aside of the grid's origin (m) they pass at most, and from which heights (m).

    Kept for the next camera: most runs have the camera of the run before.
    """
    samples = sample_rays(grid, side)
    seen = samples.rays.astype(np.float64)
    x, y = seen[0] - grid.origin[0], seen[1] - grid.origin[1]
    level = np.maximum(np.hypot(seen[3], seen[4]), 1e-9)
    aside_m = float(np.max(np.abs(x * seen[4] - y * seen[3]) / level, initial=0.0))
    return samples, aside_m, (float(seen[2].min(initial=np.inf)), float(seen[2].max(initial=-np.inf)))


def sample_rays(grid: RayGrid, side: int) -> SampleRays:
    """The side x side samples of every pixel that sees the world, between the rays of its neighbours."""
    rays, (height, width) = grid.rays, grid.shape
    seen = np.isfinite(rays).all(axis=2) & (grid.still[..., 3] < 1.0)
    pixels = np.flatnonzero(seen)
    middle = rays.reshape(-1, 6)[pixels]
    across, down = (_step(rays, axis).reshape(-1, 6)[pixels] for axis in (1, 0))
    offsets = (np.arange(side) + 0.5) / side - 0.5
    flat = np.empty((6, len(pixels) * side * side), dtype=np.float32)
    lowest, highest = np.full(len(pixels), np.inf), np.full(len(pixels), -np.inf)
    for k, (dv, du) in enumerate(product(offsets, offsets)):
        sample = middle + du * across + dv * down
        flat[:, k :: side * side] = sample.T
        rises = np.arctan2(sample[:, 5], np.hypot(sample[:, 3], sample[:, 4]))
        lowest, highest = np.minimum(lowest, rises), np.maximum(highest, rises)
    widths = (highest - lowest) * (side / max(side - 1, 1))
    widths[widths < _WIDE * grid.pixel_angle] = grid.pixel_angle
    starts = np.searchsorted(pixels // width, np.arange(height + 1))
    open_ratio = 1.0 - grid.still[..., 3].reshape(-1)[pixels]
    return SampleRays(flat, pixels.astype(np.int32), starts, widths.astype(np.float32), open_ratio, side * side)


def _step(rays: Float32Array, axis: int) -> FloatArray:
    """(H, W, 6) by how much rays change from a pixel to the next: half the way between both neighbours that see."""
    ahead = np.diff(rays, axis=axis, append=np.take(rays, [-1], axis=axis) * np.float32(np.nan))
    behind = np.roll(ahead, 1, axis=axis)
    found = [np.isfinite(step).all(axis=-1, keepdims=True) for step in (ahead, behind)]
    total = np.where(found[0], ahead, 0.0) + np.where(found[1], behind, 0.0)
    return total / np.maximum(found[0].astype(np.int64) + found[1], 1)


@njit(cache=True, error_model="numpy")
def _render_rows(
    scene: SceneArrays, samples: SampleRays, poses: FloatArray, pixel_angle: float, image: Float32Array
) -> None:
    """Add the means of all pixels' samples to the image (H, W, 3)."""
    flat, each, rows = image.reshape(-1, 3), samples.each, len(samples.starts) - 1
    most = image.shape[1] * each
    cast, radiance = np.empty((CAST_ROWS, most), dtype=np.float32), np.empty((most, 3), dtype=np.float32)
    hits = Hits(np.empty(most, dtype=np.int32), np.empty((4, most), dtype=np.float32))
    net_angle = pixel_angle / np.sqrt(each)
    for row in range(rows):
        first, last = samples.starts[row], samples.starts[row + 1]
        if first == last:
            continue
        count = (last - first) * each
        cast_rays(samples.rays, first * each, count, poses[row if len(poses) > 1 else 0].astype(np.float32), cast)
        trace_rays(scene, cast, count, net_angle, hits)
        shade_rays(scene, cast, hits, samples.widths[first:last], each, radiance)
        for i in range(last - first):
            pixel, ratio = samples.pixels[first + i], samples.open_ratio[first + i] / np.float32(each)
            for channel in range(3):
                total = np.float32(0.0)
                for k in range(i * each, (i + 1) * each):
                    total += radiance[k, channel]
                flat[pixel, channel] += ratio * total
