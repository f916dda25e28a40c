"""The parts of nimbro-lines; what the whole does its replays tell."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from touchline.config import load_settings
from touchline.field import open_field
from touchline.field.association import FieldAssociations
from touchline.geometry import Pose, wrap_angle
from touchline.localization.registration.feature_model import FeatureModel, field_lines
from touchline.localization.registration.features import Features, FeatureSettings
from touchline.localization.search.feature_poses import PoseProposals
from touchline.published.nimbro_lines.feature_belief import Agreement
from touchline.published.nimbro_lines.field_ends import FieldEnds
from touchline.published.nimbro_lines.system import NimbroLines, NimbroLinesSettings
from touchline.systems import RobotSetup, open_system
from touchline.types import CrossingKind, Crossings, Frame, Landmarks, Lines, Observation, Prior, Status

FIELDS = ("indoor-9x6", "humanoid-kid-9x6")


@pytest.mark.parametrize(
    ("changes", "most"), [((), 0.2), (("particles.random_ratio=0", "particles.max_random_ratio=0"), 0.0)]
)
def test_tracking_alone_has_no_random_particles(changes: tuple[str, ...], most: float) -> None:
    settings = load_settings(NimbroLinesSettings, None, changes, preset="paper")
    system = open_system("nimbro-lines", RobotSetup(open_field(FIELDS[0])), settings)
    assert isinstance(system, NimbroLines)
    system.reset(Prior(HERE))
    weights = np.full(2, 0.5)
    for log_likelihood in (0.0, *[-50.0] * 20):
        system.particles.injection.observe(weights, np.full(2, log_likelihood))
    assert system.particles.injection.ratio(system.particles.filter.estimate()) == most


def test_one_post_seen_ever_so_often_confirms_no_pose() -> None:
    """The heading and the way round the post are anybody's guess: a robot that saw no more was 1 m wrong for 7 s."""
    field = open_field(FIELDS[1])
    system = open_system("nimbro-lines", RobotSetup(field), NimbroLinesSettings())
    system.reset(Prior(HERE))
    posts = seen_from_here().landmarks
    for second, marks in ((0, False), (5, True)):
        for i in range(40):
            stamp_ns = second * 1_000_000_000 + i * 125_000_000
            seen = seen_from_here() if marks else Observation(stamp_ns, landmarks=posts)
            estimate = system.step(Frame(stamp_ns, observation=replace(seen, stamp_ns=stamp_ns)))
        assert estimate.pose.distance_to(HERE) < 0.1
        assert (estimate.status is Status.TRACKING) is marks


@pytest.mark.parametrize("field_name", FIELDS)
def test_tables_name_the_nearest_crossing_of_each_orientation(field_name: str) -> None:
    field = open_field(field_name)
    made = FieldAssociations(field)
    rng = np.random.default_rng(1)
    for crossing in field.crossings:
        if crossing.kind is CrossingKind.X:
            continue
        found = made.of_crossing(crossing.kind.value, oriented=True)
        number = found.table + math.floor((crossing.orientation_rad - found.turn_rad + 0.1) / (0.5 * math.pi)) % 4
        ix, iy = (
            round((value - origin) / 0.1)
            for value, origin in zip(
                (crossing.x + rng.uniform(-0.2, 0.2), crossing.y + rng.uniform(-0.2, 0.2)),
                (made.tables.origin_x, made.tables.origin_y),
                strict=True,
            )
        )
        place = made.tables.places_m[made.tables.nearest[number, iy, ix]]
        assert place == pytest.approx((crossing.x, crossing.y))


def test_colours_tell_the_ends_apart_where_there_are_any() -> None:
    assert FieldAssociations(open_field(FIELDS[0])).tell_ends_apart
    assert not FieldAssociations(open_field(FIELDS[1])).tell_ends_apart


def test_the_twin_is_the_pose_once_colours_say_so_clearly() -> None:
    told: list[float] = []
    colours = SimpleNamespace(log_likelihoods=lambda view, poses: np.array([told.pop(), 0.0]))
    ends = FieldEnds(symmetric=False, alike=True, colours=colours)  # type: ignore[arg-type]
    assert (ends.known, ends.log_odds, ends.in_doubt) == (True, 0.0, True)
    steps = [(2.0, 2.0), (-9.0, -2.0), (-0.9, -2.9), (-1.5, 4.4), (90.0, 8.4), (90.0, 12.0), (90.0, 12.0)]
    for gain, log_odds in steps:
        told.append(gain)
        assert ends.compare(SimpleNamespace(size=1), HERE) is (gain == -1.5)  # type: ignore[arg-type]
        assert ends.log_odds == pytest.approx(log_odds)
    assert not ends.in_doubt
    ends.forget_twin()
    assert ends.in_doubt
    ends.reset(start_known=True)
    assert not ends.in_doubt
    ends.lose()
    assert ends.in_doubt


def test_colours_that_do_not_count_tell_nothing_apart() -> None:
    made = FieldAssociations(open_field(FIELDS[0]))
    without_posts = ["use.posts=false"]
    for changes, told in (([], True), (without_posts, True), ([*without_posts, "use.poles=false"], False)):
        assert Features(made, load_settings(FeatureSettings, None, changes)).tell_ends_apart is told


HERE = Pose(-2.0, 0.7, 0.3)


def seen_from_here() -> Observation:
    """One corner, one tee, an X, a post and a line of the kid-size field, without noise."""
    field = open_field(FIELDS[1])
    chosen = [next(c for c in field.crossings if c.kind is kind and c.x > -0.1) for kind in CrossingKind]
    back = HERE.inverse()
    positions = back.transform(np.array([(c.x, c.y) for c in chosen]))
    crossings = Crossings(
        np.array([c.kind.value for c in chosen]),
        positions,
        np.array([wrap_angle(c.orientation_rad - HERE.heading) for c in chosen]),
        np.tile(np.eye(2) * 0.01, (3, 1, 1)),
        np.ones(3),
        np.full((3, 2), np.nan),
    )
    foot = back.transform(np.array([(4.5, 1.35)]))
    posts = Landmarks(
        np.array(["post"]), foot, np.eye(2)[np.newaxis] * 0.01, np.ones(1), (("white",),), np.zeros((1, 2))
    )
    ends = back.transform(np.array([(0.0, -1.0), (0.0, 2.0)]))[np.newaxis]
    lines = Lines(ends, np.tile(np.eye(2) * 0.01, (1, 2, 1, 1)), np.ones(1), np.full((1, 2, 2), np.nan))
    return Observation(0, lines=lines, crossings=crossings, landmarks=posts)


@pytest.mark.parametrize("seen_by", ["lines=true", "lines=false", "crossings=false", "points"])
def test_features_propose_the_pose_that_they_are_seen_from(seen_by: str) -> None:
    """By a line and points, by an oriented crossing, by a line and a post, by points that are far apart."""
    field, seen = open_field(FIELDS[1]), seen_from_here()
    changes = ["use.lines=false"] if seen_by == "points" else [f"use.{seen_by}"]
    if seen_by == "points":
        seen = replace(seen, crossings=replace(seen.crossings, orientations_rad=np.full(3, np.nan)))
    made = FieldAssociations(field)
    model = FeatureModel(made.tables, field_lines(field), polar=False)
    found = PoseProposals(model, np.array([5.5, 4.0])).of(
        Features(made, load_settings(FeatureSettings, None, changes)).of(seen)
    )
    away = np.hypot(*(found.poses[:, :2] - HERE[:2]).T) + np.abs(np.angle(np.exp(1j * (found.poses[:, 2] - HERE[2]))))
    assert away.min() < 1e-4
    assert found.log_likelihoods[np.argmin(away)] > found.log_likelihoods.max() - 0.1
    drawn = found.draw(np.random.default_rng(0), 50)
    assert drawn.shape == (50, 3)


def test_equations_5_to_8_against_plain_python() -> None:
    """The paper's form, particle by particle, with its own loops over associations."""
    field = open_field(FIELDS[1])
    made, lines = FieldAssociations(field), field_lines(field)
    settings = load_settings(FeatureSettings, preset="paper")
    n, seen = settings.noise, seen_from_here()
    view = Features(made, settings).of(seen)
    pose = Pose(HERE.x + 0.13, HERE.y - 0.2, HERE.heading + 0.05)
    expected = 0.0

    def mixture(exponent: float, sigma: float, volume: float) -> float:
        a = n.uniform_floor
        return math.log(a / volume + (1.0 - a) * math.exp(-exponent) / (2.0 * math.pi * sigma * n.sigma_beta_rad))

    places = [[(c.x, c.y) for c in field.crossings if c.kind is kind] for kind in CrossingKind]
    places.append([(goal.x, y) for goal in field.goals for y in goal.y_posts])
    points = np.concatenate((seen.crossings.positions_m, seen.landmarks.positions_m))
    for (x, y), candidates in zip(points, places, strict=True):
        d_o, beta_o, least = math.hypot(x, y), math.atan2(y, x), math.inf
        sigma = n.sigma_d_m + n.range_ratio * d_o
        for ahead, left in pose.inverse().transform(np.array(candidates)):
            off = wrap_angle(math.atan2(left, ahead) - beta_o)
            exponent = (math.hypot(ahead, left) - d_o) ** 2 / (2.0 * sigma**2) + off**2 / (2.0 * n.sigma_beta_rad**2)
            least = min(least, exponent)
        expected += mixture(least, sigma, 2.0 * math.pi * 10.0)
    (first, second), least = seen.lines.ends_m[0], math.inf
    along = (second - first) / np.linalg.norm(second - first)
    foot_o = first - (first @ along) * along
    sigma = n.sigma_l_m + n.range_ratio * float(np.hypot(*(foot_o)))
    for segment in field.segments:
        ends = pose.inverse().transform(segment.reshape(2, 2))
        direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        foot_e = ends[0] - (ends[0] @ direction) * direction
        if foot_e @ foot_o > 0.0:
            turned = math.acos(min(abs(float(direction @ along)), 1.0))
            square = float((foot_e - foot_o) @ (foot_e - foot_o))
            least = min(least, square / (2.0 * sigma**2) + (1.0 - math.cos(turned)) / n.sigma_beta_rad**2)
    expected += mixture(least, sigma, 2.0 * math.pi * 10.0)
    model = FeatureModel(made.tables, lines, polar=True)
    assert model.log_likelihoods(view, np.array([pose]))[0] == pytest.approx(expected, rel=1e-9)


def test_low_confidence_counts_less() -> None:
    made = FieldAssociations(open_field(FIELDS[1]))
    seen = seen_from_here()
    unsure = replace(seen, lines=replace(seen.lines, confidences=np.array([0.2])))
    sure, doubtful = (Features(made).of(s).lines for s in (seen, unsure))
    assert doubtful.floors[0] > sure.floors[0]
    assert doubtful.peaks[0] < sure.peaks[0]


def test_agreement_is_told_once_half_its_memory_has_been_seen() -> None:
    agreement = Agreement(10.0)
    for seen, below in ((4.0, False), (5.0, True)):
        agreement.start(seen)
        agreement.own = 0.2 * seen
        assert agreement.is_below(0.3) is below
        assert not agreement.is_below(0.1)
