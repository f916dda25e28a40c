"""`touchline compare`: runs of one recording side by side."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes import FakeSource, FakeSystem, write_recording

from touchline.cli import main
from touchline.errors import InputError
from touchline.evaluation.compare import compare, comparison_page, parting_lines
from touchline.evaluation.run_folder import RunFolder, write_summary
from touchline.evaluation.runner import run_frames
from touchline.evaluation.summary import RunSummary
from touchline.geometry import Pose
from touchline.types import Estimate, Frame

COUNT = 20


class Shifted(FakeSystem):
    """Stands a metre aside in the images from the 10th to the 13th."""

    def step(self, frame: Frame) -> Estimate:
        estimate = super().step(frame)
        if 10 <= len(self.seen) - 1 < 14:
            object.__setattr__(estimate, "pose", Pose(estimate.pose.x, estimate.pose.y + 1.0, estimate.pose.heading))
        return estimate


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_recording(tmp_path_factory.mktemp("recording") / "walk", COUNT)


def made(folder: Path, recording: Path, system: FakeSystem, name: str = "walk", **settings: Any) -> Path:
    folder.mkdir()
    with RunFolder(folder) as writer:
        tally = run_frames(FakeSource(COUNT), system, writer)
    about = {"path": str(recording), "name": name, "field": "msl-18x12"}
    told = {"system": "fake", "seed": 0, "settings": {"matching": {"c_m": 0.25, **settings}}, "recording": about}
    write_summary(folder, RunSummary(**told).updated(tally.summary()))
    return folder


@pytest.fixture
def runs(tmp_path: Path, recording: Path) -> list[Path]:
    systems = [kind(np.random.default_rng(0), searching=()) for kind in (FakeSystem, Shifted, FakeSystem)]
    changed = ({}, {"c_m": 0.3}, {})
    return [
        made(tmp_path / name, recording, system, **change)
        for name, system, change in zip("abc", systems, changed, strict=True)
    ]


def test_what_differs_and_where_they_part(runs: list[Path]) -> None:
    compared = compare(runs)
    assert compared.differing_settings() == [("matching.c_m", ["0.25", "0.3", "0.25"])]
    assert not compared.is_same(1)
    assert compared.is_same(2)
    ((begin, end, largest, images),) = compared.stretches(1)
    assert (begin, end, largest, images) == (pytest.approx(1.0), pytest.approx(1.3), pytest.approx(1.0, abs=1e-5), 4)
    parted, same = parting_lines(compared)
    assert "in 4 images: 1.00–1.30 s (up to 1.00 m)" in parted
    assert same == "c and a: the same poses in all 20 images"
    figures = dict(compared.figures())
    assert figures["a"] == figures["c"]
    assert float(figures["b"][0]) > float(figures["a"][0]) + 15.0
    assert figures["b"][4] == "0.40"  # seconds that a wrong pose was called tracking


def test_the_command_prints_both_and_writes_a_page(
    runs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    page = tmp_path / "compared.html"
    assert main(["compare", *map(str, runs), "-o", str(page)]) == 0
    said = capsys.readouterr().out
    assert "matching.c_m" in said
    assert all(len(line) <= 80 for line in said.splitlines()[:6])
    text = page.read_text(encoding="utf-8")
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    tree = json.loads(data)
    assert [run["name"] for run in tree["runs"]] == ["a", "b", "c", "truth"]
    assert [chart["title"].partition(" (")[0] for chart in tree["charts"]] == [
        "Position error", "Heading error", "Distance from a",
    ]  # fmt: skip
    assert tree["charts"][0]["range"][1] < 1000.0
    assert main(["compare", *map(str, runs), "-o", str(page)]) == 2
    assert "not overwritten" in capsys.readouterr().err


def test_a_run_that_was_cut_short_is_compared_as_far_as_it_goes(runs: list[Path]) -> None:
    for name in ("estimates.csv", "trajectory.tum"):
        path = runs[1] / name
        path.write_text("".join(path.read_text().splitlines(keepends=True)[:9]))
    compared = compare(runs[:2])
    assert np.isnan(compared.distances_m(1)[9:]).all()
    assert comparison_page(compared).count("<tr>") >= 3


def test_a_setting_that_only_another_system_has_does_not_differ(tmp_path: Path, recording: Path) -> None:
    one, other, late = (
        made(tmp_path / name, recording, FakeSystem(np.random.default_rng(0)), **settings)
        for name, settings in (("one", {"x": 1}), ("other", {"y": 2}), ("late", {}))
    )
    summary = json.loads((other / "summary.json").read_text())
    (other / "summary.json").write_text(json.dumps({**summary, "system": "else"}))
    assert [key for key, _ in compare([one, other]).differing_settings()] == ["system"]
    assert [key for key, _ in compare([one, late]).differing_settings()] == ["matching.x"]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["a"], "expected two to 6 runs, got 1"),
        (["a", "a"], "the same run is given twice"),
        (["a", "nowhere"], "is .*nowhere the folder of a run"),
        (["a", "other"], "other is a run of field trip, .*a of walk; compare runs of one recording"),
        (["a", "empty"], "holds no image to compare"),
        (["gone", "gone2"], "no run finds its recording"),
    ],
)
def test_runs_that_cannot_be_compared_are_refused(
    names: list[str], said: str, runs: list[Path], recording: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    made(tmp_path / "other", recording, FakeSystem(rng), "field trip")
    made(tmp_path / "gone", tmp_path / "moved", FakeSystem(rng))
    made(tmp_path / "gone2", tmp_path / "moved", FakeSystem(rng))
    empty = made(tmp_path / "empty", recording, FakeSystem(rng))
    (empty / "estimates.csv").write_text((empty / "estimates.csv").read_text().splitlines(keepends=True)[0])
    with pytest.raises(InputError, match=said):
        compare([tmp_path / name for name in names])
