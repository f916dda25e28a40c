"""The default world: a robot as built, drawn from its seed; `ideal: true` is the one that was designed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from simulated import scenario_file

from touchline.geometry import FloatArray
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

SHORT = open_scenario("straight-tracks", 1, 4.0)
RINGS_M = np.array([0.7, 1.0, 2.0, 3.5, 7.5])


def ground() -> FloatArray:
    """(N, 2) points around the robot, ring by ring."""
    turns = np.radians(np.arange(3.0, 360.0, 30.0))
    return np.array([(r * math.cos(a), r * math.sin(a)) for r in RINGS_M for a in turns])


def read_errors(*changes: str) -> FloatArray:
    """(RINGS, N) relative errors of the ranges that the robot's own camera.yaml gives for what it truly sees."""
    simulation = Simulation(open_scenario("straight-tracks", 3, 1.0, changes), "points")
    assert isinstance(simulation.camera_model, SimulatedOmniCamera)
    read = simulation.camera.ground_from_image(simulation.camera_model.project(ground()))
    errors: FloatArray = np.hypot(*read.T) / np.hypot(*ground().T) - 1.0
    return errors.reshape(len(RINGS_M), -1)


def test_camera_yaml_is_that_of_a_calibration_or_of_the_design() -> None:
    calibrated, design = read_errors(), read_errors("camera.known_from=design")
    assert np.abs(calibrated).max() < 0.012
    assert np.abs(design).max() > 0.03
    ranges = read_errors("camera.known_from=calibrate-range", "camera.mirror.range_spread=0.01")
    error = Simulation(open_scenario("straight-tracks", 3, 1.0, ["camera.mirror.range_spread=0.01"]), "points").head
    assert 1e-3 < abs(error.range_error) < 0.04
    assert ranges[:4].mean() == pytest.approx(error.range_error, abs=0.01)


@pytest.mark.slow
def test_images_come_late_with_the_stamp_of_when_they_were_taken() -> None:
    simulation = Simulation(SHORT, "points")
    delays_s = 1e-9 * (simulation.arrival_stamps - simulation.image_stamps)
    assert delays_s.min() >= 0.04
    assert delays_s.max() <= 0.08
    assert np.ptp(delays_s) > 0.02
    late = Simulation(open_scenario("straight-tracks", 1, 4.0, ["camera.stamped=arrived"]), "points")
    np.testing.assert_array_equal(late.image_stamps, simulation.arrival_stamps)
    np.testing.assert_array_equal(late.points(20).positions_m, simulation.points(20).positions_m)
    expected = late.track.poses_at(1e-9 * simulation.arrival_stamps[20:21])[0]
    assert late.truth[20].as_array() == pytest.approx(expected)  # what is right at the time that the stamp says
    assert late.truth[20].distance_to(simulation.truth[20]) > 0.05


def test_what_a_scenario_names_stands_and_the_rest_comes_from_behind(tmp_path: Path) -> None:
    path = scenario_file(tmp_path, "camera: {delay_s: 0.1}\nothers: {robots: 2}\nideally: {others: {balls: 1}}\n")
    built, ideal = open_scenario(path), open_scenario(path, changes=["ideal=true"])
    assert (built.camera.delay_s, built.camera.delay_spread_s, built.camera.mirror.tilt_spread_deg) == (0.1, 0.0, 0.3)
    assert (built.others.robots, built.others.moving, built.others.balls) == (2, False, 0)
    assert (ideal.camera.delay_s, ideal.camera.mirror.tilt_spread_deg, ideal.others.balls) == (0.1, 0.0, 1)
    humanoid = open_scenario("humanoid-walk")
    assert humanoid == open_scenario("humanoid-walk", changes=["ideal=true"]).model_copy(update={"ideal": False})
    assert open_scenario("calibration-strip").disturbances.shove_every_s == 0.0
