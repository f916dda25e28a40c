"""The geometry of one image in compiled loops: pixel <-> undistorted image plane <-> ground.

The plane lies at unit depth before the camera: x to the right, y down, as OpenCV's normalised coordinates. A straight
line of the field is straight in it, and a homography leads from it to the ground, the IMU's learned correction
included, as that is affine. The undistortion is a table, made once per camera (section 4.4's "pre-calculated").
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.camera import GroundView, PinholeCamera
from touchline.geometry import FloatArray
from touchline.matrices import inverse
from touchline.perception.line_graph.colour_classes import CELL_PX

Numbers = tuple[float, ...]  # no arrays: their references would be counted with every call


class Lens(NamedTuple):
    """pinhole: (4,) fx, fy, cx, cy. distortion: (5,) OpenCV's. table: (R, C, 2) plane coordinates of the pixels whose u
    and v are multiples of 8; NaN where the distortion is not trusted.
    """

    pinhole: Numbers
    distortion: Numbers
    table: FloatArray


class ImagePlane(NamedTuple):
    """lens: of the camera. ground: (9,) rows of ground from plane, homogeneous, the last one positive below the
    horizon. plane: (9,) of its inverse. size: (2,) width and height of the image (px).
    foot: (2,) the ground point below the camera (m). height: of the camera above it, in the scale of `ground`.
    """

    lens: Lens
    ground: Numbers
    plane: Numbers
    size: Numbers
    foot: Numbers
    height: float


def make_lens(camera: PinholeCamera) -> Lens:
    """The part that is the same for all images of a camera."""
    rows, columns = camera.height // CELL_PX + 2, camera.width // CELL_PX + 2
    v, u = np.mgrid[0:rows, 0:columns] * float(CELL_PX)
    plane = camera.undistorted(np.column_stack((u.ravel(), v.ravel())))
    pinhole = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    table = ((plane - pinhole[2:]) / pinhole[:2]).reshape(rows, columns, 2)
    return Lens(_numbers(pinhole), _numbers(camera.distortion), np.ascontiguousarray(table))


def _numbers(array: FloatArray) -> Numbers:
    return tuple(np.ravel(array).astype(np.float64).tolist())


def image_plane(lens: Lens, view: GroundView) -> ImagePlane:
    """The geometry of an image of a perspective camera."""
    pose = view.pose
    rotation, at = pose.rotation, pose.translation_m
    (x, y, z), rays = at.tolist(), [(-left, -up, ahead) for ahead, left, up in rotation.tolist()]  # of (x, y, 1)
    ground = np.array([
        [z * rays[0][k] - x * rays[2][k] for k in range(3)],
        [z * rays[1][k] - y * rays[2][k] for k in range(3)],
        [-rays[2][k] for k in range(3)],
    ])  # fmt: skip
    fx, fy, cx, cy = lens.pinhole
    if view.correction is not None:
        pixels = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        ground = ground @ np.linalg.solve(pixels, view.correction.homography(view.roll_rad, view.pitch_rad) @ pixels)
    size, h = (float(view.camera.width), float(view.camera.height)), _numbers(ground)
    height = math.sqrt(sum((h[k] - x * h[6 + k]) ** 2 for k in range(3)))
    return ImagePlane(lens, h, _numbers(inverse(ground)), size, (x, y), height)


@njit(cache=True, error_model="numpy")
def plane_from_pixel(lens: Lens, u: float, v: float) -> tuple[float, float]:
    """Plane coordinates of a pixel, bilinear in the lens's table; beyond its rim extrapolated."""
    rows, columns = lens.table.shape[0], lens.table.shape[1]
    column = min(max(math.floor(u / CELL_PX), 0), columns - 2)
    row = min(max(math.floor(v / CELL_PX), 0), rows - 2)
    a, b = u / CELL_PX - column, v / CELL_PX - row
    t = lens.table
    x = (1.0 - b) * ((1.0 - a) * t[row, column, 0] + a * t[row, column + 1, 0]) + b * (
        (1.0 - a) * t[row + 1, column, 0] + a * t[row + 1, column + 1, 0]
    )
    y = (1.0 - b) * ((1.0 - a) * t[row, column, 1] + a * t[row, column + 1, 1]) + b * (
        (1.0 - a) * t[row + 1, column, 1] + a * t[row + 1, column + 1, 1]
    )
    return x, y


@njit(cache=True, error_model="numpy")
def pixel_from_plane(lens: Lens, x: float, y: float) -> tuple[float, float]:
    """Where the lens shows a place of the plane."""
    d, p = lens.distortion, lens.pinhole
    r2 = x * x + y * y
    radial = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
    u = x * radial + 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x)
    v = y * radial + d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y
    return p[0] * u + p[2], p[1] * v + p[3]


@njit(cache=True, error_model="numpy")
def transformed(h: Numbers, x: float, y: float) -> tuple[float, float]:
    """A homography (9,) of a point; NaN beyond the horizon."""
    w = h[6] * x + h[7] * y + h[8]
    if w <= 1e-9:
        return np.nan, np.nan
    return (h[0] * x + h[1] * y + h[2]) / w, (h[3] * x + h[4] * y + h[5]) / w


@njit(cache=True, error_model="numpy")
def ground_from_pixel(plane: ImagePlane, u: float, v: float) -> tuple[float, float]:
    """Ground point (m, robot frame) of a pixel; NaN above the horizon."""
    x, y = plane_from_pixel(plane.lens, u, v)
    return transformed(plane.ground, x, y)


@njit(cache=True, error_model="numpy")
def pixel_from_ground(plane: ImagePlane, x: float, y: float) -> tuple[float, float]:
    """Pixel of a ground point (m, robot frame); NaN behind the camera."""
    a, b = transformed(plane.plane, x, y)
    return pixel_from_plane(plane.lens, a, b)


@njit(cache=True, error_model="numpy")
def planes_from_pixels(plane: ImagePlane, pixels: FloatArray) -> FloatArray:
    """`plane_from_pixel` of pixels (N, 2), as (N, 2)."""
    points = np.empty((len(pixels), 2))
    for i in range(len(pixels)):
        points[i, 0], points[i, 1] = plane_from_pixel(plane.lens, pixels[i, 0], pixels[i, 1])
    return points


@njit(cache=True, error_model="numpy")
def grounds_from_pixels(plane: ImagePlane, pixels: FloatArray) -> FloatArray:
    """`ground_from_pixel` of pixels (N, 2), as (N, 2)."""
    points = np.empty((len(pixels), 2))
    for i in range(len(pixels)):
        points[i, 0], points[i, 1] = ground_from_pixel(plane, pixels[i, 0], pixels[i, 1])
    return points


@njit(cache=True, error_model="numpy")
def ground_ranges(plane: ImagePlane, ranges_m: FloatArray) -> None:
    """Ranges (m) of what all pixels see, into ranges_m (H, W); NaN above the horizon."""
    for v in range(ranges_m.shape[0]):
        for u in range(ranges_m.shape[1]):
            x, y = ground_from_pixel(plane, float(u), float(v))
            ranges_m[v, u] = math.sqrt(x * x + y * y)


@njit(cache=True, error_model="numpy")
def pixels_from_grounds(plane: ImagePlane, points: FloatArray) -> FloatArray:
    """`pixel_from_ground` of ground points (N, 2), as (N, 2)."""
    pixels = np.empty((len(points), 2))
    for i in range(len(points)):
        pixels[i, 0], pixels[i, 1] = pixel_from_ground(plane, points[i, 0], points[i, 1])
    return pixels


@njit(cache=True, error_model="numpy")
def ground_covariances(plane: ImagePlane, pixels: FloatArray, noise_px: float, noise_m: float) -> FloatArray:
    """(N, 2, 2) covariances (m²) of the ground points of pixels (N, 2): noise of the pixel and of the ground."""
    ground, covariances = np.empty((len(pixels), 2)), np.empty((len(pixels), 2, 2))
    measure_grounds(plane, pixels, noise_px, noise_m, ground, covariances)
    return covariances


@njit(cache=True, error_model="numpy")
def measure_grounds(plane, pixels, noise_px, noise_m, ground, covariances):  # type: ignore[no-untyped-def]
    """Ground points of pixels (N, 2), into ground (N, 2), and `ground_covariances`, into covariances (N, 2, 2)."""
    for i in range(len(pixels)):
        u, v = pixels[i, 0], pixels[i, 1]
        x, y = ground_from_pixel(plane, u, v)
        ux, uy = ground_from_pixel(plane, u + 0.5, v)
        vx, vy = ground_from_pixel(plane, u, v + 0.5)  # downwards: never above the horizon
        a, b, c, d = 2.0 * (ux - x), 2.0 * (vx - x), 2.0 * (uy - y), 2.0 * (vy - y)
        ground[i, 0], ground[i, 1] = x, y
        covariances[i, 0, 0] = noise_px**2 * (a * a + b * b) + noise_m**2
        covariances[i, 1, 1] = noise_px**2 * (c * c + d * d) + noise_m**2
        covariances[i, 0, 1] = covariances[i, 1, 0] = noise_px**2 * (a * c + b * d)


@njit(cache=True, error_model="numpy")
def horizon_rows(plane: ImagePlane, columns: int, rows: int, out: FloatArray) -> None:
    """The highest row of cells in each column that sees ground, into out (columns,)."""
    for column in range(columns):
        out[column] = rows
        for row in range(rows):
            u, v = CELL_PX * column + 0.5 * (CELL_PX - 1), CELL_PX * row + 0.5 * (CELL_PX - 1)
            if not math.isnan(ground_from_pixel(plane, u, v)[0]):
                out[column] = row
                break
