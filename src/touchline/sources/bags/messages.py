"""What every kind of bag offers, and the one way messages are named inside."""

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple, Protocol


class Definition(NamedTuple):
    """A message definition that stands in the bag itself. language: `msg` or `idl`."""

    language: str
    text: str


class Topic(NamedTuple):
    """type: as ROS 2 writes it, sensor_msgs/msg/Image. encoding: `cdr` or `ros1`. definition: None where the bag holds
    none. messages: how many, as far as is known.
    """

    name: str
    type: str
    encoding: str
    definition: Definition | None
    messages: int


class Place(NamedTuple):
    """Where a message can be found again; what the numbers mean is known to its bag alone."""

    first: int
    second: int


class Message(NamedTuple):
    """topic: its name. log_ns: when it was received. data: as it was sent, without its copy."""

    topic: str
    log_ns: int
    data: bytes | memoryview
    place: Place


class Bag(Protocol):
    """Messages in the order in which they were received, read in constant memory."""

    @property
    def topics(self) -> Mapping[str, Topic]:
        """By name."""

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Those of some topics. What is damaged goes to the bag's problems."""

    def fetch(self, topic: str, place: Place) -> bytes | memoryview:
        """The data of one message; quick where it follows the one fetched before. Raises UnreadableError."""
