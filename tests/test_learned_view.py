"""Pictures through the camera as it was learned: field lines lie on those of the image."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchline.camera import GroundView, open_camera
from touchline.geometry import Pose, Pose3
from touchline.types import Estimate, Frame, Observation, Status, points_at
from touchline.view.learned_view import as_learned

ANGLES_RAD = np.linspace(0.05, 0.5, 10)
GROUND_M = np.array([[1.5, 0.0], [2.0, 0.6], [2.5, -0.5], [1.2, 0.3]])
DESCRIBED = open_camera(Path(__file__).parent / "data" / "humanoid_9x6_walk" / "camera.yaml")


def estimate(places_m: np.ndarray, errors: np.ndarray | None) -> Estimate:
    seen = Observation(1, points_at(places_m))
    return Estimate(1, Pose(0.0, 0.0, 0.0), np.eye(3), Status.TRACKING, observation=seen, camera_errors=errors)


@pytest.mark.parametrize("turned", [False, True], ids=["fixed", "head turned"])
def test_a_learned_camera_shows_things_where_they_are(turned: bool) -> None:
    head = Pose3.from_roll_pitch_yaw(0.0, 0.0, 0.3) if turned else Pose3.from_roll_pitch_yaw(0.0, 0.0, 0.0)
    mount = Pose3(head.rotation @ DESCRIBED.base_from_camera.rotation, DESCRIBED.base_from_camera.translation_m)
    told, errors = replace(DESCRIBED, base_from_camera=mount), np.array([0.02, -0.05, 0.03, 0.01])
    true = GroundView(told.corrected(errors, ANGLES_RAD))
    ground_m = GROUND_M @ head.rotation[:2, :2].T
    pixels = true.image_from_ground(ground_m)
    wrong_m = GroundView(told).ground_from_image(pixels)
    assert np.hypot(*(wrong_m - ground_m).T).max() > 0.1
    frame = Frame(1, base_from_camera=mount if turned else None)
    view, seen = as_learned(DESCRIBED, frame, None, estimate(wrong_m, errors))
    assert seen is not None
    np.testing.assert_allclose(seen.points.positions_m, ground_m, atol=1e-6)
    np.testing.assert_allclose(view.image_from_ground(ground_m), pixels, atol=1e-4)


def test_what_lies_outside_of_the_image_stays() -> None:
    behind_m = np.array([[-2.0, 0.0], [0.0, 3.0]])
    _, seen = as_learned(DESCRIBED, Frame(1), None, estimate(behind_m, np.array([0.0, -0.05, 0.0, 0.0])))
    assert seen is not None
    assert np.isfinite(seen.points.positions_m).all()
    np.testing.assert_array_equal(seen.points.positions_m[0], behind_m[0])
