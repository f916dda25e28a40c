"""`touchline run` with many recordings: folders, journal, tables, what fails, and going on."""

from __future__ import annotations

import csv
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import weakref
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from numba.core import event

import touchline
from touchline.cli import main
from touchline.cli.console import announce_compiling
from touchline.cli.season import line_of
from touchline.errors import InputError, TouchlineError
from touchline.evaluation.workers import open_workers
from touchline.season import Command, find_recordings, is_season, localize_all
from touchline.season.recordings import folder_names, keep
from touchline.season.runs import JOURNAL
from touchline.season.tables import RUNS_CSV, write_estimates
from touchline.sources import BagOptions, open_source

NAMES = ("omni_msl_kidnap", "omni_msl_sun")


@pytest.fixture(scope="module")
def season(small_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings, and a broken one between them."""
    folder = tmp_path_factory.mktemp("season")
    for name in NAMES:
        shutil.copytree(small_data / name, folder / "games" / name)
    (folder / "games" / "broken").mkdir()
    (folder / "games" / "broken" / "sequence.yaml").write_text("format: 1\n")
    return folder


def rows_of(folder: Path) -> dict[str, dict[str, str]]:
    with (folder / RUNS_CSV).open(encoding="utf-8") as file:
        return {row["run"]: row for row in csv.DictReader(file)}


def run_many(season: Path, output: Path, *more: str) -> int:
    given = ["run", str(season / "games"), "--output", str(output), "--workers", "1", "--system", "nubot-mti"]
    return main([*given, "--report", "failed", *more])


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
    assert not (tmp_path / "out" / "broken").exists()
    for name in NAMES:
        alone = touchline.run(season / "games" / name, "nubot-mti", output=tmp_path / f"alone-{name}")
        lines = [(folder / "trajectory.tum").read_text() for folder in (tmp_path / "out" / name, alone.folder)]
        assert lines[0] == lines[1]
        assert alone.errors is not None
        assert float(rows[name]["position_mean_m"]) == pytest.approx(alone.errors.position.mean)
        assert int(rows[name]["images"]) == len(alone.estimates)
        assert not (tmp_path / "out" / name / "report.html").exists()


def test_no_picture_is_drawn_for_a_report_that_is_not_written(
    season: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("touchline.view.run_pictures.thumbnail", None)
    run_many(season, tmp_path / "out")
    assert [row["run"] for row in rows_of(tmp_path / "out").values() if row["failure"]] == ["broken"]


def test_what_was_cut_off_goes_on(season: Path, tmp_path: Path) -> None:
    run_many(season, tmp_path / "out")
    journal = tmp_path / "out" / JOURNAL
    lines = journal.read_text().splitlines(keepends=True)
    kept = [line for line in lines if f'"run": "{NAMES[1]}"' not in line]
    journal.write_text("".join(kept) + '{"run": "omni_msl_s')  # killed while it wrote
    before = (tmp_path / "out" / NAMES[0] / "summary.json").stat().st_mtime_ns
    (tmp_path / "out" / NAMES[1] / "trajectory.tum").write_text("half a li")
    assert run_many(season, tmp_path / "out") == 1
    assert (tmp_path / "out" / NAMES[0] / "summary.json").stat().st_mtime_ns == before
    assert len((tmp_path / "out" / NAMES[1] / "trajectory.tum").read_text().splitlines()) == 20
    assert {json.loads(line)["run"] for line in journal.read_text().splitlines()[1:]} == {"broken", *NAMES}


@pytest.mark.parametrize("kind", ["SIGINT", "SIGTERM"])
def test_one_worker_that_is_interrupted_leaves_no_row_and_goes_on(season: Path, tmp_path: Path, kind: str) -> None:
    script = tmp_path / "interrupted.py"
    script.write_text(
        "import os, signal, sys\nfrom touchline.cli import main\nfrom touchline.published.nubot_mti.system import NubotMti\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\nstep, steps = NubotMti.step, []\n"
        "def stopped(self, frame):\n    steps.append(frame)\n    if len(steps) == 5:\n"
        f"        os.kill(os.getpid(), signal.{kind})\n    return step(self, frame)\n"
        "NubotMti.step = stopped\nsys.exit(main())\n"
    )
    given = [
        "run",
        str(season / "games" / NAMES[1]),
        str(season / "games" / "broken"),
        "--output",
        str(tmp_path / "out"),
    ]
    given += ["--workers", "1", "--system", "nubot-mti"]
    ended = subprocess.run([sys.executable, str(script), *given], stderr=subprocess.PIPE, timeout=60, check=False)
    assert (ended.returncode, ended.stderr.decode().splitlines()[-1]) == (130, "error: interrupted")
    assert len((tmp_path / "out" / JOURNAL).read_text().splitlines()) == 1
    assert {path.name for path in (tmp_path / "out").iterdir()} == {JOURNAL, NAMES[1]}
    assert not (tmp_path / "out" / NAMES[1] / "report.html").exists()
    assert main(given) == 1
    assert rows_of(tmp_path / "out")[NAMES[1]]["images"] == "20"


def test_only_the_same_command_goes_on(season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "other").mkdir()
    assert run_many(season, tmp_path / "other") == 2
    assert "exists already" in capsys.readouterr().err
    (tmp_path / "out").mkdir()
    head = {"command": Command("nubot-mti", report="failed", bag=BagOptions().to_dict()).to_dict()}
    row = {"run": "final", "recording": "final", "inputs": "", "failure": ""}
    (tmp_path / "out" / JOURNAL).write_text(f"{json.dumps(head)}\n{json.dumps(row)}\n")
    assert run_many(season, tmp_path / "out", "--seed", "7") == 2
    assert "is of another command (other --seed)" in capsys.readouterr().err
    (tmp_path / "out" / JOURNAL).write_text("[]\n")
    assert run_many(season, tmp_path / "out") == 2
    assert "is no journal" in capsys.readouterr().err


class Noting:
    """A worker that notes the folders of what it is given, and says of each the same failure."""

    def __init__(self, failure: str = "") -> None:
        self.failure, self.targets = failure, []  # type: ignore[var-annotated]

    def map(self, function: Any, tasks: Any) -> Any:
        raise NotImplementedError

    def unordered(self, function: Any, tasks: Any, ended: Any) -> Any:
        for task in tasks:
            self.targets.append(task.target)
            Path(task.target).mkdir(exist_ok=True)
            yield {"run": Path(task.target).name, "recording": task.recording, "failure": self.failure}, None


COMMAND = Command("nubot-mti", report="none")


def test_rows_and_folders_of_other_recordings_stay(season: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "out")
    games = find_recordings([str(season / "games")])
    later = shutil.copytree(games[1], tmp_path / "day-2" / NAMES[0])
    localize_all(games[1:], out, COMMAND, Noting())
    worker = Noting()
    assert [row["run"] for row in localize_all([str(later)], out, COMMAND, worker)] == [f"{NAMES[0]}-2"]
    assert worker.targets == [f"{out}/{NAMES[0]}-2"]
    assert list(rows_of(tmp_path / "out")) == [*NAMES, f"{NAMES[0]}-2"]
    worker = Noting()
    localize_all([str(later), *games[1:]], out, COMMAND, worker)
    assert worker.targets == []


def test_paths_are_whole_ones(season: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(season / "games")
    (tmp_path / "linked").symlink_to(season / "games" / NAMES[1])
    assert find_recordings([NAMES[1], f"../games/{NAMES[1]}", str(tmp_path / "linked")]) == [
        str(season / "games" / NAMES[1]),
        str(tmp_path / "linked"),
    ]
    worker = Noting()
    localize_all(find_recordings([NAMES[1]]), os.path.relpath(tmp_path / "out"), COMMAND, worker)
    assert Path(worker.targets[0]).is_absolute()


def test_addresses_with_the_same_end_have_a_journal_each(
    season: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    given = ["run", str(season / "games" / NAMES[1]), "--workers", "1", "--system", "nubot-mti", "--report", "none"]
    for _ in range(2):
        for name in ("one", "two"):
            assert main([*given, "--output", f"file://{tmp_path}/{name}/results"]) == 0
            assert (tmp_path / name / "results" / NAMES[1] / "summary.json").is_file()
            shutil.rmtree(tmp_path / name / "results" / NAMES[1])  # is missed, and done again
    assert len(list((tmp_path / "runs").iterdir())) == 2
    given[1] = str(season / "games" / "broken")
    assert main([*given, "--output", f"file://{tmp_path}/three/results"]) == 1
    assert list(rows_of(tmp_path / "three" / "results")) == ["broken"]


def test_what_stands_at_an_address_is_replaced(tmp_path: Path) -> None:
    for name in ("old", "new"):
        (tmp_path / name).mkdir()
        (tmp_path / name / name).write_text("")
        keep(tmp_path / name, f"file://{tmp_path}/kept")
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["new"]


def test_a_store_that_nothing_is_installed_for_is_told_before_the_work(
    season: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing(address: str) -> None:
        raise ImportError("No module named 's3fs'")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("fsspec.core.url_to_fs", missing)
    assert main(["run", str(season / "games" / NAMES[1]), "--output", "s3://cup/results"]) == 2
    assert "s3://cup/results: needs pip install 'touchline[season]'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_folder_of_games_in_a_store_is_named_by_its_address(season: Path, tmp_path: Path) -> None:
    address = f"file://{season}/games"
    with open_workers() as here:
        (row,) = localize_all([address], str(tmp_path / "out"), COMMAND, here)
    assert row["failure"].startswith(f"{address}/sequence.yaml: is missing")


def test_a_folder_is_one_commands_at_a_time(season: Path, tmp_path: Path) -> None:
    game, out = str(season / "games" / NAMES[1]), str(tmp_path / "out")

    def again(left: int) -> None:
        with pytest.raises(InputError, match="out: another touchline run is at work here"):
            localize_all([game], out, COMMAND, Noting())

    assert len(localize_all([game], out, COMMAND, Noting(), on_begin=again)) == 1


def test_what_failed_or_has_no_folder_is_done_again(season: Path, tmp_path: Path) -> None:
    games, out = find_recordings([str(season / "games")]), str(tmp_path / "out")
    localize_all(games[:1], out, COMMAND, Noting("a store that was down"))
    localize_all(games[1:], out, COMMAND, Noting())
    shutil.rmtree(tmp_path / "out" / NAMES[1])
    worker, begun = Noting(), [0]
    localize_all(games, out, COMMAND, worker, on_begin=begun.append)
    assert worker.targets == [f"{out}/broken", f"{out}/{NAMES[1]}"]
    assert begun == [0, 2]
    assert not any(row["failure"] for row in rows_of(tmp_path / "out").values())


@pytest.mark.parametrize(
    ("more", "wrong"),
    [
        (["--set", "nosuch=1"], "unknown setting 'nosuch'"),
        (["--preset", "paperr"], "no preset 'paperr'"),
        (["--system", "nosuch"], "unknown system 'nosuch'"),
    ],
)
def test_a_mistake_in_the_command_is_told_once(
    season: Path, tmp_path: Path, more: list[str], wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_many(season, tmp_path / "out", *more) == 2
    assert wrong in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_another_report_is_the_same_command_and_versions_are_named(
    season: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    game, out = str(season / "games" / NAMES[1]), str(tmp_path / "out")
    localize_all([game], out, COMMAND, Noting())
    worker = Noting()
    localize_all([game], out, Command("nubot-mti"), worker)
    assert worker.targets == []
    monkeypatch.setattr("touchline.season.runs.version", lambda name: "77")
    with pytest.raises(InputError, match=r"other --set; touchline [\d.a-z]+, here 77; numpy .*, here 77; numba"):
        localize_all([game], out, Command("nubot-mti", overrides=("line_points.circles=20",)), worker)


def test_what_is_told_before_a_run_stands_in_its_row(season: Path, tmp_path: Path) -> None:
    game = shutil.copytree(season / "games" / NAMES[1], tmp_path / "game")
    lines = [line.split(",") for line in (game / "odometry.csv").read_text().splitlines()]
    scaled = [lines[0], *([t, str(1e3 * float(x)), str(1e3 * float(y)), *rest] for t, x, y, *rest in lines[1:])]
    (game / "odometry.csv").write_text("\n".join(map(",".join, scaled)))
    with open_workers() as here:
        (row,) = localize_all([str(game)], str(tmp_path / "out"), COMMAND, here)
    assert "millimetres" in row["notices"]
    assert "millimetres" in line_of(row)


def test_where_all_has_failed_another_command_begins(season: Path, tmp_path: Path) -> None:
    game, out = str(season / "games" / NAMES[1]), str(tmp_path / "out")
    localize_all([game], out, Command("nubot-mti", bag=BagOptions(camera=Path("nosuch.yaml")).to_dict()), Noting("no"))
    localize_all([game], out, COMMAND, Noting())
    assert not rows_of(tmp_path / "out")[NAMES[1]]["failure"]
    with pytest.raises(InputError, match="other --seed"):
        localize_all([game], out, Command("nubot-mti", seed=3), Noting())


def test_a_line_says_what_a_single_run_does() -> None:
    row = {"run": "a", "failure": "", "images": 64, "tracking": 50, "position_mean_m": 5.53, "end_open_images": 53}
    assert line_of({**row, "notices": "odometry.csv: looks like mm"}) == (
        "a: 64 images, 78 % tracked, 553.0 cm; in 53 the other end of the field fits as well; "
        "odometry.csv: looks like mm"
    )


def test_a_recording_that_has_changed_is_done_again(season: Path, tmp_path: Path) -> None:
    game = tmp_path / "game"
    shutil.copytree(season / "games" / NAMES[1], game)
    command = Command("nubot-mti", report="none")
    with open_workers() as here:
        localize_all([str(game)], str(tmp_path / "out"), command, here)
        done: list[str] = []
        localize_all([str(game)], str(tmp_path / "out"), command, here, lambda row, left: done.append(row["run"]))
        assert done == []
        (game / "odometry.csv").write_text((game / "odometry.csv").read_text() + "99.0,0,0,0\n")
        localize_all([str(game)], str(tmp_path / "out"), command, here, lambda row, left: done.append(row["run"]))
    assert done == ["game"]


def test_which_recordings_are_meant(season: Path, tmp_path: Path) -> None:
    games = season / "games"
    each = [str(games / name) for name in ("broken", *NAMES)]
    assert find_recordings([str(season)]) == each
    listed = season / "list.txt"
    listed.write_text(f"# the final\ngames/{NAMES[1]}\n\ns3://cup/final\n")
    assert find_recordings([str(listed), each[1]]) == [each[2], "s3://cup/final", each[1]]
    assert is_season([each[1]], "s3://cup/results")
    assert [is_season([text]) for text in (str(season), str(listed), "s3://cup/final", each[1], "nowhere")] == [
        *(True, True, True),
        *(False, False),
    ]
    (tmp_path / "empty.txt").write_text("\n")
    with pytest.raises(InputError, match="lists no recording"):
        find_recordings([str(tmp_path / "empty.txt")])
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="nor a folder that holds recordings"):
        find_recordings([str(tmp_path / "empty"), each[1]])
    assert folder_names(["a/final", "b/final", "c/final-2", "s3://cup/final"]) == [
        *("final", "final-2"),
        *("final-2-2", "final-3"),
    ]


def test_a_folder_of_bags_holds_many_recordings_and_that_of_a_split_bag_is_one(tmp_path: Path) -> None:
    for name in ("games/a.mcap", "games/day/b.mcap", "games/final/final_0.mcap", "games/final/final_1.mcap"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"\x89MCAP0\r\n")
    games = tmp_path / "games"
    assert is_season([str(games)])
    assert find_recordings([str(games)]) == [str(games / name) for name in ("a.mcap", "day/b.mcap", "final")]
    (games / "final" / "final_0.mcap").rename(games / "final" / "final.mcap")
    assert find_recordings([str(games / "final")]) == [
        str(games / "final" / name) for name in ("final.mcap", "final_1.mcap")
    ]
    with pytest.raises(InputError, match="holds bags, each a recording of its own"):
        open_source(games)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is an empty folder"):
        open_source(tmp_path / "empty")


@pytest.mark.parametrize(
    ("more", "wrong"),
    [
        (["--start", "0,0,0", "--output", "x"], "--start is for one recording"),
        ([], "--output is missing"),
        (["--output", "x", "--report", "some"], "'some' is not one of 'all', 'failed', 'none'"),
    ],
)
def test_wrong_calls(season: Path, more: list[str], wrong: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(season), *more]) == 2
    assert wrong in capsys.readouterr().err


def test_one_recording_has_no_report_if_none_is_wanted_and_no_workers(
    season: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = ["run", str(season / "games" / NAMES[1]), "--system", "nubot-mti", "--output", str(tmp_path / "out")]
    for more in (["--workers", "2"], ["--dask", "tcp://127.0.0.1:1"]):
        assert main([*one, *more]) == 2
        assert "are for many recordings" in capsys.readouterr().err
    assert main([*one, "--report", "failed"]) == 2
    assert "--report failed: is for many recordings" in capsys.readouterr().err
    assert main([*one, "--report", "none"]) == 0
    assert f"results: {tmp_path / 'out'}" in capsys.readouterr().out
    assert not (tmp_path / "out" / "report.html").exists()


def test_tables_of_columns(season: Path, tmp_path: Path) -> None:
    assert run_many(season, tmp_path / "out", "--set", "line_points.circles=20") == 1
    runs = pyarrow.parquet.read_table(tmp_path / "out" / "runs.parquet").to_pylist()
    assert [row["run"] for row in runs] == ["broken", *NAMES]
    assert runs[0]["images"] is None
    assert (runs[2]["ended"], runs[2]["end_open_images"], runs[2]["settings"]) == (
        *("complete", 0),
        "line_points.circles=20",
    )
    estimates = pyarrow.parquet.read_table(tmp_path / "out" / NAMES[1] / "estimates.parquet")
    assert estimates.num_rows == runs[2]["images"]
    assert {"stamp_ns", "x_m", "heading_rad", "status", "protection_m"} <= set(estimates.column_names)


def test_estimates_that_cannot_be_written_are_one_recordings_failure(
    season: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(folder: Path, table: object) -> None:
        if NAMES[0] in str(folder):
            raise OSError("no space left")
        write_estimates(folder, table)  # type: ignore[arg-type]

    monkeypatch.setattr("touchline.season.runs.write_estimates", full)
    assert run_many(season, tmp_path / "out") == 1
    rows = rows_of(tmp_path / "out")
    assert "no space left" in rows[NAMES[0]]["failure"]
    assert not rows[NAMES[1]]["failure"]
    assert (tmp_path / "out" / NAMES[1] / "estimates.parquet").exists()


def test_workers_need_no_pyarrow() -> None:
    code = "import sys, touchline.season.runs; sys.exit('pyarrow' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def end_itself(task: int) -> int:
    if task == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return task


def compile_for(task: int) -> int:
    with event.trigger_event("numba:compile"):
        return task


def test_that_workers_compile_is_said_once() -> None:
    said: queue.SimpleQueue[str] = queue.SimpleQueue()
    with announce_compiling(said.put), open_workers(2) as workers:
        assert list(workers.map(compile_for, range(4))) == [0, 1, 2, 3]
        assert said.get(timeout=10.0).startswith("compiling the inner loops")
    assert said.empty()


def test_a_task_that_ends_its_worker_is_not_the_end_of_the_others() -> None:
    with open_workers(2) as workers:
        found = list(workers.unordered(end_itself, range(12), lambda task: -task))
        assert sorted(found) == sorted(-k if k == 2 else k for k in range(12))
        with pytest.raises(TouchlineError, match="a worker was ended from outside"):
            list(workers.map(end_itself, range(4)))


def test_a_worker_that_ends_while_tasks_are_handed_out_is_not_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    submit = ProcessPoolExecutor.submit

    def slow(pool: ProcessPoolExecutor, function: Callable[[int], int], task: int) -> Future[int]:
        future = submit(pool, function, task)
        if task == 2:
            wait([future])
        return future

    monkeypatch.setattr(ProcessPoolExecutor, "submit", slow)
    with open_workers(2) as workers:
        found = list(workers.unordered(end_itself, range(6), lambda task: -task))
    assert sorted(found) == [-2, 0, 1, 3, 4, 5]


def test_results_are_not_kept() -> None:
    given: list[weakref.ref[Any]] = []
    with open_workers(2) as workers:
        for found in workers.unordered(np.ones, range(1, 9), np.zeros):
            given.append(weakref.ref(found))
            assert sum(one() is not None for one in given) <= 2  # this one, and the one before
    assert len(given) == 8


def test_workers_end_with_who_started_them(tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(
        "import os, signal\nfrom touchline.evaluation.workers import open_workers\n"
        "if __name__ == '__main__':\n    with open_workers(2) as workers:\n"
        "        print(list(workers.map(abs, [-7])), flush=True)\n        os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    # its output ends when the last process that has it ends
    said = subprocess.run([sys.executable, str(script)], stdout=subprocess.PIPE, timeout=60, check=False)
    assert (said.returncode, said.stdout) == (-signal.SIGKILL, b"[7]\n")


def test_whoever_interrupts_twice_does_not_wait_for_what_workers_have_at_hand(tmp_path: Path) -> None:
    script = tmp_path / "twice.py"
    script.write_text(
        "import os, signal, threading, time\nfrom touchline.evaluation.workers import open_workers\n"
        "if __name__ == '__main__':\n    signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "    with open_workers(2) as workers:\n        for _ in workers.map(time.sleep, [0, 100, 100]):\n"
        "            threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
        "            raise KeyboardInterrupt\n"
    )
    ended = subprocess.run([sys.executable, str(script)], stderr=subprocess.PIPE, timeout=60, check=False)
    assert ended.stderr.count(b"KeyboardInterrupt") >= 2
