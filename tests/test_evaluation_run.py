"""The run: frames through a system into a folder, and what the folder says afterwards."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fakes import STEP_NS, FakeSource, FakeSystem, true_pose, true_samples

from touchline.errors import InputError
from touchline.evaluation import Run, evaluate, read_tum, write_tum
from touchline.evaluation.estimates import COLUMNS, csv_row, header, read_estimates
from touchline.evaluation.latency import LatencyHistogram
from touchline.evaluation.run_folder import RunFolder, new_folder, read_summary, write_summary
from touchline.evaluation.runner import RunTally, run_frames, said_text
from touchline.evaluation.summary import EitherSide, RunSummary
from touchline.geometry import Pose
from touchline.types import Estimate, Frame, Hypothesis, Mode, Problem, ProblemCode, Status

HEADER = header(None).strip()


def run_into(folder: Path, source: FakeSource, system: FakeSystem | None = None) -> RunTally:
    folder.mkdir()
    with RunFolder(folder) as writer:
        tally = run_frames(source, system or FakeSystem(np.random.default_rng(0)), writer)
    write_summary(folder, RunSummary(recording={"path": str(folder / "gone")}).updated(tally.summary()))
    return tally


def test_every_image_has_one_line_in_both_files(tmp_path: Path) -> None:
    tally = run_into(tmp_path / "run", FakeSource(9))
    trajectory = read_tum(tmp_path / "run" / "trajectory.tum")
    table = read_estimates(tmp_path / "run" / "estimates.csv")
    assert tally.frames == len(trajectory) == len(table) == 9
    summary = tally.summary()
    assert summary.status == {"tracking": 8, "searching": 1, "lost": 0}
    assert (summary.duration_s, summary.recording_rate_hz) == (pytest.approx(0.8), pytest.approx(10.0))
    assert np.array_equal(trajectory.stamp_ns, table.trajectory.stamp_ns)
    np.testing.assert_allclose(trajectory.values, table.trajectory.values, atol=2e-6)


def test_an_estimate_comes_back_from_the_table(tmp_path: Path) -> None:
    covariance = np.array([[0.04, 0.001, 0.002], [0.001, 0.09, 0.003], [0.002, 0.003, 0.01]])
    written = Estimate(
        1_234_567_890, true_pose(3), covariance, Status.SEARCHING, 0.123, 45, probability=0.75, perception_ms=1.25,
        hypotheses=(Hypothesis(true_pose(3).mirrored(), 0.123, 0.25),), mode=Mode.BOTH, reason="in doubt",
        protection_m=0.06, end_probability=0.5, statistics={"motion": 0.25},
    )  # fmt: skip
    bare = Estimate(1_334_567_890, true_pose(4), covariance, Status.LOST, reason='"found", not yet')
    tables = []
    for estimate in (written, bare):
        (tmp_path / "e.csv").write_text(header(estimate) + csv_row(estimate))
        tables.append(read_estimates(tmp_path / "e.csv"))
    one, other = tables
    assert np.isnan([other.protection_m, other.end_probability]).all()
    assert (other.estimate(0).reason, other.has_status(Status.LOST).tolist()) == (bare.reason, [True])
    np.testing.assert_allclose(one.std[0], [0.2, 0.3, 0.1], rtol=1e-6)
    back = one.estimate(0)
    np.testing.assert_allclose(back.covariance, covariance, rtol=1e-6)
    names = ("stamp_ns", "status", "points", "mode", "reason", "protection_rad", "statistics")
    assert [getattr(back, name) for name in names] == [getattr(written, name) for name in names]
    for name in ("probability", "twin_probability", "end_probability", "protection_m", "residual_m", "perception_ms"):
        assert getattr(back, name) == pytest.approx(getattr(written, name))
    assert back.pose == pytest.approx(written.pose, abs=1e-6)


@pytest.mark.parametrize("more", ["", "mode", "probability,twin_probability", "mode,probability,twin_probability"])
def test_estimates_of_older_versions_are_read(tmp_path: Path, more: str) -> None:
    values = {"mode": "odometry", "probability": "0.5", "twin_probability": "0.25"}
    cells = [values[name] for name in more.split(",") if name]
    row = ["1.5", "1", "2", "3", "4", "0", "0", "9", "0", "1", "tracking", "0.1", "7", "1", "2", *cells]
    (tmp_path / "e.csv").write_text(",".join((*COLUMNS, *filter(None, [more]))) + "\n" + ",".join(row) + "\n")
    table = read_estimates(tmp_path / "e.csv")
    assert table.has_modes == ("mode" in more)
    np.testing.assert_allclose(table.std[0], [2.0, 3.0, 1.0])
    assert table.probability[0] == pytest.approx(0.5 if "probability" in more else math.nan, nan_ok=True)
    assert (np.isnan(table.protection_m).all(), table.statistics, table.reasons) == (True, {}, ("",))


def test_a_residual_without_points_is_empty_and_read_as_nan(tmp_path: Path) -> None:
    estimate = replace(Estimate(0, true_pose(0), np.eye(3), Status.LOST), residual_m=math.nan)
    (tmp_path / "e.csv").write_text(HEADER + "\n" + csv_row(estimate))
    assert ",lost,,0," in (tmp_path / "e.csv").read_text()
    assert math.isnan(read_estimates(tmp_path / "e.csv").residual_m[0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rows: ["t,x,y", *rows[1:]], "line 1: expected the header"),
        (lambda rows: [*rows[:2], "1,2,3", *rows[3:]], "line 3: expected 22 values, found 3"),
        (lambda rows: [*rows[:2], rows[2].replace("tracking", "dreaming")], "line 3: 'dreaming'"),
        (lambda rows: [*rows, rows[1]], "line 4: the time does not increase"),
        (lambda rows: [*rows[:2], rows[2].replace(rows[2].split(",")[1], "north")], "line 3: could not convert"),
    ],
)
def test_a_broken_estimates_file_is_refused_with_the_line(tmp_path: Path, change, said: str) -> None:
    estimates = [Estimate(k * STEP_NS, true_pose(k + 1), np.eye(3), Status.TRACKING) for k in range(2)]
    rows = [HEADER, *(csv_row(estimate).strip() for estimate in estimates)]
    (tmp_path / "e.csv").write_text("\n".join(change(rows)) + "\n")
    with pytest.raises(InputError, match=said):
        read_estimates(tmp_path / "e.csv")


def test_frames_without_image_reach_the_system_and_are_counted(tmp_path: Path) -> None:
    system = FakeSystem(np.random.default_rng(0))
    tally = run_into(tmp_path / "run", FakeSource(8, missing=(3, 4)), system)
    assert [frame.image is None for frame in system.seen] == [k in (3, 4) for k in range(8)]
    assert tally.missing_images == 2
    assert tally.frames == 8


def test_black_stretches_are_found(tmp_path: Path) -> None:
    class Dim(FakeSource):
        def __iter__(self) -> Iterator[Frame]:
            for frame in super().__iter__():
                assert frame.image is not None
                yield replace(frame, image=(frame.image * 0.1).astype(np.uint8))

    tally = run_into(tmp_path / "run", Dim(10, black=(2, 3, 4, 7)))
    assert tally.black == 4  # others are as dark as a dim hall
    assert tally.black_ns == [(2 * STEP_NS, 4 * STEP_NS), (7 * STEP_NS, 7 * STEP_NS)]


def test_frames_that_fit_the_other_end_of_the_field_as_well_are_counted(tmp_path: Path) -> None:
    class Lost(FakeSystem):
        """Has no compass, until frame 6 tells it the side; a rival elsewhere is there throughout."""

        def step(self, frame: Frame) -> Estimate:
            estimate = super().step(frame)
            x, y, heading = estimate.pose
            rivals = [Hypothesis(Pose(-x + 0.3, -y, heading + math.pi), 0.02), Hypothesis(Pose(-x, -y, heading), 0.02)]
            return replace(estimate, hypotheses=tuple(rivals[0 if len(self.seen) <= 6 else 1 :]))

    tally = run_into(tmp_path / "run", FakeSource(10), Lost(np.random.default_rng(0), noise_m=0.0))
    assert tally.either_side == 5  # the first of the six is not located
    x, y, heading = true_pose(5).mirrored()
    told = tally.summary().either_side
    assert (told.count, told.other_pose, told.probability) == (5, pytest.approx((x, y, heading)), None)
    sure = run_into(tmp_path / "sure", FakeSource(10)).summary()
    assert sure.either_side == EitherSide()
    assert sure.said == []


def test_what_a_system_says_is_kept_once(tmp_path: Path) -> None:
    class Talking(FakeSystem):
        """Says the same of every image, and one thing more of the third."""

        def step(self, frame: Frame) -> Estimate:
            more = (Problem(ProblemCode.ODOMETRY_SCALE, "the wheels slip"),) if len(self.seen) == 2 else ()
            return replace(super().step(frame), problems=(Problem(ProblemCode.END_UNDECIDED, "undecided"), *more))

    said = run_into(tmp_path / "run", FakeSource(5), Talking(np.random.default_rng(0))).summary().said
    assert [one.code for one in said] == ["end-undecided", "odometry-scale"]
    assert said[1].t > said[0].t
    assert [one.images for one in said] == [5, 1]
    assert said_text(said[1]) == f"{said[1].t:.2f} s: the wheels slip"
    assert said_text(said[0]).endswith(f" to {said[0].until:.2f} s (5 images): undecided")


def test_every_latency_leaves_out_the_first_ten_images(tmp_path: Path) -> None:
    class Starting(FakeSystem):
        def step(self, frame: Frame) -> Estimate:
            return replace(super().step(frame), perception_ms=100.0 if len(self.seen) <= 10 else 1.0)

    latency = run_into(tmp_path / "run", FakeSource(30), Starting(np.random.default_rng(0))).summary().latency_ms
    assert latency.first_left_out == 10
    assert latency.perception.max == pytest.approx(1.0)
    assert latency.localization.max == pytest.approx(0.5)
    assert latency.total.p99 == pytest.approx(1.5, rel=0.01)
    assert latency.start_max == pytest.approx(100.5)
    few = run_into(tmp_path / "few", FakeSource(10), Starting(np.random.default_rng(0))).summary().latency_ms
    assert few.first_left_out == 0
    assert few.total.max == few.start_max == pytest.approx(100.5)


def test_a_wish_to_stop_ends_the_run_after_the_frame_at_hand(tmp_path: Path) -> None:
    done: list[Frame] = []
    with RunFolder(tmp_path) as writer:
        tally = run_frames(
            FakeSource(10),
            FakeSystem(np.random.default_rng(0)),
            writer,
            on_frame=[lambda frame, estimate: done.append(frame)],
            stop=lambda: len(done) == 3,
        )
    assert (tally.ended, tally.frames) == ("interrupted", 3)
    assert len(read_tum(tmp_path / "trajectory.tum")) == 3


def test_pictures_are_a_handful_and_hold_the_worst_fitting_frame(tmp_path: Path) -> None:
    tally = run_into(tmp_path / "run", FakeSource(200))
    assert tally.pictures is not None
    kept = tally.pictures.kept()
    assert len(kept) == 6
    assert [frame.index for frame in kept] == sorted(frame.index for frame in kept)
    assert kept[-1].index == 199  # the fake's residual grows
    assert kept[-1].reason == "largest residual"


def test_new_folders_are_numbered(tmp_path: Path) -> None:
    assert [new_folder(None, "demo", tmp_path / "runs").name for _ in range(3)] == ["demo-1", "demo-2", "demo-3"]


def test_a_summary_comes_back_and_keeps_a_path_that_is_no_utf_8(tmp_path: Path) -> None:
    whole = RunSummary(
        recording={"path": "games/\udcff", "name": "\udcff"}, prior={"pose": (1.0, 2.0, 0.5)}, seed=7
    ).updated(run_into(tmp_path / "run", FakeSource(5, black=(1, 2))).summary())
    write_summary(tmp_path, whole)
    assert read_summary(tmp_path) == whole


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is .* the folder of a run"):
        Run(tmp_path)
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(InputError, match="not valid JSON"):
        Run(tmp_path)
    (tmp_path / "summary.json").write_text("[]")
    with pytest.raises(InputError, match="expected a JSON object"):
        Run(tmp_path)


def test_evaluation_of_a_folder_knows_status_and_black_images(tmp_path: Path) -> None:
    run_into(tmp_path / "run", FakeSource(20, black=(5, 6)))
    write_tum(tmp_path / "truth.tum", true_samples(20))
    table = evaluate(tmp_path / "run", tmp_path / "truth.tum")
    assert (table.frames, table.before_first, table.black) == (17, 1, 2)
    assert 0.0 < table.x.mean < 0.03
    assert evaluate(tmp_path / "run", tmp_path / "truth.tum", skip=4).skipped == 4
    assert evaluate(tmp_path / "run" / "trajectory.tum", tmp_path / "truth.tum").frames == 20


def test_a_run_says_why_it_has_no_errors(tmp_path: Path) -> None:
    run_into(tmp_path / "run", FakeSource(5), FakeSystem(np.random.default_rng(0), searching=tuple(range(5))))
    run = Run(tmp_path / "run")
    run.truth = true_samples(5)
    assert run.errors is None
    assert run.why_no_errors.endswith("the robot was never located")
    run = Run(tmp_path / "run")
    run.truth = None
    assert run.errors is None
    assert run.why_no_errors == "the recording holds no truth to compare with"


def test_evaluation_without_truth_says_what_to_do(tmp_path: Path) -> None:
    run_into(tmp_path / "run", FakeSource(5))
    with pytest.raises(InputError, match="--truth FILE"):
        evaluate(tmp_path / "run" / "trajectory.tum")
    with pytest.raises(InputError, match="no such recording"):
        evaluate(tmp_path / "run")  # the recording is gone
    with pytest.raises(InputError, match="no such recording"):
        _ = Run(tmp_path / "run").errors
    with pytest.raises(InputError, match="no such run"):
        evaluate(tmp_path / "nowhere")
    write_summary(tmp_path / "run", RunSummary(frames=5))
    with pytest.raises(InputError, match="does not name its recording"):
        evaluate(tmp_path / "run")


def test_histogram_percentiles_are_within_its_bins() -> None:
    values = np.random.default_rng(3).lognormal(0.5, 0.8, 5000)
    histogram = LatencyHistogram()
    for value in values.tolist():
        histogram.add(value)
    assert len(histogram) == 5000
    for percent in (1, 50, 99, 100):
        exact = np.percentile(values, percent, method="inverted_cdf")
        assert histogram.percentile_ms(percent) == pytest.approx(exact, rel=0.0075)
    assert histogram.max_ms == values.max()


@pytest.mark.parametrize("stretches", ["[[1, 1e999]]", "[[1]]", "[1]", '"x"', "null"])
def test_a_summary_that_was_edited_is_refused_with_the_key(stretches: str, tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text(f'{{"black_images": {{"stretches_ns": {stretches}}}}}')
    with pytest.raises(InputError, match=r"'black_images\.stretches_ns.* is not as"):
        Run(tmp_path)
