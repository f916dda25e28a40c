"""Where frames come from: `open_source(path)` recognises the kind of recording by itself."""

from __future__ import annotations

from pathlib import Path

from touchline.sources.folder import SENSOR_FILES, Recording
from touchline.sources.problems import Problem, ProblemKind, ProblemLog
from touchline.sources.source import Source, Truth

__all__ = ["SENSOR_FILES", "Problem", "ProblemKind", "ProblemLog", "Recording", "Source", "Truth", "open_source"]


def open_source(path: str | Path, follow_links: bool = False) -> Recording:
    """Open a recording folder (docs/how-to-recording.md, format 1).

    follow_links: read what the recording names or links to outside of its folder, too.
    Raises InputError, naming file and line, when it can't be read at all. What can be survived is in `.problems`.
    """
    return Recording(Path(path), follow_links)
