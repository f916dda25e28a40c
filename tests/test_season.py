"""`touchline season`: a run folder for each recording and a table of all, what fails, and resuming."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import touchline
from touchline.cli import main
from touchline.errors import InputError, TouchlineError
from touchline.evaluation.workers import Workers, open_workers
from touchline.season import Command, find_recordings, localize_all
from touchline.season.recordings import folder_names
from touchline.season.table import CSV, Row
from touchline.sources import BagOptions, open_source

NAMES = ("omni_msl_kidnap", "omni_msl_sun")
COMMAND = Command("nubot-mti", report="none")
HERE = Workers()


@pytest.fixture(scope="module")
def season(small_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings, and a broken one between them."""
    folder = tmp_path_factory.mktemp("season")
    for name in NAMES:
        shutil.copytree(small_data / name, folder / "games" / name)
    (folder / "games" / "broken").mkdir()
    (folder / "games" / "broken" / "sequence.yaml").write_text("format: 1\n")
    return folder


@pytest.fixture
def noted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The runs that are begun, in place of running them; "down" in a recording's path is a failure."""
    begun: list[str] = []

    def note(task: object) -> Row:
        recording, target, _ = task  # type: ignore[misc]
        begun.append(Path(target).name)
        return {"run": begun[-1], "recording": recording, "failure": "down" if "broken" in recording else ""}

    monkeypatch.setattr("touchline.season.runs.localize_one", note)
    return begun


def rows_of(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / CSV).open(encoding="utf-8") as file:
        return {row["run"]: row for row in csv.DictReader(file)}


def run_many(season: Path, output: Path, *more: str) -> int:
    given = ["season", str(season / "games"), "--output", str(output), "--workers", "1", "--system", "nubot-mti"]
    return main([*given, "--report", "failed", *more])


@pytest.mark.slow
def test_each_has_a_folder_and_a_row_and_one_failure_is_not_the_end(
    season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_many(season, tmp_path / "out") == 1
    said = capsys.readouterr()
    assert "3 recordings, 1 failed" in said.out
    assert "broken: failed: " in said.err
    rows = rows_of(tmp_path / "out")
    assert list(rows) == ["broken", *NAMES]
    assert "key 'camera' is missing" in rows["broken"]["failure"]
    for name in NAMES:
        alone = touchline.run(season / "games" / name, "nubot-mti", output=tmp_path / f"alone-{name}")
        lines = [(folder / "trajectory.tum").read_text() for folder in (tmp_path / "out" / name, alone.folder)]
        assert lines[0] == lines[1]
        assert alone.errors is not None
        assert float(rows[name]["position_mean_m"]) == pytest.approx(alone.errors.position.mean)
        assert int(rows[name]["images"]) == len(alone.estimates)
        assert not (tmp_path / "out" / name / "report.html").exists()


@pytest.mark.slow
def test_two_workers_give_the_same_rows_and_do_nothing_twice(season: Path, tmp_path: Path) -> None:
    games = find_recordings([str(season / "games")])
    alone = localize_all(games, str(tmp_path / "alone"), COMMAND, HERE)
    with open_workers(2) as workers:
        rows = localize_all(games, str(tmp_path / "two"), COMMAND, workers)
    times = ("started", "rate_images_s", "time_median_ms", "time_p99_ms")
    assert [{k: v for k, v in row.items() if k not in times} for row in rows] == [
        {k: v for k, v in row.items() if k not in times} for row in alone
    ]
    done: list[Row] = []
    localize_all(games[1:], str(tmp_path / "two"), COMMAND, HERE, lambda row, left: done.append(row))
    assert done == []


@pytest.mark.slow
def test_what_was_killed_is_resumed_and_no_row_is_lost_or_twice(season: Path, tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(
        "import os, signal, sys\nfrom touchline.cli import main\n"
        "from touchline.published.nubot_mti.system import NubotMti\n"
        "step, steps = NubotMti.step, []\n"
        "def stopped(self, frame):\n    steps.append(frame)\n    if len(steps) == 50:\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n    return step(self, frame)\n"
        "NubotMti.step = stopped\nsys.exit(main())\n"
    )
    given = ["season", str(season / "games"), "-o", str(tmp_path / "out"), "--workers", "1", "--system", "nubot-mti"]
    ended = subprocess.run([sys.executable, str(script), *given], timeout=300, check=False)
    assert ended.returncode == -signal.SIGKILL
    assert list(rows_of(tmp_path / "out")) == ["broken", NAMES[0]]
    before = (tmp_path / "out" / NAMES[0] / "summary.json").stat().st_mtime_ns
    assert main(given) == 1
    assert list(rows_of(tmp_path / "out")) == ["broken", *NAMES]
    assert (tmp_path / "out" / NAMES[0] / "summary.json").stat().st_mtime_ns == before
    assert len((tmp_path / "out" / NAMES[1] / "trajectory.tum").read_text().splitlines()) == 20


def test_only_the_same_command_resumes(
    season: Path, tmp_path: Path, noted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "other").mkdir()
    game = [str(season / "games" / NAMES[1])]
    with pytest.raises(InputError, match="exists already"):
        localize_all(game, str(tmp_path / "other"), COMMAND, HERE)
    (tmp_path / "other" / CSV).write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="is no table of touchline season"):
        localize_all(game, str(tmp_path / "other"), COMMAND, HERE)
    out = str(tmp_path / "out")
    localize_all(game, out, COMMAND, HERE)
    localize_all(game, out, Command("nubot-mti"), HERE)  # another report is the same command
    assert noted == [NAMES[1]]
    with pytest.raises(InputError, match="is of another command \\(seed 0, here 7\\)"):
        localize_all(game, out, Command("nubot-mti", seed=7), HERE)
    monkeypatch.setattr("touchline.season.runs.version", lambda name: "77")
    with pytest.raises(InputError, match=r"overrides \[\], .*; touchline [\d.a-z]+, here 77; numpy .*, here 77; numba"):
        localize_all(game, out, Command("nubot-mti", overrides=("line_points.circles=20",)), HERE)


def test_what_failed_or_changed_is_done_again_and_other_rows_stay(
    season: Path, tmp_path: Path, noted: list[str]
) -> None:
    games, out = find_recordings([str(season / "games")]), str(tmp_path / "out")
    later = str(shutil.copytree(games[1], tmp_path / "day-2" / NAMES[0]))
    localize_all(games[:1], out, Command("nubot-mti", bag=BagOptions(camera=Path("nosuch.yaml")).to_dict()), HERE)
    localize_all(games, out, COMMAND, HERE)  # where all has failed, another command may begin
    assert noted == ["broken", "broken", *NAMES]
    localize_all([later], out, COMMAND, HERE)
    assert noted[4:] == [f"{NAMES[0]}-2"]
    assert list(rows_of(tmp_path / "out")) == ["broken", *NAMES, f"{NAMES[0]}-2"]
    (Path(later) / "notes.txt").write_text("another file")
    assert [row["run"] for row in localize_all([later, *games], out, COMMAND, HERE)] == [
        *(f"{NAMES[0]}-2", "broken"),
        *NAMES,
    ]
    assert noted[5:] == [f"{NAMES[0]}-2", "broken"]


def test_a_folder_is_one_commands_at_a_time(season: Path, tmp_path: Path, noted: list[str]) -> None:
    game, out = [str(season / "games" / NAMES[1])], str(tmp_path / "out")

    def again(row: Row, left: int) -> None:
        with pytest.raises(InputError, match="out: another touchline season is at work here"):
            localize_all(game, out, COMMAND, HERE)

    assert len(localize_all(game, out, COMMAND, HERE, again)) == 1


@pytest.mark.slow
def test_results_go_to_an_address_and_are_resumed_there(season: Path, tmp_path: Path) -> None:
    address = f"file://{tmp_path}/results"
    game = f"file://{season}/games/{NAMES[1]}"
    given = ["season", game, "--workers", "1", "--system", "nubot-mti", "--report", "none", "--output", address]
    assert main(given) == 0
    before = (tmp_path / "results" / NAMES[1] / "summary.json").stat().st_mtime_ns
    assert main(given) == 0
    assert (tmp_path / "results" / NAMES[1] / "summary.json").stat().st_mtime_ns == before
    assert list(rows_of(tmp_path / "results")) == [NAMES[1]]
    (row,) = localize_all([f"file://{season}/games"], str(tmp_path / "out"), COMMAND, HERE)
    assert row["failure"].startswith(f"file://{season}/games/sequence.yaml: is missing")


def test_a_store_that_nothing_is_installed_for_is_told_before_the_work(
    season: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(address: str) -> None:
        raise ImportError("No module named 's3fs'")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("fsspec.core.url_to_fs", missing)
    assert main(["season", str(season / "games" / NAMES[1]), "--output", "s3://cup/results"]) == 2
    assert "needs pip install 'touchline[season]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("more", "wrong"),
    [
        (["--set", "nosuch=1"], "unknown setting 'nosuch'"),
        (["--preset", "paperr"], "no preset 'paperr'"),
        (["--system", "nosuch"], "unknown system 'nosuch'"),
        (["--report", "some"], "'some' is not one of 'all', 'failed', 'none'"),
    ],
)
def test_a_mistake_in_the_command_is_told_once(
    season: Path, tmp_path: Path, more: list[str], wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_many(season, tmp_path / "out", *more) == 2
    assert wrong in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_which_recordings_are_meant(
    season: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    games = season / "games"
    each = [str(games / name) for name in ("broken", *NAMES)]
    assert find_recordings([str(season)]) == each
    assert find_recordings([each[2], "s3://cup/final/", each[1]]) == [each[2], "s3://cup/final", each[1]]
    monkeypatch.chdir(games)
    (tmp_path / "linked").symlink_to(each[2])
    assert find_recordings([NAMES[1], f"../games/{NAMES[1]}", str(tmp_path / "linked")]) == [
        each[2],
        str(tmp_path / "linked"),
    ]
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="nor a folder that holds recordings"):
        find_recordings([str(tmp_path / "empty"), each[1]])
    assert folder_names(["a/final", "b/final", "c/final-2", "s3://cup/final"], {}) == [
        *("final", "final-2"),
        *("final-2-2", "final-3"),
    ]


def test_a_folder_of_bags_holds_many_recordings_and_that_of_a_split_bag_is_one(tmp_path: Path) -> None:
    for name in ("games/a.mcap", "games/day/b.mcap", "games/final/final_0.mcap", "games/final/final_1.mcap"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"\x89MCAP0\r\n")
    games = tmp_path / "games"
    assert find_recordings([str(games)]) == [str(games / name) for name in ("a.mcap", "day/b.mcap", "final")]
    with pytest.raises(InputError, match="holds bags, each a recording of its own"):
        open_source(games)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is an empty folder"):
        open_source(tmp_path / "empty")


def end_itself(task: int) -> int:
    if task == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


@pytest.mark.slow
def test_a_worker_that_is_killed_is_reported_and_the_next_tasks_are_done() -> None:
    with open_workers(2) as workers:
        with pytest.raises(TouchlineError, match="a worker was killed"):
            list(workers.map(end_itself, range(12)))
        assert sorted(workers.map(abs, range(-3, 3), ordered=False)) == [0, 1, 1, 2, 2, 3]
