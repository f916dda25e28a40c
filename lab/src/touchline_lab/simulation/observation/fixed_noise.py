"""Random numbers that come again at the same place: of what is no noise, but looks like it from afar."""

import math

import numpy as np
from numba import njit

from touchline.geometry import FloatArray
from touchline_lab.simulation.observation.runs import turned

KNOTS, DIRECTIONS = 4, 24  # of the function on the mosaic: half a pixel, 15 degrees apart


@njit(cache=True)
def _hashed(seed, path, knot):  # type: ignore[no-untyped-def]
    """A number with nearly normal distribution, always the same for the same three integers (splitmix64)."""
    z = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(path) * np.uint64(0xD1B54A32D192ED03)
    z += np.uint64(knot + 4096) * np.uint64(0x8CB92BA72F3D8DD7)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    total = 0.0
    for _ in range(4):  # the sum of four even numbers of 16 bits: variance 4 / 12
        total += float(z & np.uint64(0xFFFF)) / 65535.0 - 0.5
        z >>= np.uint64(16)
    return total * math.sqrt(3.0)


@njit(cache=True)
def phase_noise(seed, path, place):  # type: ignore[no-untyped-def]
    """A fixed random function of the place on a path, normal with deviation 1, independent one unit apart."""
    knot = math.floor(place)
    share = place - knot
    mixed = (1.0 - share) * _hashed(seed, path, knot) + share * _hashed(seed, path, knot + 1)
    return mixed / math.sqrt((1.0 - share) ** 2 + share**2)


def mosaic_table(seed: int) -> FloatArray:
    """(2, DIRECTIONS, KNOTS, KNOTS) standard normal numbers for `mosaic_noise`: of errors, of misses."""
    return np.random.default_rng([seed, 17]).standard_normal((2, DIRECTIONS, KNOTS, KNOTS))


@njit(cache=True, error_model="numpy")
def mosaic_noise(tables, u, v, direction):  # type: ignore[no-untyped-def]
    """Two fixed random functions of a pixel's place on the 2 x 2 mosaic and of a direction (rad), each normal with
    deviation 1.

    tables (2, DIRECTIONS, KNOTS, KNOTS): their values; in between they are linear.
    """
    place_u, place_v = (u - 2.0 * math.floor(0.5 * u)) * (0.5 * KNOTS), (v - 2.0 * math.floor(0.5 * v)) * (0.5 * KNOTS)
    place_k = turned(direction) * (DIRECTIONS / (2.0 * math.pi))
    i, j, k = int(place_u), int(place_v), int(place_k)
    fi, fj, fk = place_u - i, place_v - j, place_k - k
    first, second, square = 0.0, 0.0, 0.0
    for di in range(2):
        for dj in range(2):
            for dk in range(2):
                weight = (fi if di else 1.0 - fi) * (fj if dj else 1.0 - fj) * (fk if dk else 1.0 - fk)
                at_k, at_j, at_i = (k + dk) % DIRECTIONS, (j + dj) % KNOTS, (i + di) % KNOTS
                first += weight * tables[0, at_k, at_j, at_i]
                second += weight * tables[1, at_k, at_j, at_i]
                square += weight * weight
    size = math.sqrt(square)
    return first / size, second / size
