"""The sensor model: how likely an observation is from a pose.

Whoever has `log_likelihoods` is one: of line points here, of crossings, posts and lines just as well.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol, TypeVar

import numba
import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray

View_contra = TypeVar("View_contra", contravariant=True)


class SensorModel(Protocol[View_contra]):
    """P(o | l) of an observation o, in whatever form the model takes it."""

    def log_likelihoods(self, view: View_contra, poses: FloatArray) -> FloatArray:
        """log P(o | l) (N,), but for a constant, of poses (N, 3): x, y (m), heading (rad), field frame."""
        ...


class LineView(NamedTuple):
    """Line points as the particles are weighed by them: positions_m (M, 2) in the robot frame, and weights (M,).

    Both are float64 and contiguous. heading_rad: what the compass says, None without one.
    """

    positions_m: FloatArray
    weights: FloatArray
    heading_rad: float | None = None


class SquaredErrors(NamedTuple):
    """Squared error of a line point that lies at a place of the field, in the unit of σ.

    squares: float32 (ny, nx). Sample [iy, ix] lies at origin + resolution_m * (ix, iy), field frame, m.
    """

    squares: npt.NDArray[np.float32]
    origin_x: float
    origin_y: float
    resolution_m: float


@numba.njit(cache=True)
def log_likelihoods(poses, points, weights, errors, factor):  # type: ignore[no-untyped-def]
    """log P(o | l) = -factor · sum of weight · error² (N,) of poses (N, 3).

    With weights 1 and factor 1 / (2 σ²) this is the product of equations (2) and (3) of Lu et al. 2013, and of (8) and
    (9) of Ismail et al. 2021. points (M, 2): robot frame, m. weights (M,). errors: SquaredErrors; the nearest sample
    counts, at the table's edge for points beyond it.
    """
    squares, origin_x, origin_y, resolution_m = errors
    last_x, last_y = float(squares.shape[1] - 1), float(squares.shape[0] - 1)
    samples_per_m = 1.0 / resolution_m
    found = np.empty(poses.shape[0])
    for j in range(poses.shape[0]):
        cosine, sine = math.cos(poses[j, 2]) * samples_per_m, math.sin(poses[j, 2]) * samples_per_m
        shift_x = (poses[j, 0] - origin_x) * samples_per_m + 0.5
        shift_y = (poses[j, 1] - origin_y) * samples_per_m + 0.5
        total = 0.0
        for i in range(points.shape[0]):
            fx = shift_x + cosine * points[i, 0] - sine * points[i, 1]
            fy = shift_y + sine * points[i, 0] + cosine * points[i, 1]
            fx = min(fx, last_x) if fx > 0.0 else 0.0  # written so that NaN never becomes an index
            fy = min(fy, last_y) if fy > 0.0 else 0.0
            total += weights[i] * squares[np.uint64(int(fy)), np.uint64(int(fx))]
        found[j] = -factor * total
    return found


__all__ = ["LineView", "SensorModel", "SquaredErrors"]
