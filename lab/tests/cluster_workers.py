"""One core, two processes and a cluster of two workers give the same numbers: `make cluster`."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from distributed import LocalCluster

from touchline.cli import main
from touchline.compiling import load_loops_lean
from touchline.evaluation.workers import Here, Workers, open_workers
from touchline.packed_loops import take_packed_loops
from touchline_lab.experiments.harness import computed, progress_to
from touchline_lab.experiments.nees import CONDITIONS, Honesty, honesty

ROOT = Path(__file__).parents[2]
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


def table(capsys: pytest.CaptureFixture[str], *more: str) -> list[dict[str, float]]:
    """What bench says of two recordings, without the times."""
    recordings = [str(ROOT / "tests" / "data" / name) for name in ("omni_msl_track", "omni_msl_kidnap")]
    assert main(["bench", *recordings, "--system", "nubot-mti", "--json", *more]) == 0
    rows = json.loads(capsys.readouterr().out)["recordings"]
    return [{key: value for key, value in row.items() if key != "ms_per_image"} for row in rows]


def test_the_figures_of_recordings_are(capsys: pytest.CaptureFixture[str], scheduler: str) -> None:
    alone = table(capsys)
    assert table(capsys, "--workers", "2") == alone
    assert table(capsys, "--dask", scheduler) == alone


def robots(workers: Workers) -> list[Honesty]:
    """Three runs of an experiment."""
    with progress_to(None, workers):
        return list(computed(partial(honesty, CONDITIONS[0], "nubot-mti"), range(3), "robots"))


def test_the_runs_of_an_experiment_are(scheduler: str) -> None:
    alone = robots(Here())
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


def test_a_task_that_ends_its_workers_is_not_the_end_of_the_others(scheduler: str) -> None:
    with open_workers(dask=scheduler) as workers:
        found = list(workers.unordered(end_itself, range(5), lambda task: -task))
        assert sorted(found) == [-2, 0, 1, 3, 4]
        with pytest.raises(ValueError, match="twenty"):
            list(workers.unordered(end_itself, [20], lambda task: -task))
