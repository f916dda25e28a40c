"""`touchline bench suite | export | score`: the open benchmark, for systems of ours and for any program."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.console import announce_compiling, errors_console, output, plain_table, say, steps_shown
from touchline.cli.workers import DaskAddress, WorkerCount
from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline.experiments.benchmark.suite import Entry, Suite

_QUICK = 10  # --quick takes one robot in so many
_WIDTH = 200

SuiteName = Annotated[str, typer.Argument(metavar="SUITE", help="touchline-bench-1, or a suite's YAML file.")]
Robots = Annotated[int | None, typer.Option(min=1, metavar="N", help="Robots of each row (default: the suite's, 30).")]
FirstRobot = Annotated[
    int | None,
    typer.Option("--first-seed", min=0, metavar="N", help="First of them (default: those for judging, 100)."),
]
OnlyRows = Annotated[
    list[str] | None, typer.Option("--rows", metavar="TEXT", help="Only rows whose name holds it; repeatable.")
]
ResultsFile = Annotated[
    Path, typer.Option("--output", "-o", metavar="FILE", help="The file of results; one that exists goes on.")
]
Quick = Annotated[bool, typer.Option("--quick", help="A tenth of the robots.")]


def suite(
    name: SuiteName,
    system: Annotated[
        list[str],
        typer.Option("--system", metavar="NAME", help="A system; NAME:paper for its paper's form. Repeatable."),
    ],
    results: ResultsFile = Path("results.jsonl"),
    robots: Robots = None,
    first_robot: FirstRobot = None,
    rows: OnlyRows = None,
    quick: Quick = False,
    workers: WorkerCount = 1,
    dask: DaskAddress = None,
) -> None:
    """Run systems over a suite, score them, and keep every drive's figures in a file: an interrupted run goes on.

    touchline bench suite touchline-bench-1 --system touchline --quick
    """
    from touchline.evaluation.workers import open_workers
    from touchline.experiments.benchmark.runs import PAPER, run_suite
    from touchline.systems import paper_settings, system_info

    for each in system:
        system_info(each.removesuffix(PAPER))
        if each.endswith(PAPER):
            paper_settings(each.removesuffix(PAPER))
    of, entries = _entries(name, robots, first_robot, rows, quick)
    with announce_compiling(errors_console().print), open_workers(workers, dask) as hands:
        _follow(run_suite(of, entries, system, results, hands), len(entries))
    _tell(of, results)


def export(
    name: SuiteName,
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where the inputs go, a recording for each drive.")],
    robots: Robots = None,
    first_robot: FirstRobot = None,
    rows: OnlyRows = None,
    quick: Quick = False,
    mcap: Annotated[bool, typer.Option("--mcap", help="Write each as an MCAP file, too (extra bags).")] = False,
) -> None:
    """Write a suite's inputs without truth, for any program: folders of CSV, and MCAP if asked."""
    from touchline.experiments.benchmark.runs import export as export_entry

    _, entries = _entries(name, robots, first_robot, rows, quick)
    if not folder.parent.is_dir():
        raise InputError(f"{folder}: cannot be made; {folder.parent} is no folder")
    with steps_shown("writing", len(entries), compiles=True) as advance:
        for entry in entries:
            inputs = export_entry(entry, folder, mcap)
            say(f"{entry.name} {inputs}" if inputs else f"{entry.name}: the public recording {entry.row.recording}")
            advance()


def score(
    name: SuiteName,
    answers: Annotated[
        list[Path],
        typer.Argument(metavar="RESULTS...", help="Folders, one a program: ENTRY.csv or ENTRY.tum of each drive."),
    ],
    results: ResultsFile = Path("results.jsonl"),
    robots: Robots = None,
    first_robot: FirstRobot = None,
    rows: OnlyRows = None,
    quick: Quick = False,
    workers: WorkerCount = 1,
    dask: DaskAddress = None,
) -> None:
    """Score the poses that a program has written for exported inputs; the folder's name is the program's."""
    from touchline.evaluation.workers import open_workers
    from touchline.experiments.benchmark.runs import score_answers

    of, entries = _entries(name, robots, first_robot, rows, quick)
    for folder in answers:
        if not folder.is_dir():
            raise InputError(f"{folder}: is no folder of results; expected one with ENTRY.csv or ENTRY.tum in it")
        known = {path.stem for path in folder.iterdir() if path.suffix in (".csv", ".tum")}
        chosen = [entry for entry in entries if entry.name in known]
        if not chosen:
            hint = f"expected names as {entries[0].name}.csv"
            raise InputError(f"{folder}: holds no result of {of.name}; {hint}")
        with announce_compiling(errors_console().print), open_workers(workers, dask) as hands:
            _follow(score_answers(of, chosen, folder.resolve(), results, hands), len(chosen))
        if len(chosen) < len(entries):
            errors_console().print(f"{folder}: {len(chosen)} of {len(entries)} drives have a result", style="yellow")
    _tell(of, results)


def _entries(
    name: str, robots: int | None, first: int | None, rows: list[str] | None, quick: bool
) -> tuple[Suite, list[Entry]]:
    """The suite, and the entries that are asked for."""
    from touchline.experiments.benchmark.suite import open_suite

    suite = open_suite(name)
    begin, end = suite.judging
    count = robots or max((end - begin) // (_QUICK if quick else 1), 1)
    entries = list(suite.entries(begin if first is None else first, count))
    kept = [entry for entry in entries if rows is None or any(text in entry.row.name for text in rows)]
    if not kept:
        raise InputError(f"--rows {', '.join(rows or ())}: no row's name holds it; known: {', '.join(_names(suite))}")
    return suite, kept


def _names(suite: Suite) -> list[str]:
    return [row.name for row in suite.rows]


def _follow(done: Iterator[int], total: int) -> None:
    """A bar for what goes on."""
    with steps_shown("drives", total) as advance:
        before = 0
        for number in done:
            for _ in range(number - before):
                advance()
            before = number


def _tell(suite: Suite, results: Path) -> None:
    """The tables of a file of results."""
    from rich.console import Console

    from touchline.experiments.benchmark.leaderboard import COLUMNS, detail, leaderboard, systems_of
    from touchline.experiments.benchmark.runs import by_row, read_results

    _, found = read_results(results)
    table = by_row(found, suite)
    terminal = output()
    wide = terminal if terminal.is_terminal else Console(highlight=False, width=_WIDTH)
    for system in systems_of(table):
        say(f"\n{system}", style="bold")
        wide.print(plain_table(*COLUMNS, rows=detail(suite, table, system), numbers_from=2))
    say(f"\n{suite.name}: cost (cm) of an image, mean over rows; time of an update in reference loops; memory (MB)")
    titles = ("system", "mirror", "update", "MB", "humanoid", "update", "MB")
    wide.print(plain_table(*titles, rows=leaderboard(suite, table)))
    say(f"written: {results}", style="dim")
