"""The experiment `reliability`: faults of wheels, and what counts as fooled."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from touchline.experiments import drives, reliability
from touchline.experiments.drives import (
    KIDNAPS,
    Drive,
    Kidnapped,
    counts,
    driven,
    followed,
    kidnaps_of,
    longest,
    track_of,
)
from touchline.experiments.faults import Slip, no_wheels, some_wheels
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.systems import RobotSetup
from touchline.types import Estimate, Frame, Hypothesis, Samples, Status

FIELD = open_field("indoor-9x6")


def drive(poses: FloatArray) -> Drive:
    """A frame per pose, 0.1 s apart; odometry tells the same, wheels a tenth of a metre per frame."""
    frames = []
    for k, pose in enumerate(poses):
        stamp_ns = np.array([100_000_000 * (k + 1)])
        wheels = Samples(stamp_ns, np.array([[0.1 * k, -0.1 * k]]))
        frames.append(Frame(int(stamp_ns[0]), odometry=Samples(stamp_ns, pose.reshape(1, 3)), wheels=wheels))
    return Drive(RobotSetup(FIELD), frames, poses)


def values(told: Drive, name: str) -> FloatArray:
    return np.concatenate([getattr(frame, name).values for frame in told.frames])


CIRCLE = np.array([[math.sin(0.1 * k), 1.0 - math.cos(0.1 * k), 0.1 * k] for k in range(40)])


def test_wheels_that_spin_or_stick_go_on_from_there_and_the_rest_of_the_way_is_true() -> None:
    rng = np.random.default_rng(0)
    stuck = values(Slip("stuck", 1.0, 2.0, factor=0.0).laid_into(drive(CIRCLE), rng), "odometry")
    np.testing.assert_allclose(stuck[:9], CIRCLE[:9], atol=1e-12)
    np.testing.assert_allclose(np.diff(stuck[8:19], axis=0), 0.0, atol=1e-12)
    ours, true = (Pose(*rows[30]).inverse().compose(Pose(*rows[39])) for rows in (stuck, CIRCLE))
    np.testing.assert_allclose(ours, true, atol=1e-9)
    spun = Slip("spin", 1.0, 2.0, spin_m_s=2.0).laid_into(drive(CIRCLE), rng)
    np.testing.assert_allclose(values(spun, "wheels")[-1], [3.9 + 2.0, -3.9 + 2.0], atol=1e-9)
    np.testing.assert_allclose(values(spun, "odometry")[:, 2], CIRCLE[:, 2], atol=1e-9)
    longer = values(Slip("long", 0.0, 9.0, factor=1.15).laid_into(drive(CIRCLE), rng), "wheels")
    np.testing.assert_allclose(longer, 1.15 * values(drive(CIRCLE), "wheels"), atol=1e-9)


def test_wheels_that_are_gone_or_dropped_say_nothing() -> None:
    rng, made = np.random.default_rng(0), drive(CIRCLE)
    assert no_wheels(made, 3, rng).odometry is None
    kept = [some_wheels(0.3)(made, k % 40, rng).wheels is not None for k in range(400)]
    assert 0.6 < np.mean(kept) < 0.8


def estimate(pose: Pose, status: Status = Status.TRACKING, *others: Pose) -> Estimate:
    return Estimate(0, pose, np.eye(3), status, hypotheses=tuple(Hypothesis(other, 0.0) for other in others))


def test_a_wrong_pose_counts_unless_its_twin_is_named_or_it_is_doubted() -> None:
    here = Pose(2.0, 1.0, 0.3)
    far = Pose(-1.0, 1.0, 0.3)
    twin = here.mirrored()
    told = [
        estimate(here),
        estimate(far),
        estimate(far, Status.SEARCHING),
        estimate(twin),
        estimate(twin, Status.TRACKING, here),
    ]
    found = track_of(drive(np.array([here] * 5)), told)
    assert found.wrong.tolist() == [False, True, False, True, True]
    assert found.unnamed.tolist() == [False, True, False, True, False]
    assert found.found.tolist() == [True, False, False, False, False]
    assert longest(found.wrong) == 2
    assert found.frames_until_found(0.15) is None


def test_a_kidnap_counts_from_the_first_frame_at_the_new_place() -> None:
    old, new = Pose(-2.0, 1.0, 0.0), Pose(2.0, 1.0, 0.0)
    made = replace(drive(np.array([old] * 5 + [new] * 25)), events=[{"kind": "kidnap", "t": 0.55}])
    told = [estimate(old)] * 12 + [estimate(old, Status.SEARCHING)] * 2 + [estimate(new)] * 16
    assert kidnaps_of(made, track_of(made, told)) == [Kidnapped(True, 7, True)]
    assert not counts(old, old.mirrored())
    assert not counts(old, Pose(-1.5, 1.0, 0.3))
    assert counts(old, Pose(-2.0, 1.0, 0.6))


def test_every_fault_is_told_for_every_system(monkeypatch: pytest.MonkeyPatch) -> None:
    here = Pose(2.0, 1.0, 0.3)
    made = drive(np.array([here] * 200))

    def followed(system: str, told: Drive, seed: int) -> Any:
        return track_of(told, [estimate(here)] * len(told.frames))

    monkeypatch.setattr(reliability, "driven", lambda *_: made)
    monkeypatch.setattr(reliability, "followed", followed)
    monkeypatch.setattr(drives, "kidnaps_of", lambda *_: [Kidnapped(True, 0, True)])
    monkeypatch.setattr(reliability, "FAULTS", reliability.FAULTS[-4:])
    monkeypatch.setattr(reliability, "AMID", ())
    monkeypatch.setattr(reliability, "SHOWN", [fault.name for fault in reliability.COMPASS])
    result = reliability.reliability(5)
    assert len(result.rows) == 3 * (4 + 2 + 1)
    assert {row[3].split()[0] for row in result.rows} == {"0.0"}


@pytest.mark.parametrize(
    ("system", "seed", "seconds"),
    [
        pytest.param("iris-fusion", 119, 12.0, id="far lines, moved by a shaking head"),
        pytest.param("iris-fusion", 114, 21.0, id="carried a metre from its twin"),
        pytest.param("nubot-mti", 112, 26.0, id="rivals of the places before"),
    ],
)
def test_a_robot_as_built_that_is_kidnapped_in_play_is_right_within_ten_images(
    system: str, seed: int, seconds: float
) -> None:
    made = driven("match", seed, seconds, *KIDNAPS)
    kidnaps = kidnaps_of(made, followed(system, made, seed))
    assert len(kidnaps) >= 3
    assert all(kidnap.right and kidnap.wrong <= 2 for kidnap in kidnaps)
