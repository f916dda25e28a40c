"""Both cameras on a robot that leans: pixel -> ground -> pixel, covariances, masks, and errors in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from touchline.camera import Camera, OmniCamera, PinholeCamera, field_of_view, leaning, open_camera
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3
from touchline.perception.detector import with_lean
from touchline.types import Frame, LinePoints, Samples

DISTORTION = (-0.25, 0.06, 0.0006, -0.0004, 0.0)


def perspective(distortion: tuple[float, ...] = DISTORTION, focal_px: float = 493.0) -> PinholeCamera:
    """A humanoid's wide-angle camera, 1.1 m high, looking down by 28°."""
    mount = Pose3.from_roll_pitch_yaw(0.0087, 0.4887, -0.0122, (0.05, 0.01, 1.1))
    return PinholeCamera(752, 480, focal_px, focal_px, 377.3, 238.6, np.array(distortion), mount)


def mirror(viewpoint_height_m: float | None = 0.8) -> OmniCamera:
    """A mirror of known closed form: range = 0.8 tan(radius / 160)."""
    radii = np.arange(10.0, 230.0, 2.0)
    ranges = 0.8 * np.tan(radii / 160.0)[np.newaxis]
    return OmniCamera(
        480, 480, (241.3, 238.2), 30.0, 225.0, -1, 0.3, radii, np.zeros(1), ranges,
        viewpoint_height_m=viewpoint_height_m,
    )  # fmt: skip


def pixels_of(camera: Camera, step: int = 24) -> FloatArray:
    v, u = np.mgrid[0 : camera.height : step, 0 : camera.width : step]
    pixels = np.column_stack((u.ravel(), v.ravel())).astype(float)
    return pixels[camera.sees(pixels)]


@pytest.mark.parametrize("model", ["omni", "pinhole"])
@settings(max_examples=40, deadline=None)
@given(roll=st.floats(-0.12, 0.12), pitch=st.floats(-0.12, 0.12), pan=st.floats(-0.9, 0.9))
def test_round_trip_with_attitude_and_pan(model: str, roll: float, pitch: float, pan: float) -> None:
    camera: Camera = mirror() if model == "omni" else perspective()
    turned = Pose3.from_roll_pitch_yaw(0.0, 0.0, pan).compose(camera.base_from_camera)
    pose = Pose3.from_roll_pitch_yaw(roll, pitch).compose(turned)
    pixels = pixels_of(camera)
    ground = camera.ground_from_image(pixels, pose)
    seen = np.isfinite(ground).all(axis=1)
    near = seen & (np.hypot(*np.nan_to_num(ground).T) < 50.0)
    assert near.sum() > 0.3 * len(pixels)
    assert np.abs(camera.image_from_ground(ground[near], pose) - pixels[near]).max() < 1e-3
    assert (camera.ray(pixels[~seen], pose)[:, 2] >= -1e-9).all(), "what sees no ground looks at or above the horizon"


def test_pixels_follow_the_documented_formula_and_opencv() -> None:
    camera, roll, pitch = perspective(), 0.03, -0.05
    points = np.column_stack((np.linspace(1.0, 6.0, 30), np.linspace(-1.0, 2.0, 30), np.zeros(30)))
    body = points @ Pose3.from_roll_pitch_yaw(roll, pitch).rotation  # Bᵀ p
    c = (body - camera.base_from_camera.translation_m) @ camera.base_from_camera.rotation  # Mᵀ (Bᵀ p - t)
    optical = np.column_stack((-c[:, 1], -c[:, 2], c[:, 0]))
    matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    wanted, _ = cv2.projectPoints(optical, np.zeros(3), np.zeros(3), matrix, np.array(DISTORTION))
    found = camera.image_from_ground(points[:, :2], leaning(camera, roll, pitch))
    assert np.nanmax(np.abs(found - wanted.reshape(-1, 2))) < 1e-9
    assert np.isfinite(found).all()


@pytest.mark.parametrize("model", ["omni", "pinhole"])
def test_covariances_agree_with_a_monte_carlo(model: str) -> None:
    camera: Camera = mirror() if model == "omni" else perspective()
    pose, noise_px, noise_m = leaning(camera, 0.02, -0.03), 0.3, 0.01
    pixels = camera.image_from_ground([[1.5, 0.0], [2.5, 1.0], [4.0, -1.5]], pose)
    rng = np.random.default_rng(1)
    for pixel, covariance in zip(pixels, camera.ground_covariances(pixels, noise_px, noise_m, pose), strict=True):
        scattered = camera.ground_from_image(pixel + noise_px * rng.standard_normal((200_000, 2)), pose)
        measured = np.cov((scattered + noise_m * rng.standard_normal(scattered.shape)).T)
        assert measured == pytest.approx(covariance, rel=0.03, abs=0.02 * np.trace(covariance))


def test_the_horizon_and_what_is_behind_are_nowhere() -> None:
    camera = perspective((0.0,) * 5)
    level = Pose3(np.eye(3), np.array([0.0, 0.0, 1.0]))
    ground = camera.ground_from_image([[377.3, 238.6], [377.3, 238.0], [377.3, 239.6]], level)
    assert np.isnan(ground[:2]).all()
    assert ground[2] == pytest.approx([493.0, 0.0])
    assert np.isnan(camera.image_from_ground([[-2.0, 0.0], [0.0, 1.0]], level)).all()


def test_the_distortion_is_not_trusted_beyond_the_image() -> None:
    camera = perspective((-0.3, 0.0, 0.0, 0.0, 0.0), focal_px=400.0)  # r (1 - 0.3 r²) turns back at r = 1.05
    assert camera.largest_radius < 1.055
    assert np.isnan(camera.image_from_base([[1.0, 3.0, 1.1]])).all(), "folded back into the image by the polynomial"
    rays = camera.camera_rays(pixels_of(camera))
    good = np.isfinite(rays).all(axis=1)
    assert (np.hypot(*(rays[good, 1:] / rays[good, :1]).T) <= camera.largest_radius).all()


def test_the_field_of_view_is_where_ground_is() -> None:
    ring = field_of_view(mirror())
    v, u = np.mgrid[0:480, 0:480]
    radius = np.hypot(u - 241.3, v - 238.2)
    assert np.array_equal(ring, (radius >= 30.0) & (radius <= 225.0))
    camera = perspective()
    below = field_of_view(camera, leaning(camera, 0.0, -0.4))
    assert below.shape == (480, 752)
    assert not below[:100].any()
    assert not below[190, 376]
    assert below[200, 376]
    assert below[330:].all()


def test_only_a_camera_with_a_viewpoint_has_rays_and_attitude() -> None:
    plain = mirror(None)
    for question in (
        lambda: plain.ray([[300.0, 300.0]]),
        lambda: leaning(plain, 0.0, 0.1),
        lambda: plain.ground_from_image([[300.0, 300.0]], Pose3.identity()),
        lambda: plain.image_from_ground([[1.0, 0.0]], Pose3.identity()),
    ):
        with pytest.raises(InputError, match="viewpoint_height_m"):
            question()


@pytest.mark.parametrize("use_attitude", [False, True])
def test_detected_points_heed_the_lean_only_where_the_camera_does(use_attitude: bool) -> None:
    camera = replace(mirror(), use_attitude=use_attitude)
    pixels = camera.image_from_ground([[2.0, 0.5], [1.0, -1.0]])
    flat = camera.ground_from_image(pixels)
    points = LinePoints(flat, camera.ground_covariances(pixels, 0.3, 0.01), np.ones(2), pixels)
    frame = Frame(0, tilt=Samples(np.array([-5, 0]), np.array([[0.3, 0.3], [0.0, 0.02]])))
    seen = with_lean(points, frame, camera, 0.3, 0.01)
    wanted = camera.ground_from_image(pixels, leaning(camera, 0.0, 0.02)) if use_attitude else flat
    assert np.array_equal(seen.positions_m, wanted)
    assert (np.abs(seen.positions_m - flat).max() > 0.02) == use_attitude
    assert with_lean(points, Frame(0), camera, 0.3, 0.01) is points


# --- camera.yaml ------------------------------------------------------------------------------------------------------

OMNI = {
    "model": "omni", "width": 10, "height": 10, "center": [5, 5], "inner_radius_px": 1, "outer_radius_px": 4,
    "handedness": 1, "mount_yaw": 0.0, "range_table": {"radius_px": [0, 5], "range_m": [0, 1]},
}  # fmt: skip
PINHOLE = {
    "model": "pinhole", "width": 752, "height": 480, "fx": 493.0, "fy": 492.0, "cx": 377.3, "cy": 238.6,
    "distortion": [-0.25, 0.06, 0.0, 0.0, 0.0],
    "mount": {"x": 0.05, "y": 0.0, "z": 1.1, "roll": 0.01, "pitch": 0.49, "yaw": -0.01},
}  # fmt: skip


def written(folder: Path, tree: dict[str, object]) -> Path:
    path = folder / "camera.yaml"
    path.write_text(yaml.safe_dump(tree))
    return path


def test_a_pinhole_camera_is_read_and_written_again(tmp_path: Path) -> None:
    camera = open_camera(written(tmp_path, PINHOLE))
    assert isinstance(camera, PinholeCamera)
    assert (camera.model, camera.width, camera.height, camera.use_attitude) == ("pinhole", 752, 480, True)
    assert camera.base_from_camera.roll_pitch_yaw() == pytest.approx((0.01, 0.49, -0.01))
    assert camera.mapping() == PINHOLE
    assert replace(camera, use_attitude=False).mapping() == PINHOLE | {"use_attitude": False}


def test_an_omni_camera_may_name_its_viewpoint(tmp_path: Path) -> None:
    camera = open_camera(written(tmp_path, OMNI | {"viewpoint_height_m": 0.8, "use_attitude": True}))
    assert camera.base_from_camera.translation_m.tolist() == [0.0, 0.0, 0.8]
    assert camera.use_attitude
    assert not open_camera(written(tmp_path, OMNI)).use_attitude


def test_what_is_wrong_in_a_camera_file_is_said(tmp_path: Path, snapshot: SnapshotAssertion) -> None:
    told = []
    for tree in (
        OMNI | {"viewpoint_height_m": -0.8},
        OMNI | {"viewpoint_height_m": "high"},
        OMNI | {"use_attitude": True},
        OMNI | {"use_attitude": 1},
        PINHOLE | {"fx": -493.0},
        PINHOLE | {"cx": 900.0},
        PINHOLE | {"distortion": [0.1]},
        PINHOLE | {"distortion": "no"},
        PINHOLE | {"mount": {"x": 0.0, "z": 1.1}},
        PINHOLE | {"mount": PINHOLE["mount"] | {"z": -1.1}},  # type: ignore[operator]
        PINHOLE | {"width": 752.5},
        {key: value for key, value in PINHOLE.items() if key != "fx"},
    ):
        path = written(tmp_path, tree)
        with pytest.raises(InputError) as error:
            open_camera(path)
        told.append(str(error.value).replace(str(tmp_path), ""))
    assert told == snapshot
