"""The observation level: line points as perception would deliver them, without an image.

The scan paths of the detector are crossed with the field's paint; then points are missed, shifted along their path and
joined by false ones, with figures fitted to what the detector finds in rendered images (docs/simulation.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numba import njit
from pydantic import Field

from touchline.camera import OmniCamera
from touchline.camera.omni import ground_from_pixel, pixel_from_ground
from touchline.config import Settings
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.perception import LinePointSettings
from touchline.simulation.crossings import COLUMNS, find_crossings, round_table, scale_at, scale_table
from touchline.types import LinePoints, empty_points


class ObservationNoise(Settings):
    """What perception adds to the truth. Pixels are along the scan path that found the point."""

    noise_px: float = Field(0.085, ge=0, description="standard deviation of most points on rays")
    wild_px: float = Field(0.33, ge=0, description="standard deviation of the others")
    circle_noise_px: float = Field(0.11, ge=0, description="standard deviation of most points on circles")
    circle_wild_px: float = Field(0.72, ge=0, description="standard deviation of the others")
    wild_share: float = Field(0.08, ge=0, le=1, description="share of the others")
    thin_px: float = Field(0.3, ge=0, description="width of a line at which the deviation has grown by 1.4")
    oblique_px: float = Field(4.0, gt=0, description="length of a crossing at which the deviation has grown by 1.4")
    spread_px: float = Field(
        1.55, ge=0, description="blur that widens a line: where the mirror's scale grows it shifts points outwards"
    )
    frame_px: float = Field(0.02, ge=0, description="deviation that all points on rays of an image share")
    found_share: float = Field(0.95, ge=0, le=1, description="share of easy crossings of rays that are found")
    circle_share: float = Field(0.85, ge=0, le=1, description="share of easy crossings of circles that are found")
    thin_half_px: float = Field(0.47, gt=0, description="width at which half the lines on rays are too thin")
    thin_slope_px: float = Field(0.06, gt=0, description="how fast that changes with the width (logistic)")
    circle_half_px: float = Field(1.5, gt=0, description="width at which half the lines on circles are too thin")
    circle_slope_px: float = Field(0.45, gt=0, description="how fast that changes with the width (logistic)")
    coarse_half_m: float = Field(
        0.17, gt=0, description="length of a pixel on the ground at which half is too far away"
    )
    coarse_slope_m: float = Field(0.014, gt=0, description="how fast that changes with the length (logistic)")
    long_px: float = Field(20.0, gt=0, description="length of a crossing of which half as many are found")
    contrast_px: float = Field(1.5, gt=0, description="width at which blur leaves 63 % of the contrast: the confidence")
    false_points: float = Field(0.3, ge=0, description="mean number of points on no line per image, anywhere in view")
    goal_points: float = Field(2.5, ge=0, description="mean number of those in each goal in view: nets, posts, shadows")
    lean_noise_rad: float = Field(0.0, ge=0, description="error of roll and of pitch that all points of an image share")
    height_m: float = Field(
        0.8, gt=0, description="height of the view: what hides the ground how far, and how a lean shifts it"
    )


class ObservedLines:
    """A virtual detector for one camera and one field: `observe` gives line points for a pose."""

    def __init__(
        self,
        camera: OmniCamera,
        field: FieldModel,
        noise: ObservationNoise | None = None,
        detector: LinePointSettings | None = None,
        view_rad: float = math.pi,
    ) -> None:
        """view_rad: how far to each side the camera sees."""
        self.camera, self.field = camera, field
        self.noise = noise or ObservationNoise()
        self.detector = detector or LinePointSettings()
        self.view_rad = view_rad
        self._scales = scale_table(camera, float(camera.range_m[:, -1].min()))
        self._rays, self._circles = _scan_geometry(camera, self.detector, view_rad)
        s = self.detector
        self._limits = (s.line_width_m or field.line_width, s.steepest_crossing, float(s.flank_px), s.blur_px)
        self._paint = (field.segments, round_table(field.circles, field.arcs), field.discs)
        self._carpet = (0.5 * field.length + field.border, 0.5 * field.width + field.border)
        grid = field.distance_map()
        self._grid = (grid.values, float(grid.origin_m[0]), float(grid.origin_m[1]), grid.resolution_m)
        self._lookup = (camera.lookup_constants, camera.bearings_rad, camera.lookup_table)
        self._fixed = occluders([(p.x, p.y, 0.5 * p.diameter, p.height) for p in field.posts], self.noise.height_m)
        self._goals = _goal_corners(field)
        self._stray_means = np.array([self.noise.false_points, *[self.noise.goal_points] * len(self._goals)])
        self._unseen = np.array([[view_rad, -view_rad]] if view_rad < math.pi else np.zeros((0, 2)))
        self._found = np.empty((2048, COLUMNS))

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
        hiding = self._fixed
        if bodies is not None and len(bodies):
            hiding = np.concatenate((hiding, occluders(bodies, self.noise.height_m)))
        count = find_crossings(
            (pose.x, pose.y, pose.heading), self._rays, self._circles, self._limits, self._paint, hiding,
            self._carpet, self._grid, self._scales, self._found,
        )  # fmt: skip
        n = self.noise
        strays = self._strays(pose, rng)
        total = count + len(strays)
        if total == 0:
            return empty_points()
        numbers = np.array(
            [
                n.noise_px, n.wild_px, n.circle_noise_px, n.circle_wild_px, n.wild_share, n.thin_px, n.oblique_px,
                n.spread_px, n.frame_px * rng.standard_normal(), n.found_share, n.circle_share, n.thin_half_px,
                n.thin_slope_px, n.circle_half_px, n.circle_slope_px, n.coarse_half_m, n.coarse_slope_m, n.long_px,
                n.contrast_px, self.detector.noise_px, self.detector.noise_m,
                *(n.lean_noise_rad * rng.standard_normal(2)), n.height_m,
            ]
        )  # fmt: skip
        sectors = self._unseen if black_rad is None else np.concatenate((self._unseen, black_rad))
        rows = np.empty((total, 9))
        kept = _perturbed(
            self._found[:count], strays, len(self._rays), sectors, numbers,
            rng.standard_normal(total), rng.random((total, 2)), self._lookup, self._scales, rows,
        )  # fmt: skip
        rows = rows[:kept]
        return LinePoints(rows[:, :2], rows[:, 2:6].reshape(-1, 2, 2), rows[:, 6], rows[:, 7:9])

    def _strays(self, pose: Pose, rng: np.random.Generator) -> FloatArray:
        """(K, 2) places of false points, base frame (m): anywhere in view, and in the goals that are near enough."""
        counts = rng.poisson(self._stray_means)
        for index, goal in enumerate(self._goals):
            if math.hypot(goal[0] - pose.x, pose.y) > self._rays[0, 2]:
                counts[1 + index] = 0
        places = np.empty((int(counts.sum()), 2))
        _place_strays(counts, self._rays, self._goals, (pose.x, pose.y, pose.heading), rng.random(places.shape), places)
        return places


def occluders(bodies: npt.ArrayLike, view_m: float) -> FloatArray:
    """(K, 4) x, y, radius, reach for `crossings.hidden` of bodies (K, 4) x, y, radius, height (m) seen from view_m."""
    table = np.array(bodies, dtype=np.float64).reshape(-1, 4)
    above = view_m - table[:, 3]
    table[:, 3] = np.where(above > 1e-3, view_m / np.maximum(above, 1e-3), np.inf)
    return table


def _goal_corners(field: FieldModel) -> FloatArray:
    """(G, 4) x inside the goal and behind its net, lowest and highest y of each goal (m, field frame)."""
    sides = [(g, math.copysign(1.0, g.x)) for g in field.goals]
    rows = [(g.x + side * 0.6 * g.depth, g.x + side * (g.depth + 0.6), *_widened(g.y_posts)) for g, side in sides]
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def _widened(posts: Sequence[float]) -> tuple[float, float]:
    return min(posts) - 0.3, max(posts) + 0.3


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
    near, far = (
        camera.ground_from_image(np.asarray(camera.center) + radius * out) for radius in (first[:, np.newaxis], outer)
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
def _place_strays(counts, rays, goals, pose, uniforms, places):  # type: ignore[no-untyped-def]
    """Fill places (K, 2), base frame: counts[0] on rays (P, 3), then counts[1 + g] in each goal (G, 4), field frame."""
    x, y, heading = pose
    c, s = math.cos(heading), math.sin(heading)
    k = 0
    for _ in range(counts[0]):
        ray = rays[int(uniforms[k, 0] * len(rays))]
        reach = ray[1] + uniforms[k, 1] * (ray[2] - ray[1])
        places[k, 0], places[k, 1] = reach * math.cos(ray[0]), reach * math.sin(ray[0])
        k += 1
    for g in range(len(goals)):
        for _ in range(counts[1 + g]):
            px = goals[g, 0] + uniforms[k, 0] * (goals[g, 1] - goals[g, 0]) - x
            py = goals[g, 2] + uniforms[k, 1] * (goals[g, 3] - goals[g, 2]) - y
            places[k, 0], places[k, 1] = c * px + s * py, c * py - s * px
            k += 1


@njit(cache=True, error_model="numpy")
def _inside_sector(bearing, sectors):  # type: ignore[no-untyped-def]
    for i in range(len(sectors)):
        if (bearing - sectors[i, 0]) % (2.0 * math.pi) <= (sectors[i, 1] - sectors[i, 0]) % (2.0 * math.pi):
            return True
    return False


@njit(cache=True, error_model="numpy")
def _found_share(on_ray, wide, scale, numbers):  # type: ignore[no-untyped-def]
    """Share of crossings that are found, `wide` pixels long where a pixel is `scale` m. numbers: see `observe`."""
    ray_share, circle_share, thin_half, thin_slope, circle_half, circle_slope, coarse_half, coarse_slope, long_px = (
        numbers
    )
    if on_ray:
        share = ray_share / (1.0 + math.exp((thin_half - wide) / thin_slope))
        share /= 1.0 + math.exp((scale - coarse_half) / coarse_slope)
    else:
        share = circle_share / (1.0 + math.exp((circle_half - wide) / circle_slope))
    return share / (1.0 + (wide / long_px) ** 2)


@njit(cache=True, error_model="numpy")
def _perturbed(found, strays, first_circle, sectors, numbers, normals, uniforms, camera, scales, out):  # type: ignore[no-untyped-def]
    """Points that are found, shifted, into out (N, 9): x, y, covariance (4), confidence, u, v; returns how many.

    found (M, COLUMNS) of `find_crossings`; strays (K, 2): places of false points. numbers: those of
    `ObservedLines.observe`. normals (N,) and uniforms (N, 2) bring the chance. camera: as there.
    """
    noise, wild, circle_noise, circle_wild, wild_share, thin_px, oblique, spread, frame = numbers[:9]
    contrast_px, point_px, point_m, roll, pitch, height = numbers[18:]
    kept = 0
    for i in range(len(found) + len(strays)):
        on_ray = True
        if i < len(found):
            x, y, path, chord, scale = found[i, 0], found[i, 1], found[i, 2], found[i, 3], found[i, 4]
            bend = found[i, 6]
            on_ray = path < first_circle
            wide = chord / scale
            if uniforms[i, 0] >= _found_share(on_ray, wide, scale, numbers[9:18]):
                continue
            if uniforms[i, 1] < wild_share:
                size = wild if on_ray else circle_wild
            else:
                size = noise if on_ray else circle_noise
            shift = size * math.sqrt(1.0 + (wide / oblique) ** 2 + (thin_px / wide) ** 2) * normals[i]
        else:
            x, y = strays[i - len(found), 0], strays[i - len(found), 1]
            wide, shift, bend = 1.5, 0.0, 0.0
        if _inside_sector(math.atan2(y, x), sectors):
            continue
        u, v = pixel_from_ground(x, y, camera[0], camera[1], camera[2])
        du, dv = u - camera[0][0], v - camera[0][1]
        radius = math.sqrt(du * du + dv * dv)
        if not radius > 1.0:
            continue
        if on_ray:
            shift += frame + 0.5 * spread * spread * bend
            u += shift * du / radius
            v += shift * dv / radius
        else:
            u -= shift * dv / radius
            v += shift * du / radius
        x, y = ground_from_pixel(u, v, camera[0], camera[1], camera[2])
        if math.isnan(x):
            continue
        du, dv = u - camera[0][0], v - camera[0][1]
        distance = math.sqrt(x * x + y * y)
        outwards, across = scale_at(distance, scales) ** 2, distance * distance / (du * du + dv * dv)
        cx, cy = x / distance, y / distance
        row = out[kept]
        lean = (x * pitch - y * roll) / height
        row[0], row[1] = x + height * pitch + x * lean, y - height * roll + y * lean
        row[2] = point_px**2 * (outwards * cx * cx + across * cy * cy) + point_m**2
        row[5] = point_px**2 * (outwards * cy * cy + across * cx * cx) + point_m**2
        row[3] = row[4] = point_px**2 * (outwards - across) * cx * cy
        row[6] = 1.0 - math.exp(-wide / contrast_px)
        row[7], row[8] = u, v
        if not math.isnan(row[2] + row[5]):
            kept += 1
    return kept
