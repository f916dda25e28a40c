"""The loop of a running robot: one thread hears, another localises the latest image, both tell.

An image that comes while the one before is looked at waits. Where looking takes less time than the images are apart,
those that wait are taken in their order, so that a moment of delay costs none; otherwise the latest one wins, and the
others are counted. An image is localised at its own time; between images the estimate is carried on to every sample of
the odometry.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Sequence
from operator import itemgetter
from statistics import median

import cv2

from touchline.errors import InputError
from touchline.files.images import decode
from touchline.geometry import Pose, wrap_angle
from touchline.live.heard import Described, Heard, Link, Published, Reading, Sight, Start
from touchline.localizer import Localizer
from touchline.types import Estimate, Evidence, GameState, ImageArray

HEARING_S = 0.1  # how long the loop may wait before it looks whether it shall end
_MAX_ODOMETRY = 2_000
_MAX_WAITING = 30  # images
_REMEMBERED, _FIRST = 15, 3  # steps and arrivals that tell who is faster; steps until then, in which code is loaded
_MAX_AGE_NS, _APART_NS = 1_000_000_000, 400_000_000  # of the newest sample; between two


class LiveLoop:
    """Between a link and a localizer. `run` returns when `stop` says so."""

    def __init__(
        self,
        link: Link,
        localizer: Localizer,
        on_published: Callable[[Published], None] = lambda published: None,
        team_evidence: bool = True,
        mates: Collection[str] = (),
    ) -> None:
        """on_published: called with every estimate of an image, by the thread that localises.

        team_evidence: what others say by the link counts. mates: who of them is known; all the rest is one voice.
        """
        self._team_evidence, self._mates = team_evidence, frozenset(mates)
        self._link, self._localizer, self._on_published = link, localizer, on_published
        self._adds: dict[str, Callable[..., None]] = {
            "odometry": localizer.add_odometry,
            "wheels": localizer.add_wheels,
            "gyro": localizer.add_gyro,
            "compass": localizer.add_compass,
            "attitude": localizer.add_attitude,
        }
        self._waiting: deque[tuple[Sight, int]] = deque()  # each with how many samples came before it
        self._steps_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._arrivals_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._changed = threading.Condition()
        self._telling = threading.Lock()
        self._ended = False
        self._failure: Exception | None = None
        self._odometry: deque[tuple[int, Pose]] = deque(maxlen=_MAX_ODOMETRY)
        self.counts = Counter(images=0, dropped=0, readings=0, published=0)

    def run(self, stop: Callable[[], bool]) -> None:
        """Until `stop` says so, which is asked several times a second. Raises what ended the thread that localises."""
        worker = threading.Thread(target=self._work, name="localize", daemon=True)
        worker.start()
        try:
            while not stop() and worker.is_alive():
                for heard in self._link.hear(HEARING_S):
                    self._take(heard)
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify()
            worker.join()
        if self._failure is not None:
            raise self._failure

    def _take(self, heard: Heard) -> None:
        if isinstance(heard, Reading):
            self.counts["readings"] += 1
            self._adds[heard.sensor](heard.stamp_ns, *heard.values)
            if heard.sensor == "odometry":
                self._carry_on(heard)
        elif isinstance(heard, Start):
            self._begin(heard)
        elif isinstance(heard, Described):
            self._localizer.use_camera(heard.camera)
        elif isinstance(heard, GameState):
            self._localizer.add_game_state(heard.stamp_ns, heard.phase, heard.penalty, heard.first_half)
        elif isinstance(heard, Evidence) and not self._team_evidence:
            self.counts["evidence"] += 1
        elif isinstance(heard, Evidence):
            said = {name: getattr(heard, name) for name in ("own_half", "place_m", "seen_m", "spread_m", "message")}
            known = heard.source in self._mates
            self._localizer.add_evidence(heard.source, heard.probability, **said, known=known)
        else:
            with self._changed:
                self.counts["images"] += 1
                self._arrivals_s.append(heard.arrived_s)
                self._waiting.append((heard, self._localizer.samples_come))
                if len(self._waiting) > (_MAX_WAITING if self._keeps_up() else 1):
                    self.counts["dropped"] += len(self._waiting) - 1
                    self._waiting = deque([self._waiting[-1]])
                self._changed.notify()

    def _keeps_up(self) -> bool:
        """Whether localising an image takes less time than passes until the next one comes."""
        if len(self._steps_s) < _FIRST or len(self._arrivals_s) < _FIRST:
            return True
        spacing_s = (self._arrivals_s[-1] - self._arrivals_s[0]) / (len(self._arrivals_s) - 1)
        return median(self._steps_s) < spacing_s

    def _begin(self, start: Start) -> None:
        try:
            pose = None if start.pose is None else tuple(start.pose)
            self._localizer.reset(pose, start.covariance, start.own_half)
        except InputError:
            self.counts["starts that are none"] += 1

    def _carry_on(self, reading: Reading) -> None:
        """Tell the pose at the time of a sample of the odometry."""
        place = Pose(*reading.values)
        self._odometry.append((reading.stamp_ns, place))
        estimate = self._localizer.pose(reading.stamp_ns)
        if self.counts["published"]:
            self._publish(Published(estimate, estimate.pose.compose(place.inverse()), dropped=self.counts["dropped"]))

    def _work(self) -> None:
        """The worker's thread: what ends it is raised by `run`."""
        try:
            self._localize_all()
        except Exception as error:
            self._failure = error

    def _localize_all(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ended or len(self._waiting) > 0)
                if self._ended:
                    return
                sight, samples = self._waiting.popleft()
            begun_s = time.monotonic()
            estimate = self._localizer.localize(
                sight.stamp_ns,
                image=_pixels(sight),
                observation=sight.observation,
                base_from_camera=sight.base_from_camera,
                samples=samples,
            )
            now_s = time.monotonic()
            self._steps_s.append(now_s - begun_s)
            moved, after_s = self._map_from_odom(estimate), now_s - sight.arrived_s
            published = Published(estimate, moved, True, self.counts["dropped"], after_s, frame=self._localizer.frame)
            self.counts["published"] += 1
            self.counts[estimate.status.value] += 1
            self._publish(published)
            self._on_published(published)

    def _publish(self, published: Published) -> None:
        with self._telling:
            self._link.publish(published)

    def _map_from_odom(self, estimate: Estimate) -> Pose | None:
        """Where the odometry frame lies; None where no sample of it is near.

        Of an image that is newer than all samples, by the pose at the newest: what comes later is not known yet.
        """
        samples = list(self._odometry)
        if not samples or abs(samples[-1][0] - estimate.stamp_ns) > _MAX_AGE_NS:
            return None
        newest_ns, newest = max(samples, key=itemgetter(0))
        if newest_ns <= estimate.stamp_ns:
            return self._localizer.pose(newest_ns).pose.compose(newest.inverse())
        odometry = _between(samples, estimate.stamp_ns)
        return None if odometry is None else estimate.pose.compose(odometry.inverse())


def _between(samples: Sequence[tuple[int, Pose]], stamp_ns: int) -> Pose | None:
    """The odometry's pose at a time, between two samples of it; None where these are far apart."""
    before = max((s for s in samples if s[0] <= stamp_ns), key=itemgetter(0), default=None)
    after = min((s for s in samples if s[0] > stamp_ns), key=itemgetter(0), default=None)
    if before is None or after is None or after[0] - before[0] > _APART_NS:
        return None
    share = (stamp_ns - before[0]) / (after[0] - before[0])
    x, y = (a + share * (b - a) for a, b in zip(before[1][:2], after[1][:2], strict=True))
    return Pose(x, y, wrap_angle(before[1].heading + share * wrap_angle(after[1].heading - before[1].heading)))


def _pixels(sight: Sight) -> ImageArray | None:
    """An image's pixels; what is no image goes on as such, so that it is counted and reported."""
    if sight.image is None or not isinstance(sight.image, bytes):
        return sight.image
    pixels = decode(sight.image, cv2.IMREAD_COLOR)
    return None if isinstance(pixels, str) else pixels
