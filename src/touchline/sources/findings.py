"""What `touchline check` found: how bad, where, what, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Severity(StrEnum):
    """How much a finding matters. An error will spoil the localization, a warning may."""

    OK = "ok"
    NOTE = "note"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding. check: the name of the check that made it. where: a file, with line or frames if that helps.

    what: what was measured, in a sentence. advice: what to do; empty if there is nothing to do.
    """

    check: str
    severity: Severity
    where: str
    what: str
    advice: str = ""


def counted(count: int, noun: str) -> str:
    """`1 image`, `2 images`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def frames_in_words(frames: list[int], shown: int = 6) -> str:
    """`frame 3`, `frames 3, 4, 9 and 12 more`."""
    if len(frames) == 1:
        return f"frame {frames[0]}"
    words = ", ".join(str(frame) for frame in frames[:shown])
    return f"frames {words}" + (f" and {len(frames) - shown} more" if len(frames) > shown else "")
