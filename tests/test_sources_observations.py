"""observations.csv and camera_pose.csv: what a robot's own detector found, and where its moving head was."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from touchline.checks.check import check_recording
from touchline.errors import InputError
from touchline.sources import ProblemKind, Recording, open_source
from touchline.sources.observations import HEADER, observation_rows
from touchline.types import (
    Crossings,
    Landmarks,
    LinePoints,
    Lines,
    Observation,
    generic_covariances,
    points_at,
)
from touchline.view.look import look_at_recording

SEQUENCE = "format: 1\nfield: msl-18x12\ncamera: none\nrate_hz: 10\n"


def recording(folder: Path, rows: list[str], header: str = HEADER, sequence: str = SEQUENCE) -> Recording:
    (folder / "sequence.yaml").write_text(sequence)
    (folder / "observations.csv").write_text("\n".join([header, *rows]) + "\n")
    return open_source(folder)


def everything() -> Observation:
    """Something of every kind."""
    rng = np.random.default_rng(1)

    def places(n: int) -> tuple[np.ndarray, ...]:
        at = rng.uniform(-5.0, 5.0, (n, 2))
        return at, generic_covariances(at) * 1.5, rng.uniform(0.1, 1.0, n), np.full((n, 2), np.nan)

    ends = rng.uniform(-5.0, 5.0, (2, 2, 2))
    at, covariances, sure, pixels = places(4)
    crossings = Crossings(
        np.array(["L", "L", "T", "X"]), at, np.array([0.1, np.nan, -3.0, 1.5]), covariances, sure, pixels
    )
    at, covariances, sure, pixels = places(6)
    kinds = np.array(["post", "post", "pole", "goal", "penalty_mark", "circle"])
    colors: tuple[tuple[str, ...], ...] = ((), ("yellow",), ("blue", "yellow", "blue"), ("blue",), (), ())
    return Observation(
        100_000_000,
        LinePoints(*places(5)),
        Lines(ends, np.stack([generic_covariances(pair) for pair in ends]), np.ones(2), np.full((2, 2, 2), np.nan)),
        crossings,
        Landmarks(kinds, at, covariances, sure, colors, pixels),
        LinePoints(*places(3)),
    )


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    written = everything()
    source = recording(tmp_path, observation_rows(written))
    (frame,) = source
    read = frame.observation
    assert read is not None
    assert (frame.stamp_ns, read.stamp_ns, frame.image, frame.problem) == (100_000_000, 100_000_000, None, None)
    for part, arrays in (
        ("points", ("positions_m", "covariances_m2", "confidences")),
        ("lines", ("ends_m", "covariances_m2", "confidences")),
        ("crossings", ("positions_m", "covariances_m2", "confidences", "orientations_rad")),
        ("landmarks", ("positions_m", "covariances_m2", "confidences")),
        ("boundary", ("positions_m", "covariances_m2", "confidences")),
    ):
        for name in arrays:
            one, other = (getattr(getattr(seen, part), name) for seen in (read, written))
            np.testing.assert_allclose(one, other, rtol=1e-6, err_msg=f"{part}.{name}")
    assert read.crossings.kinds.tolist() == written.crossings.kinds.tolist()
    assert read.landmarks.kinds.tolist() == written.landmarks.kinds.tolist()
    assert read.landmarks.colors == written.landmarks.colors
    assert source.problems.total == 0


def test_rows_that_say_no_more_than_a_place_are_enough(tmp_path: Path) -> None:
    rows = ["1.5,-2.0,0.1,point", "2.5,1.0,0.1,point", ",,0.2,none", "1,1,0.3,L"]
    one, blind, crossed = (frame.observation for frame in recording(tmp_path, rows, "x_m,y_m,t,kind"))
    assert one is not None
    assert blind is not None
    assert crossed is not None
    wanted = points_at(np.array([[1.5, -2.0], [2.5, 1.0]]))
    np.testing.assert_array_equal(one.points.positions_m, wanted.positions_m)
    np.testing.assert_array_equal(one.points.covariances_m2, wanted.covariances_m2)
    assert one.points.confidences.tolist() == [1.0, 1.0]
    assert len(blind.points) == len(blind.crossings) == 0
    assert math.isnan(crossed.crossings.orientations_rad[0])


BROKEN = {
    "0.1,pint,1,2": "kind 'pint' is not known; did you mean 'point'",
    "0.1,point,1": "has 14 values where the header names 15 columns",
    "0.1,point,one,2": "column 'x_m' reads 'one', which is not a number",
    "0.1,point,1,": "column 'y_m' is empty, but a point needs it",
    "0.1,point,1,nan": "column 'y_m' is nan, which is no measurement",
    "0.1,line,1,2,3": "column 'y2_m' is empty, but a line needs it",
    "0.1,point,1,2,,,,1,5,1": "cov_xx, cov_xy, cov_yy are no covariance",
    "0.1,point,1,2,,,,-1,0,1": "cov_xx, cov_xy, cov_yy are no covariance",
    "0.1,L,1,2,,,,,,,,,,,3": "confidence is 3, expected 0 to 1",
    "0.1x,point,1,2": "column 't' reads '0.1x', which is not a number",
    "inf,point,1,2": "column 't' is inf",
}


@pytest.mark.parametrize("text", BROKEN)
def test_a_broken_row_is_named_with_file_and_line_and_left_out(tmp_path: Path, text: str) -> None:
    def full(row: str) -> str:
        return row + "," * (14 - row.count(",")) if row[4:] != "point,1" else row + "," * 11

    good = full("0.1,point,1,2")
    source = recording(tmp_path, [good, full(text), good, full("0.2,none")])
    first, second = source
    assert first.observation is not None
    assert len(first.observation.points) == 2
    assert second.stamp_ns == 200_000_000
    (problem,) = source.problems
    assert problem.message.startswith("observations.csv, line 3: ")
    assert BROKEN[text] in problem.message


def test_times_that_run_backwards_are_reported_and_left_out(tmp_path: Path) -> None:
    rows = [f"{t},point,{k},0" + "," * 11 for k, t in enumerate((0.1, 0.2, 0.2, 9.0, 0.3, 0.4, 0.1, 0.5))]
    source = recording(tmp_path, rows)
    assert [frame.stamp_ns for frame in source] == [k * 100_000_000 for k in range(1, 6)]
    assert [(p.kind, p.line) for p in source.problems] == [(ProblemKind.TIME_ORDER, 5), (ProblemKind.TIME_ORDER, 8)]


def test_without_a_camera_the_file_is_needed(tmp_path: Path) -> None:
    (tmp_path / "sequence.yaml").write_text(SEQUENCE)
    with pytest.raises(InputError, match=r"observations\.csv: is missing, but sequence.yaml says camera 'none'"):
        open_source(tmp_path)
    with pytest.raises(InputError, match=r"observations\.csv, line 1: column 'kind' is missing"):
        recording(tmp_path, [], "t,x_m,y_m")
    with pytest.raises(InputError, match=r"observations\.csv: holds no observation"):
        recording(tmp_path, [])


def test_observations_beside_images_come_with_them(tmp_path: Path) -> None:
    rows = ["0.1000001,point,1,0" + "," * 11, "0.25,point,2,0" + "," * 11, "0.3,none" + "," * 13]
    (tmp_path / "images.csv").write_text("t,file\n0.1,a.jpg\n0.2,b.jpg\n0.3,c.jpg\n")
    source = recording(tmp_path, rows, sequence=SEQUENCE.replace("none", "omni"))
    first, second, third = source
    assert first.observation is not None
    assert len(first.observation.points) == 1
    assert second.observation is None
    assert third.observation is not None
    assert len(third.observation.points) == 0
    (unmatched,) = (p for p in source.problems if p.file == "observations.csv")
    assert unmatched.line == 3
    assert "no image of images.csv was taken at t = 0.2500 s" in unmatched.message
    (tmp_path / "observations.csv").write_text("x,y\n")
    source = open_source(tmp_path)
    assert next(iter(source)).observation is None
    assert source.problems.counts[ProblemKind.SENSOR_FILE] == 1


def test_a_recording_without_images_is_checked_and_has_nothing_to_draw_on(tmp_path: Path) -> None:
    source = recording(tmp_path, observation_rows(everything()))
    assert (source.camera_kind, source.has_images, len(source)) == ("none", False, 1)
    findings = {(finding.check, finding.severity.value): finding for finding in check_recording(source)}
    assert "× point" in findings["observations", "ok"].what
    assert ("camera", "ok") in findings
    with pytest.raises(InputError, match="has no images to draw on"):
        look_at_recording(tmp_path)


def test_the_pose_of_the_camera_is_interpolated(tmp_path: Path) -> None:
    times = (0.08, 0.12, 0.2, 0.6)
    lines = [f"{t},{t},0,1.1,0,0.5,{yaw}" for t, yaw in zip(times, (3.1, -3.1, 0.0, 0.0), strict=True)]
    (tmp_path / "camera_pose.csv").write_text("\n".join(["t,x,y,z,roll,pitch,yaw", *lines]) + "\n")
    source = recording(tmp_path, [f"{t},none" + "," * 13 for t in (0.05, 0.1, 0.2, 0.4, 0.65)])
    before, between, at, far, after = (frame.base_from_camera for frame in source)
    assert before is not None
    assert before.translation_m[0] == 0.08
    assert between is not None
    assert between.translation_m == pytest.approx([0.1, 0.0, 1.1])
    roll, pitch, yaw = between.roll_pitch_yaw()
    assert (roll, pitch, abs(yaw)) == pytest.approx((0.0, 0.5, math.pi))
    assert at is not None
    assert at.translation_m[0] == pytest.approx(0.2)
    assert far is None
    assert after is not None
    assert source.problems.counts[ProblemKind.SENSOR_GAP] == 1
