"""The fisheye camera: OpenCV's model, beyond 180°, its file and CameraInfo, and its errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from touchline.camera import FisheyeCamera, PinholeCamera, leaning, open_camera
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3
from touchline.localization.camera_errors.fisheye_focal import by_angle_scale, scaled_angle
from touchline.sources.bags.camera_file import camera_mapping

CAMERA = FisheyeCamera(
    640, 480, 285.0, 285.0, 321.4, 238.2, np.array([-0.02, 0.003, -0.001, 0.0002]),
    Pose3.from_roll_pitch_yaw(0.0, 0.55, 0.0, (0.04, 0.0, 0.52)),
)  # fmt: skip
PINHOLE = PinholeCamera(
    752, 480, 493.0, 493.0, 377.3, 238.6, np.array([-0.25, 0.06, 0.0006, -0.0004, 0.0]),
    Pose3.from_roll_pitch_yaw(0.0, 0.4887, 0.0, (0.05, 0.0, 1.1)),
)  # fmt: skip
FILE = CAMERA.mapping()
PLAIN = replace(CAMERA, distortion=np.zeros(4))


def pixels_of(camera: FisheyeCamera, step: int = 16) -> FloatArray:
    v, u = np.mgrid[0 : camera.height : step, 0 : camera.width : step]
    return np.column_stack((u.ravel(), v.ravel())).astype(float)


def wide_camera(focal_px: float = 150.0) -> FisheyeCamera:
    """210° wide."""
    return FisheyeCamera(560, 560, focal_px, focal_px, 279.5, 279.5, np.zeros(4), CAMERA.base_from_camera)


@settings(max_examples=30, deadline=None)
@given(roll=st.floats(-0.12, 0.12), pitch=st.floats(-0.12, 0.12), k1=st.floats(-0.05, 0.05))
def test_round_trip(roll: float, pitch: float, k1: float) -> None:
    camera = replace(CAMERA, distortion=np.array([k1, 0.003, -0.001, 0.0002]))
    pixels, pose = pixels_of(camera), leaning(camera, roll, pitch)
    rays = camera.camera_rays(pixels)
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
    assert camera.image_from_camera(3.0 * rays) == pytest.approx(pixels, abs=1e-6)
    ground = camera.ground_from_image(pixels, pose)
    near = np.hypot(*np.nan_to_num(ground, nan=1e9).T) < 50.0
    assert near.sum() > 0.5 * len(pixels)
    assert camera.image_from_ground(ground[near], pose) == pytest.approx(pixels[near], abs=1e-5)
    assert (camera.ray(pixels[np.isnan(ground[:, 0])], pose)[:, 2] >= -1e-9).all()


def test_pixels_are_those_of_opencv() -> None:
    rays = CAMERA.camera_rays(pixels_of(CAMERA))
    optical = np.column_stack((-rays[:, 1], -rays[:, 2], rays[:, 0]))
    matrix = np.array([[CAMERA.fx, 0.0, CAMERA.cx], [0.0, CAMERA.fy, CAMERA.cy], [0.0, 0.0, 1.0]])
    wanted, _ = cv2.fisheye.projectPoints(optical[:, None], np.zeros(3), np.zeros(3), matrix, CAMERA.distortion)
    assert wanted[:, 0] == pytest.approx(pixels_of(CAMERA), abs=1e-6)


def test_what_is_behind_a_wide_lens_is_seen() -> None:
    camera = wide_camera()
    angles = np.radians([0.0, 60.0, 90.0, 100.0, 120.0])
    directions = np.column_stack((np.cos(angles), -np.sin(angles), np.zeros(5)))
    seen = camera.image_from_camera(directions)
    assert seen[:4, 0] - camera.cx == pytest.approx(150.0 * angles[:4])
    assert np.isnan(seen[4]).all()
    assert camera.camera_rays(seen[:4]) == pytest.approx(directions[:4], abs=1e-9)
    assert np.isnan(camera.camera_rays([[279.5, 279.5 + 150.0 * np.radians(112.0)]])).all()
    folding = replace(PLAIN, distortion=np.array([-0.2, 0.0, 0.0, 0.0]))  # θ (1 - 0.2 θ²) turns back at 74°
    assert np.degrees(folding.largest_angle_rad) == pytest.approx(74.0, abs=0.1)
    assert np.isnan(folding.camera_rays([[0.0, 0.0]])).all()
    assert np.isfinite(folding.camera_rays([[321.0, 238.0]])).all()


def test_its_file_comes_back_and_mistakes_are_named(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(FILE))
    camera = open_camera(path)
    assert isinstance(camera, FisheyeCamera)
    assert camera.mapping() == FILE
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"distortion": [0.0] * 5}, "distortion needs four numbers: k1, k2, k3, k4"),
        ({"fx": 0.0}, "must be positive"),
        ({"mount": {"x": 0.0}}, "line 12: 'mount' needs x, y, z"),
        ({"imu_correction": {}}, "'imu_correction' is not a key of a fisheye camera"),
        ({"model": "fisheie"}, "unknown camera model 'fisheie'; did you mean 'fisheye'"),
    ]
    for change, words in wrong:
        path.write_text(yaml.safe_dump(FILE | change))
        with pytest.raises(InputError, match=words):
            open_camera(path)


@pytest.mark.parametrize("model", ["equidistant", "fisheye", "plumb_bob", "rational_polynomial"])
def test_camera_info(model: str) -> None:
    matrix = [CAMERA.fx, 0.0, CAMERA.cx, 0.0, CAMERA.fy, CAMERA.cy, 0.0, 0.0, 1.0]
    told = CAMERA.distortion.tolist() + ([0.0] if model == "plumb_bob" else [])
    info = SimpleNamespace(width=640, height=480, k=matrix, d=told, distortion_model=model)
    found = camera_mapping(info, CAMERA.base_from_camera)
    assert isinstance(found, dict)
    fisheye = model in ("equidistant", "fisheye")
    assert (found["model"], len(found["distortion"])) == (("fisheye", 4) if fisheye else ("pinhole", 5))
    assert found["distortion"][:4] == CAMERA.distortion.tolist()
    if model != "plumb_bob":
        info.d = [0.1] * 8
        assert "equidistant (k1, k2, k3, k4) are" in str(camera_mapping(info, CAMERA.base_from_camera))


@settings(max_examples=50, deadline=None)
@given(error=st.floats(-0.04, 0.04), pitch=st.floats(0.2, 1.2))
def test_an_error_of_focal_length_moves_ground_points(error: float, pitch: float) -> None:
    mount = Pose3.from_roll_pitch_yaw(0.05, pitch, 0.2, (0.0, 0.0, 0.6))
    camera = replace(PLAIN, base_from_camera=mount)
    longer, shorter, off = (
        replace(camera, fx=285.0 / (1.0 + e), fy=285.0 / (1.0 + e)) for e in (error - 1e-5, error + 1e-5, error)
    )
    pixels, axis = pixels_of(camera, 64), np.ascontiguousarray(mount.rotation[:, 0])
    told, right = camera.ground_from_image(pixels), off.ground_from_image(pixels)
    slopes = (shorter.ground_from_image(pixels) - longer.ground_from_image(pixels)) / 2e-5
    near = (np.hypot(*np.nan_to_num(told, nan=1e9).T) < 6.0) & (np.hypot(*np.nan_to_num(right, nan=1e9).T) < 8.0)
    assert near.sum() > 10
    for place, wanted, slope in zip(told[near], right[near], slopes[near], strict=True):
        assert scaled_angle(*place, error, 0.6, axis) == pytest.approx(wanted, rel=1e-6, abs=1e-6)
        # by an error of angles that are (1 + error) as large already
        moved = np.array(by_angle_scale(*wanted, 0.6, axis)) / (1.0 + error)
        assert moved == pytest.approx(slope, rel=1e-3, abs=1e-3)
    assert scaled_angle(1.0, 2.0, 0.1, 0.6, np.zeros(3)) == (1.0, 2.0)
    assert by_angle_scale(1.0, 2.0, 0.6, np.zeros(3)) == (0.0, 0.0)


def test_a_corrected_camera_sees_what_was_seen_where_it_is() -> None:
    errors = np.array([0.01, -0.02, 0.03, 0.02])
    angles = np.linspace(0.1, 0.7, 30)
    directions = np.column_stack((np.cos(angles), -np.sin(angles), np.zeros(30)))
    rays = PINHOLE.corrected(errors, angles).camera_rays(PINHOLE.image_from_camera(directions))
    assert -rays[:, 1] / rays[:, 0] == pytest.approx(1.02 * np.tan(angles), rel=5e-3)
    fisheye = PLAIN.corrected(errors, np.linspace(0.1, 1.2, 30))
    assert fisheye.fx == pytest.approx(285.0 / 1.02, rel=1e-4)
    assert fisheye.base_from_camera.translation_m == pytest.approx(PLAIN.base_from_camera.translation_m * (1, 1, 1.03))
    bent = CAMERA.corrected(errors, np.linspace(0.1, 1.2, 30))
    assert bent.fx == pytest.approx(285.0 / 1.02, rel=5e-3)
