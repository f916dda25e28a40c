"""The observation level: line points as perception would deliver them, without an image.

The scan paths of the detector are crossed with the field's paint (`crossings`); then points are missed, shifted along
their path and joined by false ones (`point_errors`), with figures fitted to what the detector finds in rendered images.
"""

import math
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.camera import OmniCamera
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.perception import LinePointSettings
from touchline.perception.line_points import BLUR_PX, COARSEST_PX_M, NOISE_M, STEEPEST_CROSSING
from touchline.perception.scan_lines import usable_radius
from touchline.published.iris_fusion import hsv_lines
from touchline.published.iris_fusion.hsv_lines import HsvLineSettings
from touchline.types import LinePoints
from touchline_lab.simulation.observation.crossings import COLUMNS, Ground, find_crossings, hidden, scale_table
from touchline_lab.simulation.observation.fixed_noise import mosaic_table
from touchline_lab.simulation.observation.goal_clutter import PLACES, place_strays, thread_table
from touchline_lab.simulation.observation.point_errors import ObservationNoise, PointErrors, perturbed
from touchline_lab.simulation.observation.runs import BAR, round_table, segment_table

_BAR_M = (0.12, 0.05)  # a goal's bar on the ground as seen from above, with its side: width, how far behind its middle
_MARK_M = 0.06  # by so much blur lets a path pass beside a round mark and still meet it
_STEP_PX = 4.0  # between the nodes of what a camera as built sees elsewhere
_MAX_ANYWHERE = 32  # false points of an image, elsewhere
NO_BODIES, NO_SECTORS = np.zeros((0, 4)), np.zeros((0, 2))


class ScanPaths(NamedTuple):
    """Where a detector looks for lines, and what it says of its points.

    rays: all round; staggered: every second one begins half way out. circles: about the robot. max_chord: longest way
    through a line, in its widths. point_px, point_m: the deviation that it gives its points, in the image and beside.
    own_ranges: points are read with ranges that may be far from the mirror's, and end elsewhere. hull: it looks only
    within the hull of its own carpet, not at a field beside.
    """

    rays: int
    staggered: bool
    circles: int
    max_chord: float
    point_px: float
    point_m: float
    own_ranges: bool = False
    hull: bool = False


_NUBOT, _IRIS = LinePointSettings(), HsvLineSettings()
_IRIS_RAYS = round(360.0 / _IRIS.ray_step_deg)
NUBOT_PATHS = ScanPaths(2 * _NUBOT.radial_scan_lines, True, _NUBOT.circles, STEEPEST_CROSSING, _NUBOT.noise_px, NOISE_M)
IRIS_PATHS = ScanPaths(_IRIS_RAYS, False, 0, hsv_lines.MAX_RUN, _IRIS.noise_px, hsv_lines.NOISE_M, True, True)


class BuiltCamera(NamedTuple):
    """A camera as built, where it is not quite the one that was designed.

    project: pixels (N, 2) at which it truly sees ground points (N, 2), base frame. shift_by_swing: (N, 2, 2) by how
    many pixels what is seen at pixels (N, 2) moves for each radian that its mirror leans more about x and y; None: it
    doesn't swing. known: the camera that its pixels are read with; None: the one that was designed.
    """

    project: Callable[[FloatArray], FloatArray]
    shift_by_swing: Callable[[FloatArray], FloatArray] | None = None
    known: OmniCamera | None = None


class ObservedLines:
    """A virtual detector for one camera and one field: `observe` gives line points for a pose."""

    def __init__(
        self,
        camera: OmniCamera,
        field: FieldModel,
        noise: ObservationNoise | None = None,
        paths: ScanPaths = NUBOT_PATHS,
        view_rad: float = math.pi,
        seed: int = 0,
        as_built: BuiltCamera | None = None,
        beside: FloatArray | None = None,
    ) -> None:
        """view_rad: how far to each side the camera sees. seed: of those errors that come again at the same place.

        as_built: what the camera really is; none: as designed. beside: lines (S, 4) of another field, x, y from and to.
        """
        self.camera, self.field, self.seed = camera, field, seed
        self.noise = noise or ObservationNoise()
        self.paths = paths
        self.view_rad = view_rad
        self._scales = _scale_table(camera)
        read_with = camera if as_built is None or as_built.known is None else as_built.known
        outer_px = min(usable_radius(each, COARSEST_PX_M) for each in (camera, *((read_with,) * paths.own_ranges)))
        self._rays, self._circles = _scan_geometry(camera, paths, view_rad, outer_px)
        n, width = self.noise, field.line_width
        limits = (width, paths.max_chord, BLUR_PX, n.bridged_px, n.apart_px)
        goals, bars = _goals(field)
        kinds = [n.white_goals if goal.color == "white" else n.coloured_goals for goal in field.goals]
        self._goals = goals, np.array([kind.numbers() for kind in kinds]).reshape(-1, 7)
        self._covered_goals = goals, np.array([n.covered_goals.numbers()] * len(goals)).reshape(-1, 7)
        self._threads = thread_table(goals, [goal.color == "white" for goal in field.goals], seed)
        lines = np.concatenate((segment_table(field.segments, width), bars))
        marks = field.discs + np.array([0.0, 0.0, _MARK_M])
        paint = (lines, round_table(field.circles, field.arcs), marks)
        mouth = np.array([abs(field.goals[0].x), *sorted(field.goals[0].y_posts)] if field.goals else [0.0] * 3)
        carpet = (0.5 * field.length + field.border, 0.5 * field.width + field.border)
        self._ground = Ground(self._rays, self._circles, limits, paint, mouth, carpet, self._scales)
        lookup, known = _lookup(camera), _lookup(read_with)
        nodes = None if as_built is None else _nodes(camera)
        self._posts = np.array([(p.x, p.y, 0.5 * p.diameter, p.height) for p in field.posts]).reshape(-1, 4)
        self._unseen = np.array([[view_rad, -view_rad]] if view_rad < math.pi else np.zeros((0, 2)))
        self._errors = PointErrors(
            n.numbers(paths.point_px, paths.point_m), len(self._rays), seed, mosaic_table(seed), lookup, known,
            self._scales, _scale_table(read_with) if paths.own_ranges and read_with is not camera else np.zeros((0, 2)),
            np.zeros((0, 0, 2)) if nodes is None or as_built is None else _askew(camera, nodes, as_built.project),
            _STEP_PX,
        )  # fmt: skip
        self._built, self._beside = as_built, np.zeros((0, 4)) if beside is None or paths.hull else beside
        self._found = np.empty((2048, COLUMNS))
        self._places = np.empty((PLACES * len(goals) + _MAX_ANYWHERE + len(self._rays), 2))

    def crossings(self, pose: Pose, bodies: FloatArray = NO_BODIES, black_rad: FloatArray = NO_SECTORS) -> FloatArray:
        """(M, COLUMNS) all that the detector might find from a pose, arguments as of `observe`: see `crossings`."""
        hiding = occluders(np.concatenate((self._posts, bodies)), self.noise.height_m)
        place = pose.x, pose.y, pose.heading
        return self._found[: find_crossings(place, self._ground, hiding, self._sectors(black_rad), self._found)]

    def observe(
        self,
        pose: Pose,
        rng: np.random.Generator,
        bodies: FloatArray = NO_BODIES,
        black_rad: FloatArray = NO_SECTORS,
        swing_rad: tuple[float, float] = (0.0, 0.0),
    ) -> LinePoints:
        """Line points seen from a pose in the field.

        bodies: (K, 4) x, y (field frame), radius, height (m) of what hides the ground behind it; posts do anyway.
        black_rad: (B, 2) directions from, to (base frame, counter-clockwise) in which nothing is seen. swing_rad: how
        much the mirror leans about x and y beyond its mount.
        """
        n, sectors = self.noise, self._sectors(black_rad)
        goals = self._covered_goals if len(black_rad) else self._goals
        anywhere = min(int(rng.poisson(n.false_points)), _MAX_ANYWHERE)
        count, false_count = _seen(
            (pose.x, pose.y, pose.heading), self._ground,
            (self._posts, bodies, n.height_m), sectors, rng.random((anywhere, 2)), (goals, self._threads, self.seed),
            self._found, self._places,
        )  # fmt: skip
        beside = self._seen_beside(pose, bodies)
        self._places[false_count : false_count + len(beside)] = beside
        false_count += len(beside)
        total = count + false_count
        if total == 0:
            return LinePoints.none()
        errors = self._errors
        if any(swing_rad) and self._swings is not None:
            errors = errors._replace(askew=self._still_askew + self._swings @ np.array(swing_rad))
        rows = np.empty((total, 9))
        kept = perturbed(
            self._found[:count], self._places[:false_count], sectors, errors, rng.standard_normal(3),
            rng.standard_normal((total, 2)), rows,
        )  # fmt: skip
        rows = rows[:kept]
        return LinePoints(rows[:, :2], rows[:, 2:6].reshape(-1, 2, 2), rows[:, 6], rows[:, 7:9])

    @cached_property
    def _farthest_found_m(self) -> float:
        """Range (m) beyond which a pixel is too long on the ground for lines to be found."""
        steps_m = np.diff(self.camera.range_m, axis=1).max(axis=0) / np.diff(self.camera.radius_px)
        coarse = np.flatnonzero(steps_m > self.noise.coarse_half_m)
        return float(self.camera.range_m[:, coarse[0] if len(coarse) else -1].min())

    @cached_property
    def _swings(self) -> FloatArray | None:
        """(R, C, 2, 2) by how many pixels the nodes move with the lean of the mirror; None: it doesn't swing."""
        if self._built is None or self._built.shift_by_swing is None:
            return None
        nodes = _nodes(self.camera)
        return np.nan_to_num(self._built.shift_by_swing(nodes.reshape(-1, 2)).reshape(*nodes.shape, 2))

    @cached_property
    def _still_askew(self) -> FloatArray:
        """(R, C, 2) as of `PointErrors.askew`, of a mirror that sits as designed, too."""
        askew = self._errors.askew
        return askew if len(askew) else np.zeros(_nodes(self.camera).shape)

    def _seen_beside(self, pose: Pose, bodies: FloatArray) -> FloatArray:
        """(N, 2) where rays meet the lines of the field beside (base frame, m), behind no body: the nearest on each."""
        if len(self._beside) == 0:
            return np.zeros((0, 2))
        ends = pose.inverse().transform(self._beside.reshape(-1, 2)).reshape(-1, 4)
        out = np.column_stack((np.cos(self._rays[:, 0]), np.sin(self._rays[:, 0])))
        along = ends[:, 2:] - ends[:, :2]
        cross = out[:, :1] * along[:, 1] - out[:, 1:] * along[:, 0]  # (P, S)
        start = ends[:, 0] * along[:, 1] - ends[:, 1] * along[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = start / cross
            part = (ends[:, 0] * out[:, 1:] - ends[:, 1] * out[:, :1]) / cross
        last = np.minimum(self._rays[:, 2:3], self._farthest_found_m)
        met = (part >= 0.0) & (part <= 1.0) & (reach > self._rays[:, 1:2]) & (reach < last)
        nearest = np.where(met, reach, np.inf).min(axis=1)
        places = out[np.isfinite(nearest)] * nearest[np.isfinite(nearest), np.newaxis]
        hiding = occluders(bodies, self.noise.height_m)
        at = pose.transform(places)
        clear = [not hidden(pose.x, pose.y, x, y, hiding) for x, y in at]
        return places[np.array(clear, dtype=np.bool_)]

    def _sectors(self, black_rad: FloatArray) -> FloatArray:
        """(B, 2) directions in which nothing is seen."""
        return np.concatenate((self._unseen, black_rad))


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
    return rows, segment_table(np.array(bars, dtype=np.float64).reshape(-1, 4), _BAR_M[0], BAR)


def _lookup(camera: OmniCamera) -> tuple[FloatArray, FloatArray, FloatArray]:
    return camera.lookup_constants, camera.bearings_rad, camera.lookup_table


def _scale_table(camera: OmniCamera) -> FloatArray:
    return scale_table(camera, float(camera.range_m[:, -1].min()))


def _nodes(camera: OmniCamera) -> FloatArray:
    """(R, C, 2) pixels, _STEP_PX apart, where it is known what a camera as built sees; moved to where it sees any."""
    v, u = np.mgrid[0 : camera.height + _STEP_PX : _STEP_PX, 0 : camera.width + _STEP_PX : _STEP_PX]
    nodes = np.stack((u, v), axis=-1)
    from_center = nodes - np.array(camera.center)
    radius = np.hypot(from_center[..., 0], from_center[..., 1])
    inside = np.clip(radius, camera.radius_px[0] + 0.5, camera.radius_px[-1] - 3.0) / np.maximum(radius, 1e-9)
    return np.array(camera.center) + from_center * inside[..., np.newaxis]


def _askew(camera: OmniCamera, nodes: FloatArray, project: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """(R, C, 2) by how many pixels the camera as built sees a ground point elsewhere; empty if it does not."""
    flat = nodes.reshape(-1, 2)
    grid: FloatArray = np.nan_to_num(project(camera.ground_from_image(flat)) - flat).reshape(nodes.shape)
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


def _scan_geometry(
    camera: OmniCamera, paths: ScanPaths, view_rad: float, outer: float
) -> tuple[FloatArray, FloatArray]:
    """The detector's rays (P, 3): bearing (rad), nearest, farthest range (m); circles (Q, 2): range (m), radius (px).

    outer: the radius (px) up to which the detector looks.
    Where the camera's table depends on the direction, a circle of the image is taken for one on the ground.
    """
    inner = camera.inner_radius_px
    angles = 2.0 * np.pi / paths.rays * np.arange(paths.rays)
    late = paths.staggered & (np.arange(len(angles)) % 2 == 1)
    first = np.where(late, max(inner, 0.5 * outer), inner)
    bearings = camera.mount_yaw_rad + camera.handedness * angles
    out = np.column_stack((np.cos(angles), np.sin(angles)))
    last = min(outer, float(camera.radius_px[-1]) - 1e-6)  # so that no rounding leads out of the table
    near, far = (
        camera.ground_from_image(np.asarray(camera.center) + radius * out) for radius in (first[:, np.newaxis], last)
    )
    rays = np.column_stack((bearings, np.hypot(near[:, 0], near[:, 1]), np.hypot(far[:, 0], far[:, 1])))
    turned = np.abs(np.mod(bearings + np.pi, 2.0 * np.pi) - np.pi)
    radii = np.linspace(inner, outer, paths.circles + 2)[1:-1]
    ranges = np.interp(radii, camera.radius_px, camera.range_m.mean(axis=0))
    return np.ascontiguousarray(rays[turned <= view_rad]), np.column_stack((ranges, radii))


@njit(cache=True, error_model="numpy")
def _seen(pose, ground, occluding, sectors, uniforms, clutter, found, places):  # type: ignore[no-untyped-def]
    """What `find_crossings` finds, into found, and false points, into places (K, 2), base frame: how many of each.

    occluding: posts, bodies (K, 4 each) as of `occluders`, and the height (m) that they are seen from. uniforms (N, 2):
    where on rays other false points are. clutter: goals, threads, seed of `place_strays`. Else as `find_crossings`.
    """
    (posts, bodies, view_m), (goals, threads, seed), rays = occluding, clutter, ground.rays
    standing, moving = occluders(posts, view_m), occluders(bodies, view_m)
    hiding = np.concatenate((standing, moving))
    count = find_crossings(pose, ground, hiding, sectors, found)
    for k in range(len(uniforms)):
        ray = rays[int(uniforms[k, 0] * len(rays))]
        reach = ray[1] + uniforms[k, 1] * (ray[2] - ray[1])
        places[k, 0], places[k, 1] = reach * math.cos(ray[0]), reach * math.sin(ray[0])
    view = view_m, ground.mouth, moving, ground.carpet, ground.scales
    return count, place_strays(pose, goals, threads, seed, view, places, len(uniforms))
