"""touchline, our own system: on the recordings, carried away, without a compass, told the wrong end."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from line_scenes import polar_covariances

from touchline.errors import InputError
from touchline.field import FieldModel, open_field
from touchline.field.association import FieldAssociations
from touchline.geometry import Pose, wrap_angle
from touchline.localization.estimator.bank import Image, Member
from touchline.localization.estimator.compass_fault import StuckCompass
from touchline.localization.estimator.field_end import FieldEnd
from touchline.localization.estimator.filter import Filter
from touchline.localization.estimator.game_states import game_prior
from touchline.localization.estimator.stamp_delay import StampDelay
from touchline.localization.estimator.watch import FieldWatch
from touchline.localization.registration.feature_model import FeatureModel, field_lines
from touchline.localization.registration.seen import seen_of
from touchline.localization.search.field_search import WHOLE, FieldSearch
from touchline.systems import RobotSetup
from touchline.systems.touchline import Touchline, TouchlineSettings
from touchline.types import Estimate, Evidence, Frame, LinePoints, Observation, Prior, Samples

FIELD = open_field("msl-18x12")


def seen(pose: Pose, seed: int, field: FieldModel = FIELD, reach_m: float = 5.0) -> LinePoints:
    """Noisy line points within reach of a pose, and a few that are none."""
    rng = np.random.default_rng(seed)
    exact = pose.inverse().transform(np.vstack(field.polylines(0.25)))
    exact = exact[np.hypot(*exact.T) < reach_m]
    covariances = polar_covariances(exact, (0.02, 0.01, 0.0087))
    noisy = exact + np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=exact.shape))
    points = np.vstack((noisy, rng.uniform(-4.0, 4.0, (len(noisy) // 15, 2))))
    n = len(points)
    return LinePoints(points, polar_covariances(points, (0.02, 0.01, 0.0087)), np.ones(n), np.full((n, 2), np.nan))


def frame(k: int, points: LinePoints, compass_rad: float | None = None) -> Frame:
    stamp_ns = 100_000_000 * k
    stamps = np.array([stamp_ns - 20_000_000, stamp_ns])
    compass = None if compass_rad is None else Samples(stamps, np.full((2, 1), compass_rad))
    still = Samples(stamps, np.zeros((2, 3)))
    return Frame(stamp_ns, observation=Observation(stamp_ns, points), odometry=still, compass=compass)


def errors(estimate: Estimate, truth: Pose) -> tuple[float, float]:
    turned = abs(wrap_angle(estimate.pose.heading - truth.heading))
    return estimate.pose.distance_to(truth), turned


@pytest.mark.parametrize("every", [1, 3, 5, 6, 15])
def test_the_whole_field_is_searched_once_in_so_many_images(every: int) -> None:
    """In five parts or, more often than every fifth image, in one part an image."""
    watch = FieldWatch(FieldSearch(FIELD), every)
    parts = [watch.part(in_doubt=False, follows=True) for _ in range(4 * every)]
    searched = [part for part in parts if part is not None]
    count = min(every, 5)
    assert [index for index, _ in searched] == [(k + 1) % count for k in range(len(searched))]
    assert {of for _, of in searched} == {count}
    assert len(searched) == 4 * count
    assert watch.part(in_doubt=True, follows=True) == WHOLE


SEARCHES_ON = "the search of the field goes on in the next image"


def test_a_search_within_a_budget_goes_on_in_the_next_images() -> None:
    """A fifth of the field an image, carried to another place unfelt in the tenth: nothing is tracked that was not
    before all of it has been searched, and then the pose is right; with time enough all is searched in one image.
    """
    system = Touchline(RobotSetup(FIELD), TouchlineSettings(search_ms=1e-3), np.random.default_rng(0))
    places, left, off_m = 10 * [Pose(2.0, 1.0, 0.3)] + 12 * [Pose(-4.0, -2.5, 2.0)], [], []
    for k, place in enumerate(places):
        estimate = system.step(frame(k, seen(place, k), place.heading + 0.05))
        left.append(system.watch.left)
        off_m.append(errors(estimate, place)[0])
        assert (estimate.reason == SEARCHES_ON) == (k < 4)
    assert left == [4, 3, 2, 1, *6 * [0], 4, 3, 2, 1, *8 * [0]]
    assert off_m[0] > 1.0, "a pose of the first part, which alone it would be sure of"
    assert max(off_m[4:10] + off_m[14:]) < 0.1
    plenty = Touchline(RobotSetup(FIELD), TouchlineSettings(search_ms=1e6), np.random.default_rng(0))
    estimate = plenty.step(frame(0, seen(places[0], 0), places[0].heading + 0.05))
    assert plenty.watch.left == 0
    assert errors(estimate, places[0])[0] < 0.1


def test_lines_that_are_not_seen_speak_against_a_pose() -> None:
    """A lone line 1 m ahead fits a side line as well as the goal area's, behind which the goal line would be seen."""
    system = Touchline(RobotSetup(FIELD), TouchlineSettings(), np.random.default_rng(0))
    across = np.linspace(-1.6, 1.6, 60)
    lone = np.column_stack((1.0 + 0.01 * np.random.default_rng(0).normal(size=60), across))
    points = LinePoints(lone, polar_covariances(lone, (0.02, 0.01, 0.0087)), np.ones(60), np.full((60, 2), np.nan))
    side, goal = Pose(3.5, 4.94, 0.5 * math.pi), Pose(7.31, 0.0, 0.0)
    known = np.diag([0.01, 0.01, 0.001])
    members = [Member(Filter(pose, known, system.initial), 0.0) for pose in (goal, side)]
    image = Image(seen_of(Observation(0, points), system.features, system.statistics.noise), system.errors.response())
    system.bank.members = members.copy()
    system.bank.register(image)
    system.bank.update(image, (), ())
    assert all(member.explained > 0.9 for member in members)
    assert system.bank.best is members[1]
    assert system.bank.probabilities[0] > 0.9


def found(known: bool, compass_error_rad: float) -> FieldEnd:
    """The belief after a pose was found that a compass differs from by so much."""
    end = FieldEnd(True, FeatureModel(FieldAssociations(FIELD).tables, field_lines(FIELD), polar=False), False)
    end.begin(known, compass_error_rad)
    return end


def compared(end: FieldEnd, error_rad: float, seconds: float) -> FieldEnd:
    """After so many seconds of a compass that differs by so much."""
    for _ in range(round(10 * seconds)):
        end.update_from_compass(error_rad, 0.1)
    return end


def test_a_compass_turns_the_pose_only_after_some_time() -> None:
    end = found(known=False, compass_error_rad=0.1)
    assert end.probability == pytest.approx(0.98, abs=0.003)
    assert 0.1 < compared(end, math.pi, 1.0).probability < 0.7  # undecided at once
    assert not end.is_refuted
    assert compared(end, math.pi, 20.0).is_refuted
    end.swap_ends()
    assert end.probability > 0.8


def test_a_compass_that_agrees_while_the_robot_turns_works_again_where_its_end_is_known() -> None:
    """Noisy for five seconds, then right for twenty, of a robot that turns or drives on; then its end is open."""
    odds = {}
    for known, rate in itertools.product((True, False), (1.0, 0.0)):
        end = found(known, 0.0)
        for k in range(350):
            error_rad = 2.5 * (-1) ** k if 100 <= k < 150 else 0.0
            end.update_from_compass(error_rad, 0.1, 0.1 * k * rate)
        end.leave_open()
        for _ in range(20):
            end.update_from_compass(0.0, 0.1, 0.0)
        odds[known, rate] = end.log_odds
    assert odds[True, 1.0] > 3.0
    assert max(odds[True, 0.0], odds[False, 0.0]) < 2.0
    assert odds[False, 1.0] == odds[False, 0.0]


def test_a_fault_of_the_compass_does_not_turn_a_robot_that_is_followed() -> None:
    end = found(known=False, compass_error_rad=0.1)
    compared(end, 0.1, 20.0)
    assert not compared(end, math.pi, 10.0).is_refuted
    assert 0.95 < end.probability < 0.998  # it says so, and the twin is named
    assert compared(end, 0.1, 10.0).probability > 0.97
    assert not compared(end, math.pi, 120.0).is_refuted  # it has agreed when the end was found, and for half a minute
    assert 0.99 < end.probability < 0.9995


def test_evidence_that_is_none_is_refused() -> None:
    for wrong in ({}, {"own_half": True, "place_m": (0.0, 0.0)}, {"place_m": (0.0, math.nan)}, {"place_m": "here"}):
        with pytest.raises(InputError, match="evidence"):
            Evidence("a mate", 0.9, **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="between 0 and 1"):
        Evidence("a mate", 1.0, own_half=True)


def test_who_was_picked_up_may_be_anywhere() -> None:
    assert game_prior("picked up", FIELD, Prior(Pose(1.0, 2.0, 3.0))) == Prior()
    assert game_prior("fallen", FIELD, Prior()) == Prior()
    with pytest.raises(InputError, match="did you mean 'fallen'"):
        game_prior("falling", FIELD, Prior())


def test_stamps_that_seem_too_early_are_an_odometry_that_comes_late_and_not_corrected() -> None:
    """Corrected they were carried by motion that is not known yet, which seemed earlier still: 45 cm off at 4.5 m/s."""
    late, early = StampDelay(), StampDelay()
    assert [late.update(0.05, 0.005) for _ in range(10)].count(None) == 9
    assert late.corrected_s == 0.05
    assert [early.update(-0.05, 0.005) for _ in range(10)] == 10 * [None]
    assert early.corrected_s == 0.0


def test_a_compass_that_repeats_itself_exactly_sticks_and_one_of_whole_degrees_does_not() -> None:
    rng, stamps = np.random.default_rng(1), np.arange(100, dtype=np.int64)
    restless = 0.5 + 0.01 * rng.standard_normal((100, 1))
    stuck, coarse = StuckCompass(), StuckCompass()
    stuck.update(Samples(stamps, restless))
    assert not stuck.sticks
    stuck.update(Samples(stamps, np.full((100, 1), 0.5)))
    assert stuck.sticks
    stuck.update(Samples(stamps[:1], restless[:1]))
    assert not stuck.sticks
    coarse.update(Samples(stamps, np.round(restless, 1)))
    coarse.update(Samples(stamps, np.full((100, 1), 0.5)))
    assert not coarse.sticks


@pytest.mark.parametrize(("failed_s", "decides"), [(0.0, True), (3.0, False)])
def test_an_end_that_is_left_open_is_not_decided_by_a_compass_that_had_failed(failed_s: float, decides: bool) -> None:
    end = compared(found(known=True, compass_error_rad=0.0), 0.0, 20.0)
    compared(end, math.pi, failed_s)
    end.leave_open()
    assert end.probability == pytest.approx(0.5)
    compared(end, math.pi if failed_s else 0.0, 10.0)
    assert end.undecided is not decides
