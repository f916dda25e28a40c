"""Tasks on one core, on many, or on a cluster: the same results in the same order wherever they are computed.

A task holds all that its result depends on, its seed among it, so that no worker needs to know of another.
"""

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any, Protocol, TypeVar

from touchline.errors import InputError, TouchlineError

Task = TypeVar("Task")
Result = TypeVar("Result")
_MAX_WORKERS = 1024


class Workers(Protocol):
    """Whoever computes tasks."""

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """The results in the order of the tasks. function: of a module, not made on the way."""
        ...

    def unordered(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """The results as they come."""
        ...


class Here:
    """This process alone."""

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """One after the other."""
        return map(function, tasks)

    unordered = map


class _Pool:
    def __init__(self, executor: ProcessPoolExecutor) -> None:
        self._executor = executor

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        with _ended_told():
            yield from self._executor.map(function, tasks)

    def unordered(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        with _ended_told():
            for future in as_completed([self._executor.submit(function, task) for task in tasks]):
                yield future.result()


@contextmanager
def _ended_told() -> Iterator[None]:
    try:
        yield
    except BrokenProcessPool:
        raise TouchlineError("a worker was ended from outside (is there too little memory?); take fewer") from None


class _Cluster:
    def __init__(self, client: Any) -> None:
        self._client = client

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        for future in self._client.map(function, tasks, pure=False):
            yield future.result()

    def unordered(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        from distributed import as_completed as completed_there

        futures = self._client.map(function, tasks, pure=False)
        for future, result in completed_there(futures, loop=self._client.loop, with_results=True):
            future.release()  # the cluster need not keep it until the last one is there
            yield result


@contextmanager
def open_workers(count: int = 1, dask: str | None = None) -> Iterator[Workers]:
    """Workers for as long as the block lasts: this process, so many processes, or the cluster whose scheduler is at
    `dask` (tcp://HOST:PORT), on whose machines Touchline and the files that tasks name are found under the same paths.

    Raises InputError for a number of workers that is none, where Dask is not installed, and where no scheduler answers.
    """
    if not 1 <= count <= _MAX_WORKERS:
        raise InputError(f"{count} workers: expected 1 to {_MAX_WORKERS}")
    if dask is not None:
        with _client(dask) as client:
            yield _Cluster(client)
    elif count == 1:
        yield Here()
    else:
        # a Ctrl-C is for the process that hands out the tasks
        ignored, spawn = (signal.SIGINT, signal.SIG_IGN), get_context("spawn")
        executor = ProcessPoolExecutor(count, mp_context=spawn, initializer=signal.signal, initargs=ignored)
        try:
            yield _Pool(executor)
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask needs Dask, which is not installed: pip install 'touchline[tune]'") from None
    try:
        return Client(address, timeout=5.0, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--dask {address}: no scheduler answers there ({error}); expected tcp://HOST:PORT") from None
