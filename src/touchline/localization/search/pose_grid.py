"""The poses of a coarse search: the whole field, the whole circle."""

import math

import numpy as np

from touchline.errors import InputError
from touchline.geometry import FloatArray

_MIN_SPACING_RAD = 1e-3
_MAX_POSITIONS = 10_000_000


class PoseGrid:
    """Sample poses over a field: positions (K, 2) in m, headings (H,) in rad.

    shape: rows, one for each x, and columns, one for each y, that the positions are in, row by row.
    """

    def __init__(
        self,
        length_m: float,
        width_m: float,
        spacing_m: float,
        beyond_m: float,
        spacing_rad: float,
    ) -> None:
        """length_m, width_m: of the field."""
        if spacing_rad < _MIN_SPACING_RAD:
            raise InputError(f"headings {spacing_rad:g} rad apart are too many; {_MIN_SPACING_RAD:g} is the least")
        self.spacing_m = spacing_m
        self.spacing_rad = spacing_rad
        self.positions = sample_positions(length_m, width_m, spacing_m, beyond_m)
        columns = int(np.count_nonzero(self.positions[:, 0] == self.positions[0, 0]))
        self.shape = (len(self.positions) // columns, columns)
        count = math.ceil(2 * math.pi / spacing_rad)
        self.headings = np.arange(count) * 2 * math.pi / count


def sample_positions(length_m: float, width_m: float, spacing_m: float, beyond_m: float) -> FloatArray:
    """Positions (K, 2) spacing_m apart, from beyond_m outside the lines on, centred on the field.

    21 x 15 = 315 of them for 18 x 12 m, 1 m and 1 m; a field that the spacing doesn't divide is covered beyond its end.
    Raises InputError for more than 10⁷ of them.
    """
    count = (length_m + 2.0 * beyond_m + spacing_m) * (width_m + 2.0 * beyond_m + spacing_m) / spacing_m / spacing_m
    if count > _MAX_POSITIONS:
        raise InputError(f"the search: positions {spacing_m:g} m apart are {count:.1g}; {_MAX_POSITIONS} are the most")
    axes = []
    for size_m in (length_m, width_m):
        reach_m = size_m / 2 + beyond_m
        steps = math.ceil(2 * reach_m / spacing_m - 1e-9)
        axes.append((np.arange(steps + 1) - steps / 2) * spacing_m)
    x, y = np.meshgrid(*axes, indexing="ij")
    return np.stack((x.ravel(), y.ravel()), axis=1)
