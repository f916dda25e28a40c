"""Mirror calibration of heads as they are built: leaning and displaced mirrors, seen by the simulator's exact rays."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from touchline.geometry import FloatArray
from touchline.published.strip.mirror import MirrorCalibration, calibrate_mirror
from touchline.sources import open_source
from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

TILT_DEG, SHIFT_MM = (0.7, -0.5), (1.2, -0.8)


def built_head(points: int, exposure_ms: float = 12.0) -> Simulation:
    """The scenario `calibration-strip` with a mirror that leans by 0.86° and sits 1.4 mm aside."""
    scenario = open_scenario("calibration-strip", seconds=1.4 * points + 1.0)
    mirror = scenario.camera.mirror.model_copy(update={"tilt_deg": TILT_DEG, "shift_mm": SHIFT_MM})
    camera = scenario.camera.model_copy(update={"mirror": mirror, "exposure_ms": exposure_ms})
    motion = scenario.motion.model_copy(update={"points": points})
    return Simulation(scenario.model_copy(update={"camera": camera, "motion": motion}))


@pytest.fixture(scope="module")
def head() -> Simulation:
    return built_head(24)


@pytest.fixture(scope="module")
def recording(head: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its camera.yaml knows a centre that is 9 px off, and the size."""
    folder = tmp_path_factory.mktemp("built") / "head"
    write_recording(head, folder)
    rough = {"model": "omni", "width": 480, "height": 480, "center": [246.0, 233.0]}
    (folder / "camera.yaml").write_text(yaml.safe_dump(rough))
    return folder


@pytest.fixture(scope="module")
def calibration(recording: Path) -> MirrorCalibration:
    return calibrate_mirror(open_source(recording))


def errors(calibration: MirrorCalibration, head: Simulation) -> tuple[FloatArray, FloatArray, FloatArray]:
    """True ranges, errors of range (m) and bearing (rad), (N,): every 2° between first and last edge."""
    bearing, true = np.meshgrid(np.radians(np.arange(0.0, 360.0, 2.0)), np.linspace(0.6, 6.5, 100))
    points = np.column_stack(((true * np.cos(bearing)).ravel(), (true * np.sin(bearing)).ravel()))
    read = calibration.camera.ground_from_image(head.camera_model.project(points))
    turned = np.angle((read[:, 0] + 1j * read[:, 1]) / (points[:, 0] + 1j * points[:, 1]))
    return true.ravel(), np.hypot(*read.T) - true.ravel(), turned


@pytest.mark.slow
def test_ranges_are_right_at_every_bearing(calibration: MirrorCalibration, head: Simulation) -> None:
    true, error, _ = errors(calibration, head)
    assert np.all(np.abs(error) <= np.where(true < 1.5, 0.015, 0.01 * true))


@pytest.mark.slow
def test_so_are_bearings(calibration: MirrorCalibration, head: Simulation) -> None:
    _, _, turned = errors(calibration, head)
    assert np.abs(turned).max() < np.radians(0.3)
    assert np.sqrt(np.mean(turned**2)) < np.radians(0.05)
    offsets = calibration.camera.bearing_offset_rad
    assert offsets is not None
    assert np.abs(offsets).max() > np.radians(1.0)  # what one formula for all radii would leave


@pytest.mark.slow
def test_a_hidden_end_of_the_strip_comes_from_the_other_directions(
    recording: Path, head: Simulation, tmp_path: Path
) -> None:
    folder = tmp_path / "hidden"
    shutil.copytree(recording, folder)
    row = (recording / "images.csv").read_text().split()[8].split(",")
    bearing = float(row[-1])
    first = head.camera_model.project(np.array([[0.6 * np.cos(bearing), 0.6 * np.sin(bearing)]]))[0]
    image = cv2.imread(str(recording / row[1]))
    cv2.circle(image, (round(first[0]), round(first[1])), 5, (10, 10, 10), -1)  # a black cable over the first edge
    (folder / row[1]).unlink()
    cv2.imwrite(str(folder / row[1]), image)
    calibration = calibrate_mirror(open_source(folder))
    assert calibration.filled > 0
    true, error, _ = errors(calibration, head)
    assert np.all(np.abs(error) <= np.where(true < 1.5, 0.015, 0.01 * true))


@pytest.mark.slow
def test_overexposed_white_moves_no_edge(tmp_path: Path) -> None:
    head = built_head(24, exposure_ms=18.0)
    write_recording(head, tmp_path / "bright")
    true, error, _ = errors(calibrate_mirror(open_source(tmp_path / "bright"), skip_unusable=True), head)
    assert np.all(np.abs(error) <= np.where(true < 1.5, 0.015, 0.01 * true))
