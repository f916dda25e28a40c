"""Tasks by joblib: in this process, in several, or on a Dask cluster. The results are the same everywhere.

A task holds all that its result depends on, its seed included, so that no worker needs to know of another.
"""

import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from touchline.compiling import leave_out_c_wrappers, load_loops_lean
from touchline.errors import InputError, TouchlineError
from touchline.packed_loops import take_packed_loops

Task = TypeVar("Task")
Result = TypeVar("Result")
_MAX_WORKERS = 1024
_PARENT_EVERY_S = 0.5
_KILLED = "a worker was killed (is there too little memory?); take fewer workers"


@dataclass(frozen=True, slots=True)
class Workers:
    """So many processes, 1: this process alone; or the workers of a Dask client."""

    count: int = 1
    client: Any = None

    def map(self, function: Callable[[Task], Result], tasks: Sequence[Task], ordered: bool = True) -> Iterator[Result]:
        """The results, in the order of the tasks or as they come. function: of a module.

        Raises what a task raises, and TouchlineError if a worker is killed.
        """
        if self.client is not None:
            results = _on_cluster(self.client, function, tasks, ordered)
        elif self.count > 1:
            results = _in_processes(self.count, function, tasks, ordered)
        else:
            results = map(function, tasks)
        try:
            yield from results
        except Exception as error:
            if type(error).__name__ in ("TerminatedWorkerError", "KilledWorker"):  # joblib's and Dask's
                raise TouchlineError(_KILLED) from None
            raise


def _in_processes(
    count: int, function: Callable[[Task], Result], tasks: Sequence[Task], ordered: bool
) -> Iterator[Result]:
    from joblib import Parallel, delayed, parallel_config

    kind = "generator" if ordered else "generator_unordered"
    with parallel_config("loky", n_jobs=count, inner_max_num_threads=1):
        parallel = Parallel(
            return_as=kind, batch_size=1, max_nbytes=None, initializer=_begin_worker, initargs=(os.getpid(),)
        )
    results = parallel(delayed(function)(task) for task in tasks)
    try:
        for result in results:  # noqa: UP028  # yield from would close them before the warnings are off
            yield result
    finally:
        with warnings.catch_warnings():  # that tasks were canceled is known to who stops here
            warnings.simplefilter("ignore")
            results.close()


def _on_cluster(
    client: Any, function: Callable[[Task], Result], tasks: Sequence[Task], ordered: bool
) -> Iterator[Result]:
    """By Dask itself: joblib's backend for it waits forever for the results after a task that fails."""
    from distributed import as_completed

    futures = client.map(function, tasks, pure=False)
    for future in futures if ordered else as_completed(futures, loop=client.loop):
        yield future.result()
        future.release()  # the cluster need not keep the result until the last one is there


def _begin_worker(parent: int) -> None:
    """Ctrl-C is for the process that started it; if that is killed, nobody waits for this one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform != "win32":  # where a virtual environment's Python has another process between them
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    _prepare_loops()


def _prepare_loops() -> None:
    leave_out_c_wrappers()
    take_packed_loops()
    load_loops_lean()


def _begin_cluster_worker() -> None:
    os.environ.setdefault("NUMBA_OPT", "1")  # as the commands do; Dask itself keeps BLAS to one thread
    _prepare_loops()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_PARENT_EVERY_S)
    os._exit(1)


@contextmanager
def open_workers(count: int | None = 1, dask: str | None = None) -> Iterator[Workers]:
    """So many processes (None: all cores), or the cluster whose scheduler is at `dask` (tcp://HOST:PORT).

    On the machines of a cluster, Touchline and the files that tasks name have the same paths.
    Raises InputError for an impossible number, where Dask is not installed, and where no scheduler answers.
    """
    count = min(os.cpu_count() or 1, _MAX_WORKERS) if count is None else count
    if not 1 <= count <= _MAX_WORKERS:
        raise InputError(f"{count} workers: expected 1 to {_MAX_WORKERS}")
    if dask is None:
        yield Workers(count)
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError("--dask needs Dask, which is not installed: pip install 'touchline[season]'") from None
    try:
        client = Client(dask, timeout=5.0, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--dask {dask}: no scheduler answers there ({error}); expected tcp://HOST:PORT") from None
    with client:
        client.register_worker_callbacks(_begin_cluster_worker)
        yield Workers(-1, client)
