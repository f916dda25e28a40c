"""Whether a pose that was found elsewhere shows as many of the field's lines as the robot usually sees.

Somewhere in a field a few bars, a net and a cable fit some lines, and stand still as lines do. What gives such a pose
away is what is not seen: a camera that shows the field all round would show the other lines there, too. How many a
robot sees depends on what hides its view, so it is compared with itself, as it was while it was tracked.
"""

import math

from touchline.field.distances import LineTables
from touchline.geometry import FloatArray
from touchline.localization.registration.unseen import seen_ratio

USUAL, SHOWN = 0.7, 0.2  # of its usual ratio elsewhere; what images have to show beyond it, one alone or several
MIN_ON_TRIAL, TRIAL_MEMORY = 0.6, 0.3  # mean ratio, of the usual one, that a pose found elsewhere has to keep up
TRIAL_IMAGES, TRIED_EVERY = 60, 3  # for so many images, of which one in so many is asked
MAX_M = 6.0  # farther lines are seen now and then
LEARNED_EVERY, MEMORY = 5, 0.1  # images in which what is usual is learned, and how fast


class LineCoverage:
    """`shown`: whether the pose that is followed was shown by as many lines as usual since it was found, and still is:
    for sixty images it is on trial.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing is usual yet, and nothing is asked of a pose."""
        self.shown, self._usual, self._far_m = True, 0.0, MAX_M
        self._beyond, self._images = 0.0, 0  # what was shown beyond USUAL; images in which all was well
        self._trial, self._ratio = 0, 0.0  # images that are left of it; mean ratio in these, of what is usual
        self._on_trial = False  # whether the newest image is asked for it

    def begins_image(self, found: bool, settled: bool) -> bool:
        """Whether anything is asked of an image. found: elsewhere than expected; settled: all well, and tracked."""
        if found and self._usual:
            self.shown, self._beyond = False, 0.0
        self._images += self.shown and settled
        if self._trial and self.shown:
            self._on_trial = self._trial % TRIED_EVERY == 0
            self._trial -= 1
            return self._on_trial
        self._on_trial = False
        return not self.shown or (settled and self._images % LEARNED_EVERY == 1)

    def update(self, lines: LineTables, points_m: FloatArray, pose: FloatArray) -> None:
        """Take line points (N, 2), robot frame, at a pose (3,), of an image of which `begins_image` asks."""
        ratio = seen_ratio(lines, points_m, pose, self._far_m)
        if not self.shown:
            self._beyond = max(self._beyond + ratio / self._usual - USUAL, 0.0)
            self.shown, self._trial, self._ratio = self._beyond >= SHOWN, TRIAL_IMAGES, 1.0
        elif self._on_trial:
            self._ratio += TRIAL_MEMORY * (ratio / self._usual - self._ratio)
            if self._ratio < MIN_ON_TRIAL:
                self.shown, self._beyond = False, 0.0
        else:
            self._learn(ratio, points_m)

    def _learn(self, ratio: float, points_m: FloatArray) -> None:
        farthest_m = math.sqrt(float((points_m**2).sum(axis=1).max(initial=0.0)))
        self._far_m += MEMORY * (min(farthest_m, MAX_M) - self._far_m)
        self._usual += (MEMORY if self._usual else 1.0) * (ratio - self._usual)
