"""How perception errs: which crossings it finds, how far off, and what else it takes for a line.

Almost all of a point's error is no noise: the mosaic of 2 x 2 pixels, the scan path and the line meet at some phase,
and meet so again as long as the robot stands or drives along the line. On rendered images of a standing robot errors of
one crossing agree from image to image with a correlation of 0.96, which is lost when it has moved by half a pixel;
those of neighbouring rays agree with 0.5 where both lie alike on the mosaic. So an error is a fixed random function of
where the crossing lies on the mosaic and of the path's direction (for circles: of the place on the path), with a little
fresh noise.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from pydantic import Field

from touchline.camera.omni import ground_from_pixel, pixel_from_ground
from touchline.config import Settings
from touchline.geometry import FloatArray
from touchline_lab.simulation.observation.crossings import GRAZED, MIXED, inside_sector, range_at, scale_at
from touchline_lab.simulation.observation.fixed_noise import mosaic_noise, phase_noise
from touchline_lab.simulation.observation.goal_clutter import GoalClutter
from touchline_lab.simulation.observation.runs import BAR, DISC


class ObservationNoise(Settings):
    """What perception adds to the truth; `lab/benchmarks/fit_observation_level.py` fits it to rendered images.

    Pixels are along the scan path that found the point, unless they are said to be at right angles to the line.
    """

    noise_px: float = Field(0.0856, ge=0, description="standard deviation of an error at right angles to the line")
    tail: float = Field(0.761, gt=0, description="how much heavier than normal its tails are: k of sinh(k z) / k")
    oblique_sine: float = Field(
        0.353, ge=0, description="sine of a crossing in the image at which the deviation has doubled once more"
    )
    thin_px: float = Field(1.37, ge=0, description="width of a line in the image at which it is 1.4 times that")
    kept_ratio: float = Field(0.963, ge=0, le=1, description="share of an error's variance that stays at one place")
    phase_px: float = Field(0.4, gt=0, description="way along the path after which the repeated part is another")
    frame_px: float = Field(0.01, ge=0, description="deviation that all points on rays of an image share")
    found_ratio: float = Field(0.938, ge=0, le=1, description="share of easy crossings of rays that are found")
    circle_ratio: float = Field(0.878, ge=0, le=1, description="share of easy crossings of circles that are found")
    thin_half_px: float = Field(0.289, description="width of a line in the image of which half are found")
    thin_slope_px: float = Field(0.0706, gt=0, description="how fast that changes with the width (logistic)")
    coarse_half_m: float = Field(0.178, gt=0, description="length of a pixel on the ground at which half is found")
    coarse_slope_m: float = Field(0.0016, gt=0, description="how fast that changes with the length (logistic)")
    flat_half: float = Field(0.255, description="sine of a crossing in the image at which half is found")
    flat_slope: float = Field(0.0609, gt=0, description="how fast that changes with the sine (logistic)")
    blur_px: float = Field(2.91, ge=0, description="width (pixels) that blur gives the thinnest line")
    long_slope_px: float = Field(0.646, gt=0, description="how sharp the limit of a line's width is (logistic)")
    bar_ratio: float = Field(0.973, ge=0, le=1, description="share of near crossings of a goal's bar that are found")
    bar_half_m: float = Field(2.38, gt=0, description="range at which half of these are")
    bar_slope_m: float = Field(1.13, gt=0, description="how fast that changes with the range (logistic)")
    mark_ratio: float = Field(0.817, ge=0, le=1, description="share of crossings of round marks that are found")
    grazed_ratio: float = Field(0.734, ge=0, le=1, description="share found on rays along the edge of a black sector")
    grazed_factor: float = Field(3.15, ge=1, description="how much larger errors are there")
    mixed_ratio: float = Field(0.999, ge=0, le=1, description="share found where more than one line lies on the path")
    mixed_factor: float = Field(1.53, ge=1, description="how much larger errors are there")
    bridged_px: float = Field(1.5, ge=0, description="gap between two lines that the detector takes for paint")
    apart_px: float = Field(3.5, ge=0, description="gap between two lines that it needs to find either")
    contrast_px: float = Field(1.0, gt=0, description="width at which blur leaves 63 % of the contrast: the confidence")
    false_points: float = Field(0.367, ge=0, description="mean number of points on no line per image, anywhere in view")
    white_goals: GoalClutter = GoalClutter()
    coloured_goals: GoalClutter = GoalClutter(
        net_points=21.3, net_half_m=1.67, net_slope_m=0.386, side_points=22.1, side_half_m=1.0, side_slope_m=0.593
    )
    covered_goals: GoalClutter = GoalClutter(
        net_points=183.0, net_half_m=1.0, net_slope_m=1.22, side_points=27.8, side_half_m=3.11, side_slope_m=1.3
    )
    lean_noise_rad: float = Field(0.0, ge=0, description="error of roll and of pitch that all points of an image share")
    height_m: float = Field(
        0.8, gt=0, description="height of the view: what hides the ground how far, and how a lean shifts it"
    )

    def numbers(self, point_px: float, point_m: float) -> FloatArray:
        """What `perturbed` takes; point_px, point_m: the deviations that the detector gives its points."""
        return np.array(
            [
                self.noise_px, self.tail, self.oblique_sine, self.kept_ratio, self.phase_px, self.frame_px,
                self.found_ratio, self.circle_ratio, self.thin_half_px, self.thin_slope_px,
                self.coarse_half_m, self.coarse_slope_m, self.flat_half, self.flat_slope, self.bar_ratio,
                self.bar_half_m, self.bar_slope_m, self.mark_ratio, self.grazed_ratio, self.grazed_factor,
                self.mixed_ratio, self.mixed_factor, self.blur_px, self.long_slope_px, self.contrast_px,
                self.lean_noise_rad, self.height_m, point_px, point_m, self.thin_px,
            ]
        )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _logistic(value):  # type: ignore[no-untyped-def]
    return 1.0 / (1.0 + math.exp(-value)) if value < 20.0 else 1.0  # from there on it is, to eight digits


@njit(cache=True, error_model="numpy")
def found_ratio(row, on_ray, reach, numbers):  # type: ignore[no-untyped-def]
    """Share of crossings like this row of `find_crossings` that are found; reach: its range (m)."""
    ray_ratio, circle_ratio, thin_half, thin_slope, coarse_half, coarse_slope, flat_half, flat_slope = numbers[6:14]
    bar_ratio, bar_half, bar_slope, mark_ratio, grazed_ratio = numbers[14:19]
    if row[5] == DISC:
        return mark_ratio * _logistic((coarse_half - row[4]) / coarse_slope)
    share = ray_ratio if on_ray else circle_ratio
    share *= _logistic((row[7] - thin_half) / thin_slope) * _logistic((row[8] - flat_half) / flat_slope)
    if on_ray:
        share *= _logistic((coarse_half - row[4]) / coarse_slope)
    if row[5] == BAR:
        share *= bar_ratio * _logistic((bar_half - reach) / bar_slope)
    seen_px = math.sqrt(row[7] ** 2 + numbers[22] ** 2) - row[7]  # by how much blur widens it
    share *= _logistic((row[11] - seen_px / row[8]) / numbers[23])
    if row[10] == GRAZED:
        share *= grazed_ratio
    return share * numbers[20] if row[10] == MIXED else share


@njit(cache=True, error_model="numpy")
def error_px(row, z, numbers):  # type: ignore[no-untyped-def]
    """Error along the path (pixels) of a row of `find_crossings`; z: its chance, standard normal."""
    noise, tail, oblique = numbers[:3]
    sine = max(row[8], 0.05)
    size = noise / sine * (1.0 + (oblique / sine) ** 4) * math.sqrt(1.0 + (numbers[29] / row[7]) ** 2)
    if row[10] == GRAZED:
        size *= numbers[19]
    elif row[10] == MIXED:
        size *= numbers[21]
    return size * math.sinh(tail * z) / tail


@njit(cache=True, error_model="numpy")
def edge_shift(row, reach, blur_px, scales, read):  # type: ignore[no-untyped-def]
    """How far outwards (pixels) the detector sees the middle of a line on a ray, at a range (m), for its blur.

    It takes the middle, on the ground, of two edges that blur has moved apart in the image: no longer that of the line
    where the mirror's scale grows. row: of `find_crossings`; scales: of `scale_table`; read: the same of the camera
    that both edges are read with, empty if that is as good as the true one. NaN if that camera knows no range there.
    """
    widened = 0.5 * (math.sqrt(row[7] ** 2 + blur_px**2) - row[7]) / row[8]
    half, wider = 0.5 * row[3], widened * row[4]
    far = scale_at(reach + half, scales, 1) + widened
    if len(read) == 0:
        far = range_at(far, scales, reach + half + wider)
        near = range_at(row[6] - widened, scales, reach - half - wider)
        return (0.5 * (near + far) - reach) / row[4]
    if far > read[-1, 1]:
        return np.nan
    far = range_at(far, read, reach + half + wider)
    near = range_at(row[6] - widened, read, reach - half - wider)
    middle = range_at(scale_at(reach, scales, 1), read, reach)
    return (0.5 * (near + far) - middle) / scale_at(middle, read, 0)


class PointErrors(NamedTuple):
    """How a camera and a detector err, the same for all images.

    numbers: of `ObservationNoise.numbers`. first_circle: number of the first scan path that is a circle. seed, mosaic:
    of what stays the same, see `mosaic_table`. camera: constants, bearings, ranges of the OmniCamera's look-up; known:
    of the one that pixels are read with. scales: of `scale_table`; read_scales: of `edge_shift`. askew (R, C, 2): shift
    in pixels of what the camera as built sees; step_px: from node to node.
    """

    numbers: FloatArray
    first_circle: int
    seed: int
    mosaic: FloatArray
    camera: tuple[FloatArray, FloatArray, FloatArray]
    known: tuple[FloatArray, FloatArray, FloatArray]
    scales: FloatArray
    read_scales: FloatArray
    askew: FloatArray
    step_px: float


@njit(cache=True, error_model="numpy")
def perturbed(found, strays, sectors, errors, shared, normals, out):  # type: ignore[no-untyped-def]
    """Points that are found, shifted, into out (N, 9): x, y, covariance (4), confidence, u, v; returns how many.

    found (M, COLUMNS) of `find_crossings`; strays (K, 2): places of false points (m, base frame). sectors (B, 2): black
    directions. shared (3,) and normals (N, 2): this image's chance, standard normal.
    """
    numbers, camera, known, scales = errors.numbers, errors.camera, errors.known, errors.scales
    frame, kept_ratio, phase = numbers[5] * shared[0], numbers[3], numbers[4]
    seed, mosaic = errors.seed, errors.mosaic
    again, anew = math.sqrt(kept_ratio), math.sqrt(1.0 - kept_ratio)
    kept = 0
    for i in range(len(found) + len(strays)):
        on_ray, wide, shift = True, 1.5, 0.0
        x, y = (found[i, 0], found[i, 1]) if i < len(found) else (strays[i - len(found), 0], strays[i - len(found), 1])
        u, v = pixel_from_ground(x, y, camera[0], camera[1], camera[2])
        du, dv = u - camera[0][0], v - camera[0][1]
        radius = math.sqrt(du * du + dv * dv)
        if not radius > 1.0:
            continue
        if i < len(found):
            row = found[i]
            wide = row[7]
            on_ray = row[2] < errors.first_circle
            if on_ray:
                direction = math.atan2(dv, du)
                where, whether = mosaic_noise(mosaic, u, v, direction)
            else:
                where = phase_noise(seed, 2 * int(row[2]), row[9] / phase)
                whether = phase_noise(seed, 2 * int(row[2]) + 1, row[9] / phase)
            chance = 0.5 * math.erfc((again * whether + anew * normals[i, 1]) / math.sqrt(2.0))
            if chance >= found_ratio(row, on_ray, math.sqrt(x * x + y * y), numbers):
                continue
            shift = error_px(row, again * where + anew * normals[i, 0], numbers)
            if on_ray:
                shift += frame + edge_shift(row, math.sqrt(x * x + y * y), numbers[22], scales, errors.read_scales)
                if math.isnan(shift):
                    continue
        elif inside_sector(math.atan2(y, x), sectors):
            continue
        if on_ray:
            u, v = u + shift * du / radius, v + shift * dv / radius
        else:
            u, v = u - shift * dv / radius, v + shift * du / radius
        if len(errors.askew):
            nudge_u, nudge_v = _nudged(u, v, errors.askew, errors.step_px)
            u, v = u + nudge_u, v + nudge_v
        x, y = ground_from_pixel(u, v, known[0], known[1], known[2])
        if math.isnan(x):
            continue
        point = out[kept]
        _fill(point, (x, y), (u - camera[0][0], v - camera[0][1]), scale_at(math.sqrt(x * x + y * y), scales, 0),
              numbers, shared)  # fmt: skip
        point[6] = 1.0 - math.exp(-wide / numbers[24])
        point[7], point[8] = u, v
        if not math.isnan(point[2] + point[5]):
            kept += 1
    return kept


@njit(cache=True, error_model="numpy")
def _fill(point, place, pixel, scale, numbers, shared):  # type: ignore[no-untyped-def]
    """Place, moved by the body's lean, and covariance of a point. pixel: from the camera's centre; scale: m per px."""
    lean, height, point_px, point_m = numbers[25:29]
    roll, pitch = lean * shared[1], lean * shared[2]
    (x, y), (du, dv) = place, pixel
    distance = math.sqrt(x * x + y * y)
    outwards, across = scale**2, distance * distance / (du * du + dv * dv)
    cx, cy = x / distance, y / distance
    leaning = (x * pitch - y * roll) / height
    point[0], point[1] = x + height * pitch + x * leaning, y - height * roll + y * leaning
    point[2] = point_px**2 * (outwards * cx * cx + across * cy * cy) + point_m**2
    point[5] = point_px**2 * (outwards * cy * cy + across * cx * cx) + point_m**2
    point[3] = point[4] = point_px**2 * (outwards - across) * cx * cy


@njit(cache=True, error_model="numpy")
def _nudged(u, v, shifts, step):  # type: ignore[no-untyped-def]
    """Shift (u, v) at a pixel, bilinear between the nodes (R, C, 2), which are `step` pixels apart."""
    column, row = u / step, v / step
    i, j = min(max(int(row), 0), shifts.shape[0] - 2), min(max(int(column), 0), shifts.shape[1] - 2)
    fv, fu = row - i, column - j
    near_u = (1.0 - fu) * shifts[i, j, 0] + fu * shifts[i, j + 1, 0]
    near_v = (1.0 - fu) * shifts[i, j, 1] + fu * shifts[i, j + 1, 1]
    far_u = (1.0 - fu) * shifts[i + 1, j, 0] + fu * shifts[i + 1, j + 1, 0]
    far_v = (1.0 - fu) * shifts[i + 1, j, 1] + fu * shifts[i + 1, j + 1, 1]
    return (1.0 - fv) * near_u + fv * far_u, (1.0 - fv) * near_v + fv * far_v
