"""The experiment `own`: what is drawn, what counts, and its table."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from touchline.geometry import FloatArray, Pose
from touchline.localization.search.pose_search import Mode
from touchline_lab.experiments import own, own_points
from touchline_lab.experiments.drives import Track
from touchline_lab.experiments.own import COLUMNS, Errors
from touchline_lab.experiments.own_points import SYSTEMS, row


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
