"""touchline through either kind of camera: all that is seen counts, and every setting has an effect."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from touchline.config import settings_rows
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose
from touchline.systems import RobotSetup, open_system
from touchline.systems.touchline import TouchlineSettings
from touchline.types import (
    Crossings,
    Estimate,
    Frame,
    LandmarkKind,
    Landmarks,
    LinePoints,
    Observation,
    Prior,
    Samples,
    Status,
)
from touchline_lab.experiments.drives import Drive, driven
from touchline_lab.experiments.scenes import the_camera
from touchline_lab.points.point_set import polar_covariances
from touchline_lab.simulation.observation.feature_noise import PINHOLE_FEATURES
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

COLOURED, WHITE = "indoor-9x6", "humanoid-kid-9x6"
HEIGHT_M = PINHOLE_FEATURES.height_m
SIGMAS = (0.02, 0.01, 0.0087)  # of points: ranges at 0 m and per metre, bearings


def line_points(pose: Pose, field: FieldModel, seed: int, reach_m: float = 4.0) -> LinePoints:
    """Noisy line points within reach of a pose."""
    rng = np.random.default_rng(seed)
    exact = pose.inverse().transform(np.vstack(field.polylines(0.25)))
    exact = exact[np.hypot(*exact.T) < reach_m]
    return as_points(exact + 0.02 * rng.standard_normal(exact.shape))


def as_points(positions_m: FloatArray) -> LinePoints:
    n = len(positions_m)
    return LinePoints(positions_m, polar_covariances(positions_m, SIGMAS), np.ones(n), np.full((n, 2), np.nan))


def posts(pose: Pose, field: FieldModel, coloured: bool) -> Landmarks:
    """The feet of goal posts and poles within 6 m."""
    found = [(post, pose.inverse().transform(np.array([[post.x, post.y]]))[0]) for post in field.posts]
    found = [(post, at) for post, at in found if np.hypot(*at) < 6.0]
    n = len(found)
    return Landmarks(
        np.array([LandmarkKind.POLE.value if "pole" in post.kind else LandmarkKind.POST.value for post, _ in found]),
        np.array([at for _, at in found]),
        np.tile(0.03**2 * np.eye(2), (n, 1, 1)),
        np.full(n, 0.95),
        tuple(post.colors_from_ground if coloured else () for post, _ in found),
        np.full((n, 2), np.nan),
    )


def frame(k: int, observation: Observation, compass_rad: float | None = None) -> Frame:
    """The k-th of a robot that stands, ten a second."""
    stamp_ns = 100_000_000 * (k + 1)
    stamps = np.array([stamp_ns - 20_000_000, stamp_ns])
    compass = None if compass_rad is None else Samples(stamps, np.full((2, 1), compass_rad))
    still = Samples(stamps, np.zeros((2, 3)))
    return Frame(stamp_ns, observation=replace(observation, stamp_ns=stamp_ns), odometry=still, compass=compass)


def stepped(setup: RobotSetup, prior: Prior | None, seen: Sequence[Observation]) -> list[Estimate]:
    system = open_system("touchline", setup)
    system.reset(prior)
    return [system.step(frame(k, one)) for k, one in enumerate(seen)]


# --- a mirror with features -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("camera", ["none told", "mirror"])
@pytest.mark.parametrize("start", ["nowhere", "the twin"])
def test_colours_of_posts_tell_the_ends_apart_with_a_mirror(camera: str, start: str) -> None:
    field, truth = open_field(COLOURED), Pose(2.2, 0.6, 0.4)
    setup = RobotSetup(field, the_camera() if camera == "mirror" else None)
    prior = Prior(truth.mirrored()) if start == "the twin" else None

    def seen(coloured: bool) -> list[Observation]:
        points = [line_points(truth, field, k) for k in range(12)]
        return [Observation(0, each, landmarks=posts(truth, field, coloured)) for each in points]

    told, untold = (stepped(setup, prior, seen(coloured))[-1] for coloured in (True, False))
    assert told.pose.distance_to(truth) < 0.05
    assert told.status is Status.TRACKING or told.reason == "not yet confirmed by motion"
    assert (told.twin_probability or 0.0) < 1e-3
    assert min(untold.pose.distance_to(truth), untold.pose.distance_to(truth.mirrored())) < 0.05
    assert untold.pose.distance_to(truth.mirrored()) < 0.05 or prior is None
    assert 0.005 < 1.0 - (untold.probability or 0.0) < 0.51


@pytest.mark.parametrize("height_m", [None, HEIGHT_M])
def test_a_crossing_fixes_a_pose_that_a_lone_line_leaves_open(height_m: float | None) -> None:
    """The side line, and where the halfway line meets it, through a mirror and through a perspective camera."""
    field = open_field("msl-18x12")
    tee = next(c for c in field.crossings if c.kind == "T" and abs(c.x) < 0.1 and c.y > 0.0)
    truth = Pose(-1.2, tee.y - 1.8, 0.3)
    along = np.column_stack((np.linspace(-3.0, 1.5, 50), np.full(50, tee.y)))
    start = Pose(truth.x + 0.2, truth.y + 0.1, truth.heading - 0.05)

    def seen(k: int, crossing: bool) -> Observation:
        rng = np.random.default_rng(k)
        points = truth.inverse().transform(along) + 0.015 * rng.standard_normal(along.shape)
        at = truth.inverse().transform(np.array([[tee.x, tee.y]])) + 0.02 * rng.standard_normal((1, 2))
        crossings = Crossings(
            np.array(["T"]), at, np.array([tee.orientation_rad - truth.heading]), 0.03**2 * np.eye(2)[np.newaxis],
            np.array([0.9]), np.full((1, 2), np.nan),
        )  # fmt: skip
        return Observation(0, as_points(points), crossings=crossings) if crossing else Observation(0, as_points(points))

    setup, prior = RobotSetup(field, height_m=height_m), Prior(start, covariance=np.diag([0.3, 0.3, 0.1]) ** 2)
    alone, fixed = (stepped(setup, prior, [seen(k, each) for k in range(15)])[-1] for each in (False, True))
    assert alone.covariance[0, 0] > 0.2**2
    assert fixed.covariance[0, 0] < 0.11**2
    assert abs(alone.pose.x - truth.x) > 0.15
    assert abs(fixed.pose.x - truth.x) < 0.1
    assert abs(fixed.pose.y - truth.y) < 0.15


# --- a compass --------------------------------------------------------------------------------------------------------


@cache
def walk(field: str, seconds: float = 10.0) -> tuple[FloatArray, tuple[Frame, ...]]:
    """True poses and frames of a walk, with features instead of images and a compass."""
    run = Simulation(open_scenario("humanoid-walk", 3, seconds, [f"field={field}"]), "points")
    truth = np.array(run.truth.poses)
    frames = []
    for i, each in enumerate(run):
        compass = Samples(np.array([each.stamp_ns - 10_000_000]), truth[i : i + 1, 2:] + 0.05 * math.sin(3.0 * i))
        frames.append(replace(each, observation=run.features(i), compass=compass))
    return truth, tuple(frames)


def walked(settings: dict[str, Any], frames: Sequence[Frame], prior: Prior | None = None) -> list[Estimate]:
    system = open_system("touchline", RobotSetup(open_field(WHITE), height_m=HEIGHT_M), settings)
    system.reset(prior)
    return [system.step(each) for each in frames]


def test_a_perspective_camera_uses_the_compass_where_it_is_named_alone() -> None:
    truth, frames = walk(WHITE)
    without = [replace(each, compass=None) for each in frames]
    for settings in ({}, {"compass": False}):
        for one, other in zip(walked(settings, frames), walked({}, without), strict=True):
            assert (one.pose, one.probability) == (other.pose, other.probability)
    last = walked({"compass": True}, frames)[-1]
    assert last.pose.distance_to(Pose(*truth[-1].tolist())) < 0.1
    assert (last.twin_probability or 0.0) < 0.03
    turned = [replace(each, compass=replace_values(each.compass, math.pi)) for each in frames]
    last = walked({"compass": True}, turned)[-1]
    assert last.pose.distance_to(Pose(*truth[-1].tolist()).mirrored()) < 0.1


def replace_values(samples: Samples | None, more: float) -> Samples | None:
    return None if samples is None else replace(samples, values=samples.values + more)


def test_a_mirror_uses_the_compass_unless_it_is_told_not_to() -> None:
    field, truth = open_field("msl-18x12"), Pose(-4.0, 2.0, 2.0)
    seen = [frame(k, Observation(0, line_points(truth, field, k)), truth.heading) for k in range(5)]

    def last(settings: dict[str, Any]) -> Estimate:
        system = open_system("touchline", RobotSetup(field), settings)
        return [system.step(each) for each in seen][-1]

    assert last({}).pose.distance_to(truth) < 0.1
    assert (last({}).twin_probability or 0.0) < 0.03
    assert last({"compass": False}).twin_probability == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(("view_rad", "is_perspective"), [(0.9, True), (math.pi, False)])
def test_a_camera_that_nobody_described_is_a_perspective_one_if_it_sees_a_sector(
    view_rad: float, is_perspective: bool
) -> None:
    field, truth = open_field(WHITE), Pose(-1.0, 0.5, 3.0)
    points = line_points(truth, field, 1)
    seen = points.rows(np.abs(np.arctan2(*points.positions_m.T[::-1])) < view_rad)
    system = open_system("touchline", RobotSetup(field))
    system.reset(Prior(truth))
    assert system.step(frame(0, Observation(0, seen))).pose.distance_to(truth) < 0.3
    assert system.setup.walks is is_perspective


# --- odometry ---------------------------------------------------------------------------------------------------------


def drive(seconds: float = 6.0) -> Drive:
    """Of a mirror robot, with line points instead of images."""
    return driven("straight-tracks", 3, seconds, "camera.known_from=design")


def with_odometry(each: Frame, change: Callable[[FloatArray], FloatArray]) -> Frame:
    """A frame whose odometry's poses (N, 3) are others."""
    way = each.odometry
    return each if way is None else replace(each, odometry=replace(way, values=change(way.values)))


def scaled(frames: Sequence[Frame], scale: float) -> list[Frame]:
    """Frames whose odometry counts so much of every way."""
    return [with_odometry(each, lambda poses: poses * np.array([scale, scale, 1.0])) for each in frames]


def test_the_odometry_s_scales_are_learned_and_reported_through_both_cameras() -> None:
    ride = drive()
    system = open_system("touchline", ride.setup)
    system.reset(Prior(Pose(*ride.truth[0].tolist())))
    for each in scaled(ride.frames, 0.96):
        estimate = system.step(each)
    assert estimate.odometry is not None
    assert max(estimate.odometry.errors[:2]) == pytest.approx(0.04, abs=0.02)
    truth, frames = walk(WHITE)
    for each in walked({}, scaled(frames, 0.9), Prior(Pose(*truth[0].tolist()))):
        assert each.odometry is not None
    assert 0.03 < each.odometry.errors[0] < 0.15
    assert 0.0 < each.odometry.deviations[0] < 0.05


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
    "compass_sigma_rad": 1.0,
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
        ride = drive(12.0)
        setup, truth, plain = ride.setup, ride.truth, ride.frames
    else:
        setup = RobotSetup(open_field(WHITE), height_m=HEIGHT_M)
        truth, plain = walk(WHITE, 12.0)
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


def test_a_robot_with_a_perspective_camera_may_look_away_as_long_as_it_is_told_to() -> None:
    """Without anything to see for 5 s: in doubt after 4 s, or after so many images."""
    truth, frames = walk(WHITE)
    prior = Prior(Pose(*truth[0].tolist()))
    blind = [replace(each, observation=Observation(each.stamp_ns)) for each in frames[8:48]]
    found = {images: walked({"blind_frames": images}, [*frames[:8], *blind], prior)[-1] for images in (2, 30, 60)}
    assert [found[images].status is Status.TRACKING for images in (2, 30, 60)] == [False, False, True]


def test_a_lone_mark_that_the_pose_does_not_explain_says_nothing_and_two_do() -> None:
    """A robot that looks away, and takes something for a penalty mark, ten times."""
    truth, frames = walk(WHITE)

    def after(images: int, *places_m: tuple[float, float]) -> Status:
        count, none = len(places_m), np.full((len(places_m), 2), np.nan)
        kinds = np.full(count, LandmarkKind.PENALTY_MARK, dtype=object)
        spread = np.tile(0.03**2 * np.eye(2), (count, 1, 1))
        marks = Landmarks(kinds, np.array(places_m), spread, np.ones(count), ((),) * count, none)
        last = [replace(f, observation=Observation(f.stamp_ns, landmarks=marks)) for f in frames[20 : 20 + images]]
        return walked({}, [*frames[:20], *last], Prior(Pose(*truth[0].tolist())))[-1].status

    assert after(10, (0.7, 0.9)) is Status.TRACKING
    assert after(1, (0.7, 0.9), (1.1, -0.4)) is not Status.TRACKING


@pytest.mark.parametrize("kind", ["mirror", "perspective"])
@pytest.mark.parametrize("key", [key for key, *_ in settings_rows(TouchlineSettings)])
def test_every_setting_has_an_effect_with_either_camera(kind: str, key: str) -> None:
    assert ridden(kind, key) != ridden(kind, None)
