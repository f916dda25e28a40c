"""`touchline check` reads a humanoid's camera and field off lines, crossings and landmarks."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from small_recordings import borrow

from touchline.api import prepare
from touchline.checks.features import check_features
from touchline.checks.findings import Finding, Severity
from touchline.checks.images import check_observations
from touchline.checks.lines import check_lines
from touchline.checks.sensors import check_presence
from touchline.checks.survey import Survey, take_survey
from touchline.cli.run import execute
from touchline.errors import TouchlineError
from touchline.sources import open_source

SEEN = (
    ("line", 1.36, -1.16, 2.36, 2.90),
    ("X", 1.82, 0.71, "", ""),
    ("X", 1.48, -0.70, "", ""),
    ("T", 2.36, 2.90, "", ""),
)


def survey(folder: Path) -> Survey:
    return take_survey(open_source(folder))


def only(folder: Path) -> Finding:
    (finding,) = check_features(survey(folder))
    return finding


def observed(folder: Path, kinds: tuple[str, ...]) -> Path:
    """A robot that stands and sees the same in twelve images."""
    folder.mkdir()
    (folder / "sequence.yaml").write_text("{format: 1, field: humanoid-kid-9x6, camera: none, rate_hz: 8}\n")
    rows = [["t", "kind", "x_m", "y_m", "x2_m", "y2_m"]]
    rows += [[str(0.125 * k), *map(str, each)] for k in range(1, 13) for each in SEEN if each[0] in kinds]
    (folder / "observations.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    return folder


@pytest.mark.parametrize("name", ["humanoid_9x6_walk", "humanoid_hsl_pan"])
def test_a_humanoid_without_imu_is_told_of_a_start_only_where_the_ends_look_alike(
    small_data: Path, tmp_path: Path, name: str
) -> None:
    """Its system asks no compass: coloured goals tell the ends apart, white ones don't."""
    folder = borrow(small_data / name, tmp_path / "walk", frames=3)
    (folder / "imu.csv").unlink(missing_ok=True)
    found = [finding for finding in check_presence(survey(folder)) if finding.check in ("compass", "ends")]
    if name == "humanoid_9x6_walk":
        assert not found
    else:
        (finding,) = found
        assert (finding.severity, finding.where) == (Severity.NOTE, "field.yaml")
        assert finding.advice.startswith("Tell where the robot starts, --start X,Y,HEADING or --own-half")


@pytest.mark.slow
def test_a_fallen_robot_is_told_with_one_cause(
    small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each image names another angle; `run` counted each of them by itself and named none."""
    folder = borrow(small_data / "humanoid_9x6_walk", tmp_path / "walk", frames=6)
    imu = folder / "imu.csv"
    header, *rows = csv.reader(imu.read_text().splitlines())
    for number, row in enumerate(rows):
        row[header.index("pitch")] = str(1.3 + 0.001 * number)
    imu.unlink()
    imu.write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")
    found = only(folder)
    assert found.severity is Severity.ERROR
    assert found.what.endswith("more than 60°")
    assert found.advice == "It has fallen, or roll and pitch are not in radians."
    with pytest.raises(TouchlineError, match="in 6 of them, the robot leans by"):
        execute(prepare(folder, "nimbro-lines"), tmp_path / "run")
    assert "searching 6" in capsys.readouterr().out


def test_features_without_points_are_good_for_a_humanoid(tmp_path: Path) -> None:
    folder = observed(tmp_path / "seen", ("line", "X", "T"))
    assert list(check_lines(survey(folder))) == []
    (told,) = check_observations(survey(folder))
    assert told.severity is Severity.NOTE
    assert "nimbro-lines takes them" in told.advice
    assert only(folder).severity is Severity.OK


def test_a_mirror_has_another_check(small_data: Path) -> None:
    assert list(check_features(survey(small_data / "omni_msl_track"))) == []
