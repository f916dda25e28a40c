"""The measurements of docs/how-to-extend.md, as they stand there: valid for both kinds of camera; and its lens."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml
from drives import Drive, open_drive

from touchline.camera import CAMERAS, PerspectiveCamera, open_camera
from touchline.camera.base import ground_jacobian
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.estimator.measurement import Measurement
from touchline.systems import open_system, touchline
from touchline.types import Frame, Prior, Status

PAGE = Path(__file__).parents[1] / "docs" / "how-to-extend.md"
PACKAGE = "touchline.localization.estimator"
POSTS = np.array([[4.5, 1.3], [4.5, -1.3], [-4.5, 1.3]])
BOARD_M, BOARD_RAD = 5.0, 0.5 * math.pi
OFF = np.array([0.25, -0.25, 0.15])  # how far off the start is (m, m, rad)
BLIND = 25  # images
# of each measurement: its reading at a pose, which of x, y, heading (or both) it shows, and how well (m, rad)
READINGS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "heading": lambda pose: pose[2:],
    "post ranges": lambda pose: np.column_stack((POSTS, np.hypot(*(POSTS - pose[:2]).T))),
    "board": lambda pose: np.array([BOARD_M - pose[1], wrap_angle(BOARD_RAD - float(pose[2]))]),
}
SHOWN = {"heading": [2], "post ranges": [0, 1], "board": [1, 2]}


def modules(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The page's files, imported; the last is the table."""
    blocks = re.findall(r"```python\n# localization/estimator/(\w+)\.py\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert [name for name, _ in blocks] == ["measured_heading", "post_ranges", "laser_board", "measurements"]
    for name, text in blocks:
        module = ModuleType(f"{PACKAGE}.{name}")
        exec(compile(text, f"{PAGE.name}: {name}.py", "exec"), module.__dict__)
        monkeypatch.setitem(sys.modules, module.__name__, module)
    return module


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch) -> tuple[Measurement, ...]:
    """The three of the page, entered in the system."""
    found: tuple[Measurement, ...] = modules(monkeypatch).MEASUREMENTS
    monkeypatch.setattr(touchline, "MEASUREMENTS", found)
    return found


ROBOTS = pytest.mark.parametrize("robot", ["tracks", "walk-kid"])


def errors(drive: Drive, sensor: str | None, blind: bool) -> tuple[FloatArray, list[Status]]:
    """Absolute errors (N, 3) of a start that is off, and the status, with the readings of a sensor or none."""
    system, rng = open_system("touchline", drive.setup), np.random.default_rng(1)
    system.reset(Prior(Pose(*(drive.truth[0] + OFF))))
    found, said = [], []
    for frame, truth in zip(drive.frames, drive.truth, strict=True):
        estimate = system.step(as_measured(frame, truth, sensor, rng, blind))
        off = np.array(estimate.pose) - truth
        found.append([abs(off[0]), abs(off[1]), abs(wrap_angle(float(off[2])))])
        said.append(estimate.status)
    return np.array(found), said


def as_measured(frame: Frame, truth: FloatArray, sensor: str | None, rng: np.random.Generator, blind: bool) -> Frame:
    """A frame with a sensor's noisy reading, and without anything seen."""
    if blind:
        frame = replace(frame, image=None, observation=None)
    if sensor is None:
        return frame
    noisy = truth + rng.normal(0.0, [0.02, 0.02, 0.02])
    return replace(frame, measurements={sensor: READINGS[sensor](noisy)})


@ROBOTS
@pytest.mark.parametrize("sensor", READINGS)
def test_a_measurement_alone_pulls_a_wrong_pose_to_the_truth(
    robot: str, sensor: str, table: tuple[Measurement, ...]
) -> None:
    drive = open_drive(robot)
    drive = replace(drive, frames=drive.frames[:BLIND], truth=drive.truth[:BLIND])
    (with_it, _), (without, _) = errors(drive, sensor, blind=True), errors(drive, None, blind=True)
    shown = SHOWN[sensor]
    assert (without[-5:, shown].mean(axis=0) > 0.1).all()
    assert (with_it[-5:, shown].mean(axis=0) < 0.7 * without[-5:, shown].mean(axis=0)).all()


@ROBOTS
def test_a_false_measurement_moves_nothing(robot: str, table: tuple[Measurement, ...]) -> None:
    drive = open_drive(robot)
    system, other = open_system("touchline", drive.setup), open_system("touchline", drive.setup)
    for one in (system, other):
        one.reset(Prior(Pose(*drive.truth[0])))
    for frame, truth in zip(drive.frames[:30], drive.truth, strict=False):
        false = {"heading": truth[2:] + 2.0, "board": np.array([BOARD_M - truth[1] + 3.0, BOARD_RAD - truth[2]])}
        estimate, right = system.step(replace(frame, measurements=false)), other.step(frame)
    assert estimate.status is Status.TRACKING
    assert estimate.pose.distance_to(right.pose) < 0.02


@pytest.mark.parametrize("sensor", READINGS)
def test_the_gradient_is_that_of_the_squared_residual(sensor: str, table: tuple[Measurement, ...]) -> None:
    """At a residual within a standard deviation, where a false reading is unlikely."""
    measurement, truth = table[list(READINGS).index(sensor)], np.array([1.0, -0.8, 0.4])
    frame = Frame(0, measurements={sensor: READINGS[sensor](truth)})
    at, step = truth + np.array([0.01, 0.01, 0.005]), 1e-5
    evidence = measurement.of(frame, Pose(*at))
    assert evidence is not None

    def log_likelihood(offset: FloatArray) -> float:
        there = measurement.of(frame, Pose(*(at + offset)))
        assert there is not None
        return there.log_likelihood

    numeric = [(log_likelihood(one) - log_likelihood(-one)) / (2.0 * step) for one in step * np.eye(3)]
    assert evidence.gradient == pytest.approx(numeric, rel=0.02, abs=1e-3)
    assert evidence.information == pytest.approx(evidence.information.T)
    assert np.linalg.eigvalsh(evidence.information)[0] > -1e-6


def test_a_frame_without_a_reading_gives_no_evidence(table: tuple[Measurement, ...]) -> None:
    assert [one.of(Frame(0), Pose(0.0, 0.0, 0.0)) for one in table] == [None, None, None]


# --- another lens -----------------------------------------------------------------------------------------------------

LENS = {"model": "equisolid", "width": 640, "height": 480, "fx": 285.0, "fy": 285.0, "cx": 321.4, "cy": 238.2}
MOUNT = {"x": 0.04, "y": 0.0, "z": 0.52, "roll": 0.0, "pitch": 0.55, "yaw": 0.0}


@pytest.fixture
def lens(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> PerspectiveCamera:
    """The camera of the page, entered as it says, and opened from its camera.yaml."""
    (block,) = re.findall(r"```python\n# camera/equisolid\.py\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    module = ModuleType("touchline.camera.equisolid")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(block, f"{PAGE.name}: equisolid.py", "exec"), module.__dict__)
    monkeypatch.setitem(CAMERAS, "equisolid", module.EquisolidCamera)
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(LENS | {"mount": MOUNT, "use_attitude": False}))
    camera = open_camera(tmp_path / "camera.yaml")
    assert isinstance(camera, PerspectiveCamera)
    assert camera.mapping() == LENS | {"mount": MOUNT, "use_attitude": False}
    return camera


def test_pixels_and_ground_of_another_lens(lens: PerspectiveCamera) -> None:
    v, u = np.mgrid[0:480:16, 0:640:16]
    pixels = np.column_stack((u.ravel(), v.ravel())).astype(float)
    rays, ground = lens.camera_rays(pixels), lens.ground_from_image(pixels)
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
    assert lens.image_from_camera(3.0 * rays) == pytest.approx(pixels, abs=1e-9)
    near = np.hypot(*np.nan_to_num(ground, nan=1e9).T) < 20.0
    assert lens.image_from_ground(ground[near]) == pytest.approx(pixels[near], abs=1e-6)
    slopes = ground_jacobian(lens.ground_from_image, pixels[near])
    assert lens.ground_covariances(pixels[near], 2.0, 0.0) == pytest.approx(4.0 * slopes @ slopes.transpose(0, 2, 1))
    off = lens.corrected(np.array([0.0, 0.0, 0.0, 0.02]), np.linspace(0.1, 1.2, 30))
    assert off.fx == pytest.approx(lens.fx / 1.02, rel=5e-3)
