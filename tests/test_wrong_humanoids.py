"""What can't be localised as a humanoid's recording is told in one clear sentence, whichever command is asked."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_recordings import borrow

from touchline.api import prepare
from touchline.cli import main
from touchline.errors import InputError
from touchline.evaluation.runner import robot_setup
from touchline.published.nimbro_lines.system import NimbroLines
from touchline.sources import open_source

FRAMES = 5
NO_LEAN = "nothing tells how the camera leans at this image"
NO_FIELD = "no green carpet found around the robot"
UNKNOWN = "kind 'corner-flag' is not known"


def rewrite(path: Path, text: str) -> None:
    path.unlink(missing_ok=True)  # borrowed files are links
    path.write_bytes(text.encode())


def observed(folder: Path, camera: str, rows: list[str]) -> Path:
    """A recording of what a detector of the robot's own found, eight frames a second."""
    folder.mkdir(exist_ok=True)
    rewrite(folder / "sequence.yaml", f"{{format: 1, field: humanoid-kid-9x6, camera: {camera}, rate_hz: 8}}\n")
    lines = [f"{0.125 * k},{row}" for k in range(1, FRAMES + 1) for row in rows]
    (folder / "observations.csv").write_text("\n".join(["t,kind,x_m,y_m,x2_m,y2_m", *lines]) + "\n")
    return folder


@pytest.fixture(scope="module")
def wrong(small_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of recordings, each wrong in its own way."""
    place = tmp_path_factory.mktemp("wrong")
    walk = small_data / "humanoid_9x6_walk"
    (borrow(walk, place / "no-lean", frames=FRAMES) / "imu.csv").unlink()
    imu = borrow(walk, place / "fallen", frames=FRAMES) / "imu.csv"
    header, *rows = csv.reader(imu.read_text().splitlines())
    for row in rows:
        row[header.index("pitch")] = "1.3"
    rewrite(imu, "\n".join(",".join(row) for row in [header, *rows]) + "\n")
    hall = borrow(walk, place / "no-field", frames=FRAMES) / "images"
    names = sorted(file.name for file in hall.iterdir())
    hall.unlink() if hall.is_symlink() else shutil.rmtree(hall)
    hall.mkdir()
    wall = np.full((480, 752, 3), (110, 130, 150), np.uint8)
    wall[300:] = (60, 80, 110)
    for name in names:
        cv2.imwrite(str(hall / name), wall)
    shutil.copy(walk / "camera.yaml", place / "camera.yaml")
    observed(place / "unknown", "none", ["corner-flag,1.8,0.7,,"])
    borrow(small_data / "omni_msl_track", place / "mirror", frames=FRAMES)
    return place


@pytest.mark.parametrize(
    ("command", "status", "told"),
    [
        ("check no-lean", 1, NO_LEAN),
        ("view no-lean", 0, NO_LEAN),
        ("locate no-lean/images/000000.jpg --camera camera.yaml --field indoor-9x6", 2, NO_LEAN),
        ("calibrate colour no-field --output colours.npz", 2, NO_FIELD),
        ("view fallen", 0, "the robot lies"),
        ("run no-field --system nimbro-lines", 1, NO_FIELD),
        ("check no-field", 1, NO_FIELD),
        ("view no-field", 0, NO_FIELD),
        ("run unknown --system nimbro-lines", 1, UNKNOWN),
        ("check unknown", 1, UNKNOWN),
        ("view unknown", 2, "has no images to draw on"),
        ("run mirror --system nimbro-lines", 2, "this camera is an omni: take --system touchline"),
        ("view mirror --system nimbro-lines", 2, "this camera is an omni: take --system touchline"),
        ("calibrate imu mirror --output out.yaml", 2, "its camera looks at a mirror"),
    ],
)
def test_each_command_says_what_is_wrong(
    wrong: Path,
    command: str,
    status: int,
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(wrong)
    monkeypatch.setenv("COLUMNS", "2000")
    assert main(command.split()) == status
    said = capsys.readouterr()
    assert " ".join((said.out + said.err).split()).count(told) == 1


def test_the_height_behind_a_detector_is_that_of_camera_yaml(wrong: Path) -> None:
    """It was taken for 1 m without a word; it tells what an error of the lean does to the features."""
    rows = ["line,1.36,-1.16,2.36,2.90", "X,1.82,0.71,,"]
    without = prepare(observed(wrong / "without", "none", rows), "nimbro-lines")
    assert any("nothing tells how high the camera is: 1 m is assumed" in notice for notice in without.notices)
    folder = observed(wrong / "with", "pinhole", rows)
    shutil.copy(wrong / "camera.yaml", folder / "camera.yaml")
    found = prepare(folder, "nimbro-lines")
    assert not any("how high" in notice for notice in found.notices)
    assert robot_setup(open_source(folder)).height_m == pytest.approx(1.1)
    assert isinstance(found.system, NimbroLines)
    assert found.system.features.height_m == found.system.tracker.filter.height_m == pytest.approx(1.1)


def test_lone_carriage_returns_are_named(wrong: Path) -> None:
    listed = wrong / "fallen" / "images.csv"
    header, *rows = listed.read_text().splitlines()
    rewrite(listed, "\r".join([header, *rows]))
    with pytest.raises(InputError, match=r"images.csv: ends its lines with a lone carriage return \(\\r\): save it"):
        open_source(wrong / "fallen")
    rewrite(listed, "\n".join([header, *rows[:-2], "\r".join(rows[-2:])]) + "\n")
    problems = [str(problem) for problem in open_source(wrong / "fallen").problems]
    assert any("holds a carriage return (\\r) that ends no line" in problem for problem in problems)
    rewrite(listed, "\n".join([header, *rows]) + "\n")
