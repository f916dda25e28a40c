"""Where to look: the pixel paths along which lines are searched.

Radial scan lines (the papers' 72) cross whatever runs around the robot; circles cross whatever points at it. Between
the radial scan lines shorter ones fill the outer part of the image, where neighbours have drifted apart.
"""

from dataclasses import dataclass

import numpy as np

from touchline.camera import OmniCamera
from touchline.errors import InputError
from touchline.geometry import BoolArray, Float32Array, FloatArray, Int32Array, IntArray, runs_of

FILL_FROM = 0.5  # share of the outer radius from which short rays stand between the others
_MAX_SAMPLES = 10_000_000
_CIRCLE_OVERLAP = 60  # samples by which a circle goes on past its start so that a line lying there is seen whole
_SAMPLES_A_LINE = 3.5  # that tell both of its edges
CACHE_LINE = 64  # bytes
MAX_STEP_PX = 1.5  # farther apart, what is far thinner than a line looks as wide as one


@dataclass(frozen=True, eq=False)
class ScanLines:
    """Paths of samples, one pixel apart or up to one and a half.

    samples: (N, 2) u, v of all paths, one after the other. starts: (P + 1,) first sample of each path.
    closed: (P,) number of samples after which a path repeats itself, 0 for an open one.
    corners: (N,) index of the sample's upper left pixel's first channel in an image laid flat; shares: (2, N) how far
    the sample is on its way to the next pixel in u and v. Both for bilinear look-up.
    touched: (T,) indices in that image, in order, one in each line of the processor's cache that the samples' pixels
    lie in. radii_px: (R,) of the samples of a full ray.
    """

    samples: FloatArray
    starts: IntArray
    closed: IntArray
    corners: Int32Array
    shares: Float32Array
    touched: Int32Array
    radii_px: FloatArray

    def at_samples(self, picture: BoolArray) -> BoolArray:
        """Values (N,) of a picture (H, W) at the samples' upper left pixels."""
        return picture.reshape(-1)[self.corners // 3]


def build_scan_lines(
    camera: OmniCamera,
    radial: int,
    circles: int,
    inner_px: float,
    outer_px: float,
    fill_from: float = FILL_FROM,
    line_width_m: float = 0.0,
) -> ScanLines:
    """`radial` rays from `inner_px` to `outer_px`, as many short ones between them that start at `fill_from` of the
    outer radius, and `circles` circles at equal distances in the image. All stay two pixels inside the image. Where a
    line so wide takes many pixels, samples stand farther apart than one.
    Raises InputError for more than 10⁷ samples.
    """
    count = 2.0 * radial * (outer_px - inner_px) + circles * (np.pi * (inner_px + outer_px) + _CIRCLE_OVERLAP)
    if count > _MAX_SAMPLES:
        raise InputError(
            f"{radial} radial scan lines and {circles} circles up to {outer_px:g} px have {count:.2g} samples; "
            f"{_MAX_SAMPLES} are the most"
        )
    u0, v0 = camera.center
    range_m = camera.range_m.mean(axis=0)
    m_px = np.gradient(range_m, camera.radius_px)

    def step_px(metres_px: float) -> float:
        if not metres_px > 0.0:  # NaN, too: of a table that tells nothing there
            return 1.0
        return min(max(line_width_m / (_SAMPLES_A_LINE * metres_px), 1.0), MAX_STEP_PX)

    ray_px = [inner_px]
    while ray_px[-1] < outer_px:
        ray_px.append(ray_px[-1] + step_px(float(np.interp(ray_px[-1], camera.radius_px, m_px))))
    radii_px = np.array(ray_px[:-1] or ray_px)
    paths: list[FloatArray] = []
    closed: list[int] = []
    for index in range(2 * radial):
        angle = np.pi * index / radial
        first = inner_px if index % 2 == 0 else max(inner_px, fill_from * outer_px)
        radii = radii_px[radii_px >= first]
        paths.append(np.column_stack((u0 + radii * np.cos(angle), v0 + radii * np.sin(angle))))
        closed.append(0)
    for radius in np.linspace(inner_px, outer_px, circles + 2)[1:-1]:
        count = round(2.0 * np.pi * radius / step_px(float(np.interp(radius, camera.radius_px, range_m)) / radius))
        angles = 2.0 * np.pi / count * np.arange(count + _CIRCLE_OVERLAP)
        paths.append(np.column_stack((u0 + radius * np.cos(angles), v0 + radius * np.sin(angles))))
        closed.append(count)
    pieces = [piece for path, count in zip(paths, closed, strict=True) for piece in _inside(path, count, camera)]
    starts = np.concatenate(([0], np.cumsum([len(path) for path, _ in pieces]))).astype(np.int64)
    lengths = np.array([count for _, count in pieces], dtype=np.int64)
    samples = np.concatenate([path for path, _ in pieces])
    whole = np.floor(samples)
    corners = (3 * (whole[:, 1] * camera.width + whole[:, 0])).astype(np.int32)
    shares = np.ascontiguousarray((samples - whole).T, np.float32)
    rows = np.concatenate((corners, corners + 3 * camera.width))
    touched = CACHE_LINE * np.unique(np.concatenate((rows, rows + 5)) // CACHE_LINE)
    return ScanLines(samples, starts, lengths, corners, shares, touched.astype(np.int32), radii_px)


def usable_radius(camera: OmniCamera, coarsest_px_m: float) -> float:
    """Radius (px) up to which a pixel is no longer on the ground than coarsest_px_m, and the field is seen."""
    steps = np.diff(camera.range_m, axis=1).max(axis=0) / np.diff(camera.radius_px)
    too_coarse = np.nonzero(steps > coarsest_px_m)[0]
    limit = camera.radius_px[too_coarse[0]] if len(too_coarse) else camera.radius_px[-1]
    return float(min(limit, camera.outer_radius_px))


def _inside(path: FloatArray, closed: int, camera: OmniCamera) -> list[tuple[FloatArray, int]]:
    """The path, or what the image's border leaves of it: open pieces. closed: see ScanLines; 0 for an open path."""
    u, v = path.T
    inside = (u >= 2) & (u <= camera.width - 3) & (v >= 2) & (v <= camera.height - 3)
    if inside.all():
        return [(path, closed)]
    if not closed:  # a ray leaves the image once; it stays a path even if nothing is left of it
        return [(path[inside], 0)]
    first = int(np.argmin(inside[:closed]))  # go round once, from where the circle leaves the image
    order = (first + np.arange(closed)) % closed
    path, inside = path[order], inside[order]
    return [(path[low:high], 0) for low, high in runs_of(inside)]
