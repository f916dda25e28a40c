"""Lines, crossings and posts at the observation level."""

from __future__ import annotations

import math

import numpy as np

from touchline.field import open_field
from touchline.geometry import Pose, wrap_angle
from touchline.types import CrossingKind, LandmarkKind
from touchline_lab.simulation.observation.feature_noise import FeatureNoise, LandmarkNoise
from touchline_lab.simulation.observation.features import ObservedFeatures
from touchline_lab.simulation.observation.observed_lines import leaning_view

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
