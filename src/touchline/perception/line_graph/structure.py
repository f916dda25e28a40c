"""Section 3 in one go: image -> colour classes in cells -> field boundary -> skeleton -> line structure graph."""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit

from touchline.geometry import BoolArray, ByteArray, FloatArray, IntArray
from touchline.perception.line_graph.chains import Chains, find_chains
from touchline.perception.line_graph.colour_classes import (
    CELL_PX,
    CLASSES,
    FIRST_WHITE,
    FULL,
    GREEN,
    WHITE,
    ColourClasses,
    CountArray,
    carpet_light,
    count_classes,
    paint_above,
    suppress_fringes,
)
from touchline.perception.line_graph.contrast import BLOCK_PX, mean_blocks, white_blocks
from touchline.perception.line_graph.field_boundary import BoundaryThresholds, find_boundary
from touchline.perception.line_graph.graph import Graph, line_graph
from touchline.perception.line_graph.image_plane import ImagePlane, ground_from_pixel
from touchline.perception.line_graph.settings import LineGraphSettings
from touchline.perception.line_graph.skeleton import low_pass, rank_cells, white_inside
from touchline.types import ImageArray

_MAX_PASSES = 8
_BESIDE = 1.2  # of a line's width to each side: from one of its edges beyond the other one
_MAX_REACH = 40  # blocks
_ABOUT = 5  # cells each way that the carpet's light is averaged over
_MIN_CARPET = 0.05  # share of these that has to be carpet
_MIN_WHITE = 0.75  # white pixels after the low-pass that count: less is a stray
_DARKEST, _BRIGHTEST = 0.25, 3.0  # of the carpet's light against that of learning


class Structure(NamedTuple):
    """What section 3 makes of an image, in cells of 8 x 8 pixels.

    counts: (8, rows, columns) pixels of each class. paint, base: (rows, columns) as of `Pixels`. ends: (columns,)
    height of the field's boundary. sees_ground: (rows, columns) below the horizon. smooth: (rows, columns) low-passed
    white. ranks: (rows, columns) of the skeleton.
    """

    counts: CountArray
    paint: FloatArray
    base: FloatArray
    ends: FloatArray
    sees_ground: BoolArray
    smooth: FloatArray
    ranks: ByteArray
    graph: Graph
    chains: Chains


def find_structure(
    image: ImageArray,
    classes: ColourClasses,
    usable: BoolArray,
    plane: ImagePlane,
    line_width_m: float,
    settings: LineGraphSettings,
) -> Structure:
    """The structure of an image (H, W, 3). usable: (rows, columns) cells whose colours count."""
    counts, paint, base = _counted(image, classes, usable, (plane, line_width_m))
    ends, horizon = _boundary(counts, plane, settings)
    rows, columns = usable.shape
    white, smooth = np.empty((rows, columns)), np.empty((rows, columns))
    white_inside(counts, ends, white)
    passes = np.ones(rows, dtype=np.int64) if settings.paper.fixed_low_pass else _passes(plane, rows, line_width_m)
    low_pass(white, passes, smooth)
    ranks = np.empty((rows, columns), dtype=np.uint8)
    rank_cells(smooth, ranks, _MIN_WHITE if settings.paper.strays else 0.0)
    graph = line_graph(smooth, ranks)
    sees_ground = np.arange(rows)[:, np.newaxis] >= horizon
    return Structure(counts, paint, base, ends, sees_ground, smooth, ranks, graph, find_chains(graph))


def _counted(
    image: ImageArray, classes: ColourClasses, usable: BoolArray, line: tuple[ImagePlane, float]
) -> tuple[CountArray, FloatArray, FloatArray]:
    """Counts, paint and base; line: where it is looked for, and its width (m)."""
    model, usual = classes.model, float(classes.model.signal @ classes.model.green)
    light: FloatArray = np.ones(usable.shape)
    base: FloatArray = np.full(usable.shape, usual)
    washed = np.zeros(usable.shape, dtype=np.uint8)
    if classes.local:
        carpet_light(image, classes.tables, (float(model.green.sum()), model.signal), (light, washed, base))
    white_from = np.empty(usable.shape, dtype=np.uint8)
    _white_codes(light, classes.white_from, min(classes.white_until, 255.0), white_from)
    counts = np.empty((CLASSES, *usable.shape), dtype=np.uint8)
    count_classes(image, classes.tables, white_from, washed, counts)
    suppress_fringes(counts)
    if classes.least_contrast > 0.0:
        light, base = _count_by_contrast(image, classes, sides(line[0], image.shape[0] // BLOCK_PX, line[1]), counts)
    if not usable.all():
        counts[:, ~usable] = 0
    paint = paint_above(base, light, (model.white, model.signal)) if classes.local else light
    return counts, paint, base - usual


def _count_by_contrast(
    image: ImageArray, classes: ColourClasses, reach: IntArray, counts: CountArray
) -> tuple[FloatArray, FloatArray]:
    """White as what exceeds both its sides, into counts; light and signal of the carpet about each cell."""
    (rows, columns), per_cell, model = counts.shape[1:], CELL_PX // BLOCK_PX, classes.model
    blocks = mean_blocks(image)[: per_cell * rows, : per_cell * columns]
    white = white_blocks(blocks, reach[: len(blocks)], classes.least_contrast)
    counts[WHITE] = BLOCK_PX**2 * white.reshape(rows, per_cell, columns, per_cell).sum(axis=(1, 3))
    counts[GREEN] = np.minimum(counts[GREEN], FULL - counts[WHITE])
    both = cv2.transform(blocks, np.vstack((np.ones(3), model.signal)).astype(np.float32))
    both = np.dstack((np.ones(white.shape, dtype=np.float32), both)) * ~white[..., np.newaxis]
    carpet = (
        cv2.resize(both, (columns, rows), interpolation=cv2.INTER_AREA) * (counts[GREEN] > FULL // 4)[..., np.newaxis]
    )
    share, bright, signal = cv2.split(cv2.blur(carpet, (_ABOUT, _ABOUT)).astype(np.float64))
    known, share = share > _MIN_CARPET, np.maximum(share, _MIN_CARPET)
    light = np.where(known, bright / share / model.green.sum(), 1.0)
    base = np.where(known, signal / share, model.signal @ model.green)
    return np.clip(light, _DARKEST, _BRIGHTEST), base


@njit(cache=True)
def _white_codes(light: FloatArray, white_from: float, until: float, codes: ByteArray) -> None:
    """Code from which on a pixel is white in the light of each cell, into codes (rows, columns); bounds the light."""
    rows, columns = light.shape
    for row in range(rows):
        for column in range(columns):
            light[row, column] = min(max(light[row, column], _DARKEST), _BRIGHTEST)
            code = FIRST_WHITE + (white_from - FIRST_WHITE) * light[row, column]
            codes[row, column] = np.uint8(min(max(code, FIRST_WHITE), until))


def _boundary(counts: CountArray, plane: ImagePlane, settings: LineGraphSettings) -> tuple[FloatArray, FloatArray]:
    columns = counts.shape[2]
    limits = BoundaryThresholds(settings.pixel_threshold, settings.row_threshold, settings.window_threshold)
    horizon, ends = np.empty(columns), np.empty(columns)
    find_boundary(counts, plane, limits, settings.paper.plain_boundary, horizon, ends)
    return ends, horizon


@njit(cache=True, error_model="numpy")
def _passes(plane: ImagePlane, rows: int, line_width_m: float) -> IntArray:
    """(rows,) of the low-pass: as many as a line that runs away from the camera is wide, in cells."""
    passes = np.ones(rows, dtype=np.int64)
    middle = plane.size[0] / 2.0
    for row in range(rows):
        v = CELL_PX * row + 0.5 * (CELL_PX - 1)
        x, y = ground_from_pixel(plane, middle, v)
        ax, ay = ground_from_pixel(plane, middle + 1.0, v)
        per_px = math.hypot(ax - x, ay - y)
        if per_px > 0.0:
            passes[row] = min(max(1, int(line_width_m / per_px / CELL_PX + 0.5)), _MAX_PASSES)
    return passes


@njit(cache=True, error_model="numpy")
def sides(plane: ImagePlane, rows: int, width_m: float) -> IntArray:
    """(rows, 2) how far, in blocks across and along the image, to the sides of a line of this width in each row of
    blocks; 0 above the horizon.
    """
    reach, u = np.zeros((rows, 2), dtype=np.int64), 0.5 * plane.size[0]
    for row in range(rows):
        v = BLOCK_PX * (row + 0.5) - 0.5
        x, y = ground_from_pixel(plane, u, v)
        for way in range(2):
            ax, ay = ground_from_pixel(plane, u + (way == 0), v + (way == 1))
            blocks = _BESIDE * width_m / math.hypot(ax - x, ay - y) / BLOCK_PX + 0.5
            if blocks > 0.0:
                reach[row, way] = min(math.ceil(blocks), _MAX_REACH)
    return reach
