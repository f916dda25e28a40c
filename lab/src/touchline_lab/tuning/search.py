"""The search: batches of trials, proposed by a tree of Parzen estimators (TPE) and kept in a journal.

What is proposed depends on the trials before, on the seed and on how many are proposed at once; not on who computes
them, nor on whether the search was interrupted. So the same search gives the same trials on one core, on many and on a
cluster, in one go or in several.
"""

import importlib
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from touchline.errors import InputError
from touchline.evaluation.workers import Workers
from touchline.files.new import replace_file
from touchline.files.opened import read_text
from touchline_lab.tuning.trial import Dimension, Score, Task, Trial, score_of

JOURNAL = "trials.jsonl"
_MAX_BYTES = 100_000_000


@dataclass(frozen=True, slots=True)
class Search:
    """What is searched: the tasks that each trial runs, the dimensions, the seed, and how many are proposed at once."""

    tasks: tuple[Task, ...]
    dimensions: tuple[Dimension, ...]
    seed: int = 0
    together: int = 4

    def to_dict(self) -> dict[str, Any]:
        """As the journal's first line has it."""
        first = self.tasks[0]
        return {
            "system": first.system,
            "on": list(dict.fromkeys(task.on for task in self.tasks)),
            "seeds": len({task.seed for task in self.tasks}),
            "seconds": first.seconds,
            "search": [dimension.to_dict() for dimension in self.dimensions],
            "settings": dict(first.base),
            "seed": self.seed,
            "together": self.together,
        }


def tune(
    search: Search, journal: Path, count: int, workers: Workers, on_trial: Callable[[Trial], None] = lambda trial: None
) -> list[Trial]:
    """All trials until there are `count`, the first that of the settings as they are.

    journal: trials are read from there, if it exists, and written there batch by batch. on_trial: told of each.
    Raises InputError for the journal of another search, and where Optuna is not installed.
    """
    optuna = optuna_library()
    trials = read_journal(journal, search) if journal.exists() else []
    _keep(journal, search, trials)
    for trial in trials:
        on_trial(trial)
    while len(trials) < count:
        begin = 0 if not trials else 1 + (len(trials) - 1) // search.together * search.together
        proposed = _proposed(optuna, search, trials[:begin])[len(trials) - begin : count - begin]
        batch = list(_tried(search, proposed, workers))
        trials += batch
        _keep(journal, search, trials)
        for trial in batch:
            on_trial(trial)
    return trials


def best_of(trials: Sequence[Trial]) -> int:
    """Which trial cost least, the first of several."""
    return min(range(len(trials)), key=lambda index: trials[index].cost_m)


def read_journal(journal: Path, search: Search) -> list[Trial]:
    """The trials of whole lines. Raises InputError if the journal is that of another search, or none."""
    head, *lines = read_text(journal, _MAX_BYTES).splitlines() or [""]
    try:
        differing = [key for key, value in _as_read(search.to_dict()).items() if json.loads(head).get(key) != value]
        trials = [_trial(json.loads(line)) for line in lines if line.endswith("}")]
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(f"{journal}: is no journal of touchline tune") from None
    if differing:
        raise InputError(f"{journal}: is of another search ({', '.join(differing)} differ); choose another --output")
    return trials


def optuna_library() -> Any:
    """The module `optuna`. Raises InputError where it is not installed."""
    try:
        optuna = importlib.import_module("optuna")
    except ImportError:
        raise InputError("tuning needs Optuna, which is not installed: pip install 'touchline-lab'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def _proposed(optuna: Any, search: Search, trials: Sequence[Trial]) -> list[tuple[tuple[str, Any], ...]]:
    """Values for the next batch, of the trials before alone; the very first are the settings as they are."""
    if not trials:
        return [()]
    ranges = {one.key: _distribution(optuna, one) for one in search.dimensions}
    chance = np.random.SeedSequence([search.seed, len(trials)])
    sampler = optuna.samplers.TPESampler(seed=int(chance.generate_state(1)[0]), constant_liar=True)
    study = optuna.create_study(sampler=sampler)
    for trial in trials:
        if trial.values and math.isfinite(trial.cost_m):
            known = optuna.trial.create_trial(params=dict(trial.values), distributions=ranges, value=trial.cost_m)
            study.add_trial(known)
    asked = [study.ask(ranges) for _ in range(search.together)]
    return [tuple((one.key, trial.params[one.key]) for one in search.dimensions) for trial in asked]


def _distribution(optuna: Any, one: Dimension) -> Any:
    if one.choices:
        return optuna.distributions.CategoricalDistribution(one.choices)
    if one.whole:
        return optuna.distributions.IntDistribution(int(one.low), int(one.high), log=one.log)
    return optuna.distributions.FloatDistribution(one.low, one.high, log=one.log)


def _tried(search: Search, proposed: Sequence[tuple[tuple[str, Any], ...]], workers: Workers) -> Iterator[Trial]:
    tasks = [replace(task, changes=values) for values in proposed for task in search.tasks]
    scores = list(workers.map(score_of, tasks))
    size = len(search.tasks)
    for number, values in enumerate(proposed):
        own = scores[number * size : (number + 1) * size]
        known = tuple(score for score in own if score is not None)
        yield Trial(values, known if len(known) == size else None)


def _keep(journal: Path, search: Search, trials: Sequence[Trial]) -> None:
    lines = [_as_read(search.to_dict())]
    for trial in trials:
        cost_m = trial.cost_m if math.isfinite(trial.cost_m) else None
        lines.append({"values": dict(trial.values), "scores": trial.scores, "cost_m": cost_m})
    text = "".join(json.dumps(line, allow_nan=True) + "\n" for line in lines)
    replace_file(journal, text.encode())


def _trial(line: dict[str, Any]) -> Trial:
    scores = line["scores"]
    return Trial(tuple(line["values"].items()), None if scores is None else tuple(Score(*score) for score in scores))


def _as_read(tree: dict[str, Any]) -> dict[str, Any]:
    """A tree as it comes back from JSON: lists for tuples."""
    return dict(json.loads(json.dumps(tree)))
