"""Tasks on one core, on many, or on a cluster: the same results in the same order wherever they are computed.

A task holds all that its result depends on, its seed among it, so that no worker needs to know of another.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import get_context, parent_process
from typing import Any, Protocol, TypeVar

from touchline.compiling import leave_out_c_wrappers, load_loops_lean
from touchline.errors import InputError, TouchlineError
from touchline.packed_loops import take_packed_loops

Task = TypeVar("Task")
Result = TypeVar("Result")
_MAX_WORKERS = 1024
ENDED = "a worker was ended from outside (is there too little memory?)"


class Workers(Protocol):
    """Whoever computes tasks."""

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """The results in the order of the tasks. function: of a module, not made on the way."""
        ...

    def unordered(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], ended: Callable[[Task], Result]
    ) -> Iterator[Result]:
        """The results as they come. ended: what stands for that of a task whose process was ended from outside.

        On a cluster: of one that was at hand in as many workers that ended as its scheduler allows, and in one more.
        """
        ...


class Here:
    """This process alone."""

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        """One after the other."""
        return map(function, tasks)

    def unordered(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], ended: Callable[[Task], Result]
    ) -> Iterator[Result]:
        """One after the other."""
        return map(function, tasks)


class _Pool:
    def __init__(self, count: int) -> None:
        self._count, self._context, self._is_closed = count, get_context("spawn"), False
        self._compiling = self._context.Event()
        threading.Thread(target=self._pass_on, daemon=True).start()
        self._open()

    def _open(self) -> None:
        self._executor = ProcessPoolExecutor(
            self._count, mp_context=self._context, initializer=_begin_worker, initargs=(self._compiling.set,)
        )

    def _pass_on(self) -> None:
        """Numba's event that a loop is compiled, of the first in any worker, here: whoever listens tells the user."""
        self._compiling.wait()
        if not self._is_closed:
            from numba.core import event

            with event.trigger_event("numba:compile"):
                pass

    def close(self) -> None:
        self._is_closed = True
        self._compiling.set()
        workers = list((self._executor._processes or {}).values())
        try:
            self._executor.shutdown(wait=True, cancel_futures=True)
        except BaseException:  # a second Ctrl-C: nobody would tell them to end, and Python's own end waits for them
            for worker in workers:
                worker.terminate()
            raise

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        try:
            yield from self._executor.map(function, tasks)
        except BrokenProcessPool:
            raise TouchlineError(f"{ENDED}; take fewer") from None

    def unordered(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], ended: Callable[[Task], Result]
    ) -> Iterator[Result]:
        rounds = [list(tasks)]
        while rounds:
            given = rounds.pop()
            numbers: dict[Future[Result], int] = {}
            with suppress(BrokenProcessPool):  # a worker may end while tasks are still handed out
                for task in given:
                    numbers[self._executor.submit(function, task)] = len(numbers)
            broken = list(range(len(numbers), len(given)))
            for future in as_completed(numbers):
                number = numbers.pop(future)  # which holds the result
                if isinstance(future.exception(), BrokenProcessPool):
                    broken.append(number)
                else:
                    yield future.result()
            left = [given[number] for number in sorted(broken)]
            if left:
                self._open()
            if len(given) == 1:
                yield from map(ended, left)
            elif left:  # the oldest were at hand, one more than workers: halves of them show whose fault it was
                suspects = min(len(left), self._count + 1)
                half = (suspects + 1) // 2
                rounds += [left[suspects:], left[half:suspects], left[:half]]


def _prepare_loops() -> None:
    leave_out_c_wrappers()
    take_packed_loops()
    load_loops_lean()


def _begin_worker(on_compiling: Callable[[], None]) -> None:
    """A Ctrl-C is for the process that hands out the tasks; if that is killed, nobody waits for this one."""
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            on_compiling()

        def on_end(self, event: Any) -> None: ...

    _prepare_loops()
    event.register("numba:compile", Listener())  # type: ignore[no-untyped-call]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _begin_cluster_worker() -> None:
    os.environ.setdefault("NUMBA_OPT", "1")  # as the commands do; Dask itself keeps BLAS to one thread
    _prepare_loops()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


class _Cluster:
    def __init__(self, client: Any) -> None:
        self._client = client

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[Result]:
        for future in self._client.map(function, tasks, pure=False):
            yield future.result()

    def unordered(
        self, function: Callable[[Task], Result], tasks: Sequence[Task], ended: Callable[[Task], Result]
    ) -> Iterator[Result]:
        from distributed import KilledWorker
        from distributed import as_completed as completed_there

        futures = self._client.map(function, tasks, pure=False)
        given = {future.key: task for future, task in zip(futures, tasks, strict=True)}
        results = completed_there(futures, loop=self._client.loop, with_results=True, raise_errors=False)
        for future, result in results:
            task = given.pop(future.key)
            if future.status == "error":
                error = future.exception()
                if not isinstance(error, KilledWorker):
                    raise error
                result = ended(task)
            future.release()  # the cluster need not keep it until the last one is there
            yield result


@contextmanager
def open_workers(count: int | None = 1, dask: str | None = None) -> Iterator[Workers]:
    """Workers for as long as the block lasts: this process, so many processes (None: all cores), or the
    cluster whose scheduler is at `dask` (tcp://HOST:PORT), on whose machines Touchline and the files that tasks name
    are found under the same paths.

    Raises InputError for a number of workers that is none, where Dask is not installed, and where no scheduler answers.
    """
    count = min(os.cpu_count() or 1, _MAX_WORKERS) if count is None else count
    if not 1 <= count <= _MAX_WORKERS:
        raise InputError(f"{count} workers: expected 1 to {_MAX_WORKERS}")
    if dask is not None:
        with _client(dask) as client:
            yield _Cluster(client)
    elif count == 1:
        yield Here()
    else:
        pool = _Pool(count)
        try:
            yield pool
        finally:
            pool.close()


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask needs Dask, which is not installed: pip install 'touchline[tune]'") from None
    try:
        client = Client(address, timeout=5.0, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--dask {address}: no scheduler answers there ({error}); expected tcp://HOST:PORT") from None
    client.register_worker_callbacks(_begin_cluster_worker)
    return client
