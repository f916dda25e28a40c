"""The poses of a coarse search: the whole field, the whole circle, or a piece of either."""

from __future__ import annotations

import math

import numpy as np

from touchline.errors import InputError
from touchline.localization.published.nubot.global_search import sample_positions

_MIN_SPACING_RAD = 1e-3


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
        heading: float | None = None,
        tolerance_rad: float = math.pi,
    ) -> None:
        """length_m, width_m: of the field. heading, tolerance_rad: search only this far to each side of a heading."""
        if spacing_rad < _MIN_SPACING_RAD:
            raise InputError(f"headings {spacing_rad:g} rad apart are too many; {_MIN_SPACING_RAD:g} is the least")
        self.spacing_m = spacing_m
        self.spacing_rad = spacing_rad
        self.positions = sample_positions(length_m, width_m, spacing_m, beyond_m)
        columns = int(np.count_nonzero(self.positions[:, 0] == self.positions[0, 0]))
        self.shape = (len(self.positions) // columns, columns)
        if heading is None:
            count = math.ceil(2 * math.pi / spacing_rad)
            self.headings = np.arange(count) * 2 * math.pi / count
        else:
            each_side = math.ceil(tolerance_rad / spacing_rad)
            self.headings = heading + np.linspace(-tolerance_rad, tolerance_rad, 2 * each_side + 1)
