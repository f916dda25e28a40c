"""What Python and notebooks show of systems, estimates, fields and runs; a run as a pandas table."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from fakes import FakeSource, FakeSystem, write_recording

import touchline
from touchline.errors import InputError
from touchline.evaluation import Run
from touchline.evaluation.run_folder import RunFolder, write_summary
from touchline.evaluation.runner import run_frames
from touchline.evaluation.summary import RunSummary
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
