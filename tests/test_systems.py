"""What holds of every system: how it is built, and that it takes whatever a frame brings."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from touchline.camera import OmniCamera
from touchline.field import open_field
from touchline.geometry import Pose
from touchline.motion.compass import COMPASS_FALSE
from touchline.published.nubot.belief import Belief
from touchline.published.nubot.global_localizer import Localization
from touchline.published.nubot.matcher import Match
from touchline.published.nubot.pose_filter import PoseFilter
from touchline.systems import SYSTEMS, LocalizationSystem, RobotSetup, open_system
from touchline.types import Frame, Prior, Status
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

every_system = pytest.mark.parametrize("name", SYSTEMS)
MAX_STEP = 15


def opened(name: str) -> LocalizationSystem:
    return open_system(name, RobotSetup(open_field("indoor-9x6")))


def statement_lines(function: Callable[..., object]) -> int:
    """Lines of a function's body without docstring, comments and empty lines."""
    text = textwrap.dedent(inspect.getsource(function))
    definition = ast.parse(text).body[0]
    assert isinstance(definition, ast.FunctionDef)
    body = definition.body[1:] if ast.get_docstring(definition) else definition.body
    lines = text.splitlines()[body[0].lineno - 1 :]
    return sum(bool(line.strip()) and not line.strip().startswith("#") for line in lines)


@every_system
def test_a_system_is_composed_and_inherits_nothing(name: str) -> None:
    assert type(opened(name)).__mro__[1:] == (object,)


@every_system
def test_a_step_is_a_list_of_at_most_fifteen_lines(name: str) -> None:
    assert statement_lines(type(opened(name)).step) <= MAX_STEP


@pytest.mark.parametrize("level", ["points", "images", "neither"])
@pytest.mark.parametrize("name", [name for name, info in SYSTEMS.items() if OmniCamera in info.cameras])
def test_a_system_takes_frames_with_points_with_images_and_with_neither(name: str, level: str) -> None:
    scenario = open_scenario("tour-20", 1, 0.5, ["ideal=true"])
    run = Simulation(scenario, level="images" if level == "images" else "points")
    setup = RobotSetup(run.field, run.camera if level == "images" else None, run.wheel_directions_rad)
    made = open_system(name, setup)
    frames = [Frame(frame.stamp_ns) if level == "neither" else frame for frame in run]
    estimates = [made.step(frame) for frame in frames]
    assert [estimate.stamp_ns for estimate in estimates] == [frame.stamp_ns for frame in frames]
    assert (estimates[-1].points > 0) == (level != "neither")
    unmoved = level != "neither" and estimates[-1].reason == "not yet confirmed by motion"
    assert (estimates[-1].status is Status.SEARCHING and not unmoved) == (level == "neither")
    assert (made.detector is None) == (level != "images")
    assert all(np.isfinite(estimate.covariance).all() for estimate in estimates)


@every_system
def test_poses_hold_plain_floats(name: str) -> None:
    """Of NumPy's scalars some JSON writers, and `is True` after a comparison, make something else."""
    run = Simulation(open_scenario("tour-20", 1, 0.5, ["ideal=true"]), level="points")
    made = open_system(name, RobotSetup(run.field, None, run.wheel_directions_rad))
    frames = (replace(frame, observation=replace(run.features(k), points=run.points(k))) for k, frame in enumerate(run))
    poses = [each.pose for frame in frames for one in [made.step(frame)] for each in (one, *one.hypotheses)]
    assert {type(value) for pose in poses for value in pose} == {float}


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
def test_compass_own_half_or_an_asymmetric_field_tell_the_end_of_the_field(
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
def test_a_compass_that_agreed_with_a_told_pose_tells_the_end_from_then_on(prior: Prior | None, trusted: bool) -> None:
    belief = Belief(symmetric=True, unknown=UNKNOWN)
    belief.reset(prior)
    belief.take(found(kept=prior is not None), 0.3)
    belief.lose(compass_trusted=trusted)
    belief.take(found(), 0.3)
    told = prior is not None and trusted
    assert belief.twin_probability == (0.0 if told else COMPASS_FALSE)


def test_a_pose_that_was_kept_says_nothing_new_of_the_end_of_the_field() -> None:
    belief = Belief(symmetric=True, unknown=UNKNOWN)
    belief.reset(Prior(HERE))
    belief.take(found(kept=True), None)
    assert belief.twin_probability == 0.0
