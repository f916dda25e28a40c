"""`touchline check` reads the calibration off the lines."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from touchline.checks.findings import Finding, Severity
from touchline.checks.lines import check_lines
from touchline.checks.survey import take_survey
from touchline.sources import open_source

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"


def findings(folder: Path) -> dict[str, Finding]:
    return {finding.check: finding for finding in check_lines(take_survey(open_source(folder)))}


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return Path(shutil.copytree(EXAMPLE, tmp_path / "recording"))


def change_camera(recording: Path, **changes: Any) -> None:
    path = recording / "camera.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | changes))


def test_a_good_recording_gets_good_marks() -> None:
    found = findings(EXAMPLE)
    assert {name: f.severity for name, f in found.items()} == {"lines": Severity.OK, "tilt": Severity.OK}
    assert "tracked in 60 of 60 images" in found["lines"].what


@pytest.mark.parametrize(("factor", "word"), [(1.03, "long"), (0.97, "short")])
def test_a_wrong_scale_of_the_ranges_is_told(recording: Path, factor: float, word: str) -> None:
    table = yaml.safe_load((recording / "camera.yaml").read_text())["range_table"]
    table["range_m"] = [round(factor * value, 5) for value in table["range_m"]]
    change_camera(recording, range_table=table)
    scale = findings(recording)["ranges"]
    assert scale.severity is Severity.WARNING
    assert word in scale.what
    assert float(scale.what.split()[-2]) == pytest.approx(3.0, abs=0.8)


@pytest.mark.slow
@pytest.mark.parametrize(("turned_deg", "severity"), [(2.0, Severity.NOTE), (-4.0, Severity.WARNING)])
def test_a_turned_camera_is_told_with_what_to_add(recording: Path, turned_deg: float, severity: Severity) -> None:
    mount_yaw = yaml.safe_load((recording / "camera.yaml").read_text())["mount_yaw"]
    change_camera(recording, mount_yaw=mount_yaw + math.radians(turned_deg))
    heading = findings(recording)["heading"]
    assert heading.severity is severity
    assert "mount_yaw" in heading.advice
    to_add = float(heading.advice.split("add ")[1].split(" rad")[0])
    assert math.degrees(to_add) == pytest.approx(-turned_deg, abs=0.3)


def test_few_images_tell_nothing(recording: Path) -> None:
    rows = (recording / "images.csv").read_text().splitlines()
    (recording / "images.csv").write_text("\n".join(rows[:4]))
    lines = findings(recording)["lines"]
    assert lines.severity is Severity.NOTE
    assert lines.what == "too few images to tell whether the lines fit: 3 usable, 5 are needed"
