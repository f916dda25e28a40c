"""Overlays, the bird's-eye view and the sheet of stages."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from fakes import CAMERA_YAML, two_points

from touchline.camera import GroundView, OmniCamera, open_camera
from touchline.errors import InputError
from touchline.field import FieldModel, open_field
from touchline.geometry import Pose
from touchline.view.birds_eye import birds_eye_image
from touchline.view.look import look_at_recording
from touchline.view.overlay import (
    LINE_COLOR,
    OFF_LINE_COLOR,
    ON_LINE_COLOR,
    overlay_image,
    projected_lines,
)
from touchline.view.picture_files import save_picture
from touchline.view.stages import contact_sheet, save_pictures

GREEN = (40, 140, 40)


@pytest.fixture
def camera(tmp_path: Path) -> OmniCamera:
    (tmp_path / "camera.yaml").write_text(CAMERA_YAML)
    return open_camera(tmp_path / "camera.yaml")


@pytest.fixture(scope="module")
def field() -> FieldModel:
    return open_field("msl-18x12")


def carpet() -> np.ndarray:
    return np.full((96, 96, 3), GREEN, dtype=np.uint8)


def count(image: np.ndarray, color: tuple[int, int, int]) -> int:
    return int(np.all(image == color, axis=-1).sum())


def test_projected_lines_lie_on_the_field_lines(camera: OmniCamera, field: FieldModel) -> None:
    pose = Pose(1.0, -0.5, 0.7)
    pieces = projected_lines(GroundView(camera), field, pose)
    assert pieces
    on_field = pose.transform(camera.ground_from_image(np.concatenate(pieces)))
    assert np.max(field.line_distances(on_field)) < 1e-3


def test_a_line_through_the_robot_is_broken_there(camera: OmniCamera, field: FieldModel) -> None:
    for piece in projected_lines(
        GroundView(camera), field, Pose(0.0, 3.0, 0.0)
    ):  # the robot stands on the halfway line
        assert len(piece) >= 2
        assert np.hypot(*np.diff(piece, axis=0).T).max() <= 40.0


def test_points_are_coloured_by_their_distance_to_the_lines(camera: OmniCamera, field: FieldModel) -> None:
    pose = Pose(-1.0, 0.6, 0.0)  # the point 1 m ahead is on the halfway line, the one to the left is not on any
    points = two_points()
    assert field.line_distances(pose.transform(points.positions_m)) == pytest.approx([0.0, 0.388], abs=0.01)
    drawn = overlay_image(carpet(), GroundView(camera), field, pose, points)[:192]
    for pixel, color in zip(points.pixels, (ON_LINE_COLOR, OFF_LINE_COLOR), strict=True):
        u, v = np.round(2 * pixel + 0.5).astype(int)
        assert tuple(drawn[v, u].tolist()) == color


def test_without_a_pose_only_points_are_drawn(camera: OmniCamera, field: FieldModel) -> None:
    drawn = overlay_image(carpet(), GroundView(camera), None, None, two_points())
    assert count(drawn, LINE_COLOR) == 0
    assert count(drawn, ON_LINE_COLOR) > 10


def test_points_of_unknown_pixel_are_passed_over(camera: OmniCamera, field: FieldModel) -> None:
    points = two_points()
    points.pixels[:] = np.nan
    drawn = overlay_image(carpet(), GroundView(camera), field, Pose(0.0, 0.0, 0.0), points)[:192]
    assert count(drawn, ON_LINE_COLOR) == count(drawn, OFF_LINE_COLOR) == 0


def test_birds_eye_view_puts_ground_where_it_is(camera: OmniCamera) -> None:
    image = carpet()
    u, v = np.round(camera.image_from_ground(np.array([[0.0, 1.5]]))[0]).astype(int)  # 1.5 m to the left
    image[v - 2 : v + 3, u - 2 : u + 3] = (0, 0, 255)
    seen = birds_eye_image(image, GroundView(camera), reach_m=2.0, pixels_per_m=40)
    assert seen.shape == (161, 161, 3)
    red = np.argwhere((seen[..., 2] > 200) & (seen[..., 1] < 60))
    row, column = red.mean(axis=0)
    assert (80 - row) / 40 == pytest.approx(0.0, abs=0.1)  # forward is up
    assert (80 - column) / 40 == pytest.approx(1.5, abs=0.1)  # left is on the left


def test_birds_eye_view_is_dark_where_nothing_is_seen(camera: OmniCamera) -> None:
    seen = birds_eye_image(carpet(), GroundView(camera), reach_m=9.0, pixels_per_m=10)
    assert seen[0, 0].max() < 40  # farther than the table reaches
    assert seen[85, 85].max() > 100  # half a metre away: carpet


def test_stage_pictures_are_saved_in_order_with_a_sheet(tmp_path: Path) -> None:
    pictures = {"original": carpet(), "bird's-eye view": np.zeros((50, 120, 3), dtype=np.uint8)}
    paths = save_pictures(pictures, tmp_path)
    assert [path.name for path in paths] == ["01-original.png", "02-birds-eye-view.png", "stages.png"]
    assert cv2.imread(str(paths[0])).shape == (96, 96, 3)
    assert cv2.imread(str(paths[2])).shape == contact_sheet(pictures).shape


def test_a_picture_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "no").write_text("a file, no folder")
    with pytest.raises(InputError, match="cannot be written"):
        save_picture(tmp_path / "no" / "folder.png", carpet())


# --- a perspective camera ---------------------------------------------------------------------------------------------


def test_the_true_pose_is_drawn_where_no_system_sees_through_the_camera(shared_data: Path) -> None:
    look = look_at_recording(shared_data / "humanoid_9x6_walk", 3, "nubot-mti")
    assert look.field_from_robot is not None
    assert "the true pose; nubot-mti sees nothing through a camera of the model pinhole" in look.words()
    assert look.view.base_from_camera is not None, "the body's lean"
    pictures = look.stages()
    assert list(pictures) == ["original", "bird's-eye view", "overlay"]
    magenta = (pictures["overlay"][:960] == LINE_COLOR).all(axis=2)
    rows, columns = np.nonzero(magenta)
    assert len(rows) > 500
    white = look.image[..., 0].astype(int) + look.image[..., 2] - look.image[..., 1]
    on_line = white[np.minimum(rows // 2, 479), np.minimum(columns // 2, 751)]
    assert np.median(on_line) > np.percentile(white[200:], 90), "lines are drawn on what is white"


def test_the_example_for_rerun_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    main = runpy.run_path(str(Path(__file__).parents[1] / "examples" / "rerun_view.py"))["main"]
    assert main(["runs/match-1"]) == 2
    assert capsys.readouterr().err == "error: Rerun is not installed: pip install rerun-sdk\n"
