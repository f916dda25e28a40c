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
from touchline.simulation.ground_shading import EDGE_FLAG, shade_ground, shade_open_carpet
from touchline.simulation.scene import Scene, SceneArrays
from touchline.simulation.solids import first_bodies, sort_into_sectors
from touchline.simulation.tracing import trace_rays
from touchline.simulation.upright_shading import shade_upright

Float32Array = npt.NDArray[np.float32]
_PORTION = 4096
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
        self._rays = np.ascontiguousarray(grid.rays.reshape(-1, 6)[self._pixels])
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
            chosen = self._pixels if everywhere else _edge_pixels(self._labels)
            _render_samples(arrays, chosen, grid.rays, poses, grid.pixel_angle / side, side, self._image)
        _lay_still(self._image, grid.still, float(scene.light[::8, ::8, 0].mean()))
        return self._image


@njit(cache=True, error_model="numpy")
def _shade(
    scene: SceneArrays,
    rays: Float32Array,
    rows: npt.NDArray[np.int32],
    poses: FloatArray,
    pixel_angle: float,
    hits: Float32Array,
    codes: npt.NDArray[np.int32],
    lists: npt.NDArray[np.int32],
    radiance: Float32Array,
    labels: npt.NDArray[np.int32],
) -> None:
    """Radiance (N, 3) and labels (N,) of rays (N, 6); hits (2, N, 8), codes (N,) and lists (2, N) are work space."""
    s = scene
    count, ground_count = shade_open_carpet(
        rays, rows, poses, s.first_body, s.room, s.flags, s.paint_frame, s.light, s.light_frame, s.carpet, s.pyramid,
        s.sun[0], pixel_angle, radiance, labels, lists[0], lists[1], hits[1],
    )  # fmt: skip
    rest = lists[0, :count]
    trace_rays(rays, rows, rest, poses, s.solids, s.starts, s.items, s.near, s.room, pixel_angle, hits[0], codes)
    for turn in range(2):
        shade_ground(
            lists[1, :ground_count] if turn == 0 else rest, hits[1] if turn == 0 else hits[0],
            _ALL_CARPET if turn == 0 else codes, s.flags, s.light, s.light_frame, s.shapes, s.cell_starts, s.cell_items,
            s.paint_frame, s.paints, s.carpet, s.pyramid, s.casters, s.caster_cells, s.sun, s.windows, pixel_angle,
            radiance, labels,
        )  # fmt: skip
    shade_upright(
        rest, hits[0], codes, s.solids, s.palette, s.room, s.room_colours, s.light, s.light_frame, s.pyramid, s.casters,
        s.sun, s.windows, pixel_angle, radiance, labels,
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
    """One sample in the middle of each of pixels (N,), flat indices, with rays (N, 6), into image and label image."""
    hits, codes = np.empty((2, _PORTION, 8), dtype=np.float32), np.empty(_PORTION, dtype=np.int32)
    lists, labels = np.empty((2, _PORTION), dtype=np.int32), np.empty(_PORTION, dtype=np.int32)
    radiance, rows = np.empty((_PORTION, 3), dtype=np.float32), np.zeros(_PORTION, dtype=np.int32)
    flat, flat_labels = image.reshape(-1, 3), label_image.reshape(-1)
    for start in range(0, len(pixels), _PORTION):
        stop = min(start + _PORTION, len(pixels))
        if len(poses) > 1:
            for i in range(start, stop):
                rows[i - start] = pixels[i] // image.shape[1]
        _shade(scene, rays[start:stop], rows, poses, pixel_angle, hits, codes, lists, radiance, labels)
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
    """Means of side x side samples of pixels (N,), flat indices, into the image; rays (H, W, 6) of all middles."""
    portion = max(1, _PORTION // (side * side))
    size = portion * side * side
    hits, codes = np.empty((2, size, 8), dtype=np.float32), np.empty(size, dtype=np.int32)
    lists, labels = np.empty((2, size), dtype=np.int32), np.empty(size, dtype=np.int32)
    radiance, rows = np.empty((size, 3), dtype=np.float32), np.zeros(size, dtype=np.int32)
    samples, flat = np.empty((size, 6), dtype=np.float32), image.reshape(-1, 3)
    each = side * side
    for start in range(0, len(pixels), portion):
        some = pixels[start : start + portion]
        _sample_rays(rays, some, side, samples)
        if len(poses) > 1:
            for i in range(len(some) * each):
                rows[i] = some[i // each] // image.shape[1]
        _shade(scene, samples[: len(some) * each], rows, poses, pixel_angle, hits, codes, lists, radiance, labels)
        for i in range(len(some)):
            for c in range(3):
                total = 0.0
                for n in range(each):
                    total += radiance[i * each + n, c]
                flat[some[i], c] = total / each


@njit(cache=True, error_model="numpy")
def _edge_pixels(labels: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Flat indices of the pixels that are flagged or differ from one of their four neighbours; 0 sees no world."""
    height, width = labels.shape
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
                if a != label or b != label or c != label or d != label:
                    for other in (a & mask, b & mask, c & mask, d & mask):
                        edge = edge or (other != label and other != 0)
            if edge:
                chosen[count] = n
                count += 1
    return chosen[:count].copy()


@njit(cache=True, error_model="numpy")
def _sample_rays(rays: Float32Array, pixels: npt.NDArray[np.int32], side: int, samples: Float32Array) -> None:
    """Rays (len(pixels) * side^2, 6) on a regular grid within each pixel, from the neighbours' rays."""
    height, width = rays.shape[:2]
    for i in range(len(pixels)):
        v, u = pixels[i] // width, pixels[i] % width
        left, right = max(u - 1, 0), min(u + 1, width - 1)
        up, down = max(v - 1, 0), min(v + 1, height - 1)
        for c in range(6):
            middle = rays[v, u, c]
            low, high = rays[v, left, c], rays[v, right, c]
            low, high = (middle if np.isnan(low) else low), (middle if np.isnan(high) else high)
            du = (high - low) / max(right - left, 1)
            low, high = rays[up, u, c], rays[down, u, c]
            low, high = (middle if np.isnan(low) else low), (middle if np.isnan(high) else high)
            dv = (high - low) / max(down - up, 1)
            for b in range(side):
                for a in range(side):
                    fu, fv = (a + 0.5) / side - 0.5, (b + 0.5) / side - 0.5
                    samples[(i * side + b) * side + a, c] = middle + fu * du + fv * dv


@njit(cache=True, error_model="numpy")
def _lay_still(image: Float32Array, still: Float32Array, level: float) -> None:
    """What is fixed to the robot over the world, by its share of each pixel."""
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            share = still[v, u, 3]
            if share > 0.0:
                for c in range(3):
                    image[v, u, c] = (1.0 - share) * image[v, u, c] + still[v, u, c] * level
