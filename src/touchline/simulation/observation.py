"""The observation level: line points as perception would deliver them, without an image.

The scan paths of the detector are crossed with the field's paint (`crossings`); then points are missed, shifted along
their path and joined by false ones (`point_errors`), with figures fitted to what the detector finds in rendered images.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from touchline.camera import OmniCamera
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.perception import LinePointSettings
from touchline.simulation.crossings import COLUMNS, find_crossings, hidden, scale_table, through_mouth
from touchline.simulation.point_errors import ObservationNoise, mosaic_table, perturbed, phase_noise
from touchline.simulation.runs import BAR, bar_table, round_table
from touchline.types import LinePoints, empty_points

_BAR_M = (0.12, 0.05)  # a goal's bar on the ground as seen from above, with its side: width, how far behind its middle
_MARK_M = 0.06  # by so much blur lets a path pass beside a round mark and still meet it
_STEP_PX = 4.0  # between the nodes of what a camera as built sees elsewhere
_STRAY_PLACES, _NET_PLACES = 60, 24  # per goal; how many of them on the net behind
_MOST_ANYWHERE = 32  # false points of an image, elsewhere
_NO_BODIES = np.zeros((0, 4))
_STRAY_TURN_RAD = 0.1  # after such a turn or
_STRAY_WAY_M = 0.3  # such a way other false points are seen


class ObservedLines:
    """A virtual detector for one camera and one field: `observe` gives line points for a pose."""

    def __init__(
        self,
        camera: OmniCamera,
        field: FieldModel,
        noise: ObservationNoise | None = None,
        detector: LinePointSettings | None = None,
        view_rad: float = math.pi,
        seed: int = 0,
        as_built: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        """view_rad: how far to each side the camera sees. seed: of those errors that come again at the same place.

        as_built: pixels (N, 2) at which the camera truly sees ground points (N, 2), base frame, where it is not quite
        the one it is taken for; none: it is.
        """
        self.camera, self.field, self.seed = camera, field, seed
        self.noise = noise or ObservationNoise()
        self.detector = detector or LinePointSettings()
        self.view_rad = view_rad
        self._scales = scale_table(camera, float(camera.range_m[:, -1].min()))
        self._rays, self._circles = _scan_geometry(camera, self.detector, view_rad)
        s, n = self.detector, self.noise
        width = s.line_width_m or field.line_width
        self._limits = (width, s.steepest_crossing, s.blur_px, n.bridged_px, n.apart_px)
        self._goals, bars = _goals(field)
        lines = np.concatenate((bar_table(field.segments, width), bars))
        marks = field.discs + np.array([0.0, 0.0, _MARK_M])
        self._paint = (lines, round_table(field.circles, field.arcs), marks)
        self._mouth = np.array([abs(field.goals[0].x), *sorted(field.goals[0].y_posts)] if field.goals else [0.0] * 3)
        self._carpet = (0.5 * field.length + field.border, 0.5 * field.width + field.border)
        self._lookup = (camera.lookup_constants, camera.bearings_rad, camera.lookup_table)
        self._posts = np.array([(p.x, p.y, 0.5 * p.diameter, p.height) for p in field.posts]).reshape(-1, 4)
        self._unseen = np.array([[view_rad, -view_rad]] if view_rad < math.pi else np.zeros((0, 2)))
        self._numbers = n.numbers(s.noise_px, s.noise_m)
        self._askew = (_askew(camera, as_built), _STEP_PX)
        self._same = (seed, mosaic_table(seed))
        self._found = np.empty((2048, COLUMNS))
        self._places = np.empty((_STRAY_PLACES * len(self._goals) + _MOST_ANYWHERE, 2))

    def crossings(
        self, pose: Pose, bodies: FloatArray | None = None, black_rad: FloatArray | None = None
    ) -> FloatArray:
        """(M, COLUMNS) all that the detector might find from a pose, arguments as of `observe`: see `crossings`."""
        hiding = np.concatenate((self._posts, _NO_BODIES if bodies is None else bodies))
        count = find_crossings(
            (pose.x, pose.y, pose.heading), self._rays, self._circles, self._limits, self._paint, self._mouth,
            occluders(hiding, self.noise.height_m), self._carpet, self._sectors(black_rad), self._scales, self._found,
        )  # fmt: skip
        return self._found[:count]

    def observe(
        self,
        pose: Pose,
        rng: np.random.Generator,
        bodies: FloatArray | None = None,
        black_rad: FloatArray | None = None,
    ) -> LinePoints:
        """Line points seen from a pose in the field.

        bodies: (K, 4) x, y (field frame), radius, height (m) of what hides the ground behind it; posts do anyway.
        black_rad: (B, 2) directions from, to (base frame, counter-clockwise) in which nothing is seen.
        """
        n, sectors = self.noise, self._sectors(black_rad)
        more = n.covered_factor if black_rad is not None and len(black_rad) else 1.0
        anywhere = min(int(rng.poisson(more * n.false_points)), _MOST_ANYWHERE)
        means = more * n.goal_points, n.goal_m, more * n.net_points, min(more, 2.0) * n.net_m
        count, false_count = _seen(
            (pose.x, pose.y, pose.heading), self._rays, self._circles, self._limits, self._paint, self._mouth,
            self._posts, _NO_BODIES if bodies is None else bodies, n.height_m, self._carpet, sectors, self._scales,
            self._found, rng.random((anywhere, 2)), self._goals, self.seed, means, self._places,
        )  # fmt: skip
        total = count + false_count
        if total == 0:
            return empty_points()
        rows = np.empty((total, 9))
        kept = perturbed(
            self._found[:count], self._places[:false_count], len(self._rays), sectors, self._numbers, self._same,
            rng.standard_normal(3), rng.standard_normal((total, 2)), self._lookup, self._scales, self._askew, rows,
        )  # fmt: skip
        rows = rows[:kept]
        return LinePoints(rows[:, :2], rows[:, 2:6].reshape(-1, 2, 2), rows[:, 6], rows[:, 7:9])

    def _sectors(self, black_rad: FloatArray | None) -> FloatArray:
        """(B, 2) directions in which nothing is seen."""
        return self._unseen if black_rad is None or len(black_rad) == 0 else np.concatenate((self._unseen, black_rad))


@njit(cache=True, error_model="numpy")
def occluders(bodies, view_m):  # type: ignore[no-untyped-def]
    """(K, 4) x, y, radius, reach for `crossings.hidden` of bodies (K, 4) x, y, radius, height (m) seen from view_m."""
    table = bodies.copy()
    for i in range(len(table)):
        above = view_m - bodies[i, 3]
        table[i, 3] = view_m / above if above > 1e-3 else np.inf
    return table


def _goals(field: FieldModel) -> tuple[FloatArray, FloatArray]:
    """(G, 4) x of the posts and of the net, lowest and highest y (m) of each goal; bars of the white ones."""
    boxes, bars = [], []
    for goal in field.goals:
        side, low, high = math.copysign(1.0, goal.x), min(goal.y_posts), max(goal.y_posts)
        boxes.append((goal.x, goal.x + side * goal.depth, low, high))
        if goal.color == "white":
            back = goal.x + side * (goal.depth + _BAR_M[1])
            bars.append((back, low, back, high))
    rows = np.array(boxes, dtype=np.float64).reshape(-1, 4)
    return rows, bar_table(np.array(bars, dtype=np.float64).reshape(-1, 4), _BAR_M[0], BAR)


def _askew(camera: OmniCamera, as_built: Callable[[FloatArray], FloatArray] | None) -> FloatArray:
    """(R, C, 2) by how many pixels the camera as built sees a ground point elsewhere; empty if it does not."""
    if as_built is None:
        return np.zeros((0, 0, 2))
    v, u = np.mgrid[0 : camera.height + _STEP_PX : _STEP_PX, 0 : camera.width + _STEP_PX : _STEP_PX]
    nodes = np.column_stack((u.ravel(), v.ravel()))
    from_center = nodes - np.array(camera.center)
    radius = np.hypot(from_center[:, 0], from_center[:, 1])
    inside = np.clip(radius, camera.radius_px[0] + 0.5, camera.radius_px[-1] - 3.0) / np.maximum(radius, 1e-9)
    nearest = np.array(camera.center) + from_center * inside[:, np.newaxis]
    shifts = as_built(camera.ground_from_image(nearest)) - nearest
    grid: FloatArray = np.nan_to_num(shifts).reshape(*u.shape, 2)
    return np.zeros((0, 0, 2)) if np.abs(grid).max() < 1e-6 else np.ascontiguousarray(grid)


def leaning_view(height_m: float, focal_px: float, farthest_m: float) -> OmniCamera:
    """The ground as a head at a height (m) sees it, as a table: one pixel is 1 / focal_px of angle everywhere.

    It stands for a pinhole camera with known lean at the observation level; its pixels are no image's.
    """
    radii = np.arange(1.0, focal_px * math.atan2(farthest_m, height_m) + 2.0)
    ranges = height_m * np.tan(np.minimum(radii / focal_px, 1.56))
    outer = float(radii[-1])
    size = 2 * int(outer) + 3
    return OmniCamera(size, size, (outer + 1.0, outer + 1.0), 0.3 * focal_px, outer, 1, 0.0, radii, np.zeros(1),
                      ranges[np.newaxis])  # fmt: skip


def _scan_geometry(camera: OmniCamera, s: LinePointSettings, view_rad: float) -> tuple[FloatArray, FloatArray]:
    """The detector's rays (P, 3): bearing (rad), nearest, farthest range (m); circles (Q, 2): range (m), radius (px).

    Where the camera's table depends on the direction, a circle of the image is taken for one on the ground.
    """
    inner, outer = camera.inner_radius_px, _farthest_radius(camera, s.coarsest_px_m)
    angles = np.pi / s.radial_scan_lines * np.arange(2 * s.radial_scan_lines)
    first = np.where(np.arange(len(angles)) % 2 == 0, inner, max(inner, 0.5 * outer))
    bearings = camera.mount_yaw_rad + camera.handedness * angles
    out = np.column_stack((np.cos(angles), np.sin(angles)))
    last = min(outer, float(camera.radius_px[-1]) - 1e-6)  # so that no rounding leads out of the table
    near, far = (
        camera.ground_from_image(np.asarray(camera.center) + radius * out) for radius in (first[:, np.newaxis], last)
    )
    rays = np.column_stack((bearings, np.hypot(near[:, 0], near[:, 1]), np.hypot(far[:, 0], far[:, 1])))
    turned = np.abs(np.mod(bearings + np.pi, 2.0 * np.pi) - np.pi)
    radii = np.linspace(inner, outer, s.circles + 2)[1:-1]
    ranges = np.interp(radii, camera.radius_px, camera.range_m.mean(axis=0))
    return np.ascontiguousarray(rays[turned <= view_rad]), np.column_stack((ranges, radii))


def _farthest_radius(camera: OmniCamera, coarsest_px_m: float) -> float:
    """The radius (px) beyond which the detector does not look: a pixel there is longer than coarsest_px_m."""
    too_coarse = np.flatnonzero(np.diff(camera.range_m, axis=1).max(axis=0) > coarsest_px_m * np.diff(camera.radius_px))
    limit = camera.radius_px[too_coarse[0]] if len(too_coarse) else camera.radius_px[-1]
    return float(min(limit, camera.outer_radius_px))


@njit(cache=True, error_model="numpy")
def _seen(  # type: ignore[no-untyped-def]
    pose, rays, circles, limits, paint, mouth, posts, bodies, view_m, carpet, sectors, scales, found, uniforms, goals,
    seed, means, places,
):  # fmt: skip
    """What `find_crossings` finds, into found, and false points, into places (`_place_strays`): how many of each.

    posts, bodies: (K, 4) as of `occluders`, seen from the height view_m (m); the other arguments as there.
    """
    standing, moving = occluders(posts, view_m), occluders(bodies, view_m)
    hiding = np.concatenate((standing, moving))
    count = find_crossings(pose, rays, circles, limits, paint, mouth, hiding, carpet, sectors, scales, found)
    return count, _place_strays(uniforms, rays, goals, pose, seed, means, mouth, moving, places)


@njit(cache=True, error_model="numpy")
def _place_strays(uniforms, rays, goals, pose, seed, means, mouth, bodies, places):  # type: ignore[no-untyped-def]
    """Fill places (K, 2), base frame: some on rays (P, 3), then those seen in the goals (G, 4), field frame; how many.

    A goal's first places lie on the net behind, the others on posts and side nets; which of them give a point depends
    on the direction and distance from which they are seen. uniforms (N, 2): where on rays. means: mean number at posts
    and sides seen from 1 m, the range (m) within which; mean number through the net, the range. mouth, bodies: see
    `crossings`.
    """
    x, y, heading = pose
    c, s = math.cos(heading), math.sin(heading)
    for k in range(len(uniforms)):
        ray = rays[int(uniforms[k, 0] * len(rays))]
        reach = ray[1] + uniforms[k, 1] * (ray[2] - ray[1])
        places[k, 0], places[k, 1] = reach * math.cos(ray[0]), reach * math.sin(ray[0])
    count = len(uniforms)
    for g in range(len(goals)):
        depth, span = goals[g, 1] - goals[g, 0], goals[g, 3] - goals[g, 2]
        away = math.sqrt((goals[g, 0] - x) ** 2 + (0.5 * (goals[g, 2] + goals[g, 3]) - y) ** 2)
        sides = means[0] / max(away, 1.0) / (_STRAY_PLACES - _NET_PLACES) if away < means[1] else 0.0
        net = means[2] / _NET_PLACES if away < means[3] else 0.0
        for k in range(_STRAY_PLACES):
            share = net if k < _NET_PLACES else sides
            if share == 0.0:
                continue
            name = 4096 + _STRAY_PLACES * g + k
            deep, aside = phase_noise(seed, name, 0.0), phase_noise(seed, name, 1.0)
            if k < _NET_PLACES:
                px, py = goals[g, 1], goals[g, 2] + span * (0.5 + 0.25 * aside)
            else:
                px = goals[g, 0] + depth * (0.5 + 0.25 * deep)
                py = (goals[g, 2] if k % 2 else goals[g, 3]) + 0.05 * aside
            if hidden(x, y, px, py, bodies) or (k < _NET_PLACES and not through_mouth(x, y, px, py, mouth)):
                continue
            stretch = 1.25 + 0.12 * phase_noise(seed, name, 2.0)  # threads are above the ground that they hide
            px, py = x + stretch * (px - x), y + stretch * (py - y)
            px, py = px - x, py - y
            seen = 0.8 * phase_noise(seed, name, 10.0 + (heading + math.atan2(py, px)) / _STRAY_TURN_RAD)
            seen += 0.6 * phase_noise(seed, name + 2048, 10.0 + math.sqrt(px * px + py * py) / _STRAY_WAY_M)
            if 0.5 * math.erfc(seen / math.sqrt(2.0)) < share:
                places[count, 0], places[count, 1] = c * px + s * py, c * py - s * px
                count += 1
    return count
