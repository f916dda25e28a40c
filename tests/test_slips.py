"""Users' slips: numbers in other units, images of another size or without colour, told by `run` and by `check`."""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from touchline.api import prepare
from touchline.checks.check import check_recording
from touchline.checks.findings import Severity
from touchline.checks.slips import find_slips
from touchline.cli.run import execute
from touchline.errors import InputError, TouchlineError
from touchline.messages import length_unit
from touchline.sources import open_source
from touchline.types import ImageArray

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
IMAGES = 6
DEGREES = 180.0 / math.pi


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """The first images of the example, to be spoiled."""
    folder = tmp_path / "recording"
    shutil.copytree(EXAMPLE, folder, ignore=lambda path, names: [n for n in names if Path(path).name == "images"])
    rows = (folder / "images.csv").read_text().splitlines()[: IMAGES + 1]
    (folder / "images.csv").write_text("\n".join(rows) + "\n")
    for k in range(IMAGES):
        shutil.copy(EXAMPLE / "images" / f"{k:06d}.jpg", folder / "images")
    return folder


def change(path: Path, columns: Iterable[str], to: Callable[[float], float]) -> None:
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    for row in rows:
        for name in columns:
            row[header.index(name)] = f"{to(float(row[header.index(name)])):.17g}"
    path.write_text("\n".join(",".join(row) for row in [header, *rows]) + "\n")


def repaint(folder: Path, to: Callable[[ImageArray], ImageArray]) -> None:
    for path in (folder / "images").iterdir():
        image = cv2.imread(str(path))
        assert image is not None
        cv2.imwrite(str(path), to(image.astype(np.uint8)))


def turn(folder: Path, rad_per_s: float, per_rad: float) -> None:
    """Let compass and gyro see a robot that turns; the compass in a unit of its own."""
    change(folder / "imu.csv", ["gz"], lambda _: rad_per_s)
    times = iter(np.genfromtxt(folder / "imu.csv", delimiter=",", names=True)["t"].tolist())
    change(folder / "imu.csv", ["yaw"], lambda _: per_rad * math.remainder(rad_per_s * next(times), 2.0 * math.pi))


def found(folder: Path) -> list[tuple[str, str]]:
    """Codes and places."""
    return [(slip.code, slip.where) for slip in find_slips(open_source(folder))]


@pytest.mark.parametrize(("unit", "per_second"), [("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9)])
def test_times_in_other_units(recording: Path, unit: str, per_second: float) -> None:
    change(recording / "odometry.csv", ["t"], lambda t: per_second * t)
    (slip,) = find_slips(open_source(recording))
    assert (slip.code, slip.where, slip.what) == ("time-unit", "odometry.csv", f"the times look like {unit}")
    for name in ("images.csv", "imu.csv"):
        change(recording / name, ["t"], lambda t: per_second * t)
    assert found(recording) == [("time-unit", "images.csv, odometry.csv, imu.csv")]
    change(recording / "images.csv", ["t"], lambda t: per_second * 1.7e9 + t)  # counted from 1970
    with pytest.raises(InputError, match=f"names no image: its times look like {unit}, t is in seconds"):
        open_source(recording)


def in_degrees(folder: Path) -> list[str]:
    """Columns that are, of the IMU alone."""
    slips = find_slips(open_source(folder))
    assert {(slip.code, slip.where) for slip in slips} == {("angle-unit", "imu.csv")}
    return [slip.what.split("'")[1] for slip in slips]


def test_a_compass_in_degrees(recording: Path) -> None:
    turn(recording, 0.8, DEGREES)
    assert in_degrees(recording) == ["yaw"]
    change(recording / "imu.csv", ["gz"], lambda rate: DEGREES * rate)
    assert in_degrees(recording) == ["gz", "yaw"]


@pytest.mark.parametrize(("unit", "per_metre"), [("centimetres", 100.0), ("millimetres", 1000.0)])
def test_lengths_in_other_units(recording: Path, unit: str, per_metre: float) -> None:
    change(recording / "odometry.csv", ["x", "y"], lambda way: per_metre * way)
    (slip,) = find_slips(open_source(recording))
    assert (slip.code, slip.where, unit in slip.advice) == ("length-unit", "odometry.csv", True)


@pytest.mark.parametrize(("unit", "per_metre"), [("centimetres", 100.0), ("millimetres", 1000.0)])
def test_a_range_table_in_other_units(recording: Path, unit: str, per_metre: float) -> None:
    tree = yaml.safe_load((recording / "camera.yaml").read_text())
    tree["range_table"]["range_m"] = (per_metre * np.array(tree["range_table"]["range_m"])).tolist()
    (recording / "camera.yaml").write_text(yaml.safe_dump(tree))
    (slip,) = find_slips(open_source(recording))
    assert (slip.code, slip.where, unit in slip.advice) == ("length-unit", "camera.yaml", True)


def not_localised(folder: Path, tmp_path: Path) -> str:
    """The error that ends `touchline run`; `touchline check` finds one, too."""
    assert any(finding.severity is Severity.ERROR for finding in check_recording(folder))
    with pytest.raises(TouchlineError, match=f"none of {IMAGES} images was localised") as raised:
        execute(prepare(folder), tmp_path / "run")
    return str(raised.value)


@pytest.mark.parametrize(
    ("repainted", "why"),
    [
        (lambda image: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), "images.csv: the images are grey"),
        (lambda image: image[::2, ::2], "is 240×240 pixels, expected 480×480: 0.5 times that size"),
        (lambda image: image[:, :400], "is 400×480 pixels, expected 480×480"),
        (lambda image: image * 0 + 128, "in 6 of them, the image is black, or shows nothing at all"),
    ],
)
def test_images_that_cannot_be_localised_in(
    recording: Path, tmp_path: Path, repainted: Callable[[ImageArray], ImageArray], why: str
) -> None:
    repaint(recording, repainted)
    assert why in not_localised(recording, tmp_path)


# --- a perspective camera ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "spoil", "code"),
    [
        ("camera.yaml", lambda text: text.replace("z: 1.1", "z: 110"), "length-unit"),
        ("camera.yaml", lambda text: text.replace("pitch: 0.488692", "pitch: 28"), "angle-unit"),
        ("camera_pose.csv", lambda text: "t,x,y,z,roll,pitch,yaw\n0.1,0,0,1100,0,0.4,0\n", "length-unit"),
        ("camera_pose.csv", lambda text: "t,x,y,z,roll,pitch,yaw\n0.1,0,0,1.1,0,24,-50\n", "angle-unit"),
    ],
)
def test_where_a_camera_is_in_other_units(
    small_data: Path, tmp_path: Path, file: str, spoil: Callable[[str], str], code: str
) -> None:
    folder = Path(shutil.copytree(small_data / "humanoid_9x6_walk", tmp_path / "walk"))
    assert found(folder) == []
    path = folder / file
    path.write_text(spoil(path.read_text() if path.exists() else ""))
    assert found(folder) == [(code, file)]


def test_the_unit_of_a_length() -> None:
    units = [length_unit(number, 60.0) for number in (900.0, 6000.0, 6001.0, 18000.0)]
    assert units == ["centimetres", "centimetres", "millimetres", "millimetres"]
