"""touchline through either kind of camera: all that is seen counts, and every setting has an effect."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from drives import Drive, open_drive

from touchline.config import settings_rows
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.systems import RobotSetup, open_system
from touchline.systems.touchline import TouchlineSettings
from touchline.types import (
    Estimate,
    Frame,
    LinePoints,
    Observation,
    Prior,
    Samples,
)

WHITE = "humanoid-kid-9x6"
HEIGHT_M = 1.1


# --- a compass --------------------------------------------------------------------------------------------------------


@cache
def walk(seconds: float = 10.0) -> tuple[FloatArray, tuple[Frame, ...]]:
    """True poses and frames of a walk, with features instead of images and a compass."""
    drive = open_drive("walk-kid")
    truth, count, frames = drive.truth, round(8.0 * seconds), []
    for i, each in enumerate(drive.frames[:count]):
        compass = Samples(np.array([each.stamp_ns - 10_000_000]), truth[i : i + 1, 2:] + 0.05 * math.sin(3.0 * i))
        frames.append(replace(each, compass=compass))
    return truth[:count], tuple(frames)


# --- odometry ---------------------------------------------------------------------------------------------------------


def drive() -> Drive:
    """Of a mirror robot, with line points instead of images."""
    return open_drive("tracks")


def with_odometry(each: Frame, change: Callable[[FloatArray], FloatArray]) -> Frame:
    """A frame whose odometry's poses (N, 3) are others."""
    way = each.odometry
    return each if way is None else replace(each, odometry=replace(way, values=change(way.values)))


# --- settings ---------------------------------------------------------------------------------------------------------

# of each setting another value, with either camera, that has an effect on a rough ride
OTHERS: dict[str, Any] = {
    "min_points": 60,
    "min_explained": 0.97,
    "min_probability": 0.999999,
    "blind_frames": {"mirror": 1, "perspective": 60},
    "search_every": 1,
    "search_ms": 0.001,
    "compass": False,
    "compass_sigma_rad": 0.02,
    "gate": {"mirror": 1.0, "perspective": 1e9},
    "start_position_m": 0.05,
    "start_heading_rad": 0.02,
    "self_calibration": False,
    "odometry.forward_scale": 0.2,
    "odometry.sideways_scale": 0.2,
    "odometry.turn_scale": 0.2,
    "compass_track.lag_s": 0.3,
}


SHOVES_M = {"mirror": 0.15, "perspective": 0.25}  # such that the gate decides whether one is tried
SWING_RAD, SWING_RAD_S = 0.9, 2.0  # of the compass about the heading, and of the gyro with it


def sector(seen: Observation | None, half_rad: float) -> Observation | None:
    """What lies ahead alone, of line points and lines; crossings and landmarks left out."""
    if seen is None:
        return None
    points = seen.points
    kept = np.abs(np.arctan2(points.positions_m[:, 1], points.positions_m[:, 0])) < half_rad
    few = (column[kept] for column in (points.positions_m, points.covariances_m2, points.confidences, points.pixels))
    return Observation(seen.stamp_ns, LinePoints(*few), lines=seen.lines)


def shoved(each: Frame, time_s: float, shove_m: float) -> Frame:
    """A frame by whose odometry the robot was shoved at 1.5 s and at 2 s and carried away at 6 s: that alone jumps."""
    first, second = np.array([shove_m, 0.8 * shove_m, 0.1]), np.array([0.2, 0.1, 0.1])
    by = (time_s >= 1.5) * first + (time_s >= 2.0) * second + (time_s >= 6.0) * np.array([1.2, 0.9, 0.7])
    return with_odometry(each, lambda poses: poses + by)


def swung(each: Frame, time_s: float) -> Frame:
    """A frame whose compass swings about the heading."""
    compass, gyro = each.compass, each.gyro
    if compass is not None:
        off_rad = SWING_RAD * math.sin(SWING_RAD_S * time_s)
        compass = replace(compass, values=compass.values + off_rad)
    if gyro is not None:
        rate_rad_s = SWING_RAD * SWING_RAD_S * math.cos(SWING_RAD_S * time_s)
        gyro = replace(gyro, values=gyro.values + np.array([0.0, 0.0, rate_rad_s]))
    return replace(each, compass=compass, gyro=gyro)


def rough(frames: Sequence[Frame], times_s: FloatArray, shove_m: float) -> list[Frame]:
    """A ride with shoves at 1.5 and 2 s, a compass that swings, 6 s without anything to see, in which the robot is
    carried away, and a narrow view now and then.
    """
    found = []
    for each, time_s in zip(frames, (times_s - times_s[0]).tolist(), strict=True):
        now = swung(shoved(each, time_s, shove_m), time_s)
        if 3.0 < time_s < 9.0:
            now = replace(now, observation=Observation(now.stamp_ns))
        elif time_s > 2.4 or 1.0 < time_s < 1.8:
            now = replace(now, observation=sector(now.observation, 0.6))
        found.append(now)
    return found


FIRST_NARROW = {"mirror": 0, "perspective": 10}


def narrow(frames: Sequence[Frame], first: int) -> list[Frame]:
    """A narrow view, for 4 s, that shows several places alike. first: image."""
    return [replace(each, observation=sector(each.observation, 0.6)) for each in frames[first : first + 40]]


def fingerprint(estimates: Sequence[Estimate]) -> list[Any]:
    """All that a user gets."""
    return [
        (e.pose, e.status, e.probability, e.covariance.tolist(), [(h.pose, h.probability) for h in e.hypotheses])
        for e in estimates
    ]


@cache
def ridden(kind: str, key: str | None) -> list[Any]:
    """A rough ride through a camera, with one setting changed, or none."""
    if kind == "mirror":
        ride = drive()
        setup, truth, plain = ride.setup, ride.truth, ride.frames
    else:
        setup = RobotSetup(open_field(WHITE), height_m=HEIGHT_M)
        truth, plain = walk(12.0)
    frames = rough(plain, np.array([1e-9 * each.stamp_ns for each in plain]), SHOVES_M[kind])
    settings: dict[str, Any] = {"compass": True}
    if key is not None:
        settings[key] = OTHERS[key][kind] if isinstance(OTHERS[key], dict) else OTHERS[key]
    system = open_system("touchline", setup, settings)
    x, y, heading = truth[0].tolist()
    found = []
    for prior, seen in (
        (Prior(Pose(x + 0.1, y - 0.1, heading + 0.05)), frames),
        (None, narrow(plain, FIRST_NARROW[kind])),
    ):
        system.reset(prior)
        found += [system.step(each) for each in seen]
    return fingerprint(found)


@pytest.mark.parametrize("kind", ["mirror", "perspective"])
@pytest.mark.parametrize("key", [key for key, *_ in settings_rows(TouchlineSettings)])
def test_every_setting_has_an_effect_with_either_camera(kind: str, key: str) -> None:
    assert ridden(kind, key) != ridden(kind, None)
