"""Whether a pose has been followed so far across the field that the field must be this one.

Near a goal another field's lines fit as well as the right ones, and so they do about the centre; between the two, the
pose then slides along by as much as the fields differ. One that has crossed half of the field, and was moved by the
images no more than odometries slip, is of this field, and what lies on no line besides is clutter.
"""

import math

from touchline.geometry import Pose

CROSSED = 0.45  # of the field's length, between the places that the pose has been at
SLIPPED_M, MEMORY_M = 0.3, 4.0  # by which images may have moved it, and the way over which that is forgotten
AWAY_S = 0.5  # between two images, after which nothing shows that it was followed


class FieldProof:
    """`given`: whether the pose that is followed has shown which field it is."""

    def __init__(self, length_m: float) -> None:
        """length_m: of the field."""
        self._crossed_m = CROSSED * length_m
        self.reset()

    def reset(self) -> None:
        """Nothing was followed."""
        self._last: Pose | None = None
        self._low, self._high, self._slipped = (math.inf, math.inf), (-math.inf, -math.inf), (0.0, 0.0)

    @property
    def given(self) -> bool:
        """See the class."""
        crossed_m = math.hypot(self._high[0] - self._low[0], self._high[1] - self._low[1])
        return self._last is not None and crossed_m > self._crossed_m and math.hypot(*self._slipped) < SLIPPED_M

    def update(self, pose: Pose, predicted: Pose | None, seconds: float) -> None:
        """Take a pose after an image, and where it was predicted; None: it was not followed. seconds: since the last
        image.
        """
        if predicted is None or seconds > AWAY_S:
            self.reset()
        way_m = 0.0 if self._last is None else pose.distance_to(self._last)
        if predicted is not None and self._last is not None:
            kept, (x, y) = math.exp(-way_m / MEMORY_M), self._slipped
            self._slipped = kept * x + pose.x - predicted.x, kept * y + pose.y - predicted.y
        self._last = pose
        self._low = min(self._low[0], pose.x), min(self._low[1], pose.y)
        self._high = max(self._high[0], pose.x), max(self._high[1], pose.y)
