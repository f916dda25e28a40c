"""Part of a field, as where a robot is searched for."""

import math
from dataclasses import dataclass

from touchline.geometry import Pose


@dataclass(frozen=True, slots=True)
class Region:
    """Part of the field to search: limits of x and y in m, field frame."""

    min_x: float = -math.inf
    max_x: float = math.inf
    min_y: float = -math.inf
    max_y: float = math.inf

    def contains(self, pose: Pose) -> bool:
        """Whether the pose's position lies inside."""
        return self.min_x <= pose.x <= self.max_x and self.min_y <= pose.y <= self.max_y


OWN_HALF = Region(max_x=0.0)
