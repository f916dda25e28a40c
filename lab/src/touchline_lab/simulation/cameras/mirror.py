"""Mirror profiles from the reflection law: which mirror shows the ground as wanted?

A camera's pinhole looks straight up at a mirror of revolution about its axis. R is the distance from the axis, Z the
height above the pinhole. A pixel at radius rho looks along tan(alpha) = rho / focal_px and meets the mirror at R = Z
tan(alpha); there the mirror must send the ray towards a wanted target. The law of reflection gives the slope dZ/dR of
the mirror, and with dR = tan(alpha) dZ + Z d(tan(alpha)) an ordinary differential equation

    dZ/d(rho) = slope Z / (1 - slope tan(alpha)) / focal_px,

solved here with Runge and Kutta's fourth-order steps of an eighth of a pixel. Ready targets: hyperbolic, horizontally
isometric, vertically isometric, and the three from the inside out (lu2013, section 3.1).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from touchline.errors import InputError
from touchline.geometry import FloatArray

# At a pixel radius (px): x, z, w of the point (x / w, z / w) that the reflected ray shall pass, distance from the axis
# and height above the ground in m; w = 0 is a direction, w < 0 a ray that rises above the horizon.
Target = Callable[[float], tuple[float, float, float]]
_STEP_PX = 0.125
_STEEPEST = 50.0


@dataclass(frozen=True)
class MirrorHead:
    """A camera below a mirror: focal length (px), height of the pinhole above the ground and of the mirror's apex above

    the pinhole (m), outermost pixel radius at which there is mirror.
    """

    focal_px: float = 620.0
    camera_height_m: float = 0.69
    apex_m: float = 0.10
    outer_px: float = 231.5

    def __post_init__(self) -> None:
        values = (self.focal_px, self.camera_height_m, self.apex_m, self.outer_px)
        if not all(math.isfinite(value) and value > 0.0 for value in values):
            raise InputError("mirror: focal length, heights and outer radius are positive numbers")


@dataclass(frozen=True, eq=False)
class MirrorProfile:
    """A solved mirror: radius_m, height_m (above the pinhole) and slope dZ/dR (N,), from the axis outwards."""

    head: MirrorHead
    radius_m: FloatArray
    height_m: FloatArray
    slope: FloatArray

    def surface(self, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Height above the pinhole and slope at distances from the axis (any shape), by cubic pieces; NaN outside."""
        i = np.clip(np.searchsorted(self.radius_m, radius, side="right") - 1, 0, len(self.radius_m) - 2)
        h = self.radius_m[i + 1] - self.radius_m[i]
        t = (radius - self.radius_m[i]) / h
        y0, y1, m0, m1 = self.height_m[i], self.height_m[i + 1], self.slope[i] * h, self.slope[i + 1] * h
        a, b = 2.0 * (y0 - y1) + m0 + m1, 3.0 * (y1 - y0) - 2.0 * m0 - m1
        height = y0 + t * (m0 + t * (b + t * a))
        slope = (m0 + t * (2.0 * b + 3.0 * t * a)) / h
        outside = (radius > self.radius_m[-1]) | (radius < 0.0)
        return np.where(outside, np.nan, height), np.where(outside, np.nan, slope)


def solve_mirror(target: Target, head: MirrorHead | None = None) -> MirrorProfile:
    """The profile that shows each pixel radius its target. Raises InputError where no mirror does (with the radius)."""
    head = head or MirrorHead()
    steps = math.ceil(head.outer_px / _STEP_PX)
    radii_px = np.linspace(0.0, head.outer_px, steps + 1)
    heights, slopes = np.empty(steps + 1), np.empty(steps + 1)
    z = head.apex_m
    for n, rho in enumerate(radii_px):
        rate, slope = _rate(target, head, float(rho), z)
        heights[n], slopes[n] = z, slope
        if n == steps:
            break
        h = float(radii_px[n + 1] - rho)
        k2, _ = _rate(target, head, float(rho) + 0.5 * h, z + 0.5 * h * rate)
        k3, _ = _rate(target, head, float(rho) + 0.5 * h, z + 0.5 * h * k2)
        k4, _ = _rate(target, head, float(radii_px[n + 1]), z + h * k3)
        z += h / 6.0 * (rate + 2.0 * k2 + 2.0 * k3 + k4)
    radii = heights * radii_px / head.focal_px
    if np.any(np.diff(radii) <= 0.0):
        at = float(radii_px[int(np.argmax(np.diff(radii) <= 0.0))])
        raise InputError(f"mirror: no profile shows this range: at {at:.1f} px the mirror folds back towards its axis")
    return MirrorProfile(head, radii, heights, slopes)


def _rate(target: Target, head: MirrorHead, rho: float, z: float) -> tuple[float, float]:
    """dZ/d(rho) and the slope dZ/dR at a pixel radius where the mirror is z above the pinhole."""
    x, height, w = target(rho)
    tangent = rho / head.focal_px
    radius = z * tangent
    out_r, out_z = x - w * radius, height - w * (head.camera_height_m + z)
    size = math.hypot(out_r, out_z)
    if not (math.isfinite(size) and size > 0.0 and z > 0.0):
        raise InputError(f"mirror: no profile shows this range: it breaks down at {rho:.1f} px; check the wanted range")
    cosine = 1.0 / math.hypot(1.0, tangent)
    slope = (out_r / size - tangent * cosine) / (cosine - out_z / size)
    if not abs(slope) < _STEEPEST or slope * tangent >= 0.99:
        raise InputError(
            f"mirror: no profile shows this range: at {rho:.1f} px the mirror would stand along the camera's ray; "
            "a smaller range, a longer focal length or a smaller outer radius helps"
        )
    return slope * z / (1.0 - slope * tangent) / head.focal_px, slope


def tangent_range(scale_m: float = 1.57, per_px: float = 0.0071) -> Target:
    """The recorded cameras' range r = scale tan(rho per_px), continued beyond the horizon."""
    return lambda rho: (scale_m * math.sin(per_px * rho), 0.0, math.cos(per_px * rho))


def hyperbolic(head: MirrorHead | None = None, horizon_px: float = 210.0) -> tuple[Target, MirrorHead]:
    """A hyperboloid with the pinhole in its far focus: one viewpoint in the near one. Returns the head with its apex.

    With eccentricity e, rho = horizon sin(theta) / (1 + k cos(theta)) for a ray at theta from straight down,
    k = (e^2 + 1) / (2 e), horizon = focal (e^2 - 1) / (2 e). The apex is kept, so the focus lies 2 e / (e + 1) of it
    high.
    """
    head = head or MirrorHead()
    ratio = horizon_px / head.focal_px
    e = ratio + math.hypot(ratio, 1.0)
    k = (e * e + 1.0) / (2.0 * e)
    focus = head.camera_height_m + 2.0 * head.apex_m * e / (e + 1.0)

    def target(rho: float) -> tuple[float, float, float]:
        theta = math.atan2(rho * k, horizon_px) + math.asin(rho / math.hypot(horizon_px, rho * k))
        return focus * math.sin(theta), 0.0, math.cos(theta)

    return target, head


def horizontally_isometric(metres_per_px: float = 0.045) -> Target:
    """Equal steps in the image are equal steps on the ground."""
    if not (math.isfinite(metres_per_px) and metres_per_px > 0.0):
        raise InputError(f"mirror: {metres_per_px} m of ground per pixel shows no ground")
    return lambda rho: (metres_per_px * rho, 0.0, 1.0)


def vertically_isometric(
    distance_m: float = 5.0, lowest_m: float = -6.0, highest_m: float = 1.0, outer_px: float = 231.5
) -> Target:
    """Equal steps in the image are equal steps of height on an upright wall at a distance around the robot.

    lowest_m: height shown in the middle (below the ground: there the ground in front is seen), highest_m: at outer_px.
    """
    return lambda rho: (distance_m, lowest_m + (highest_m - lowest_m) * rho / outer_px, 1.0)


def combined(
    head: MirrorHead | None = None,
    inner: tuple[float, float] = (95.0, 1.2),
    middle: tuple[float, float] = (178.0, 5.5),
    highest_m: float = 1.0,
) -> Target:
    """The papers' mirror from the inside out: hyperbolic, then horizontally, then vertically isometric (lu2013, 3.1).

    inner, middle: pixel radius and ground range (m) at which the first and the second part end; highest_m: height
    seen at the outer radius on the upright wall that stands where the second part ends.
    """
    head = head or MirrorHead()
    (rho_1, r_1), (rho_2, r_2) = inner, middle
    if not (0.0 < rho_1 < rho_2 < head.outer_px and 0.0 < r_1 < r_2 and highest_m > 0.0):
        raise InputError("mirror: the parts' radii and ranges must grow outwards and end inside the outer radius")
    curve, _ = hyperbolic(head, _horizon_for(head, rho_1, r_1))

    def target(rho: float) -> tuple[float, float, float]:
        if rho <= rho_1:
            return curve(rho)
        if rho <= rho_2:
            return r_1 + (r_2 - r_1) * (rho - rho_1) / (rho_2 - rho_1), 0.0, 1.0
        return r_2, highest_m * (rho - rho_2) / (head.outer_px - rho_2), 1.0

    return target


def _horizon_for(head: MirrorHead, rho: float, range_m: float) -> float:
    """The hyperbola's horizon (px) for which a pixel radius shows a ground range, by bisection."""

    def reached(horizon: float) -> float:
        x, _, w = hyperbolic(head, horizon)[0](rho)
        return x / w if w > 0.0 else math.inf

    low, high = 0.5 * rho, 40.0 * rho
    if not reached(high) < range_m < reached(low):
        raise InputError(f"mirror: no hyperbola shows {range_m:g} m at {rho:g} px with this head")
    for _ in range(80):
        between = 0.5 * (low + high)
        low, high = (between, high) if reached(between) > range_m else (low, between)
    return 0.5 * (low + high)
