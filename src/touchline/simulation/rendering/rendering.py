"""Body rays of a camera + a scene -> linear radiance of each pixel, with supersampling where a pixel holds an edge.

Whether a pixel holds an edge is worked out from the world, not from neighbouring pixels: the ray through its middle is
compared with outlines, paint and shadows, and wherever one that nothing hides comes as close as the pixel's samples
reach, the pixel is averaged over its regular grid of samples. All others keep the one in their middle; what nets let by
and the tones of strips of carpet are averaged in place. Rays go through the loops in portions that stay in the
processor's cache.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.compiled import uncounted
from touchline.simulation.rendering.bare_carpet import (
    PLACE_ROWS,
    POINT_ROWS,
    find_plain,
    lay_out_bare,
    meet_ground,
    shade_bare,
)
from touchline.simulation.rendering.casting import cast_rays, spread_rays
from touchline.simulation.rendering.ground_shading import shade_marked, sift_ground, sort_rays
from touchline.simulation.rendering.nets import average_nets
from touchline.simulation.rendering.sampling import SampleRays, fill_samples, sample_rays
from touchline.simulation.rendering.scene import Scene, SceneArrays
from touchline.simulation.rendering.solids import sort_into_cells
from touchline.simulation.rendering.tracing import trace_rays
from touchline.simulation.rendering.upright_shading import shade_upright

Float32Array = npt.NDArray[np.float32]
Int32Array = npt.NDArray[np.int32]
Work = tuple[
    Float32Array, Int32Array, Int32Array, Int32Array, Int32Array, Float32Array, Float32Array, Float32Array,
    Float32Array, Int32Array, Int32Array,
]  # fmt: skip
SECTORS, BINS = 512, 128  # of the directions in which bodies are looked for
_PORTION = 2048
_UPRIGHT = 1e-4  # sine of the lean from which on pixels are turned notably


@dataclass(frozen=True, eq=False)
class RayGrid:
    """What each pixel of a camera looks along, in the body frame.

    rays (H, W, 6) float32: origin (m) and direction; NaN where a pixel sees no part of the world. pixel_angle: rad from
    one pixel to the next. origin (3,): about where rays start (m, body frame); slack_m: how far from it at most.
    still (H, W, 4) float32: red, green, blue of what is fixed to the robot (reflectance, premultiplied) and its share
    of the pixel.
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


class Renderer:
    """Renders linear radiance (H, W, 3) float32, red green blue, of one camera's rays."""

    def __init__(self, grid: RayGrid) -> None:
        self.grid = grid
        seen = np.isfinite(grid.rays).all(axis=2) & (grid.still[..., 3] < 1.0)
        self._pixels = np.flatnonzero(seen).astype(np.int32)
        self._rays = np.ascontiguousarray(grid.rays.reshape(-1, 6)[self._pixels].T)
        self._samples: dict[int, SampleRays] = {}
        layer = grid.still.reshape(-1, 4)  # mostly a grey veil, laid with each ray; the rest is laid over in the end
        colours, alpha = layer[:, :3], layer[:, 3]
        grey = (colours == alpha[:, np.newaxis]).all(axis=1)
        self._veil = np.where(grey & seen.reshape(-1), alpha, 0.0).astype(np.float32)
        laid = np.flatnonzero((self._veil == 0.0) & (colours > 0.0).any(axis=1) | (~grey & seen.reshape(-1)))
        self._laid, self._layer = laid.astype(np.int32), np.ascontiguousarray(layer[laid])
        self._layer[~seen.reshape(-1)[laid], 3] = 1.0  # no ray fills these
        self._image = np.zeros((*grid.shape, 3), dtype=np.float32)

    def render(self, scene: Scene, poses: FloatArray, side: int = 2, everywhere: bool = False) -> Float32Array:
        """Radiance (H, W, 3) of a scene from poses (1 or H, 12): rotation field_from_body by rows, then translation.

        side: samples along each side of a supersampled pixel; 1 for none. everywhere: supersample all pixels.
        The array is the renderer's own and is overwritten by the next call.
        """
        samples, chosen = self._sample_rays(side), self._pixels
        level = float(scene.light[::8, ::8, 0].mean())
        lean = float(np.hypot(poses[:, 6], poses[:, 7]).max())
        arrays = self._arrays(scene, poses, lean, samples.widest)
        if not everywhere:
            chosen = _render_middles(
                arrays, self._pixels, self._rays, samples.spread, samples.shift_m, lean, poses, self.grid.pixel_angle,
                samples.texture, self.grid.rays, side, self._veil, level, self._image,
            )  # fmt: skip
        if side > 1 or everywhere:
            _render_samples(
                arrays, chosen, self.grid.rays, poses, self.grid.pixel_angle, samples.angles, side, self._veil, level,
                self._image,
            )  # fmt: skip
        _lay_over(self._laid, self._layer, level, self._image.reshape(-1, 3))
        return self._image

    def _arrays(self, scene: Scene, poses: FloatArray, lean: float, widest: float) -> SceneArrays:
        """The scene as seen from poses: bodies sorted by direction around the middle of the places of the camera."""
        grid, samples = self.grid, next(iter(self._samples.values()))
        places = poses[:, :9].reshape(-1, 3, 3) @ grid.origin + poses[:, 9:]
        middle = places.mean(axis=0)
        moved = float(np.hypot(*(places - middle)[:, :2].T).max())
        tilted = lean * grid.slack_m + float(np.abs(places[:, 2] - middle[2]).max()) + 1e-3
        low, high = samples.heights_m
        height = middle[2] - grid.origin[2]
        starts, items, near = sort_into_cells(
            scene.solids, float(middle[0]), float(middle[1]), samples.aside_m + moved + tilted, grid.slack_m + moved,
            low + height - tilted, high + height + tilted, widest * (1.0 + lean), SECTORS, BINS,
        )  # fmt: skip
        return scene.arrays(starts, items, near)

    def _sample_rays(self, side: int) -> SampleRays:
        """The rays of all samples, made when first asked for."""
        if side not in self._samples:
            self._samples = {side: sample_rays(self.grid.rays, self._pixels, side, self.grid.pixel_angle)}
        return self._samples[side]


@njit(cache=True, error_model="numpy")
def _lay_over(pixels: Int32Array, layer: Float32Array, level: float, image: Float32Array) -> None:
    """Lay reflectances, premultiplied, and shares (N, 4) of pixels (N,), flat indices, over the image (H W, 3).

    Where the share is 1, nothing else was put into the image.
    """
    light = np.float32(level)
    for i in range(len(pixels)):
        n, rest = np.uint32(pixels[i]), np.float32(1.0) - layer[i, 3]
        for c in range(3):
            image[n, c] = (rest * image[n, c] if rest > np.float32(0.0) else np.float32(0.0)) + layer[i, c] * light


@uncounted
def _meet(
    scene: SceneArrays,
    total: int,
    cast: Float32Array,
    extents: Float32Array,
    shift: float,
    texture: Float32Array,
    net_angle: float,
    work: Work,
    edges: npt.NDArray[np.bool_],
) -> tuple[int, int, int]:
    """What the first `total` cast rays (9, N) meet, and edges (N,); counts of upright hits, of rays on the carpet, and
    of those where it is plain.

    extents (3, N), shift: how far a pixel's samples reach, see `spread_rays`; zero: these are samples. texture (5, N):
    how textures are smoothed, see `SampleRays`. net_angle: width of a sample (rad), over which nets are smoothed.
    """
    s = scene
    hits, codes, rest, ground, bare, landing, _, _, _, flag, plain = work
    edges[:total] = False
    meet_ground(cast, extents, shift, texture, total, landing)
    find_plain(cast, extents, landing, total, s.flag_words, s.flag_frame, s.carpet, s.sun[0] > 0.0, flag, plain)
    count, ground_count, bare_count = sort_rays(cast, landing, total, s.starts, s.room, plain, rest, ground, bare)
    walls = (s.room[0], s.room[1], s.room[2], s.room[3], s.room[4], s.room[5])
    if shift > 0.0:  # a loop for middles, and one for samples, which need no margins
        return trace_rays(
            cast, extents, shift, rest[:count], s.solids, s.starts, s.items, s.near, walls, net_angle, hits, codes,
            plain, ground, ground_count, bare, bare_count, edges, True,
        )  # fmt: skip
    return trace_rays(
        cast, extents, 0.0, rest[:count], s.solids, s.starts, s.items, s.near, walls, net_angle, hits, codes, plain,
        ground, ground_count, bare, bare_count, edges, False,
    )  # fmt: skip


@uncounted
def _shade(
    scene: SceneArrays,
    counts: tuple[int, int, int],
    cast: Float32Array,
    extents: Float32Array,
    shift: float,
    upright: bool,
    texture: Float32Array,
    work: Work,
    radiance: Float32Array,
    edges: npt.NDArray[np.bool_],
) -> None:
    """Radiance (N, 3) of what `_meet` counted; where edges (N,) is set instead, it is left as it was."""
    s, (count, ground_count, bare_count) = scene, counts
    hits, codes, rest, ground, bare, landing, places, points, marks, flag, _ = work
    lay_out_bare(bare[:bare_count], landing, flag, places, points)
    ground_count, bare_count, dots = sift_ground(
        ground[:ground_count], landing, cast, extents, texture, upright, flag, s.shapes, s.cell_starts, s.cell_items,
        s.paint_frame, s.carpet, s.casters, s.caster_cells, s.sun, s.windows, marks, bare, places, points, bare_count,
        edges,
    )  # fmt: skip
    shade_bare(bare[:bare_count], places, points, dots, s.light, s.light_frame, s.carpet, s.pyramid, s.sun, radiance)
    shade_marked(
        ground[:ground_count], marks, landing, cast, texture, flag, s.light, s.light_frame, s.paints, s.carpet,
        s.pyramid, float(s.sun[0]), radiance,
    )  # fmt: skip
    shade_upright(
        rest[:count], hits, codes, s.solids, s.palette, s.room, s.room_colours, s.light, s.light_frame, s.pyramid,
        s.casters, s.sun, s.windows, shift > 0.0, radiance, edges,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _work_space(size: int) -> Work:
    return (
        np.empty((size, 8), dtype=np.float32),
        np.empty(size, dtype=np.int32),
        np.empty(size, dtype=np.int32),
        np.empty(size, dtype=np.int32),
        np.empty(size, dtype=np.int32),
        np.empty((4, size), dtype=np.float32),
        np.empty((PLACE_ROWS, size), dtype=np.float32),
        np.empty((POINT_ROWS, 4 * size), dtype=np.float32),
        np.empty((4, size), dtype=np.float32),
        np.empty(size, dtype=np.int32),
        np.empty(size, dtype=np.int32),
    )


@njit(cache=True, error_model="numpy")
def _render_middles(
    scene: SceneArrays,
    pixels: npt.NDArray[np.int32],
    rays: Float32Array,
    spread: Float32Array,
    shift: float,
    lean: float,
    poses: FloatArray,
    pixel_angle: float,
    texture: Float32Array,
    grid: Float32Array,
    side: int,
    veil: Float32Array,
    level: float,
    image: Float32Array,
) -> npt.NDArray[np.int32]:
    """One sample in the middle of each of pixels (N,), flat indices, with rays (6, N), into the image.

    grid (H, W, 6): rays of all pixels, for the side x side samples of nets. Over the image lies a white veil, of these
    shares (H W,) of the pixels, under a light of some level.
    Returns the pixels that hold an edge; they are left as they were.
    """
    work, rows = _work_space(_PORTION), np.zeros(_PORTION, dtype=np.int32)
    radiance, edges = np.empty((_PORTION, 3), dtype=np.float32), np.empty(_PORTION, dtype=np.bool_)
    cast, extents = np.empty((9, _PORTION), dtype=np.float32), np.empty((3, _PORTION), dtype=np.float32)
    flat, chosen, edged = image.reshape(-1, 3), np.empty(len(pixels), dtype=np.int32), 0
    net_angle, light = pixel_angle / side, np.float32(level)
    for start in range(0, len(pixels), _PORTION):
        some = pixels[start : start + _PORTION]
        stop = start + len(some)
        if len(poses) > 1:
            for i in range(len(some)):
                rows[i] = some[i] // image.shape[1]
        cast_rays(rays, rows, poses, SECTORS, BINS, cast, start, len(some))
        here = texture[:, start:stop]
        spread_rays(spread, cast, lean, shift, extents, start, len(some))
        counts = _meet(scene, len(some), cast, extents, shift, here, net_angle, work, edges)
        average_nets(
            work[2][: counts[0]], work[0], cast, some, grid, side, rows, poses, scene.solids, scene.starts, scene.items,
            net_angle,
        )  # fmt: skip
        _shade(scene, counts, cast, extents, shift, lean < _UPRIGHT, here, work, radiance, edges)
        for i in range(len(some)):
            if edges[i]:
                chosen[edged] = some[i]
                edged += 1
                continue
            n = np.uint32(some[i])
            rest, over = np.float32(1.0) - veil[n], veil[n] * light
            for c in range(3):
                flat[n, c] = rest * radiance[i, c] + over
    return chosen[:edged].copy()


@njit(cache=True, error_model="numpy")
def _render_samples(
    scene: SceneArrays,
    pixels: npt.NDArray[np.int32],
    rays: Float32Array,
    poses: FloatArray,
    pixel_angle: float,
    angles: Float32Array,
    side: int,
    veil: Float32Array,
    level: float,
    image: Float32Array,
) -> None:
    """Means of side x side samples of pixels (N,), flat indices, and the veil over them, into the image.

    rays (H, W, 6): of all pixels.
    """
    each = side * side
    portion = max(1, _PORTION // each)
    work, rows = _work_space(portion * each), np.zeros(portion * each, dtype=np.int32)
    radiance, edges = np.empty((portion * each, 3), dtype=np.float32), np.empty(portion * each, dtype=np.bool_)
    samples, cast = np.empty((6, portion * each), dtype=np.float32), np.empty((9, portion * each), dtype=np.float32)
    extents, texture = np.zeros((3, portion * each), dtype=np.float32), np.zeros((5, portion * each), dtype=np.float32)
    flat, light = image.reshape(-1, 3), np.float32(level)
    for start in range(0, len(pixels), portion):
        some = pixels[start : start + portion]
        total = len(some) * each
        fill_samples(rays, some, side, samples)
        for i in range(len(some)):
            for n in range(i * each, (i + 1) * each):
                texture[4, n] = angles[some[i]]
        if len(poses) > 1:
            for i in range(total):
                rows[i] = some[i // each] // image.shape[1]
        cast_rays(samples, rows, poses, SECTORS, BINS, cast, 0, total)
        counts = _meet(scene, total, cast, extents, 0.0, texture, pixel_angle / side, work, edges)
        _shade(scene, counts, cast, extents, 0.0, True, texture, work, radiance, edges)
        for i in range(len(some)):
            pixel = np.uint32(some[i])
            rest, over = np.float32(1.0) - veil[pixel], veil[pixel] * light
            for c in range(3):
                mean = np.float32(0.0)
                for k in range(i * each, (i + 1) * each):
                    mean += radiance[np.uint32(k), c]
                flat[pixel, c] = rest * (mean / each) + over
