"""How the robots of the scenarios move, and what they see live."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from simulated import scenario_file, shortened

from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario


class TestMotions:
    def test_a_kidnap_lies_half_an_image_before_the_first_new_image(self) -> None:
        simulation = Simulation(open_scenario("kidnap", seconds=4.5, changes=["ideal=true"]), "points")
        assert [(event["t"], event["kind"]) for event in simulation.events] == [
            (1.8, "occluded"), (2.05, "kidnap"), (3.8, "occluded"), (4.05, "kidnap"),
        ]  # fmt: skip
        covered = [simulation.track.covered_at(t) for t in simulation.image_times_s]
        assert [index for index, black in enumerate(covered) if black] == [17, 18, 19, 37, 38, 39]
        moves = [simulation.truth[k].distance_to(simulation.truth[k + 1]) for k in range(len(simulation) - 1)]
        assert moves[19] > 0.5
        assert max(moves[:19]) < 0.15
        assert all(len(simulation.points(index)) == 0 for index in (17, 18, 19))


class TestLive:
    def test_the_exposure_set_now_is_that_of_the_next_image(self) -> None:
        simulation = shortened("straight-tracks", 0.5)
        means = []
        for frame in simulation:
            assert frame.image is not None
            means.append(float(frame.image.mean()))
            simulation.set(0.5 * (frame.exposure_ms or 0.0), 1.7)
        assert all(after < 0.85 * before for before, after in itertools.pairwise(means))
        assert simulation.frame(0).exposure_ms == pytest.approx(12.0 / 2**5)

    def test_grab_looks_again_from_the_same_place(self) -> None:
        simulation = shortened("straight-tracks", 0.5)
        frames = iter(simulation)
        first = next(frames).image
        again = simulation.grab()
        assert first is not None
        assert not np.array_equal(first, again)
        assert np.abs(first.astype(float) - again).mean() < 4.0
        simulation.set(24.0, 1.7)
        assert simulation.grab().mean() > 1.2 * again.mean()
        assert next(frames).stamp_ns == 200_000_000

    def test_a_late_image_brings_the_samples_that_came_meanwhile(self, tmp_path: Path) -> None:
        path = scenario_file(tmp_path, "seconds: 1\ncamera: {delay_s: 0.05, delay_spread_s: 0.01}\n")
        simulation = Simulation(open_scenario(path), "points")
        delays = simulation.arrival_stamps - simulation.image_stamps
        assert np.all((delays >= 40_000_000) & (delays <= 60_000_000))
        seen = 0
        for frame, arrival in zip(simulation, simulation.arrival_stamps, strict=True):
            assert frame.odometry is not None
            seen += len(frame.odometry)
            assert frame.stamp_ns < frame.odometry.stamp_ns[-1] <= arrival
            assert seen == arrival // 20_000_000 + 1
