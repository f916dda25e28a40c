"""Where the field's green ends in each direction, so that nothing beyond it is taken for a line."""

import numpy as np
from numba import njit

from touchline.camera import OmniCamera
from touchline.geometry import BoolArray, FloatArray, IntArray
from touchline.perception.colour import GREEN
from touchline.perception.path_samples import BODY, PathSamples
from touchline.perception.profiles import keep

OVEREXPOSED = 250.0  # grey level from which on all channels tell nothing: what lies under direct sun may be carpet
_BESIDE = 3  # rays on each side that may vouch for a point: a ray along a line sees no green itself


def gap_lengths(camera: OmniCamera, radii_px: FloatArray, gap_m: float) -> IntArray:
    """How many samples of a ray are `gap_m` on the ground at each of its samples, whose radii (S,) are given; (S,)."""
    slope = np.gradient(np.mean(camera.range_m, axis=0), camera.radius_px)
    metres = np.interp(radii_px, camera.radius_px, slope) * np.diff(radii_px, append=radii_px[-1:] + 1.0)
    return np.ceil(np.clip(gap_m / metres, 6, 80)).astype(np.int64)


@njit(cache=True)
def green_ends(
    starts: IntArray,
    rays: int,
    samples: PathSamples,
    gaps: IntArray,
    radii_px: FloatArray,
    ends: FloatArray,
) -> None:
    """Radius (px) of the last green sample of each full ray before a gap longer than any line, into ends (rays,).

    starts, samples: of the scan lines; the full rays are the paths 0, 2, 4, ... gaps, radii_px: by sample. What is
    overexposed counts neither as green nor as a gap. Each end is then the middle one of three neighbours, so that a rod
    or a stain in one direction does not cut the field.
    """
    single, classes, values = np.empty(rays), samples.classes, samples.values
    for ray in range(rays):
        low, high = starts[2 * ray], starts[2 * ray + 1]
        last, missing = 0, 0
        for k in range(high - low):
            at = np.uint64(low + k)  # unsigned: none can count from the end
            if classes[at] == GREEN:
                last, missing = k, 0
            elif classes[at] != BODY and min(values[0, at], values[1, at], values[2, at]) < OVEREXPOSED:
                missing += 1
                if missing > gaps[min(k, len(gaps) - 1)]:
                    break
        single[ray] = radii_px[last]
    for ray in range(rays):
        a, b, c = single[ray - 1], single[ray], single[(ray + 1) % rays]
        ends[ray] = max(min(a, b), min(max(a, b), c))


@njit(cache=True)
def inside_green(crossings: FloatArray, u0: float, v0: float, ends: FloatArray, margins_px: FloatArray) -> BoolArray:
    """Whether crossings (N, >= 4; columns 2, 3 are u, v) lie within the green's end of one of the rays about them.

    margins_px (N,): how far beyond it each may lie.
    """
    rays = len(ends)
    inside, farthest = np.empty(len(crossings), dtype=np.bool_), np.zeros(rays)
    for ray in range(rays):  # of the rays about a place between this one and the next
        for beside in range(ray - _BESIDE, ray + _BESIDE + 2):
            farthest[ray] = max(farthest[ray], ends[beside % rays])
    for i in range(len(crossings)):
        du, dv = crossings[i, 2] - u0, crossings[i, 3] - v0
        position = np.arctan2(dv, du) / (2.0 * np.pi) * rays
        end = farthest[int(np.floor(position)) % rays]
        inside[i] = np.sqrt(du * du + dv * dv) <= end + margins_px[i]
    return inside


@njit(cache=True)
def keep_within_green(crossings, rays, gaps, center, ends):  # type: ignore[no-untyped-def]
    """Move the crossings (N, COLUMNS) that lie within the green to the front; returns how many there are.

    rays: first samples of the scan lines, how many full rays there are, the samples and their radii; center: u, v;
    gaps, ends: as of `green_ends`.
    """
    (starts, count, samples, radii_px), (u0, v0) = rays, center
    green_ends(starts, count, samples, gaps, radii_px, ends)
    margins_px = 2.0 + 0.5 * crossings[:, 7]  # the middle of a line that the green ends at lies beyond
    return keep(crossings, inside_green(crossings, u0, v0, ends, margins_px))
