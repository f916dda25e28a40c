"""Penalty marks: small white patches that lie alone on the carpet, as large as a mark looks there.

Ours: the paper names none. A ball is larger and stands up, the centre mark lies on a line.
"""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray, IntArray
from touchline.matrices import uncounted
from touchline.perception.line_graph.colour_classes import CELL_PX, FULL, GREEN, WHITE, CountArray
from touchline.perception.line_graph.image_plane import ImagePlane, ground_from_pixel

_MIN_WHITE_PIXELS = 8  # white pixels from which on a cell is a patch's
_CARPET = 0.5  # share of green that each cell about a patch has
_MIN_AREA_RATIO, _MAX_AREA_RATIO = 0.5, 1.7  # area against what is expected
_MIN_PX = 20.0  # of that area
_STANDING = 2.0  # what stands is higher than this, against a mark that lies
_MAX_CELLS = 100


@njit(cache=True, error_model="numpy")
def find_penalty_marks(counts: CountArray, ends: FloatArray, plane: ImagePlane, diameter: float) -> FloatArray:
    """(N, 2) pixels of the middles of marks of a diameter (m). ends: (columns,) height of the field's boundary."""
    counts, plane = uncounted((counts, plane))
    rows, columns = counts.shape[1:]
    patches, number = np.zeros((rows, columns), dtype=np.int64), 0
    stack, sums = np.empty((_MAX_CELLS + 8, 2), dtype=np.int64), np.empty(5)
    found = np.empty((_MAX_CELLS, 2))
    count = 0
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            if patches[row, column] or counts[WHITE, row, column] < _MIN_WHITE_PIXELS or rows - row > ends[column]:
                continue
            number += 1
            stack[0, 0], stack[0, 1] = row, column
            if (
                _is_alone(counts, patches, number, stack, sums)
                and count < _MAX_CELLS
                and _is_mark(sums, plane, diameter)
            ):
                found[count, 0], found[count, 1] = sums[1], sums[2]
                count += 1
    return found[:count]


@njit(cache=True)
def _is_alone(counts: CountArray, patches: IntArray, number: int, stack: IntArray, sums: FloatArray) -> bool:
    """Whether the patch of white cells about the first of the stack is small and alone on the carpet; its area, u, v,
    variances of u and of v into sums (5,).

    patches: (rows, columns) which one a cell belongs to. What is left of one that is not alone, as its cells are not
    followed to the last, touches it.
    """
    rows, columns = counts.shape[1:]
    patches[stack[0, 0], stack[0, 1]] = number
    count, done = 1, 0
    sums[:] = 0.0
    while done < count:
        r, c = stack[done, 0], stack[done, 1]
        done += 1
        white, u, v = np.float64(counts[WHITE, r, c]), CELL_PX * (c + 0.5) - 0.5, CELL_PX * (r + 0.5) - 0.5
        sums[0] += white
        sums[1] += white * u
        sums[2] += white * v
        sums[3] += white * u * u
        sums[4] += white * v * v
        if not (0 < r < rows - 1 and 0 < c < columns - 1):
            return False
        for nr in range(r - 1, r + 2):
            for nc in range(c - 1, c + 2):
                if patches[nr, nc] == number:
                    continue
                if counts[WHITE, nr, nc] >= _MIN_WHITE_PIXELS:
                    if patches[nr, nc]:
                        return False
                    patches[nr, nc] = number
                    stack[count, 0], stack[count, 1] = nr, nc
                    count += 1
                elif counts[GREEN, nr, nc] + counts[WHITE, nr, nc] < _CARPET * FULL:
                    return False
        if count > _MAX_CELLS:
            return False
    for k in range(1, len(sums)):
        sums[k] /= sums[0]
    sums[3] -= sums[1] ** 2
    sums[4] -= sums[2] ** 2
    return True


@njit(cache=True, error_model="numpy")
def _is_mark(sums: FloatArray, plane: ImagePlane, diameter: float) -> bool:
    """Whether a patch has the area and the height of a mark that lies there."""
    u, v = sums[1], sums[2]
    x, y = ground_from_pixel(plane, u, v)
    ux, uy = ground_from_pixel(plane, u + 1.0, v)
    vx, vy = ground_from_pixel(plane, u, v + 1.0)
    per_pixel = abs((ux - x) * (vy - y) - (uy - y) * (vx - x))
    expected = 0.25 * math.pi * diameter**2 / per_pixel
    if not (expected >= _MIN_PX and _MIN_AREA_RATIO * expected <= sums[0] <= _MAX_AREA_RATIO * expected):
        return False
    across, up = 0.5 * diameter / math.hypot(ux - x, uy - y), 0.5 * diameter / math.hypot(vx - x, vy - y)
    blur = CELL_PX**2 / 12.0
    return bool(sums[4] - blur < (_STANDING * 0.5 * up) ** 2 + blur and sums[3] - blur < across**2 + blur)
