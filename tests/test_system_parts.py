"""The parts of NuBot's systems, each by itself: tracker, failure monitor, global localizers, and their input."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from line_scenes import view as points_seen

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.registration.covariance import is_one_line
from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.motion import Motion, MotionHistory
from touchline.published.nubot import failure
from touchline.published.nubot.compass_correction import CompassCorrection
from touchline.published.nubot.failure import FailureMonitor, FailureSettings
from touchline.published.nubot.global_localizer import Localization, Prediction
from touchline.published.nubot.global_search import GlobalSearch, GlobalSearchSettings
from touchline.published.nubot.match_input import MatchInput, refine_with_tilt
from touchline.published.nubot.matcher import Matcher
from touchline.published.nubot.pose_filter import Fusion
from touchline.published.nubot.tracker import MAX_UNSETTLED, Tracker
from touchline.published.nubot_mcl.particle_localizer import (
    ParticleFollower,
    ParticleLocalizer,
    ParticleSearch,
    ParticleSearchSettings,
)
from touchline.published.nubot_mcl.particles import NubotParticles
from touchline.published.nubot_mti.grid_localizer import GridLocalizer
from touchline.types import Frame, LinePoints, Prior, Samples

FIELD = open_field("msl-18x12")
MATCHER = Matcher(FIELD.distance_map())
HERE = Pose(2.0, 1.0, 0.3)
WRONG = Pose(-3.0, 3.0, 2.0)
STILL = Motion(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)
SURE: FloatArray = np.diag([0.01, 0.01, 0.005]) ** 2


def match_input(
    pose: Pose = HERE, compass_rad: float | None = 0.3, seed: int = 0, usable: bool = True, tilted: bool = True
) -> MatchInput:
    positions_m = points_seen(FIELD, pose, np.random.default_rng(seed), noise=0.005)
    n = len(positions_m)
    points = LinePoints(positions_m, np.tile(np.eye(2) * 1e-4, (n, 1, 1)), np.ones(n), np.full((n, 2), np.nan))
    tilt = LearnedMirror(FIELD, enabled=tilted)
    return MatchInput(points, np.full(n, 1.0 / n), usable, compass_rad, tilt, CompassCorrection())


def prediction(pose: Pose, lost: bool = False, matched: bool = False) -> Prediction:
    match = MATCHER.match(match_input().positions_m, match_input().weights, pose) if matched else None
    return Prediction(pose, SURE, lost, match)


# ---- the value that travels ------------------------------------------------------------------------------------------


def test_what_is_learned_of_the_compass_holds_for_the_rest_of_the_step() -> None:
    seen = match_input(compass_rad=0.3)
    seen.correction.offset_rad = 0.1
    assert seen.heading_rad == pytest.approx(0.4)
    assert seen.heading_error_rad(0.5) == pytest.approx(0.1)
    assert seen.heading_is_plausible(0.5, 0.2)
    assert not seen.heading_is_plausible(0.9, 0.2)


def test_without_a_compass_every_heading_is_plausible() -> None:
    seen = match_input(compass_rad=None)
    assert seen.heading_rad is None
    assert seen.heading_error_rad(3.0) is None
    assert seen.heading_is_plausible(3.0, 0.1)


def test_the_tilt_is_left_alone_where_it_is_switched_off_or_the_match_is_poor() -> None:
    for seen, error in ((match_input(tilted=False), 0.0), (match_input(), 0.9)):
        refine_with_tilt(MATCHER, seen, HERE.as_array(), error)
        assert not seen.tilt.mean.any()
    seen = match_input()
    refine_with_tilt(MATCHER, seen, HERE.as_array(), 0.05)
    assert seen.tilt.mean.any()


# ---- tracker ---------------------------------------------------------------------------------------------------------


def test_the_tracker_finds_the_pose_near_the_prediction_and_fuses_it() -> None:
    tracker = Tracker(MATCHER)
    tracker.reset(Prior(HERE.compose(Pose(-0.2, 0.1, 0.05))))
    tracker.predict(Motion(Pose(0.1, 0.0, 0.0), SURE, 0.0))
    match = tracker.match(match_input())
    assert match is not None
    assert match.pose.distance_to(HERE) < 0.02
    tracker.fuse(match_input(), match)
    assert tracker.filter.pose.distance_to(HERE) < 0.03


def test_a_frame_whose_tilt_cannot_be_settled_is_not_fused_unless_there_are_many() -> None:
    """A vibrating head threw single frames decimetres off while the robot was tracked."""
    tracker, there = Tracker(MATCHER), Pose(HERE.x + 0.2, HERE.y, HERE.heading)
    tracker.start_at(HERE, np.diag([0.1, 0.1, 0.05]) ** 2)
    seen = match_input(there)
    match = tracker.match(seen)
    assert match is not None
    assert match.settled
    for _ in range(MAX_UNSETTLED):
        assert tracker.fuse(seen, replace(match, settled=False)) is Fusion.SUPPORTS
        assert tracker.filter.pose == HERE
    tracker.fuse(seen, replace(match, settled=False))
    assert tracker.filter.pose.distance_to(there) < 0.05


def test_a_lone_line_tells_nothing_of_the_mirror() -> None:
    y = np.linspace(-2.0, 2.0, 40)
    count, pose = len(y), Pose(6.9375, 0.0, 0.0)  # 2 m before the goal line
    ahead = LinePoints(
        np.column_stack((np.full(count, 2.0), y)), np.tile(np.eye(2) * 1e-4, (count, 1, 1)), np.ones(count),
        np.full((count, 2), np.nan),
    )  # fmt: skip
    seen = replace(match_input(), points=ahead, weights=np.full(count, 1.0 / count))
    refine_with_tilt(MATCHER, seen, pose.as_array(), 0.0)
    assert not seen.tilt.mean.any()


def test_there_is_no_match_without_a_pose_or_without_usable_points() -> None:
    tracker = Tracker(MATCHER)
    assert tracker.match(match_input()) is None
    tracker.start_at(HERE, SURE)
    assert tracker.match(match_input(usable=False)) is None
    tracker.fuse(match_input(), None)
    assert tracker.filter.pose == HERE


def test_a_told_pose_is_as_sure_as_its_covariance_says() -> None:
    tracker = Tracker(MATCHER)
    tracker.reset(Prior(HERE, covariance=SURE))
    np.testing.assert_array_equal(tracker.filter.covariance, SURE)


# ---- failure ---------------------------------------------------------------------------------------------------------


def monitor(keep_unless_better: bool = False, **settings: object) -> FailureMonitor:
    search = GlobalSearch(MATCHER, FIELD.length, FIELD.width)
    rules = FailureSettings.model_validate(settings)
    return FailureMonitor(search, rules, keep_unless_better)


def test_the_first_bad_frame_refutes_a_start_pose_that_nothing_has_confirmed() -> None:
    seen = match_input()
    poor = MATCHER.assess(seen.positions_m, seen.weights, WRONG.as_array(), 0.8)
    for unconfirmed in (True, False):
        judge = monitor()
        judge.reset(start_pose_unconfirmed=unconfirmed)
        assert judge.has_failed(seen, poor, WRONG, 0.0) is unconfirmed
        assert judge.failures == unconfirmed


def test_five_bad_frames_fail_unless_no_other_place_is_better(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(failure, "SUSPECT_M", 10.0)
    seen = match_input()
    poor = MATCHER.assess(seen.positions_m, seen.weights, WRONG.as_array(), 0.8)
    for pose, error, kept in ((WRONG, 0.8, False), (HERE, 0.0, True)):
        judge = monitor(keep_unless_better=True)
        match = MATCHER.assess(seen.positions_m, seen.weights, WRONG.as_array(), error) if kept else poor
        assert [judge.has_failed(seen, match, pose, 0.0) for _ in range(5)] == [False] * 4 + [not kept]


# ---- global localizers -----------------------------------------------------------------------------------------------


def grid(**settings: object) -> GridLocalizer:
    search = GlobalSearch(MATCHER, FIELD.length, FIELD.width, GlobalSearchSettings.model_validate(settings))
    return GridLocalizer(search)


def particles(**settings: object) -> ParticleSearch:
    chosen = ParticleSearchSettings.model_validate(settings)
    rng = np.random.default_rng(0)
    made = NubotParticles(MATCHER, FIELD.length, FIELD.width, rng, chosen.particles, FIELD.is_symmetric)
    return ParticleSearch(made, chosen)


def searched(localizer: GridLocalizer | ParticleLocalizer | ParticleFollower, frames: int) -> list[Localization]:
    found: list[Localization] = []
    for k in range(frames):
        guess = prediction(found[-1].pose if found else Pose(0.0, 0.0, 0.0))
        if not isinstance(localizer, GridLocalizer):
            localizer.search.predict(STILL)
        one = localizer.localize(match_input(seed=k), guess)
        assert one is not None
        found.append(one)
        if one.confirmed:
            break
    return found


@pytest.mark.parametrize("localizer", [grid(), ParticleLocalizer(particles()), ParticleFollower(particles())])
def test_every_localizer_finds_the_robot_within_ten_frames(
    localizer: GridLocalizer | ParticleLocalizer | ParticleFollower,
) -> None:
    if isinstance(localizer, ParticleFollower):
        localizer.search.reset()
    else:
        localizer.reset()
    last = searched(localizer, 10)[-1]
    assert last.confirmed
    assert last.has_pose
    assert last.pose.distance_to(HERE) < 0.1


def test_the_grid_stays_with_a_tracked_match_unless_another_is_better() -> None:
    found = grid().localize(match_input(), prediction(HERE, matched=True))
    assert found is not None
    assert found.kept
    found = grid().localize(match_input(), prediction(WRONG, matched=True))
    assert found is not None
    assert not found.kept
    assert found.pose.distance_to(HERE) < 0.05


def test_a_pose_that_is_not_accepted_is_confirmed_once_it_has_held_for_three_frames() -> None:
    localizer = grid(accepted_error=1e-9)
    confirmed = []
    for _ in range(4):
        found = localizer.localize(match_input(), prediction(HERE, matched=True))
        assert found is not None
        confirmed.append(found.confirmed)
    assert confirmed == [False, False, True, False]


def test_particles_rest_once_matching_goes_on_and_stay_at_work_where_they_follow() -> None:
    for kind, at_work in ((ParticleLocalizer, False), (ParticleFollower, True)):
        search = particles()
        searched(kind(search), 10)
        assert (search.cycles > 0) is at_work


def test_a_search_starts_anew_when_the_robot_was_lost_and_after_too_many_cycles() -> None:
    search = particles(max_cycles=3, particles={"converged_m": 1e-6})
    localizer = ParticleLocalizer(search)
    starts = []
    for k in range(8):
        localizer.localize(match_input(seed=k), prediction(HERE, lost=k == 7))
        starts.append(search.starts)
    assert starts == [1, 1, 1, 2, 2, 2, 3, 1]


def test_particles_that_follow_start_about_the_prediction() -> None:
    follower = ParticleFollower(particles())
    found = follower.follow(match_input(), prediction(HERE.compose(Pose(0.05, 0.0, 0.0))))
    assert found.has_pose
    assert found.pose.distance_to(HERE) < 0.1
    assert follower.match_nearby(match_input(), found.pose).pose.distance_to(HERE) < 0.05


# ---- compass and motion ----------------------------------------------------------------------------------------------


def test_the_compass_learns_only_from_matches() -> None:
    correction = CompassCorrection()
    match = MATCHER.assess(match_input().positions_m, match_input().weights, HERE.as_array(), 0.0)
    for _ in range(4):
        correction.learn(match, 0.2)
    correction.learn(None, 0.2)
    assert correction.good_frames == 0
    for _ in range(5):
        correction.learn(match, 0.2)
    assert correction.offset_rad == pytest.approx(0.2 * 0.1, abs=1e-6)
    correction.reset()
    assert correction.offset_rad == 0.0


def test_a_history_takes_a_frame_and_gives_the_motion_since_the_one_before() -> None:
    history = MotionHistory()
    stamps = np.array([0, 100_000_000], dtype=np.int64)
    odometry = Samples(stamps, np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]))
    assert history.take(Frame(0, odometry=odometry)).pose == Pose(0.0, 0.0, 0.0)
    assert history.take(Frame(100_000_000)).pose.x == pytest.approx(0.1)
    with pytest.raises(ValueError, match="forward in time"):
        history.take(Frame(50_000_000))


def test_particles_that_have_gathered_along_a_lone_line_start_anew_once_more_is_seen() -> None:
    along = np.linspace(-3.0, 3.0, 60)
    line = np.column_stack((along, np.full(60, 1.5) + 0.02 * np.sin(along)))
    corner = np.concatenate((line, line[:, ::-1]))
    assert is_one_line(line)
    assert not is_one_line(corner)
    given_up: list[int] = []
    seen: list[int] = []
    search = SimpleNamespace(
        reset=lambda: None, give_up=lambda: given_up.append(len(seen)), start_if_due=lambda *_: None,
        cycle=lambda _: seen.append(1), converged=False,
    )  # fmt: skip
    for whole_field, expected in ((object(), [3]), (None, [])):  # the paper's own form has no such rule
        localizer = ParticleLocalizer(search, whole_field)  # type: ignore[arg-type]
        given_up.clear()
        seen.clear()
        for points in (corner, line, line, corner, corner):
            localizer.localize(SimpleNamespace(positions_m=points), SimpleNamespace())  # type: ignore[arg-type]
        assert given_up == expected
