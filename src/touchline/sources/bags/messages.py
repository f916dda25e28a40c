"""What every kind of bag offers, and the one way messages are named inside."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Hashable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from touchline.files.opened import UnreadableError
from touchline.sources.problems import ProblemKind, ProblemLog

if TYPE_CHECKING:
    from rosbags.interfaces import MessageDefinition


class Topic(NamedTuple):
    """type: as ROS 2 writes it, sensor_msgs/msg/Image. encoding: `cdr` or `ros1`. definition: of the bag itself, None
    where it holds none. messages: how many, as far as is known.
    """

    name: str
    type: str
    encoding: str
    definition: MessageDefinition | None
    messages: int


class Place(NamedTuple):
    """Where a message can be found again, in the order of the bag; what the numbers mean is known to its bag alone."""

    first: int
    second: int


class Message(NamedTuple):
    """topic: its name. log_ns: when it was received. data: as it was sent."""

    topic: str
    log_ns: int
    data: bytes
    place: Place


class Bag(ABC):
    """Messages in the order in which they were received, read in constant memory. Damage goes to `problems`."""

    def __init__(self, problems: ProblemLog) -> None:
        self._problems = problems
        self._reported: set[Hashable] = set()
        self._following: dict[str, Iterator[Message]] = {}  # the messages after the one fetched last

    @property
    @abstractmethod
    def topics(self) -> Mapping[str, Topic]:
        """By name."""

    @abstractmethod
    def messages(self, topics: Collection[str], start: Place | None = None) -> Iterator[Message]:
        """The messages of some topics, from a place on that one of them has."""

    def fetch(self, topic: str, place: Place) -> bytes:
        """The data of one message; quick where it follows the one fetched before. Raises UnreadableError."""
        following = self._following.pop(topic, None)
        message = None if following is None else next(following, None)
        if message is None or following is None or message.place != place:
            following = self.messages((topic,), place)
            message = next((message for message in following if message.place >= place), None)
        if message is None or message.place != place:
            raise UnreadableError(Path(topic), "a message is not where it was")
        self._following[topic] = following
        return message.data

    def _report(self, damage: Hashable, file: str, what: str) -> None:
        """Report damage once, however often the file is read."""
        if damage not in self._reported:
            self._reported.add(damage)
            self._problems.add(ProblemKind.BAG, file, what)
