"""Body rays of a camera + a scene -> linear radiance of each pixel, with supersampling where a pixel holds an edge.

Edges are pixels whose label (which paint, body, face, band; sunlit or not) differs from a neighbour's, that lie within
their own footprint of a paint's edge, or that look through a net. They are averaged over a regular grid of samples; all
others keep the one sample in their middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import FloatArray
from touchline.simulation.ground_shading import EDGE_FLAG, shade_ground
from touchline.simulation.scene import Scene
from touchline.simulation.solids import sort_into_sectors
from touchline.simulation.tracing import trace_rays
from touchline.simulation.upright_shading import shade_upright

Float32Array = npt.NDArray[np.float32]
_RIGHT, _DOWN = np.array([1, -1, 0, 0]), np.array([0, 0, 1, -1])


@dataclass(frozen=True, eq=False)
class RayGrid:
    """What each pixel of a camera looks along, in the body frame.

    rays (H, W, 6) float32: origin (m) and direction; NaN where a pixel sees no part of the world. pixel_angle: rad from one
    pixel to the next. slack_m: how far origins lie from the body's axis at most. still (H, W, 4) float32: red, green, blue
    of what is fixed to the robot (reflectance, premultiplied) and its share of the pixel.
    """

    rays: Float32Array
    pixel_angle: float
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
        self._rows = (self._pixels // width).astype(np.int32)
        self._label_image = np.zeros((height, width), dtype=np.int32)
        self._image = np.zeros((height, width, 3), dtype=np.float32)
        self._hits = np.empty((len(self._pixels), 8), dtype=np.float32)
        self._codes = np.empty(len(self._pixels), dtype=np.int32)
        self._radiance = np.empty((len(self._pixels), 3), dtype=np.float32)
        self._labels = np.empty(len(self._pixels), dtype=np.int32)

    def render(self, scene: Scene, poses: FloatArray, side: int = 2, everywhere: bool = False) -> Float32Array:
        """Radiance (H, W, 3) of a scene from poses (1 or H, 12): rotation field_from_body by rows, then translation.

        side: samples along each side of a supersampled pixel; 1 for none. everywhere: supersample all pixels.
        The array is the renderer's own and is overwritten by the next call.
        """
        rows = self._rows if len(poses) > 1 else np.zeros_like(self._rows)
        sectors = sort_into_sectors(
            scene.solids, poses[:, 9].mean(), poses[:, 10].mean(), self.grid.slack_m + _spread(poses)
        )
        arrays = (self._hits, self._codes, self._radiance, self._labels)
        _shade(scene, self._rays, rows, poses, sectors, self.grid.pixel_angle, arrays)
        _scatter(self._pixels, self._radiance, self._labels, self._image, self._label_image)
        if side > 1:
            edges = self._pixels if everywhere else _edge_pixels(self._pixels, self._label_image)
            self._supersample(scene, poses, sectors, side, edges)
        _lay_still(self._image, self.grid.still, _mean_level(scene))
        return self._image

    def _supersample(
        self, scene: Scene, poses: FloatArray, sectors: tuple[npt.NDArray[np.int32], npt.NDArray[np.int16], FloatArray],
        side: int, edges: npt.NDArray[np.int32],
    ) -> None:  # fmt: skip
        width = self.grid.shape[1]
        chunk = 1 << 17
        per_chunk = max(1, chunk // (side * side))
        for start in range(0, len(edges), per_chunk):
            some = edges[start : start + per_chunk]
            rays = _sample_rays(self.grid.rays, some, side)
            rows = np.repeat((some // width).astype(np.int32), side * side) if len(poses) > 1 else np.zeros(
                len(rays), dtype=np.int32
            )  # fmt: skip
            count = len(rays)
            arrays = (
                np.empty((count, 8), dtype=np.float32),
                np.empty(count, dtype=np.int32),
                np.empty((count, 3), dtype=np.float32),
                np.empty(count, dtype=np.int32),
            )
            _shade(scene, rays, rows, poses, sectors, self.grid.pixel_angle / side, arrays)
            _average(some, arrays[2], side * side, self._image)


def _spread(poses: FloatArray) -> float:
    middle = poses[:, 9:11].mean(axis=0)
    return float(np.hypot(*(poses[:, 9:11] - middle).T).max())


def _mean_level(scene: Scene) -> float:
    return float(scene.light[::8, ::8, 0].mean())


def _shade(
    scene: Scene,
    rays: Float32Array,
    rows: npt.NDArray[np.int32],
    poses: FloatArray,
    sectors: tuple[npt.NDArray[np.int32], npt.NDArray[np.int16], FloatArray],
    pixel_angle: float,
    arrays: tuple[Float32Array, npt.NDArray[np.int32], Float32Array, npt.NDArray[np.int32]],
) -> None:
    """Trace rays (N, 6) and fill hits, codes, radiance and labels."""
    hits, codes, radiance, labels = arrays
    starts, items, near = sectors
    trace_rays(rays, rows, poses, scene.solids, starts, items, near, scene.room, pixel_angle, hits, codes)
    shade_ground(
        hits, codes, scene.light, scene.light_frame, *scene.paint, scene.paints, scene.carpet, scene.pyramid,
        scene.casters, scene.caster_cells, scene.sun, scene.windows, pixel_angle, radiance, labels,
    )  # fmt: skip
    shade_upright(
        hits, codes, scene.solids, scene.palette, scene.room, scene.room_colours, scene.light, scene.light_frame,
        scene.pyramid, scene.casters, scene.sun, scene.windows, pixel_angle, radiance, labels,
    )  # fmt: skip


@njit(cache=True)
def _scatter(
    pixels: npt.NDArray[np.int32],
    radiance: Float32Array,
    labels: npt.NDArray[np.int32],
    image: Float32Array,
    label_image: npt.NDArray[np.int32],
) -> None:
    """Values of a list of pixels into images (H, W, 3) and (H, W)."""
    flat, flat_labels = image.reshape(-1, 3), label_image.reshape(-1)
    for i in range(len(pixels)):
        for c in range(3):
            flat[pixels[i], c] = radiance[i, c]
        flat_labels[pixels[i]] = labels[i]


@njit(cache=True)
def _edge_pixels(pixels: npt.NDArray[np.int32], labels: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """The pixels that are flagged or differ from one of their four neighbours."""
    height, width = labels.shape
    chosen = np.empty(len(pixels), dtype=np.int32)
    count = 0
    mask = EDGE_FLAG - 1
    for i in range(len(pixels)):
        v, u = pixels[i] // width, pixels[i] % width
        label = labels[v, u]
        edge = label >= EDGE_FLAG
        label &= mask
        if not edge and 0 < u < width - 1 and 0 < v < height - 1:
            for n in range(4):
                other = labels[v + _DOWN[n], u + _RIGHT[n]] & mask
                edge = edge or (other != label and other != 0)  # 0: a neighbour that sees no part of the world
        if edge:
            chosen[count] = pixels[i]
            count += 1
    return chosen[:count].copy()


@njit(cache=True)
def _sample_rays(rays: Float32Array, pixels: npt.NDArray[np.int32], side: int) -> Float32Array:
    """Rays (len(pixels) * side^2, 6) on a regular grid within each pixel, from the neighbours' rays."""
    height, width = rays.shape[:2]
    samples = np.empty((len(pixels) * side * side, 6), dtype=np.float32)
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
    return samples


@njit(cache=True)
def _average(pixels: npt.NDArray[np.int32], radiance: Float32Array, samples: int, image: Float32Array) -> None:
    """Means of each pixel's samples into the image."""
    flat = image.reshape(-1, 3)
    for i in range(len(pixels)):
        for c in range(3):
            total = 0.0
            for n in range(samples):
                total += radiance[i * samples + n, c]
            flat[pixels[i], c] = total / samples


@njit(cache=True)
def _lay_still(image: Float32Array, still: Float32Array, level: float) -> None:
    """What is fixed to the robot over the world, by its share of each pixel."""
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            share = still[v, u, 3]
            if share > 0.0:
                for c in range(3):
                    image[v, u, c] = (1.0 - share) * image[v, u, c] + still[v, u, c] * level
