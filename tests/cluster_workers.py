"""One core, two processes and a cluster of two workers give the same numbers: `make cluster`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import LocalCluster

from touchline.cli import main

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
    alone = journal(tmp_path / "alone")
    assert journal(tmp_path / "many", "--workers", "2") == alone
    assert journal(tmp_path / "cluster", "--dask", scheduler) == alone
