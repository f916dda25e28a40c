"""Every scenario runs, is written as a recording and localised; same seed, same bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated import NAMES, Recordings, content, shortened

from touchline.sources import open_source
from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.scenario import scenario_names


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    return Recordings(tmp_path_factory.mktemp("simulated"))


class TestEveryScenario:
    def test_these_come_with_the_package(self) -> None:
        assert tuple(scenario_names()) == NAMES

    @pytest.mark.slow
    @pytest.mark.parametrize("name", NAMES)
    def test_its_recording_is_read_without_a_problem(self, recordings: Recordings, name: str) -> None:
        recording = open_source(recordings[name])
        frames = list(recording)
        assert len(frames) == len(recording) > 0
        assert [str(problem) for problem in recording.problems] == []
        assert all(frame.image is not None and frame.odometry is not None for frame in frames)
        assert recording.truth is not None
        assert recording.sequence["simulation"]["seed"] == 1


class TestDeterminism:
    @pytest.mark.slow
    def test_the_same_seed_gives_the_same_bytes_and_another_seed_another_run(self, tmp_path: Path) -> None:
        for folder, seed in (("one", 5), ("same", 5), ("other", 6)):
            write_recording(shortened("match", 0.3, seed), tmp_path / folder)
        one, same, other = (content(tmp_path / folder) for folder in ("one", "same", "other"))
        assert one == same
        assert one.keys() == other.keys()
        differing = {name for name in one if one[name] != other[name]}
        assert {"images/000000.jpg", "imu.csv", "odometry.csv", "wheels.csv", "ground_truth.tum"} <= differing
        assert {"field.yaml", "camera.yaml", "images.csv"} & differing == set()

    @pytest.mark.slow
    def test_a_frame_is_the_same_whatever_was_asked_for_before(self) -> None:
        simulation = shortened("match", 1.0)
        list(simulation)
        np.testing.assert_array_equal(simulation.image(1), shortened("match", 1.0).image(1))

    @pytest.mark.slow
    def test_the_live_samples_are_those_of_the_recording(self, recordings: Recordings) -> None:
        for live, read in zip(shortened("match"), open_source(recordings["match"]), strict=True):
            for sensor in ("odometry", "wheels", "gyro", "compass", "tilt"):
                one, other = getattr(live, sensor), getattr(read, sensor)
                np.testing.assert_array_equal(one.stamp_ns, other.stamp_ns)
                np.testing.assert_array_equal(one.values, other.values)
