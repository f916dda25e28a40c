"""The link to ROS 2: which topics are read, what their messages say, and what is published."""

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

from touchline.camera import Camera, PerspectiveCamera
from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.live.heard import Heard, Picture, Published, Reading, count_refused
from touchline.live.overlays import Overlays
from touchline.live.ros_node import RosNode
from touchline.live.ros_reader import FIXED_TOPICS, FIXED_TYPES, RosReader
from touchline.live.ros_writer import BOOSTER_POSE_TYPE, PLAYED, RosWriter
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.result_messages import OVERLAY, OWN, ResultMessages
from touchline.sources.bags.roles import (
    CAMERA_INFO,
    COMPASS,
    DETECTION_TOPIC,
    DETECTIONS,
    IMU,
    ODOMETRY,
    ROLES,
    choose_topics,
)
from touchline.sources.bags.standard import Frames
from touchline.sources.bags.with_rosbags import BadMessageError
from touchline.sources.problems import ProblemLog

SETTLE_S = 1.0  # after a publisher has appeared, until topics are chosen: others may still come
UNUSABLE = (BadMessageError, InputError, ValueError, TypeError, OverflowError, AttributeError, IndexError)
"""What a message that is none may raise where it is read."""


class RosOptions(NamedTuple):
    """topics: role -> topic, where it isn't found by its type. base: the robot's frame on the ground, None: by its
    usual names. field: that is shown. camera: of features in pixels, and of a head whose own pose a topic gives.
    late_ms: by which messages without a stamp are received later than measured. frames: of what is published.
    while_searching: the transform is published then, too; tf: at all.
    """

    topics: Mapping[str, str] = MappingProxyType({})
    base: str | None = None
    field: FieldModel | None = None
    camera: Camera | None = None
    late_ms: float = 0.0
    frames: Frames = Frames()
    while_searching: bool = False
    tf: bool = True


class RosLink:
    """A link whose topics are found by their types as publishers appear, or named; those of the node's namespace come
    first.
    """

    def __init__(self, node: RosNode, options: RosOptions | None = None) -> None:
        """Raises InputError."""
        options = options or RosOptions()
        self._named = dict(options.topics)
        for role in self._named:
            if role not in ROLES:
                raise InputError(f"--topic {role}: is not known; one of {', '.join(ROLES)}")
        self._node = node
        self._reader = RosReader(options.base, options.camera, options.late_ms)
        results = ResultMessages(node.codec, options.field, node.namespace)
        results.standard.frames = options.frames
        results.while_searching, results.with_tf = options.while_searching, options.tf
        self._writer, self._overlays = RosWriter(node.codec, results), Overlays(options.field)
        self._seen: dict[str, Topic] = {}
        self._news_s = 0.0
        self._chosen: dict[str, set[str]] = {}  # roles by topic
        self._refused: Counter[str] = Counter()
        results.wanted = node.wanted
        for topic, kind, latched in results.announced():
            node.announce(topic, kind, latched)
        for out in results.field():
            node.publish(out)

    def hear(self, timeout_s: float) -> list[Heard]:
        """What has come; the first message is waited for."""
        ends_s = time.monotonic() + timeout_s
        while True:
            for name, kind in self._node.offered():
                if name not in self._seen:
                    self._seen[name] = Topic(name, kind, "cdr", None, 1)
                    self._news_s = time.monotonic()
            for topic in self._to_read():
                self._node.read(topic.name, topic.type)
            for name, kind in self._answers():
                self._node.announce(name, kind)
            # where the camera is, and what it is, come before what it saw
            taken = sorted(self._node.take(ends_s), key=lambda each: self._order(each[0]))
            found = [heard for name, data in taken for heard in self._heard(name, data)]
            found += self._reader.due()
            if found or time.monotonic() >= ends_s:
                return found

    def publish(self, published: Published) -> None:
        """Publish an estimate."""
        for out in self._writer.published(published):
            self._node.publish(out)
        results = self._writer.results
        if published.frame is not None and self._node.wanted(results.namespace + OVERLAY):
            jpeg = self._overlays.picture(self._reader.camera, published.frame, published.estimate)
            if jpeg is not None:
                self._node.publish(results.overlay(max(published.estimate.stamp_ns, 0), jpeg))

    def close(self) -> None:
        """Leave the network."""
        self._node.close()

    def around(self) -> str:
        """What is to be heard here, in words."""
        names = [f"{name} ({topic.type})" for name, topic in sorted(self._seen.items())]
        found = f"topics that were found: {', '.join(names)[:600]}" if names else "no topic was found"
        return f"{found}; {self._node.around()}"

    @property
    def topics(self) -> dict[str, str]:
        """What is read: role -> topic."""
        return {role: name for name, roles in self._chosen.items() for role in roles}

    @property
    def refused(self) -> dict[str, int]:
        """What was left out so far, and how often."""
        return {**(self._refused + self._reader.refused), **self._node.refused}

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

    def _heard(self, name: str, data: bytes) -> Iterator[Heard]:
        """What a message says; what can't be used is counted."""
        roles, topic = self._chosen[name], self._seen[name]
        try:
            message = self._node.codec.decode(topic, data)
            for role in roles - ({COMPASS} if IMU in roles else set()):
                yield from self._reader.read(role, message, with_compass=COMPASS in roles)
        except UNUSABLE as error:
            count_refused(self._refused, f"a message of {name} that can't be used ({str(error)[:80]})")

    def _fixed(self, name: str) -> str | None:
        """The role of a topic that is known by its name, with or without the namespace."""
        return FIXED_TOPICS.get(name) or (FIXED_TOPICS.get(name.removeprefix(self._node.namespace)))

    def _order(self, name: str) -> int:
        """In which messages that came together are read: CameraInfo needs the transforms, an image needs both."""
        return 0 if self._fixed(name) else 1 if CAMERA_INFO in self._chosen[name] else 2

    def _choose(self) -> list[tuple[str, Topic]]:
        """What was found for each role that is still free."""
        named = {role: name for role, name in self._named.items() if name in self._seen}
        free = {name: topic for name, topic in self._seen.items() if not (self._fixed(name) or OWN in name)}
        own = {name: topic for name, topic in free.items() if name.startswith(f"{self._node.namespace}/")}
        own |= {name: free[name] for name in named.values() if name in free}
        waits = {role for role in self._named if role not in named}
        taken = set(self.topics)
        try:
            found = choose_topics(own, named, ProblemLog()) if self._node.namespace else {}
            found = found or choose_topics(free, named, ProblemLog())
        except InputError as error:
            self._refused[str(error)] += 1
            return []
        return [(role, topic) for role, topic in found.items() if role not in taken and role not in waits]


class RosRobot:
    """The robot's side: publishes what a recording holds. camera: of its images, where ROS has messages for it."""

    def __init__(self, node: RosNode, camera: PerspectiveCamera | None = None) -> None:
        """Announces everything and waits until listeners have found it."""
        self._node, self._writer = node, RosWriter(node.codec, camera=camera)
        for topic, kind in PLAYED.items():
            node.announce(topic, kind)
        time.sleep(2.0 * SETTLE_S)

    def send(self, event: Reading | Picture) -> None:
        """Publish a sample or an image."""
        for out in self._writer.played(event):
            self._node.publish(out)

    def close(self) -> None:
        """Send what is left, and leave the network."""
        for out in self._writer.rest():
            self._node.publish(out)
        self._node.close()
