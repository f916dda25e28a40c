"""own-humanoids: what is laid into walks, and its table with few and short ones."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from touchline.geometry import wrap_angle
from touchline.systems import RobotSetup
from touchline_lab.experiments import own_humanoids
from touchline_lab.experiments.drives import Drive
from touchline_lab.experiments.injections import FALL_S, carried, drifting, fallen, looking_lower, misjudged
from touchline_lab.experiments.schulz_runs import AS_SIMULATED, dead_reckoned, walk
from touchline_lab.simulation.cameras.perspective import humanoid_camera
from touchline_lab.simulation.observation.features import leaning

FIELD, SECONDS = "indoor-9x6", 12.0


@cache
def walked() -> Drive:
    return walk(FIELD, AS_SIMULATED, 3, SECONDS)


def test_a_drift_turns_the_odometry_alone() -> None:
    drifted = drifting(walked(), 0.01)
    before, after = dead_reckoned(walked()), dead_reckoned(drifted)
    turned = wrap_angle(float(after.poses[-1, 2] - before.poses[-1, 2]))
    assert turned == pytest.approx(0.01 * SECONDS, abs=0.005)
    assert np.array_equal(drifted.truth, walked().truth)


def test_a_fall_hides_everything_and_moves_the_robot_unfelt() -> None:
    down = fallen(walked(), (3.0,), np.random.default_rng(1))
    seen = [len(f.observation.lines) if f.observation is not None else 0 for f in down.frames]
    blind = (down.times_s >= 3.0) & (down.times_s < 3.0 + FALL_S)
    assert not np.array(seen)[blind].any()
    assert np.array(seen)[~blind].any()
    before, after = dead_reckoned(walked()), dead_reckoned(down)
    at = int(np.flatnonzero(blind)[-1])
    assert math.hypot(*(after.poses[at] - before.poses[at])[:2]) == pytest.approx(0.4, abs=0.25)


def test_a_robot_that_was_carried_off_feels_nothing() -> None:
    moved = carried(walked(), 40, 70)
    assert len(moved.frames) == len(walked().frames) - 30
    track = dead_reckoned(moved)
    assert math.hypot(*(track.poses[40] - track.poses[39])[:2]) < 0.05
    assert moved.times_s[40] - moved.times_s[39] == pytest.approx(1.0)


def test_a_lower_camera_moves_near_ground_as_to_first_order() -> None:
    frame = looking_lower(walked(), 1e-3, 1.1).frames[0]
    original = walked().frames[0].observation
    assert frame.observation is not None
    assert original is not None
    expected = leaning(original.usable(), 0.0, 1e-3, 1.1)
    assert frame.observation.lines.ends_m == pytest.approx(expected.lines.ends_m, abs=2e-3)


def test_a_misjudged_camera_shows_what_the_true_one_does_elsewhere() -> None:
    camera = replace(humanoid_camera(), distortion=np.zeros(5), use_attitude=False)
    told = misjudged(replace(walked(), setup=RobotSetup(walked().field, camera)), 0.03, 0.02)
    original, moved = walked().frames[0].observation, told.frames[0].observation
    assert original is not None
    assert moved is not None
    assert told.setup.camera is not None
    pixels = camera.image_from_ground(original.crossings.positions_m)
    assert moved.crossings.positions_m == pytest.approx(told.setup.camera.ground_from_image(pixels), abs=1e-6)


def test_the_table_holds_both_systems(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own_humanoids, "FIELDS", {FIELD: "coloured"})
    monkeypatch.setattr(own_humanoids, "CASES", own_humanoids.CASES[:1])
    monkeypatch.setattr(own_humanoids, "RECORDINGS", ())
    monkeypatch.setattr(own_humanoids, "SECONDS", 8.0)
    monkeypatch.setattr(own_humanoids, "SECONDS_FROM_NOWHERE", 6.0)  # it is believed when it has moved
    monkeypatch.setattr(own_humanoids, "STARTS_FROM_NOWHERE", 1)
    result = own_humanoids.own_humanoids(1)
    assert [row[:3] for row in result.rows] == [
        *(("as built", FIELD, system) for system in (*own_humanoids.SYSTEMS, own_humanoids.WITHOUT)),
        *((robot, FIELD, system) for system in own_humanoids.SYSTEMS for robot in (own_humanoids.STRAIGHT, "ideal")),
    ]
    assert float(result.rows[0][3]) < 5.0
    assert all(float(row[8]) == 0.0 for row in result.rows)
    assert all(0.0 < float(row[9]) < 3.0 for row in result.rows)
    assert "0 of 1 never" in result.notes[1]
