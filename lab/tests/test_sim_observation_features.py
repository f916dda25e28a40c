"""Lines, crossings and posts at the observation level."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from touchline.camera import GroundView, PinholeCamera
from touchline.camera import leaning as leaning_camera
from touchline.field import FieldModel, open_field
from touchline.geometry import Pose, wrap_angle
from touchline.perception.line_graph import LineGraphDetector, LineGraphSettings
from touchline.types import CrossingKind, LandmarkKind, Observation
from touchline_lab.simulation.observation.feature_noise import PINHOLE_FEATURES, FeatureNoise, LandmarkNoise
from touchline_lab.simulation.observation.features import ObservedFeatures
from touchline_lab.simulation.observation.observed_lines import leaning_view
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

_ALL = LandmarkNoise(found_ratio=1.0, outwards_px=0.0, across_px=0.0)
SILENT = FeatureNoise(
    outwards_px=0.0, across_px=0.0, orientation_deg=0.0, found_ratio=1.0, found_half_m=99.0, line_ratio=1.0,
    line_px=0.0, line_end_m=0.0, posts=_ALL, white_posts=_ALL, poles=_ALL, wrong_kind_ratio=0.0, farthest_m=5.5,
)  # fmt: skip
POSE = Pose(-2.0, 0.8, 0.6)


def observer(noise: FeatureNoise = SILENT, view_rad: float = math.pi) -> ObservedFeatures:
    return ObservedFeatures(leaning_view(0.8, 190.0, 9.0), open_field("indoor-9x6"), noise, view_rad)


def test_without_noise_each_crossing_is_one_of_the_field_with_its_kind_and_orientation() -> None:
    seen = observer().observe(POSE, np.random.default_rng(0)).crossings
    assert len(seen) > 5
    for kind, position_m, orientation_rad in zip(seen.kinds, seen.positions_m, seen.orientations_rad, strict=True):
        x, y = POSE.transform(position_m)
        twin = min(observer().field.crossings, key=lambda c: math.hypot(c.x - x, c.y - y))
        assert math.hypot(twin.x - x, twin.y - y) < 1e-4
        assert kind == twin.kind
        turn = wrap_angle(orientation_rad + POSE.heading - twin.orientation_rad)
        quarter = turn % (math.pi / 2) if twin.kind is CrossingKind.X else turn
        assert min(abs(quarter), abs(quarter - math.pi / 2)) < 1e-9


def test_all_within_reach_is_seen_and_nothing_beyond() -> None:
    features = observer().observe(POSE, np.random.default_rng(0))
    ranges = [math.hypot(c.x - POSE.x, c.y - POSE.y) for c in observer().field.crossings]
    assert len(features.crossings) == sum(0.4 < r <= 5.5 for r in ranges)
    assert np.hypot(*features.crossings.positions_m.T).max() <= 5.5 + 1e-6
    assert set(features.landmarks.kinds) == {LandmarkKind.POST, LandmarkKind.POLE, LandmarkKind.GOAL}
    assert set(features.landmarks.colors) >= {("yellow",), ("yellow", "blue", "yellow")}


def test_lines_are_the_visible_part_of_the_fields_lines() -> None:
    lines = observer().observe(POSE, np.random.default_rng(0)).lines
    assert len(lines) == 5  # the goal area is too far away or too short
    for start, end in lines.ends_m:
        steps = np.linspace(start, end, 20)
        assert np.all(observer().field.line_distances(POSE.transform(steps)) < 1e-3)
        assert math.hypot(*(end - start)) >= 0.6


def test_what_stands_behind_a_robot_or_in_a_black_sector_is_not_seen() -> None:
    free = observer().observe(POSE, np.random.default_rng(0))
    target = free.crossings.positions_m[0]
    body = np.array([(*POSE.transform(0.6 * target), 0.26, 0.8)])
    blocked = observer().observe(POSE, np.random.default_rng(0), body)
    assert not any(np.allclose(position, target) for position in blocked.crossings.positions_m)
    assert len(blocked.crossings) < len(free.crossings)
    bearing = math.atan2(target[1], target[0])
    black = observer().observe(POSE, np.random.default_rng(0), black_rad=np.array([[bearing - 0.1, bearing + 0.1]]))
    assert not any(np.allclose(position, target) for position in black.crossings.positions_m)
    ahead = observer(view_rad=0.5).observe(POSE, np.random.default_rng(0))
    assert all(abs(math.atan2(y, x)) <= 0.5 + 1e-6 for x, y in ahead.crossings.positions_m)


def test_errors_are_as_large_as_their_covariances_say() -> None:
    noisy = observer(SILENT.model_copy(update={"outwards_px": 0.8, "across_px": 0.5, "tail": 0.5}))
    exact = observer().observe(POSE, np.random.default_rng(0)).crossings
    squares = []
    for seed in range(150):
        seen = noisy.observe(POSE, np.random.default_rng(seed)).crossings
        for error, covariance in zip(seen.positions_m - exact.positions_m, seen.covariances_m2, strict=True):
            squares.append(error @ np.linalg.solve(covariance, error))
    assert np.mean(squares) == pytest.approx(2.0, rel=0.1)


def test_errors_are_larger_across_than_outwards_and_have_heavy_tails() -> None:
    noisy, exact = observer(FeatureNoise(farthest_m=5.5)), observer().observe(POSE, np.random.default_rng(0)).crossings
    every = exact.positions_m
    errors = []
    for seed in range(300):
        for position in noisy.observe(POSE, np.random.default_rng(seed)).crossings.positions_m:
            truth = every[np.argmin(np.hypot(*(every - position).T))]
            ends = noisy.camera.image_from_ground(np.array([truth, position]))
            out = (ends[0] - noisy.camera.center) / math.hypot(*(ends[0] - noisy.camera.center))
            errors.append(((ends[1] - ends[0]) @ out, (ends[1] - ends[0]) @ (-out[1], out[0])))
    outwards, across = (np.diff(np.percentile(e, (15.87, 84.13)))[0] / 2.0 for e in np.array(errors).T)
    assert outwards == pytest.approx(0.137 * math.sinh(1.4) / 1.4, rel=0.12)
    assert across == pytest.approx(0.283 * math.sinh(1.4) / 1.4, rel=0.12)


def test_a_lean_moves_all_features_of_an_image_together_and_their_covariances_know_it() -> None:
    leaning = observer(SILENT.model_copy(update={"lean_deg": 0.25, "height_m": 1.1}))
    exact = observer().observe(POSE, np.random.default_rng(0))
    squares, sides = [], []
    for seed in range(200):
        seen = leaning.observe(POSE, np.random.default_rng(seed))
        errors = seen.crossings.positions_m - exact.crossings.positions_m
        for error, covariance in zip(errors, seen.crossings.covariances_m2, strict=True):
            squares.append(error @ np.linalg.solve(covariance, error))
        feet = seen.landmarks.positions_m - exact.landmarks.positions_m
        ahead = np.concatenate((errors[:, 0], feet[:, 0]))
        sides.append(abs(np.mean(np.sign(ahead))))
    assert np.mean(squares) == pytest.approx(2.0, rel=0.15)
    assert np.mean(sides) > 0.5


def test_fewer_crossings_are_found_far_away() -> None:
    far = observer(SILENT.model_copy(update={"found_half_m": 3.0, "found_slope_m": 0.3}))
    seen = [far.observe(POSE, np.random.default_rng(seed)).crossings for seed in range(100)]
    ranges = np.concatenate([np.hypot(*crossings.positions_m.T) for crossings in seen])
    every = np.hypot(*observer().observe(POSE, np.random.default_rng(0)).crossings.positions_m.T)
    assert np.sum(ranges < 2.4) == pytest.approx(100 * np.sum(every < 2.4), rel=0.1)
    assert np.sum(ranges > 4.0) < 5 * np.sum(every > 4.0)


def test_misses_and_wrong_kinds_come_as_often_as_documented() -> None:
    noise = SILENT.model_copy(update={"found_ratio": 0.7, "wrong_kind_ratio": 0.2})
    every = len(observer().observe(POSE, np.random.default_rng(0)).crossings)
    kinds = {(round(c.x, 3), round(c.y, 3)): c.kind for c in observer().field.crossings}
    found, wrong = 0, 0
    for seed in range(200):
        seen = observer(noise).observe(POSE, np.random.default_rng(seed)).crossings
        for kind, (x, y) in zip(seen.kinds, POSE.transform(seen.positions_m), strict=True):
            twin = min(kinds, key=lambda place: math.hypot(place[0] - x, place[1] - y))
            found, wrong = found + 1, wrong + (kinds[twin] != kind)
    assert found / (200 * every) == pytest.approx(0.7, abs=0.04)
    assert wrong / found == pytest.approx(0.2, abs=0.04)


def test_a_run_gives_the_same_features_for_a_frame_and_none_when_covered() -> None:
    simulation = Simulation(open_scenario("kidnap", seconds=3.0, changes=["ideal=true"]), "points")
    one, same = simulation.features(3), simulation.features(3)
    np.testing.assert_array_equal(one.crossings.positions_m, same.crossings.positions_m)
    assert len(simulation.features(18).crossings) == 0
    assert len(Simulation(open_scenario("humanoid-walk", seconds=2.0), "points").features(5).lines) > 0


class Seen(NamedTuple):
    """One image's features, and by whom they were seen from where."""

    features: Observation
    camera: PinholeCamera
    pose: Pose
    field: FieldModel


def _rendered_and_observed(name: str) -> tuple[list[Seen], list[Seen]]:
    """What the line graph finds in some images of a walk, and what the observation level makes of them, five times."""
    simulation = Simulation(open_scenario("humanoid-walk", 3, 60.0, [f"field={name}"]))
    camera, field = simulation.camera, simulation.field
    assert isinstance(camera, PinholeCamera)
    detector = LineGraphDetector(camera, LineGraphSettings(), field)
    rendered, observed = [], []
    for index in range(10, len(simulation), 45):
        time_s = float(simulation.image_times_s[index])
        pose, (roll, pitch) = simulation.track.pose_at(time_s), simulation.track.attitude_at(time_s)
        built = replace(camera, base_from_camera=leaning_camera(camera, float(roll), float(pitch)))
        rendered.append(Seen(detector.detect(simulation.image(index), GroundView(built)), built, pose, field))
        features = ObservedFeatures(built, field, PINHOLE_FEATURES.model_copy(update={"lean_deg": 0.0}))
        for seed in range(5):
            rng = np.random.default_rng([seed, index])
            observed.append(Seen(features.observe(pose, rng, simulation._bodies(time_s)), built, pose, field))
    return rendered, observed


def _figures(images: list[Seen]) -> dict[str, float]:
    """How many features an image shows, and the medians of their errors (px)."""
    counts = {"crossings": 0, "lines": 0, "landmarks": 0}
    errors: dict[str, list[float]] = {"crossings": [], "posts and poles": []}
    for seen, camera, pose, field in images:
        counts["crossings"] += len(seen.crossings)
        counts["lines"] += len(seen.lines)
        counts["landmarks"] += len(seen.landmarks)
        upright = np.isin(seen.landmarks.kinds, [LandmarkKind.POST, LandmarkKind.POLE])
        for kind, found, there in (
            ("crossings", seen.crossings.positions_m, field.crossings),
            ("posts and poles", seen.landmarks.positions_m[upright], field.posts),
        ):
            places = pose.inverse().transform(np.array([(one.x, one.y) for one in there]))
            pixels = camera.image_from_ground(places)
            errors[kind] += [np.nanmin(np.hypot(*(pixels - p).T)) for p in camera.image_from_ground(found)]
    per_image = {f"{kind} per image": count / len(images) for kind, count in counts.items()}
    return per_image | {f"error of {kind} (px)": float(np.median(values)) for kind, values in errors.items()}


def test_features_are_those_that_the_line_graph_finds_in_rendered_images() -> None:
    pairs = [_rendered_and_observed(name) for name in ("indoor-9x6", "humanoid-kid-9x6")]
    rendered, observed = (_figures([image for pair in pairs for image in pair[k]]) for k in (0, 1))
    assert observed == pytest.approx(rendered, rel=0.2)
