"""The experiment `own`: what is drawn, what counts, and its table."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from touchline.field import open_field
from touchline.field.distances import distances_to_lines
from touchline.geometry import FloatArray, Pose
from touchline.localization.search.pose_search import Mode
from touchline.types import LinePoints, Status
from touchline_lab.experiments import own, own_ablations, own_points
from touchline_lab.experiments.drives import Kidnapped, Track, driven
from touchline_lab.experiments.injections import Fault, unseen
from touchline_lab.experiments.own import COLUMNS, Errors
from touchline_lab.experiments.own_points import OWN, SYSTEMS, VIEWS, row
from touchline_lab.points.point_set import PointSet

FIELD = open_field("msl-18x12")


def test_drawn_points_lie_on_lines_but_for_the_clutter_and_within_the_view() -> None:
    view = own_points.View("", clutter=0.3, angle_rad=np.pi)
    drawn = own_points.drawn_set(view, 30, np.random.default_rng(0))
    assert len(drawn) == 30
    assert drawn.clutter is not None
    false = np.concatenate(drawn.clutter)
    away = np.concatenate(
        [
            distances_to_lines(FIELD.line_tables, Pose(*truth).transform(points.positions_m))
            for truth, points in zip(drawn.truth.tolist(), drawn.points, strict=True)
        ]
    )
    assert false.mean() == pytest.approx(0.3, abs=0.03)
    assert np.quantile(away[~false], 0.95) < 0.2 < np.quantile(away[false], 0.7)
    seen = np.concatenate([points.positions_m for points in drawn.points])
    assert (np.abs(np.arctan2(seen[:, 1], seen[:, 0])) < np.radians(93.0)).all()
    normalised = [
        np.sqrt(points.covariances_m2[~told].trace(axis1=1, axis2=2)).mean()
        for points, told in zip(drawn.points, drawn.clutter, strict=True)
    ]
    assert 0.02 < np.mean(normalised) < 0.15


def test_of_sure_modes_those_that_are_right_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = own_points.drawn_set(own_points.FULL, 4, np.random.default_rng(0))
    right = [Pose(*truth) for truth in drawn.truth.tolist()]

    class Search:
        def __init__(self) -> None:
            self.frame = -1

        def everywhere(self, *_: object) -> tuple[Mode, ...]:
            """Both ends share 0.9; right in all frames but the first."""
            self.frame += 1
            found = Pose(0.0, 0.0, 0.0) if self.frame == 0 else right[self.frame]
            return tuple(
                Mode(pose, 1e-4 * np.eye(3), share, 0.0, 1.0, 1.0)
                for pose, share in ((found, 0.45), (found.mirrored(), 0.45), (Pose(1.0, 1.0, 1.0), 0.1))
            )

    monkeypatch.setattr(own_points, "_search", lambda field: Search())
    found = own_points.kept_modes(drawn)
    assert found[:4] == (0.75, 0.75, 0.75, 0.75)
    np.testing.assert_allclose(found.probabilities, [0.9, 0.1] * 4)  # of each place once
    assert found.is_right.tolist() == [False, False] + [True, False] * 3


def test_the_points_of_a_lone_line_fix_no_place() -> None:
    line = np.column_stack((np.full(30, 2.0), np.linspace(-1.0, 1.0, 30)))
    points = LinePoints(line, np.tile(1e-4 * np.eye(2), (30, 1, 1)), np.ones(30), np.full((30, 2), np.nan))
    poses = np.array([[6.925, 4.4, 0.0]])  # a goal line alone in view
    lone = PointSet("", FIELD, (points,), poses, poses, poses[:, 2], None)
    assert not own_points._is_fixed(lone, 0)
    assert own_points._is_fixed(own_points.drawn_set(own_points.FULL, 1, np.random.default_rng(0)), 0)


def test_a_mode_of_a_lone_line_stands_for_every_place_along_it_and_for_their_twins() -> None:
    mode = Mode(Pose(1.0, 2.0, 0.1), np.diag([9.0, 1e-4, 1e-4]), 0.5, 0.0, 1.0, 1.0)
    along, aside = Pose(4.0, 2.0, 0.1), Pose(1.0, 2.3, 0.1)
    assert own_points._stands_for(mode, along)
    assert own_points._stands_for(mode, along.mirrored())
    assert not own_points._stands_for(mode, aside)
    assert not own_points._is_near(mode.pose, along)


@pytest.fixture
def outcomes() -> Callable[[FloatArray, FloatArray], own.Played]:
    """Play of 40 frames, 0.1 s apart: tracked and flipped where it is told."""

    def played(tracking: FloatArray, flipped: FloatArray) -> own.Played:
        times_s = 0.1 * np.arange(40)
        truth = np.tile((4.0, 0.0, 0.0), (40, 1))
        poses = np.where(flipped[:, np.newaxis] > 0, (-4.0, 0.0, np.pi), (4.1, 0.0, 0.0))
        return own.played_of(Track(times_s, poses, truth, tracking > 0))

    return played


def test_a_flip_counts_while_it_is_called_tracking(
    outcomes: Callable[[FloatArray, FloatArray], own.Played],
) -> None:
    at = np.arange(40)
    found = outcomes(at < 30, at >= 10)
    assert found.flip_s == pytest.approx(2.0)
    assert found.loss_s == pytest.approx(2.0)
    assert found.tracked == 0.75
    assert found.error_m == pytest.approx((10 * 0.1 + 20 * 8.0) / 30)


def test_the_papers_experiments_are_counted_where_we_are_better_than_every_other_system() -> None:
    conditions = [own.Condition(name, papers="one") for name in "ab"]
    runs = {(c.name, system): [Errors(2.0, 2.0, 3.0, 0.1, 100.0, 0)] * 3 for c in conditions for system in SYSTEMS}
    for name, ours in (("a", 1.0), ("b", 1.9)):
        runs[name, OWN] = [Errors(ours + 0.1 * n, ours, 3.0, 0.1, 100.0, 0) for n in range(3)]
    rows = own._paper_rows(conditions, runs)
    assert [each[3] for each in rows] == ["1 of 2; not: b (one)", "2 of 2"]


def test_a_drive_under_a_condition_has_its_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(own, "SECONDS", 4.0)
    drive = own.robot_of(own.Condition("", faults=(Fault("", 1.0, 2.0, unseen),)), 0)
    seen = np.array([0 if frame.observation is None else len(frame.observation.points) for frame in drive.frames])
    hidden = (drive.times_s >= 1.0) & (drive.times_s < 2.0)
    assert (seen[hidden] == 0).all()
    assert np.median(seen[~hidden]) > 50


def test_pictures_are_drawn_of_few_runs() -> None:
    errors = [Errors(1.0, 1.0, 2.0, 0.1, 100.0, 0)]
    own._picture({(condition.name, system): errors for condition in own.CONDITIONS for system in SYSTEMS})
    told = np.linspace(0.0, 1.0, 200)
    kept = own_points.Kept(1.0, 1.0, 1.0, 1.0, told, told > 0.5, 1.0)
    drives = {
        (part.name, condition.name): [own_ablations.Driven(1.0, 2.0, 0.0)]
        for part in own_ablations.PARTS
        for condition in own_ablations.CONDITIONS
    }
    kidnaps = {
        (part.name, view): [own_ablations.Driven(1.0, 2.0, 0.0, [Kidnapped(True, 0, False)])]
        for part in own_ablations.PARTS
        for view in own_ablations.KIDNAP_RUNS
    }
    own_ablations._picture({**drives, **kidnaps})
    own_points.picture(
        own_points.PointRuns({system: [] for system in own_points.BENCHED}, [], {v.name: [kept] for v in VIEWS})
    )


def test_a_system_is_followed_without_each_part() -> None:
    drive = driven("straight-tracks", 0, 4.0)
    for part in own_ablations.PARTS:
        system = own_ablations.without(part, drive, 0)
        away = system.step(drive.frames[0]).pose.distance_to(Pose(*drive.truth[0].tolist()))
        assert away < 0.2
    without = own_ablations.without(own_ablations.PARTS[1], drive, 0)
    without.reset()
    assert all(without.step(frame).status is Status.SEARCHING for frame in drive.frames[:5])


def test_ours_stands_beside_the_best_other_robot_by_robot() -> None:
    first = own.CONDITIONS[0]
    runs = {
        (first.name, system): [Errors(1.0 + k + n, 1.0 + k, 2.0, 0.1, 100.0, n) for n in range(3)]
        for k, system in enumerate(SYSTEMS)
    }
    rows = own._rows(first, runs)
    assert all(len(each) == len(COLUMNS) for each in rows)
    assert rows[0][:4] == (first.title, "mean (cm)", "–", "2.00 [1.00, 3.00]")
    assert rows[0][-1] == "-1.00 [-1.00, -1.00]"
    assert rows[-1][3] == "2"


def test_a_row_has_a_dash_where_nothing_is_told() -> None:
    assert row("a", "b", "c", {"nubot-mcl": "1"}) == ("a", "b", "c", "–", "–", "1", "–", "–")
