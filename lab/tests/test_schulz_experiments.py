"""The experiments of nimbro-lines: short runs of each, and how they count."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from touchline.geometry import Pose
from touchline_lab.experiments import (
    EXPERIMENTS,
    schulz_accuracy,
    schulz_belief,
    schulz_games,
    schulz_imu,
    schulz_lines_only,
    schulz_runs,
    schulz_timing,
)
from touchline_lab.experiments.drives import Drive, Track
from touchline_lab.experiments.harness import ExperimentResult, write_result
from touchline_lab.experiments.schulz_runs import AS_BUILT, IDEAL, PANNING, right_of, settings, tracked, walk
from touchline_lab.simulation.observation.features import leaning, turned
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario


@pytest.fixture(scope="module")
def walked() -> Drive:
    return walk("humanoid-kid-9x6", IDEAL, 3, 8.0)


def run(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ExperimentResult:
    """One seed, without recordings, its page written."""
    monkeypatch.setenv("TOUCHLINE_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    result = EXPERIMENTS[name].run(1)
    assert all(len(row) == len(result.columns) for row in result.rows)
    assert all(path.stat().st_size for path in write_result(result, tmp_path))
    return result


def test_accuracy_has_a_row_for_each_robot_field_and_form(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, seconds in (("SECONDS", 1.0), ("SECONDS_WITH_FALSE", 1.0), ("SECONDS_FROM_NOWHERE", 1.0)):
        monkeypatch.setattr(schulz_accuracy, name, seconds)
    monkeypatch.setattr(schulz_accuracy, "STARTS_FROM_NOWHERE", 1)
    monkeypatch.setattr(schulz_accuracy, "FALSE_SHARES", (0.5,))
    monkeypatch.setattr(schulz_accuracy, "FIELDS", {"indoor-9x6": "coloured goals, poles"})
    result = run("schulz-accuracy", monkeypatch, tmp_path)
    names = [row[0] for row in result.rows]
    assert (names.count("as built"), names.count("as simulated")) == (4, 2)
    assert names.count(PANNING.name) == names.count("50 % false crossings") == 1
    assert result.headline.paper.startswith("17 cm, 89 %")
    assert any("TOUCHLINE_DATA" in note for note in result.notes)


def test_recorded_rows_have_the_odometry_beside(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHLINE_DATA", str(shared_data))
    monkeypatch.setattr(schulz_accuracy, "RECORDINGS", ("humanoid_hsl_pan",))
    monkeypatch.setattr(schulz_accuracy, "STARTS", 1)
    ours, paper, alone = schulz_accuracy.recorded_rows()
    assert len(ours) == len(paper) == len(alone) == len(schulz_accuracy.COLUMNS)
    medians = [float(row[4].partition(" ")[0]) for row in (ours, alone)]
    assert medians[0] < 0.5 * medians[1]


def test_lines_only_compares_each_pair_of_tracks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(schulz_lines_only, "SECONDS", 2.0)
    result = run("schulz-lines-only", monkeypatch, tmp_path)
    assert len(result.rows) == 6 * len(schulz_lines_only.CASES)
    assert [row[4] for row in result.rows[:4]] == ["0.17", "0.14", "0.26", "–"]


def test_the_belief_of_everything_has_one_position(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(schulz_belief, "HEADINGS", 36)
    rows = run("schulz-belief", monkeypatch, tmp_path).rows
    together = [row for row in rows if row[1] == "lines, crossings, pole"]
    assert [float(row[3]) for row in together] == [1.0, 1.0]
    alone = [float(row[3]) for row in rows if row[1] == "pole"]
    assert min(alone) > 4.5


def test_the_learned_correction_halves_what_marks_wander() -> None:
    each = schulz_imu.learned(1)
    found = each.calibration
    assert found.after_px < 0.15 * found.before_px
    for lean_deg in schulz_imu.LEANS_DEG.values():  # all over the image, not at the marks alone
        left, shift = schulz_imu.against_geometry(each.camera, found, *lean_deg)
        assert left < 0.1 * shift
    left, shift = schulz_imu.against_geometry(each.camera, each.equation_2, 0.0, 3.0)
    assert left > 0.5 * shift


def test_every_part_of_table_1_takes_some_time(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHLINE_DATA", str(shared_data))
    rows = EXPERIMENTS["schulz-timing"].run(1).rows
    assert [row[0] for row in rows] == [*schulz_timing.PAPER_US, schulz_timing.REST, schulz_timing.ALL]
    assert all(float(row[2]) > 0.0 for row in rows)
    assert float(rows[-1][2]) > max(float(row[2]) for row in rows[:-1])


def test_a_game_has_a_fall_and_a_re_entry_at_the_side_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    played = schulz_games.game(IDEAL, 3)
    back = int(np.argmax(played.times_s > schulz_games.FALL_S))
    assert abs(abs(played.truth[back, 1]) - 3.0) < 0.00076
    blind = (played.times_s > schulz_games.FALL_S - schulz_games.DOWN_S + 0.2) & (played.times_s < schulz_games.FALL_S)
    seen = [0 if f.observation is None else len(f.observation.lines) for f in played.frames]
    assert not np.array(seen)[blind].any()
    monkeypatch.setattr(schulz_games, "GAMES", 1)
    monkeypatch.setattr(schulz_games, "SECONDS", 33.0)
    monkeypatch.setattr(schulz_games, "CASES", dict(list(schulz_games.CASES.items())[:2]))
    assert len(run("schulz-games", monkeypatch, tmp_path).rows) == 2


def test_a_walk_is_tracked_and_odometry_alone_starts_at_the_truth(walked: Drive) -> None:
    track = tracked(walked, 0, settings())
    assert right_of(track).all()
    assert np.median(track.distances_m[-20:]) < 0.0168
    assert schulz_runs.dead_reckoned(walked).distances_m[0] < 1e-9


def test_a_robot_as_built_looks_away_half_of_the_time() -> None:
    frames = walk("indoor-9x6", AS_BUILT, 1, 8.0).frames
    seen = [len(f.observation.lines) + len(f.observation.crossings) > 0 for f in frames if f.observation is not None]
    assert 0.3 < np.mean(seen) <= 0.52


def test_what_a_turned_head_sees_is_in_the_robot_frame() -> None:
    changes = ["field=humanoid-kid-9x6", "others.robots=0"]
    simulation = Simulation(open_scenario("humanoid-walk", 1, 5.0, changes), "points")
    field, pose = simulation.field, simulation.truth[3]
    crossings = simulation.features(3, 0.8).crossings
    places = np.array([(c.x, c.y) for c in field.crossings])
    away = np.hypot(*(pose.transform(crossings.positions_m)[:, np.newaxis] - places).transpose(2, 0, 1))
    assert len(crossings)
    assert away.min(axis=1).max() < 0.036
    bearings = np.arctan2(crossings.positions_m[:, 1], crossings.positions_m[:, 0])
    assert np.abs(bearings - 0.8).max() < 0.75
    straight = simulation.features(3)
    back = turned(turned(straight, 0.8), -0.8)
    np.testing.assert_allclose(back.lines.ends_m, straight.lines.ends_m, atol=1e-9)
    np.testing.assert_allclose(back.crossings.covariances_m2, straight.crossings.covariances_m2, atol=1e-9)
    assert leaning(straight, 0.0, 0.0, 1.0).lines.ends_m == pytest.approx(straight.lines.ends_m)


def test_false_crossings_are_added_in_the_asked_ratio(walked: Drive) -> None:
    true = sum(len(frame.observation.crossings) for frame in walked.frames if frame.observation is not None)
    frames = schulz_runs.with_false_crossings(0.5, walked, 0).frames
    found = sum(len(frame.observation.crossings) for frame in frames if frame.observation is not None)
    assert found == pytest.approx(2 * true, rel=0.25)


def test_a_start_is_near_the_truth_but_not_at_it() -> None:
    truth = Pose(1.0, 2.0, 3.0)
    starts = [schulz_runs.start_about(truth, seed) for seed in range(50)]
    assert 0.2 < max(start.distance_to(truth) for start in starts) <= 0.3
    assert max(abs(start.heading - 3.0) for start in starts) <= math.radians(10.0)


def test_the_time_until_right_asks_for_two_seconds() -> None:
    times = np.arange(0.0, 10.0, 0.5)
    poses = np.zeros((20, 3))
    poses[:6, 0], poses[8, 0] = 1.0, 1.0
    track = Track(times, poses, np.zeros((20, 3)), np.ones(20, dtype=np.bool_))
    assert schulz_runs.time_until_right(track) == pytest.approx(4.5)
    assert schulz_runs.time_until_right(track, 4.0) == pytest.approx(0.5)
    never = Track(times, poses, np.zeros((20, 3)), np.zeros(20, dtype=np.bool_))
    assert math.isinf(schulz_runs.time_until_right(never))
    twins = Track(times, poses * 0.0 + (-1.0, 0.0, math.pi), np.tile((1.0, 0.0, 0.0), (20, 1)), track.tracking)
    assert right_of(schulz_runs.either_end(twins)).all()
