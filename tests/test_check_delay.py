"""`touchline check` names a constant delay of the images' stamps."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchline.checks.delay import find_delay
from touchline.checks.findings import Severity
from touchline.checks.lines import check_lines
from touchline.checks.survey import take_survey
from touchline.geometry import FloatArray, Pose
from touchline.simulation.recording import write_recording
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.sources import open_source
from touchline.types import Estimate, Samples, Status


def where(times_s: FloatArray) -> FloatArray:
    """(N, 3) a robot that drives to and fro, and turns."""
    return np.column_stack((2.0 * np.sin(0.7 * times_s), 0.5 * times_s, 0.8 * np.sin(times_s)))


def estimates(delay_s: float, noise_m: float = 0.005) -> list[Estimate]:
    stamps_s, rng = np.arange(1.0, 11.0, 0.1), np.random.default_rng(4)
    seen = where(stamps_s - delay_s) + noise_m * rng.standard_normal((len(stamps_s), 3))
    return [
        Estimate(round(1e9 * t), Pose(*pose), np.eye(3), Status.TRACKING)
        for t, pose in zip(stamps_s, seen.tolist(), strict=True)
    ]


def odometry(scale: float = 1.02) -> Samples:
    """In a frame of its own, with a scale error."""
    times_s = np.arange(0.0, 11.0, 0.02)
    poses = where(times_s)
    c, s = math.cos(1.0), math.sin(1.0)
    turned = scale * poses[:, :2] @ np.array([[c, s], [-s, c]])
    return Samples(np.rint(1e9 * times_s).astype(np.int64), np.column_stack((turned, poses[:, 2] + 1.0)))


@pytest.mark.parametrize("delay_s", [0.0, 0.06, 0.1, 0.25, -0.05])
def test_the_delay_is_found_beside_a_scale_error(delay_s: float) -> None:
    found = find_delay(estimates(delay_s), odometry())
    assert found is not None
    assert found.late_s == pytest.approx(delay_s, abs=max(0.006, 4.0 * found.deviation_s))
    assert found.deviation_s < 0.01


def test_too_little_to_compare_tells_nothing() -> None:
    assert find_delay(estimates(0.1)[:15], odometry()) is None
    assert find_delay(estimates(0.1), replace(odometry(), stamp_ns=odometry().stamp_ns + 10**13)) is None


@pytest.mark.parametrize("stamped", ["taken", "arrived"])
def test_a_recording_stamped_on_arrival_is_named_and_one_with_true_stamps_is_not(tmp_path: Path, stamped: str) -> None:
    changes = ["camera.delay_s=0.1", f"camera.stamped={stamped}"]
    write_recording(Simulation(open_scenario("match", 1, 9.0, changes), "points"), tmp_path / "late")
    found = {finding.check: finding for finding in check_lines(take_survey(open_source(tmp_path / "late")))}
    assert ("delay" in found) == (stamped == "arrived")
    if stamped == "arrived":
        assert found["delay"].severity is Severity.WARNING
        assert 80.0 < float(found["delay"].what.split()[3]) < 120.0
