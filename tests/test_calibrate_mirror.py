"""Model-free mirror calibration: interpolation in closed form, rendered strips of a known tilt, bad recordings."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from strip_scenes import EDGES_M, HANDEDNESS, YAW_RAD, tilted_camera, write_strip_recording
from syrupy.assertion import SnapshotAssertion

from touchline.camera import OmniCamera, open_camera
from touchline.camera.model_free import lagrange, periodic_lagrange, range_image, ranges_along, table_radii
from touchline.camera.writing import camera_yaml
from touchline.cli import main
from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.published.strip.mirror import MirrorCalibration, calibrate_mirror
from touchline.sources import open_source


def ring_points(low_m: float, high_m: float, bearings: int = 144, ranges: int = 120) -> FloatArray:
    """Points (N, 2) at every bearing and range."""
    b, r = np.meshgrid(np.arange(bearings) * 2 * np.pi / bearings, np.linspace(low_m, high_m, ranges))
    return np.column_stack(((r * np.cos(b)).ravel(), (r * np.sin(b)).ravel()))


def range_errors(found: OmniCamera, true: OmniCamera, low_m: float, high_m: float) -> tuple[FloatArray, FloatArray]:
    """True ranges (N,) and the errors (N,) of the ranges that a camera reads at their pixels (m)."""
    points = ring_points(low_m, high_m)
    read = found.ground_from_image(true.image_from_ground(points))
    ranges = np.hypot(*points.T)
    return ranges, np.hypot(*read.T) - ranges


# --- interpolation ----------------------------------------------------------------------------------------------------


def test_four_support_points_reproduce_a_cubic_exactly() -> None:
    x = np.array([0.0, 1.0, 2.5, 3.0, 4.2, 6.0, 7.0])
    at = np.linspace(0.0, 7.0, 41)
    assert lagrange(x, x**3 - 2.0 * x, at) == pytest.approx(at**3 - 2.0 * at, abs=1e-10)


def test_interpolation_around_the_circle_knows_no_seam() -> None:
    angles = np.radians(np.arange(-180.0, 180.0, 15.0))
    at = np.radians(np.linspace(-720.0, 720.0, 97))
    assert periodic_lagrange(angles, 5.0 + np.cos(angles - 1.0), at) == pytest.approx(5.0 + np.cos(at - 1.0), abs=2e-4)


@pytest.mark.parametrize("last_m", [2.0, 2.0 + 1e-12, 1.9])
def test_ranges_that_no_longer_grow_are_continued(last_m: float) -> None:
    radii, ranges = np.array([[50.0, 70.0, 90.0]]), np.array([1.0, 2.0, last_m])
    table = table_radii(radii, ranges)
    assert 91.0 <= table[-1] <= 180.0
    assert np.isfinite(ranges_along(radii, ranges, table)).all()


# --- rendered strips --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_strip_recording(tmp_path_factory.mktemp("strip") / "strip", tilted_camera())


@pytest.fixture(scope="module")
def calibration(recording: Path) -> MirrorCalibration:
    return calibrate_mirror(open_source(recording))


@pytest.mark.slow
def test_ranges_of_a_tilted_mirror_are_found_at_every_bearing(calibration: MirrorCalibration) -> None:
    ranges, errors = range_errors(calibration.camera, tilted_camera(), EDGES_M[0], EDGES_M[-1])
    assert np.abs(errors / ranges).max() < 0.005
    assert np.abs(errors[ranges < 1.5]).max() < 0.008


@pytest.mark.slow
def test_centre_handedness_and_mounting_come_from_the_images(calibration: MirrorCalibration) -> None:
    camera = calibration.camera
    assert camera.center == pytest.approx(tilted_camera().center, abs=0.3)
    assert camera.handedness == HANDEDNESS
    assert camera.mount_yaw_rad == pytest.approx(YAW_RAD, abs=0.002)
    assert 32.0 <= camera.inner_radius_px <= 38.0


@pytest.mark.slow
def test_the_distance_map_knows_every_pixel_of_the_table(calibration: MirrorCalibration) -> None:
    camera = calibration.camera
    distance = range_image(camera)
    assert distance.shape == (camera.height, camera.width)
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    radius = np.hypot(u - camera.center[0], v - camera.center[1])
    seen = (radius >= camera.radius_px[0]) & (radius <= camera.radius_px[-1])
    assert np.array_equal(np.isfinite(distance), seen)


@pytest.mark.slow
def test_the_written_file_is_the_same_camera(calibration: MirrorCalibration, tmp_path: Path) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(camera_yaml(calibration.camera, "two\nlines"), encoding="utf-8")
    points = ring_points(0.6, 6.0, bearings=24, ranges=20)
    assert open_camera(file).image_from_ground(points) == pytest.approx(
        calibration.camera.image_from_ground(points), abs=0.01
    )


# --- the public recording ---------------------------------------------------------------------------------------------


def bare_copy(source: Path, folder: Path, center: tuple[float, float]) -> Path:
    """A recording whose camera.yaml knows no more than the size and a rough centre."""
    folder.mkdir()
    shutil.copytree(source / "images", folder / "images")
    for name in ("images.csv", "sequence.yaml", "field.yaml"):
        shutil.copy(source / name, folder)
    rough = {"model": "omni", "width": 480, "height": 480, "center": list(center)}
    (folder / "camera.yaml").write_text(yaml.safe_dump(rough))
    return folder


def test_the_public_recording_is_calibrated_without_its_range_table(small_data: Path, tmp_path: Path) -> None:
    source = small_data / "omni_calibration"
    with_table = calibrate_mirror(open_source(source)).camera
    without = calibrate_mirror(open_source(bare_copy(source, tmp_path / "a", with_table_center(source)))).camera
    assert np.array_equal(with_table.range_m, without.range_m)
    assert (with_table.center, with_table.handedness, with_table.mount_yaw_rad) == (
        without.center,
        without.handedness,
        without.mount_yaw_rad,
    )
    ranges, errors = range_errors(without, open_camera(source / "camera.yaml"), 0.6, 6.5)
    assert np.all(np.abs(errors) <= np.where(ranges < 1.5, 0.015, 0.01 * ranges))


def with_table_center(source: Path) -> tuple[float, float]:
    return open_camera(source / "camera.yaml").center


# --- bad recordings ---------------------------------------------------------------------------------------------------


def copy_of(recording: Path, folder: Path) -> Path:
    copy = folder / "copy"
    shutil.copytree(recording, copy)
    return copy


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as refused:
        calibrate_mirror(open_source(folder))
    return str(refused.value)


def put_image(folder: Path, index: int, image: np.ndarray) -> None:  # type: ignore[type-arg]
    (folder / f"images/{index:02d}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())


def change_sequence(folder: Path, **changes: object) -> None:
    tree = yaml.safe_load((folder / "sequence.yaml").read_text()) | changes
    (folder / "sequence.yaml").write_text(yaml.safe_dump({k: v for k, v in tree.items() if v is not None}))


@pytest.mark.slow
def test_what_a_strip_recording_lacks_is_told(recording: Path, tmp_path: Path, snapshot: SnapshotAssertion) -> None:
    """And in which file."""
    folder, told = copy_of(recording, tmp_path), []
    about, images = folder / "sequence.yaml", folder / "images.csv"
    described, listed = about.read_text(), images.read_text()
    for changes in (
        {"patch_edges_m": None},
        {"patch_edges_m": [1.0, 2.0]},
        {"patch_edges_m": ["near", "far"]},
        {"patch_edges_m": [*EDGES_M[:4], EDGES_M[5], EDGES_M[4], *EDGES_M[6:]]},
        {"patch_colors": ["black", "red"] * 7},
        {"patch_colors": ["black", "white"] * 3},
        {"patch_half_width_m": -0.2},
    ):
        about.write_text(described)
        change_sequence(folder, **changes)
        told.append(refusal(folder))
    about.write_text(described)
    rows = listed.split()
    for text in (
        "\n".join(rows[:7]) + "\n",
        "\n".join(rows[:13]) + "\n",
        listed.replace("bearing_rad", "bearing"),
        listed.replace(rows[3].split(",")[2], "north"),
    ):
        images.write_text(text)
        told.append(refusal(folder))
    assert [words.replace(str(folder), "strip") for words in told] == snapshot


# --- the command ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_writes_camera_and_picture(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "camera.yaml"
    assert main(["calibrate", "mirror", str(recording), "--output", str(file)]) == 0
    assert "16 images of 15 edges" in capsys.readouterr().out
    assert len(open_camera(file).bearings_rad) == 72
    picture = cv2.imread(str(tmp_path / "camera.png"))
    assert picture.shape == (940, 2700, 3)
    assert main(["calibrate", "mirror", str(recording), "--output", str(file)]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.slow
def test_an_image_without_the_strip_is_left_out(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = copy_of(recording, tmp_path)
    put_image(folder, 2, np.full((400, 400, 3), 90, np.uint8))
    arguments = ["calibrate", "mirror", str(folder), "--output", str(tmp_path / "camera.yaml")]
    assert main(arguments) == 2
    refused = capsys.readouterr().err
    assert "images/02.png" in refused
    assert "strip is not found" in refused
    assert main([*arguments, "--skip-unusable"]) == 0
    said = capsys.readouterr()
    assert "15 images of 15 edges" in said.out
    assert "left out" in said.err
    assert "images/02.png" in said.err
