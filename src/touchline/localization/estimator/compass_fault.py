"""The end of the field by a compass, as log-odds: a sensor that now and then fails for a while.

A robot that is followed from image to image does not change its end, and a compass either works or has failed, then
stuck or turned by half a circle. So there are six states, right or wrong end with a compass that works, that had failed
when the pose was found or that has failed since, and a filter over them (Rabiner 1989, the forward recursion): faults
begin seldom. One that nobody saw begin ends soon, or a compass could excuse a wrong end for ever; one that begins while
a robot is followed may last as long as it likes: the robot cannot have changed its end. A compass that turns round then
has failed, unless it had agreed for a moment only; one that has failed does not locate a robot that was lost meanwhile.
"""

import math

from numba import njit

from touchline.geometry import wrap_angle
from touchline.motion.compass import COMPASS_FALSE
from touchline.types import Samples

FAULT_EVERY_S = 600.0  # mean time until a fault begins
FAULT_S, SEEN_FAULT_S = 10.0, 120.0  # mean times until one ends: that nobody saw begin, and that began since
UNLIKELY = 0.05  # of what a state does not lead to, in one image: the compass is late, or the robot turns
MAX_S = 0.2  # between two images, as far as it counts: readings in a pause are unknown
MAX_LOG_ODDS = 10.0  # log-odds that a minute of agreement comes to
SUSPECT = 0.2  # probability of a failed compass from which it does not count in the search of a lost robot
CHANCE_RAD = 1.5  # turn over which a failed compass agrees by chance: stuck or turned, it does not turn along
NEAR_RAD, FAR_RAD = math.pi / 4.0, 0.75 * math.pi  # errors of a compass at the right end, and at the wrong one
# columns a compass that works, had failed, has failed since; rows right and wrong end. NumPy takes several times longer
EndStates = tuple[float, float, float]
CompassStates = tuple[EndStates, EndStates]

# of a robot whose pose jumps as its compass turns round, that it was carried to near its twin's place; else it was
# shoved in the very image in which the compass failed. Both are rare; where robots play, shoves are not
CARRIED = 0.33
REPEATS = 15  # equal readings in a row of one that sticks: 0.3 s at 50 Hz
PAIRS, DIFFERING = 50, 0.7  # successive readings that must be known, and the share of them that differ
# likelihood of each reading (for the pose's end, for neither, against it); a failed compass may show anything
_LIKELY: dict[int, CompassStates] = {
    1: ((1.0, 1.0, 1.0), (UNLIKELY, 1.0, 1.0)),
    0: ((UNLIKELY, 1.0, 1.0), (UNLIKELY, 1.0, 1.0)),
    -1: ((UNLIKELY, 1.0, 1.0), (1.0, 1.0, 1.0)),
}

# the reading with which a pose was found: a failed compass has led the search to the other end, or is right by chance
_FIRST_READING: dict[int, CompassStates] = {
    1: ((1.0, 0.25, 0.25), (1e-6, 1.0, 1.0)),
    -1: ((1e-6, 1.0, 1.0), (1.0, 0.25, 0.25)),
}


class StuckCompass:
    """Whether a compass sticks: one whose readings have always differed a little repeats exactly the same one.

    A compass of whole degrees repeats itself while the robot stands; of that nothing is concluded.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing is known."""
        self._last_rad = math.nan
        self._repeats = self._pairs = self._differing = 0

    @property
    def sticks(self) -> bool:
        """Whether it does now."""
        return self._repeats >= REPEATS and self._pairs >= PAIRS and self._differing >= DIFFERING * self._pairs

    def update(self, compass: Samples | None) -> None:
        """Take the readings (M, 1) since the image before."""
        for reading_rad in [] if compass is None else compass.values[:, 0].tolist():
            same, self._last_rad = reading_rad == self._last_rad, reading_rad
            self._repeats = self._repeats + 1 if same else 0
            if self._repeats < REPEATS:
                self._pairs += 1
                self._differing += not same


class CompassFaultFilter:
    """Log-odds of the pose's end against the other by the compass alone."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing is known."""
        self.states = _both_ends(COMPASS_FALSE, 0.0)

    @property
    def log_odds(self) -> float:
        """Of the pose's end, against the other."""
        (a, b, c), (d, e, f) = self.states
        return math.log((a + b + c) / (d + e + f))

    @property
    def is_suspect(self) -> bool:
        """Whether it has probably failed: it does not count in the search of a lost robot."""
        return sum(self._failed) > SUSPECT

    @property
    def _failed(self) -> tuple[float, float]:
        """Probability that it had failed before, and that it has since."""
        right, wrong = self.states
        total = sum(right) + sum(wrong)
        return (right[1] + wrong[1]) / total, (right[2] + wrong[2]) / total

    def forget_end(self) -> None:
        """Nothing is known of the end; the probabilities of its faults are kept."""
        self.states = _both_ends(*self._failed)

    def begin(self, error_rad: float | None) -> None:
        """A pose was found anew that a compass differs from: of its end nothing else is known."""
        self.forget_end()
        support = supports(error_rad)
        if support:
            self.states = _weighed(self.states, _FIRST_READING[support])

    def update(self, error_rad: float | None, seconds: float, turned_rad: float = 0.0) -> None:
        """Take its difference from the pose's heading; None: no reading. seconds: since the one before. turned_rad: by
        which a robot has turned meanwhile whose end is known: one that agrees all the same works again.
        """
        support = supports(error_rad)
        if support is None:
            return
        chance = math.exp(-turned_rad / CHANCE_RAD) if support == 1 else 1.0
        self.states = _followed(self.states, min(max(seconds, 0.0), MAX_S), bool(support), _LIKELY[support], chance)

    def doubt(self) -> None:
        """It has turned round in the image in which the pose jumped."""
        self.states = (0.0, 1.0 - CARRIED, 0.0), (CARRIED, 0.0, 0.0)

    def swap_ends(self) -> None:
        """The twin is the pose from now on."""
        right, wrong = self.states
        self.states = wrong, right


@njit(cache=True)
def _followed(states, elapsed_s, agrees, likely, chance):  # type: ignore[no-untyped-def]
    """States after a time and a reading; agrees: with an end, which a failed compass does by chance, as long as the
    robot does not turn; likely: the reading in each state; chance: that one which has failed shows it.
    """
    ends, ends_since, failing = elapsed_s / FAULT_S, elapsed_s / SEEN_FAULT_S, elapsed_s / FAULT_EVERY_S
    lasts = chance * (1.0 - ends) * (math.exp(-ends) if agrees else 1.0)  # and shows what it has shown
    lasts_since = chance * (1.0 - ends_since) * (math.exp(-ends_since) if agrees else 1.0)
    (a, b, c), (d, e, f) = states
    right = a * (1.0 - failing) + ends * b + ends_since * c, lasts * b, (a * failing + c) * lasts_since
    wrong = d * (1.0 - failing) + ends * e + ends_since * f, lasts * e, (d * failing + f) * lasts_since
    return _bounded(_weighed((right, wrong), likely))


def _both_ends(failed: float, since: float) -> CompassStates:
    """States of which nothing but the probabilities of a failed compass are known."""
    each = 0.5 * (1.0 - failed - since), 0.5 * failed, 0.5 * since
    return each, each


@njit(cache=True)
def _weighed(states: CompassStates, likely: CompassStates) -> CompassStates:
    """Each state times how likely it is."""
    (a, b, c), (d, e, f) = states
    (g, h, i), (k, m, n) = likely
    return (a * g, b * h, c * i), (d * k, e * m, f * n)


@njit(cache=True)
def _bounded(states: CompassStates) -> CompassStates:
    """States that sum to one, with log-odds of MAX_LOG_ODDS between the ends at most: nothing is certain for ever."""
    (a, b, c), (d, e, f) = states
    for_end, against = a + b + c, d + e + f
    least, total = math.exp(-MAX_LOG_ODDS) * max(for_end, against), for_end + against
    right, wrong = max(for_end, least) / (for_end * total), max(against, least) / (against * total)
    return (a * right, b * right, c * right), (d * wrong, e * wrong, f * wrong)


def supports(error_rad: float | None) -> int | None:
    """1 for the pose's end, -1 against it, 0 for neither, of a compass that differs by an angle from its heading."""
    if error_rad is None:
        return None
    error = abs(wrap_angle(error_rad))
    return 1 if error < NEAR_RAD else -1 if error > FAR_RAD else 0
