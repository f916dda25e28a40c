"""Walks in RoboCup's MuJoCo soccer server, made by lab/benchmarks/mujoco: short ones are followed; the gait."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

BENCHMARK = Path(__file__).parent.parent / "benchmarks" / "mujoco"


def test_a_leg_reaches_where_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARK))
    gait = importlib.import_module("gait")
    for side in (1, -1):
        place = np.array([0.1, 0.12 * side, -0.58])
        turn = gait.rotation(2, 0.2 * side)
        end, attitude, derivatives = gait.foot(gait.leg(place, turn, side, gait.BENT), side)
        np.testing.assert_allclose(end, place, atol=1e-4)
        np.testing.assert_allclose(attitude, turn, atol=1e-4)
        assert np.linalg.matrix_rank(derivatives) == 6


def test_the_gait_shifts_the_body_over_the_leg_that_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARK))
    gait = importlib.import_module("gait")
    walk, shifts = gait.Gait(), {1: [], -1: []}
    for _ in range(200):
        angles = walk.step(0.02, np.array([0.2, 0.0, 0.1]), np.zeros(2), np.zeros(2))
        feet = [gait.foot(each, side)[0] for each, side in zip(angles, (1, -1), strict=True)]
        shifts[walk.stance].append(feet[0][1] + feet[1][1])  # negative with the body to the left
        assert min(foot[2] for foot in feet) == pytest.approx(-gait.HIP_M, abs=1e-3)
    assert np.mean(shifts[1][20:]) < -0.005 < 0.005 < np.mean(shifts[-1][20:])
