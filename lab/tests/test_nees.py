"""The experiment `nees`: what counts of a covariance, and its table."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from touchline.field import open_field
from touchline.geometry import Pose
from touchline.systems import RobotSetup
from touchline.types import Estimate, Frame, Status
from touchline_lab.experiments import drives, nees


def test_of_honest_errors_a_third_of_nees_is_one_and_the_ellipse_covers_95_percent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng, count = np.random.default_rng(1), 2000
    deviations = np.array([0.02, 0.05, 0.01])
    truth = np.column_stack((rng.uniform(-3, 3, (count, 2)), np.full(count, 3.1)))
    frames = [Frame(k * 10_000_000) for k in range(count)]

    def step(frame: Frame) -> Estimate:
        k = frame.stamp_ns // 10_000_000
        pose = truth[k] + deviations * rng.standard_normal(3)
        status = Status.TRACKING if k % 2 else Status.SEARCHING
        return Estimate(frame.stamp_ns, Pose(*pose.tolist()), np.diag(deviations**2), status)

    monkeypatch.setattr(drives, "open_system", lambda *_: SimpleNamespace(step=step))
    drive = drives.Drive(RobotSetup(open_field("msl-18x12")), frames, truth)
    found = nees.honesty_of(drives.followed("nubot-mti", drive, 0), (5.0, 20.0))
    assert found.nees == pytest.approx(1.0, abs=0.1)
    assert found.covered == pytest.approx(0.95, abs=0.02)
    assert found.error_m == pytest.approx(0.044, abs=0.004)
    assert found.stated_m == pytest.approx(0.0539, abs=0.001)
    assert found.tracked == 0.5
