"""The topics of ROS 2 over Zenoh without ROS: keys, attachments and liveliness tokens as rmw_zenoh_cpp has them.

Where no router answers on this machine, as ROS's `rmw_zenohd` would, this is one.
"""

import itertools
import json
import os
import queue
import struct
import time
import weakref
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from typing import Any

import zenoh
import zenoh.ext
from rosbags.typesys import Stores, get_typestore

from touchline.errors import InputError
from touchline.live.dds_types import dds_name, ros_name
from touchline.live.ros_link import NODE, domain_id

_PORT, _ANSWER_MS = 7447, 300
_MAX_WAITING = 200
_UNKNOWN_HASH = "TypeHashNotSupported"
_TRANSIENT_LOCAL, _DEFAULT_QOS = ":1:,1:,:,:,,", "::,10:,:,:,,"  # what differs from ROS's defaults


class Zenoh:
    """The robot's topics over Zenoh, found by their publishers' liveliness tokens."""

    pause_s = 0.0

    def __init__(self, namespace: str = "", network: bool = False, name: str = NODE) -> None:
        """network: a router that is opened here is reached from other machines, too. ZENOH_CONFIG_OVERRIDE counts, as
        key=value;key=value. Raises InputError.
        """
        self._domain, self._names = domain_id(), itertools.count(1)
        self._session, self._where = _opened(network)
        self._close = weakref.finalize(self, self._session.close)  # the interpreter does not end while one is open
        zid, node = str(self._session.zid()), next(self._names)
        self._gid = bytes.fromhex(zid.zfill(32))
        space = (namespace or "/").replace("/", "%")
        self._token_head = f"@ros2_lv/{self._domain}/{zid}/{node}"
        self._token_tail = f"%/{space}/{name}"
        self._tokens = [self._alive(f"{self._token_head}/{node}/NN/{self._token_tail}")]
        self._came: queue.Queue[tuple[str, bytes]] = queue.Queue(_MAX_WAITING)
        self._found: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self._publishers: dict[str, tuple[Any, itertools.count[int]]] = {}
        self._readers: list[Any] = []
        self._lost = 0
        self._offers = self._session.liveliness().declare_subscriber(
            f"@ros2_lv/{self._domain}/*/*/*/MP/**", self._appeared, history=True
        )

    @property
    def refused(self) -> dict[str, int]:
        """What could not be carried."""
        return {"a message that came while too many were waiting": self._lost} if self._lost else {}

    def around(self) -> str:
        """Where it looks for topics, in words."""
        return f"domain {self._domain} (ROS_DOMAIN_ID), {self._where}"

    def close(self) -> None:
        """Leave the network."""
        self._close()

    def offered(self) -> Iterator[tuple[str, str]]:
        """Names and types of what others publish."""
        while not self._found.empty():
            yield self._found.get()

    def read(self, name: str, kind: str) -> None:
        """Read a topic from now on, whatever version of its type is published."""

        def came(sample: Any) -> None:
            try:
                self._came.put_nowait((name, sample.payload.to_bytes()))
            except queue.Full:
                self._lost += 1

        key = self._key(name, kind, "*")
        if name.endswith("/tf_static"):
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            self._readers.append(zenoh.ext.declare_advanced_subscriber(self._session, key, came, history=history))
        else:
            self._readers.append(self._session.declare_subscriber(key, came))
        self._announce_end("MS", name, kind, _DEFAULT_QOS)

    def take(self, ends_s: float) -> Iterator[tuple[str, bytes]]:
        """What has come."""
        try:
            yield self._came.get(timeout=min(max(ends_s - time.monotonic(), 0.0), 0.01))
            for _ in range(self._came.qsize()):
                yield self._came.get_nowait()
        except queue.Empty:
            return

    def announce(self, name: str, kind: str, latched: bool = False) -> None:
        """Say that something will be published. latched: those that come later receive the last one."""
        if name in self._publishers:
            return
        key = self._key(name, kind, _hash(kind))
        made: Any
        if latched:
            cache = zenoh.ext.CacheConfig(1)
            made = zenoh.ext.declare_advanced_publisher(self._session, key, cache=cache, publisher_detection=True)
        else:
            made = self._session.declare_publisher(key)
        self._publishers[name] = made, itertools.count(1)
        self._announce_end("MP", name, kind, _TRANSIENT_LOCAL if latched else _DEFAULT_QOS)

    def write(self, name: str, kind: str, data: bytes, latched: bool = False) -> None:
        """Publish a message."""
        self.announce(name, kind, latched)
        publisher, numbers = self._publishers[name]
        attachment = struct.pack("<qqB", next(numbers), time.time_ns(), len(self._gid)) + self._gid
        publisher.put(data, attachment=attachment)

    def wanted(self, name: str) -> bool:
        """Whether somebody reads what is published there."""
        publisher: Any = self._publishers[name][0] if name in self._publishers else None
        status = getattr(publisher, "matching_status", None)  # a latched one has none, and is written anyway
        return status is not None and bool(status.matching)

    def _appeared(self, sample: Any) -> None:
        """A token of a publisher: its topic and type; what is none of ROS's is left aside."""
        parts = str(sample.key_expr).split("/")
        if sample.kind == zenoh.SampleKind.PUT and len(parts) == 13 and parts[2] != str(self._session.zid()):
            kind = ros_name(parts[10])
            if kind is not None:
                self._found.put((parts[9].replace("%", "/"), kind))

    def _key(self, name: str, kind: str, version: str) -> str:
        return f"{self._domain}/{name.strip('/')}/{dds_name(kind)}/{version}"

    def _announce_end(self, end: str, name: str, kind: str, qos: str) -> None:
        """What `ros2 topic list` shows: MP of a publisher, MS of a subscriber."""
        topic = f"{name.replace('/', '%')}/{dds_name(kind)}/{_hash(kind)}"
        self._tokens.append(
            self._alive(f"{self._token_head}/{next(self._names)}/{end}/{self._token_tail}/{topic}/{qos}")
        )

    def _alive(self, key: str) -> Any:
        return self._session.liveliness().declare_token(key)


@cache
def _hash(kind: str) -> str:
    """The version of a type as ROS 2 computes it from Iron on (REP 2016)."""
    try:
        return str(get_typestore(Stores.ROS2_JAZZY).hash_rihs01(kind))
    except KeyError:
        return _UNKNOWN_HASH


def _opened(network: bool) -> tuple[Any, str]:
    """A session, and where its router is, in words. Raises InputError."""
    given = [each.partition("=") for each in os.environ.get("ZENOH_CONFIG_OVERRIDE", "").split(";") if "=" in each]
    own = {key.strip(): value.strip() for key, _, value in given}
    if own:
        return _session(own), "as ZENOH_CONFIG_OVERRIDE says"
    there = f"tcp/127.0.0.1:{_PORT}"
    client = {"mode": '"client"', "connect/endpoints": json.dumps([there]), "connect/timeout_ms": str(_ANSWER_MS)}
    with suppress(InputError):
        return _session(client), f"by the router at {there}"
    here = f"tcp/[::]:{_PORT}" if network else there
    router = {"mode": '"router"', "listen/endpoints": json.dumps([here])}
    return _session(router), f"no router was there, so this is one, at {here}"


def _session(settings: Mapping[str, str]) -> Any:
    config = zenoh.Config()
    try:
        for key, value in {"scouting/multicast/enabled": "false", **settings}.items():
            config.insert_json5(key, value)
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise InputError(f"--zenoh: {error}") from None
