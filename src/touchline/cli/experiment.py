"""`touchline experiment`: the papers' experiments, rerun."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.workers import DaskAddress, WorkerCount

_WIDTH = 200  # where it is no terminal: pages of results are read from files, too
_LINE_EVERY_S = 10.0

if TYPE_CHECKING:
    from rich.table import Table

    from touchline.evaluation.workers import Workers
    from touchline.experiments import Experiment, ExperimentResult


def experiment(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME|all", help="Which experiment.", show_default=False)
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, metavar="N", help="Runs with other chance; the spread is of these.")] = 5,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Where pages and pictures go.")] = Path(
        "results"
    ),
    workers: WorkerCount = 1,
    dask: DaskAddress = None,
    listing: Annotated[bool, typer.Option("--list", help="List the experiments and stop.")] = False,
) -> None:
    """Rerun an experiment of the papers: our figures beside theirs, the picture, a row in DIR/results.md.

    touchline experiment lu2013-kidnap --seeds 5   reruns one. Without a name, the experiments are listed.
    """
    from rich.console import Console

    from touchline.cli.console import output as console
    from touchline.evaluation.workers import open_workers
    from touchline.experiments import EXPERIMENTS, chosen_experiments
    from touchline.experiments.writing import check_writable, write_result

    if listing or name is None:
        for known in EXPERIMENTS.values():
            console().print(f"{known.name:<18} {known.description}", markup=False)
        console().print("touchline experiment NAME reruns one, touchline experiment all every one", style="dim")
        return
    experiments = chosen_experiments(name)
    check_writable(output)
    with open_workers(workers, dask) as hands:
        for chosen in experiments:
            result = _run(chosen, seeds, hands)
            files = write_result(result, output, list(EXPERIMENTS))
            console().print(f"{result.name}: {result.title}; {result.seeds} seeds", style="bold")
            terminal = console()
            wide = terminal if terminal.is_terminal else Console(highlight=False, width=_WIDTH)
            wide.print(_table(result), soft_wrap=False)
            for note in result.notes:
                console().print(note, style="dim", markup=False)
            console().print(f"written: {', '.join(str(path) for path in files)}\n", markup=False)


def _run(chosen: Experiment, seeds: int, workers: Workers) -> ExperimentResult:
    """Run one; a terminal shows how far it has come, anything else gets a line every ten seconds."""
    from touchline.cli.console import errors_console

    console = errors_console()
    said_s = time.monotonic()

    with console.status(f"{chosen.name}: {seeds} seeds") as status:

        def tell(progress: str) -> None:
            nonlocal said_s
            status.update(f"{chosen.name}: {progress}")
            if not console.is_terminal and time.monotonic() - said_s > _LINE_EVERY_S:
                said_s = time.monotonic()
                console.print(f"{chosen.name}: {progress}")

        return chosen.run(seeds, tell, workers)


def _table(result: ExperimentResult) -> Table:
    from rich.table import Table

    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for index, title in enumerate(result.columns):
        table.add_column(title, justify="right" if index else "left", no_wrap=True)
    for row in result.rows:
        table.add_row(*row)
    return table
