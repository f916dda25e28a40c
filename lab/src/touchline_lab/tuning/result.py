"""What a search leaves: the best settings as a file for `run --config`, a table of all trials, a picture."""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from touchline.config import leaves, settings_tree, tree_of
from touchline.evaluation.workers import Workers
from touchline.files.new import replace_file
from touchline.palette import BLUE, ORANGE, VERMILLION
from touchline.systems import system_info
from touchline_lab.tuning.search import Search, best_of
from touchline_lab.tuning.trial import Dimension, Score, Task, Trial, mean_score, score_of, settings_of, value_at

BEST, TABLE, PICTURE = "best.yaml", "trials.csv", "trials.png"
_CM = 100.0


class Judged(NamedTuple):
    """Scores on recordings that the search has not seen: of the settings as they were, and of the best."""

    names: tuple[str, ...]
    before: Score
    best: Score

    @property
    def better(self) -> bool:
        """Whether the winner wins there, too."""
        return self.best.cost_m < self.before.cost_m


def judge(names: Sequence[str], tasks: Sequence[Task], values: tuple[tuple[str, Any], ...], workers: Workers) -> Judged:
    """The settings as they were and the best ones on other recordings. tasks: without changes."""
    both = [*tasks, *(replace(task, changes=values) for task in tasks)]
    scores = [score for score in workers.map(score_of, both) if score is not None]
    return Judged(tuple(names), mean_score(scores[: len(tasks)]), mean_score(scores[len(tasks) :]))


def write_results(folder: Path, search: Search, trials: Sequence[Trial], judged: Judged | None) -> list[Path]:
    """best.yaml, trials.csv and trials.png; returns their paths."""
    best = trials[best_of(trials)]
    paths = [folder / name for name in (BEST, TABLE, PICTURE)]
    replace_file(paths[0], best_file(search, best, judged).encode())
    replace_file(paths[1], trials_table(search, trials).encode())
    drawn = io.BytesIO()
    trials_figure(search, trials).savefig(drawn, dpi=110, format="png", metadata={"Software": None})
    replace_file(paths[2], drawn.getvalue())
    return paths


def best_file(search: Search, best: Trial, judged: Judged | None) -> str:
    """A settings file with what differs from the system's own, and where it comes from."""
    task = replace(search.tasks[0], changes=best.values)
    own = leaves(settings_tree(system_info(task.system).settings()))
    best_values = leaves(settings_tree(settings_of(task)))
    tree = tree_of({key: value for key, value in best_values.items() if value != own[key]})
    on = ", ".join(dict.fromkeys(Path(one.on).name for one in search.tasks))
    lines = [f"# {task.system}: the best that touchline tune found on {on}"]
    if judged is None:
        lines.append("# not judged on recordings other than those; do that before you trust it (--judge)")
    else:
        before, after = _CM * judged.before.cost_m, _CM * judged.best.cost_m
        lines.append(f"# judged on {', '.join(judged.names)}: cost {before:.2f} cm before, {after:.2f} cm with it")
    return "\n".join(lines) + "\n" + yaml.safe_dump(tree, sort_keys=False)


def trials_table(search: Search, trials: Sequence[Trial]) -> str:
    """CSV: a row for each trial."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["trial", "cost_m", "tracked", "mean_m", *(one.key for one in search.dimensions)])
    base = settings_of(search.tasks[0])
    for number, trial in enumerate(trials):
        mean = mean_score(trial.scores) if trial.scores is not None else Score(math.nan, math.nan, math.nan)
        values = dict(trial.values) or {one.key: value_at(base, one.key) for one in search.dimensions}
        rows.writerow([number, *(f"{figure:.6f}" for figure in mean), *(values[one.key] for one in search.dimensions)])
    return text.getvalue()


def trials_figure(search: Search, trials: Sequence[Trial]) -> Figure:
    """The cost of every trial in their order, and over each setting that was searched."""
    shown = search.dimensions[:8]
    columns = min(3, 1 + len(shown))
    rows = -(-(1 + len(shown)) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.2 * rows), layout="constrained")
    costs = np.array([_CM * trial.cost_m for trial in trials])
    costs[~np.isfinite(costs)] = np.nan
    first = figure.add_subplot(rows, columns, 1)
    first.plot(costs, ".", color=BLUE, label="a trial")
    first.step(
        np.arange(len(costs)), np.fmin.accumulate(costs), where="post", color=VERMILLION, label="best until then"
    )
    first.axhline(costs[0], color=ORANGE, linestyle="--", label="the settings as they are")
    first.set(xlabel="trial", ylabel="cost (cm)")
    first.legend(fontsize=8)
    for place, one in enumerate(shown, start=2):
        _draw(figure.add_subplot(rows, columns, place), one, trials, costs)
    return figure


def _draw(axes: Axes, one: Dimension, trials: Sequence[Trial], costs: Any) -> None:
    def place(trial: Trial) -> Any:
        value = dict(trial.values)[one.key]
        return str(value) if one.choices else value

    tried = [(trial, cost) for trial, cost in zip(trials, costs, strict=True) if trial.values]
    axes.plot([place(trial) for trial, _ in tried], [cost for _, cost in tried], ".", color=BLUE)
    best = best_of(trials)
    if trials[best].values:
        axes.plot([place(trials[best])], [costs[best]], "o", color=VERMILLION, label="the best")
        axes.legend(fontsize="small")
    axes.set(xlabel=one.key, ylabel="cost (cm)")
    if one.log:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_locator(NullLocator())
