"""Which line of the field a point belongs to, and on which side of it the point lies."""

from typing import NamedTuple

import numpy as np

from touchline.field.distances import LineTables
from touchline.geometry import BoolArray, FloatArray, IndexArray

_ROUNDED_M = 1e-6


class NearestLine(NamedTuple):
    """Of places (N,): the nearest line's number, segments first, then circles and arcs; where along a segment it is
    nearest (0 to 1); the distance (m) from it, positive on a segment's left and outside of a circle; the normal (N, 2)
    that way; whether the place lies past a segment's end; how far the next line is (m).
    """

    line: IndexArray
    along: FloatArray
    distance_m: FloatArray
    normal: FloatArray
    is_beyond: BoolArray
    next_m: FloatArray

    @property
    def side(self) -> FloatArray:
        """(N,) 1 or -1: a line aside by a metre towards its side 1 is a metre nearer there. Beyond an end 0."""
        return np.where(self.is_beyond, 0.0, np.sign(self.distance_m))


def outward(tables: LineTables) -> FloatArray:
    """(L,) on which side (1, -1) of a line its outer edge is: that of the field, of an area or of a circle."""
    x, y, dx, dy, _ = tables.segments.T
    wide = np.maximum(np.abs(x), np.abs(x + dx))
    front = (np.abs(dx) < np.abs(dy)) & (wide < wide.max(initial=0.0) - _ROUNDED_M)  # of an area: towards the middle
    side = np.sign(np.round(dx * (2.0 * y + dy) - dy * (2.0 * x + dx), 6))
    return np.concatenate((np.where(front, -side, side), np.ones(len(tables.arcs))))


def nearest_line(tables: LineTables, places: FloatArray) -> NearestLine:
    """The lines that places (N, 2), field frame (m), are nearest to."""
    segments, arcs = tables
    off = places[:, np.newaxis] - segments[:, :2]
    along = np.clip((off * segments[:, 2:4]).sum(axis=2) * segments[:, 4], 0.0, 1.0)
    off -= along[..., np.newaxis] * segments[:, 2:4]
    outward = places[:, np.newaxis] - arcs[:, :2]
    reach = np.hypot(outward[..., 0], outward[..., 1])
    beside = (outward * arcs[:, 3:5]).sum(axis=2) >= reach * arcs[:, 5]
    gaps = np.hstack((np.hypot(off[..., 0], off[..., 1]), np.where(beside, np.abs(reach - arcs[:, 2]), np.inf)))
    line = np.argmin(gaps, axis=1)
    rows, count = np.arange(len(places)), len(segments)
    gap = gaps[rows, line]
    gaps[rows, line] = np.inf
    straight = line < count
    place, distance, normal = np.zeros(len(places)), np.zeros(len(places)), np.zeros((len(places), 2))
    if count:
        k = line[straight]
        place[straight] = along[straight, k]
        normal[straight] = np.column_stack((-segments[k, 3], segments[k, 2])) * np.sqrt(segments[k, 4:])
        distance[straight] = (off[straight, k] * normal[straight]).sum(axis=1)
    if len(arcs):
        m = line[~straight] - count
        out = reach[~straight, m]
        normal[~straight] = outward[~straight, m] / np.maximum(out, 1e-9)[:, np.newaxis]
        distance[~straight] = out - arcs[m, 2]
    is_beyond = straight & (np.abs(distance) < gap - _ROUNDED_M)
    return NearestLine(line, place, distance, normal, is_beyond, gaps.min(axis=1))
