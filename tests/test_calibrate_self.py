"""calibrate self: a mirror askew is found from the lines of a drive; what tells too little is refused."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from touchline.calibration.self_calibration import SelfCalibration, calibrate_self, spread_views
from touchline.camera import OmniCamera
from touchline.cli.commands import app
from touchline.errors import NoFitError
from touchline.geometry import Pose
from touchline.systems import RobotSetup, open_system
from touchline.types import Estimate
from touchline_lab.experiments.drives import Drive, driven
from touchline_lab.simulation.cameras.factory import open_simulated_camera
from touchline_lab.simulation.cameras.mirror_rays import MirrorMount
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.scenario import CameraSettings

ASKEW = (
    "camera.known_from=design", "camera.mirror.tilt_spread_deg=0", "camera.mirror.shift_spread_mm=0",
    "camera.mirror.tilt_deg=[0.5,-0.3]", "camera.mirror.shift_mm=[0.2,0.3]",
)  # fmt: skip


@pytest.fixture(scope="module")
def robot() -> tuple[Drive, RobotSetup, list[Estimate]]:
    drive = driven("match", 4, 10.0, *ASKEW)
    setup = drive.setup
    assert isinstance(setup.camera, OmniCamera)
    setup = replace(setup, camera=replace(setup.camera, stated_uncertainty=None))  # a table that nobody has touched
    system = open_system("touchline", setup)
    return drive, setup, [system.step(frame) for frame in drive.frames]


@pytest.fixture(scope="module")
def found(robot: tuple[Drive, RobotSetup, list[Estimate]]) -> SelfCalibration:
    _, setup, estimates = robot
    assert isinstance(setup.camera, OmniCamera)
    return calibrate_self(spread_views(estimates), setup.camera, setup.field)


def test_line_points_lie_on_the_lines_with_the_camera_that_is_written(
    robot: tuple[Drive, RobotSetup, list[Estimate]], found: SelfCalibration
) -> None:
    drive, setup, _ = robot
    apart = {camera: beside_lines_m(drive, camera) for camera in (setup.camera, found.camera)}
    assert apart[found.camera] < 0.6 * apart[setup.camera]  # the rest is of a head that shakes
    assert found.after[0] > 0.85 > found.before[0]


def test_the_ground_is_shown_where_it_is_and_not_shifted_about_the_robot(found: SelfCalibration) -> None:
    built = open_simulated_camera(
        CameraSettings(), MirrorMount(math.radians(0.5), math.radians(-0.3), shift_x=0.0002, shift_y=0.0003)
    )
    assert isinstance(built, SimulatedOmniCamera)
    around = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    for range_m in (1.5, 2.0, 3.0, 4.0):
        exact = range_m * np.column_stack((np.cos(around), np.sin(around)))
        off = found.camera.ground_from_image(built.project(exact)) - exact
        assert np.hypot(*off.mean(axis=0)) < 0.009  # twice as much by one law for all shapes of mirrors
        assert np.sqrt((off**2).sum(axis=1).mean()) < 0.011


def beside_lines_m(drive: Drive, camera: OmniCamera) -> float:
    """Median distance of the points of a drive from the lines, at the true poses."""
    away = []
    for frame, truth in zip(drive.frames[::5], drive.truth[::5], strict=True):
        assert frame.observation is not None
        ground = camera.ground_from_image(frame.observation.points.pixels)
        placed = Pose(*truth.tolist()).transform(ground[np.isfinite(ground).all(axis=1)])
        away.append(drive.field.line_distances(placed))
    return float(np.median(np.concatenate(away)))


def test_lean_and_how_sure_it_is_are_told(found: SelfCalibration) -> None:
    lean_per_m = np.hypot(*np.radians([0.5, 0.3])) * 2.0 / 0.75
    assert np.hypot(*found.shared[:2]) == pytest.approx(lean_per_m, rel=0.15)
    sure = found.camera.uncertainty
    assert 0.005 < sure.tilt_deg < 0.1
    assert 0.02 < sure.center_px < 0.8


def test_too_few_places_and_another_field_are_refused(robot: tuple[Drive, RobotSetup, list[Estimate]]) -> None:
    _, setup, estimates = robot
    assert isinstance(setup.camera, OmniCamera)
    with pytest.raises(NoFitError, match="too few, 3 are needed: the robot must move about"):
        calibrate_self(spread_views(estimates[60:61]), setup.camera, setup.field)
    views = [one._replace(pose=one.pose + np.array([1.0, 1.0, 0.3])) for one in spread_views(estimates)]
    with pytest.raises(NoFitError, match="% of the line points lie on lines with the best mirror"):
        calibrate_self(views, setup.camera, setup.field)


def test_views_lie_apart(robot: tuple[Drive, RobotSetup, list[Estimate]]) -> None:
    views = spread_views(robot[2], 10)
    poses = np.array([one.pose for one in views])
    places = np.column_stack((poses[:, :2], 1.5 * np.cos(poses[:, 2]), 1.5 * np.sin(poses[:, 2])))
    gaps = np.linalg.norm(places[:, np.newaxis] - places, axis=2)[~np.eye(len(poses), dtype=bool)]
    assert len(views) == 10
    assert gaps.min() > 0.3


def test_the_command_refuses_a_recording_that_tells_too_little(small_data: Path, tmp_path: Path) -> None:
    target = tmp_path / "camera.yaml"
    result = CliRunner().invoke(app, ["calibrate", "self", str(small_data / "omni_9x6_points"), "-o", str(target)])
    assert result.exit_code != 0
    assert re.search("not calibrated: the recording leaves", str(result.exception) + result.output)
    assert not target.exists()
