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
