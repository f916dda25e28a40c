"""Broken recordings: what can't be opened says why in one message; what can be survived is reported and counted."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_recordings import delete_lines, edit_line, replace_line, write_recording, write_sensors
from syrupy.assertion import SnapshotAssertion

from touchline.checks.check import check_recording
from touchline.checks.findings import Severity
from touchline.errors import InputError
from touchline.sources import ProblemKind, open_source
from touchline.sources.problems import KEPT_PER_KIND

Damage = Callable[[Path], object]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "small")


def write(name: str, text: str) -> Damage:
    return lambda folder: (folder / name).write_text(text)


def remove(name: str) -> Damage:
    return lambda folder: (folder / name).unlink()


def edit(name: str, line: int, column: int, value: str) -> Damage:
    return lambda folder: edit_line(folder / name, line, column, value)


def replaced(name: str, line: int, text: str) -> Damage:
    return lambda folder: replace_line(folder / name, line, text)


def described(**keys: object) -> Damage:
    """sequence.yaml with other keys; None leaves a key out."""
    about = {"format": 1, "field": "msl-18x12", "camera": "omni", "rate_hz": 10} | keys
    lines = "".join(f"{key}: {value}\n" for key, value in about.items() if value is not None)
    return write("sequence.yaml", lines)


CAMERA = "model: omni\nwidth: 48\nheight: 32\n"
WHOLE_CAMERA = CAMERA + (
    "center: [24, 16]\ninner_radius_px: 2\nouter_radius_px: 9\nhandedness: 1\nmount_yaw: 0\n"
    "range_table: {radius_px: [0, 10], range_m: [0, 3]}\n"
)
UNREADABLE: dict[str, Damage] = {
    "no sequence.yaml": remove("sequence.yaml"),
    "no images.csv": remove("images.csv"),
    "sequence.yaml is no YAML": write("sequence.yaml", "format: 1\nfield: [1"),
    "sequence.yaml is a list": write("sequence.yaml", "- 1\n"),
    "sequence.yaml is no text": lambda folder: (folder / "sequence.yaml").write_bytes(b"\xff\xfe\x00"),
    "no format": described(format=None),
    "a later format": described(format=2),
    "a format in words": described(format="one"),
    "no field": described(field=None),
    "an unknown field": described(field="msl-18x21"),
    "a field that is a list": described(field="[1, 2]"),
    "no camera": described(camera=None),
    "an unknown camera": described(camera="onmi"),
    "another camera model": write("camera.yaml", "model: pinhole\n"),
    "images.csv is empty": write("images.csv", ""),
    "images.csv has no image": write("images.csv", "t,file\n"),
    "images.csv has no good row": write("images.csv", "t,file\nx,a.jpg\n0.1\n"),
    "images.csv lacks a column": write("images.csv", "t,name\n0.1,a.jpg\n"),
    "images.csv is no text": lambda folder: (folder / "images.csv").write_bytes(b"\x89PNG\x1b[31m\n"),
    "a camera of an unknown model": write("camera.yaml", CAMERA.replace("omni", "spherical")),
    "a camera without model": write("camera.yaml", CAMERA.removeprefix("model: omni\n")),
    "a camera without width": write("camera.yaml", CAMERA.replace("width: 48\n", "")),
    "a camera without center": write("camera.yaml", CAMERA),
    "a camera with another word": write("camera.yaml", CAMERA + "centre: [1, 2]\n"),
    "a size in words": write("camera.yaml", WHOLE_CAMERA.replace("32", "low")),
}


def test_what_cannot_be_opened_says_why_and_where(tmp_path: Path, snapshot: SnapshotAssertion) -> None:
    said = []
    for case, damage in UNREADABLE.items():
        folder = write_recording(tmp_path / case.replace(" ", "-"), frames=1)
        damage(folder)
        with pytest.raises(InputError) as error:
            _ = open_source(folder).camera
        assert str(folder) in str(error.value)
        said.append(f"{case}: {str(error.value).replace(str(folder), 'FOLDER')}")
    assert "\n".join(said) == snapshot


def test_a_camera_file_that_lacks_a_key_is_a_finding_of_the_check(folder: Path) -> None:
    write("camera.yaml", CAMERA + "centre: [1, 2]\n")(folder)
    (found,) = (finding for finding in check_recording(folder) if finding.check == "camera")
    assert (found.severity, found.where) == (Severity.ERROR, "camera.yaml")


UNUSABLE_SENSORS: dict[str, tuple[Damage, str, str]] = {
    "lacks a column": (replaced("odometry.csv", 1, "t,x,y,z"), "odometry", r"odometry\.csv, line 1: column 'theta' is"),
    "has semicolons": (
        replaced("wheels.csv", 1, "t;a;b"),
        "wheels",
        r"found: t;a;b.* expected t,a,b, separated by commas",
    ),
    "is binary": (
        lambda f: (f / "imu.csv").write_bytes(b"t,\x00\x1b[2J\xff\n"),
        "compass",
        r"imu\.csv: is not a text file",
    ),
    "is a folder": (
        lambda f: ((f / "wheels.csv").unlink(), (f / "wheels.csv").mkdir()),
        "wheels",
        r"wheels\.csv: cannot be read \(Is a directory\)",
    ),
}


@pytest.mark.parametrize("case", UNUSABLE_SENSORS)
def test_a_recording_is_read_without_a_sensor_whose_file_is_unusable(folder: Path, case: str) -> None:
    damage, sensor, message = UNUSABLE_SENSORS[case]
    damage(folder)
    source = open_source(folder)
    frames = list(source)
    assert len(frames) == 8
    assert all(getattr(frame, sensor) is None for frame in frames)
    assert source.problems.counts == {ProblemKind.SENSOR_FILE: 1}
    (problem,) = source.problems
    assert re.match(f".*{message}", problem.message), problem.message
    assert problem.message.endswith("the recording is read without it")
    assert problem.message.isprintable()
    others = {"odometry", "wheels", "gyro"} - {"gyro" if sensor == "compass" else sensor}
    assert all(getattr(frames[-1], other) is not None for other in others)


@pytest.mark.parametrize("nothing", ["", " ", "nan"])
def test_an_empty_cell_of_the_imu_costs_one_quantity_and_no_row(folder: Path, nothing: str) -> None:
    for line in (5, 6, 30):
        edit_line(folder / "imu.csv", line, 3, nothing)
    edit_line(folder / "imu.csv", 8, 0 + 1, nothing)
    source = open_source(folder)
    frames = list(source)
    compass, gyro, tilt = (
        sum(len(samples) for frame in frames if (samples := getattr(frame, name)) is not None)
        for name in ("compass", "gyro", "tilt")
    )
    assert (compass, gyro, tilt) == (gyro - 3, 41, gyro - 1)
    assert source.problems.counts == {ProblemKind.EMPTY_COLUMN: 2}
    rows = len((folder / "imu.csv").read_text().splitlines()) - 1
    what = "in {} of {} rows; what it measures is unknown there"
    assert [problem.message for problem in source.problems] == [
        f"imu.csv: column 'roll' is empty {what.format(1, rows)}",
        f"imu.csv: column 'yaw' is empty {what.format(3, rows)}",
    ]


def test_a_path_that_is_no_recording_says_so(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such recording"):
        open_source(tmp_path / "nowhere")
    (tmp_path / "match.bag").write_bytes(b"#ROSBAG")
    with pytest.raises(InputError, match=r"match\.bag: ends like a bag but is none"):
        open_source(tmp_path / "match.bag")
    (tmp_path / "notes").write_bytes(b"Friday")
    with pytest.raises(InputError, match=r"notes: is not a recording; expected a folder"):
        open_source(tmp_path / "notes")


def cut(name: str, share: float) -> Damage:
    """Keep the first part of a file."""

    def damage(folder: Path) -> None:
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: int(share * len(data))])

    return damage


def overwritten(name: str, with_bytes: bytes) -> Damage:
    """Put other bytes in the middle of a file."""

    def damage(folder: Path) -> None:
        data = bytearray((folder / name).read_bytes())
        middle = len(data) // 2
        data[middle : middle + len(with_bytes)] = with_bytes
        (folder / name).write_bytes(data)

    return damage


def image_of(name: str, shape: tuple[int, ...], dtype: type[np.generic]) -> Damage:
    """Write another image under the name, as PNG whatever the name says."""
    pixels = np.full(shape, 9, dtype=dtype)
    return lambda folder: (folder / name).write_bytes(cv2.imencode(".png", pixels)[1].tobytes())


IMAGE = "images/000003.jpg"
NOISE = np.random.default_rng(3).integers(0, 256, 600, dtype=np.uint8).tobytes()
PLACE = r"images\.csv, line 5 \(frame 3\): images/000003\.jpg "
BROKEN_IMAGES: dict[str, tuple[Damage, ProblemKind, str]] = {
    "missing": (remove(IMAGE), ProblemKind.MISSING_IMAGE, "is missing"),
    "a folder": (
        lambda folder: ((folder / IMAGE).unlink(), (folder / IMAGE).mkdir()),
        ProblemKind.MISSING_IMAGE,
        "cannot be read",
    ),
    "empty": (cut(IMAGE, 0.0), ProblemKind.BROKEN_IMAGE, "is empty"),
    "cut off": (cut(IMAGE, 0.7), ProblemKind.BROKEN_IMAGE, "is a JPEG file that ends early"),
    "noise inside": (overwritten(IMAGE, NOISE), ProblemKind.BROKEN_IMAGE, "is a damaged JPEG file"),
    "text": (write(IMAGE, "not an image"), ProblemKind.BROKEN_IMAGE, "is not an image that can be decoded"),
    "of another size": (image_of(IMAGE, (40, 48, 3), np.uint8), ProblemKind.IMAGE_SIZE, "is 48×40 .* expected 48×32"),
    "16-bit": (image_of(IMAGE, (32, 48, 3), np.uint16), ProblemKind.LINEAR_IMAGE, "holds 16-bit"),
}


@pytest.mark.parametrize("case", BROKEN_IMAGES)
def test_a_broken_image_is_reported_and_survived(folder: Path, case: str) -> None:
    damage, kind, message = BROKEN_IMAGES[case]
    damage(folder)
    source = open_source(folder)
    frames = list(source)
    assert [frame.image is None for frame in frames] == [index == 3 for index in range(8)]
    assert re.match(PLACE + message, frames[3].problem or ""), frames[3].problem
    assert frames[3].odometry is not None  # the sensors of that frame are there all the same
    assert source.problems.counts == {kind: 1}
    problem = source.problems[0]
    assert (problem.file, problem.line, problem.frame, problem.message) == ("images.csv", 5, 3, frames[3].problem)


@pytest.mark.parametrize("filling", [b"", NOISE * 4])
def test_a_jpeg_that_is_damaged_inside_is_broken(folder: Path, small_data: Path, filling: bytes) -> None:
    """OpenCV decodes these: an upper half that is right, below it a picture of its own."""
    data = (small_data / "omni_msl_track" / "images" / "000010.jpg").read_bytes()
    middle = len(data) // 2
    (folder / IMAGE).write_bytes(data[:middle] + filling + data[middle + 4000 :])
    assert cv2.imread(str(folder / IMAGE)) is not None
    assert "is a damaged JPEG file" in (list(open_source(folder))[3].problem or "")


def test_a_jpeg_with_a_thumbnail_and_a_trailer_is_whole(folder: Path) -> None:
    """The thumbnail in the header ends like an image, and a camera may write what it likes behind the image."""
    data = (folder / IMAGE).read_bytes()
    header = b"Exif\0\0" + data
    segment = b"\xff\xe1" + (len(header) + 2).to_bytes(2, "big") + header
    (folder / IMAGE).write_bytes(data[:2] + segment + data[2:] + b"\xff\x01trailer")
    assert all(frame.image is not None for frame in open_source(folder))
    cut(IMAGE, 0.8)(folder)
    source = open_source(folder)
    assert "is a JPEG file that ends early" in (list(source)[3].problem or "")


def test_images_have_to_be_of_the_size_in_camera_yaml(folder: Path) -> None:
    (folder / "camera.yaml").write_text("model: omni\nwidth: 64\nheight: 32\n")
    source = open_source(folder)
    assert all(frame.image is None for frame in source)
    assert source.problems.counts == {ProblemKind.IMAGE_SIZE: 8}


ROWS: dict[str, tuple[Damage, ProblemKind, str]] = {
    "too few values": (replaced("odometry.csv", 15, "0.260,1.0"), ProblemKind.BROKEN_ROW, "has 2 values where the"),
    "too many values": (replaced("wheels.csv", 15, "0.260,1,2,3"), ProblemKind.BROKEN_ROW, "has 4 values where the"),
    "a word": (edit("imu.csv", 15, 3, "north"), ProblemKind.BROKEN_ROW, "column 'yaw' reads 'north'"),
    "an empty cell": (edit("odometry.csv", 15, 2, ""), ProblemKind.BROKEN_ROW, "'y' reads empty"),
    "NaN": (edit("odometry.csv", 15, 3, "nan"), ProblemKind.NOT_A_NUMBER, "column 'theta' is nan"),
    "infinity": (edit("wheels.csv", 15, 1, "-inf"), ProblemKind.NOT_A_NUMBER, "column 'a' is -inf"),
    "time beyond clocks": (edit("imu.csv", 15, 0, "1e30"), ProblemKind.BROKEN_ROW, "'t' is 1e.30, beyond"),
    "a value beyond sense": (edit("wheels.csv", 15, 2, "-1e99"), ProblemKind.BROKEN_ROW, "'b' is -1e"),
    "time running backwards": (edit("odometry.csv", 15, 0, "0.100"), ProblemKind.TIME_ORDER, "the time 0.1 s runs"),
    "a repeated time": (edit("imu.csv", 15, 0, "0.240"), ProblemKind.TIME_ORDER, "repeats"),
    "a time far ahead": (edit("wheels.csv", 15, 0, "999"), ProblemKind.TIME_ORDER, "the time 999 s"),
    "no text at all": (replaced("imu.csv", 15, "\x00\x01,\x02"), ProblemKind.BROKEN_ROW, "has 2 values"),
}


@pytest.mark.parametrize("case", ROWS)
def test_a_broken_sensor_row_is_left_out_and_reported_with_its_line(folder: Path, case: str) -> None:
    damage, kind, message = ROWS[case]
    damage(folder)
    source = open_source(folder)
    frames = list(source)
    assert source.problems.counts == {kind: 1}
    problem = source.problems[0]
    assert (problem.line, problem.kind) == (15, kind)
    assert re.match(rf"{problem.file}, line 15: .*{message}", problem.message), problem.message
    of_file = {"odometry.csv": "odometry", "wheels.csv": "wheels", "imu.csv": "gyro"}[problem.file]
    stamps = np.concatenate([getattr(frame, of_file).stamp_ns for frame in frames])
    expected = np.delete(np.arange(41) * 20_000_000, 13)  # line 15 held the sample at 0.26 s
    np.testing.assert_array_equal(stamps, expected)


def test_a_sensor_gap_is_reported_and_survived(folder: Path) -> None:
    delete_lines(folder / "odometry.csv", 13, 22)
    source = open_source(folder)
    frames = list(source)
    assert [frame.odometry is None for frame in frames] == [False, False, True, True, False, False, False, False]
    assert source.problems.counts == {ProblemKind.SENSOR_GAP: 1}
    assert re.match(r"odometry\.csv, line 13: nothing for 0\.220 s before t = 0\.420 s", source.problems[0].message)


def test_a_sensor_that_starts_late_and_ends_early_is_reported(folder: Path) -> None:
    lines = (folder / "wheels.csv").read_text().splitlines()
    (folder / "wheels.csv").write_text("\n".join([lines[0], *lines[20:30]]) + "\n")  # 0.38 s to 0.56 s
    source = open_source(folder)
    list(source)
    assert [problem.message for problem in source.problems] == [
        "wheels.csv: starts at t = 0.380 s, the first image is at t = 0.100 s",
        "wheels.csv: ends at t = 0.560 s, images go on at t = 0.700 s",
    ]


def test_a_clock_set_back_leaves_out_as_few_rows_as_possible(folder: Path) -> None:
    lines = (folder / "imu.csv").read_text().splitlines()
    repeated = lines[:21] + lines[11:]  # the ten rows from 0.20 s on come twice
    (folder / "imu.csv").write_text("\n".join(repeated))
    source = open_source(folder)
    frames = list(source)
    assert source.problems.counts == {ProblemKind.TIME_ORDER: 10}
    assert [problem.line for problem in source.problems] == list(range(22, 32))
    assert sum(len(frame.gyro) for frame in frames if frame.gyro is not None) == 41


IMAGE_ROWS: dict[str, tuple[Damage, ProblemKind, str]] = {
    "too few values": (replaced("images.csv", 5, "0.4000"), ProblemKind.BROKEN_ROW, "has 1 value where"),
    "a word for a time": (edit("images.csv", 5, 0, "soon"), ProblemKind.BROKEN_ROW, "column 't' reads 'soon'"),
    "NaN": (edit("images.csv", 5, 0, "nan"), ProblemKind.NOT_A_NUMBER, "column 't' is nan"),
    "no file": (edit("images.csv", 5, 1, " "), ProblemKind.BROKEN_ROW, "names no file"),
    "time running backwards": (edit("images.csv", 5, 0, "0.05"), ProblemKind.TIME_ORDER, "runs backwards"),
    "a time far ahead": (edit("images.csv", 5, 0, "77"), ProblemKind.TIME_ORDER, "the time 77 s"),
}


@pytest.mark.parametrize("case", IMAGE_ROWS)
def test_a_broken_image_row_is_left_out_and_reported_with_its_line(folder: Path, case: str) -> None:
    damage, kind, message = IMAGE_ROWS[case]
    damage(folder)
    source = open_source(folder)
    assert source.problems.counts == {kind: 1, ProblemKind.TRUTH: 1}  # the truth has one pose more now
    assert re.match(rf"images\.csv, line 5: .*{message}", source.problems[0].message), source.problems[0].message
    frames = list(source)
    assert len(source) == len(frames) == 7
    assert [frame.name[-5] for frame in frames] == list("0124567")


TRUTHS: dict[str, tuple[Damage, ProblemKind, str]] = {
    "another length": (lambda f: delete_lines(f / "ground_truth.tum", 8, 8), ProblemKind.TRUTH, "7 usable poses for 8"),
    "other times": (
        replaced("ground_truth.tum", 3, "0.31 0 0 0 0 0 0 1"),
        ProblemKind.TRUTH,
        r"pose 2 is at t = 0\.31",
    ),
    "a word": (replaced("ground_truth.tum", 3, "0.3 x 0 0 0 0 0 1"), ProblemKind.BROKEN_ROW, "line 3: x reads 'x'"),
    "too few values": (replaced("ground_truth.tum", 3, "0.3 1 2"), ProblemKind.BROKEN_ROW, "line 3: has 3 values"),
    "NaN": (replaced("ground_truth.tum", 3, "0.3 nan 0 0 0 0 0 1"), ProblemKind.NOT_A_NUMBER, "line 3: x is nan"),
    "no rotation": (replaced("ground_truth.tum", 3, "0.3 0 0 0 0 0 0 0"), ProblemKind.BROKEN_ROW, "line 3: needs"),
    "backwards": (replaced("ground_truth.tum", 3, "0.1 0 0 0 0 0 0 1"), ProblemKind.TIME_ORDER, "line 3: the time 0.1"),
}


@pytest.mark.parametrize("case", TRUTHS)
def test_a_broken_truth_is_reported_and_survived(folder: Path, case: str) -> None:
    damage, kind, message = TRUTHS[case]
    damage(folder)
    source = open_source(folder)
    assert re.search(rf"ground_truth\.tum.*{message}", source.problems[0].message), source.problems[0].message
    assert source.problems[0].kind is kind
    assert len(list(source)) == 8
    assert source.truth is not None
    assert len(source.truth) == (8 if case == "other times" else 7)


def test_broken_events_are_left_out_and_reported(tmp_path: Path) -> None:
    source = open_source(write_recording(tmp_path / "a", events=[{"t": 0.3, "kind": "slip"}, {"kind": "slip"}, 7]))
    assert len(source.events) == 1
    assert source.problems.counts == {ProblemKind.SEQUENCE: 2}
    assert not open_source(write_recording(tmp_path / "b", events="none")).events


def test_all_problems_are_counted_and_the_first_of_each_kind_kept(folder: Path) -> None:
    write_sensors(folder, 2000)
    for name in ("imu.csv", "wheels.csv"):
        lines = (folder / name).read_text().splitlines()
        spoiled = [f"{line},extra" if number % 2 else line for number, line in enumerate(lines[1:])]
        (folder / name).write_text("\n".join([lines[0], *spoiled]))
    (folder / IMAGE).unlink()
    source = open_source(folder)
    list(source)
    problems = source.problems
    assert problems.counts == {ProblemKind.BROKEN_ROW: 2000, ProblemKind.MISSING_IMAGE: 1}
    assert problems.total == 2001
    assert len(problems) == KEPT_PER_KIND + 2  # the image, and the first of the second file
    assert "2000 × broken row" in problems.summary()
    assert "1 × missing image" in problems.summary()
