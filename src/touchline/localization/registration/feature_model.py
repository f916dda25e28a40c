"""The sensor model of features: crossings, posts, poles, marks and lines (Schulz and Behnke 2012, section 5).

Points and lines come with what they may be taken for, and their noise; a particle's likelihood is the product of the
observations' (equation 8), each of which is never less than a uniform one (section 5.3).
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from touchline.field import FieldModel
from touchline.field.association import AssociationTables
from touchline.geometry import FloatArray, IntArray
from touchline.matrices import uncounted


class PointFeatures(NamedTuple):
    """Crossings and landmarks as seen, robot frame.

    positions_m: (M, 2). information: (M, 2, 2) inverse covariances (1/m²), own_information without the error of the
    camera's lean, which all features of a frame share. sigmas: (M, 2) of range (m) and bearing (rad), equation (5).
    floors, peaks: (M,) densities of a uniform observation and at the top of the normal one, with their shares. trust:
    (M,) confidences. sets: (M, 4) table, number of sets, first and end of the candidates. turns_rad: (M,) to be added
    to a heading, quarters of which count the sets. candidates: (C,) places.
    """

    positions_m: FloatArray
    information: FloatArray
    own_information: FloatArray
    sigmas: FloatArray
    floors: FloatArray
    peaks: FloatArray
    trust: FloatArray
    sets: IntArray
    turns_rad: FloatArray
    candidates: IntArray


class LineFeatures(NamedTuple):
    """Visible parts of straight lines, robot frame.

    ends_m: (L, 2, 2). sigmas: (L, 2) of the distance (m) and the direction (rad), own_sigmas without the error of the
    camera's lean. floors, peaks, trust: (L,) as of points.
    """

    ends_m: FloatArray
    sigmas: FloatArray
    own_sigmas: FloatArray
    floors: FloatArray
    peaks: FloatArray
    trust: FloatArray


class FeatureView(NamedTuple):
    """All that one frame shows."""

    points: PointFeatures
    lines: LineFeatures

    @property
    def size(self) -> int:
        """How many features there are."""
        return len(self.points.positions_m) + len(self.lines.ends_m)


def field_lines(field: FieldModel) -> FloatArray:
    """(S, 5) straight lines of a field: unit direction ux, uy; of its start the distance to the left of the centre
    mark's parallel, and along it; length (m).
    """
    start, along = field.segments[:, :2], field.segments[:, 2:] - field.segments[:, :2]
    length = np.hypot(along[:, 0], along[:, 1])
    ux, uy = along.T / length
    aside, ahead = ux * start[:, 1] - uy * start[:, 0], ux * start[:, 0] + uy * start[:, 1]
    return np.ascontiguousarray(np.column_stack((ux, uy, aside, ahead, length)))


class FeatureModel:
    """P(z | x) of equation (8) for particles.

    polar: points by range and bearing, equation (5), and lines by their perpendiculars, equations (6) and (7); else
    points by their covariances, and lines by where their middle lies, their direction and their ends.
    """

    def __init__(self, tables: AssociationTables, lines: FloatArray, polar: bool) -> None:
        """lines: (S, 5), `field_lines`."""
        self.tables, self.lines, self.polar = tables, lines, polar

    def log_likelihoods(self, view: FeatureView, poses: FloatArray) -> FloatArray:
        """log P(z | x) (N,) of poses (N, 3)."""
        found = np.zeros(len(poses))
        if len(view.points.positions_m):
            add_points(found, poses, view.points, self.tables, self.polar)
        if len(view.lines.ends_m) and len(self.lines):
            add_lines(found, poses, view.lines, self.lines, self.polar)
        return found


@numba.njit(cache=True)
def table_place(tables, set_number, x, y):  # type: ignore[no-untyped-def]
    """The nearest place of a set for a place of the field (m); -1 if the set is empty."""
    nearest = tables.nearest
    ix = (x - tables.origin_x) * 10.0 + 0.5
    iy = (y - tables.origin_y) * 10.0 + 0.5
    ix = min(ix, nearest.shape[2] - 1.0) if ix > 0.0 else 0.0  # written so that NaN never becomes an index
    iy = min(iy, nearest.shape[1] - 1.0) if iy > 0.0 else 0.0
    return int(nearest[set_number, int(iy), int(ix)])


@numba.njit(cache=True)
def point_exponent(points, i, polar, ahead, left):  # type: ignore[no-untyped-def]
    """Half the squared error of point i if its place lies at ahead, left (m) of the robot; equation (5) if polar."""
    x, y = points.positions_m[i, 0], points.positions_m[i, 1]
    if polar:
        range_error = (math.sqrt(ahead * ahead + left * left) - math.sqrt(x * x + y * y)) / points.sigmas[i, 0]
        bearing_error = math.atan2(x * left - y * ahead, x * ahead + y * left) / points.sigmas[i, 1]
        return 0.5 * (range_error * range_error + bearing_error * bearing_error)
    dx, dy, w = ahead - x, left - y, points.information
    return 0.5 * (w[i, 0, 0] * dx * dx + 2.0 * w[i, 0, 1] * dx * dy + w[i, 1, 1] * dy * dy)


@numba.njit(cache=True)
def best_place(points, i, tables, polar, pose):  # type: ignore[no-untyped-def]
    """The place (-1 for none) that point i is taken for, its exponent, and the sum of exp(-exponent) of all places
    that were tried; equation (4).

    pose: x, y (m), heading (rad), its cosine and sine.
    """
    px, py, heading, cosine, sine = pose
    places = tables.places_m
    best, least, total = -1, np.inf, 0.0
    table, sets, first, end = points.sets[i, 0], points.sets[i, 1], points.sets[i, 2], points.sets[i, 3]
    if table >= 0:
        x, y = points.positions_m[i, 0], points.positions_m[i, 1]
        if sets > 1:
            table += math.floor((heading + points.turns_rad[i]) / (0.5 * math.pi)) % sets
        best = table_place(tables, table, px + cosine * x - sine * y, py + sine * x + cosine * y)
        if best >= 0:
            dx, dy = places[best, 0] - px, places[best, 1] - py
            least = point_exponent(points, i, polar, cosine * dx + sine * dy, cosine * dy - sine * dx)
            total = math.exp(-least)
    for k in range(first, end):
        place = points.candidates[k]
        dx, dy = places[place, 0] - px, places[place, 1] - py
        exponent = point_exponent(points, i, polar, cosine * dx + sine * dy, cosine * dy - sine * dx)
        total += math.exp(-exponent)
        if exponent < least:
            best, least = place, exponent
    return best, least, total


@numba.njit(cache=True)
def add_points(found, poses, points, tables, polar):  # type: ignore[no-untyped-def]
    """Add the logarithms of section 5.3's mixture of all points to found (N,), of poses (N, 3)."""
    points, tables = uncounted((points, tables))
    for j in range(poses.shape[0]):
        heading = poses[j, 2]
        pose = (poses[j, 0], poses[j, 1], heading, math.cos(heading), math.sin(heading))
        total = 0.0
        for i in range(points.positions_m.shape[0]):
            least = best_place(points, i, tables, polar, pose)[1]
            total += math.log(points.floors[i] + points.peaks[i] * math.exp(-least))
        found[j] += total


@numba.njit(cache=True)
def line_table(lines):  # type: ignore[no-untyped-def]
    """(L, 8) of observed lines: middle x, y; unit direction dx, dy; half the length (m); distance to the left of the
    robot; inverse squares of both sigmas.
    """
    ends = lines.ends_m
    table = np.empty((ends.shape[0], 8))
    for i in range(ends.shape[0]):
        x, y = ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1]
        length = math.sqrt(x * x + y * y)
        table[i, 0], table[i, 1] = 0.5 * (ends[i, 0, 0] + ends[i, 1, 0]), 0.5 * (ends[i, 0, 1] + ends[i, 1, 1])
        table[i, 2], table[i, 3], table[i, 4] = x / length, y / length, 0.5 * length
        table[i, 5] = table[i, 2] * table[i, 1] - table[i, 3] * table[i, 0]
        table[i, 6], table[i, 7] = 1.0 / lines.sigmas[i, 0] ** 2, 1.0 / lines.sigmas[i, 1] ** 2
    return table


@numba.njit(cache=True)
def perpendicular_exponent(seen, i, direction, field, k, pose):  # type: ignore[no-untyped-def]
    """Equations (6) and (7): half the squared error of the perpendiculars' difference and of the direction.

    Infinite where the line would lie on the robot's other side. The direction's error is its chord.
    """
    dx, dy = direction
    offset = field[k, 2] - (field[k, 0] * pose[1] - field[k, 1] * pose[0])  # of the field's line, to its left
    along = field[k, 0] * dx + field[k, 1] * dy  # cosine between both normals
    dot = offset * seen[i, 5] * along
    if dot <= 0.0:
        return np.inf
    square = offset * offset + seen[i, 5] * seen[i, 5] - 2.0 * dot
    return 0.5 * square * seen[i, 6] + (1.0 - abs(along)) * seen[i, 7]


@numba.njit(cache=True)
def middle_exponent(seen, i, turned, field, k):  # type: ignore[no-untyped-def]
    """Half the squared error of where the middle of line i lies beside line k, of the direction, and of how far the
    ends lie beyond those of the line. turned: its unit direction and middle in the field frame.
    """
    dx, dy, x, y = turned
    ux, uy = field[k, 0], field[k, 1]
    sine = ux * dy - uy * dx
    if abs(sine) > 0.9:
        return np.inf
    aside = ux * y - uy * x - field[k, 2]
    middle = ux * x + uy * y - field[k, 3]
    half = seen[i, 4] * abs(ux * dx + uy * dy)
    beyond = max(0.0, max(half - middle, middle + half - field[k, 4]))
    return 0.5 * ((aside * aside + beyond * beyond) * seen[i, 6] + sine * sine * seen[i, 7])


@numba.njit(cache=True)
def best_line(seen, i, field, polar, pose):  # type: ignore[no-untyped-def]
    """The line of the field (-1 for none) that line i is taken for, and its exponent: the least one.

    seen (L, 8): `line_table`. field (S, 5): `field_lines`. pose: x, y (m), heading (rad), its cosine and sine.
    """
    cosine, sine = pose[3], pose[4]
    dx, dy = cosine * seen[i, 2] - sine * seen[i, 3], sine * seen[i, 2] + cosine * seen[i, 3]
    x = pose[0] + cosine * seen[i, 0] - sine * seen[i, 1]
    y = pose[1] + sine * seen[i, 0] + cosine * seen[i, 1]
    best, least = -1, np.inf
    for k in range(field.shape[0]):
        if polar:
            exponent = perpendicular_exponent(seen, i, (dx, dy), field, k, pose)
        else:
            exponent = middle_exponent(seen, i, (dx, dy, x, y), field, k)
        if exponent < least:
            best, least = k, exponent
    return best, least


@numba.njit(cache=True)
def add_lines(found, poses, lines, field, polar):  # type: ignore[no-untyped-def]
    """Add the logarithms of section 5.3's mixture of all lines to found (N,); exp comes after the association."""
    seen = line_table(lines)
    for j in range(poses.shape[0]):
        heading = poses[j, 2]
        pose = (poses[j, 0], poses[j, 1], heading, math.cos(heading), math.sin(heading))
        total = 0.0
        for i in range(seen.shape[0]):
            least = best_line(seen, i, field, polar, pose)[1]
            total += math.log(lines.floors[i] + lines.peaks[i] * math.exp(-least))
        found[j] += total
