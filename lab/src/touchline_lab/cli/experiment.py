"""`touchline experiment`: the papers' experiments, rerun."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.console import plain_table, say, shown_progress, wide_output
from touchline.cli.options import DaskAddress, WorkerCount
from touchline.errors import InputError
from touchline.messages import counted

if TYPE_CHECKING:
    from touchline.evaluation.workers import Workers
    from touchline_lab.experiments import Experiment, ExperimentResult
    from touchline_lab.experiments.harness import Done


def experiment(
    name: Annotated[str | None, typer.Argument(metavar="NAME|all", help="Which experiment.")] = None,
    seeds: Annotated[int, typer.Option(min=1, metavar="N", help="Runs with other chance; the spread is of these.")] = 5,
    first_seed: Annotated[int, typer.Option(min=0, metavar="N", help="First of them.")] = 0,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Where pages and pictures go.")] = Path(
        "results"
    ),
    workers: WorkerCount = None,
    dask: DaskAddress = None,
    part: Annotated[
        str, typer.Option(metavar="REGEX", help="Of faults and play: run those of its tasks that it matches alone.")
    ] = "",
    draw: Annotated[bool, typer.Option("--draw", help="Run nothing: table and pictures of what DIR holds.")] = False,
    budget: Annotated[
        float | None,
        typer.Option(min=0.1, metavar="MINUTES", help="Of each: as many of --seeds as fit, by the time of the first."),
    ] = None,
    listing: Annotated[bool, typer.Option("--list", help="List the experiments and stop.")] = False,
) -> None:
    """Rerun an experiment of the papers: our figures beside theirs, the picture, a row in DIR/results.md.

    touchline experiment lu2013-kidnap --seeds 5   reruns one. Without a name, the experiments are listed.

    faults and play take hours: their results are kept in DIR/NAME.jsonl as they come, and a second run goes on there.
    all takes a night with --seeds 30 --budget 12; begun again it leaves what DIR holds by the same commit.
    """
    from touchline.evaluation.workers import open_workers
    from touchline_lab.experiments import EXPERIMENTS, chosen_experiments
    from touchline_lab.experiments.harness import NOTHING, check_writable, newest_done, note_done

    if listing or name is None:
        for known in EXPERIMENTS.values():
            say(f"{known.name:<18} {known.description}")
        say("touchline experiment NAME reruns one, touchline experiment all every one", style="dim")
        return
    experiments = chosen_experiments(name)
    check_writable(output)
    try:
        re.compile(part)
    except re.error as error:
        raise InputError(f"--part {part}: is no regular expression ({error})") from None
    with open_workers(workers, dask) as hands:
        for chosen in experiments:
            asked, kept = range(first_seed, first_seed + seeds), (output, NOTHING if draw else part)
            if draw or part:
                _show(_run(chosen, asked, hands, kept), output)
                continue
            done = newest_done(output, chosen.name) if name == "all" else None
            if done is not None and done.is_enough(asked, budget):
                say(f"{chosen.name}: done before\n", style="dim")
                continue
            if budget is None:
                _measure(chosen, asked, hands, output)
                continue
            if done is None or done.seeds != asked[:1]:
                done = _measure(chosen, asked[:1], hands, output)
            fit = asked[: max(math.floor(budget / max(done.minutes, 1e-3)) - 1, 1)]  # beside the first
            if fit != done.seeds:
                done = _measure(chosen, fit, hands, output)
            note_done(output, chosen.name, done._replace(budget=budget))


def _measure(chosen: Experiment, seeds: range, workers: Workers, output: Path) -> Done:
    """Run one, show it, and note that it is done."""
    from touchline_lab.experiments.harness import Done, note_done

    begun_s = time.monotonic()
    _show(_run(chosen, seeds, workers, (output, "")), output)
    done = Done(seeds, (time.monotonic() - begun_s) / 60.0)
    note_done(output, chosen.name, done)
    return done


def _show(result: ExperimentResult, output: Path) -> None:
    """Its table, and its page and pictures in a folder."""
    from touchline_lab.experiments import EXPERIMENTS
    from touchline_lab.experiments.harness import write_result

    files = write_result(result, output, list(EXPERIMENTS))
    say(f"{result.name}: {result.title}; {counted(result.seeds, 'seed')}", style="bold")
    wide_output().print(plain_table(*result.columns, rows=result.rows, no_wrap=True), soft_wrap=False)
    say(*result.notes, style="dim")
    say(f"written: {', '.join(str(path) for path in files)}\n")


def _run(chosen: Experiment, seeds: range, workers: Workers, kept: tuple[Path, str]) -> ExperimentResult:
    """Run one and show how far it has come."""
    with shown_progress(chosen.name, f"{len(seeds)} seeds") as report:
        return chosen.run(len(seeds), report, workers, *kept, first_seed=seeds.start)
