"""One trial: settings, run over every recording or scenario, and what its errors cost."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from touchline.config import Settings, leaves, load_settings, settings_from_mapping, settings_rows, settings_tree
from touchline.errors import InputError
from touchline.evaluation.metrics import associate
from touchline.evaluation.runner import robot_setup
from touchline.geometry import FloatArray, wrap_angles
from touchline.messages import did_you_mean
from touchline.motion import FrameOrder
from touchline.perception.covered import is_covered
from touchline.sources import Truth, is_recording, open_source
from touchline.systems import RobotSetup, open_system, system_info
from touchline.systems.ordered import OrderedSystem
from touchline.types import Frame, Status
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

Value = float | int | bool | str
_EXAMPLE = "expected KEY=LOW:HIGH, KEY=LOW:HIGH:log or KEY=A,B,C"


@dataclass(frozen=True, slots=True)
class Dimension:
    """One setting: numbers from low to high (log: by their logarithm), whole ones if `whole`, or one of `choices`."""

    key: str
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    whole: bool = False
    choices: tuple[Value, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        if self.choices:
            return {"key": self.key, "choices": list(self.choices)}
        return {"key": self.key, "low": self.low, "high": self.high, "log": self.log, "whole": self.whole}


def dimension_from_text(text: str, model: type[Settings]) -> Dimension:
    """KEY=LOW:HIGH, KEY=LOW:HIGH:log or KEY=A,B,C of a system's settings. Raises InputError for anything else."""
    key, equals, values = (part.strip() for part in text.partition("="))
    if not (key and equals and values):
        raise InputError(f"--search {text}: {_EXAMPLE}")
    known = {row[0]: row[1] for row in settings_rows(model)}
    if key not in known:
        meant = did_you_mean(key, list(known), alike=0.7)
        hint = f"{meant} " if meant.startswith("did you mean") else ""
        raise InputError(f"--search {text}: there is no setting '{key}'; {hint}touchline systems NAME lists them")
    if ":" in values:
        return _range(text, key, values.split(":"), known[key], model)
    choices = tuple(_taken(text, key, one, model) for one in values.split(","))
    if len(set(choices)) < 2:
        raise InputError(f"--search {text}: one value leaves nothing to search; {_EXAMPLE}")
    return Dimension(key, choices=choices)


def _range(text: str, key: str, parts: list[str], default: Any, model: type[Settings]) -> Dimension:
    if len(parts) not in (2, 3) or (len(parts) == 3 and parts[2] != "log"):
        raise InputError(f"--search {text}: {_EXAMPLE}")
    if isinstance(default, bool) or not isinstance(default, int | float):
        raise InputError(f"--search {text}: '{key}' is no number; give the values to choose from: {key}=A,B")
    ends = [_taken(text, key, part, model) for part in parts[:2]]
    try:
        low, high = (float(end) for end in ends)
    except ValueError:
        raise InputError(f"--search {text}: {_EXAMPLE}") from None
    log = len(parts) == 3
    if not (math.isfinite(low) and math.isfinite(high) and low < high) or (log and low <= 0.0):
        raise InputError(f"--search {text}: LOW has to be below HIGH{', and above 0 for log' if log else ''}")
    return Dimension(key, low, high, log, whole=isinstance(default, int))


def _taken(text: str, key: str, value: str, model: type[Settings]) -> Value:
    """What a setting makes of a value. Raises InputError if it takes none such."""
    try:
        loaded: Any = load_settings(model, None, [f"{key}={value}"])
    except InputError as error:
        raise InputError(f"--search {text}: {error}") from None
    return value_at(loaded, key)


def value_at(settings: Settings, key: str) -> Value:
    """The value of a dotted key, as users write it (`paper.` first)."""
    value = leaves(settings_tree(settings))[key]
    return value if isinstance(value, float | int | bool | str) else str(value)


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
