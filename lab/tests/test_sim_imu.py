"""The IMU's correction and the lean that it tells, of simulated humanoids that sway."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from touchline.calibration.marks import read_marks
from touchline.camera import PinholeCamera, ground_view
from touchline.motion import LeanFilter
from touchline.published.nimbro_lines.imu import calibrate_imu
from touchline.sources import Recording
from touchline.types import Frame
from touchline_lab.simulation.recording import _write_calibration
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario


@dataclass
class Walk:
    """What `calibrate_imu` asks of a recording, without its images."""

    simulation: Simulation
    folder: Path

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.simulation)

    def file(self, name: str) -> Path:
        return self.folder / name


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Walk:
    simulation = Simulation(open_scenario("walk-in-place", 2, 15.0), "points")
    folder = tmp_path_factory.mktemp("walk")
    _write_calibration(simulation, folder)
    return Walk(simulation, folder)


@pytest.mark.slow
def test_the_imu_s_correction_holds_marks_still_and_in_place(walk: Walk) -> None:
    """Ground distances from a robot that sways, against the level camera: without, with, and by known kinematics."""
    level = walk.simulation.camera
    assert isinstance(level, PinholeCamera)
    found = calibrate_imu(cast("Recording", walk), level)
    assert found.before_px > 8.0
    assert found.after_px < 0.8  # of which the IMU's noise is 0.6
    assert found.left_out < 0.03 * len(found.seen_px)
    paper = calibrate_imu(
        cast("Recording", walk), level, paper=True
    )  # equation (2) alone: two corners are not described
    assert found.after_px < paper.after_px
    assert found.left_out < 0.2 * paper.left_out
    learned = replace(level, imu_correction=found.correction)
    marks, leaning = read_marks(walk.folder / "marks.csv"), LeanFilter()
    places = {"near-left": (1.5, 0.45), "near-right": (1.5, -0.45), "far-left": (2.8, 0.9), "far-right": (2.8, -0.9)}
    errors: list[list[float]] = []
    for frame in walk.simulation:
        leaning.add(frame)
        lean = leaning.lean(frame.stamp_ns)
        assert lean is not None
        rows = [i for i, name in enumerate(marks.files) if name == frame.name]
        true = np.array([places[marks.names[i]] for i in rows])
        views = (ground_view(replace(level, use_attitude=False)), ground_view(learned, None, *lean))
        views = (*views, ground_view(level, None, *lean))
        errors.append([float(np.hypot(*(v.ground_from_image(marks.pixels[rows]) - true).T).mean()) for v in views])
    without, with_it, by_kinematics = np.median(errors, axis=0)
    assert with_it < 0.05
    assert with_it < 0.5 * without  # the rest is what the IMU errs by all the time
    assert with_it < by_kinematics + 0.02


@pytest.mark.slow
def test_the_lean_at_an_image_is_ten_times_better_than_the_newest_reading() -> None:
    simulation, leaning = Simulation(open_scenario("humanoid-walk", 4, 20.0), "points"), LeanFilter()
    filtered, newest = [], []
    for index, frame in enumerate(simulation):
        leaning.add(frame)
        lean = leaning.lean(frame.stamp_ns)
        assert lean is not None
        assert frame.tilt is not None
        true = simulation.track.attitude_at(float(simulation.image_times_s[index]))
        filtered.append(np.subtract(lean, true))
        newest.append(frame.tilt.values[-1] - true)
    assert np.std(newest[5:]) > np.radians(0.4)
    assert np.std(np.array(filtered)[5:], axis=0).max() < np.radians(0.1)
