"""`touchline check` on recordings that were spoiled in one way each: it says what, where, how bad, and what to do."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from small_recordings import borrow, delete_lines, edit_line, replace_line, write_recording
from test_sources_broken import BROKEN_IMAGES, IMAGE_ROWS, ROWS, TRUTHS

from touchline.checks.check import CHECKS, check_recording
from touchline.checks.consistency import check_consistency
from touchline.checks.features import check_features
from touchline.checks.findings import Finding, Severity
from touchline.checks.lines import check_lines

WHEELS = {"a_dir_rad": math.pi / 4, "b_dir_rad": -math.pi / 4}
BAD = (Severity.WARNING, Severity.ERROR)
RUNNING = (check_lines, check_features, check_consistency)


@pytest.fixture
def arc(tmp_path: Path) -> Path:
    """Three seconds of an arc; nothing is wrong with its sensors, its images are noise."""
    return write_recording(tmp_path / "arc", frames=31, wheels=WHEELS)


@pytest.fixture
def real(tmp_path: Path, small_data: Path) -> Path:
    """Sixteen images of a public recording, free to be changed."""
    return borrow(small_data / "omni_msl_match", tmp_path / "match", frames=16)


@pytest.fixture(autouse=True)
def _without_runs(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """The checks that run a system have files of their own."""
    if "slow" not in request.keywords:
        monkeypatch.setattr("touchline.checks.check.CHECKS", [each for each in CHECKS if each not in RUNNING])


def found(folder: Path, check: str) -> Finding:
    """The worst finding of one check."""
    findings = [finding for finding in check_recording(folder) if finding.check == check]
    assert findings, f"no finding of {check}"
    return findings[0]


def assert_found(folder: Path, check: str, severity: Severity, where: str, what: str) -> None:
    """The worst finding of the check is this one, and it says what to do."""
    finding = found(folder, check)
    assert (finding.severity, finding.where) == (severity, where), finding
    assert re.search(what, finding.what), finding
    assert bool(finding.advice) == (severity is not Severity.OK), finding


def rewrite_column(file: Path, column: int, change: Callable[[float], float]) -> None:
    lines = file.read_text().split()
    for number, line in enumerate(lines[1:], start=1):
        cells = line.split(",")
        cells[column] = f"{change(float(cells[column])):.6f}"
        lines[number] = ",".join(cells)
    file.write_text("\n".join(lines))


def rewrite_yaml(file: Path, **keys: object) -> None:
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | keys))


def rewrite_images(folder: Path, indices: range, change: Callable[[np.ndarray, int], np.ndarray]) -> None:
    for index in indices:
        path = folder / f"images/{index:06d}.jpg"
        path.write_bytes(cv2.imencode(".jpg", change(cv2.imread(str(path)), index))[1].tobytes())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "warned"),
    [
        ("humanoid_9x6_walk", []),
        ("omni_9x6_points", []),
        ("omni_calibration", []),
        ("omni_exposure", ["images"]),  # linear: no image yet
        ("omni_msl_kidnap", ["light"]),  # the camera is covered twice for three images
        ("omni_msl_match", []),
        ("omni_msl_sun", []),
        ("omni_msl_track", []),
    ],
)
def test_no_false_alarm_on_the_public_recordings(shared_data: Path, name: str, warned: list[str]) -> None:
    findings = check_recording(shared_data / name)
    assert [finding.check for finding in findings if finding.severity in BAD] == warned
    order = [Severity.ERROR, Severity.WARNING, Severity.NOTE, Severity.OK]
    assert [finding.severity for finding in findings] == sorted((f.severity for f in findings), key=order.index)


def test_a_few_missing_images_are_a_warning_many_an_error(arc: Path) -> None:
    (arc / "images/000007.jpg").unlink()
    assert_found(arc, "images", Severity.WARNING, "images.csv", r"1 of 31 images: images\.csv, line 9 \(frame 7\)")
    for index in range(8, 16):
        (arc / f"images/{index:06d}.jpg").unlink()
    assert_found(arc, "images", Severity.ERROR, "images.csv", r"9 of 31 images: .*000007\.jpg is missing")


def test_dark_and_overexposed_images_are_named(real: Path) -> None:
    rewrite_images(real, range(3), lambda image, _: (image * 0.2).astype(np.uint8))
    assert_found(real, "light", Severity.WARNING, "images.csv", r"3 dark .*: frames 0, 1, 2")
    rewrite_images(real, range(3), lambda image, _: np.clip(image * 40.0, 0, 255).astype(np.uint8))
    assert_found(real, "light", Severity.WARNING, "images.csv", r"3 overexposed .*: frames 0, 1, 2")


def test_a_camera_out_of_focus_is_a_warning_motion_blur_a_note(real: Path) -> None:
    assert_found(real, "focus", Severity.OK, "images.csv", "sharp")
    rewrite_images(real, range(2), lambda image, _: cv2.GaussianBlur(image, (0, 0), 2.0))
    assert_found(real, "focus", Severity.NOTE, "images.csv", "2 blurred: frames 0, 1")
    rewrite_images(real, range(2, 16), lambda image, _: cv2.GaussianBlur(image, (0, 0), 2.0))
    assert_found(real, "focus", Severity.WARNING, "images.csv", "the images are blurred")


def test_broken_rows_and_gaps_are_summed_up_by_file(arc: Path) -> None:
    edit_line(arc / "imu.csv", 9, 3, "x")
    edit_line(arc / "imu.csv", 12, 3, "x")
    delete_lines(arc / "odometry.csv", 20, 40)
    rows = [finding for finding in check_recording(arc) if finding.check == "rows"]
    assert [(finding.severity, finding.where) for finding in rows] == [
        (Severity.WARNING, "imu.csv, line 9"),
        (Severity.WARNING, "odometry.csv, line 20"),
    ]
    assert rows[0].what.endswith("(and 1 more like it)")
    assert "nothing for 0.440 s" in rows[1].what


def test_an_unusable_sensor_file_is_an_error_and_nothing_else_is_said_of_it(arc: Path) -> None:
    (arc / "wheels.csv").write_text("t;a;b\n0;1;2\n")
    assert_found(
        arc, "rows", Severity.ERROR, "wheels.csv, line 1", "separated by commas; the recording is read without"
    )
    assert all(finding.check != "sensors" for finding in check_recording(arc))


def test_a_missing_compass_is_a_warning_that_says_what_to_do(arc: Path) -> None:
    lines = [line.split(",") for line in (arc / "imu.csv").read_text().splitlines()]
    (arc / "imu.csv").write_text("\n".join(",".join([*cells[:3], cells[3][:0], *cells[4:]]) for cells in lines[1:]))
    header = ",".join(lines[0])
    (arc / "imu.csv").write_text(header + "\n" + (arc / "imu.csv").read_text())
    assert_found(arc, "compass", Severity.WARNING, "imu.csv", "column 'yaw' is empty: no compass")
    assert "--own-half" in found(arc, "compass").advice
    assert all("clock" not in finding.advice for finding in check_recording(arc))
    (arc / "imu.csv").unlink()
    assert_found(arc, "compass", Severity.WARNING, "imu.csv", "is not there: no compass")


def test_a_sensor_on_another_clock_is_an_error(arc: Path) -> None:
    rewrite_column(arc / "imu.csv", 0, lambda time_s: time_s + 1000.0)
    assert_found(arc, "sensors", Severity.ERROR, "imu.csv", "no sample lies between the first and the last image")


@pytest.mark.parametrize(
    ("file", "columns", "what"),
    [
        ("imu.csv", [3], "yaw stay the same from t = 0.50 s"),
        ("odometry.csv", [3], "theta stay the same from t = 0.50 s"),
        ("odometry.csv", [1, 2], "x and y stay the same from t = 0.50 s"),
        ("wheels.csv", [1, 2], "a and b stay the same from t = 0.50 s"),
    ],
)
def test_a_stuck_sensor_is_found_while_another_moves(arc: Path, file: str, columns: list[int], what: str) -> None:
    assert all(finding.check != "stuck" for finding in check_recording(arc))
    for line in range(27, 162):  # from 0.5 s on
        for column in columns:
            edit_line(arc / file, line, column, "0.25")
    assert_found(arc, "stuck", Severity.WARNING, file, what)


def test_wheels_in_centimetres_are_an_error(arc: Path) -> None:
    for column in (1, 2):
        rewrite_column(arc / "wheels.csv", column, lambda travel: 100.0 * travel)
    assert_found(arc, "wheels", Severity.ERROR, "wheels.csv", r"99\.0\d+ × the way")


def test_a_wheel_that_counts_backwards_is_an_error(arc: Path) -> None:
    rewrite_column(arc / "wheels.csv", 1, lambda travel: -travel)
    assert_found(arc, "wheels", Severity.ERROR, "wheels.csv", r"turned by -90")


def test_swapped_wheels_of_a_drive_in_many_directions_are_mirror_images(tmp_path: Path) -> None:
    """The robot goes round twice without turning."""
    folder = write_recording(tmp_path / "rounds", frames=121, wheels=WHEELS)
    seconds = np.arange(0.0, 12.5, 0.02)
    x, y = np.sin(seconds), 1.0 - np.cos(seconds)
    a, b = (x - y) / math.sqrt(2.0), (x + y) / math.sqrt(2.0)
    for name, header, columns in (("odometry", "t,x,y,theta", (x, y, 0.0 * x)), ("wheels", "t,a,b", (a, b))):
        table = np.column_stack((seconds, *columns))
        np.savetxt(folder / f"{name}.csv", table, "%.6f", ",", header=header, comments="")
    assert_found(folder, "wheels", Severity.ERROR, "wheels.csv", "mirror images of each other")


def test_wheels_need_their_directions(arc: Path) -> None:
    rewrite_yaml(arc / "sequence.yaml", wheels={"a_dir_rad": 0.5})
    assert_found(arc, "wheels", Severity.WARNING, "sequence.yaml", "names no rolling directions")
    rewrite_yaml(arc / "sequence.yaml", wheels={"a_dir_rad": 0.5, "b_dir_rad": 0.5})
    assert_found(arc, "wheels", Severity.ERROR, "sequence.yaml", "nearly parallel")


def test_a_compass_that_counts_clockwise_is_an_error(arc: Path) -> None:
    assert_found(arc, "turns", Severity.OK, "imu.csv", r"the compass turns 1\.000 × as far as gz")
    rewrite_column(arc / "imu.csv", 3, lambda yaw: -yaw)
    assert_found(arc, "turns", Severity.ERROR, "imu.csv", r"the compass turns -1\.000 ×")


def standing(folder: Path, rate: float) -> None:
    """Make the arc a robot that stands, with a gyro that says `rate` (rad/s)."""
    for file, columns in (("odometry.csv", (1, 2, 3)), ("wheels.csv", (1, 2)), ("imu.csv", (3,))):
        for column in columns:
            rewrite_column(folder / file, column, lambda _: 0.25)
    rewrite_column(folder / "imu.csv", 6, lambda _: rate)


def test_the_bias_of_the_gyro_is_measured_at_rest(arc: Path) -> None:
    assert_found(arc, "gyro bias", Severity.NOTE, "imu.csv", "not measured")
    standing(arc, math.radians(0.4))
    assert_found(arc, "gyro bias", Severity.OK, "imu.csv", r"gz is \+0\.40°/s while the robot stands")
    standing(arc, math.radians(-4.0))
    assert_found(arc, "gyro bias", Severity.WARNING, "imu.csv", r"gz is -4\.00°/s")


def test_a_late_compass_is_found(tmp_path: Path) -> None:
    folder = write_recording(tmp_path / "r", frames=60)
    for late_s, severity in ((0.02, Severity.OK), (0.15, Severity.WARNING)):
        rows = ["t,roll,pitch,yaw,gx,gy,gz"]
        for time_s in np.arange(0, 6.2, 0.02):
            yaw = 0.6 * math.sin(3.0 * (time_s - late_s))
            rows.append(f"{time_s:.3f},0,0,{yaw:.6f},0,0,{1.8 * math.cos(3.0 * time_s):.6f}")
        (folder / "imu.csv").write_text("\n".join(rows))
        finding = found(folder, "compass lag")
        assert finding.severity is severity
        measured = re.search(r"the compass is (\d+) ± \d+ ms late, 0 ms documented", finding.what)
        assert measured is not None
        assert float(measured[1]) == pytest.approx(1000 * late_s, abs=10)


def test_a_turned_compass_is_found_where_the_truth_is_known(arc: Path) -> None:
    assert_found(arc, "compass", Severity.OK, "imu.csv", r"0\.0° off the true heading")
    rewrite_column(arc / "imu.csv", 3, lambda yaw: yaw + math.radians(9.0))
    assert_found(arc, "compass", Severity.NOTE, "imu.csv", r"\+9\.0° off")
    rewrite_column(arc / "imu.csv", 3, lambda yaw: yaw + math.radians(11.0))
    assert_found(arc, "compass", Severity.WARNING, "imu.csv", r"\+20\.0° off")
    rewrite_column(arc / "imu.csv", 3, lambda yaw: yaw + math.radians(70.0))
    assert_found(arc, "compass", Severity.ERROR, "imu.csv", r"\+90\.0° off")


def test_without_camera_yaml_there_is_an_error(arc: Path) -> None:
    assert_found(arc, "camera", Severity.ERROR, "camera.yaml", "is missing")


@pytest.mark.parametrize(
    ("keys", "severity", "what"),
    [
        ({"center": [700.0, 239.5]}, Severity.ERROR, r"center \(700, 239\.5\) lies outside the image of 480×480"),
        ({"outer_radius_px": 300.0}, Severity.WARNING, r"outer_radius_px 300 reaches beyond the image"),
        ({"handedness": 0}, Severity.ERROR, "handedness"),
        ({"range_table": {"radius_px": [0, 200, 100], "range_m": [0, 1, 2]}}, Severity.ERROR, r"range_table"),
        ({"range_table": {"radius_px": [0, 100, 200], "range_m": [0, 2, 1]}}, Severity.ERROR, r"range_table"),
        ({"range_table": {"radius_px": [0, 50, 80], "range_m": [0, 1, 9]}}, Severity.WARNING, "covers 0 to 80 px"),
        ({"range_table": {"radius_px": [0, 99, 220], "range_m": [0, 0.1, 0.9]}}, Severity.WARNING, "ends at 0.90 m"),
    ],
)
def test_a_senseless_camera_yaml_is_found(real: Path, keys: dict[str, object], severity: Severity, what: str) -> None:
    rewrite_yaml(real / "camera.yaml", **keys)
    assert_found(real, "camera", severity, "camera.yaml", what)


def test_the_mirror_is_found_to_a_fraction_of_a_pixel(real: Path) -> None:
    rewrite_yaml(real / "camera.yaml", center=[244.5, 236.5])
    finding = found(real, "mirror")
    assert finding.severity is Severity.WARNING
    measured = re.search(r"centred at \((.*), (.*)\), 5\.\d px", finding.what)
    assert measured is not None
    np.testing.assert_allclose([float(number) for number in measured.groups()], [239.5, 239.5], atol=0.3)


def test_a_wrong_handedness_is_an_error(small_data: Path, tmp_path: Path) -> None:
    folder = borrow(small_data / "omni_msl_match", tmp_path / "match", frames=30)
    assert_found(folder, "handedness", Severity.OK, "camera.yaml", "as handedness says")
    rewrite_yaml(folder / "camera.yaml", handedness=1)
    assert_found(folder, "handedness", Severity.ERROR, "camera.yaml", "turns against handedness")


def test_another_field_than_the_named_one_is_found(real: Path) -> None:
    assert_found(real, "field", Severity.OK, "field.yaml", "18 × 12 m, lines 12.5 cm, as the preset")
    rewrite_yaml(real / "sequence.yaml", field="msl-22x14")
    assert_found(
        real, "field", Severity.WARNING, "field.yaml", r"up to \d\.\d\d m from those of the preset 'msl-22x14'"
    )
    rewrite_yaml(real / "sequence.yaml", field="our lab")
    finding = found(real, "field")
    assert finding.severity is Severity.NOTE
    assert "'our lab', which is no preset" in finding.what


def test_where_the_truth_has_ended_nothing_is_compared(real: Path) -> None:
    truth = real / "ground_truth.tum"
    truth.write_text("".join(truth.read_text().splitlines(keepends=True)[:3]))
    findings = [finding for finding in check_recording(real) if finding.where == "ground_truth.tum"]
    assert {finding.severity for finding in findings} == {Severity.WARNING, Severity.NOTE}
    assert any("holds 3 usable poses" in finding.what for finding in findings)
    assert any("not compared with the true poses" in finding.what for finding in findings)


def test_a_truth_outside_the_hall_is_an_error(arc: Path) -> None:
    replace_line(arc / "ground_truth.tum", 3, "0.3 900 0 0 0 0 0 1")
    assert_found(arc, "truth", Severity.ERROR, "ground_truth.tum", "poses more than 5 m outside the lines: frame 2")


def test_a_truth_that_moves_otherwise_than_odometry_is_an_error(arc: Path) -> None:
    assert_found(arc, "truth", Severity.OK, "ground_truth.tum", r"1\.000 × the way of odometry")
    lines = [line.split() for line in (arc / "ground_truth.tum").read_text().splitlines()]
    turned = [[t, str(-float(y)), x, *rest] for t, x, y, *rest in lines]
    (arc / "ground_truth.tum").write_text("\n".join(" ".join(line) for line in turned))
    assert_found(arc, "truth", Severity.ERROR, "ground_truth.tum", r"turned by \+90\.\d°")


DAMAGES = [BROKEN_IMAGES["noise inside"], ROWS["a word"], IMAGE_ROWS["no file"], TRUTHS["NaN"]]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("damage", [damage for damage, *_ in DAMAGES])
def test_whatever_is_reported_while_reading_is_a_finding(tmp_path: Path, damage: Callable[[Path], object]) -> None:
    folder = write_recording(tmp_path / "small", frames=8, wheels=WHEELS)
    damage(folder)
    assert any(finding.severity in BAD for finding in check_recording(folder) if finding.check in ("images", "rows"))


def test_a_recording_of_one_image_can_be_checked(tmp_path: Path) -> None:
    findings = check_recording(write_recording(tmp_path / "one", frames=1, rate_hz=None))
    assert "holds a single image" in {finding.what for finding in findings}
