"""Texts, and the header with which most messages begin, read without a decoder: quick, also of large images."""

import struct
from typing import NamedTuple


class Header(NamedTuple):
    """stamp_ns: 0 where the sender gave none. text: the string behind the header, `format` of a compressed image."""

    stamp_ns: int
    frame: str
    text: str


def read_header(data: bytes | memoryview, encoding: str) -> Header | None:
    """The header of a message in CDR or of ROS 1; None if it is too short to have one."""
    ros1 = encoding == "ros1"
    try:
        order = "<" if ros1 or data[1] & 1 else ">"
        base = 4
        seconds, rest = struct.unpack_from(f"{order}{'I' if ros1 else 'i'}I", data, base)
        at, frame = _string(data, order, base + 8)
        if not ros1:
            at = base + (at - base + 3) // 4 * 4
        try:
            text = _string(data, order, at)[1]
        except (struct.error, ValueError):
            text = ""
        return Header(seconds * 1_000_000_000 + rest, frame, text)
    except (struct.error, IndexError, ValueError):
        return None


def read_text(data: bytes | memoryview) -> str | None:
    """What a std_msgs/String in CDR says; None if it is none."""
    try:
        (length,) = struct.unpack_from("<I" if data[1] & 1 else ">I", data, 4)
        return None if length > len(data) - 8 or not length else str(data[8 : 7 + length], "utf-8")
    except (struct.error, IndexError, ValueError):
        return None


def _string(data: bytes | memoryview, order: str, at: int) -> tuple[int, str]:
    (length,) = struct.unpack_from(f"{order}I", data, at)
    if length > 1000 or at + 4 + length > len(data):
        raise ValueError("no string")
    return at + 4 + length, bytes(data[at + 4 : at + 4 + length]).rstrip(b"\0").decode("utf-8", errors="replace")
