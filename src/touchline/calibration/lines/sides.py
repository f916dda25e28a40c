"""Which line of the field a point belongs to, and on which side of it the point lies."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.field.distances import LineTables
from touchline.geometry import FloatArray

_ROUNDED_M = 1e-6


def sides_of(tables: LineTables, places: FloatArray) -> tuple[npt.NDArray[np.intp], FloatArray, FloatArray]:
    """The nearest line (N,) of each place (N, 2), segments first, then circles and arcs, its side (N,): 1 or -1, and

    how far the next line is (N,) (m). A line that lies aside by a metre towards its side 1 is a metre nearer there.
    Beyond a line's end the side is 0.
    """
    segments, arcs = tables
    off = places[:, np.newaxis] - segments[:, :2]
    along = np.clip((off * segments[:, 2:4]).sum(axis=2) * segments[:, 4], 0.0, 1.0)
    off -= along[..., np.newaxis] * segments[:, 2:4]
    outward = places[:, np.newaxis] - arcs[:, :2]
    reach = np.hypot(outward[..., 0], outward[..., 1])
    beside = (outward * arcs[:, 3:5]).sum(axis=2) >= reach * arcs[:, 5]
    gaps = np.where(beside, np.abs(reach - arcs[:, 2]), np.inf)
    gaps = np.concatenate((np.hypot(off[..., 0], off[..., 1]), gaps), axis=1)
    line = np.argmin(gaps, axis=1)
    rows, count = np.arange(len(places)), len(segments)
    gaps[rows, line] = np.inf
    straight = line < count
    side = np.zeros(len(places))
    if count:
        k = np.where(straight, line, 0)
        lateral = off[rows, k, 1] * segments[k, 2] - off[rows, k, 0] * segments[k, 3]
        beyond = np.abs(lateral) * np.sqrt(segments[k, 4]) < np.hypot(*off[rows, k].T) - _ROUNDED_M
        side = np.where(straight & ~beyond, np.sign(lateral), side)
    if len(arcs):
        m = np.where(straight, 0, line - count)
        side = np.where(straight, side, np.sign(reach[rows, m] - arcs[m, 2]))
    return line, side, gaps.min(axis=1)
