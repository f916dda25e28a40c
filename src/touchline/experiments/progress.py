"""How far an experiment has come, told to whoever listens, the command line for one; and who computes its runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

from touchline.evaluation.workers import Here, Workers

Item = TypeVar("Item")
Result = TypeVar("Result")
Listener = Callable[[str], None]
_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)
_WORKERS: ContextVar[Workers] = ContextVar("workers", default=Here())  # noqa: B039  # it holds nothing


@contextmanager
def told_to(listener: Listener | None, workers: Workers | None = None) -> Iterator[None]:
    """Within it, `listener` is told of every step of `follow` and `computed`, as a short line of text.

    workers: who computes what is `computed`; None: this process.
    """
    token, hands = _LISTENER.set(listener), _WORKERS.set(workers or Here())
    try:
        yield
    finally:
        _LISTENER.reset(token)
        _WORKERS.reset(hands)


def follow(items: Sequence[Item], what: str) -> Iterator[Item]:
    """The items one by one; before each the listener is told which of how many it is."""
    for number, item in enumerate(items, start=1):
        tell(f"{what}, {number} of {len(items)}")
        yield item


def computed(function: Callable[[Item], Result], items: Sequence[Item], what: str) -> Iterator[Result]:
    """What a function of a module makes of each item, in their order, by whatever workers there are.

    Each result depends on its item alone. The listener is told which of how many is waited for.
    """
    results = _WORKERS.get().map(function, items)
    for number in range(1, len(items) + 1):
        tell(f"{what}, {number} of {len(items)}")
        yield next(results)


def tell(progress: str) -> None:
    """Say how far it has come, if anybody listens."""
    listener = _LISTENER.get()
    if listener is not None:
        listener(progress)
