"""`touchline check` reads the calibration off the lines."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from touchline.sources import open_source
from touchline.sources.check_lines import check_lines
from touchline.sources.findings import Finding, Severity
from touchline.sources.survey import take_survey

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


def test_a_leaning_mirror_is_told(recording: Path) -> None:
    """The table of a head whose rays all lean by half a degree, beside images of an upright one."""
    table = yaml.safe_load((recording / "camera.yaml").read_text())["range_table"]
    radii, upright = np.array(table["radius_px"])[:-10], np.array(table["range_m"])[:-10]
    bearings = np.arange(36) * 2 * math.pi / 36
    height = 0.75
    lean = math.radians(0.5) * np.cos(bearings)[:, None]
    ranges = np.maximum.accumulate(height * np.tan(np.arctan(upright / height) + lean).clip(0.001, 500), axis=1)
    ranges += 1e-6 * np.arange(len(radii))
    change_camera(
        recording,
        range_table={"radius_px": radii.tolist(), "bearing_rad": bearings.tolist(), "range_m": ranges.tolist()},
    )
    tilt = findings(recording)["tilt"]
    assert tilt.severity is Severity.NOTE
    assert float(tilt.what.split()[-1].rstrip("°")) == pytest.approx(0.25, abs=0.06)


def test_another_field_fits_no_pose(recording: Path) -> None:
    shutil.copy(Path(__file__).parents[1] / "src/touchline/field/presets/spl-9x6.yaml", recording / "field.yaml")
    assert findings(recording)["lines"].severity is Severity.WARNING
