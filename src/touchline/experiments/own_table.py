"""The table of `own`: one row for each figure, one column for each system."""

from __future__ import annotations

from collections.abc import Mapping

OWN = "touchline"
OTHERS = ("nubot-mti", "nubot-mcl", "iris-fusion")
SYSTEMS = (OWN, *OTHERS)
COLUMNS = ("what", "figure", "asked of touchline", *SYSTEMS, "touchline less the best other")
NONE = "–"


def row(what: str, figure: str, asked: str, told: Mapping[str, str], less: str = NONE) -> tuple[str, ...]:
    """A row. told: by system. less: ours less the best other's, paired."""
    return (what, figure, asked, *(told.get(system, NONE) for system in SYSTEMS), less)
