"""Egocentric coordinates of one image: where they come from, round trips, and one sentence for what cannot be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from touchline.camera import PinholeCamera, ground_view, leaning, open_camera
from touchline.camera.imu_correction import ImuCorrection, levelled, monomials
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3
from touchline.perception.line_graph.image_plane import grounds_from_pixels, image_plane, make_lens

PIXELS = np.array([(376.0, 300.0), (100.0, 250.0), (700.0, 460.0), (376.0, 20.0)])
CORRECTION = ImuCorrection(
    np.array([(0.1, -0.3, 0.2, 0.05, 1.5), (-0.1, 0.4, 0.8, -0.6, -2.0)]), reference_rad=(0.02, -0.01)
)


@pytest.fixture(scope="module")
def camera() -> PinholeCamera:
    mount = Pose3.from_roll_pitch_yaw(0.0087, 0.4887, -0.0122, (0.05, 0.01, 1.1))
    distortion = np.array((-0.25, 0.06, 0.0006, -0.0004, 0.0))
    return PinholeCamera(752, 480, 493.0, 493.0, 377.3, 238.6, distortion, mount)


WHOLE = ImuCorrection(
    np.array(
        [(-0.4, 0, -0.1, 0.3, 0, 200, -140), (0, 0, -0.9, 1.1, 1, 600, -430), (0, 0.0001, -0.0004, 0.001, 0, 0.1, -0.4)]
    ),
    reference_rad=(0.02, -0.01),
)


def learned(camera: PinholeCamera, correction: ImuCorrection = CORRECTION) -> PinholeCamera:
    return replace(camera, imu_correction=correction)


@pytest.mark.parametrize("correction", [None, CORRECTION, WHOLE])
def test_ground_and_back(camera: PinholeCamera, correction: ImuCorrection | None) -> None:
    view = ground_view(camera if correction is None else learned(camera, correction), None, 0.03, -0.12)
    ground = view.ground_from_image(PIXELS)
    assert correction or np.isnan(ground[3]).all()  # above the horizon
    assert view.image_from_ground(ground[:3]) == pytest.approx(PIXELS[:3], abs=1e-6)
    on_floor = np.column_stack((ground[:3], np.zeros(3)))
    assert view.image_from_base(on_floor) == pytest.approx(PIXELS[:3], abs=1e-6)
    assert (np.linalg.eigvalsh(view.covariances(PIXELS[:3], 1.0, 0.005)) > 0.0).all()


def test_the_learned_correction_is_equation_2(camera: PinholeCamera) -> None:
    roll, pitch = np.full(3, 0.03), np.full(3, -0.12)
    seen = camera.undistorted(PIXELS[:3])
    f = monomials(seen, roll - CORRECTION.reference_rad[1], pitch - CORRECTION.reference_rad[0])[:, :5]
    level = camera.distorted(seen + f @ CORRECTION.matrix.T)
    view = ground_view(learned(camera), None, 0.03, -0.12)
    assert view.ground_from_image(PIXELS[:3]) == pytest.approx(camera.ground_from_image(level), abs=1e-9)


def test_many_leans_at_once_are_levelled_as_one_by_one(camera: PinholeCamera) -> None:
    seen = camera.undistorted(PIXELS[:3])
    for correction in (CORRECTION, WHOLE):
        f = monomials(seen, np.full(3, 0.04), np.full(3, -0.14))
        one = correction.level(seen, 0.03, -0.12)
        assert levelled(correction.matrix, seen, f) == pytest.approx(one, abs=1e-9)


@pytest.mark.parametrize("correction", [CORRECTION, WHOLE])
def test_the_line_detectors_plane_is_the_views(camera: PinholeCamera, correction: ImuCorrection) -> None:
    view = ground_view(learned(camera, correction), None, 0.03, -0.12)
    near = np.array([(376.0, 300.0), (112.0, 320.0), (640.0, 448.0)])  # on the lens's table
    found = grounds_from_pixels(image_plane(make_lens(camera), view), near)
    assert found == pytest.approx(view.ground_from_image(near), abs=0.01)


def test_a_frames_pose_comes_before_the_correction(camera: PinholeCamera) -> None:
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
    path.write_text(yaml.safe_dump(learned(camera).mapping()))
    again = open_camera(path)
    assert isinstance(again, PinholeCamera)
    assert again.imu_correction is not None
    np.testing.assert_array_equal(again.imu_correction.matrix, CORRECTION.matrix)
    assert again.imu_correction.reference_rad == CORRECTION.reference_rad
    path.write_text(yaml.safe_dump(camera.mapping() | {"imu_correction": {"matrix": [[1.0]]}}))
    with pytest.raises(InputError, match="imu_correction"):
        open_camera(path)
