"""Line points by colour transitions: green, white, green along a scan line.

Lu, Zheng, Liu and Wang 2008 (reference 25 of Lu et al. 2013), section 4.1 of Xiong et al.: pixels are put into colour
classes, scan lines go outwards, and where green gives way to white and white to green again there is a line. Nothing is
asked of its width, and the edges are whole pixels.
"""

import numpy as np

from touchline.camera import OmniCamera
from touchline.geometry import BoolArray, ByteArray, FloatArray, IndexArray
from touchline.perception.colour import GREEN, WHITE
from touchline.perception.profiles import COLUMNS
from touchline.perception.scan_lines import ScanLines

MIN_GREEN_PX = 3  # length of the green on both sides: a single green pixel in a net or a robot is noise
MAX_GAP_PX = 3  # length of what is neither green nor white between them: the blur of an edge


def find_transitions(lines: ScanLines, classes: ByteArray, camera: OmniCamera, max_run_px: int) -> FloatArray:
    """Green-white-green transitions of all scan lines, rows (M, COLUMNS) like those of `find_line_profiles`.

    classes: (N,) of the samples. max_run_px: longest white. The point is midway between both transitions in the image;
    the contrast of all is 1. What a closed scan line shows twice, where it overlaps itself, is found twice.
    """
    known = np.flatnonzero((classes == GREEN) | (classes == WHITE))
    path = np.searchsorted(lines.starts, known, side="right") - 1
    white = classes[known] == WHITE
    ends = np.flatnonzero(_ends_run(known, path, white))
    first = np.concatenate(([0], ends[:-1] + 1)) if len(ends) else ends
    begin, end, is_white = known[first], known[ends], white[ends]
    size = ends - first + 1
    k = np.flatnonzero(is_white)
    k = k[(k > 0) & (k < len(ends) - 1)]
    before, after = k - 1, k + 1
    beside = ~is_white[before] & ~is_white[after] & (path[ends[before]] == path[ends[k]])
    beside &= path[ends[after]] == path[ends[k]]
    beside &= (size[before] >= MIN_GREEN_PX) & (size[after] >= MIN_GREEN_PX)
    beside &= (begin[k] - end[before] <= MAX_GAP_PX + 1) & (begin[after] - end[k] <= MAX_GAP_PX + 1)
    beside &= end[k] - begin[k] < max_run_px
    k = k[beside]
    edges = 0.5 * (end[k - 1] + begin[k]), 0.5 * (end[k] + begin[k + 1])
    inner, outer = (_at(lines.samples, edge) for edge in edges)
    middle = 0.5 * (inner + outer)
    found = np.empty((len(k), COLUMNS))
    found[:, :2], found[:, 2:4], found[:, 4] = camera.ground_from_image(middle), middle, 1.0
    found[:, 5] = np.hypot(*(camera.ground_from_image(inner) - camera.ground_from_image(outer)).T)
    found[:, 6], found[:, 7] = path[ends[k]], 0.0
    return found[np.isfinite(found).all(axis=1)]


def _ends_run(known: IndexArray, path: IndexArray, white: BoolArray) -> BoolArray:
    """Whether each classified sample is the last one of a run of its class: another class, path or a gap follows."""
    follows = (np.diff(known) > MAX_GAP_PX + 1) | (np.diff(path) != 0) | (white[1:] != white[:-1])
    return np.concatenate((follows, [True])) if len(known) else np.zeros(0, dtype=np.bool_)


def _at(samples: FloatArray, index: FloatArray) -> FloatArray:
    """Image positions (M, 2) at fractional sample numbers (M,)."""
    low = index.astype(np.intp)
    share = (index - low)[:, np.newaxis]
    return samples[low] + share * (samples[np.minimum(low + 1, len(samples) - 1)] - samples[low])
