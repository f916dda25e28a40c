"""The link over UDP: needs no ROS on this side; a bridge of forty lines on the robot's makes topics of it."""

import socket
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

from touchline.errors import InputError
from touchline.live.datagrams import Datagrams, image_datagrams, published_datagram, reading_datagram, seen_datagram
from touchline.live.heard import Heard, Picture, Published, Reading

LOOPBACK, PORT, ANSWERS_PORT = "127.0.0.1", 28400, 28401
_MAX_DATAGRAM = 65_536
_BUFFER_BYTES = 8_000_000  # of the kernel's: some images
_MAX_AT_ONCE = 1_000


class UdpLink:
    """Hears datagrams on one address and tells estimates to another. Raises InputError for an address that is none."""

    def __init__(
        self, here: tuple[str, int] = (LOOPBACK, PORT), there: tuple[str, int] = (LOOPBACK, ANSWERS_PORT)
    ) -> None:
        self._datagrams = Datagrams()
        self._there = resolved(there)
        self._in, self._out = bound(here), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.unheard = 0  # estimates that could not be sent

    @property
    def address(self) -> tuple[str, int]:
        """Where it hears."""
        host, port = self._in.getsockname()
        return str(host), int(port)

    def hear(self, timeout_s: float) -> list[Heard]:
        """What has come: the first message is waited for, the rest taken along."""
        found: list[Heard] = []
        for datagram in received(self._in, timeout_s):
            heard = self._datagrams.read(datagram)
            if heard is not None:
                found.append(heard)
        return found

    def publish(self, published: Published) -> None:
        """Send an estimate; nobody listening, or a network that is away, does no harm."""
        try:
            self._out.sendto(published_datagram(published), self._there)
        except OSError:
            self.unheard += 1

    @property
    def refused(self) -> dict[str, int]:
        """What was left out so far, and how often."""
        unheard = {"an estimate that could not be sent": self.unheard} if self.unheard else {}
        return {**self._datagrams.refused, **unheard}

    def around(self) -> str:
        """Where it listens, in words."""
        host, port = self.address
        return f"it listens for datagrams to {host}:{port}"

    def close(self) -> None:
        """Let go of both sockets."""
        self._in.close()
        self._out.close()


class UdpRobot:
    """The robot's side: sends what a recording holds."""

    def __init__(self, there: tuple[str, int] = (LOOPBACK, PORT)) -> None:
        """Raises InputError for an address that is none."""
        self._there = resolved(there)
        self._out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(self, event: Reading | Picture) -> None:
        """Send a sample or an image; nobody listening does no harm."""
        for datagram in _datagrams_of(event):
            with suppress(OSError):
                self._out.sendto(datagram, self._there)

    def close(self) -> None:
        """Let go of the socket."""
        self._out.close()


def _datagrams_of(event: Reading | Picture) -> Iterator[bytes]:
    if isinstance(event, Reading):
        yield reading_datagram(event)
    elif event.observation is not None:
        yield seen_datagram(replace(event.observation, stamp_ns=event.stamp_ns), event.base_from_camera)
    elif event.data is not None:
        yield from image_datagrams(event.stamp_ns, event.data, event.base_from_camera)


def resolved(there: tuple[str, int]) -> tuple[str, int]:
    """An address with its host as a number, asked for once. Raises InputError for a host that nobody knows."""
    try:
        found = socket.getaddrinfo(*there, family=socket.AF_INET, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        raise InputError(f"udp {there[0]}:{there[1]}: {getattr(error, 'strerror', None) or error}") from None
    host, port = found[0][4][:2]
    return str(host), int(port)


def bound(here: tuple[str, int], shared: bool = False) -> socket.socket:
    """A socket that hears on an address. shared: with other programs, which hear broadcasts there, too.

    Raises InputError for one that is taken, or not of this machine.
    """
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        for option in (socket.SO_REUSEADDR, socket.SO_REUSEPORT) if shared else ():
            opened.setsockopt(socket.SOL_SOCKET, option, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        opened.bind(here)
    except (OSError, OverflowError, UnicodeError) as error:
        opened.close()
        raise InputError(f"udp {here[0]}:{here[1]}: {getattr(error, 'strerror', None) or error}") from None
    return opened


def received(opened: socket.socket, timeout_s: float) -> Iterator[bytes]:
    """Datagrams that have come, the first one waited for."""
    opened.settimeout(timeout_s)
    for _ in range(_MAX_AT_ONCE):
        try:
            yield opened.recv(_MAX_DATAGRAM)
        except (TimeoutError, BlockingIOError):
            return
        except OSError:  # an answer that could not be delivered, told by the kernel
            return
        opened.setblocking(False)
