"""How the systems after NuBot tell the end of the field, with a compass that may fail."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from touchline.geometry import Pose
from touchline.motion.compass import COMPASS_FALSE
from touchline.published.nubot.belief import Belief
from touchline.published.nubot.compass_correction import CompassCorrection
from touchline.published.nubot.global_localizer import Localization
from touchline.published.nubot.matcher import Match
from touchline.published.nubot.pose_filter import PoseFilter
from touchline.types import Prior, Status

# ---- the belief in a pose --------------------------------------------------------------------------------------------

HERE = Pose(1.0, 2.0, 0.3)
CERTAIN, UNKNOWN = np.diag([0.01, 0.01, 0.001]), np.diag([100.0, 100.0, 9.0])


def found(**changes: object) -> Localization:
    match = Match(HERE, 0.05, 0.04, CERTAIN)
    return replace(Localization(HERE, CERTAIN, match, confirmed=True, has_pose=True), **changes)  # type: ignore[arg-type]


def test_a_pose_is_believed_once_it_is_confirmed() -> None:
    belief = Belief(symmetric=True, unknown=UNKNOWN)
    assert belief.status is Status.SEARCHING
    belief.take(found(confirmed=False), 0.3)
    assert belief.status is Status.SEARCHING
    np.testing.assert_array_equal(belief.covariance(PoseFilter(HERE, CERTAIN)), CERTAIN + UNKNOWN)
    belief.take(found(), 0.3)
    assert belief.is_tracking
    np.testing.assert_array_equal(belief.covariance(PoseFilter(HERE, CERTAIN)), CERTAIN)
    belief.lose()
    assert belief.status is Status.LOST


@pytest.mark.parametrize(
    ("symmetric", "compass_rad", "prior", "named"),
    [
        (True, 0.3, None, [COMPASS_FALSE]),
        (True, None, None, [None]),
        (False, None, None, []),
        (True, None, Prior(own_half=True), []),
    ],
)
def test_compass_own_half_or_field_tell_the_end(
    symmetric: bool, compass_rad: float | None, prior: Prior | None, named: list[float | None]
) -> None:
    belief = Belief(symmetric, UNKNOWN)
    belief.reset(prior)
    belief.take(found(), compass_rad)
    others = belief.other_end(PoseFilter(HERE, CERTAIN), 0.04)
    assert [other.probability for other in others] == named
    assert all(other.pose == HERE.mirrored() for other in others)
    assert belief.region is None


@pytest.mark.parametrize(("prior", "trusted"), [(Prior(HERE), True), (Prior(HERE), False), (None, True)])
def test_a_compass_that_agreed_with_a_told_pose_is_trusted(prior: Prior | None, trusted: bool) -> None:
    belief = Belief(symmetric=True, unknown=UNKNOWN)
    belief.reset(prior)
    belief.take(found(kept=prior is not None), 0.3)
    belief.lose(compass_trusted=trusted)
    belief.take(found(), 0.3)
    told = prior is not None and trusted
    assert belief.twin_probability == (0.0 if told else COMPASS_FALSE)


def test_a_pose_that_was_kept_tells_no_end() -> None:
    belief = Belief(symmetric=True, unknown=UNKNOWN)
    belief.reset(Prior(HERE))
    belief.take(found(kept=True), None)
    assert belief.twin_probability == 0.0


def test_a_compass_turned_in_a_move_is_believed_once_lost() -> None:
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
def test_a_compass_that_had_failed_tells_no_end(moved: bool) -> None:
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
