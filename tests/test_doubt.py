"""Honest doubt: what is no view of the field is not called tracking, and a compass is a witness among others."""

from __future__ import annotations

import math

import pytest

from touchline.published.nubot.compass_correction import CompassCorrection


def test_a_compass_that_turned_round_as_the_robot_was_moved_is_believed_once_the_robot_is_lost() -> None:
    for moved in (False, True):
        one = CompassCorrection()
        for _ in range(12):
            one.update(0.02, 0.3, 0.3)
        for k in range(3):
            one.update(0.02, 0.3, 0.3 + math.pi, moved=moved and k == 0)
        assert one.doubted
        assert bool(one.either_end) is moved
        one.lose()
        assert one.doubted is not moved


def judged(compass: CompassCorrection, off_rad: float, frames: int, moved: bool = False) -> None:
    """So many good matches with such a compass; moved: the robot was, in the first."""
    for k in range(frames):
        compass.update(0.02, 0.3, 0.3 - off_rad, moved=moved and k == 0)


@pytest.mark.parametrize("moved", [False, True])
def test_a_compass_that_had_failed_as_the_robot_was_lost_tells_no_end(moved: bool) -> None:
    """Half of all places agree with it; the others show that it is right again."""
    one = CompassCorrection()
    judged(one, 0.0, 12)
    judged(one, math.pi, 20, moved)
    one.lose()
    one.start_anew()
    judged(one, 0.0, 20)  # a false one again, at the other end
    assert [each.code for each in one.doubts] == ["compass-wrong"]
    assert not one.doubted
    judged(one, math.pi, 20)
    assert not one.doubted  # nor is it doubted in favour of the end that it had told
    one.lose()
    one.start_anew()
    judged(one, 0.0, 20)
    assert not one.doubts


def test_the_learned_offset_is_bounded_in_total() -> None:
    one = CompassCorrection()
    for k in range(400):
        one.update(0.02, 0.01 * k, 0.0)  # it sticks while the robot turns slowly
    assert abs(one.offset_rad) <= 0.6 + 1e-9
    assert one.doubted
    assert math.isfinite(one.offset_rad)


def test_clutter_beside_the_lines_does_not_hide_that_the_compass_has_failed() -> None:
    """Lines of the next field leave a large mean distance; the compass was asked, as if nothing had agreed with it."""
    one = CompassCorrection()
    for _ in range(12):
        one.update(0.2, 0.3, 0.3, error=0.08)
    for _ in range(3):
        one.update(0.2, 0.3, 0.3 + math.pi, error=0.08)
    assert one.doubted
