"""The noise of features for the loops: Schulz and Behnke 2012, section 5, equations (5) and (6), and section 5.3."""

import math
from typing import NamedTuple

from numba import njit

from touchline.geometry import FloatArray

MAX_M = 10.0  # of the observation range, whose measure is the uniform density of section 5.3
MIN_M = 0.05  # a line without length has no direction
MODEL_RAD = 0.02  # error of a line's direction on the field: paint, carpet, lens; added to covariances
MIN_RATIO = 1e-6  # of the normal observation: a confidence of 0 is no division by it


class Noise(NamedTuple):
    """`FeatureNoiseSettings`; height_m: of the camera; model_m: error of a feature's place on the field. stated:
    whether what is seen states its covariance, to which both are added; else it is as the paper has it.
    """

    sigma_d_m: float
    sigma_l_m: float
    range_ratio: float
    sigma_beta_rad: float
    uniform_floor: float
    lean_rad: float
    height_m: float
    model_m: float
    stated: bool


@njit(cache=True, error_model="numpy")
def point_noise(positions, covariances, confidences, noise, information, own, sigmas, mixture):  # type: ignore[no-untyped-def]
    """Of points (M, 2), covariances (M, 2, 2), into what `PointFeatures` has of them; mixture (2, M): floors, peaks."""
    for i in range(len(positions)):
        x, y = positions[i, 0], positions[i, 1]
        a, b = covariances[i, 0, 0] + noise.model_m**2, covariances[i, 0, 1]
        c = covariances[i, 1, 1] + noise.model_m**2
        _invert(a, b, c, own[i])
        xr, xp, yr, yp = _lean_errors(x, y, noise)
        det = _invert(a + xr * xr + xp * xp, b + xr * yr + xp * yp, c + yr * yr + yp * yp, information[i])
        sigmas[i, 0] = noise.sigma_d_m + noise.range_ratio * math.hypot(x, y)
        sigmas[i, 1] = noise.sigma_beta_rad
        if noise.stated:
            uniform, density = 1.0 / (math.pi * MAX_M**2), 1.0 / (2.0 * math.pi * math.sqrt(det))
        else:
            uniform, density = _by_sigmas(sigmas[i])
        mixture[0, i], mixture[1, i] = _mixed(confidences[i], uniform, density, noise)


@njit(cache=True, error_model="numpy")
def line_noise(ends, covariances, confidences, noise, sigmas, own, mixture):  # type: ignore[no-untyped-def]
    """Of lines (L, 2, 2), covariances (L, 2, 2, 2) of their ends, into what `LineFeatures` has of them; mixture (2, L).

    Standard deviations (L, 2) are those of the middle's distance aside (m) and of the direction (rad).
    """
    for i in range(len(ends)):
        dx, dy = ends[i, 1, 0] - ends[i, 0, 0], ends[i, 1, 1] - ends[i, 0, 1]
        length = math.hypot(dx, dy)
        nx, ny = -dy / length, dx / length
        aside = 0.0
        for c in covariances[i]:
            aside += nx * nx * c[0, 0] + nx * ny * (c[0, 1] + c[1, 0]) + ny * ny * c[1, 1]
        middle, turn = aside / 4.0 + noise.model_m**2, aside / length**2 + MODEL_RAD**2
        own[i, 0], own[i, 1] = math.sqrt(middle), math.sqrt(turn)
        if noise.stated:
            first = _lean_errors(ends[i, 0, 0], ends[i, 0, 1], noise)
            last = _lean_errors(ends[i, 1, 0], ends[i, 1, 1], noise)
            for k in range(2):  # roll, pitch
                one, other = nx * first[k] + ny * first[2 + k], nx * last[k] + ny * last[2 + k]
                middle, turn = middle + (0.5 * (one + other)) ** 2, turn + ((other - one) / length) ** 2
            sigmas[i, 0], sigmas[i, 1] = math.sqrt(middle), math.sqrt(turn)
        else:
            sigmas[i, 0] = noise.sigma_l_m + noise.range_ratio * _closest_range(ends[i], dx, dy)
            sigmas[i, 1] = noise.sigma_beta_rad
        uniform, density = _by_sigmas(sigmas[i])
        mixture[0, i], mixture[1, i] = _mixed(confidences[i], uniform, density, noise)


@njit(cache=True, error_model="numpy")
def _invert(a: float, b: float, c: float, out: FloatArray) -> float:
    """The inverse of ((a, b), (b, c)) into out (2, 2); returns the determinant of what was inverted."""
    det = a * c - b * b
    out[0, 0], out[1, 1] = c / det, a / det
    out[0, 1] = out[1, 0] = -b / det
    return det


@njit(cache=True, error_model="numpy")
def _lean_errors(x: float, y: float, noise: Noise) -> tuple[float, float, float, float]:
    """By how much a ground point moves by the error of the lean: x by roll and by pitch, y by roll and by pitch (m)."""
    h, error = noise.height_m, noise.lean_rad
    return -error * x * y / h, error * (h + x * x / h), -error * (h + y * y / h), error * x * y / h


@njit(cache=True, error_model="numpy")
def _closest_range(ends: FloatArray, dx: float, dy: float) -> float:
    """d_o of equation (6): range of the closest point of a line from its ends (2, 2), dx and dy apart."""
    share = -(ends[0, 0] * dx + ends[0, 1] * dy) / (dx * dx + dy * dy)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(ends[0, 0] + share * dx, ends[0, 1] + share * dy)


@njit(cache=True, error_model="numpy")
def _by_sigmas(sigmas: FloatArray) -> tuple[float, float]:
    """Densities of the uniform and at the top of the normal observation of a distance and an angle."""
    return 1.0 / (2.0 * math.pi * MAX_M), 1.0 / (2.0 * math.pi * sigmas[0] * sigmas[1])


@njit(cache=True, error_model="numpy")
def _mixed(confidence: float, uniform: float, density: float, noise: Noise) -> tuple[float, float]:
    """Both densities with the shares of section 5.3."""
    base = noise.uniform_floor
    share = min(max(base + (1.0 - base) * (1.0 - confidence), base), 1.0 - MIN_RATIO)
    return share * uniform, (1.0 - share) * density
