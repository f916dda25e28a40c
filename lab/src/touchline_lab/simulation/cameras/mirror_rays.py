"""Rays of a camera through a mirror, exactly: pinhole -> mirror as mounted (tilted, displaced) -> world."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray, tilt_rotation
from touchline_lab.simulation.cameras.mirror import MirrorProfile


@dataclass(frozen=True, slots=True)
class MirrorMount:
    """How a mirror as built differs from its design: turns about the body's x and y through its apex (rad), shift
    (m)."""

    tilt_x: float = 0.0
    tilt_y: float = 0.0
    shift_x: float = 0.0
    shift_y: float = 0.0
    shift_z: float = 0.0

    @property
    def is_ideal(self) -> bool:
        """Whether the mirror sits as designed."""
        return not any((self.tilt_x, self.tilt_y, self.shift_x, self.shift_y, self.shift_z))


def mirror_rays(
    profile: MirrorProfile, mount: MirrorMount, radius_px: npt.ArrayLike, bearing_rad: npt.ArrayLike
) -> FloatArray:
    """Rays (N, 6) in the body frame of pixels at a radius (px) and bearing (rad) (N,): point on the mirror, unit
    direction.

    Newton's method along the camera's ray for the meeting with the mirror, then the law of reflection at its normal
    there. NaN where a ray passes the mirror.
    """
    head = profile.head
    tangent = np.asarray(radius_px, dtype=np.float64) / head.focal_px
    bearing = np.asarray(bearing_rad, dtype=np.float64)
    rays = np.stack((tangent * np.cos(bearing), tangent * np.sin(bearing), np.ones_like(tangent)), axis=-1)
    rotation = tilt_rotation(mount.tilt_x, mount.tilt_y)  # of the mirror in the body
    apex = np.array([mount.shift_x, mount.shift_y, head.apex_m + mount.shift_z])
    origin = -apex @ rotation  # the pinhole in the mirror's frame, whose origin is the apex
    direction = rays @ rotation
    t = np.full(len(rays), head.apex_m)
    outermost = profile.radius_m[-1]
    for _ in range(12):
        point = origin + t[:, np.newaxis] * direction
        radius = np.hypot(point[:, 0], point[:, 1])
        height, slope = profile.surface(np.minimum(radius, outermost))
        outward = (point[:, 0] * direction[:, 0] + point[:, 1] * direction[:, 1]) / np.maximum(radius, 1e-12)
        excess = point[:, 2] - (height - head.apex_m) - slope * np.maximum(radius - outermost, 0.0)
        t = t - excess / (direction[:, 2] - slope * outward)
    point = origin + t[:, np.newaxis] * direction
    radius = np.hypot(point[:, 0], point[:, 1])
    _, slope = profile.surface(radius)
    outwards = point[:, :2] / np.maximum(radius, 1e-12)[:, np.newaxis]
    normal = np.column_stack((slope[:, np.newaxis] * outwards, -np.ones(len(rays))))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    reflected = direction - 2.0 * np.sum(direction * normal, axis=1, keepdims=True) * normal
    points = point @ rotation.T + apex + np.array([0.0, 0.0, head.camera_height_m])
    result: FloatArray = np.hstack((points, reflected @ rotation.T))
    result[np.isnan(slope)] = np.nan
    return result


def ground_of_rays(rays: FloatArray) -> FloatArray:
    """Where rays (N, 6) meet the ground (N, 2), body frame (m); NaN for rays that do not."""
    falling = rays[:, 5] < 0.0
    t = np.where(falling, -rays[:, 2] / np.where(falling, rays[:, 5], 1.0), np.nan)
    return rays[:, :2] + t[:, np.newaxis] * rays[:, 3:5]


def design_range_table(profile: MirrorProfile, farthest_m: float = 180.0) -> tuple[FloatArray, FloatArray]:
    """Pixel radii 0, 1, 2, ... and the ground ranges (m) that the mirror as designed shows there, up to farthest_m."""
    radii = np.arange(0.0, math.floor(profile.head.outer_px) + 1.0)
    ground = ground_of_rays(mirror_rays(profile, MirrorMount(), radii, np.zeros_like(radii)))[:, 0]
    ground[0] = max(float(ground[0]), 0.0)
    good = np.isfinite(ground) & (ground < farthest_m)
    last = len(radii) if good.all() else int(np.argmin(good))
    return radii[:last], ground[:last]
