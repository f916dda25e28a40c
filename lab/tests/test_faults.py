"""The experiment `faults`: each changes what it must and nothing else; what counts as wrong, noticed and named."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.systems import RobotSetup
from touchline.types import Estimate, Frame, Hypothesis, Observation, Problem, Samples, Status, points_at
from touchline_lab.experiments import faults, faulty_play
from touchline_lab.experiments import schulz_runs as humanoids
from touchline_lab.experiments.catalogue import (
    CATALOGUE,
    CLOUD,
    FEATURES,
    MIRROR,
    Kind,
    Laid,
    walk_of_points,
)
from touchline_lab.experiments.drives import (
    BoolArray,
    Drive,
    Kidnapped,
    counts,
    driven,
    kidnaps_of,
    longest,
    track_of,
)
from touchline_lab.experiments.faults import outcome, rightly_named
from touchline_lab.experiments.injections import Change, Fault

FIELD = open_field("indoor-9x6")
START_S, END_S = 2.0, 4.0
CHANGED = {
    "": set(),
    "odometry": {"odometry", "wheels"},
    "gyro": {"gyro"},
    "compass": {"compass"},
    "clock": {"stamp_ns", "observation"},
    "image": {"observation"},
    "field": {"observation"},
    "head": {"observation"},
    "clutter": {"observation"},
    "sight": {"observation"},
    "start": set(),
}
"""What of the frames the faults of a family change; those in which the robot is carried or covered: more."""


def drive(poses: FloatArray) -> Drive:
    """A frame per pose, 0.1 s apart; odometry tells the same, wheels a tenth of a metre per frame."""
    frames = []
    for k, pose in enumerate(poses):
        stamp_ns = np.array([100_000_000 * (k + 1)])
        wheels = Samples(stamp_ns, np.array([[0.1 * k, -0.1 * k]]))
        seen = Observation(int(stamp_ns[0]), points_at(np.array([[1.0, 0.5 + 0.01 * k], [2.0, -1.0]])))
        odometry = Samples(stamp_ns, pose.reshape(1, 3))
        frames.append(Frame(int(stamp_ns[0]), observation=seen, odometry=odometry, wheels=wheels))
    return Drive(RobotSetup(FIELD), frames, poses)


def values(told: Drive, name: str) -> FloatArray:
    return np.concatenate([getattr(frame, name).values for frame in told.frames])


CIRCLE = np.array([[math.sin(0.1 * k), 1.0 - math.cos(0.1 * k), 0.1 * k] for k in range(40)])


def changed(change: Change, start_s: float, end_s: float, made: Drive | None = None) -> Drive:
    """The robot on a circle, with a change from one time to another."""
    return Fault("", start_s, end_s, change).laid_into(made or drive(CIRCLE), np.random.default_rng(0))


@cache
def short(robots: str) -> Drive:
    """Eight seconds of a robot of a kind."""
    if robots == MIRROR:
        return driven("match", 3, 8.0)
    if robots == FEATURES:
        return humanoids.walk("humanoid-kid-9x6", humanoids.AS_SIMULATED, 3, 8.0)
    return walk_of_points("humanoid-kid-9x6", 3, 8.0)


def same(one: object, other: object) -> bool:
    """Whether two values of frames are equal, arrays and all, but for rounding."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        if one.shape != other.shape or one.dtype.kind not in "fi":
            return np.array_equal(one, other)
        return np.allclose(one, other, rtol=0.0, atol=1e-9, equal_nan=True)
    if hasattr(one, "__slots__") and type(one) is type(other) and not isinstance(one, Pose):
        return all(same(getattr(one, name), getattr(other, name)) for name in one.__slots__)
    return bool(one == other)


def differing(one: Drive, other: Drive, frames: BoolArray) -> set[str]:
    """Which attributes of the frames that are marked differ."""
    found = set()
    for first, second in zip(np.array(one.frames, object)[frames], np.array(other.frames, object)[frames], strict=True):
        found |= {name for name in Frame.__slots__ if not same(getattr(first, name), getattr(second, name))}
    return found


def test_the_catalogue_names_each_fault_once_and_holds_enough() -> None:
    titles = [kind.title for kind in CATALOGUE]
    assert len(set(titles)) == len(titles) >= 60
    assert {kind.robots for kind in CATALOGUE} == {MIRROR, FEATURES, CLOUD}
    assert {kind.family for kind in CATALOGUE} <= {*CHANGED, "carried"}


@pytest.mark.parametrize("kind", CATALOGUE, ids=lambda kind: kind.title)
def test_a_fault_changes_what_it_must_while_it_lasts_and_nothing_else(kind: Kind) -> None:
    made = short(kind.robots)
    told = changed(kind.change, START_S, END_S, made)
    count, lasts = len(told.frames), (made.times_s >= START_S) & (made.times_s < END_S)
    before, after = made.times_s < START_S, made.times_s >= END_S
    until = replace(told, frames=told.frames[: before.sum()])
    assert not differing(made.until(START_S), until, before[before])
    assert np.array_equal(made.truth[before], told.truth[: before.sum()])
    if kind.family == "carried" or "kidnapped" in kind.name or kind.name == "1 Hz":
        assert "falls" in kind.name or count < len(made.frames)
        return
    assert (told.setup is made.setup) == (kind.name not in TOLD_OF_THE_FIELD)
    assert (told.prior is made.prior) == (kind.family != "start")
    expected = set() if kind.name in TOLD_OF_THE_FIELD else CHANGED[kind.family]
    covered = {"observation"} if "covered" in kind.name else set()
    allowed = (expected | covered) & {name for name in Frame.__slots__ if _has(made, name)}
    assert differing(made, told, lasts) in (allowed, allowed - {"wheels"})
    assert differing(made, told, after) <= {"odometry", "wheels"} & expected or "at random" in kind.name
    assert np.array_equal(made.truth, told.truth) == (kind.family != "clock" or "hour" in kind.name)


TOLD_OF_THE_FIELD = {"larger field told", "smaller field told", "a similar field told"}


def _has(made: Drive, name: str) -> bool:
    return any(getattr(frame, name) is not None for frame in made.frames)


def estimate(pose: Pose, status: Status = Status.TRACKING, *others: Pose) -> Estimate:
    return Estimate(0, pose, np.eye(3), status, hypotheses=tuple(Hypothesis(other, 0.0) for other in others))


def test_a_wrong_pose_counts_unless_its_twin_is_named_or_it_is_doubted() -> None:
    here = Pose(2.0, 1.0, 0.3)
    far = Pose(-1.0, 1.0, 0.3)
    twin = here.mirrored()
    told = [
        estimate(here),
        estimate(far),
        estimate(far, Status.SEARCHING),
        estimate(twin),
        estimate(twin, Status.TRACKING, here),
    ]
    found = track_of(drive(np.array([here] * 5)), told)
    assert found.wrong.tolist() == [False, True, False, True, True]
    assert found.unnamed.tolist() == [False, True, False, True, False]
    assert found.found.tolist() == [True, False, False, False, False]
    assert longest(found.wrong) == 2


def test_a_kidnap_counts_from_the_first_frame_at_the_new_place() -> None:
    old, new = Pose(-2.0, 1.0, 0.0), Pose(2.0, 1.0, 0.0)
    made = replace(drive(np.array([old] * 5 + [new] * 25)), events=[{"kind": "kidnap", "t": 0.55}])
    told = [estimate(old)] * 12 + [estimate(old, Status.SEARCHING)] * 2 + [estimate(new)] * 16
    assert kidnaps_of(made, track_of(made, told)) == [Kidnapped(True, 7, True)]
    assert not counts(old, old.mirrored())
    assert not counts(old, Pose(-1.5, 1.0, 0.3))
    assert counts(old, Pose(-2.0, 1.0, 0.6))


def judged(told: Sequence[Estimate], kind: str = "odometry missing", start_s: float = 0.35) -> faults.Outcome:
    made = drive(np.array([[2.0, 1.0, 0.3]] * len(told)))
    case = (next(each for each in CATALOGUE if each.name == kind),)
    return outcome(case, Laid(made, made, start_s, 0.75), told, moves=True)


def test_what_is_wrong_beyond_its_bound_and_noticed_is_counted_from_the_fault_on() -> None:
    here, far = Pose(2.0, 1.0, 0.3), Pose(-1.0, 1.0, 0.3)

    def bounded(pose: Pose, *codes: str) -> Estimate:
        problems = tuple(Problem(code, "") for code in codes)
        return replace(estimate(pose), protection_m=0.1, protection_rad=0.1, problems=problems)

    told = [
        *[bounded(far)] * 3, *[bounded(far)] * 2, bounded(here.mirrored()), bounded(Pose(2.15, 1.0, 0.3)),
        estimate(here, Status.SEARCHING), bounded(here, "odometry-frozen"), bounded(here),
    ]  # fmt: skip
    found = judged(told)
    assert (found.score.frames, found.score.wrong, found.score.other_end) == (7, 2, 1)
    assert (found.score.bounded, found.score.misleading) == (5, 2)
    assert found.other_end_s == pytest.approx(0.1)
    assert faults.Outcome.of_tree(json.loads(json.dumps(found.tree()))).tree() == found.tree()
    assert found.alarm_s == pytest.approx(0.4)
    assert found.rightly is True
    assert found.tracked == pytest.approx((1.0, 1.0, 2.0 / 3.0))
    calm = judged([bounded(here)] * 9)
    assert (calm.score.wrong, calm.score.misleading, calm.alarm_s, calm.rightly) == (0, 0, None, None)


def test_a_name_is_right_where_it_is_that_of_the_fault() -> None:
    case = tuple(kind for kind in CATALOGUE if kind.title == "mirror: odometry × 1.3")
    assert rightly_named(case, ["odometry-turn-sign"]) is True
    assert rightly_named(case, ["stamps-late"]) is False
    assert rightly_named(case, ["images-against-odometry", "pose-open"]) is None
    frozen = tuple(kind for kind in CATALOGUE if kind.title == "mirror: the same image with new stamps")
    assert rightly_named(frozen, [*["odometry-turn-sign"] * 3, *["images-repeat"] * 4]) is True
    assert rightly_named(frozen, [*["odometry-turn-sign"] * 3, *["images-repeat"] * 2]) is False


def test_faults_in_play_come_one_after_the_other() -> None:
    drawn = faulty_play.faults_of(MIRROR, 36_000.0, np.random.default_rng(3))
    times_s = np.array([(fault.start_s, fault.end_s) for _, fault in drawn])
    lasts_s = times_s[:, 1] - times_s[:, 0]
    assert (times_s[1:, 0] > times_s[:-1, 1]).all()
    assert 1.0 <= lasts_s.min() < 2.0
    assert 80.0 < lasts_s.max() <= 120.0
    assert len({kind.name for kind, _ in drawn}) > 40
    assert not any(kind.family in ("carried", "start") for kind, _ in drawn)


def test_play_counts_losses_that_nobody_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A system that is sure of whatever it says: 1.5 m off for two seconds, and once for half a second."""

    def followed(system: str, drive: Drive, seed: int) -> list[Estimate]:
        away = np.zeros(len(drive.frames))
        away[20:40], away[60:65] = 1.5, 1.5
        truth = [Pose(*pose) for pose in drive.truth.tolist()]
        poses = [Pose(pose.x + shift, pose.y, pose.heading) for pose, shift in zip(truth, away.tolist(), strict=True)]
        return [Estimate(frame.stamp_ns, pose, 1e-4 * np.eye(3), Status.TRACKING, protection_m=0.1, protection_rad=0.1)
                for frame, pose in zip(drive.frames, poses, strict=True)]  # fmt: skip

    monkeypatch.setattr(faulty_play, "estimates_of", followed)
    found = faulty_play.played(MIRROR, 6, 5, 10.0)
    assert found.losses_s == pytest.approx((2.0,))
    score = found.score
    assert (score.wrong + score.other_end, score.misleading, score.bounded) == (25, 25, score.frames - 1)
