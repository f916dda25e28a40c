"""nubot-mcl on the public recordings, under black sectors, and on what may go wrong."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from touchline.config import load_settings
from touchline.field import open_field
from touchline.geometry import Pose
from touchline.published.nubot_mcl.alone import NubotMclAlone, NubotMclAloneSettings
from touchline.published.nubot_mcl.particle_localizer import CONFIRMATIONS, ParticleLocalizer
from touchline.published.nubot_mcl.system import NubotMcl, NubotMclSettings
from touchline.systems import RobotSetup, open_system
from touchline.types import Estimate, Frame, LinePoints, Observation, Prior, Samples, Status

FIELD = open_field("msl-18x12")


# ---- from here on without images: points of a known pose --------------------------------------------------------


def seen_from(pose: Pose, seed: int = 0, reach_m: float = 5.0) -> LinePoints:
    rng = np.random.default_rng(seed)
    robot = pose.inverse().transform(np.concatenate([line[::5] for line in FIELD.polylines()]))
    robot = robot[np.hypot(*robot.T) < reach_m]
    robot = np.concatenate((robot + rng.normal(0, 0.01, robot.shape), rng.uniform(-4, 4, (5, 2))))
    n = len(robot)
    return LinePoints(robot, np.tile(np.eye(2) * 0.02**2, (n, 1, 1)), np.ones(n), np.full((n, 2), np.nan))


def frame(index: int, points: LinePoints, odometry: Pose, compass_rad: float | None) -> Frame:
    stamp = np.array([index * 100_000_000], dtype=np.int64)
    compass = None if compass_rad is None else Samples(stamp, np.array([[compass_rad]]))
    return Frame(
        int(stamp[0]),
        observation=Observation(int(stamp[0]), points),
        odometry=Samples(stamp, np.array([odometry])),
        compass=compass,
    )


def system(*sets: str, prior: Prior | None = None, seed: int = 0) -> NubotMcl:
    settings = load_settings(NubotMclSettings, None, sets)
    made = open_system("nubot-mcl", RobotSetup(FIELD), settings, np.random.default_rng(seed))
    assert isinstance(made, NubotMcl)
    made.reset(prior)
    return made


def alone(*sets: str, prior: Prior | None = None, seed: int = 0) -> NubotMclAlone:
    settings = load_settings(NubotMclAloneSettings, None, sets)
    made = open_system("nubot-mcl-alone", RobotSetup(FIELD), settings, np.random.default_rng(seed))
    assert isinstance(made, NubotMclAlone)
    made.reset(prior)
    return made


def stand(made: NubotMcl | NubotMclAlone, pose: Pose, frames: range, compass_rad: float | None) -> list[Estimate]:
    return [made.step(frame(k, seen_from(pose, k), Pose(0.0, 0.0, 0.0), compass_rad)) for k in frames]


def error_m(estimate: Estimate, pose: Pose) -> float:
    return estimate.pose.distance_to(pose)


def test_figure_3_particles_matching_and_particles_again() -> None:
    here, there = Pose(2.0, 1.0, 0.3), Pose(-5.0, -3.0, -2.0)
    made = system("paper.failure.single_criterion_failure=false", "paper.failure.monitor=false")
    found = stand(made, here, range(10), 0.3)
    assert found[-1].status is Status.TRACKING
    assert error_m(found[-1], here) < 0.02
    after = stand(made, there, range(10, 30), -2.0)
    statuses = [e.status for e in after]
    assert statuses[:4] == [Status.TRACKING] * 4  # the paper's rule: five cycles in a row
    assert after[-1].status is Status.TRACKING
    assert error_m(after[-1], there) < 0.02


def test_a_single_particle_that_was_kidnapped_finds_back() -> None:
    """Its spread is that of a bin: there is something to start anew from."""
    here, there = Pose(2.0, 1.0, 0.3), Pose(-5.0, -3.0, -2.0)
    made = alone("particles.adaptive.enabled=true", "paper.particles.resampling_threshold=1")
    before = stand(made, here, range(20), 0.3)[-1]
    assert len(made.particles.particles) == 1
    assert np.sqrt(np.diag(before.covariance)) == pytest.approx([0.144, 0.144, 0.0756], rel=0.01)
    for k in range(20, 23):
        made.step(frame(k, LinePoints.none(), Pose(0.0, 0.0, 0.0), -2.0))
    after = stand(made, there, range(23, 40), -2.0)[-1]
    assert after.status is Status.TRACKING
    assert error_m(after, there) < 0.1


def test_particles_that_do_not_converge_start_anew_with_wider_headings(monkeypatch: pytest.MonkeyPatch) -> None:
    made = system("particles.converged_m=1e-6", "max_cycles=4")
    widenings: list[float] = []
    restart = made.particles.restart

    def noted(*arguments: Any, widening: float, **named: Any) -> None:
        widenings.append(widening)
        restart(*arguments, widening=widening, **named)

    monkeypatch.setattr(made.particles, "restart", noted)
    estimates = stand(made, Pose(2.0, 1.0, 0.3), range(12), 0.3)
    assert widenings == [1.0, 2.0, 4.0]
    assert all(estimate.status is Status.SEARCHING for estimate in estimates)


@pytest.mark.parametrize("step_m", [0.0, 0.25, 0.6])
def test_a_poor_calibration_is_believed_after_some_starts(step_m: float) -> None:
    """Points 10 % too far: no pose is accepted, but the particles come to the same one again and again."""
    made, step = system(), Pose(step_m, 0.0, 0.0)
    pose, driven = Pose(-6.0, 2.0, 0.3), Pose(0.0, 0.0, 0.0)
    for k in range(8):
        points = seen_from(pose, k)
        far = replace(points, positions_m=1.1 * points.positions_m)
        estimate = made.step(frame(k, far, driven, pose.heading))
        assert estimate.status is (Status.SEARCHING if k < CONFIRMATIONS else Status.TRACKING)
        assert error_m(estimate, pose) < 0.6
        pose, driven = pose.compose(step), driven.compose(step)


def test_frames_without_points_keep_the_search_going_and_break_nothing() -> None:
    made = system()
    for k in range(3):
        estimate = made.step(frame(k, LinePoints.none(), Pose(0.0, 0.0, 0.0), 0.3))
        assert estimate.status is Status.SEARCHING
    assert stand(made, Pose(2.0, 1.0, 0.3), range(3, 10), 0.3)[-1].status is Status.TRACKING


def test_particles_along_a_lone_line_start_anew_later() -> None:
    """The paper's own form, without a search of the whole field, has no such rule."""
    along = np.linspace(-3.0, 3.0, 60)
    line = np.column_stack((along, np.full(60, 1.5) + 0.02 * np.sin(along)))
    corner = np.concatenate((line, line[:, ::-1]))
    given_up: list[int] = []
    seen: list[int] = []
    search = SimpleNamespace(
        reset=lambda: None, give_up=lambda: given_up.append(len(seen)), start_if_due=lambda *_: None,
        cycle=lambda _: seen.append(1), converged=False,
    )  # fmt: skip
    for whole_field, expected in ((object(), [3]), (None, [])):
        localizer = ParticleLocalizer(search, whole_field)  # type: ignore[arg-type]
        given_up.clear()
        seen.clear()
        for points in (corner, line, line, corner, corner):
            localizer.localize(SimpleNamespace(positions_m=points), SimpleNamespace())  # type: ignore[arg-type]
        assert given_up == expected
