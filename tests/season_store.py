"""A season in an object store and on a cluster, and the page's questions: `make season` (moto, s3fs, duckdb, dask)."""

from __future__ import annotations

import os
import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import duckdb
import fsspec
import pytest
from distributed import Client, LocalCluster
from moto.server import ThreadedMotoServer

from touchline.cli import main
from touchline.evaluation.workers import Workers, open_workers
from touchline.season import Command, localize_all

ROOT = Path(__file__).parents[1]
NAMES = ("omni_msl_kidnap", "omni_msl_sun", "omni_msl_match")
COMMAND = Command("nubot-mti", report="none")


@pytest.fixture(scope="module")
def games(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("season")
    for name in NAMES:
        shutil.copytree(ROOT / "tests" / "data" / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def alone(games: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The trajectories of one core."""
    output = tmp_path_factory.mktemp("alone") / "out"
    localize_all([str(games / name) for name in NAMES], str(output), COMMAND, Workers())
    return {name: (output / name / "trajectory.tum").read_text() for name in NAMES}


@pytest.fixture
def store(monkeypatch: pytest.MonkeyPatch) -> Iterator[fsspec.AbstractFileSystem]:
    server = ThreadedMotoServer(port=0)
    server.start()
    host, port = server.get_host_and_port()
    for name, value in (
        ("AWS_ACCESS_KEY_ID", "test"),
        ("AWS_SECRET_ACCESS_KEY", "test"),
        ("AWS_ENDPOINT_URL", f"http://{host}:{port}"),
        ("FSSPEC_S3_ENDPOINT_URL", f"http://{host}:{port}"),
    ):
        monkeypatch.setenv(name, value)
    system = fsspec.filesystem("s3", endpoint_url=f"http://{host}:{port}", skip_instance_cache=True)
    system.mkdir("cup")
    yield system
    server.stop()


def test_recordings_come_from_a_store_and_results_go_there(
    games: Path,
    alone: dict[str, str],
    store: fsspec.AbstractFileSystem,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in NAMES:
        store.put(str(games / name), f"cup/{name}", recursive=True)
    command = ["season", *(f"s3://cup/{name}" for name in NAMES), "--output", "s3://cup/results", "--workers", "1",
               "--system", "nubot-mti", "--report", "none"]  # fmt: skip
    assert main(command) == 0
    for name in NAMES:
        assert store.cat(f"cup/results/{name}/trajectory.tum").decode() == alone[name]
    store.pipe(f"cup/{NAMES[1]}/notes.txt", b"another file")  # is done again, in place of what is there
    assert main(command) == 0
    for name in NAMES:
        files = {file.rsplit("/", 1)[-1] for file in store.ls(f"cup/results/{name}", detail=False, refresh=True)}
        assert files == {"summary.json", "estimates.csv", "trajectory.tum"}
        assert store.cat(f"cup/results/{name}/trajectory.tum").decode() == alone[name]
    assert "omni_msl_sun" in store.cat("cup/results/runs.csv").decode()


def test_a_cluster_gives_the_same_numbers_though_a_worker_dies(
    games: Path, alone: dict[str, str], tmp_path: Path
) -> None:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        killed: list[int] = []

        def kill_one(row: object, left: int) -> None:
            if not killed:
                with Client(cluster) as client:
                    pids = client.run(os.getpid)
                killed.append(next(iter(pids.values())))
                os.kill(killed[0], signal.SIGKILL)

        with open_workers(1, str(cluster.scheduler_address)) as hands:
            recordings = [str(games / name) for name in NAMES]
            rows = localize_all(recordings, str(tmp_path / "out"), COMMAND, hands, kill_one)
    assert killed
    assert [row["failure"] for row in rows] == ["", "", ""]
    for name in NAMES:
        assert (tmp_path / "out" / name / "trajectory.tum").read_text() == alone[name]


def test_the_pages_questions_are_answered(games: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    localize_all([str(games / name) for name in NAMES], str(tmp_path / "out"), COMMAND, Workers())
    monkeypatch.chdir(tmp_path / "out")
    page = (ROOT / "docs" / "how-to-season.md").read_text(encoding="utf-8")
    database = duckdb.connect()
    answers = []
    for block in re.findall(r"```sql\n(.*?)```", page, re.DOTALL):
        for statement in block.split(";"):
            if statement.strip():
                answers.append(database.execute(statement).fetchall())
    assert len(answers) == 12
    assert answers[2][0][0] == "omni_msl_kidnap"  # the images without a pose are the black ones
