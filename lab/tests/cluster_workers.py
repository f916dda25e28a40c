"""One core, two processes and a cluster of two workers give the same numbers: `make cluster`."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from distributed import LocalCluster

from touchline.cli import main
from touchline.compiling import load_loops_lean
from touchline.errors import TouchlineError
from touchline.evaluation.workers import Workers, open_workers
from touchline.packed_loops import take_packed_loops
from touchline_lab.experiments.harness import computed, progress_to
from touchline_lab.experiments.nees import CONDITIONS, Honesty, honesty

SEARCH = ("--system", "nubot-mti", "--search", "matching.c_m=0.05:0.6:log", "--search", "matching.iterations=2:30")


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield str(cluster.scheduler_address)


def journal(folder: Path, *more: str) -> str:
    command = ["tune", "straight-tracks", "--seconds", "3", "--seeds", "2", "--trials", "8", *SEARCH]
    assert main([*command, "-o", str(folder), *more]) == 0
    return (folder / "trials.jsonl").read_text()


def test_a_search_is_the_same_on_one_core_on_many_and_on_a_cluster(tmp_path: Path, scheduler: str) -> None:
    alone = journal(tmp_path / "alone", "--workers", "1")
    assert journal(tmp_path / "many", "--workers", "2") == alone
    assert journal(tmp_path / "cluster", "--dask", scheduler) == alone


def robots(workers: Workers) -> list[Honesty]:
    """Three runs of an experiment."""
    with progress_to(None, workers):
        return list(computed(partial(honesty, CONDITIONS[0], "nubot-mti"), range(3), "robots"))


def test_the_runs_of_an_experiment_are(scheduler: str) -> None:
    alone = robots(Workers())
    for where in ((2, None), (1, scheduler)):
        with open_workers(*where) as workers:
            assert robots(workers) == alone


def has_begun(task: int) -> bool:
    known = take_packed_loops.cache_info().currsize + load_loops_lean.cache_info().currsize
    return known == 2 and os.environ["NUMBA_OPT"] == "1"


def test_workers_of_a_cluster_begin_as_those_of_this_machine(scheduler: str) -> None:
    with open_workers(dask=scheduler) as workers:
        assert all(workers.map(has_begun, range(4)))


def end_itself(task: int) -> int:
    if task == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 20:
        raise ValueError("twenty")
    return task


def test_a_task_that_ends_its_workers_or_fails_is_reported(scheduler: str) -> None:
    with open_workers(dask=scheduler) as workers:
        with pytest.raises(TouchlineError, match="a worker was killed"):
            list(workers.map(end_itself, range(5), ordered=False))
        with pytest.raises(ValueError, match="twenty"):
            list(workers.map(end_itself, [20]))
