"""touchline, our own system: on the recordings, carried away, without a compass, told the wrong end."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from line_scenes import errors, frame, seen

from touchline.errors import InputError
from touchline.field import open_field
from touchline.field.association import FieldAssociations
from touchline.geometry import Pose
from touchline.localization.estimator.compass_fault import StuckCompass
from touchline.localization.estimator.field_end import FieldEnd
from touchline.localization.estimator.game_states import game_prior
from touchline.localization.estimator.stamp_delay import StampDelay
from touchline.localization.estimator.watch import FieldWatch
from touchline.localization.registration.feature_model import FeatureModel, field_lines
from touchline.localization.search.field_search import WHOLE, FieldSearch
from touchline.systems import RobotSetup
from touchline.systems.touchline import Touchline, TouchlineSettings
from touchline.types import Evidence, Prior, Samples

FIELD = open_field("msl-18x12")


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


def test_a_search_within_a_budget_goes_on_later() -> None:
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


def test_a_compass_that_agrees_in_turns_works_again() -> None:
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


def test_a_faulty_compass_turns_no_robot_that_is_followed() -> None:
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


def test_stamps_that_seem_early_are_not_corrected() -> None:
    """Corrected they were carried by motion that is not known yet, which seemed earlier still: 45 cm off at 4.5 m/s."""
    late, early = StampDelay(), StampDelay()
    assert [late.update(0.05, 0.005) for _ in range(10)].count(None) == 9
    assert late.corrected_s == 0.05
    assert [early.update(-0.05, 0.005) for _ in range(10)] == 10 * [None]
    assert early.corrected_s == 0.0


def test_a_compass_that_repeats_itself_exactly_sticks() -> None:
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
def test_a_compass_that_had_failed_decides_no_open_end(failed_s: float, decides: bool) -> None:
    end = compared(found(known=True, compass_error_rad=0.0), 0.0, 20.0)
    compared(end, math.pi, failed_s)
    end.leave_open()
    assert end.probability == pytest.approx(0.5)
    compared(end, math.pi if failed_s else 0.0, 10.0)
    assert end.undecided is not decides
