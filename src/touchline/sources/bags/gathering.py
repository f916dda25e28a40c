"""What several topics say of the same image, brought together by its stamp."""

from collections.abc import Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class Gathering(Generic[T]):
    """Holds what was said of an image until all parts have been heard, or will not say more, or time is up.

    A part that has spoken of a later image says no more of an earlier one. wait_ns: how long the slower part is waited
    for, on whatever clock `now_ns` is of.
    """

    def __init__(self, wait_ns: int) -> None:
        self._wait_ns = wait_ns
        self._newest: dict[str, int] = {}  # by part
        self._held: dict[int, tuple[int, set[str], list[T]]] = {}  # by stamp: since when, by whom, what
        self._last_ns: int | None = None
        self.late = 0  # messages that came too late

    def add(self, part: str, stamp_ns: int, items: list[T], now_ns: int) -> None:
        """A part has found these in the image of a stamp."""
        self._newest[part] = max(stamp_ns, self._newest.get(part, stamp_ns))
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            self.late += 1
            return
        _, parts, held = self._held.setdefault(stamp_ns, (now_ns, set(), []))
        parts.add(part)
        held.extend(items)

    def expect(self, part: str) -> None:
        """A part that has not been heard yet is waited for, too."""
        self._newest.setdefault(part, -(2**63))

    def ready(self, now_ns: int) -> Iterator[tuple[int, list[T]]]:
        """Stamps and what was found, in the order of time."""
        for stamp_ns in sorted(self._held):
            since_ns, parts, held = self._held[stamp_ns]
            complete = all(part in parts or newest > stamp_ns for part, newest in self._newest.items())
            if not complete and now_ns - since_ns < self._wait_ns:
                return
            del self._held[stamp_ns]
            self._last_ns = stamp_ns
            yield stamp_ns, held

    def rest(self) -> Iterator[tuple[int, list[T]]]:
        """What is held still, at the end."""
        for stamp_ns in sorted(self._held):
            yield stamp_ns, self._held.pop(stamp_ns)[2]
