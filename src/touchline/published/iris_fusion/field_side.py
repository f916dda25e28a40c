"""At which end of a symmetric field the robot is: the compass is a witness there, not the judge.

Lines look the same from both ends. Whoever has followed the robot from image to image since the compass last agreed
has three witnesses for its end, lines, gyro and wheels, and needs more than a compass that suddenly says otherwise.
Ismail et al. 2021 ask the compass at the start alone; this rule is ours.
"""

import math

from touchline.geometry import wrap_angle
from touchline.motion.compass import COMPASS_FALSE

# images in a row with such a difference until the compass contradicts, or without it until it agrees
HEADING_FRAMES = 5
# by so many images a contradiction has to last longer than the agreement before it, to be believed after all: 20 s
PATIENCE_FRAMES = 200
MAX_AGREED = 600  # images of agreement that count: a minute
# images in which a compass kept its difference from the pose, up to KEPT_RAD, after which that is its jump
STEADY_FRAMES = 15
KEPT_RAD = 0.35


class FieldSide:
    """Judges the compass while the robot is followed. `known`: whether the pose's end is; else the twin is named, too.

    `doubted`: the compass contradicts a pose that it had agreed with. `by_compass`: nothing but it tells the end.

    A compass that turned round just as the robot was moved unfelt has failed, or the robot was carried to the other
    end: no witness has followed it.
    """

    def __init__(self, heading_rad: float | None) -> None:
        """heading_rad: difference from the compass that shows the wrong end; none: the compass is not asked."""
        self.heading_rad = heading_rad
        self.start(known=True)

    def start(self, known: bool, start_known: bool = False) -> None:
        """Follow a robot from now on. known: whether its end is. start_known: from a person, not by the compass."""
        self.known, self._start_known = known, start_known
        self.doubted = self._unsettled = self.by_compass = self._compass_is_right = False
        self._forget()

    def search(self, known: bool, by_compass: bool = False) -> None:
        """The robot was lost and is searched for. A compass that was doubted remains so until it changes its mind.

        by_compass: nothing else tells the end; that is enough if it has agreed with an end that was told. One that
        turned round as the robot was moved shows where to search, but may have failed: the end stays unknown.
        """
        either_end = self.either_end
        self.doubted = (self.doubted or self._contradicts) and not self._moved
        self.by_compass = by_compass and not self._compass_is_right
        jumped = self._unsettled and self.wrong
        refuted = self._start_known and self.wrong
        self._unsettled = not jumped and (self.doubted or either_end or self._unsettled or refuted)
        self.doubted = self.doubted and not self.wrong
        self.known, self._start_known = known and not self._unsettled, False
        self._forget()

    def _forget(self) -> None:
        self._confirmed = self._had_agreed = self._had_turned = self._moved = self._unfelt = False
        self._off_rad, self._steady = math.inf, 0
        self._agreed = self._against = self._straight = self._turned = 0

    def update_from_compass(self, off_compass_rad: float | None, moved: bool = False) -> None:
        """One image of a robot that is followed: its heading minus the compass; None without one.

        moved: the robot was, since the image before, and the odometry felt nothing of it.
        """
        if self.heading_rad is None or off_compass_rad is None:
            return
        before_rad, self._off_rad = self._off_rad, off_compass_rad
        if abs(off_compass_rad) > self.heading_rad:
            kept = self._turned > 0 and abs(wrap_angle(off_compass_rad - before_rad)) < KEPT_RAD
            self._steady = self._steady + 1 if kept else 0
            if self._turned == 0:
                self._unfelt = moved
                self._moved = moved and abs(before_rad) < 0.5 * self.heading_rad
            self._straight, self._turned, self._against = 0, self._turned + 1, self._against + 1
        else:
            self._steady = 0
            self._straight, self._turned, self._agreed = self._straight + 1, 0, min(self._agreed + 1, MAX_AGREED)
        if self._straight >= HEADING_FRAMES:
            self._had_agreed = True
            if not self._unsettled or self._had_turned or self._agreed > PATIENCE_FRAMES:
                self.known = self._confirmed = True
                self._compass_is_right |= not self.by_compass
                self.doubted = self._unsettled = self._start_known = False
                self._against = 0
        if self._turned >= HEADING_FRAMES:
            self._had_turned = True
            self.doubted |= self._confirmed
            self.known &= not (self._confirmed or self._unsettled)

    @property
    def _contradicts(self) -> bool:
        """Whether the compass has begun to contradict a pose that it had agreed with, and the robot was not moved."""
        return self._confirmed and self._turned > 0 and not self._unfelt

    @property
    def either_end(self) -> bool:
        """Whether the compass turned round just as the robot was moved: it may be at the other end."""
        return self.doubted and self._moved

    def heading(self, compass_rad: float | None) -> float | None:
        """The heading (rad) that a search begins with: the compass's, without its jump if it is doubted; or none."""
        doubted = self.doubted or self._contradicts
        if compass_rad is None or not doubted or self._moved or self.wrong:
            return compass_rad
        return wrap_angle(compass_rad + self._off_rad) if self._steady >= STEADY_FRAMES else None

    @property
    def twin_probability(self) -> float | None:
        """Of standing at the other end: 0 where the end is known, None where nothing tells it."""
        return None if not self.known else COMPASS_FALSE if self.by_compass else 0.0

    @property
    def wrong(self) -> bool:
        """Whether the robot is followed at the wrong end."""
        if self._turned < HEADING_FRAMES:
            return False
        if self._confirmed:
            return self._against > self._agreed + PATIENCE_FRAMES
        return not self._unsettled or self._had_agreed or self._against > PATIENCE_FRAMES
