"""`touchline tune`: settings searched over recordings or scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.console import announce_compiling, errors_console, output, plain_table, say
from touchline.cli.options import DaskAddress, WorkerCount
from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline_lab.tuning import Score, Search, Trial
    from touchline_lab.tuning.result import Judged

_CM = 100.0


def tune(
    names: Annotated[
        list[str], typer.Argument(metavar="RECORDING|SCENARIO...", help="Recordings that hold the truth, or scenarios.")
    ],
    search: Annotated[
        list[str],
        typer.Option(
            "--search", metavar="KEY=LOW:HIGH", help="What to search; also KEY=LOW:HIGH:log, KEY=A,B,C. Repeatable."
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="The search's folder; one that exists goes on.")
    ],
    system: Annotated[str | None, typer.Option(help="The system (default: touchline).")] = None,
    trials: Annotated[int, typer.Option(min=2, metavar="N", help="How many settings are tried.")] = 40,
    seeds: Annotated[int, typer.Option(min=1, metavar="N", help="Runs with other chance on each.")] = 1,
    seconds: Annotated[float | None, typer.Option(min=1.0, help="Of each scenario.")] = None,
    judged_on: Annotated[
        list[str] | None,
        typer.Option("--judge", metavar="RECORDING", help="Others, on which the winner is judged. Repeatable."),
    ] = None,
    config: Annotated[Path | None, typer.Option(help="YAML file of the settings that stay.")] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="One of the settings that stay; repeatable.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same trials.")] = 0,
    together: Annotated[int, typer.Option(min=1, max=256, metavar="N", help="Trials that are proposed at once.")] = 4,
    workers: WorkerCount = None,
    dask: DaskAddress = None,
) -> None:
    """Search settings over recordings or scenarios: which ones cost the smallest errors?

    touchline tune match -o tuned --system nubot-mti --search matching.c_m=0.1:0.5 --judge other_match

    An image costs its error in m, its heading's in rad added, 1 m at most; one that is not tracked costs 1 m.
    """
    from touchline.evaluation.workers import open_workers
    from touchline.systems import system_info
    from touchline_lab.experiments.harness import check_writable
    from touchline_lab.tuning import Search, Task, dimension_from_text, tasks_on
    from touchline_lab.tuning import tune as search_for
    from touchline_lab.tuning.result import judge, write_results
    from touchline_lab.tuning.search import JOURNAL, best_of, optuna_library
    from touchline_lab.tuning.trial import base_of

    optuna_library()
    name = system_info(system or "touchline").name
    model = system_info(name).settings
    dimensions = tuple(dimension_from_text(text, model) for text in search)
    if len({one.key for one in dimensions}) < len(dimensions):
        raise InputError("--search: one key twice")
    task = Task("", name, base_of(name, config, settings or ()), seconds=seconds)
    asked = Search(tuple(tasks_on(names, seeds, task)), dimensions, seed, together)
    others = tasks_on(judged_on or (), seeds, task)
    if {one.on for one in others} & {one.on for one in asked.tasks}:
        raise InputError("--judge: the winner was found on these; it has to be judged on others")
    check_writable(output)
    console = errors_console()
    with announce_compiling(console.print), open_workers(workers, dask) as hands, _Progress(trials) as progress:
        tried = search_for(asked, output / JOURNAL, trials, hands, progress.take)
        best = tried[best_of(tried)]
        judged = judge(judged_on or (), others, best.values, hands) if others and best.values else None
    _tell(asked, tried, judged, bool(others))
    for path in write_results(output, asked, tried, judged):
        console.print(f"written: {path}")


class _Progress:
    """How many trials are done, and the best cost; a line on the terminal."""

    def __init__(self, total: int) -> None:
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        words = TextColumn("best {task.fields[best]}")
        self._bar = Progress(BarColumn(), MofNCompleteColumn(), words, TimeRemainingColumn(), console=errors_console())
        self._task = self._bar.add_task("trials", total=total, best="–")
        self._best_m = float("inf")

    def __enter__(self) -> _Progress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def take(self, trial: Trial) -> None:
        """One trial more."""
        self._best_m = min(self._best_m, trial.cost_m)
        self._bar.update(self._task, advance=1, best=f"{_CM * self._best_m:.2f} cm")


def _tell(search: Search, trials: list[Trial], judged: Judged | None, wanted: bool) -> None:
    """The best settings, what they cost, and what that is worth."""
    from touchline_lab.tuning.search import best_of
    from touchline_lab.tuning.trial import mean_score

    best = trials[best_of(trials)]
    found = [("found on these: as they are", trials[0].scores), ("found on these: the best", best.scores)]
    rows = [_row(title, mean_score(scores)) for title, scores in found if scores is not None]
    if judged is not None:
        rows += [_row("judged on others: as they are", judged.before), _row("judged on others: the best", judged.best)]
    output().print(plain_table("", "cost (cm)", "tracked (%)", "error (cm)", rows=rows, no_wrap=True))
    if not best.values:
        say("nothing better was found than the settings as they are", style="yellow")
        return
    say(*(f"{key}: {value}" for key, value in best.values))
    if judged is not None and judged.better:
        say("better on recordings that the search has not seen, too", style="green")
    elif judged is not None:
        say("not better on the others: keep the settings as they are", style="yellow")
    elif not wanted:
        what = "found on these recordings, and so better there than anywhere else: judge it on others (--judge)"
        say(what, style="yellow")


def _row(title: str, score: Score) -> tuple[str, ...]:
    return title, f"{_CM * score.cost_m:.3f}", f"{100.0 * score.tracked:.1f}", f"{_CM * score.mean_m:.3f}"
