"""A temporary folder that goes when its owner does."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from pathlib import Path


class TemporaryFolder:
    """A new folder, removed with all it holds when nobody holds this any more, at the latest when Python ends."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="touchline-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)
