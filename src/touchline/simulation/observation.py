"""The observation level: line points as perception would deliver them, without an image.

The scan paths of the detector are crossed with the field's paint; then points are missed, shifted along their path and
joined by false ones, with figures fitted to what the detector finds in rendered and recorded images (docs/simulation.md).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from pydantic import Field

from touchline.camera import OmniCamera
from touchline.camera.omni import ground_from_pixel, pixel_from_ground
from touchline.config import Settings
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.perception import LinePointSettings
from touchline.perception.line_points import _usable_radius
from touchline.simulation.crossings import COLUMNS, find_crossings, round_table
from touchline.types import LinePoints, empty_points


class ObservationNoise(Settings):
    """What perception adds to the truth. Pixels are along the scan path that found the point."""

    noise_px: float = Field(0.09, ge=0, description="standard deviation of most points")
    wild_share: float = Field(0.12, ge=0, le=1, description="share of points with the larger deviation")
    wild_px: float = Field(0.30, ge=0, description="standard deviation of those")
    oblique_px: float = Field(10.0, gt=0, description="length of a crossing at which the deviation has grown by 1.4")
    outward_px: float = Field(0.03, description="mean shift of points on rays away from the robot")
    frame_px: float = Field(0.012, ge=0, description="deviation that all points on rays of an image share")
    found_share: float = Field(0.96, ge=0, le=1, description="share of wide lines that are found on rays")
    circle_share: float = Field(0.75, ge=0, le=1, description="share of wide lines that are found on circles")
    half_width_px: float = Field(0.9, gt=0, description="width of a line that is found half as often")
    width_slope_px: float = Field(0.22, gt=0, description="how fast that changes with the width (logistic)")
    false_points: float = Field(2.0, ge=0, description="mean number of points per image that are on no line")
    lean_noise_rad: float = Field(0.0, ge=0, description="error of roll and of pitch that all points of an image share")
    height_m: float = Field(0.6, gt=0, description="height of the viewpoint, for errors of the lean")


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
        self._rays, self._circles = _scan_geometry(camera, self.detector, view_rad)
        s = self.detector
        self._limits = (s.line_width_m or field.line_width, s.steepest_crossing, float(s.flank_px))
        self._paint = (field.segments, round_table(field.circles, field.arcs), field.discs)
        self._carpet = (0.5 * field.length + field.border, 0.5 * field.width + field.border)
        grid = field.distance_map()
        self._grid = (grid.values, float(grid.origin_m[0]), float(grid.origin_m[1]), grid.resolution_m)
        self._lookup = (camera.lookup_constants, camera.bearings_rad, camera.lookup_table)
        self._fixed = np.array([(p.x, p.y, 0.5 * p.diameter) for p in field.posts]).reshape(-1, 3)
        self._unseen = np.array([[view_rad, -view_rad]] if view_rad < math.pi else np.zeros((0, 2)))
        self._found = np.empty((2048, COLUMNS))

    def observe(
        self,
        pose: Pose,
        rng: np.random.Generator,
        robots: FloatArray | None = None,
        black_rad: FloatArray | None = None,
    ) -> LinePoints:
        """Line points seen from a pose in the field.

        robots: (K, 3) x, y (field frame), radius (m) of what hides the ground behind it, beside posts and poles.
        black_rad: (B, 2) directions from, to (base frame, counter-clockwise) in which nothing is seen.
        """
        hiding = self._fixed if robots is None else np.concatenate((self._fixed, robots))
        count = find_crossings(
            (pose.x, pose.y, pose.heading), self._rays, self._circles, self._limits, self._paint, hiding,
            self._carpet, self._grid, self._lookup, self._found,
        )  # fmt: skip
        n = self.noise
        strays = rng.poisson(n.false_points) if n.false_points > 0.0 else 0
        total = count + strays
        if total == 0:
            return empty_points()
        numbers = np.array(
            [
                n.noise_px, n.wild_share, n.wild_px, n.oblique_px, n.outward_px, n.frame_px * rng.standard_normal(),
                n.found_share, n.circle_share, n.half_width_px, n.width_slope_px, self.detector.noise_px,
                self.detector.noise_m, *(n.lean_noise_rad * rng.standard_normal(2)), n.height_m,
            ]
        )  # fmt: skip
        sectors = self._unseen if black_rad is None else np.concatenate((self._unseen, black_rad))
        rows = np.empty((total, 9))
        kept = _perturbed(
            self._found[:count], strays, self._rays, len(self._rays), sectors, numbers,
            rng.standard_normal(total), rng.random((total, 2)), self._lookup, rows,
        )  # fmt: skip
        rows = rows[:kept]
        return LinePoints(rows[:, :2], rows[:, 2:6].reshape(-1, 2, 2), rows[:, 6], rows[:, 7:9])


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
    """The detector's rays (P, 3): bearing (rad), nearest, farthest range (m), and circles (Q, 2): range (m), radius (px).

    Where the camera's table depends on the direction, a circle of the image is taken for one on the ground.
    """
    inner, outer = camera.inner_radius_px, _usable_radius(camera, s.coarsest_px_m)
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


@njit(cache=True)
def _inside_sector(bearing, sectors):  # type: ignore[no-untyped-def]
    for i in range(len(sectors)):
        if (bearing - sectors[i, 0]) % (2.0 * math.pi) <= (sectors[i, 1] - sectors[i, 0]) % (2.0 * math.pi):
            return True
    return False


@njit(cache=True)
def _perturbed(found, strays, rays, first_circle, sectors, numbers, normals, uniforms, camera, out):  # type: ignore[no-untyped-def]
    """Points that are found, shifted, into out (N, 9): x, y, covariance (4), confidence, u, v; returns how many.

    found (M, COLUMNS) of `find_crossings`; strays: number of false points, anywhere on rays (P, 3). numbers: those of
    `ObservedLines.observe`. normals (N,) and uniforms (N, 2) bring the chance. camera: as there.
    """
    noise, wild_share, wild, oblique, outward, frame, ray_share, circle_share = numbers[:8]
    half_width, slope, point_px, point_m, roll, pitch, height = numbers[8:]
    kept = 0
    for i in range(len(found) + strays):
        on_ray = True
        if i < len(found):
            x, y, path, chord, scale = found[i, 0], found[i, 1], found[i, 2], found[i, 3], found[i, 4]
            on_ray = path < first_circle
            wide = chord / scale
            share = (ray_share if on_ray else circle_share) / (1.0 + math.exp((half_width - wide) / slope))
            if uniforms[i, 0] >= share:
                continue
            size = wild if uniforms[i, 1] < wild_share else noise
            shift = size * math.sqrt(1.0 + (wide / oblique) ** 2) * normals[i]
        else:
            ray = int(uniforms[i, 0] * len(rays))
            reach = rays[ray, 1] + uniforms[i, 1] * (rays[ray, 2] - rays[ray, 1])
            x, y = reach * math.cos(rays[ray, 0]), reach * math.sin(rays[ray, 0])
            wide, shift = 2.0, 0.0
        if _inside_sector(math.atan2(y, x), sectors):
            continue
        u, v = pixel_from_ground(x, y, camera[0], camera[1], camera[2])
        du, dv = u - camera[0][0], v - camera[0][1]
        radius = math.sqrt(du * du + dv * dv)
        if not radius > 1.0:
            continue
        if on_ray:
            u += (shift + outward + frame) * du / radius
            v += (shift + outward + frame) * dv / radius
        else:
            u -= shift * dv / radius
            v += shift * du / radius
        x, y = ground_from_pixel(u, v, camera[0], camera[1], camera[2])
        if math.isnan(x):
            continue
        ax, ay = ground_from_pixel(u + 0.5, v, camera[0], camera[1], camera[2])
        bx, by = ground_from_pixel(u - 0.5, v, camera[0], camera[1], camera[2])
        cx, cy = ground_from_pixel(u, v + 0.5, camera[0], camera[1], camera[2])
        dx, dy = ground_from_pixel(u, v - 0.5, camera[0], camera[1], camera[2])
        a, b, c, d = ax - bx, cx - dx, ay - by, cy - dy
        row = out[kept]
        lean = (x * pitch - y * roll) / height
        row[0], row[1] = x + height * pitch + x * lean, y - height * roll + y * lean
        row[2], row[5] = point_px**2 * (a * a + b * b) + point_m**2, point_px**2 * (c * c + d * d) + point_m**2
        row[3] = row[4] = point_px**2 * (a * c + b * d)
        row[6] = min(1.0, 0.32 + 0.22 * wide)
        row[7], row[8] = u, v
        if not math.isnan(row[2] + row[5]):
            kept += 1
    return kept
