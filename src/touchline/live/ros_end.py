"""What the links of ROS share: which topics are read, what their messages say, and what is published."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

from touchline.camera import Camera
from touchline.errors import InputError
from touchline.live.heard import Heard, Published, count_refused
from touchline.live.ros import RosReader
from touchline.live.ros_topics import BOOSTER_POSE_TYPE, FIXED_TOPICS, FIXED_TYPES, Outgoing
from touchline.live.ros_writer import RosWriter
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.roles import COMPASS, DETECTION_TOPIC, DETECTIONS, IMU, ODOMETRY, ROLES, choose_topics
from touchline.sources.bags.with_rosbags import BadMessageError, Codec
from touchline.sources.problems import ProblemLog

SETTLE_S = 1.0  # after a publisher has appeared, until topics are chosen: others may still come
UNUSABLE = (BadMessageError, InputError, ValueError, TypeError, OverflowError, AttributeError, IndexError)
"""What a message that is none may raise where it is read."""


class RosEnd(ABC):
    """A link whose topics are found by their types as publishers appear, or named; whoever carries the messages."""

    pause_s = 0.0  # between two looks at what has come

    def __init__(
        self,
        topics: Mapping[str, str] | None = None,
        base: str | None = None,
        namespace: str = "",
        camera: Camera | None = None,
        late_ms: float = 0.0,
    ) -> None:
        """topics: role -> topic, where it isn't found by its type. namespace: of this robot, whose topics come first.
        camera: of features in pixels, and of a head whose own pose a topic tells. late_ms: by which messages without a
        stamp are received later than measured. Raises InputError.
        """
        self._named = dict(topics or {})
        for role in self._named:
            if role not in ROLES:
                raise InputError(f"--topic {role}: is not known; one of {', '.join(ROLES)}")
        self._codec, self._namespace = Codec(), namespace
        self._reader, self._writer = RosReader(base, camera, late_ms), RosWriter(self._codec, namespace)
        self._seen: dict[str, Topic] = {}
        self._news_s = 0.0
        self._chosen: dict[str, set[str]] = {}  # roles by topic
        self._refused: Counter[str] = Counter()

    def hear(self, timeout_s: float) -> list[Heard]:
        """What has come; the first message is waited for."""
        ends_s = time.monotonic() + timeout_s
        while True:
            for name, kind in self._offered():
                if name not in self._seen:
                    self._seen[name] = Topic(name, kind, "cdr", None, 1)
                    self._news_s = time.monotonic()
            for topic in self._to_read():
                self._read(topic)
            for name, kind in self._answers():
                self._announce(name, kind)
            found = [heard for name, data in self._take(ends_s) for heard in self._heard(name, data)]
            found += self._reader.due()
            if found or time.monotonic() >= ends_s:
                return found
            time.sleep(self.pause_s)

    def publish(self, published: Published) -> None:
        """Publish an estimate."""
        for out in self._writer.published(published):
            self._write(out)

    @abstractmethod
    def close(self) -> None:
        """Leave the network."""

    @abstractmethod
    def _offered(self) -> Iterable[tuple[str, str]]:
        """Names and types, sensor_msgs/msg/Image, of what somebody publishes."""

    @abstractmethod
    def _read(self, topic: Topic) -> None:
        """Read a topic from now on."""

    @abstractmethod
    def _announce(self, name: str, kind: str) -> None:
        """Say that something will be published."""

    @abstractmethod
    def _take(self, ends_s: float) -> Iterable[tuple[str, bytes]]:
        """Topics and messages that have come, by `_in_order`. ends_s: until when they may be waited for."""

    @abstractmethod
    def _write(self, out: Outgoing) -> None:
        """Publish a message."""

    def around(self) -> str:
        """What is to be heard here, in words."""
        names = [f"{name} ({topic.type})" for name, topic in sorted(self._seen.items())]
        return f"topics that were found: {', '.join(names)[:600]}" if names else "no topic was found"

    @property
    def topics(self) -> dict[str, str]:
        """What is read: role -> topic."""
        return {role: name for name, roles in self._chosen.items() for role in roles}

    @property
    def refused(self) -> dict[str, int]:
        """What was left out so far, and how often."""
        return dict(self._refused + self._reader.refused)

    def _to_read(self) -> list[Topic]:
        """Topics that are to be read from now on: fixed ones at once, others once nothing new appears."""
        found = [(self._fixed(name), topic) for name, topic in self._seen.items() if name not in self._chosen]
        new = [(role, topic) for role, topic in found if role and FIXED_TYPES[role] == topic.type]
        if self._news_s and time.monotonic() > self._news_s + SETTLE_S:
            self._news_s = 0.0
            new += self._choose()
            read = {*self.topics, *(role for role, _ in new)}
            self._reader.odometry_by_transforms = ODOMETRY not in read | set(self._named)
        opened = {topic.name: topic for _, topic in new if topic.name not in self._chosen}
        for role, topic in new:
            self._chosen.setdefault(topic.name, set()).add(role)
            self._reader.expect(role)
        return list(opened.values())

    def _answers(self) -> list[tuple[str, str]]:
        """Topics and types that are published because of what is read."""
        detections = self.topics.get(DETECTIONS, "")
        if not detections.startswith(DETECTION_TOPIC):
            return []
        return [(self._writer.as_booster(detections.removeprefix(DETECTION_TOPIC)), BOOSTER_POSE_TYPE)]

    def _in_order(self) -> list[str]:
        """The topics that are read; where the camera is comes before what it saw."""
        return sorted(self._chosen, key=lambda name: not self._fixed(name))

    def _heard(self, name: str, data: bytes) -> Iterator[Heard]:
        """What a message says; what can't be used is counted."""
        roles, topic = self._chosen[name], self._seen[name]
        try:
            message = self._codec.decode(topic, data)
            for role in roles - ({COMPASS} if IMU in roles else set()):
                yield from self._reader.read(role, message, with_compass=COMPASS in roles)
        except UNUSABLE as error:
            count_refused(self._refused, f"a message of {name} that can't be used ({str(error)[:80]})")

    def _fixed(self, name: str) -> str | None:
        """The role of a topic that is known by its name, with or without the namespace."""
        return FIXED_TOPICS.get(name) or (FIXED_TOPICS.get(name.removeprefix(self._namespace)))

    def _choose(self) -> list[tuple[str, Topic]]:
        """What was found for each role that is still free."""
        named = {role: name for role, name in self._named.items() if name in self._seen}
        free = {name: topic for name, topic in self._seen.items() if not self._fixed(name)}
        own = {name: topic for name, topic in free.items() if name.startswith(f"{self._namespace}/")}
        own |= {name: free[name] for name in named.values() if name in free}
        waits = {role for role in self._named if role not in named}
        taken = set(self.topics)
        try:
            found = choose_topics(own, named, ProblemLog()) if self._namespace else {}
            found = found or choose_topics(free, named, ProblemLog())
        except InputError as error:
            self._refused[str(error)] += 1
            return []
        return [(role, topic) for role, topic in found.items() if role not in taken and role not in waits]
