"""What nimbro-lines makes of odd frames: features that are none, silence, a frame from the past."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from test_odd_frames import ODD, is_honest

from touchline.geometry import FloatArray, Pose
from touchline.localizer import Localizer
from touchline.motion import LeanFilter
from touchline.systems import RobotSetup, open_system
from touchline.types import Frame, Observation, Prior, Samples, Status, System
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

SENSORS = ("odometry", "gyro", "compass", "tilt")
NANOSECONDS = 1_000_000_000


@cache
def walk() -> tuple[Simulation, list[Frame]]:
    """8 s on a field with coloured goals and poles, seen as features."""
    run = Simulation(open_scenario("humanoid-walk", 3, 8.0, ["field=indoor-9x6"]), "points")
    return run, [replace(frame, observation=run.features(i)) for i, frame in enumerate(run)]


def truth(index: int) -> Pose:
    return Pose(*walk()[0].truth.poses[index].tolist())


def at_the_start() -> System:
    made = open_system("nimbro-lines", RobotSetup(walk()[0].field))
    made.reset(Prior(truth(0)))
    return made


def spoiled(seen: Observation, position_m: float) -> Observation:
    """Every third feature of each kind lies elsewhere; of lines one end."""

    def moved(places: FloatArray) -> FloatArray:
        places = places.copy()
        places[::3] = position_m * np.array([0.6, -0.8])
        return places

    ends_m = seen.lines.ends_m.copy()
    ends_m[:, 1] = moved(ends_m[:, 1])
    return replace(
        seen,
        lines=replace(seen.lines, ends_m=ends_m),
        crossings=replace(seen.crossings, positions_m=moved(seen.crossings.positions_m)),
        landmarks=replace(seen.landmarks, positions_m=moved(seen.landmarks.positions_m)),
    )


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("position_m", [30.0, 1e6, 1e150, 1e300, np.nan, np.inf])
def test_features_farther_than_the_field_or_without_a_place_are_none(position_m: float) -> None:
    system = at_the_start()
    for index, frame in enumerate(walk()[1]):
        assert frame.observation is not None
        estimate = system.step(replace(frame, observation=spoiled(frame.observation, position_m)))
        assert estimate.observation is not None
        assert len(estimate.observation.lines) == len(frame.observation.lines) * 2 // 3
        assert np.isfinite([*estimate.pose, *estimate.covariance.ravel()]).all()
        assert estimate.pose.distance_to(truth(index)) < 0.3
    assert estimate.status is Status.TRACKING


def test_the_live_loop_names_the_features_that_it_leaves_out() -> None:
    localizer = Localizer(walk()[0].field, system="nimbro-lines")
    for frame in walk()[1]:
        seen = frame.observation
        assert seen is not None
        if all(map(len, (seen.lines, seen.crossings, seen.landmarks))):
            estimate = localizer.localize(frame.stamp_ns, observation=spoiled(seen, np.nan))
            for kind in ("line", "crossing", "landmark"):
                assert any(f"a {kind} that is no measurement" in str(problem) for problem in estimate.problems)
            return
    pytest.fail("no frame shows a feature of each kind")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
@pytest.mark.parametrize("ahead_s", [0, 3600, -3600])
def test_a_second_of_sensors_without_sense_costs_the_robot_nothing(value: float, ahead_s: int) -> None:
    system = at_the_start()
    for index, frame in enumerate(walk()[1][:60]):
        if 20 <= index < 30:
            frame = replace(frame, **{key: senseless(getattr(frame, key), value, ahead_s) for key in SENSORS})
        estimate = system.step(frame)
        assert np.isfinite([*estimate.pose, *estimate.covariance.ravel()]).all()
        assert is_honest(estimate, truth(index))
    assert estimate.status is Status.TRACKING
    assert estimate.pose.distance_to(truth(index)) < 0.1


def senseless(samples: Samples | None, value: float, ahead_s: int) -> Samples | None:
    if samples is None:
        return None
    return Samples(samples.stamp_ns + ahead_s * NANOSECONDS, np.full_like(samples.values, value))


@pytest.mark.parametrize("what", [name for name in ODD if name != "no numbers"])
def test_every_second_frame_may_show_nothing(what: str) -> None:
    system = at_the_start()
    for index, frame in enumerate(walk()[1]):
        estimate = system.step(ODD[what](frame) if index % 2 else frame)
        assert np.isfinite([*estimate.pose, *estimate.covariance.ravel()]).all()
        assert estimate.pose.distance_to(truth(index)) < 0.3
    assert estimate.status is Status.TRACKING


def test_a_frame_from_the_past_is_refused_and_changes_nothing() -> None:
    plain, disturbed = at_the_start(), at_the_start()
    frames = walk()[1]
    for index, frame in enumerate(frames[:40]):
        if index == 30:
            with pytest.raises(ValueError, match="forward in time"):
                disturbed.step(frames[20])
        assert disturbed.step(frame).pose == plain.step(frame).pose


@pytest.mark.parametrize("silent", [20, 50])
def test_a_robot_that_walks_on_in_silence_is_not_taken_to_be_where_it_was(silent: int) -> None:
    system = at_the_start()
    frames = walk()[1]
    for frame in frames[:20]:
        system.step(frame)
    for index in range(20 + silent, min(40 + silent, len(frames))):
        assert is_honest(system.step(frames[index]), truth(index))


@pytest.mark.parametrize("sensor", ["gyro", "tilt"])
@pytest.mark.parametrize("value", [np.nan, 1e300, 0.3])
def test_a_sample_of_another_clock_costs_the_lean_nothing(sensor: str, value: float) -> None:
    plain, disturbed = LeanFilter(), LeanFilter()
    for index, frame in enumerate(walk()[1][:30]):
        plain.add(frame)
        disturbed.add(frame)
        if index == 10:
            for ahead_s in (-3600, 0.5, 3600):
                stamps_ns = np.array([frame.stamp_ns + round(ahead_s * NANOSECONDS)])
                odd = Samples(stamps_ns, np.full((1, 3 if sensor == "gyro" else 2), value))
                disturbed.add(replace(Frame(frame.stamp_ns), **{sensor: odd}))
        assert disturbed.lean(frame.stamp_ns) == plain.lean(frame.stamp_ns)
        assert index == 0 or plain.lean(frame.stamp_ns) is not None
