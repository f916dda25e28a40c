"""`touchline bench`: how exact, how sure and how fast a localizer is, on point sets and on recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from typer.core import TyperGroup

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
from touchline.errors import InputError, TouchlineError
from touchline.messages import counted

if TYPE_CHECKING:
    from touchline.season.bench import BenchRow
    from touchline_lab.bench.suite import Entry, Suite
    from touchline_lab.points.bench import PointBench
    from touchline_lab.points.point_set import PointSet

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
Program = Annotated[
    str | None, typer.Option(metavar="COMMAND", help="A localizer of your own instead: it answers lines.")
]
Quick = Annotated[bool, typer.Option("--quick", help="A tenth of the robots.")]


class _BenchGroup(TyperGroup):
    """A first word that is no subcommand is a recording, for the hidden command `recordings`."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        return super().resolve_command(ctx, args if args[0] in self.commands else ["recordings", *args])


bench_app = typer.Typer(
    cls=_BenchGroup,
    subcommand_metavar="suite|export|score SUITE | points FILE.npz | RECORDING...",
    no_args_is_help=True,
    help="How exact, how sure and how fast: a system on a suite, a point set, or recordings that hold the truth.",
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


def _check_one(system: str | None, program: str | None) -> None:
    if system is not None and program is not None:
        raise InputError("--system and --program exclude each other")


@bench_app.command("points")
def points(
    file: Annotated[Path, typer.Argument(metavar="FILE.npz", help="A point set.")],
    system: Annotated[
        str | None, typer.Option(help="touchline (the default), or a system for omnidirectional cameras.")
    ] = None,
    program: Program = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Localise every frame of a point set: from a start, from the compass alone, from nothing.

    Mean errors, how many times the Cramér-Rao bound, share of right poses (20 cm, 5°; from nothing or
    the twin), time.
    """
    _check_one(system, program)
    from touchline.messages import did_you_mean
    from touchline_lab.points.localizers import OWN, point_systems
    from touchline_lab.points.point_set import read_point_set

    name = system or OWN
    if name not in point_systems():
        raise InputError(f"--system {name}: {did_you_mean(name, list(point_systems()))}")
    result = _bench_with_progress(read_point_set(file), name, program)
    if json:
        print_json({"name": program or name, "file": str(file), **result.to_dict()})
        return
    output().print(_point_table(result))
    bound = f"{100.0 * result.bound_position_m:.2f} cm, {_DEG * result.bound_heading_rad:.3f}°"
    say(f"{program or name} on {file}; the Cramér-Rao bound is {bound}", style="dim")


@bench_app.command("recordings", hidden=True)
def recordings(
    given: Annotated[
        list[str],
        typer.Argument(metavar="RECORDING...", help="Recordings that hold the truth, folders of some, a list.txt."),
    ],
    system: Annotated[str | None, typer.Option(help="The system to run; see touchline systems.")] = None,
    program: Program = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    workers: TimedWorkers = 1,
    dask: DaskAddress = None,
) -> None:
    """Run a system, or a program of your own, on recordings from nothing, and compare its poses with the truth.

    What cannot be compared is a row that says so, and exit status 1 at the end; the others go on.
    """
    from touchline.evaluation.workers import ENDED, open_workers
    from touchline.season import find_recordings
    from touchline.season.bench import BenchRow, BenchTask, bench_row
    from touchline.season.recordings import folder_names
    from touchline.systems import DEFAULT_SYSTEM, system_info

    _check_one(system, program)
    name = system_info(system or DEFAULT_SYSTEM).name
    found = find_recordings(given)
    tasks = [BenchTask(*each) for each in zip(folder_names(found), found, strict=True)]
    done: dict[str, BenchRow] = {}
    with steps_shown("recordings", len(tasks), compiles=True) as advance, open_workers(workers, dask) as hands:
        bench = partial(bench_row, system=name, program=program)
        for row in hands.unordered(bench, tasks, lambda task: BenchRow(task.name, None, ENDED)):
            done[row.name] = row
            advance()
    rows = [done[task.name] for task in tasks]
    failed = [f"{row.name}: failed: {row.failure}" for row in rows if row.failure]
    if json:
        print_json({"system": program or name, "recordings": [row.to_dict() for row in rows]})
    else:
        wide_output().print(_recording_table(rows))
        say(*failed)
    if failed:
        raise TouchlineError(f"{counted(len(failed), 'recording')} failed, the first: {failed[0]}")


def _bench_with_progress(points: PointSet, name: str, program: str | None) -> PointBench:
    from touchline.evaluation.outside_program import OutsideProgram
    from touchline_lab.points.bench import bench_points
    from touchline_lab.points.localizers import point_localizer

    with (
        steps_shown("localising", 3 * len(points), compiles=True) as advance,
        nullcontext() if program is None else OutsideProgram(program, points.field) as outside,
    ):
        localizer = point_localizer(name, points.field) if outside is None else outside
        return bench_points(points, localizer, advance)


def _point_table(result: PointBench) -> Table:
    rows = []
    for name, score in (("a start", result.init), ("the compass", result.compass), ("nothing", result.none)):
        position, heading = f"{100.0 * score.mean_position_m:.3f}", f"{_DEG * score.mean_heading_rad:.4f}"
        found, time = f"{100.0 * score.success:.2f}", f"{score.us_per_update:.1f}"
        rows.append((name, position, heading, f"{score.times_bound:.3f}", found, time))
    return _table(rows, "from", "position (cm)", "heading (°)", "× bound", "found (%)", "time (µs)")


def _recording_table(found: list[BenchRow]) -> Table:
    rows = []
    for name, score, _ in found:
        if score is None:
            rows.append((name, *[""] * 7, "failed"))
            continue
        figures = (score.mean_position_m, score.max_position_m, score.mean_heading_rad, score.max_heading_rad)
        scaled = [f"{scale * value:.2f}" for scale, value in zip((100.0, 100.0, _DEG, _DEG), figures, strict=True)]
        counts = (str(score.images), f"{100.0 * score.tracked:.1f}")
        rows.append((name, *counts, *scaled, f"{score.ms_per_image:.2f}", score.problems))
    titles = "position (cm)", "largest (cm)", "heading (°)", "largest (°)", "time (ms)", "problems"
    return _table(rows, "recording", "images", "tracked (%)", *titles)


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
        before = 0
        for number in done:
            for _ in range(number - before):
                advance()
            before = number


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
