"""Whether a pose has been followed so far across the field that the field must be this one.

Near a goal another field's lines fit as well as the right ones, and so they do about the centre; between the two, the
pose then slides along by as much as the fields differ. One that has gone along half of the field, and was moved by the
images no more than odometries slip, is of this field, and what lies on no line besides is clutter. A field that is up
to 7 % larger or smaller passes: by so much odometries may slip, too.
"""

import math

from touchline.geometry import Pose, wrap_angle

CROSSED = 0.45  # of the field's length, between the places along it that the pose has been at
SLIPPED_M, MEMORY_M = 0.3, 4.0  # by which images may have moved it, and the way over which that is forgotten
AWAY_S = 0.5  # between two images, after which nothing shows that it was followed
MAX_WAY_M, MAX_TURN = 1.5, 2.0  # (m, rad) between two images: no robot moves so, the other end is believed now
SHOWN_M, MIN_SHOWN = 5.0, 0.7  # lines so near, and the share of them that points lie on
SHOWN_MEMORY = 0.3  # weight of an image in it


class FieldProof:
    """`given`: whether the pose that is followed has shown that the field is the one that was given."""

    def __init__(self, length_m: float) -> None:
        """length_m: of the field."""
        self._crossed_m = CROSSED * length_m
        self.reset()

    def reset(self) -> None:
        """Nothing was followed."""
        self._last: Pose | None = None
        self._low_m, self._high_m, self._slipped_m = math.inf, -math.inf, (0.0, 0.0)
        self._shown: float | None = None

    @property
    def given(self) -> bool:
        """Whether it has gone far enough, without sliding."""
        return self._high_m - self._low_m > self._crossed_m and math.hypot(*self._slipped_m) < SLIPPED_M

    def shows(self, ratio: float) -> bool:
        """Take the share of the near lines that points of an image lie on; whether that is most of them, of late."""
        self._shown = ratio if self._shown is None else self._shown + SHOWN_MEMORY * (ratio - self._shown)
        return self._shown >= MIN_SHOWN

    def update(self, pose: Pose, predicted: Pose | None, seconds: float) -> None:
        """Take a pose after an image, and where it was predicted; None: it was not followed. seconds: since the last
        image.
        """
        if predicted is None or seconds > AWAY_S or self._ends_exchanged(pose):
            self.reset()
        way_m = 0.0 if self._last is None else pose.distance_to(self._last)
        if predicted is not None and self._last is not None:
            kept, (x, y) = math.exp(-way_m / MEMORY_M), self._slipped_m
            self._slipped_m = kept * x + pose.x - predicted.x, kept * y + pose.y - predicted.y
        self._last = pose
        self._low_m, self._high_m = min(self._low_m, pose.x), max(self._high_m, pose.x)

    def _ends_exchanged(self, pose: Pose) -> bool:
        last = self._last
        return last is not None and (
            pose.distance_to(last) > MAX_WAY_M or abs(wrap_angle(pose.heading - last.heading)) > MAX_TURN
        )
