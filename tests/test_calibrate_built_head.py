"""Mirror calibration of heads as they are built: leaning and displaced mirrors, seen by the simulator's exact rays."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from touchline.camera import open_camera
from touchline.camera.writing import camera_yaml
from touchline.geometry import FloatArray
from touchline.published.strip.axis import fit_axis
from touchline.published.strip.directions import groups_of_directions, healed, smooth_bearings, white_excess
from touchline.published.strip.edges import SPREAD_PX, end_edge
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


def test_ranges_are_right_at_every_bearing(calibration: MirrorCalibration, head: Simulation) -> None:
    true, error, _ = errors(calibration, head)
    assert np.all(np.abs(error) <= np.where(true < 1.5, 0.015, 0.01 * true))


def test_so_are_bearings(calibration: MirrorCalibration, head: Simulation) -> None:
    _, _, turned = errors(calibration, head)
    assert np.abs(turned).max() < np.radians(0.3)
    assert np.sqrt(np.mean(turned**2)) < np.radians(0.05)
    offsets = calibration.camera.bearing_offset_rad
    assert offsets is not None
    assert np.abs(offsets).max() > np.radians(1.0)  # what one formula for all radii would leave


def test_the_file_brings_both_tables(calibration: MirrorCalibration, tmp_path: Path) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(camera_yaml(calibration.camera, "a remark"), encoding="utf-8")
    written = open_camera(file)
    assert written.bearing_offset_rad == pytest.approx(calibration.camera.bearing_offset_rad, abs=1e-6)
    pixels = np.array([[300.0, 200.0], [120.0, 250.0], [240.0, 60.0]])
    assert written.ground_from_image(pixels) == pytest.approx(calibration.camera.ground_from_image(pixels), abs=1e-3)


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


def test_overexposed_white_moves_no_edge(tmp_path: Path) -> None:
    head = built_head(24, exposure_ms=18.0)
    write_recording(head, tmp_path / "bright")
    true, error, _ = errors(calibrate_mirror(open_source(tmp_path / "bright"), skip_unusable=True), head)
    assert np.all(np.abs(error) <= np.where(true < 1.5, 0.015, 0.01 * true))


# --- the pieces -------------------------------------------------------------------------------------------------------

EDGES_M = np.array([0.6, 0.73, 0.86, 1.01, 1.17, 1.35, 1.55, 1.79, 2.06, 2.38, 2.78, 3.3, 3.98, 4.97, 6.5])
SIGNS = -((-1) ** np.arange(15))


def waving(directions: int) -> tuple[FloatArray, FloatArray]:
    """Directions (S,) and radii (S, 15) of a mirror that leans."""
    angles = np.arange(directions) * 2.0 * np.pi / directions
    return angles, 225.0 * np.arctan(EDGES_M / 1.57) + 5.0 * np.cos(angles - 0.4)[:, np.newaxis]


def test_an_edge_that_contradicts_the_other_directions_is_replaced_by_what_they_say() -> None:
    angles, radii = waving(24)
    spoilt = radii.copy()
    spoilt[7, 14] += 1.5
    spoilt[3, 0] = np.nan
    mended, which = healed(angles, spoilt, np.full(15, 0.2), of_its_own=True)
    assert np.argwhere(which).tolist() == [[3, 0], [7, 14]]
    assert mended == pytest.approx(radii, abs=1e-6)


def test_a_dent_in_the_mirror_stays() -> None:
    angles, radii = waving(24)
    radii[5] += 1.5  # every edge in one direction: no mistake of one edge
    mended, which = healed(angles, radii, np.full(15, 0.2), of_its_own=True)
    assert not which.any()
    assert np.array_equal(mended, radii)


def test_white_that_spreads_over_black_is_measured_as_a_zigzag() -> None:
    _, radii = waving(12)
    spread = radii - 0.15 * SIGNS  # where it gets brighter outwards the edge is seen too far in
    assert white_excess(spread, EDGES_M, SIGNS)[1:] == pytest.approx(np.full(14, 0.15), abs=0.02)
    assert white_excess(spread, EDGES_M, SIGNS)[0] == 0.0  # black beside carpet
    assert white_excess(radii, EDGES_M, SIGNS) == pytest.approx(np.zeros(15), abs=1e-6)


def blurred(r: FloatArray, edges: list[float], levels: list[float]) -> FloatArray:
    """Levels between edges, blurred as SPREAD says."""
    light = np.full(len(r), levels[-1])
    for edge, before, behind in zip(edges, levels, levels[1:], strict=False):
        light = light + (before - behind) * np.interp(r - edge, SPREAD_PX, SPREAD)
    return light


SPREAD = 1.0 / (1.0 + np.exp(SPREAD_PX / 0.5))
PROFILE_PX = np.arange(-8.0, 12.0, 0.25)


@pytest.mark.parametrize(
    ("edges", "levels"),
    [
        ([0.3], [1.0, 0.2]),  # carpet behind the strip
        ([0.3], [1.0, 0.6]),  # something brighter than the carpet
        ([0.3, 2.3], [1.0, 0.2, 0.9]),  # carpet, then a field line two pixels behind
        ([0.3, 2.3], [1.0, 0.2, 0.0]),  # carpet, then something black
    ],
)
def test_the_end_of_the_strip_is_found_whatever_lies_behind(edges: list[float], levels: list[float]) -> None:
    light = blurred(PROFILE_PX, edges, levels)
    assert end_edge(PROFILE_PX, light, 0.5, 0.2, SPREAD) == pytest.approx(0.3, abs=0.05)


def test_an_axis_through_another_centre_is_a_curve() -> None:
    center, radii = np.array([200.0, 200.0]), np.linspace(50.0, 190.0, 15)
    along = np.linspace(48.0, 195.0, 14)
    points = np.column_stack((203.0 + along, np.full(14, 202.0)))  # a line that passes the centre 2 px aside
    points[4] += (0.0, 3.0)  # a rod
    axis = fit_axis(points, center, radii)
    u, v = axis.pixels(radii)
    assert v == pytest.approx(np.full(15, 202.0), abs=0.05)
    assert np.hypot(u - 200.0, v - 200.0) == pytest.approx(radii)


def test_errors_of_turning_by_hand_are_smoothed_and_a_wrong_bearing_is_found() -> None:
    seen = np.arange(24) * 2.0 * np.pi / 24
    true = seen + 0.01 * np.cos(seen - 1.0) + 0.003 * np.sin(2.0 * seen)
    noise = np.random.default_rng(3).normal(0.0, np.radians(0.3), 24)
    smooth, wrong = smooth_bearings(seen, true + noise)
    assert wrong == {}
    assert np.sqrt(np.mean((smooth - true) ** 2)) < 0.75 * np.sqrt(np.mean(noise**2))
    given = true.copy()
    given[5] += np.radians(20.0)
    smooth, wrong = smooth_bearings(seen, given)
    assert list(wrong) == [5]
    assert smooth == pytest.approx(true, abs=1e-3)


def test_images_of_one_direction_are_one_group_across_the_seam() -> None:
    bearings = np.radians([0.5, 90.0, 180.0, 270.0, 359.0, 91.5])
    assert sorted(sorted(group) for group in groups_of_directions(bearings)) == [[0, 4], [1, 5], [2], [3]]
