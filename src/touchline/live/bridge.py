"""The topics of ROS 2 by the bridge of ros/touchline_ros, which runs in ROS's own Python and connects to here.

Each frame: its length (4 bytes), what it is (1), the lengths of topic and type (2 each), both names, and data; all
little-endian. The bridge says what is published (G), sends messages (M) and whether a topic is read (W). It is asked to
read (R), to announce (A; data 1: latched) and to publish (M).
"""

import select
import socket
import struct
import time
from collections import Counter
from collections.abc import Iterator

from touchline.errors import InputError
from touchline.live.heard import count_refused

PORT = 28402
_HEAD, _MAX_BYTES, _CHUNK = struct.Struct("<IcHH"), 100_000_000, 1_000_000
_SEND_S = 2.0  # until a bridge that takes nothing is let go


class Bridge:
    """Waits for the bridge, and for it again where it was lost; the newest one counts."""

    pause_s = 0.0

    def __init__(self, here: tuple[str, int] = ("127.0.0.1", PORT)) -> None:
        """Raises InputError for an address that is taken, or not of this machine."""
        self._here = here
        try:
            self._server = socket.create_server(here)
        except (OSError, OverflowError) as error:
            raise InputError(f"--bridge {here[0]}:{here[1]}: {getattr(error, 'strerror', None) or error}") from None
        self._bridge: socket.socket | None = None
        self._received = bytearray()
        self._found: list[tuple[str, str]] = []
        self._asked: dict[tuple[bytes, str], bytes] = {}  # said again to a bridge that comes later
        self._wanted: set[str] = set()
        self.refused: Counter[str] = Counter()

    @property
    def address(self) -> tuple[str, int]:
        """Where it waits."""
        host, port = self._server.getsockname()
        return str(host), int(port)

    def around(self) -> str:
        """Whether the bridge is there, in words."""
        where = "{}:{}".format(*self.address)
        return f"the bridge is connected to {where}" if self._bridge else f"no bridge has connected to {where}"

    def close(self) -> None:
        """Let go of the bridge."""
        self._leave()
        self._server.close()

    def offered(self) -> list[tuple[str, str]]:
        """Names and types of what others publish."""
        found, self._found = self._found, []
        return found

    def read(self, name: str, kind: str) -> None:
        """Have a topic read from now on."""
        self._ask(b"R", name, kind)

    def announce(self, name: str, kind: str, latched: bool = False) -> None:
        """Say that something will be published. latched: those that come later receive the last one."""
        if (b"A", name) not in self._asked:
            self._ask(b"A", name, kind, b"\1" if latched else b"\0")

    def write(self, name: str, kind: str, data: bytes, latched: bool = False) -> None:
        """Have a message published."""
        self.announce(name, kind, latched)
        if latched:
            self._ask(b"M", name, kind, data)
        else:
            self._send(frame(b"M", name, kind, data))

    def wanted(self, name: str) -> bool:
        """Whether somebody reads what is published there."""
        return name in self._wanted

    def take(self, ends_s: float) -> Iterator[tuple[str, bytes]]:
        """What the bridge has sent."""
        ends = [each for each in (self._server, self._bridge) if each is not None]
        ready = select.select(ends, [], [], min(max(ends_s - time.monotonic(), 0.0), 0.1))[0]
        if self._server in ready:
            self._welcome()
        elif ready and self._bridge is not None:
            try:
                received = self._bridge.recv(_CHUNK)
            except OSError:
                received = b""
            if received:
                self._received += received
            else:
                self._leave()
        yield from self._frames()

    def _frames(self) -> Iterator[tuple[str, bytes]]:
        try:
            for what, name, kind, data in frames(self._received):
                if what == b"M":
                    yield name, data
                elif what == b"G":
                    self._found.append((name, kind))
                elif what == b"W":
                    (self._wanted.add if data == b"\1" else self._wanted.discard)(name)
                else:
                    raise ValueError("a frame of no kind that is known")
        except ValueError as error:
            count_refused(self.refused, f"a bridge that was let go: {str(error)[:80]}")
            self._leave()

    def _welcome(self) -> None:
        self._leave()
        self._bridge = self._server.accept()[0]
        self._bridge.settimeout(_SEND_S)
        for asked in list(self._asked.values()):
            self._send(asked)

    def _leave(self) -> None:
        if self._bridge is not None:
            self._bridge.close()
        self._bridge = None
        self._received.clear()
        self._wanted.clear()

    def _ask(self, what: bytes, name: str, kind: str, data: bytes = b"") -> None:
        self._asked[what, name] = frame(what, name, kind, data)
        self._send(self._asked[what, name])

    def _send(self, whole: bytes) -> None:
        try:
            if self._bridge is not None:
                self._bridge.sendall(whole)
        except OSError:
            self._leave()


def frame(what: bytes, name: str, kind: str, data: bytes) -> bytes:
    """One frame."""
    topic, of = name.encode(), kind.encode()
    return _HEAD.pack(_HEAD.size + len(topic) + len(of) + len(data), what, len(topic), len(of)) + topic + of + data


def frames(received: bytearray) -> Iterator[tuple[bytes, str, str, bytes]]:
    """What, topic, type and data of each whole frame, which is taken away. Raises ValueError for what is none."""
    while len(received) >= _HEAD.size:
        length, what, topic, of = _HEAD.unpack_from(received)
        if not _HEAD.size + topic + of <= length <= _MAX_BYTES:
            raise ValueError(f"a frame of {length} bytes")
        if len(received) < length:
            return
        with memoryview(received) as view:
            name_at, kind_at = _HEAD.size + topic, _HEAD.size + topic + of
            name, kind = str(view[_HEAD.size : name_at], "utf-8"), str(view[name_at:kind_at], "utf-8")
            data = bytes(view[kind_at:length])
        del received[:length]
        yield what, name, kind, data
