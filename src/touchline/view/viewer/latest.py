"""Shown while a robot plays: in a thread of its own, so that localization does not wait for the viewer."""

from __future__ import annotations

import threading
from collections.abc import Callable

from touchline.types import Estimate, Frame


class LatestShown:
    """Hands frames to what shows them. While it is busy with one, only the latest of those that come waits."""

    def __init__(self, show: Callable[[Frame, Estimate], None]) -> None:
        self._show = show
        self._waiting: tuple[Frame, Estimate] | None = None
        self._ended = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="show", daemon=True)
        self._thread.start()

    def take(self, frame: Frame, estimate: Estimate) -> None:
        """Show it as soon as there is time, unless another one comes before."""
        with self._changed:
            self._waiting = frame, estimate
            self._changed.notify()

    def close(self) -> None:
        """Show what waits, and end."""
        with self._changed:
            self._ended = True
            self._changed.notify()
        self._thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._ended or self._waiting is not None)
                taken, self._waiting = self._waiting, None
            if taken is None:
                return
            self._show(*taken)
