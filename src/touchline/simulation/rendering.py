"""Body rays of a camera + a scene -> linear radiance of each pixel, with supersampling where a pixel holds an edge.

Edges are pixels whose label (which body, face, band; sunlit or not) differs from a neighbour's, or whose samples could lie
on both sides of a paint's edge. They are averaged over a regular grid of samples; all others keep the one in their middle.
Rays go through the loops in portions that stay in the processor's cache.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.casting import cast_rays
from touchline.simulation.ground_shading import EDGE_FLAG, shade_ground, shade_open_carpet
from touchline.simulation.scene import Scene, SceneArrays
from touchline.simulation.solids import first_bodies, sort_into_sectors
from touchline.simulation.tracing import trace_rays
from touchline.simulation.upright_shading import shade_upright

Float32Array = npt.NDArray[np.float32]
_PORTION = 2048
_ALL_CARPET = np.zeros(0, dtype=np.int32)


@dataclass(frozen=True, eq=False)
class RayGrid:
    """What each pixel of a camera looks along, in the body frame.

    rays (H, W, 6) float32: origin (m) and direction; NaN where a pixel sees no part of the world. pixel_angle: rad from
    one pixel to the next. origin (3,): about where rays start (m, body frame); slack_m: how far from it at most.
    still (H, W, 4) float32: red, green, blue of what is fixed to the robot (reflectance, premultiplied) and its share of
    the pixel.
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
        height, width = grid.shape
        seen = np.isfinite(grid.rays).all(axis=2) & (grid.still[..., 3] < 1.0)
        self._pixels = np.flatnonzero(seen).astype(np.int32)
        self._rays = np.ascontiguousarray(grid.rays.reshape(-1, 6)[self._pixels].T)
        self._samples: dict[int, Float32Array] = {}
        dark = (grid.still[..., 3] == 1.0) & (grid.still[..., :3] == 0.0).all(axis=2)  # black for ever
        self._still_pixels = np.flatnonzero((grid.still[..., 3] > 0.0) & ~dark).astype(np.int32)
        self._labels = np.zeros((height, width), dtype=np.int32)
        self._image = np.zeros((height, width, 3), dtype=np.float32)

    def render(self, scene: Scene, poses: FloatArray, side: int = 2, everywhere: bool = False) -> Float32Array:
        """Radiance (H, W, 3) of a scene from poses (1 or H, 12): rotation field_from_body by rows, then translation.

        side: samples along each side of a supersampled pixel; 1 for none. everywhere: supersample all pixels.
        The array is the renderer's own and is overwritten by the next call.
        """
        grid = self.grid
        places = (poses[:, :9].reshape(-1, 3, 3) @ grid.origin + poses[:, 9:])[:, :2]
        middle = places.mean(axis=0)
        slack = grid.slack_m + float(np.hypot(*(places - middle).T).max())
        starts, items, near = sort_into_sectors(scene.solids, float(middle[0]), float(middle[1]), slack)
        arrays = scene.arrays(starts, items, near, first_bodies(starts, items, near))
        _render_middles(arrays, self._pixels, self._rays, poses, grid.pixel_angle, self._image, self._labels)
        if side > 1:
            chosen = self._pixels if everywhere else _edge_pixels(self._labels, self._image)
            samples = self._sample_rays(side)
            _render_samples(arrays, chosen, samples, poses, grid.pixel_angle / side, side, self._image)
        _lay_still(self._image, self._still_pixels, grid.still, float(scene.light[::8, ::8, 0].mean()))
        return self._image

    def _sample_rays(self, side: int) -> Float32Array:
        """Rays (H W, 6, side^2) of a regular grid of samples in each pixel, made when first asked for."""
        if side not in self._samples:
            rays = np.empty((self.grid.rays[..., 0].size, 6, side * side), dtype=np.float32)
            _sample_rays(self.grid.rays, self._pixels, side, rays)
            self._samples = {side: rays}
        return self._samples[side]


@njit(cache=True, error_model="numpy")
def _shade(
    scene: SceneArrays,
    rays: Float32Array,
    rows: npt.NDArray[np.int32],
    poses: FloatArray,
    pixel_angle: float,
    cast: Float32Array,
    hits: Float32Array,
    codes: npt.NDArray[np.int32],
    lists: npt.NDArray[np.int32],
    radiance: Float32Array,
    labels: npt.NDArray[np.int32],
) -> None:
    """Radiance (N, 3) and labels (N,) of rays (6, N); cast (8, N), hits (2, N, 8), codes (N,) and lists (2, N) are work space."""
    s = scene
    cast_rays(rays, rows, poses, cast)
    count, ground_count = shade_open_carpet(
        cast, rays.shape[1], s.first_body, s.room, s.flags, s.paint_frame, s.light, s.light_frame, s.carpet, s.pyramid,
        s.sun[0], pixel_angle, radiance, labels, lists[0], lists[1], hits[1],
    )  # fmt: skip
    rest = lists[0, :count]
    trace_rays(cast, rest, s.solids, s.starts, s.items, s.near, s.room, pixel_angle, hits[0], codes)
    for turn in range(2):
        shade_ground(
            lists[1, :ground_count] if turn == 0 else rest, hits[1] if turn == 0 else hits[0],
            _ALL_CARPET if turn == 0 else codes, s.flags, s.light, s.light_frame, s.shapes, s.cell_starts, s.cell_items,
            s.paint_frame, s.paints, s.carpet, s.pyramid, s.casters, s.caster_cells, s.sun, s.windows, pixel_angle,
            radiance, labels,
        )  # fmt: skip
    shade_upright(
        rest, hits[0], codes, s.solids, s.palette, s.room, s.room_colours, s.light, s.light_frame, s.pyramid, s.casters,
        s.sun, s.windows, radiance, labels,
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _render_middles(
    scene: SceneArrays,
    pixels: npt.NDArray[np.int32],
    rays: Float32Array,
    poses: FloatArray,
    pixel_angle: float,
    image: Float32Array,
    label_image: npt.NDArray[np.int32],
) -> None:
    """One sample in the middle of each of pixels (N,), flat indices, with rays (6, N), into image and label image."""
    hits, codes = np.empty((2, _PORTION, 8), dtype=np.float32), np.empty(_PORTION, dtype=np.int32)
    lists, labels = np.empty((2, _PORTION), dtype=np.int32), np.empty(_PORTION, dtype=np.int32)
    radiance, rows = np.empty((_PORTION, 3), dtype=np.float32), np.zeros(_PORTION, dtype=np.int32)
    cast = np.empty((8, _PORTION), dtype=np.float32)
    flat, flat_labels = image.reshape(-1, 3), label_image.reshape(-1)
    for start in range(0, len(pixels), _PORTION):
        stop = min(start + _PORTION, len(pixels))
        if len(poses) > 1:
            for i in range(start, stop):
                rows[i - start] = pixels[i] // image.shape[1]
        _shade(scene, rays[:, start:stop], rows, poses, pixel_angle, cast, hits, codes, lists, radiance, labels)
        for i in range(start, stop):
            flat_labels[pixels[i]] = labels[i - start]
            for c in range(3):
                flat[pixels[i], c] = radiance[i - start, c]


@njit(cache=True, error_model="numpy")
def _render_samples(
    scene: SceneArrays,
    pixels: npt.NDArray[np.int32],
    rays: Float32Array,
    poses: FloatArray,
    pixel_angle: float,
    side: int,
    image: Float32Array,
) -> None:
    """Means of side x side samples of pixels (N,), flat indices, into the image; all rays (H W, 6, side^2)."""
    portion = max(1, _PORTION // (side * side))
    size = portion * side * side
    hits, codes = np.empty((2, size, 8), dtype=np.float32), np.empty(size, dtype=np.int32)
    lists, labels = np.empty((2, size), dtype=np.int32), np.empty(size, dtype=np.int32)
    radiance, rows = np.empty((size, 3), dtype=np.float32), np.zeros(size, dtype=np.int32)
    samples, cast = np.empty((6, size), dtype=np.float32), np.empty((8, size), dtype=np.float32)
    flat = image.reshape(-1, 3)
    each = side * side
    for start in range(0, len(pixels), portion):
        some = pixels[start : start + portion]
        for i in range(len(some)):
            for c in range(6):
                for n in range(each):
                    samples[c, i * each + n] = rays[some[i], c, n]
        if len(poses) > 1:
            for i in range(len(some) * each):
                rows[i] = some[i // each] // image.shape[1]
        _shade(
            scene, samples[:, : len(some) * each], rows, poses, pixel_angle, cast, hits, codes, lists, radiance, labels
        )
        for i in range(len(some)):
            for c in range(3):
                total = 0.0
                for n in range(each):
                    total += radiance[i * each + n, c]
                flat[some[i], c] = total / each


@njit(cache=True, error_model="numpy")
def _edge_pixels(labels: npt.NDArray[np.int32], image: Float32Array) -> npt.NDArray[np.int32]:
    """Flat indices of the pixels that are flagged or differ from one of their four neighbours; 0 sees no world.

    A neighbour of another label but of all but the same radiance does not count.
    """
    height, width = labels.shape
    colours = image.reshape(-1, 3)
    flat = labels.reshape(-1)
    chosen = np.empty(height * width, dtype=np.int32)
    count = 0
    mask = np.int32(EDGE_FLAG - 1)
    for v in range(height):
        for u in range(width):
            n = v * width + u
            label = flat[n]
            if label == 0:
                continue
            edge = label >= EDGE_FLAG
            if not edge and 0 < u < width - 1 and 0 < v < height - 1:
                a, b, c, d = flat[n - 1], flat[n + 1], flat[n - width], flat[n + width]
                if a == label and b == label and c == label and d == label:
                    continue
                for m in (n - 1, n + 1, n - width, n + width):
                    other = flat[m] & mask
                    edge = edge or (other != label and other != 0 and _differ(colours, n, m))
            if edge:
                chosen[count] = n
                count += 1
    return chosen[:count].copy()


@njit(cache=True, error_model="numpy")
def _differ(colours: Float32Array, n: int, m: int) -> bool:
    """Whether the radiance of two pixels differs by more than 2 % (a grey level or two) in any colour."""
    for c in range(3):
        if abs(colours[n, c] - colours[m, c]) > 0.02 * colours[n, c] + 0.0005:
            return True
    return False


@njit(cache=True, error_model="numpy")
def _sample_rays(rays: Float32Array, pixels: npt.NDArray[np.int32], side: int, samples: Float32Array) -> None:
    """Fill rays (H W, 6, side^2) on a regular grid within each of pixels (N,), from the neighbours' rays (H, W, 6)."""
    height, width = rays.shape[:2]
    offsets = ((np.arange(side) + 0.5) / side - 0.5).astype(np.float32)
    for i in range(len(pixels)):
        v, u = pixels[i] // width, pixels[i] % width
        left, right = max(u - 1, 0), min(u + 1, width - 1)
        up, down = max(v - 1, 0), min(v + 1, height - 1)
        if np.isnan(rays[v, left, 3]):
            left = u
        if np.isnan(rays[v, right, 3]):
            right = u
        if np.isnan(rays[up, u, 3]):
            up = v
        if np.isnan(rays[down, u, 3]):
            down = v
        per_u, per_v = np.float32(1.0 / max(right - left, 1)), np.float32(1.0 / max(down - up, 1))
        for c in range(6):
            middle = rays[v, u, c]
            du, dv = (rays[v, right, c] - rays[v, left, c]) * per_u, (rays[down, u, c] - rays[up, u, c]) * per_v
            for b in range(side):
                for a in range(side):
                    samples[pixels[i], c, b * side + a] = middle + offsets[a] * du + offsets[b] * dv


@njit(cache=True, error_model="numpy")
def _lay_still(image: Float32Array, pixels: npt.NDArray[np.int32], still: Float32Array, level: float) -> None:
    """What is fixed to the robot over the world at pixels (N,), flat indices, by its share of each."""
    flat, layer = image.reshape(-1, 3), still.reshape(-1, 4)
    for n in pixels:
        for c in range(3):
            flat[n, c] = (1.0 - layer[n, 3]) * flat[n, c] + layer[n, c] * level
