"""What Python and notebooks show of systems, estimates, fields and runs; a run as a pandas table."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from fakes import FakeSource, FakeSystem, true_samples, write_recording

import touchline
from touchline.errors import InputError
from touchline.evaluation import Run
from touchline.evaluation.run import path_picture
from touchline.evaluation.run_data import carried_rows
from touchline.evaluation.run_folder import RunFolder, write_summary
from touchline.evaluation.runner import run_frames
from touchline.evaluation.summary import RunSummary
from touchline.systems import SYSTEMS, open_system
from touchline.types import Hypothesis, Problem, ProblemCode


@pytest.fixture
def run(tmp_path: Path) -> Run:
    recording = write_recording(tmp_path / "walk", 12)
    folder = tmp_path / "run"
    folder.mkdir()
    with RunFolder(folder) as writer:
        tally = run_frames(FakeSource(12), FakeSystem(np.random.default_rng(0), searching=(0,)), writer)
    summary = RunSummary(recording={"path": str(recording)}, system="fake").updated(tally.summary())
    write_summary(folder, summary)
    return Run(folder)


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_is_opened_from_names_and_dicts_and_says_what_it_is(name: str) -> None:
    from_name = open_system(name, "msl-18x12")
    from_dict = open_system(name, {"field": "msl-18x12", "wheel_directions_rad": (0.8, -0.8)}, {})
    kind = type(from_name).__name__
    assert repr(from_name) == f"{kind}(msl-18x12, no camera)"
    assert repr(from_dict) == f"{kind}(msl-18x12, no camera, two measuring wheels)"


@pytest.mark.parametrize(
    ("setup", "said"),
    [
        ({"field": "msl-18x12", "camra": "c.yaml"}, "which has no 'camra'; "),
        ({"camera": None}, "'field' is missing"),
        ("msl-18x21", "did you mean 'msl-18x12'"),
    ],
)
def test_a_setup_that_cannot_be_meant_is_answered_with_what_can(setup: Any, said: str) -> None:
    with pytest.raises(InputError, match=said):
        open_system("touchline", setup)


def test_an_estimate_reads_as_a_pose_with_its_uncertainty() -> None:
    covariance = np.diag([0.0004, 0.0009, np.radians(0.5) ** 2])
    pose = touchline.Pose(1.0, -2.5, np.radians(90.0))
    shown = repr(touchline.Estimate(1_500_000_000, pose, covariance, touchline.Status.TRACKING, 0.012, 45))
    assert shown == (
        "Estimate(1.500 s: x 1.000 ± 0.020 m, y -2.500 ± 0.030 m, heading 90.00 ± 0.50°, tracking, 45 points, "
        "residual 1.2 cm)"
    )


def drawn(shown: str) -> ElementTree.Element:
    """The picture in what a notebook shows."""
    return ElementTree.fromstring(shown[shown.index("<svg") : shown.index("</svg>") + len("</svg>")])


def counted(picture: ElementTree.Element, kind: str) -> int:
    return sum(part.tag.endswith(kind) for part in picture.iter())


def test_an_estimate_is_a_table_of_its_poses_in_a_notebook_and_marks_on_a_field() -> None:
    pose, covariance = touchline.Pose(1.0, -2.5, np.radians(90.0)), np.diag([0.0004, 0.0009, np.radians(0.5) ** 2])
    seen = touchline.Observation(0, np.array([[1.0, 0.0], [2.0, 0.0]]))
    others = (Hypothesis(pose.mirrored(), 0.012, 0.25, covariance), Hypothesis(touchline.Pose(3.0, 0.0, 0.0), np.nan))
    estimate = touchline.Estimate(
        1_500_000_000, pose, covariance, touchline.Status.TRACKING, 0.012, 2, others, 0.75, observation=seen,
        problems=(Problem(ProblemCode.SAMPLE_UNUSABLE, "gyro: < 0"),),
    )  # fmt: skip
    shown = estimate._repr_html_()
    cells = ["1.000 ± 0.020", "-2.500 ± 0.030", "90.000 ± 0.500", "1.2", "0.75"]
    assert f"<th>tracking</th><td>{'</td><td>'.join(cells)}</td></tr>" in shown
    assert shown.count("<tr><th>or</th>") == 2
    assert "<p>gyro: &lt; 0</p>" in shown
    assert "nan" not in shown
    marks = estimate.svg_marks()
    assert (marks.count("<polygon"), marks.count("<ellipse")) == (3, 2)
    assert "M1.00,-1.50h0 M1.00,-0.50h0" in marks  # the points, as seen from the pose


def test_a_localizer_shows_its_last_estimate_on_the_field() -> None:
    localizer = touchline.Localizer("msl-18x12")
    assert repr(localizer).endswith("(msl-18x12, no camera): no image yet)")
    assert counted(drawn(localizer._repr_html_()), "polygon") == 0
    localizer.localize(0, points=np.array([[2.0, 0.1 * k] for k in range(20)]))
    assert counted(drawn(localizer._repr_html_()), "polygon") >= 1
    assert "Estimate(0.000 s: " in repr(localizer)


def test_a_recording_and_its_frames_read_as_what_they_hold(tmp_path: Path) -> None:
    source = touchline.open_source(write_recording(tmp_path / "walk", 2))
    assert repr(source) == f"Recording({source.name}: 2 images, field {source.field.name}, camera omni)"
    frame, _ = source
    assert repr(frame).startswith("Frame(0.000 s: image ")
    assert "array" not in repr(frame)
    assert repr(touchline.Frame(1_500_000_000)) == "Frame(1.500 s: no image)"


def test_a_field_reads_as_its_sizes_and_is_drawn_in_a_notebook() -> None:
    field = touchline.open_field("spl-9x6")
    assert repr(field).startswith("FieldModel(spl-9x6: 9.05 × 6.05 m, 18 lines 0.05 m wide, 3 marks")
    picture = drawn(field._repr_svg_())
    assert picture.attrib["viewBox"].split() == ["-5.200", "-3.700", "10.400", "7.400"]
    paths = [part for part in picture.iter() if part.tag.endswith("path")]
    assert [path.attrib["d"].count("M") for path in paths] == [18]


def test_a_run_shows_its_errors_and_its_path(run: Run) -> None:
    assert repr(run).endswith("run': fake, 12 images)")
    shown = run._repr_html_()
    assert "position (cm)" in shown
    assert "data:image/png;base64," in shown
    moved = Run(run.folder)
    moved.summary = run.summary.updated(RunSummary(recording={"path": "gone"}))
    assert "no such recording" in moved._repr_html_()


def test_a_robot_that_was_carried_leaves_a_gap_in_its_path() -> None:
    poses = true_samples(20).values.copy()
    poses[12:, 0] += 5.0
    assert carried_rows(poses).tolist() == [12]
    field, truth = touchline.open_field("msl-18x12"), touchline.Samples(true_samples(20).stamp_ns, poses)
    assert path_picture(field, truth, np.zeros(20, np.int8), truth).shape[2] == 3


def test_a_run_is_a_pandas_table_where_pandas_is(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pip install pandas"):
        run.frame  # noqa: B018

    def made(columns: dict[str, Any], index: Any) -> Any:
        return SimpleNamespace(columns=columns, index=index)

    def index(values: Any, name: str) -> tuple[Any, str]:
        return values, name

    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=made, Index=index))
    frame = run.frame
    assert frame.index[1] == "stamp_ns"
    assert list(frame.columns)[:3] == ["x_m", "y_m", "heading_rad"]
    assert frame.columns["status"][:2] == ["searching", "tracking"]
    assert all(len(column) == 12 for column in frame.columns.values())
    assert np.isfinite(frame.columns["error_x_m"]).all()
