"""nimbro-lines on the features of a walking robot: it tracks, finds itself, says what it does not know; its parts."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from touchline.config import load_settings, preset_values
from touchline.errors import InputError
from touchline.field import open_field
from touchline.field.association import FieldAssociations
from touchline.geometry import FloatArray, Pose, Pose3, wrap_angle
from touchline.localization.registration.feature_model import FeatureModel, field_lines
from touchline.localization.registration.features import Features, FeatureSettings
from touchline.localization.search.feature_poses import PoseProposals
from touchline.published.nimbro_lines.system import NimbroLines, NimbroLinesSettings
from touchline.systems import RobotSetup, open_system
from touchline.types import (
    CrossingKind,
    Crossings,
    Estimate,
    Frame,
    Landmarks,
    Lines,
    Observation,
    Prior,
    Samples,
    Status,
)
from touchline_lab.experiments.schulz_runs import TRACKING_ALONE
from touchline_lab.simulation.observation.features import leaning
from touchline_lab.simulation.run import PINHOLE_FEATURES, Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELDS = ("indoor-9x6", "humanoid-kid-9x6")


@cache
def walk(field: str) -> tuple[FloatArray, tuple[Frame, ...]]:
    """True poses and frames of a walk of 20 s, with features instead of images."""
    run = Simulation(open_scenario("humanoid-walk", 3, 20.0, [f"field={field}"]), "points")
    frames = tuple(replace(frame, observation=run.features(i)) for i, frame in enumerate(run))
    return np.array(run.truth.poses), frames


def localized(field: str, prior: Prior, *settings: str) -> list[Estimate]:
    system = open_system(
        "nimbro-lines", RobotSetup(open_field(field)), load_settings(NimbroLinesSettings, None, settings)
    )
    system.reset(prior)
    return [system.step(frame) for frame in walk(field)[1]]


def errors_m(field: str, estimates: list[Estimate]) -> FloatArray:
    truth = walk(field)[0]
    return np.array([math.hypot(e.pose.x - t[0], e.pose.y - t[1]) for e, t in zip(estimates, truth, strict=True)])


def near_start(field: str) -> Prior:
    x, y, heading = walk(field)[0][0]
    return Prior(Pose(float(x) + 0.2, float(y) - 0.2, float(heading) + 0.15))


@pytest.mark.parametrize("field", FIELDS)
def test_it_tracks_from_a_start_pose(field: str) -> None:
    estimates = localized(field, near_start(field))
    assert all(e.status is Status.TRACKING for e in estimates[5:])
    assert np.median(errors_m(field, estimates)) < 0.05
    assert errors_m(field, estimates)[10:].max() < 0.3


def test_the_papers_form_tracks_less_precisely() -> None:
    preset = preset_values(NimbroLinesSettings, "paper")
    assert preset["paper"] == {"rates": False, "refine": False, "twin": False, "restart": False, "monitor": False}
    settings = load_settings(NimbroLinesSettings, preset="paper")
    system = open_system("nimbro-lines", RobotSetup(open_field(FIELDS[0])), settings)
    system.reset(near_start(FIELDS[0]))
    estimates = [system.step(frame) for frame in walk(FIELDS[0])[1]]
    assert 0.02 < np.median(errors_m(FIELDS[0], estimates)) < 0.3


@pytest.mark.parametrize(("changes", "most"), [((), 0.2), (TRACKING_ALONE, 0.0)])
def test_tracking_alone_has_no_random_particles(changes: tuple[str, ...], most: float) -> None:
    settings = load_settings(NimbroLinesSettings, None, changes, preset="paper")
    system = open_system("nimbro-lines", RobotSetup(open_field(FIELDS[0])), settings)
    assert isinstance(system, NimbroLines)
    system.reset(near_start(FIELDS[0]))
    weights = np.full(2, 0.5)
    for log_likelihood in (0.0, *[-50.0] * 20):
        system.particles.injection.observe(weights, np.full(2, log_likelihood))
    assert system.particles.injection.ratio(system.particles.filter.estimate()) == most


def test_coloured_goals_and_poles_find_the_robot_from_nowhere() -> None:
    estimates = localized(FIELDS[0], Prior())
    believed = [e.status is Status.TRACKING for e in estimates]
    assert any(believed[:80])
    wrong = errors_m(FIELDS[0], estimates) > 0.5
    assert not np.any(wrong & np.array(believed))


@pytest.mark.parametrize("others", [(), ("features.use.crossings=false",)])
def test_colours_take_it_from_the_twin_that_it_was_told_to_the_right_end(others: tuple[str, ...]) -> None:
    """Lines and crossings fit both; it tracked the twin for whole games, all but some posts explained."""
    truth = [Pose(*pose) for pose in walk(FIELDS[0])[0]]
    estimates = localized(FIELDS[0], Prior(truth[0].mirrored()), *others)
    wrong = errors_m(FIELDS[0], estimates) > 0.5
    believed = np.array([e.status is Status.TRACKING for e in estimates])
    assert np.sum(wrong & believed) <= 8
    assert np.all((believed & ~wrong)[-40:])
    named = [len(e.hypotheses) == 1 for e in estimates]
    told = named.index(True)  # a person's word stands until colours speak against it
    assert told <= 8
    assert all(n for n, w, b in zip(named[told:], wrong[told:], believed[told:], strict=True) if w and not b)


def test_a_told_start_is_not_believed_before_something_confirms_it() -> None:
    system = open_system("nimbro-lines", RobotSetup(open_field(FIELDS[1])), NimbroLinesSettings())
    system.reset(near_start(FIELDS[1]))
    believed = []
    for i, frame in enumerate(walk(FIELDS[1])[1][:40]):
        blind = i < 20  # 2.5 s
        estimate = system.step(replace(frame, observation=Observation(frame.stamp_ns)) if blind else frame)
        believed.append(estimate.status is Status.TRACKING)
        assert estimate.status is not Status.LOST
    assert not any(believed[:20])
    assert all(believed[25:])


def test_an_attitude_that_drifts_is_followed() -> None:
    """The IMU's reading of the upright pose wanders, by 4° here: all that is seen lies farther and farther aside."""
    system = open_system("nimbro-lines", RobotSetup(open_field(FIELDS[1])), NimbroLinesSettings())
    system.reset(near_start(FIELDS[1]))
    truth, frames = walk(FIELDS[1])
    for pose, frame in zip(truth, frames, strict=True):
        assert frame.observation is not None
        lean_rad = math.radians(4.0) * frame.stamp_ns / frames[-1].stamp_ns
        seen = leaning(frame.observation, lean_rad, -lean_rad, PINHOLE_FEATURES.height_m)
        estimate = system.step(replace(frame, observation=seen))
        assert estimate.pose.distance_to(Pose(*pose)) < 0.3
    assert estimate.status is Status.TRACKING


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


def test_a_pose_that_nothing_confirms_for_some_time_is_believed_no_longer() -> None:
    """The robot may have fallen, and enter again anywhere at a side line."""
    system = open_system("nimbro-lines", RobotSetup(open_field(FIELDS[0])), NimbroLinesSettings())
    system.reset(near_start(FIELDS[0]))
    believed = []
    for i, frame in enumerate(walk(FIELDS[0])[1][:100]):
        blind = 20 <= i < 60  # 5 s
        estimate = system.step(replace(frame, observation=Observation(frame.stamp_ns)) if blind else frame)
        believed.append(estimate.status is Status.TRACKING)
    assert all(believed[5:50])
    assert not any(believed[54:60])
    assert all(believed[75:])


def test_a_symmetric_fields_twin_is_named_unless_the_half_is_told() -> None:
    truth = Pose(*walk(FIELDS[1])[0][-1])
    lost = localized(FIELDS[1], Prior())[-1]
    assert lost.status is Status.TRACKING
    (twin,) = lost.hypotheses
    assert min(lost.pose.distance_to(truth), twin.pose.distance_to(truth)) < 0.3
    told = localized(FIELDS[1], Prior(own_half=True))[-1]  # in the other half, which looks the same
    assert told.status is Status.TRACKING
    assert not told.hypotheses
    assert told.pose.distance_to(truth.mirrored()) < 0.3


def test_both_ends_are_named_after_it_was_carried_away_where_nothing_tells_them_apart() -> None:
    system = open_system("nimbro-lines", RobotSetup(open_field(FIELDS[1])), NimbroLinesSettings())
    system.reset(near_start(FIELDS[1]))
    truth, frames = walk(FIELDS[1])
    for i, frame in enumerate(frames[:100]):
        where = i if i < 40 else i + 60  # 1.9 m away
        estimate = system.step(replace(frame, observation=frames[where].observation))
        if i < 40:
            assert not estimate.hypotheses
    assert estimate.status is Status.TRACKING
    (twin,) = estimate.hypotheses
    there = Pose(*truth[where])
    assert min(estimate.pose.distance_to(there), twin.pose.distance_to(there)) < 0.3


def test_kinds_can_be_switched_off() -> None:
    only_lines = ("features.use.crossings=false", "features.use.posts=false", "features.use.poles=false")
    estimates = localized(FIELDS[1], near_start(FIELDS[1]), *only_lines, "paper.features.marks=false")
    assert max(e.points for e in estimates) < max(e.points for e in localized(FIELDS[1], near_start(FIELDS[1])))
    assert np.median(errors_m(FIELDS[1], estimates)) < 0.1


def test_it_stops_believing_a_start_pose_that_is_wrong() -> None:
    x, y, heading = walk(FIELDS[0])[0][0]
    estimates = localized(FIELDS[0], Prior(Pose(float(x) + 1.5, float(y) - 1.0, float(heading) + 1.0)))
    wrong = errors_m(FIELDS[0], estimates) > 0.5
    believed = np.array([e.status is Status.TRACKING for e in estimates])
    assert np.sum(wrong & believed) < 25
    assert not wrong[-1]


# ---- the parts -------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("covariances", [True, False])
def test_the_likelihood_is_greatest_at_the_true_pose(covariances: bool) -> None:
    field = open_field(FIELDS[1])
    made = FieldAssociations(field)
    settings = load_settings(FeatureSettings, None, [f"paper.covariances={str(covariances).lower()}"])
    view = Features(made, settings).of(seen_from_here())
    assert view.size == 5
    model = FeatureModel(made.tables, field_lines(field), polar=not covariances)
    poses = np.array(HERE) + np.concatenate((np.zeros((1, 3)), np.random.default_rng(0).normal(0.0, 0.3, (300, 3))))
    found = model.log_likelihoods(view, poses)
    assert np.argmax(found) == 0


def test_positions_in_whole_metres_are_as_unsure_as_others() -> None:
    field = open_field(FIELDS[1])
    seen = seen_from_here()
    rounded = [replace(of, positions_m=of.positions_m.round()) for of in (seen.crossings, seen.landmarks)]
    whole = [replace(of, positions_m=of.positions_m.astype(np.int64)) for of in rounded]
    made = Features(FieldAssociations(field))
    exact, ints = (made.of(Observation(0, crossings=c, landmarks=posts)).points for c, posts in (rounded, whole))
    np.testing.assert_array_equal(exact.sigmas, ints.sigmas)
    assert (ints.sigmas > 0.0).all()


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


def test_a_fields_lines_are_in_normal_form() -> None:
    field = open_field(FIELDS[0])
    ux, uy, aside, ahead, length = field_lines(field).T
    start, end = field.segments[:, :2], field.segments[:, 2:]
    assert ux * start[:, 1] - uy * start[:, 0] == pytest.approx(aside)
    assert ux * end[:, 0] + uy * end[:, 1] == pytest.approx(ahead + length)


def test_posts_alone_keep_it_right_for_minutes_because_the_particles_tell_what_is_what() -> None:
    """White posts look alike: taken for what they are from a prediction that has drifted, they led 5 m astray."""
    run = Simulation(open_scenario("humanoid-walk", 3, 70.0, [f"field={FIELDS[1]}"]), "points")
    settings = load_settings(NimbroLinesSettings, None, ["features.use.lines=false", "features.use.crossings=false"])
    system = open_system("nimbro-lines", RobotSetup(run.field), settings)
    system.reset(near_start(FIELDS[1]))
    far = [
        system.step(replace(frame, observation=run.features(i))).pose.distance_to(run.truth[i])
        for i, frame in enumerate(run)
    ]
    assert np.median(far) < 0.2
    assert max(far) < 0.6


# ---- wrong input -----------------------------------------------------------------------------------------------------


def test_what_cannot_be_is_told_in_one_sentence() -> None:
    field = open_field(FIELDS[0])
    image = np.repeat(np.random.default_rng(0).integers(60, 200, (480, 752, 1)), 3, axis=2).astype(np.uint8)
    camera = Simulation(open_scenario("humanoid-walk", 3, 1.0)).camera
    mirror = Simulation(open_scenario("match", 3, 1.0, ["ideal=true"])).camera
    with pytest.raises(InputError, match="lines in images of a perspective camera; this camera is an omni"):
        open_system("nimbro-lines", RobotSetup(field, mirror))
    system = open_system("nimbro-lines", RobotSetup(field, camera))

    def problem(stamp_ns: int, tilt: Samples | None, pose: Pose3 | None = None) -> str:
        estimate = system.step(Frame(stamp_ns, image, base_from_camera=pose, tilt=tilt))
        assert estimate.status is not Status.TRACKING
        assert estimate.observation is not None
        return estimate.observation.problem or ""

    assert "nothing tells how the camera leans" in problem(0, None)
    fallen = Samples(np.array([10**9]), np.array([(0.0, 1.3)]))
    assert "the robot leans by 74°" in problem(10**9, fallen)
    assert problem(2 * 10**9, None, camera.base_from_camera) != ""  # no field in it
    with pytest.raises(ValueError, match="are of the kinds L, T, X, not Y"):
        replace(seen_from_here().crossings, kinds=np.array(["L", "T", "Y"]))
