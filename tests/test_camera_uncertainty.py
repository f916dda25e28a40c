"""What camera.yaml says of how sure it is: read, checked, written, and what it is good for."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from touchline.camera import OmniCamera, open_camera
from touchline.camera.model_free import MIN_UNCERTAINTY, Edges, edges_uncertainty
from touchline.camera.uncertainty import USUAL_RANGE_RATIO, USUAL_TILT_DEG, CameraUncertainty
from touchline.camera.writing import camera_yaml
from touchline.errors import InputError
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.types import LinePoints
from touchline_lab.simulation.cameras.omni import omni_mapping
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELD = open_field("msl-18x12")
RADII = np.arange(52.0, 201.0)
CAMERA = OmniCamera(
    480, 480, (239.5, 239.5), 52.0, 200.0, -1, -1.5708, RADII, np.zeros(1), 1.57 * np.tan(0.0071 * RADII)[np.newaxis]
)


def written(tmp_path: Path, camera: OmniCamera, **more: object) -> Path:
    file = tmp_path / "camera.yaml"
    file.write_text(yaml.safe_dump({**omni_mapping(camera), **more}), encoding="utf-8")
    return file


def test_a_file_that_does_not_say_how_sure_it_is_is_as_sure_as_usual(tmp_path: Path) -> None:
    camera = open_camera(written(tmp_path, CAMERA))
    assert camera.stated_uncertainty is None
    assert camera.uncertainty == CameraUncertainty(USUAL_TILT_DEG, 1.5, USUAL_RANGE_RATIO)
    assert "uncertainty" not in omni_mapping(camera)


@pytest.mark.parametrize("sure", [CameraUncertainty(0.0, 0.0, 0.0), CameraUncertainty(0.1, 0.75, 0.0125)])
def test_what_is_stated_is_written_and_read_again(tmp_path: Path, sure: CameraUncertainty) -> None:
    camera = replace(CAMERA, stated_uncertainty=sure)
    assert open_camera(written(tmp_path, camera)).uncertainty == sure
    other = tmp_path / "calibrated.yaml"
    other.write_text(camera_yaml(camera, "a remark"), encoding="utf-8")
    assert open_camera(other).uncertainty == sure


def test_a_part_of_it_is_enough(tmp_path: Path) -> None:
    sure = open_camera(written(tmp_path, CAMERA, uncertainty={"center_px": 0.5})).uncertainty
    assert sure == CameraUncertainty(USUAL_TILT_DEG, 0.5, USUAL_RANGE_RATIO)


@pytest.mark.parametrize(
    ("value", "named"),
    [
        (0.3, "must be a mapping"),
        ({"tilt": 0.3}, "uncertainty.tilt.*tilt_deg"),
        ({"tilt_deg": -0.1}, "uncertainty.tilt_deg.*between 0 and 10"),
        ({"range_ratio": 3}, "uncertainty.range_ratio.*between 0 and 0.5"),
        ({"center_px": "one"}, "uncertainty.center_px"),
        ({"center_px": math.nan}, "uncertainty.center_px"),
    ],
)
def test_nonsense_is_named(tmp_path: Path, value: object, named: str) -> None:
    with pytest.raises(InputError, match=named):
        open_camera(written(tmp_path, CAMERA, uncertainty=value))


def test_the_simulator_says_what_it_draws_from_and_nothing_is_wrong_with_an_ideal_robot() -> None:
    def stated(*changes: str) -> CameraUncertainty:
        camera = Simulation(open_scenario("straight-tracks", 1, 1.0, changes), level="points").camera
        assert isinstance(camera, OmniCamera)
        return camera.uncertainty

    assert stated("ideal=true") == CameraUncertainty(0.0, 0.0, 0.0)
    design = stated("camera.known_from=design", "camera.mirror.range_spread=0.01")
    assert design == CameraUncertainty(0.3, pytest.approx(1.5), 0.01)
    mirror = stated()
    assert MIN_UNCERTAINTY.tilt_deg <= mirror.tilt_deg < 0.1
    assert MIN_UNCERTAINTY.center_px <= mirror.center_px < 0.3
    assert MIN_UNCERTAINTY.range_ratio <= mirror.range_ratio < 0.005


def test_edges_that_scatter_more_leave_a_calibration_less_sure() -> None:
    bearings, ranges = np.arange(24) * math.pi / 12.0, np.linspace(0.7, 8.0, 15)
    radii = np.arctan(ranges / 1.57) / 0.0071 + np.zeros((24, 1))
    noise = np.random.default_rng(2).standard_normal(radii.shape)
    fine, rough = (
        edges_uncertainty(Edges(bearings, np.zeros_like(radii), radii + px * noise, ranges)) for px in (0.0, 2.0)
    )
    assert fine == pytest.approx(MIN_UNCERTAINTY)
    assert rough.center_px > 2.0 * fine.center_px
    assert rough.tilt_deg > 1.5 * fine.tilt_deg


def true_and_seen(pose: Pose, camera: OmniCamera, off_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    ground = pose.inverse().transform(np.concatenate([line[::3] for line in FIELD.polylines()]))
    ground = ground[np.hypot(*ground.T) < 6.0]
    points = camera.ground_from_image(camera.image_from_ground(ground) + off_px)
    shown = np.isfinite(points).all(axis=1)
    noise = 0.005 * np.random.default_rng(4).standard_normal((int(shown.sum()), 2))
    return ground[shown], points[shown] + noise


def seen(pose: Pose, camera: OmniCamera, off_px: FloatArray) -> LinePoints:
    """Points of the lines within 6 m, through a mirror whose image is displaced by off_px (2,)."""
    points = true_and_seen(pose, camera, off_px)[1]
    count = len(points)
    return LinePoints(points, np.tile(1e-4 * np.eye(2), (count, 1, 1)), np.ones(count), np.zeros((count, 2)))


def test_a_displaced_mirror_is_found_out_unless_the_file_says_that_it_is_exact() -> None:
    """A mirror 0.3 mm off shifted every pose by centimetres, however well its tilt was known."""
    rng, off_px = np.random.default_rng(1), np.array([1.2, -0.9])
    tilts = {
        name: LearnedMirror(FIELD, replace(CAMERA, stated_uncertainty=sure), looked_for=(displaced, displaced))
        for name, displaced, sure in (
            ("usual", True, None),
            ("exact", True, CameraUncertainty(0.0, 0.0, 0.0)),
            ("paper", False, None),
        )
    }
    errors: dict[str, list[float]] = {name: [] for name in tilts}
    for _ in range(12):
        pose = Pose(*rng.uniform((-5.0, -3.0, -3.0), (5.0, 3.0, 3.0)).tolist())
        points = seen(pose, CAMERA, off_px)
        for name, tilt in tilts.items():
            fit = tilt.update(points, pose)
            assert fit is not None
            errors[name].append(float(np.hypot(fit.pose[0] - pose.x, fit.pose[1] - pose.y)))
    usual, exact = tilts["usual"], tilts["exact"]
    ground, _ = true_and_seen(pose, CAMERA, off_px)
    assert np.median(np.hypot(*(usual.corrected(points.positions_m) - ground).T)) < 0.01  # not 1.5 px beside
    assert max(errors["usual"][3:]) < 0.015
    assert np.median(errors["paper"][3:]) > 0.02
    assert not exact.mean.any()
    assert not exact.covariance.any()
    assert np.trace(exact.unseen) == 0.0
    assert 0.0 < np.sqrt(np.trace(usual.unseen)) < 0.03


def test_a_right_file_is_not_spoilt_by_what_the_detector_errs_by() -> None:
    """Errors that the lines do not show beyond doubt are not taken off the points, but the pose is as unsure."""
    tilt = LearnedMirror(FIELD, CAMERA)
    for k in range(8):
        pose = Pose(-3.0 + 0.7 * k, 0.5, 0.3 * k)
        tilt.update(seen(pose, CAMERA, np.zeros(2)), pose)
    assert np.abs(tilt.correction).max() < 1e-3
    assert np.trace(tilt.unseen) > 0.0
