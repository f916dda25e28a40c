"""Threads of nets, which look like lines where carpet lies behind them: many other threads cross them.

No field line is crossed often: the halfway line by the centre circle, twice in the length of its diameter. Wherever
else lines meet, one of them ends. An addition of ours.
"""

import math

from numba import njit

from touchline.geometry import FloatArray
from touchline.perception.line_graph.image_plane import ImagePlane, pixel_from_plane, transformed
from touchline.perception.line_graph.profiles import Pixels, cut_across, signal_at

_BESIDE_PX = 4.0  # from a line's edge to where others that cross it are looked for
_WHITE, _BARE = 0.4, 0.25  # of the line's contrast: from where on another thread begins, and has ended
_STEP_PX = 2.0  # no thread that is seen at all is thinner
_MIN_THREADS, _PER_M = 3, 3.0  # of threads that cross one; meshes have 10 cm at most


@njit(cache=True, error_model="numpy")
def is_thread(pixels: Pixels, plane: ImagePlane, line: FloatArray, contrast: float) -> bool:
    """Whether a line (4,) x0, y0, x1, y1 of the image plane, of this contrast, is crossed as threads of nets are."""
    ax, ay = transformed(plane.ground, line[0], line[1])
    bx, by = transformed(plane.ground, line[2], line[3])
    length_m = math.hypot(bx - ax, by - ay)
    nx, ny = -(by - ay) / length_m, (bx - ax) / length_m
    first = cut_across(pixels, plane, ax + 0.05 * (bx - ax), ay + 0.05 * (by - ay), nx, ny).width_px
    last = cut_across(pixels, plane, bx + 0.05 * (ax - bx), by + 0.05 * (ay - by), nx, ny).width_px
    focal = plane.lens.pinhole[0]
    dx, dy = line[2] - line[0], line[3] - line[1]
    length_px = focal * math.hypot(dx, dy)
    height, width = pixels.image.shape[0], pixels.image.shape[1]
    steps = int(length_px / _STEP_PX)
    for side in range(2):
        threads, white = 0, False
        for k in range(steps + 1):
            share = k / steps
            beside = (0.5 * ((1.0 - share) * first + share * last) + _BESIDE_PX) / length_px
            beside = beside if side else -beside
            u, v = pixel_from_plane(plane.lens, line[0] + share * dx - beside * dy, line[1] + share * dy + beside * dx)
            if not (0.0 <= u <= width - 1 and 0.0 <= v <= height - 1):
                continue
            signal = signal_at(pixels, u, v)
            if not white and signal > _WHITE * contrast:
                white = True
                threads += 1
            elif signal < _BARE * contrast:
                white = False
        if threads < max(_MIN_THREADS, _PER_M * length_m):
            return False
    return True
