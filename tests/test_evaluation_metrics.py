"""Error statistics, association by time, and the TUM format."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from touchline.errors import InputError
from touchline.evaluation import ErrorStatistics, error_table, read_tum, write_tum
from touchline.evaluation.metrics import associate, signed_errors
from touchline.evaluation.tum import seconds_text, stamp_from_text
from touchline.types import Samples

STEP_NS = 100_000_000


def samples(poses: list[tuple[float, float, float]], start: int = 0) -> Samples:
    stamps = (np.arange(len(poses), dtype=np.int64) + start) * STEP_NS
    return Samples(stamps, np.array(poses, dtype=np.float64).reshape(-1, 3))


def shifted(truth: Samples, errors: list[tuple[float, float, float]]) -> Samples:
    return Samples(truth.stamp_ns, truth.values + np.array(errors))


def test_statistics_are_those_of_the_closed_forms() -> None:
    statistics = ErrorStatistics.of(np.array([-3.0, 1.0, 1.0, 5.0]))
    assert statistics.mean == pytest.approx(2.5)  # of |error|: 3, 1, 1, 5
    assert statistics.median == pytest.approx(2.0)
    assert statistics.max == pytest.approx(5.0)
    assert statistics.std_signed == pytest.approx(math.sqrt(8.0))  # about the signed mean 1: 16 + 0 + 0 + 16 over 4
    assert statistics.std_abs == pytest.approx(math.sqrt(2.75))  # about 2.5: 0.25 + 2.25 + 2.25 + 6.25 over 4


def test_heading_errors_go_the_short_way_round() -> None:
    truth = samples([(0.0, 0.0, math.pi - 0.01)])
    estimate = samples([(0.0, 0.0, -math.pi + 0.02)])
    assert signed_errors(estimate, truth).values[0, 2] == pytest.approx(0.03)


def test_printed_table_has_centimetres_and_degrees(snapshot: SnapshotAssertion) -> None:
    truth = samples([(0.0, 0.0, 0.0)] * 3)
    assert str(error_table(shifted(truth, [(0.0123, 0.0, math.radians(2.0))] * 3), truth)) == snapshot


def test_frames_before_the_first_estimate_are_left_out_and_counted() -> None:
    truth = samples([(0.0, 0.0, 0.0)] * 5)
    estimate = shifted(truth, [(9.0, 9.0, 1.0)] * 2 + [(0.01, 0.0, 0.0)] * 3)
    table = error_table(estimate, truth, located=np.array([False, False, True, True, True]))
    assert (table.frames, table.before_first, table.lost, table.tracked_position) == (3, 2, 0, None)
    assert table.x.max == pytest.approx(0.01)
    assert [name for name, _ in table.rows()] == ["x (cm)", "y (cm)", "position (cm)", "heading (°)"]


def test_frames_in_which_the_robot_is_lost_count_and_a_row_is_without_them() -> None:
    truth = samples([(0.0, 0.0, 0.0)] * 6)
    estimate = shifted(
        truth, [(9.0, 0.0, 0.0), *[(0.01, 0.0, 0.0)] * 2, (3.0, 4.0, 2.0), (0.6, 0.8, 2.0), (0.0, 0.0, 0.0)]
    )
    table = error_table(estimate, truth, located=np.array([False, True, True, False, False, True]))
    assert (table.frames, table.before_first, table.lost) == (5, 1, 2)
    assert (table.position.max, table.heading.max) == pytest.approx((5.0, 2.0))
    assert table.tracked_position is not None
    assert (table.tracked_position.mean, table.tracked_position.max) == pytest.approx((0.02 / 3.0, 0.01))
    assert table.rows()[2][0] == "position, tracked (cm)"
    assert table.rows()[2][1][-1] == "1.00"
    assert "5 frames counted (in 2 the robot was lost or searched for); left out: 1 before the first" in str(table)
    assert table.as_dict()["tracked_position_m"]["max"] == pytest.approx(0.01)
    assert table.as_dict()["lost"] == 2


def test_every_frame_is_counted_once() -> None:
    truth = samples([(0.0, 0.0, 0.0)] * 6, start=2)  # frames 2 to 7
    estimate = samples([(0.0, 0.0, 0.0)] * 9)
    located = np.isin(np.arange(9), [3, 4, 5, 7, 8])
    table = error_table(estimate, truth, located=located, black_ns=[(0, 0), (5 * STEP_NS, 5 * STEP_NS)], skip=1)
    assert table.skipped + table.before_first + table.black + table.without_truth + table.frames == 9
    assert (table.skipped, table.before_first, table.black, table.without_truth) == (1, 2, 1, 1)
    assert (table.lost, table.frames) == (1, 4)


def test_estimates_take_the_nearest_truth_within_half_a_frame() -> None:
    stamps = np.array([0, 100, 200, 300], dtype=np.int64)
    truth = np.array([40, 150, 252], dtype=np.int64)
    assert associate(stamps, truth).tolist() == [0, 1, 1, 2]
    assert associate(stamps, np.array([351], dtype=np.int64)).tolist() == [-1, -1, -1, -1]


@given(
    st.lists(st.integers(0, 2000), min_size=2, max_size=20, unique=True),
    st.lists(st.integers(0, 2000), min_size=1, max_size=20, unique=True),
)
def test_association_agrees_with_brute_force(stamps: list[int], truth: list[int]) -> None:
    ours, known = np.array(sorted(stamps)), np.array(sorted(truth))
    half = 0.5 * float(np.median(np.diff(ours)))
    for stamp, index in zip(ours, associate(ours, known), strict=True):
        nearest = int(np.abs(known - stamp).min())
        if nearest <= half:
            assert abs(int(known[index]) - int(stamp)) == nearest
        else:
            assert index == -1


def test_nothing_to_compare_is_refused_with_the_reason() -> None:
    truth = samples([(0.0, 0.0, 0.0)] * 3)
    with pytest.raises(InputError, match="same recording and clock"):
        error_table(samples([(0.0, 0.0, 0.0)] * 3, start=1000), truth)
    with pytest.raises(InputError, match="the robot was never located"):
        error_table(truth, truth, located=np.zeros(3, dtype=np.bool_))
    with pytest.raises(InputError, match="all frames were left out"):
        error_table(truth, truth, skip=3)
    with pytest.raises(InputError, match="are black"):
        error_table(truth, truth, black_ns=[(0, 10 * STEP_NS)])


@given(st.integers(-(10**18), 10**18))
def test_stamps_survive_the_text_exactly(stamp_ns: int) -> None:
    assert stamp_from_text(seconds_text(stamp_ns)) == stamp_ns


def test_stamps_are_read_in_scientific_notation_too() -> None:
    assert stamp_from_text("1.5e1") == 15_000_000_000
    with pytest.raises(ValueError, match="inf"):
        stamp_from_text("inf")


def test_trajectory_survives_the_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    poses = np.column_stack((rng.uniform(-9, 9, (50, 2)), rng.uniform(-math.pi, math.pi, 50)))
    before = Samples(np.cumsum(rng.integers(1, 10**9, 50)), poses)
    write_tum(tmp_path / "a.tum", before)
    after = read_tum(tmp_path / "a.tum")
    assert np.array_equal(after.stamp_ns, before.stamp_ns)
    np.testing.assert_allclose(after.values, before.values, atol=1e-6)


def test_heading_is_the_yaw_of_a_general_quaternion(tmp_path: Path) -> None:
    roll, yaw = 0.1, 0.7  # Rz(yaw) Rx(roll)
    cr, sr, cy, sy = math.cos(roll / 2), math.sin(roll / 2), math.cos(yaw / 2), math.sin(yaw / 2)
    (tmp_path / "a.tum").write_text(f"# comment\n\n0 1 2 0 {sr * cy} {sr * sy} {cr * sy} {cr * cy}\n")
    assert read_tum(tmp_path / "a.tum").values[0, 2] == pytest.approx(yaw)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("0 1 2 0 0 0 0 1\n1 2 3\n", "line 2: expected 't x y z qx qy qz qw', found 3 values"),
        ("0 1 2 0 0 0 zero 1\n", "line 1: a value is not a number"),
        ("0 nan 2 0 0 0 0 1\n", "line 1: a value is NaN"),
        ("0 1 2 0 0 0 0 0\n", "line 1: .*quaternion is zero"),
        ("1 1 2 0 0 0 0 1\n0.5 1 2 0 0 0 0 1\n", "line 2: the time does not increase"),
        ("# nothing\n", "holds no pose"),
    ],
)
def test_broken_trajectories_are_refused_with_the_line(tmp_path: Path, content: str, said: str) -> None:
    (tmp_path / "a.tum").write_text(content)
    with pytest.raises(InputError, match=f"a.tum.*{said}"):
        read_tum(tmp_path / "a.tum")


def test_a_missing_or_binary_trajectory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_tum(tmp_path / "none.tum")
    (tmp_path / "b.tum").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        read_tum(tmp_path / "b.tum")
