"""The open benchmark: inputs for any program, poses that come back, figures and their intervals."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchline.cli import main
from touchline.errors import InputError
from touchline.evaluation.workers import Workers
from touchline.geometry import Pose
from touchline.sources import open_source
from touchline.types import Samples
from touchline_lab.bench import runs
from touchline_lab.bench.exchange import Answers, read_answers, read_start, track_of_answers, write_inputs
from touchline_lab.bench.leaderboard import figure, leaderboard
from touchline_lab.bench.scoring import over_robots, score_of
from touchline_lab.bench.suite import Entry, Suite, digest, open_suite
from touchline_lab.experiments.drives import Drive, Track

SUITE = "touchline-bench-1"
SMALL = """\
name: small
judging: [100, 101]
rows:
  - {track: mirror, condition: calm, scenario: straight-tracks, seconds: 2}
  - {track: humanoid, condition: calm, field: hsl-s-9x6, seconds: 2, either_end: true}
"""


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A suite of two short rows."""
    path = tmp_path / "small.yaml"
    path.write_text(SMALL, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def drive() -> Drive:
    """A walk of three seconds."""
    row = next(row for row in open_suite(SUITE).rows if row.track == "humanoid" and row.condition == "match")
    found = Entry(row.model_copy(update={"seconds": 3.0}), 0).drive()
    assert found is not None
    return found


def tracks(error_m: float, count: int = 10, tracking: bool = True) -> Track:
    truth = np.column_stack((np.linspace(1.0, 2.0, count), np.full(count, 0.5), np.zeros(count)))
    poses = truth + np.array([error_m, 0.0, 0.0])
    covariances = np.tile(np.diag([1e-4] * 3), (count, 1, 1))
    return Track(np.arange(count) / 10.0, poses, truth, np.full(count, tracking), covariances)


def test_every_row_of_the_suite_has_a_name_of_its_own_and_faults_that_there_are() -> None:
    suite = open_suite(SUITE)
    names = [row.name for row in suite.rows]
    assert len(set(names)) == len(names)
    assert {fault.name for row in suite.rows for fault in Entry(row, 100).faults}
    assert not set(range(*suite.tuning)) & set(range(*suite.judging))
    assert not set(range(*suite.judging)) & set(range(*suite.release))


def test_what_a_program_is_given_is_what_the_robot_measured_and_no_truth(drive: Drive, tmp_path: Path) -> None:
    write_inputs(drive, tmp_path / "walk", "walk")
    read = open_source(tmp_path / "walk")
    assert read.truth is None
    assert read.events == ()
    frames = list(read)
    assert [frame.stamp_ns for frame in frames] == [frame.stamp_ns for frame in drive.frames]
    for was, now in zip(drive.frames, frames, strict=True):
        assert was.observation is not None
        assert now.observation is not None
        np.testing.assert_allclose(now.observation.lines.ends_m, was.observation.lines.ends_m, atol=1e-5)
        np.testing.assert_allclose(
            now.observation.crossings.positions_m, was.observation.crossings.positions_m, atol=1e-5
        )
        was_kinds, now_kinds = was.observation.crossings.kinds.tolist(), now.observation.crossings.kinds.tolist()
        assert now_kinds == was_kinds
    for sensor in ("odometry", "tilt", "gyro", "compass"):
        was_log, now_log = (Samples.joined([getattr(f, sensor) for f in of]) for of in (drive.frames, frames))
        assert (was_log is None) == (now_log is None)
        if was_log is not None and now_log is not None:
            np.testing.assert_allclose(now_log.values, was_log.values[: len(now_log)], atol=1e-6)
    start, told = read_start(tmp_path / "walk"), drive.prior
    assert start is not None
    assert told is not None
    np.testing.assert_allclose(start.pose, told.pose, atol=1e-6)


def test_the_hash_of_inputs_hears_a_hundredth_of_a_millimetre_and_no_rounding(drive: Drive) -> None:
    def moved(by_m: float) -> Drive:
        frame = drive.frames[1]
        assert frame.odometry is not None
        other = replace(frame, odometry=Samples(frame.odometry.stamp_ns, np.round(frame.odometry.values, 6) + by_m))
        return replace(drive, frames=[drive.frames[0], other, *drive.frames[2:]])

    assert digest(moved(0.0)) == digest(moved(1e-8))
    assert digest(moved(0.0)) != digest(moved(1e-5))


def test_errors_cost_what_the_page_says() -> None:
    assert score_of(tracks(0.0), []).cost_m == 0.0
    assert score_of(tracks(0.2), []).cost_m == pytest.approx(0.2)
    assert score_of(tracks(0.2, tracking=False), []).cost_m == 1.0
    wrong = score_of(tracks(0.8), [])
    assert (wrong.cost_m, wrong.wrong, wrong.wrong_times) == (3.0, 10, 1)
    assert score_of(tracks(0.2), []).nees == pytest.approx(0.04 / 1e-4 / 3.0)


def test_images_without_an_answer_count() -> None:
    track = tracks(0.0)
    stamps = np.rint(1e9 * track.times_s[:4]).astype(np.int64)
    answers = answers_at(stamps, track.poses[:4])
    score = score_of(track_of_answers(track.times_s, track.truth, answers), [0.0])
    assert score.available == pytest.approx(0.4)
    assert score.cost_m == pytest.approx(0.6)
    assert score.median_m == math.inf
    assert score.recover_s == (0.0,)


def answers_at(stamps: np.ndarray, poses: np.ndarray) -> Answers:
    return Answers(stamps, poses, np.ones(len(poses), np.bool_), np.full((len(poses), 3, 3), np.nan))


def test_either_end_is_right_but_not_one_and_then_the_other() -> None:
    right = tracks(0.0)
    poses = right.turned.poses.copy()
    assert score_of(replace(right, poses=poses), [], either_end=True).cost_m == pytest.approx(0.0, abs=1e-9)
    poses[:3] = right.poses[:3]
    assert score_of(replace(right, poses=poses), [], either_end=True).wrong == 3
    assert score_of(replace(right, poses=poses), [0.3], either_end=True).wrong == 0


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("t,x,y\n0,1,2\n", "theta missing"),
        ("t,x,y,theta\n0,1,2,a\n", "line 2"),
        ("t,x,y,theta\n1,1,2,0\n1,1,2,0\n", "line 3: the time does not increase"),
    ],
)
def test_a_file_that_is_none_is_told_of_with_its_line(text: str, what: str, tmp_path: Path) -> None:
    (tmp_path / "answers.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=what):
        read_answers(tmp_path / "answers.csv")


def test_intervals_are_bca_s_and_hold_the_mean_as_often_as_they_say() -> None:
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(40):
        low, high = over_robots(rng.lognormal(0.0, 0.5, 30), np.mean)[1:]
        held += low <= math.exp(0.125) <= high
    assert 33 <= held <= 40
    assert over_robots([2.0, 2.0]) == (2.0, 2.0, 2.0)
    assert over_robots([1.0, math.inf, math.inf]).value == math.inf


def test_a_run_goes_on_where_it_was_cut_off(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "results.jsonl"
    command = ["bench", "suite", str(small), "--system", "touchline", "--output", str(file)]
    assert main(command) == 0
    whole = file.read_text(encoding="utf-8")
    assert len(whole.splitlines()) == 1 + 2
    head, found = runs.read_results(file)
    assert head["suite"] == "small"
    assert all(scored.score.median_m < 0.3 for scored in found)
    assert "mirror: calm" in capsys.readouterr().out
    assert main(command) == 0
    assert file.read_text(encoding="utf-8") == whole
    file.write_text(whole[:-40], encoding="utf-8")
    assert main(command) == 0
    assert len(runs.read_results(file)[1]) == 2
    other = Suite(name="other")
    with pytest.raises(InputError, match="holds results of small, not of other"):
        list(runs.run_suite(other, [], ["touchline"], file, Workers()))


@pytest.mark.slow
def test_any_program_can_enter(small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inputs, answers = tmp_path / "inputs", tmp_path / "still"
    assert main(["bench", "export", str(small), str(inputs), "--robots", "1"]) == 0
    files = {path: path.stat().st_mtime_ns for path in inputs.rglob("*.csv")}
    assert main(["bench", "export", str(small), str(inputs), "--robots", "2"]) == 0  # goes on behind the first
    assert files.items() <= {path: path.stat().st_mtime_ns for path in inputs.rglob("*.csv")}.items()
    assert len([*inputs.iterdir()]) == 4
    answers.mkdir()
    start = (inputs / "mirror-calm-msl-18x12-100" / "start.tum").read_text(encoding="utf-8").split()
    rows = (inputs / "mirror-calm-msl-18x12-100" / "observations.csv").read_text(encoding="utf-8").splitlines()[1:]
    times = dict.fromkeys(row.split(",")[0] for row in rows)
    poses = "".join(f"{time} {' '.join(start[1:])}\n" for time in times)
    (answers / "mirror-calm-msl-18x12-100.tum").write_text(poses, encoding="utf-8")
    file = tmp_path / "scored.jsonl"
    assert main(["bench", "score", str(small), str(answers), "--output", str(file)]) == 0
    (scored,) = runs.read_results(file)[1]
    assert scored.system == "still"
    assert scored.score.available == 1.0
    assert 0.0 < scored.score.median_m < 3.0
    shutil.rmtree(answers)
    answers.mkdir()
    assert main(["bench", "score", str(small), str(answers)]) == 2
    assert "holds no result of small" in capsys.readouterr().err
    (inputs / "mirror-calm-msl-18x12-100" / "odometry.csv").write_text("t,x,y,theta\n", encoding="utf-8")
    assert main(["bench", "export", str(small), str(inputs), "--robots", "1"]) == 2  # nothing is overwritten


def test_inputs_go_into_a_folder_that_there_is(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runs, "export", lambda entry, folder, mcap: folder / entry.name)
    assert main(["bench", "export", str(small), str(tmp_path / "inputs"), "--robots", "1"]) == 0
    assert capsys.readouterr().out.count(str(tmp_path / "inputs")) == 2
    assert main(["bench", "export", str(small), str(tmp_path / "nowhere" / "inputs")]) == 2
    assert "nowhere is no folder" in " ".join(capsys.readouterr().err.split())


def test_the_one_figure_is_the_mean_of_rows_and_says_which_are_missing() -> None:
    suite = open_suite(SUITE)
    first, second = [row.name for row in suite.rows if row.track == "mirror"][:2]
    scores = [score_of(tracks(error), []) for error in (0.01, 0.03)]
    table = {(first, "a"): scores, (second, "a"): [scores[1]] * 2, (first, "b"): scores}
    place = figure(suite, table, "a", "mirror")
    assert place is not None
    assert place.cost_cm.value == pytest.approx(2.5)
    assert place.rows == 2
    assert figure(suite, table, "a", "humanoid") is None
    rows = leaderboard(suite, table)
    assert [row[0] for row in rows] == ["b", "a"]
    assert rows[0][4] == "n/a"


def test_starts_are_near_the_truth_and_none_is_told_where_the_row_says_so(drive: Drive) -> None:
    assert drive.prior is not None
    assert drive.prior.pose is not None
    assert drive.prior.pose.distance_to(Pose(*drive.truth[0].tolist())) <= 0.3
