"""A mirror calibrated from the field's own lines: points of known mirrors, and what can't be told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from line_scenes import along_edges
from typer.testing import CliRunner

from touchline.calibration.lines.calibration import (
    MIN_ON_LINES,
    LineCalibration,
    calibrate_points,
    check,
    refined,
    turning_axis,
)
from touchline.calibration.lines.equations import SHAPE, Lines, Noise, Seen, residual
from touchline.calibration.lines.mirror_shape import MirrorShape
from touchline.calibration.lines.pixels_file import image_size, read_pixels
from touchline.calibration.lines.search import Candidate
from touchline.camera import open_camera
from touchline.cli.calibrate_lines import different
from touchline.cli.commands import app
from touchline.errors import InputError, NoFitError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose

CENTER, SCALE_M, PER_PX = np.array([238.0, 243.0]), 1.6, 0.0070


@pytest.fixture(scope="module")
def field() -> FieldModel:
    return open_field("msl-18x12")


def seen_pixels(
    field: FieldModel,
    pose: Pose,
    rng: np.random.Generator,
    handedness: int = 1,
    reach_m: float = 8.0,
    step_m: float = 0.2,
) -> FloatArray:
    """Pixels (N, 2) of the field's lines within reach, through an upright mirror; a third of a pixel of noise."""
    ground = pose.inverse().transform(np.concatenate(field.polylines(step_m)))
    ground = ground[(np.hypot(*ground.T) < reach_m) & (np.hypot(*ground.T) > 0.6)]
    radius = np.arctan(np.hypot(*ground.T) / SCALE_M) / PER_PX
    bearing = np.arctan2(ground[:, 1], ground[:, 0])
    pixels = CENTER + radius[:, np.newaxis] * np.column_stack((np.cos(bearing), handedness * np.sin(bearing)))
    return np.asarray(pixels + rng.normal(0.0, 0.33, pixels.shape))


def calibrated(pixels: list[FloatArray], field: FieldModel, handedness: int = 1) -> LineCalibration:
    return calibrate_points(pixels, np.array([240.0, 240.0]), 220.0, field, handedness)


def range_errors(shape: MirrorShape, first_m: float = 2.0) -> FloatArray:
    ranges = np.linspace(first_m, 6.0, 20)
    return np.asarray(shape.range_m(np.arctan(ranges / SCALE_M) / PER_PX) / ranges - 1.0)


@pytest.mark.slow
def test_a_mirror_is_found_in_clutter(field: FieldModel) -> None:
    rng, handedness = np.random.default_rng(3), -1
    pixels = seen_pixels(field, Pose(3.0, -1.5, 0.7), rng, handedness)
    strays = CENTER + 190.0 * rng.uniform(-1.0, 1.0, (round(0.15 / 0.85 * len(pixels)), 2))
    found = calibrated([np.concatenate((pixels, strays))], field, handedness)
    check(found)
    assert np.abs(found.shape.center - CENTER).max() < 0.3
    assert np.abs(range_errors(found.shape)).max() < 0.01
    pose = found.poses[0]
    assert np.hypot(abs(pose.x) - 3.0, abs(pose.y) - 1.5) < 0.03


@pytest.mark.parametrize("apart_px", [0.0, 6.0])
def test_images_of_two_robots_are_refused(field: FieldModel, apart_px: float) -> None:
    """Together they seemed to show one mirror, with its centre in between."""
    rng, poses = np.random.default_rng(5), (Pose(3.0, -1.5, 0.7), Pose(-2.5, 1.0, -1.6))
    pixels = [seen_pixels(field, pose, rng, reach_m=6.0) for pose in poses]
    pixels[1] = pixels[1] + np.array([0.0, apart_px])
    start = Candidate(np.array([*CENTER, np.log(SCALE_M), PER_PX, 0.0, 0.0]), np.array(poses), 0.0)
    found = refined(start, 1.0, [Seen(one, 1.0, 5.0) for one in pixels], np.array([240.0, 240.0]), 220.0, field)
    if apart_px == 0.0:
        check(found)
    else:
        assert found.on_lines > MIN_ON_LINES
        with pytest.raises(NoFitError, match=r"image 1 .* px .*one robot"):
            check(found)
        for points in ((20, 200), (40, 45)):  # few beside the other's, or few in all
            dim = replace(found, pixels=tuple(one[:n] for one, n in zip(found.pixels, points, strict=True)))
            with pytest.raises(NoFitError, match=rf"image 1 \({points[0]} points\) .*bad light"):
                check(dim)


def test_a_shape_whose_ranges_do_not_grow_is_no_mirror() -> None:
    """What a photograph through a lens makes of it."""
    flat = MirrorShape(np.array([*CENTER, np.log(SCALE_M), 0.0, 0.0, 0.0]), 1, 5.0, np.zeros(2))
    with pytest.raises(NoFitError, match="--model pinhole or fisheye"):
        flat.camera((640, 480), 30.0, 200.0)


def test_one_line_is_refused(field: FieldModel) -> None:
    rng = np.random.default_rng(0)
    pixels = seen_pixels(field, Pose(5.0, 4.5, 0.3), rng, reach_m=2.0, step_m=0.02)
    with pytest.raises(NoFitError):
        check(calibrated([pixels], field))


def test_too_few_points_are_refused(field: FieldModel) -> None:
    with pytest.raises(NoFitError, match="too few"):
        calibrated([np.full((5, 2), 200.0)], field)


def test_the_axis_of_a_turn_is_found() -> None:
    headings = np.array([0.0, 1.2, 2.5, 4.0])
    axis = np.array([0.03, -0.02])
    at = [np.array([2.0, 1.0]) - np.array([[np.cos(h), -np.sin(h)], [np.sin(h), np.cos(h)]]) @ axis for h in headings]
    found, off = turning_axis(np.column_stack((np.array(at), headings)))
    assert found == pytest.approx(axis, abs=1e-9)
    assert off == pytest.approx(0.0, abs=1e-9)
    assert turning_axis(np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 1.0], [1.0, 4.0, 2.0]]))[1] is None


def test_derivatives_are_those_of_the_distance(field: FieldModel) -> None:
    rng = np.random.default_rng(2)
    lines = Lines(True, field.distance_map(0.05, 3.0).table, field.line_tables)
    spline = rng.normal(0.0, 0.02, 19)
    state = np.array([238.0, 243.0, 0.47, 0.007, 0.01, -0.02, *spline, 3.0, -1.5, 0.7])
    work = np.zeros(SHAPE + 19 + 3), np.zeros(4), np.zeros(4)
    for pixel in seen_pixels(field, Pose(3.0, -1.5, 0.7), rng)[::40]:
        residual(pixel, -1.0, 14.0, state, lines, Noise(0.01, 2.5), work)
        own, steps = work[0].copy(), 1e-6 * np.eye(len(state))
        others = [
            [residual(pixel, -1.0, 14.0, state + side * step, lines, Noise(0.01, 2.5), work)[0] for side in (1, -1)]
            for step in steps
        ]
        numeric = np.array([(high - low) / 2e-6 for high, low in others])
        assert own == pytest.approx(numeric, abs=1e-5 * np.abs(own).max())


def test_the_camera_puts_pixels_where_the_shape_does() -> None:
    parameters = np.array([238.0, 243.0, np.log(1.6), 0.007, 0.012, -0.008])
    shape = MirrorShape(parameters, -1, 14.0, np.array([0.02, -0.01]))
    camera = shape.camera((480, 480), 40.0, 200.0, 0.5)
    rng = np.random.default_rng(0)
    angle, radius = rng.uniform(0.0, 2.0 * np.pi, 50), rng.uniform(60.0, 190.0, 50)
    pixels = CENTER + radius[:, np.newaxis] * np.column_stack((np.cos(angle), np.sin(angle)))
    turn = np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    expected = shape.ground(pixels) @ turn
    assert np.hypot(*(camera.ground_from_image(pixels) - expected).T).max() < 0.01


@pytest.mark.slow
def test_the_command_writes_a_camera_and_a_picture(field: FieldModel, tmp_path: Path) -> None:
    """Of a field whose file has the outer edges of its lines, which it says."""
    pixels = seen_pixels(field, Pose(3.0, -1.5, 0.7), np.random.default_rng(3))
    points, out = tmp_path / "points.csv", tmp_path / "camera.yaml"
    points.write_text("u_px,v_px\n" + "\n".join(f"{u:.2f},{v:.2f}" for u, v in pixels))
    told = tmp_path / "field.yaml"
    along_edges(field).to_yaml(told)
    command = ["calibrate", "lines", str(points), "--field", str(told), "--size", "480x480", "-o", str(out)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "handedness: 1 is taken" in done.output
    assert "further in: the field's file may hold their outer edges" in " ".join(done.output.split())
    assert (tmp_path / "camera.png").exists()
    camera = open_camera(out)
    assert np.abs(np.array(camera.center) - CENTER).max() < 0.3  # type: ignore[attr-defined]


def test_files_of_pixels(tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    file.write_text("v_px,u_px\n2,1\n2,1\n4,3\n")
    assert read_pixels(file).tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert image_size("640x480", [read_pixels(file)]) == (640, 480)
    file.write_text("u_px,v_px\n1,2\nx,3\n")
    with pytest.raises(InputError, match="line 3"):
        read_pixels(file)
    for size in ("large", "9" * 5000 + "x480", "640x" + "9" * 400, "99999x480"):
        with pytest.raises(InputError, match="--size: expected WIDTHxHEIGHT"):
            image_size(size, [np.ones((1, 2))])


def refusal(*words: object) -> str:
    """What `calibrate lines` says while it writes nothing."""
    done = CliRunner().invoke(app, ["calibrate", "lines", *map(str, words), "--field", "msl-18x12"])
    assert isinstance(done.exception, InputError | NoFitError), done
    return str(done.exception)


def test_an_image_of_one_grey_shows_no_mirror(tmp_path: Path) -> None:
    image = tmp_path / "grey.png"
    cv2.imwrite(str(image), np.full((480, 480, 3), 90, np.uint8))
    assert "no mirror's circle is found" in refusal(image, "-o", tmp_path / "camera.yaml")


def test_images_of_different_sizes_a_folder_and_degrees_are_refused(tmp_path: Path) -> None:
    (tmp_path / "recording" / "images").mkdir(parents=True)
    images, out = [tmp_path / "a.png", tmp_path / "b.png"], tmp_path / "camera.yaml"
    for path, side in zip(images, (60, 64), strict=True):
        cv2.imwrite(str(path), np.full((side, 60, 3), 90, np.uint8))
    assert "another size" in refusal(*images, "-o", out)
    assert "images/*.png for instance" in refusal(tmp_path / "recording", "-o", out)
    for angle in ("90", "-6.3", "nan"):
        assert "in rad" in refusal(images[0], "-o", out, f"--mount-yaw={angle}")


def test_what_is_given_twice_counts_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [tmp_path / f"{name}.png" for name in "abc"]
    contents = [np.full((4, 4, 3), value, np.uint8) for value in (1, 2, 1)]
    assert different(paths, contents) == [0, 1]
    told = " ".join(capsys.readouterr().err.split())
    assert "left out" in told
    assert "shows the same as" in told
