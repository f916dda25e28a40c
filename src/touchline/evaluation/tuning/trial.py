"""One trial: settings, run over every recording or scenario, and what its errors cost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from touchline.config import Settings, leaves, load_settings, settings_from_mapping, settings_tree
from touchline.errors import InputError
from touchline.evaluation.metrics import associate
from touchline.evaluation.runner import robot_setup
from touchline.evaluation.tuning.space import Value
from touchline.geometry import FloatArray, wrap_angles
from touchline.motion import FrameOrder
from touchline.perception.covered import is_covered
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.sources import is_recording, open_source
from touchline.sources.source import Truth
from touchline.systems import RobotSetup, open_system, system_info
from touchline.systems.ordered import OrderedSystem
from touchline.types import Frame, Status

MAX_M = 1.0
"""What an image costs at most, and one that is not tracked; a radian of heading costs as much as a metre."""


class Score(NamedTuple):
    """Of a run or the mean of several: cost (m), share of images tracked, mean position error of these (m)."""

    cost_m: float
    tracked: float
    mean_m: float


@dataclass(frozen=True, slots=True)
class Task:
    """One run of a system from nothing. on: the path of a recording, or the name of a scenario.

    base: a whole tree of settings as JSON has it; changes: what differs. seed: of the system, and of a scenario.
    seconds: how long a scenario is; None: as it says.
    """

    on: str
    system: str
    base: tuple[tuple[str, Any], ...] = ()
    changes: tuple[tuple[str, Value], ...] = ()
    seed: int = 0
    seconds: float | None = None


@dataclass(frozen=True, slots=True)
class Trial:
    """Settings that were tried, by key, and the score of each task in order; None where they exclude each other."""

    values: tuple[tuple[str, Value], ...]
    scores: tuple[Score, ...] | None

    @property
    def cost_m(self) -> float:
        """The mean over the tasks; infinite where the settings exclude each other."""
        return float("inf") if self.scores is None else mean_score(self.scores).cost_m


def mean_score(scores: Sequence[Score]) -> Score:
    """Every run counts the same; the error is that of the runs that were tracked at all."""
    costs, tracked, errors = np.array(scores, dtype=np.float64).T
    known = errors[np.isfinite(errors)]
    return Score(float(costs.mean()), float(tracked.mean()), float(known.mean()) if len(known) else float("nan"))


def tasks_on(names: Sequence[str], seeds: int, task: Task) -> list[Task]:
    """A task for each recording or scenario and seed, otherwise as `task`; a recording by its whole path.

    Raises InputError for a recording without true poses and for what is neither.
    """
    tasks = []
    for name in names:
        path = Path(name)
        recorded = path.exists() and is_recording(path)
        if recorded and open_source(path).truth is None:
            raise InputError(f"{name}: holds no true poses (ground_truth.tum) to compare with")
        if not recorded:
            open_scenario(name, 0, task.seconds)
        on = str(path.resolve()) if recorded else name
        tasks += [replace(task, on=on, seed=seed) for seed in range(seeds)]
    return tasks


def base_of(system: str, file: Path | None, overrides: Sequence[str]) -> tuple[tuple[str, Any], ...]:
    """The settings that stay, for tasks. Raises InputError for those that are wrong."""
    return tuple(settings_tree(load_settings(system_info(system).settings, file, overrides)).items())


def settings_of(task: Task) -> Settings:
    """Its settings. Raises InputError where they exclude each other."""
    model = system_info(task.system).settings
    given = leaves(settings_tree(settings_from_mapping(model, dict(task.base))))
    loaded = load_settings(model, None, [f"{key}={_written(value)}" for key, value in task.changes])
    changed = leaves(settings_tree(loaded))
    return settings_from_mapping(model, given | {key: changed[key] for key, _ in task.changes})


def score_of(task: Task) -> Score | None:
    """Run it; None where its settings exclude each other."""
    try:
        chosen = settings_of(task)
    except InputError:
        return None
    frames, truth, setup = _seen(task)
    system = OrderedSystem(open_system(task.system, setup, chosen, np.random.default_rng(task.seed)))
    return scored(frames, truth, system)


def _written(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value) if isinstance(value, float) else str(value)


def _seen(task: Task) -> tuple[Iterable[Frame], Truth, RobotSetup]:
    if not Path(task.on).exists():
        return _simulated(task.on, task.seed, task.seconds)
    source = open_source(task.on)
    assert source.truth is not None
    return source, source.truth, robot_setup(source)


@lru_cache(maxsize=8)
def _simulated(scenario: str, seed: int, seconds: float | None) -> tuple[Sequence[Frame], Truth, RobotSetup]:
    """What a robot sees on the observation level."""
    made = Simulation(open_scenario(scenario, seed, seconds), level="points")
    return list(made), made.truth, RobotSetup(made.field, made.camera, made.wheel_directions_rad)


def scored(frames: Iterable[Frame], truth: Truth, system: OrderedSystem) -> Score:
    """What the estimates of frames cost; black images and those that come late do not count."""
    stamps: list[int] = []
    poses: list[FloatArray] = []
    tracked: list[bool] = []
    for frame in frames:
        estimate = system.step(frame)
        dropped = system.order in (FrameOrder.LATE, FrameOrder.UNCONFIRMED)
        black = frame.image is not None and is_covered(frame.image)
        if dropped or black or (stamps and estimate.stamp_ns <= stamps[-1]):
            continue
        stamps.append(estimate.stamp_ns)
        poses.append(np.array(estimate.pose))
        tracked.append(estimate.status is Status.TRACKING)
    match = associate(np.array(stamps, np.int64), truth.stamp_ns)
    known = match >= 0
    if not known.any():
        return Score(MAX_M, 0.0, float("nan"))
    errors = np.array(poses)[known] - truth.poses[match[known]]
    apart_m, located = np.hypot(errors[:, 0], errors[:, 1]), np.array(tracked)[known]
    cost = np.where(located, np.minimum(apart_m + np.abs(wrap_angles(errors[:, 2])), MAX_M), MAX_M)
    mean_m = float(apart_m[located].mean()) if located.any() else float("nan")
    return Score(float(cost.mean()), float(located.mean()), mean_m)
