"""iris-points, iris-tracks, iris-track, iris-disturbances: the figures that they must reach, with fewer runs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from touchline.field import open_field
from touchline.geometry import wrap_angles
from touchline.systems import RobotSetup
from touchline.types import Frame, Mode, Samples
from touchline_lab.experiments import iris_disturbances, iris_points
from touchline_lab.experiments.drives import Drive, Track
from touchline_lab.experiments.injections import covered, gyro_drifting, slipped
from touchline_lab.experiments.iris_runs import SYSTEMS, IrisDrive, drive

# --- disturbances ---------------------------------------------------------------------------------------------------


def test_a_slip_turns_the_wheels_by_30_cm_and_a_drift_adds_a_degree_per_second() -> None:
    stamps = (np.arange(50) * 20_000_000).astype(np.int64)
    zeros = Samples(stamps, np.zeros((50, 2)))
    setup = RobotSetup(open_field("indoor-9x6"), wheel_directions_rad=(math.pi / 4, -math.pi / 4))
    frames = [Frame(0, wheels=zeros, gyro=Samples(stamps, np.zeros((50, 3)))), Frame(2_000_000_000)]
    still = Drive(setup, frames, np.zeros((2, 3)))
    rolled = slipped(still, 0.3, 0.3, 0.0).frames[0].wheels
    assert rolled is not None
    assert rolled.values[:15] == pytest.approx(0.0)
    assert rolled.values[-1] == pytest.approx([0.3 / math.sqrt(2)] * 2)
    turned = gyro_drifting(still, 0.5, math.radians(1.0)).frames[0].gyro
    assert turned is not None
    assert turned.values[:25].max() == 0.0
    assert np.degrees(turned.values[25:, 2]) == pytest.approx(1.0)
    assert [frame.observation is None for frame in covered(still, 0.0, 1.0).frames] == [False, True]


def test_what_an_outcome_says_comes_from_the_truth() -> None:
    """A pose that is 1 m off for half a second, then 5 cm."""
    count = 60
    truth = np.zeros((count, 3))
    track = np.zeros((count, 3))
    track[10:15, 0], track[15:, 1] = 1.0, 0.05
    track[:, 2] = wrap_angles(np.full(count, 2.0 * math.pi))
    stamps = (np.arange(count) * 100_000_000).astype(np.int64)
    tracking = np.array([not 10 <= k < 13 for k in range(count)])
    said = dict.fromkeys(SYSTEMS, Track(stamps / 1e9, track, truth, tracking))
    none = np.zeros(0, dtype=np.int64)
    driven = IrisDrive(open_field("indoor-9x6"), said, np.ones(count, dtype=bool), (Mode.BOTH,) * count, none)
    assert driven.tracked_ratio(1.0) == pytest.approx(47 / 50)
    late = replace(driven, before_ns=stamps - stamps[-1])  # found 5.9 s after the start
    assert late.tracked_ratio(-4.0) == pytest.approx(57 / 101)
    outcome = iris_disturbances.outcome_of(driven, 1.0)
    assert (outcome.far_s, outcome.back_m, outcome.lost_s, outcome.largest_m) == pytest.approx((0.5, 0.05, 0.3, 1.0))
    assert outcome.is_kept("slip")
    assert not outcome.is_kept("covered")  # farther than 30 cm
    assert not outcome.is_kept("nothing")


# --- robots that are not found --------------------------------------------------------------------------------------


def blind(seed: int) -> IrisDrive:
    """A drive whose camera shows nothing at all."""
    frames = [Frame(100_000_000 * k) for k in range(40)]
    return drive(Drive(RobotSetup(open_field("indoor-9x6")), frames, np.zeros((40, 3))), seed)


def test_a_drive_that_never_finds_the_robot_holds_nothing() -> None:
    driven = blind(0)
    assert not driven.found
    assert len(driven.before_ns) == 40
    assert driven.tracked_ratio(1.0) == 0.0
    assert all(track.poses.shape == track.truth.shape == (0, 3) for track in driven.tracks.values())
    outcome = iris_disturbances.outcome_of(driven, 1.0)
    assert not outcome.found
    assert not any(outcome.is_kept(kind) for kind in iris_disturbances.KINDS)


# --- the table ------------------------------------------------------------------------------------------------------


def test_without_the_recording_the_simulated_table_stands_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two places, at each of which the fusion is 1 cm off, the others 2 and 3."""
    truth = np.repeat([[0.0, 0.0, 0.0], [1.0, 2.0, 0.5]], 30, axis=0)
    times_s, tracking, none = np.arange(60) / 5.0, np.ones(60, dtype=bool), np.zeros(0, dtype=np.int64)
    said = {
        name: Track(times_s, truth + np.array([error_m, 0.0, 0.0]), truth, tracking)
        for name, error_m in zip(SYSTEMS, (0.02, 0.03, 0.01), strict=True)
    }
    toured = IrisDrive(open_field("indoor-9x6"), said, tracking, (Mode.BOTH,) * 60, none)
    monkeypatch.setattr(iris_points, "tour", lambda *_, **__: toured)
    monkeypatch.setattr(iris_points, "recorded_tour", lambda *_: None)
    found = iris_points.iris_points(1)
    first = {row[0]: row for row in found.rows if row[0]}
    fusions = ("on images", "mirror tilted by 0.5°", "mirror tilted by 0.5°, on images")
    assert list(first) == [*SYSTEMS, *(f"sensor fusion, {name}" for name in fusions)]
    assert [row[5] for row in first.values()] == ["2.00", "3.00", *["1.00"] * 4]
    assert "TOUCHLINE_DATA" in " ".join(found.notes)
    assert [name for name, _ in found.pictures] == ["error-map", "places"]
