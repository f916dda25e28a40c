"""A start pose that a person gives: how far it may be off."""

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray


class StartSettings(Settings):
    """The standard deviations of a pose that is given without a covariance."""

    start_position_m: float = Field(0.3, gt=0, description="standard deviation of x and y of a pose that is given (m)")
    start_heading_rad: float = Field(0.15, gt=0, description="standard deviation of a heading that is given (rad)")

    @property
    def start_covariance(self) -> FloatArray:
        """(3, 3) of a pose that is given without one, (m, m, rad)."""
        return np.diag(np.square([self.start_position_m, self.start_position_m, self.start_heading_rad]))
