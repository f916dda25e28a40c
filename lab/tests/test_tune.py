"""Settings searched: the same trials however the search is done, and what of it is refused."""

from __future__ import annotations

import csv
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from fakes import FakeSource, FakeSystem, true_samples, write_recording

from touchline.cli import main
from touchline.config import load_settings
from touchline.errors import InputError
from touchline.evaluation.workers import Workers, open_workers
from touchline.published.nubot_mti.system import NubotMtiSettings
from touchline.sources import Truth
from touchline.systems.ordered import OrderedSystem
from touchline_lab.tuning import Dimension, Search, Task, dimension_from_text, score_of, tasks_on, tune
from touchline_lab.tuning.result import best_file, judge, trials_figure, trials_table
from touchline_lab.tuning.search import best_of
from touchline_lab.tuning.trial import MAX_M, Score, Trial, base_of, mean_score, scored, settings_of

SYSTEM, SCENARIO = "nubot-mti", "straight-tracks"
SPACE = ("matching.c_m=0.05:0.6:log", "matching.iterations=2:30")


def searched(seeds: int = 1) -> Search:
    """One second of a drive, two settings."""
    task = Task("", SYSTEM, base_of(SYSTEM, None, ()), seconds=1.0)
    dimensions = tuple(dimension_from_text(text, NubotMtiSettings) for text in SPACE)
    return Search(tuple(tasks_on([SCENARIO], seeds, task)), dimensions, seed=3, together=2)


def test_a_search_that_was_interrupted_goes_on_as_if_it_had_not_been(tmp_path: Path) -> None:
    whole = tune(searched(), tmp_path / "whole", 6, Workers())
    told: list[Trial] = []
    tune(searched(), tmp_path / "cut", 2, Workers())
    assert tune(searched(), tmp_path / "cut", 6, Workers(), told.append) == whole == told
    assert (tmp_path / "whole").read_text() == (tmp_path / "cut").read_text()
    assert whole[0].values == ()  # the settings as they are come first
    assert len({trial.values for trial in whole}) == 6
    assert all(2 <= dict(trial.values)["matching.iterations"] <= 30 for trial in whole[1:])
    assert whole[best_of(whole)].cost_m == min(trial.cost_m for trial in whole)
    with pytest.raises(InputError, match=r"another search \(seed differ\)"):
        tune(replace(searched(), seed=4), tmp_path / "cut", 8, Workers())
    (tmp_path / "cut").write_text("{")
    with pytest.raises(InputError, match="no journal"):
        tune(searched(), tmp_path / "cut", 8, Workers())


@pytest.mark.slow
def test_many_processes_give_the_results_in_order() -> None:
    with open_workers(2) as workers:
        assert list(workers.map(abs, range(-5, 5))) == [5, 4, 3, 2, 1, 0, 1, 2, 3, 4]
    with pytest.raises(InputError, match="0 workers"), open_workers(0):
        pass


@pytest.mark.slow
def test_no_scheduler_is_told_in_words() -> None:
    with pytest.raises(InputError, match="no scheduler answers there"), open_workers(dask="nowhere"):
        pass


def test_what_an_image_costs() -> None:
    (task,) = tasks_on([SCENARIO], 1, Task("", SYSTEM, seconds=1.0))
    score = score_of(task)
    assert score is not None
    assert score.tracked > 0.5
    assert score.mean_m < 0.05
    lost = 1.0 - score.tracked
    assert lost * MAX_M <= score.cost_m < lost * MAX_M + 0.1
    assert mean_score([Score(1.0, 0.0, float("nan")), Score(0.02, 1.0, 0.01)]) == Score(0.51, 0.5, 0.01)
    assert score_of(replace(task, changes=(("matching.c_m", -1.0),))) is None


def test_a_late_image_after_a_black_one_is_not_counted() -> None:
    frames = list(FakeSource(6, black=(4,)))
    truth = Truth(true_samples(6).stamp_ns, true_samples(6).values)
    in_order, late = (
        [*frames[:5], *between, frames[5]] for between in ([], [replace(frames[3], stamp_ns=350_000_000)])
    )
    scores = [
        scored(each, truth, OrderedSystem(FakeSystem(np.random.default_rng(0), 0.0))) for each in (in_order, late)
    ]
    assert scores[0] == scores[1]


def test_the_best_settings_are_a_file_that_run_takes(tmp_path: Path) -> None:
    search = searched()
    values = (("matching.c_m", 0.125), ("matching.iterations", 7))
    trials = [Trial((), (Score(0.03, 1.0, 0.02),)), Trial(values, (Score(0.02, 1.0, 0.01),)), Trial(values, None)]
    judged = judge(["straight-tracks"], search.tasks, values, Workers())
    file = tmp_path / "best.yaml"
    file.write_text(best_file(search, trials[best_of(trials)], judged))
    assert yaml.safe_load(file.read_text()) == {"matching": {"c_m": 0.125, "iterations": 7}}
    assert load_settings(NubotMtiSettings, file) == settings_of(replace(search.tasks[0], changes=values))
    assert "judged on straight-tracks" in file.read_text()
    assert "not judged" in best_file(search, trials[1], None)
    rows = list(csv.DictReader(trials_table(search, trials).splitlines()))
    assert [row["matching.iterations"] for row in rows] == ["25", "7", "7"]
    assert [row["cost_m"] for row in rows] == ["0.030000", "0.020000", "nan"]
    assert len(trials_figure(search, trials).axes) == 3


def test_what_is_searched_may_be_numbers_or_choices() -> None:
    assert dimension_from_text("matching.iterations=5:25", NubotMtiSettings) == Dimension(
        "matching.iterations", 5.0, 25.0, whole=True
    )
    assert dimension_from_text("matching.c_m=0.1,0.2,0.3", NubotMtiSettings).choices == (0.1, 0.2, 0.3)
    assert dimension_from_text("matching.c_m=0.1:1:log", NubotMtiSettings).log


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("matching.c=1:2", "there is no setting 'matching.c'"),
        ("line_sigma_m=0.1:0.2", "there is no setting 'line_sigma_m'; touchline systems NAME lists them"),
        ("matching.c_m", "expected KEY=LOW:HIGH"),
        ("matching.c_m=2:1", "LOW has to be below HIGH"),
        ("matching.c_m=1:2:lin", "expected KEY=LOW:HIGH"),
        ("matching.c_m=-1:2", "matching.c_m"),
        ("matching.c_m=much:more", "matching.c_m"),
        ("matching.c_m=0.2", "nothing to search"),
        ("learning.colour_file=a:b", "is no number"),
    ],
)
def test_a_space_that_is_none_is_refused(text: str, said: str) -> None:
    with pytest.raises(InputError, match="--search") as refused:
        dimension_from_text(text, NubotMtiSettings)
    assert said in str(refused.value)


def test_the_command_refuses_before_it_computes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_recording(tmp_path / "without", 2, truth=False)

    def refusal(*given: str) -> str:
        assert main(["tune", *given, "-o", "tuned", "--system", SYSTEM]) == 2
        return capsys.readouterr().err

    ways = ["--search", "matching.c_m=0.1:0.5"]
    assert "no true poses" in refusal("without", *ways)
    assert "straight-tracks" in refusal("straight-track", *ways)
    assert "judged on others" in refusal(SCENARIO, *ways, "--judge", SCENARIO)
    assert "one key twice" in refusal(SCENARIO, *ways, *ways)
    monkeypatch.setitem(sys.modules, "optuna", None)
    assert "pip install 'touchline-lab'" in refusal(SCENARIO, *ways)
    assert not (tmp_path / "tuned").exists()
