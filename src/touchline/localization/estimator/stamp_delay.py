"""Whether images are stamped late, by an unknown delay: when the filter's delay is accepted.

Two measurements give it: the odometry, by a state of the filter that learns from every start, stop and turn (`Filter`),
and how a walking robot sways (`SwayDelay`). Nothing is corrected by it until it is sure: a robot with correct stamps
loses nothing by the noise of a state that it does not need. Stamps that seem too early are an odometry that comes late;
to correct them would take the motion after the stamp, which is unknown yet.
"""

import math

from touchline.motion.samples import NANOSECONDS, SampleHistory
from touchline.types import Problem, ProblemCode

INITIAL_DEVIATION_S = 0.06  # standard deviation of the delay, at first
MIN_S = 0.012  # that is corrected: 4 cm at 3 m/s
ACCEPTED = 4.0  # z-score above which a delay is accepted
MIN_IMAGES = 5  # in a row
REJECTED = 2.0  # z-score below which, or less than half of MIN_S, it is none after all
WANDERING_S = 0.01  # standard deviation of stamps on arrival about their mean: drivers, buses, other processes
REPORTED_EVERY = 200  # images
USUAL_AHEAD_S = 0.1  # of an image's stamp before that of the newest odometry which comes with it: more is another clock
CLOCK_S, CLOCK_IMAGES = 0.03, 3  # change of that which shows a clock that was set, and for how many images it lasts
NOT_CORRECTED = "not corrected, for where the head was then is not told; at least so much"


class StampDelay:
    """`corrected_s`: how late images are stamped, as far as it is accepted and can be corrected, else 0; `deviation_s`:
    standard deviation.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing is known."""
        self._accepted_s, self.deviation_s, self._correctable = 0.0, 0.0, True
        self._sure, self._since_reported = 0, REPORTED_EVERY

    @property
    def corrected_s(self) -> float:
        """How late images are stamped (s)."""
        return self._accepted_s if self._correctable else 0.0

    @property
    def wandering_s(self) -> float:
        """Standard deviation of a stamp about the mean: of stamps on arrival alone."""
        return WANDERING_S if self.corrected_s else 0.0

    def take(self, late_s: float, deviation_s: float) -> bool:
        """Accept a delay that the motion has shown, if it can be corrected; whether it is another than before."""
        if not self._correctable or abs(late_s - self._accepted_s) < 2.0 * deviation_s:
            return False
        self._accepted_s, self.deviation_s, self._sure = late_s, deviation_s, MIN_IMAGES
        return True

    def update(self, estimated_s: float, deviation_s: float, correctable: bool = True) -> Problem | None:
        """Take the delay that an image gives. correctable: not so of a head that pans and was elsewhere then.

        Returns the problem to report: at first and every REPORTED_EVERY images.
        """
        self._correctable = correctable
        if self._accepted_s:
            if estimated_s < max(REJECTED * deviation_s, 0.5 * MIN_S):
                self.reset()
        else:
            self._sure = self._sure + 1 if estimated_s > max(ACCEPTED * deviation_s, MIN_S) else 0
        if not self._accepted_s and self._sure < MIN_IMAGES:
            return None
        self._accepted_s, self.deviation_s = estimated_s, deviation_s
        self._since_reported += 1
        if self._since_reported <= REPORTED_EVERY:
            return None
        self._since_reported = 0
        late = f"images are stamped {1e3 * estimated_s:.0f} ± {1e3 * deviation_s:.0f} ms too late"
        if correctable:
            return Problem(ProblemCode.STAMPS_LATE_CORRECTED, f"{late}: corrected")
        return Problem(ProblemCode.STAMPS_LATE, f"{late}: {NOT_CORRECTED}")


class Arrivals:
    """Whether images are stamped as long after the odometry that comes with them as usual; if not, a clock was set, or
    runs otherwise. `off_s`: by how much the newest image is; `change_s`: with this image, what has lasted and is usual
    from now on; `ahead_s`: by which its stamp is beyond the newest odometry that came with it.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing is usual yet."""
        self.off_s, self.change_s, self._usual_s, self._newest_ns = 0.0, 0.0, math.nan, 0
        self.ahead_s = 0.0
        self._changes_s: list[float] = []

    def update(self, stamp_ns: int, odometry: SampleHistory) -> None:
        """Take the stamp of an image after the samples that came with it."""
        self.change_s = 0.0
        if not len(odometry) or odometry.last_ns == self._newest_ns:
            return
        self._newest_ns = odometry.last_ns
        ahead_s = (stamp_ns - odometry.last_ns) / NANOSECONDS
        self.ahead_s = max(ahead_s, 0.0)
        if math.isnan(self._usual_s):
            self._usual_s = ahead_s if abs(ahead_s) < USUAL_AHEAD_S else 0.0
        self.off_s = ahead_s - self._usual_s
        if abs(self.off_s) < CLOCK_S:
            self.off_s, self._changes_s = 0.0, []
            return
        self._changes_s = [*self._changes_s[1 - CLOCK_IMAGES :], self.off_s]
        nearest_s = min(self._changes_s, key=abs)
        lasts = len(self._changes_s) == CLOCK_IMAGES and abs(sum(self._changes_s)) == sum(map(abs, self._changes_s))
        if lasts:
            self._usual_s, self.off_s, self._changes_s = self._usual_s + nearest_s, self.off_s - nearest_s, []
            self.change_s = nearest_s
