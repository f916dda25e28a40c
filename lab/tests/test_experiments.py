"""touchline experiment: the frame, and the figures that each experiment must reach, with fewer runs than by default."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from touchline.cli import main
from touchline.errors import InputError
from touchline_lab.experiments import (
    EXPERIMENTS,
    Experiment,
    ExperimentResult,
    chosen_experiments,
    harness,
)
from touchline_lab.experiments.harness import (
    NOTHING,
    RUNS,
    Headline,
    Kept,
    interval,
    percent,
    progress_to,
    rate,
    result_page,
    resumed,
    seed_range,
    spread,
    wilson,
    with_row,
    write_result,
)


def result(name: str = "one", ours: str = "1 cm") -> ExperimentResult:
    figure = Figure(figsize=(1, 1))
    return ExperimentResult(
        "A title", ("what", "paper", "ours"), (("mean | max", "2", "1"),), Headline("mean", "2 cm", ours), ("A note.",),
        (("map", figure),), name, 5,
    )  # fmt: skip


# --- the frame --------------------------------------------------------------------------------------------------------


def test_spread_is_mean_and_standard_deviation_over_the_seeds() -> None:
    assert spread([1.0, 2.0, 3.0]) == "2.00 ± 1.00"
    assert spread([2.5]) == "2.50"
    assert percent([0.98, 1.0]) == "99.0 ± 1.4 %"


def test_rates_have_wilsons_interval_and_means_one_by_bootstrap() -> None:
    assert rate(40, 40) == "100.0 % [91.2, 100.0]"
    assert rate(0, 10) == "0.0 % [0.0, 27.8]"
    assert wilson(8, 10) == pytest.approx((0.490, 0.943), abs=1e-3)
    low, high = (float(v) for v in interval(np.arange(10.0)).partition("[")[2].rstrip("]").split(", "))
    assert low == pytest.approx(2.7, abs=0.25)
    assert high == pytest.approx(6.3, abs=0.25)
    assert interval([2.5]) == "2.50"


def test_a_run_replaces_its_row_of_the_results_and_keeps_the_others_in_order() -> None:
    page = with_row(with_row("", result("b")), result("a"), ["a", "b"])
    again = with_row(page, result("b", "3 cm"), ["a", "b"])
    rows = [line for line in again.splitlines() if line.startswith("| [")]
    assert [row[3:4] for row in rows] == ["a", "b"]
    assert "3 cm" in rows[1]
    assert "1 cm" not in rows[1]


def test_every_file_of_a_result_is_written_and_named(tmp_path: Path) -> None:
    files = write_result(result(), tmp_path / "results")
    assert [path.name for path in files] == ["one.md", "one-map.png", "results.md"]
    assert all(path.stat().st_size > 0 for path in files)
    page = files[0].read_text(encoding="utf-8")
    assert "![one](one-map.png)" in page
    assert "mean \\| max" in page
    assert page == result_page(result(), ["one-map.png"])


def test_a_folder_that_cannot_be_written_is_told_plainly(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="--output"):
        write_result(result(), tmp_path / "file" / "results")


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_tells_how_far_it_has_come(name: str) -> None:
    """The first thing of all is told before anything takes long: whoever hears it can end the experiment."""

    class HeardError(Exception):
        pass

    heard: list[str] = []

    def listen(progress: str) -> None:
        heard.append(progress)
        raise HeardError

    with pytest.raises(HeardError):
        EXPERIMENTS[name].run(3, listen)
    assert re.fullmatch(r"[a-z ]+, 1 of \d+", heard[0])


def test_seeds_begin_where_they_are_asked_to() -> None:
    with progress_to(None, first_seed=7):
        assert list(seed_range(3)) == [7, 8, 9]
        assert list(seed_range(2, 10)) == list(range(70, 90))
    assert list(seed_range(2)) == [0, 1]
    first, later = (EXPERIMENTS["schulz-imu"].run(1, first_seed=first) for first in (0, 3))
    assert (later.seeds, later.first_seed) == (1, 3)
    assert first.rows != later.rows
    assert with_row("", later).splitlines()[-1].endswith("| 1 from 3 |")


def test_all_goes_on_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a folder holds of these seeds by this commit is left; other seeds are run."""
    runs: list[tuple[str, int, int]] = []

    def run(self: Experiment, seeds: int, *_: object, first_seed: int) -> ExperimentResult:
        runs.append((self.name, seeds, first_seed))
        return replace(result(self.name), first_seed=first_seed)

    monkeypatch.setattr(Experiment, "run", run)
    monkeypatch.setattr("touchline_lab.experiments.EXPERIMENTS", {name: EXPERIMENTS[name] for name in ("own", "nees")})
    command = ["experiment", "all", "--output", str(tmp_path), "--seeds", "2"]
    assert main(command) == 0
    (tmp_path / RUNS).write_text("".join((tmp_path / RUNS).read_text().splitlines(keepends=True)[:1]))
    assert main(command) == 0
    assert runs == [("own", 2, 0), ("nees", 2, 0), ("nees", 2, 0)]
    assert "own: done before" in capsys.readouterr().out
    assert main([*command, "--first-seed", "100"]) == 0
    assert runs[3:] == [("own", 2, 100), ("nees", 2, 100)]
    assert main(command) == 0  # the pages are of the other seeds now
    assert runs[5:] == [("own", 2, 0), ("nees", 2, 0)]
    (tmp_path / "own.md").unlink()
    with (tmp_path / RUNS).open("a") as file:
        file.write('{"name": "ne')  # cut off
    assert main(command) == 0
    assert runs[7:] == [("own", 2, 0)]
    (tmp_path / RUNS).write_text("nothing\n")
    assert main(command) == 2


@pytest.mark.parametrize(("first_s", "runs"), [(60.0, [1, 11]), (240.0, [1, 2]), (900.0, [1]), (0.0, [1, 30])])
def test_a_budget_is_so_many_seeds_as_fit(
    first_s: float, runs: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twelve minutes, and a first seed that takes one, four, fifteen and none; begun again, nothing is run twice."""
    found, now_s, stops = [], 0.0, True

    def run(self: Experiment, seeds: int, *_: object, first_seed: int) -> ExperimentResult:
        nonlocal now_s, stops
        if stops and found:
            stops = False
            raise InputError("stopped behind the first seed")
        found.append(seeds)
        now_s += first_s * seeds
        return replace(result(self.name), seeds=seeds, first_seed=first_seed)

    monkeypatch.setattr(Experiment, "run", run)
    monkeypatch.setattr("touchline_lab.experiments.EXPERIMENTS", {"own": EXPERIMENTS["own"]})
    monkeypatch.setattr("touchline_lab.cli.experiment.time.monotonic", lambda: now_s)
    command = ["experiment", "all", "--output", str(tmp_path), "--seeds", "30", "--budget"]
    codes = [main([*command, "12"]), main([*command, "12"]), main([*command, "6"])]
    assert codes == [0 if runs == [1] else 2, 0, 0]
    assert found == runs
    stops = False
    assert main(["experiment", "own", *command[2:], "12"]) == 0  # one that is named is run whatever is there
    assert found == [*runs, *runs]


def test_results_of_other_seeds_and_of_another_commit_do_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, computed = tmp_path / "faults.jsonl", []

    def square(item: int) -> int:
        computed.append(item)
        return item**2

    def found(items: list[int], part: str = "") -> list[int]:
        computed.clear()
        with progress_to(None, kept=Kept(path, part)):
            return resumed(square, items, "squares")

    monkeypatch.setattr(harness, "commit", lambda: "a")
    assert found([1, 2]) == [1, 4]
    assert (found([2, 3]), computed) == ([4, 9], [3])
    assert (found([5, 6], "5"), computed) == ([25, 1, 4, 9], [5])
    monkeypatch.setattr(harness, "commit", lambda: "b")
    assert (found([1, 2]), computed) == ([1, 4], [1, 2])
    assert (sorted(found([1], NOTHING)), computed) == ([1, 4, 9, 25], [])


def test_the_commit_is_git_s_and_empty_without_a_repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if (Path(__file__).parents[1] / ".git").exists():
        assert re.fullmatch("[0-9a-f]{12}", harness.commit())
    monkeypatch.setattr(harness, "__file__", str(tmp_path / "src" / "touchline" / "experiments" / "harness.py"))
    assert harness.commit() == ""


def test_a_mistyped_experiment_is_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match="did you mean 'lu2013-kidnap'"):
        chosen_experiments("lu2013-kidnp")
    assert len(chosen_experiments("all")) == len(EXPERIMENTS)


def test_the_command_lists_the_experiments_and_runs_one(tmp_path: Path, capsys: Any) -> None:
    assert main(["experiment"]) == 0
    listed = capsys.readouterr().out
    assert [name for name in EXPERIMENTS if name not in listed] == []
    assert main(["experiment", "xiong-samples", "--seeds", "1", "--output", str(tmp_path / "out")]) == 0
    assert "315" in capsys.readouterr().out
    assert "[xiong-samples](xiong-samples.md)" in (tmp_path / "out" / "results.md").read_text(encoding="utf-8")
    assert main(["experiment", "nonsense"]) == 2


# --- the experiments --------------------------------------------------------------------------------------------------


# mean and largest position error (m), mean heading error (rad): twice what is measured at the most


# --- lu2013-lighting --------------------------------------------------------------------------------------------------


# --- the page of the last results -------------------------------------------------------------------------------------
