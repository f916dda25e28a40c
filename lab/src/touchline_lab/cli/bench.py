"""`touchline bench`: how exact, how sure and how fast a localizer is, on a suite and on point sets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from touchline.cli.console import (
    announce_compiling,
    errors_console,
    output,
    plain_table,
    print_json,
    say,
    steps_shown,
    wide_output,
)
from touchline.cli.options import DaskAddress, TimedWorkers, WorkerCount
from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline_lab.bench.suite import Entry, Suite
    from touchline_lab.points.bench import PointBench

_DEG = 57.29578  # degrees in a radian
_QUICK = 10  # --quick takes one robot in so many

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


bench_app = typer.Typer(
    subcommand_metavar="suite|export|score SUITE | points FILE.npz",
    no_args_is_help=True,
    help="How exact, how sure and how fast: a system or any program on a suite, a localizer on a point set.",
)


@bench_app.command("suite")
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
    workers: TimedWorkers = 1,
    dask: DaskAddress = None,
) -> None:
    """Run systems over a suite, score them, and keep every drive's figures in a file: an interrupted run goes on.

    touchline bench suite touchline-bench-1 --system touchline --quick
    """
    from touchline.evaluation.workers import open_workers
    from touchline.systems import paper_settings, system_info
    from touchline_lab.bench.runs import PAPER, run_suite

    for each in system:
        system_info(each.removesuffix(PAPER))
        if each.endswith(PAPER):
            paper_settings(each.removesuffix(PAPER))
    of, entries = _entries(name, robots, first_robot, rows, quick)
    with announce_compiling(errors_console().print), open_workers(workers, dask) as hands:
        _follow(run_suite(of, entries, system, results, hands), len(entries))
    _tell(of, results)


@bench_app.command("export")
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
    from touchline_lab.bench.runs import export as export_entry

    _, entries = _entries(name, robots, first_robot, rows, quick)
    if not folder.parent.is_dir():
        raise InputError(f"{folder}: cannot be made; {folder.parent} is no folder")
    with steps_shown("writing", len(entries), compiles=True) as advance:
        for entry in entries:
            inputs = export_entry(entry, folder, mcap)
            say(f"{entry.name} {inputs}" if inputs else f"{entry.name}: the public recording {entry.row.recording}")
            advance()


@bench_app.command("score")
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
    workers: WorkerCount = None,
    dask: DaskAddress = None,
) -> None:
    """Score the poses that a program has written for exported inputs; the folder's name is the program's."""
    from touchline.evaluation.workers import open_workers
    from touchline_lab.bench.runs import score_answers

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


@bench_app.command("points")
def points(
    file: Annotated[Path, typer.Argument(metavar="FILE.npz", help="A point set.")],
    system: Annotated[
        str | None, typer.Option(help="touchline (the default), or a system for omnidirectional cameras.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Localise every frame of a point set: from a start, from the compass alone, from nothing.

    Mean errors, how many times the Cramér-Rao bound, share of right poses (20 cm, 5°; from nothing or
    the twin), time.
    """
    from touchline.messages import did_you_mean
    from touchline_lab.points.bench import bench_points
    from touchline_lab.points.localizers import OWN, point_localizer, point_systems
    from touchline_lab.points.point_set import read_point_set

    name = system or OWN
    if name not in point_systems():
        raise InputError(f"--system {name}: {did_you_mean(name, list(point_systems()))}")
    point_set = read_point_set(file)
    with steps_shown("localising", 3 * len(point_set), compiles=True) as advance:
        result = bench_points(point_set, point_localizer(name, point_set.field), advance)
    if json:
        print_json({"name": name, "file": str(file), **result.to_dict()})
        return
    output().print(_point_table(result))
    bound = f"{100.0 * result.bound_position_m:.2f} cm, {_DEG * result.bound_heading_rad:.3f}°"
    say(f"{name} on {file}; the Cramér-Rao bound is {bound}", style="dim")


def _point_table(result: PointBench) -> Table:
    rows = []
    for name, score in (("a start", result.init), ("the compass", result.compass), ("nothing", result.none)):
        position, heading = f"{100.0 * score.mean_position_m:.3f}", f"{_DEG * score.mean_heading_rad:.4f}"
        found, time = f"{100.0 * score.success:.2f}", f"{score.us_per_update:.1f}"
        rows.append((name, position, heading, f"{score.times_bound:.3f}", found, time))
    return _table(rows, "from", "position (cm)", "heading (°)", "× bound", "found (%)", "time (µs)")


def _table(rows: Sequence[Sequence[str]], *titles: str) -> Table:
    narrow = (title.replace(" (", "\n(") for title in titles)  # so that a recording's name has room
    return plain_table(*narrow, rows=rows, overflow="fold")


def _entries(
    name: str, robots: int | None, first: int | None, rows: list[str] | None, quick: bool
) -> tuple[Suite, list[Entry]]:
    """The suite, and the entries that are asked for."""
    from touchline_lab.bench.suite import open_suite

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
        for number in done:
            advance(completed=number)


def _tell(suite: Suite, results: Path) -> None:
    """The tables of a file of results."""
    from touchline_lab.bench.leaderboard import COLUMNS, detail, leaderboard, systems_of
    from touchline_lab.bench.runs import by_row, read_results

    _, found = read_results(results)
    table = by_row(found, suite)
    wide = wide_output()
    for system in systems_of(table):
        say(f"\n{system}", style="bold")
        wide.print(plain_table(*COLUMNS, rows=detail(suite, table, system), numbers_from=2), soft_wrap=False)
    say(f"\n{suite.name}: cost (cm) of an image, mean over rows; time of an update in reference loops; memory (MB)")
    titles = ("system", "mirror", "update", "MB", "humanoid", "update", "MB")
    wide.print(plain_table(*titles, rows=leaderboard(suite, table)), soft_wrap=False)
    say(f"written: {results}", style="dim")
