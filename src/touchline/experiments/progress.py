"""How far an experiment has come: told to whoever listens, the command line for one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")
Listener = Callable[[str], None]
_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def told_to(listener: Listener | None) -> Iterator[None]:
    """Within it, `listener` is told of every step of `follow`, as a short line of text."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def follow(items: Sequence[Item], what: str) -> Iterator[Item]:
    """The items one by one; before each the listener is told which of how many it is."""
    for number, item in enumerate(items, start=1):
        tell(f"{what}, {number} of {len(items)}")
        yield item


def tell(progress: str) -> None:
    """Say how far it has come, if anybody listens."""
    listener = _LISTENER.get()
    if listener is not None:
        listener(progress)
