"""The omnidirectional mirror camera: pixel <-> ground through a range table (docs/how-to-recording.md).

A pixel's direction about the mirror's centre gives the bearing, its radius the ground range: from one table for all
directions, or from one row for each of several bearings (a mirror as built, calibrated model-free). Between the table's
radii the range follows a monotone cubic, between bearings it is linear and periodic. A mirror that leans turns
bearings, too: a second table of the same rows may tell by how much.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.camera.base import Camera, ground_jacobian, ground_of_rays, pixel_covariances
from touchline.camera.reading import (
    check_inner_keys,
    check_keys,
    naming_lines,
    read_image_size,
    read_number,
    read_numbers,
    read_pixels,
    read_switch,
)
from touchline.camera.uncertainty import CameraUncertainty, read_uncertainty, usual_uncertainty
from touchline.errors import InputError
from touchline.geometry import BoolArray, FloatArray, Pose3
from touchline.messages import shown

_KEYS = ("width", "height", "center", "inner_radius_px", "outer_radius_px", "handedness", "mount_yaw", "range_table")
_OPTIONAL = ("viewpoint_height_m", "use_attitude", "uncertainty")
_TABLE_KEYS = ("radius_px", "range_m", "bearing_rad", "bearing_offset_rad")
_MAX_TABLE_MB = 500
_INVERSE_STEPS = 6
_MAX_OFFSET_RAD = 0.2  # a mirror that leans by 5°
_STEP_PX = 0.125  # spacing of the resampled table: fine enough that linear look-up adds < 0.1 mm below 8 m


@dataclass(frozen=True, eq=False)
class OmniCamera:
    """A camera that looks up at a convex mirror.

    bearing = mount_yaw_rad + handedness * atan2(v - v0, u - u0), in the base frame; the range comes from the table.
    radius_px: (R,) the table's radii; bearings_rad: (B,) ascending in [0, 2 pi), B = 1 when the table holds for all
    directions; range_m: (B, R) ground range from the base origin; bearing_offset_rad: (B, R) what the true bearing is
    more than the formula's, none for a mirror that turns none. Rows belong to the formula's bearings.
    viewpoint_height_m: where the rays that the mirror collects would meet, above the base origin; without it the
    camera has no rays, only ground points. use_attitude: whether the IMU's roll and pitch are used; usually it errs
    more than a wheeled robot leans. stated_uncertainty: how sure the tables are; None where nobody has said so.
    """

    width: int
    height: int
    center: tuple[float, float]
    inner_radius_px: float
    outer_radius_px: float
    handedness: int
    mount_yaw_rad: float
    radius_px: FloatArray
    bearings_rad: FloatArray
    range_m: FloatArray
    bearing_offset_rad: FloatArray | None = None
    viewpoint_height_m: float | None = None
    use_attitude: bool = False
    stated_uncertainty: CameraUncertainty | None = None
    # for the compiled loops: ranges (1, B, F) at uniform steps, with bearing offsets below them (2, B, F);
    # u0, v0, handedness, yaw, first radius, step, last radius, cosine and sine of the yaw
    lookup_table: FloatArray = field(init=False, repr=False)
    lookup_constants: FloatArray = field(init=False, repr=False)
    model: ClassVar[str] = "omni"

    def __post_init__(self) -> None:
        radii, ranges, yaw = self.radius_px, self.range_m, self.mount_yaw_rad
        if ranges.shape != (len(self.bearings_rad), len(radii)):
            raise ValueError(
                f"range table: {ranges.shape} ranges for {len(self.bearings_rad)} bearings, {len(radii)} radii"
            )
        offsets = self.bearing_offset_rad
        if offsets is not None and offsets.shape != ranges.shape:
            raise ValueError(f"range table: {offsets.shape} bearing offsets for {ranges.shape} ranges")
        fine = np.minimum(np.arange(radii[0], radii[-1] + 0.5 * _STEP_PX, _STEP_PX), radii[-1])
        layers = [[_monotone_cubic(radii, row, fine) for row in ranges]]
        if offsets is not None:
            layers.append([np.interp(fine, radii, row) for row in offsets])
        object.__setattr__(self, "lookup_table", np.array(layers, dtype=np.float64))
        object.__setattr__(
            self,
            "lookup_constants",
            np.array([*self.center, self.handedness, yaw, radii[0], _STEP_PX, radii[-1], np.cos(yaw), np.sin(yaw)]),
        )

    @classmethod
    def from_mapping(cls, tree: dict[str, Any], path: Path) -> "OmniCamera":
        """A camera from the content of a camera.yaml; `path` is named in errors."""
        with naming_lines(path):
            return _from_mapping(tree, path)

    @property
    def uncertainty(self) -> CameraUncertainty:
        """How sure the tables are: as stated, or as usual."""
        return self.stated_uncertainty or usual_uncertainty(self.outer_radius_px)

    @property
    def base_from_camera(self) -> Pose3:
        """The viewpoint above the base origin, axes as the base frame's. InputError if its height is not known."""
        if self.viewpoint_height_m is None:
            raise InputError(
                "an omnidirectional camera needs 'viewpoint_height_m' in camera.yaml for rays and attitude"
            )
        return Pose3(np.eye(3), np.array([0.0, 0.0, self.viewpoint_height_m]))

    def ray(self, pixels: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Unit vectors (N, 3) of what pixels (N, 2) see, in the base frame, from the viewpoint on.

        NaN outside the table. Raises InputError without `viewpoint_height_m`.
        """
        still = self.base_from_camera
        ground = self.ground_from_image(pixels)
        rays = np.column_stack((ground, np.full(len(ground), -still.translation_m[2])))
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return rays if base_from_camera is None else rays @ base_from_camera.rotation.T

    def ground_from_image(self, pixels: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Ground points (N, 2) in the base frame (m) of pixels (N, 2) u, v; NaN outside the table's radii.

        With a pose of the camera: InputError without `viewpoint_height_m`, NaN at and above the horizon.
        """
        if base_from_camera is not None:
            return ground_of_rays(base_from_camera.translation_m, self.ray(pixels, base_from_camera))
        uv = np.ascontiguousarray(np.asarray(pixels, dtype=np.float64).reshape(-1, 2))
        return ground_from_pixels(uv, self.lookup_constants, self.bearings_rad, self.lookup_table)

    def image_from_ground(self, points: npt.ArrayLike, base_from_camera: Pose3 | None = None) -> FloatArray:
        """Pixels (N, 2) u, v of ground points (N, 2) in the base frame (m); NaN outside the table's ranges.

        With a pose of the camera: InputError without `viewpoint_height_m`.
        """
        xy: FloatArray = np.ascontiguousarray(np.asarray(points, dtype=np.float64).reshape(-1, 2))
        if base_from_camera is not None:
            xy = np.ascontiguousarray(self._ground_if_upright(xy, base_from_camera))
        return pixels_from_ground(xy, self.lookup_constants, self.bearings_rad, self.lookup_table)

    def ground_covariances(
        self, pixels: npt.ArrayLike, noise_px: float, noise_m: float, base_from_camera: Pose3 | None = None
    ) -> FloatArray:
        """(N, 2, 2) covariances (m²) of ground points: the pixels' noise through the mirror, and the ground's own."""
        if base_from_camera is None:
            uv = np.ascontiguousarray(np.asarray(pixels, dtype=np.float64).reshape(-1, 2))
            tables = (self.lookup_constants, self.bearings_rad, self.lookup_table)
            return covariances_of_pixels(uv, (float(noise_px) ** 2, float(noise_m) ** 2), *tables)
        jacobians = ground_jacobian(lambda uv: self.ground_from_image(uv, base_from_camera), pixels)
        return pixel_covariances(jacobians, noise_px, noise_m)

    def sees(self, pixels: FloatArray) -> BoolArray:
        """Whether pixels (N, 2) lie between the inner and the outer radius; False for NaN."""
        radius = np.hypot(pixels[:, 0] - self.center[0], pixels[:, 1] - self.center[1])
        return (radius >= self.inner_radius_px) & (radius <= self.outer_radius_px)

    def _ground_if_upright(self, points: FloatArray, base_from_camera: Pose3) -> FloatArray:
        """The ground points (N, 2) that an upright camera would see in the directions of ground points (N, 2)."""
        height = float(self.base_from_camera.translation_m[2])
        seen = base_from_camera.inverse().transform(np.column_stack((points, np.zeros(len(points)))))
        depth = np.where(seen[:, 2] < 0.0, -seen[:, 2], np.nan)
        return seen[:, :2] * (height / depth)[:, np.newaxis]


def require_omni(camera: Camera, purpose: str) -> OmniCamera:
    """The camera, if it looks at a mirror; else InputError: `purpose` an omnidirectional camera, and what there is.

    purpose: what needs it, up to the word before: "nubot-mti finds line points in images of".
    """
    if isinstance(camera, OmniCamera):
        return camera
    raise InputError(f"{purpose} an omnidirectional camera; this camera is a {camera.model}")


def _from_mapping(tree: dict[str, Any], path: Path) -> OmniCamera:
    check_keys(tree, _KEYS, _OPTIONAL, path, "an omni camera")
    center = read_numbers(tree["center"], path, "center", 1)
    if center.shape != (2,):
        raise InputError(f"{path}: 'center' needs two numbers, u and v")
    if tree["handedness"] not in (1, -1):
        raise InputError(f"{path}: 'handedness' must be 1 or -1, found {shown(tree['handedness'])}")
    for value in center:
        read_pixels(float(value), path, "center")
    inner, outer = (read_pixels(tree[key], path, key) for key in ("inner_radius_px", "outer_radius_px"))
    if not 0.0 <= inner < outer:
        raise InputError(f"{path}: 'inner_radius_px' ({inner:g}) must lie between 0 and 'outer_radius_px' ({outer:g})")
    width, height = read_image_size(tree, path)
    viewpoint_height_m = None
    if tree.get("viewpoint_height_m") is not None:
        viewpoint_height_m = read_number(tree["viewpoint_height_m"], path, "viewpoint_height_m")
        if not viewpoint_height_m > 0.0:
            raise InputError(f"{path}: 'viewpoint_height_m' must be positive (m), found {viewpoint_height_m:g}")
    use_attitude = read_switch(tree, "use_attitude", False, path)
    if use_attitude and viewpoint_height_m is None:
        raise InputError(f"{path}: 'use_attitude: true' needs 'viewpoint_height_m', the viewpoint's height (m)")
    radii, bearings, ranges, offsets = _range_table(tree["range_table"], path)
    return OmniCamera(
        width,
        height,
        (float(center[0]), float(center[1])),
        inner,
        outer,
        int(tree["handedness"]),
        read_number(tree["mount_yaw"], path, "mount_yaw"),
        radii,
        bearings,
        ranges,
        offsets,
        viewpoint_height_m,
        use_attitude,
        read_uncertainty(tree, outer, path),
    )


def _range_table(table: Any, path: Path) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray | None]:
    if not isinstance(table, dict) or "radius_px" not in table or "range_m" not in table:
        raise InputError(f"{path}: 'range_table' needs 'radius_px' and 'range_m' (and 'bearing_rad' if per direction)")
    check_inner_keys(table, _TABLE_KEYS, path, "range_table")
    radii = read_numbers(table["radius_px"], path, "range_table.radius_px", 1)
    read_pixels(float(np.abs(radii).max()), path, "range_table.radius_px")
    if "bearing_rad" in table:
        bearings = np.mod(read_numbers(table["bearing_rad"], path, "range_table.bearing_rad", 1), 2.0 * np.pi)
        ranges = read_numbers(table["range_m"], path, "range_table.range_m", 2)
        if len(bearings) != len(ranges):
            raise InputError(f"{path}: 'range_table' has {len(bearings)} bearings but {len(ranges)} rows of ranges")
        offsets = _offsets(table, ranges.shape, path)
        order = np.argsort(bearings)
        bearings, ranges, offsets = bearings[order], ranges[order], None if offsets is None else offsets[order]
        if np.any(np.diff(bearings) <= 0.0):
            raise InputError(f"{path}: 'range_table.bearing_rad' names a bearing twice")
    else:
        if "bearing_offset_rad" in table:
            raise InputError(f"{path}: 'range_table.bearing_offset_rad' needs 'bearing_rad', the bearings of its rows")
        bearings, offsets = np.zeros(1), None
        ranges = read_numbers(table["range_m"], path, "range_table.range_m", 1)[np.newaxis]
    if len(radii) < 2 or ranges.shape[1] != len(radii):
        raise InputError(
            f"{path}: 'range_table' has {len(radii)} radii but {ranges.shape[1]} ranges (at least two of each)"
        )
    for name, rows in (("radius_px", radii[np.newaxis]), ("range_m", ranges)):
        row, column = np.nonzero(np.diff(rows, axis=1) <= 0.0)
        if len(row):
            raise InputError(f"{path}: 'range_table.{name}' must increase, but entry {column[0] + 2} does not")
    if radii[0] < 0.0 or ranges.min() < 0.0:
        raise InputError(f"{path}: 'range_table' holds a negative radius or range")
    megabytes = 8e-6 * len(bearings) * (radii[-1] - radii[0]) / _STEP_PX * (1 if offsets is None else 2)
    if megabytes > _MAX_TABLE_MB:
        what = f"with {len(bearings)} bearings up to {radii[-1]:g} px it would have {megabytes:.3g} MB"
        raise InputError(f"{path}: 'range_table' is too large: {what}, and {_MAX_TABLE_MB} MB are the most")
    return radii, bearings, ranges, offsets


def _offsets(table: dict[str, Any], shape: tuple[int, ...], path: Path) -> FloatArray | None:
    if "bearing_offset_rad" not in table:
        return None
    key = "range_table.bearing_offset_rad"
    offsets = read_numbers(table["bearing_offset_rad"], path, key, 2)
    if offsets.shape != shape:
        raise InputError(f"{path}: '{key}' must have a row for each bearing with an entry for each radius")
    if np.abs(offsets).max() > _MAX_OFFSET_RAD:
        raise InputError(f"{path}: '{key}' holds {np.abs(offsets).max():g}; offsets are radians, at most 0.2")
    return offsets


def _monotone_cubic(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """Piecewise cubic through (x, y), rising wherever the data do: limited slopes after Fritsch and Carlson."""
    h, secant = np.diff(x), np.diff(y) / np.diff(x)
    slope = np.empty_like(y)
    slope[0], slope[-1] = secant[0], secant[-1]
    left, right = secant[:-1], secant[1:]
    w1, w2 = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    slope[1:-1] = (w1 + w2) / (w1 / left + w2 / right)
    i = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    t = (at - x[i]) / h[i]
    result: FloatArray = (
        y[i] * (1 + 2 * t) * (1 - t) ** 2
        + slope[i] * h[i] * t * (1 - t) ** 2
        + y[i + 1] * t * t * (3 - 2 * t)
        + slope[i + 1] * h[i] * t * t * (t - 1)
    )
    return result


@njit(cache=True)
def bearing_rows(bearing: float, bearings: FloatArray) -> tuple[int, int, float]:
    """The two table rows around a bearing (rad) and the second one's share; periodic; bearings (B,) in [0, 2 pi)."""
    n = len(bearings)
    if n == 1:
        return 0, 0, 0.0
    angle = bearing % (2.0 * np.pi)
    k, end = 0, n
    while k < end:  # by hand: np.searchsorted takes half a second to compile
        middle = (k + end) // 2
        if bearings[middle] <= angle:
            k = middle + 1
        else:
            end = middle
    low, high = (k - 1) % n, k % n
    gap = (bearings[high] - bearings[low]) % (2.0 * np.pi)
    return low, high, ((angle - bearings[low]) % (2.0 * np.pi)) / gap


@njit(cache=True)
def ground_from_pixel(
    u: float, v: float, constants: FloatArray, bearings: FloatArray, table: FloatArray
) -> tuple[float, float]:
    """Ground point (m, base frame) of one pixel; NaN outside. The three arrays are those of an OmniCamera."""
    du, dv = u - constants[0], v - constants[1]
    radius = np.sqrt(du * du + dv * dv)
    if not constants[4] <= radius <= constants[6]:
        return np.nan, np.nan
    cosine, sine = (du / radius, constants[2] * dv / radius) if radius > 0.0 else (1.0, 0.0)
    x, y = constants[7] * cosine - constants[8] * sine, constants[8] * cosine + constants[7] * sine
    rows = (0, 0, 0.0)
    if len(bearings) > 1:
        rows = bearing_rows(constants[3] + constants[2] * np.arctan2(dv, du), bearings)
    position = (radius - constants[4]) / constants[5]
    i = min(int(position), table.shape[2] - 2)
    distance = _between(table, 0, rows, i, position - i)
    if len(table) > 1:
        offset = _between(table, 1, rows, i, position - i)
        cosine, sine = np.cos(offset), np.sin(offset)
        x, y = cosine * x - sine * y, sine * x + cosine * y
    return distance * x, distance * y


@njit(cache=True)
def pixel_from_ground(
    x: float, y: float, constants: FloatArray, bearings: FloatArray, table: FloatArray
) -> tuple[float, float]:
    """Pixel of one ground point (m, base frame); NaN outside the table. The inverse of `ground_from_pixel`."""
    distance, bearing = np.sqrt(x * x + y * y), np.arctan2(y, x)
    seen = bearing  # of the formula; offsets change slowly, so that a few steps are exact
    for step in range(_INVERSE_STEPS if len(table) > 1 else 1):
        rows = bearing_rows(seen, bearings)
        position = _position(distance, table[0], rows)
        if len(table) > 1 and step < _INVERSE_STEPS - 1:
            i = min(int(position), table.shape[2] - 2)
            seen = bearing - _between(table, 1, rows, i, position - i)
    if not _between(table, 0, rows, 0, 0.0) <= distance <= _between(table, 0, rows, table.shape[2] - 2, 1.0):
        return np.nan, np.nan
    radius, angle = constants[4] + constants[5] * position, (seen - constants[3]) * constants[2]
    return constants[0] + radius * np.cos(angle), constants[1] + radius * np.sin(angle)


@njit(cache=True)
def _between(table: FloatArray, layer: int, rows: tuple[int, int, float], i: int, f: float) -> float:
    """A layer's value between two rows (`bearing_rows`) and the columns i and i + 1 (f: its share) of a table."""
    low, high, share = rows
    value: float = (1.0 - share) * (table[layer, low, i] * (1.0 - f) + table[layer, low, i + 1] * f)
    if share > 0.0:
        value += share * (table[layer, high, i] * (1.0 - f) + table[layer, high, i + 1] * f)
    return value


@njit(cache=True)
def _position(distance: float, ranges: FloatArray, rows: tuple[int, int, float]) -> float:
    """At which column (with fraction) of the rows a range is found; the nearest end if it is at none."""
    low, high, share = rows
    first, last = 0, ranges.shape[1] - 1
    while last - first > 1:
        middle = (first + last) // 2
        if (1.0 - share) * ranges[low, middle] + share * ranges[high, middle] <= distance:
            first = middle
        else:
            last = middle
    near = (1.0 - share) * ranges[low, first] + share * ranges[high, first]
    far = (1.0 - share) * ranges[low, last] + share * ranges[high, last]
    return first + min(max((distance - near) / (far - near), 0.0), 1.0)


@njit(cache=True)
def ground_from_pixels(
    pixels: FloatArray, constants: FloatArray, bearings: FloatArray, table: FloatArray
) -> FloatArray:
    """`ground_from_pixel` for pixels (N, 2); returns (N, 2)."""
    points = np.empty((len(pixels), 2))
    for i in range(len(pixels)):
        points[i, 0], points[i, 1] = ground_from_pixel(pixels[i, 0], pixels[i, 1], constants, bearings, table)
    return points


@njit(cache=True)
def _slope(before: float, here: float, after: float) -> float:
    """Derivative from values half a pixel away on both sides, or on the one where there is any."""
    ahead, behind = 2.0 * (after - here), 2.0 * (here - before)
    if np.isnan(ahead):
        return behind
    return ahead if np.isnan(behind) else 0.5 * (ahead + behind)


@njit(cache=True, error_model="numpy")
def shifted_ground(pixels, shift, constants, bearings, table, out):  # type: ignore[no-untyped-def]
    """`ground_from_pixel` of pixels (N, 2), shifted by (u, v), into out (2, N); in a loop that becomes SIMD
    instructions where the mirror is alike all round.
    """
    if len(bearings) > 1 or len(table) > 1:
        for i in range(len(pixels)):
            u, v = pixels[i, 0] + shift[0], pixels[i, 1] + shift[1]
            out[0, i], out[1, i] = ground_from_pixel(u, v, constants, bearings, table)
        return
    c, ranges, xs, ys = constants, table[0, 0], out[0], out[1]
    last = np.int32(len(ranges) - 2)
    for i in range(len(pixels)):
        du, dv = pixels[i, 0] + shift[0] - c[0], pixels[i, 1] + shift[1] - c[1]
        radius = np.sqrt(du * du + dv * dv)
        cosine, sine = (du / radius if radius > 0.0 else 1.0), (c[2] * dv / radius if radius > 0.0 else 0.0)
        position = (radius - c[4]) / c[5]
        k = np.int32(min(max(position, 0.0), float(last)))
        f = position - k
        distance = ranges[k] * (1.0 - f) + ranges[k + 1] * f if c[4] <= radius <= c[6] else np.nan
        xs[i], ys[i] = distance * (c[7] * cosine - c[8] * sine), distance * (c[8] * cosine + c[7] * sine)


@njit(cache=True, error_model="numpy")
def covariances_of_pixels(
    pixels: FloatArray, noise: tuple[float, float], constants: FloatArray, bearings: FloatArray, table: FloatArray
) -> FloatArray:
    """(N, 2, 2) covariances (m²) of the ground points of pixels (N, 2), as `camera.base.pixel_covariances`.

    noise: variances of a pixel (px²) and of the ground (m²).
    """
    noise_px2, noise_m2 = noise
    covariances, grounds = np.empty((len(pixels), 2, 2)), np.empty((5, 2, len(pixels)))
    for k in range(5):
        u, v = ((0.0, 0.0), (-0.5, 0.0), (0.5, 0.0), (0.0, -0.5), (0.0, 0.5))[k]
        shifted_ground(pixels, (u, v), constants, bearings, table, grounds[k])
    here, left, right, up, down = grounds[0], grounds[1], grounds[2], grounds[3], grounds[4]
    for i in range(len(pixels)):
        x_u, y_u = _slope(left[0, i], here[0, i], right[0, i]), _slope(left[1, i], here[1, i], right[1, i])
        x_v, y_v = _slope(up[0, i], here[0, i], down[0, i]), _slope(up[1, i], here[1, i], down[1, i])
        covariances[i, 0, 0] = noise_px2 * (x_u * x_u + x_v * x_v) + noise_m2
        covariances[i, 0, 1] = covariances[i, 1, 0] = noise_px2 * (x_u * y_u + x_v * y_v)
        covariances[i, 1, 1] = noise_px2 * (y_u * y_u + y_v * y_v) + noise_m2
    return covariances


@njit(cache=True)
def pixels_from_ground(
    points: FloatArray, constants: FloatArray, bearings: FloatArray, table: FloatArray
) -> FloatArray:
    """`pixel_from_ground` for points (N, 2); returns (N, 2)."""
    pixels = np.empty((len(points), 2))
    for i in range(len(points)):
        pixels[i, 0], pixels[i, 1] = pixel_from_ground(points[i, 0], points[i, 1], constants, bearings, table)
    return pixels
