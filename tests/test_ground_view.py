"""Egocentric coordinates of one image: where they come from, round trips, and one sentence for what cannot be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from touchline.camera import PinholeCamera, ground_view, leaning, open_camera
from touchline.camera.imu_correction import ImuCorrection, monomials
from touchline.camera.pinhole import pinhole_mapping
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3

PIXELS = np.array([(376.0, 300.0), (100.0, 250.0), (700.0, 460.0), (376.0, 20.0)])
CORRECTION = ImuCorrection(
    np.array([(0.1, -0.3, 0.2, 0.05, 1.5), (-0.1, 0.4, 0.8, -0.6, -2.0)]), reference_rad=(0.02, -0.01)
)


@pytest.fixture(scope="module")
def camera() -> PinholeCamera:
    mount = Pose3.from_roll_pitch_yaw(0.0087, 0.4887, -0.0122, (0.05, 0.01, 1.1))
    distortion = np.array((-0.25, 0.06, 0.0006, -0.0004, 0.0))
    return PinholeCamera(752, 480, 493.0, 493.0, 377.3, 238.6, distortion, mount)


def learned(camera: PinholeCamera) -> PinholeCamera:
    return replace(camera, imu_correction=CORRECTION)


@pytest.mark.parametrize("with_correction", [False, True])
def test_ground_and_back(camera: PinholeCamera, with_correction: bool) -> None:
    view = ground_view(learned(camera) if with_correction else camera, None, 0.03, -0.12)
    ground = view.ground_from_image(PIXELS)
    assert with_correction or np.isnan(ground[3]).all()  # above the horizon
    assert view.image_from_ground(ground[:3]) == pytest.approx(PIXELS[:3], abs=1e-6)
    on_floor = np.column_stack((ground[:3], np.zeros(3)))
    assert view.image_from_base(on_floor) == pytest.approx(PIXELS[:3], abs=1e-6)
    assert (np.linalg.eigvalsh(view.covariances(PIXELS[:3], 1.0, 0.005)) > 0.0).all()


def test_the_learned_correction_is_equation_2(camera: PinholeCamera) -> None:
    roll, pitch = np.full(3, 0.03), np.full(3, -0.12)
    seen = camera.undistorted(PIXELS[:3])
    f = monomials(seen, roll - CORRECTION.reference_rad[1], pitch - CORRECTION.reference_rad[0])
    level = camera.distorted(seen + f @ CORRECTION.matrix.T)
    view = ground_view(learned(camera), None, 0.03, -0.12)
    assert view.ground_from_image(PIXELS[:3]) == pytest.approx(camera.ground_from_image(level), abs=1e-9)


def test_a_frames_pose_comes_before_the_correction_and_that_before_the_mount(camera: PinholeCamera) -> None:
    measured = leaning(camera, 0.01, 0.02)
    by_pose = ground_view(learned(camera), measured, 0.3, 0.3).ground_from_image(PIXELS)
    np.testing.assert_array_equal(by_pose, camera.ground_from_image(PIXELS, measured))
    by_lean = ground_view(camera, None, 0.01, 0.02).ground_from_image(PIXELS)
    np.testing.assert_array_equal(by_lean, by_pose)
    assert not np.allclose(ground_view(learned(camera), None, 0.01, 0.02).ground_from_image(PIXELS[:3]), by_lean[:3])


def unsupported(camera: PinholeCamera, roll: float | None, pitch: float | None, pose: Pose3 | None = None) -> str:
    with pytest.raises(InputError) as caught:
        ground_view(camera, pose, roll, pitch)
    return str(caught.value)


def test_what_cannot_be_is_told_in_one_sentence(camera: PinholeCamera) -> None:
    assert "imu.csv" in unsupported(camera, None, None)
    assert "leans by 69°" in unsupported(camera, 1.2, 0.0)
    assert "leans by 80°" in unsupported(camera, None, None, Pose3.from_roll_pitch_yaw(1.4, 0.5))
    still = replace(camera, use_attitude=False)
    level: FloatArray = ground_view(still).ground_from_image(PIXELS)
    np.testing.assert_array_equal(level, still.ground_from_image(PIXELS))


def test_a_camera_file_keeps_its_correction(camera: PinholeCamera, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(pinhole_mapping(learned(camera))))
    again = open_camera(path)
    assert isinstance(again, PinholeCamera)
    assert again.imu_correction is not None
    np.testing.assert_array_equal(again.imu_correction.matrix, CORRECTION.matrix)
    assert again.imu_correction.reference_rad == CORRECTION.reference_rad
    path.write_text(yaml.safe_dump(pinhole_mapping(camera) | {"imu_correction": {"matrix": [[1.0]]}}))
    with pytest.raises(InputError, match="imu_correction"):
        open_camera(path)
