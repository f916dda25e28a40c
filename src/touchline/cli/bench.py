"""`touchline bench`: how exact, how sure and how fast a localizer is, on point sets and on recordings."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from typer.core import TyperGroup

from touchline.cli import bench_suite
from touchline.cli.console import announce_compiling, errors_console, output, plain_table, say, steps_shown
from touchline.cli.workers import DaskAddress, WorkerCount
from touchline.errors import InputError

if TYPE_CHECKING:
    from touchline.evaluation.points.bench import PointBench
    from touchline.evaluation.points.point_set import PointSet
    from touchline.evaluation.recordings_bench import RecordingScore

_PIPE_WIDTH = 200
_DEG = 57.29578  # degrees in a radian


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
for command in (bench_suite.suite, bench_suite.export, bench_suite.score):
    bench_app.command(command.__name__)(command)


@bench_app.command("points")
def points(
    file: Annotated[Path, typer.Argument(metavar="FILE.npz", help="A point set.")],
    system: Annotated[
        str | None, typer.Option(help="touchline (the default), or a system for omnidirectional cameras.")
    ] = None,
    program: Annotated[
        str | None, typer.Option(metavar="COMMAND", help="A localizer of your own instead: it answers lines.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Localise every frame of a point set: from a start, from the compass alone, from nothing.

    Mean errors, how many times the Cramér-Rao bound, share of right poses (20 cm, 5°; from nothing or
    the twin), time.
    """
    if system is not None and program is not None:
        raise InputError("--system and --program exclude each other")
    from touchline.evaluation.points.localizers import OWN, point_systems
    from touchline.evaluation.points.point_set import read_point_set
    from touchline.messages import did_you_mean

    name = system or OWN
    if name not in point_systems():
        raise InputError(f"--system {name}: {did_you_mean(name, list(point_systems()))}")
    result = _bench_with_progress(read_point_set(file), name, program)
    if json:
        typer.echo(_as_json({"name": program or name, "file": str(file), **result.to_dict()}))
        return
    output().print(_point_table(result))
    bound = f"{100.0 * result.bound_position_m:.2f} cm, {_DEG * result.bound_heading_rad:.3f}°"
    say(f"{program or name} on {file}; the Cramér-Rao bound is {bound}", style="dim")


@bench_app.command("recordings", hidden=True)
def recordings(
    folders: Annotated[list[Path], typer.Argument(metavar="RECORDING...", help="Recordings that hold the truth.")],
    system: Annotated[str | None, typer.Option(help="The system to run; see touchline systems.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    workers: WorkerCount = 1,
    dask: DaskAddress = None,
) -> None:
    """Run a system on recordings from nothing, and compare its poses with the truth.

    Times per image are those of a busy machine where many workers share one.
    """
    from touchline.evaluation.recordings_bench import bench_recording
    from touchline.evaluation.workers import open_workers
    from touchline.systems import DEFAULT_SYSTEM, system_info

    name = system_info(system or DEFAULT_SYSTEM).name
    with announce_compiling(errors_console().print), open_workers(workers, dask) as hands:
        scores = list(hands.map(partial(bench_recording, system=name), [folder.resolve() for folder in folders]))
    if json:
        typer.echo(_as_json({"system": name, "recordings": [score.to_dict() for score in scores]}))
    else:
        console = output()
        if not console.is_terminal:
            console.width = _PIPE_WIDTH  # one line for each recording
        console.print(_recording_table(scores))


def _bench_with_progress(points: PointSet, name: str, program: str | None) -> PointBench:
    from touchline.evaluation.points.bench import bench_points
    from touchline.evaluation.points.localizers import point_localizer
    from touchline.evaluation.points.outside_program import OutsideProgram

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


def _recording_table(scores: list[RecordingScore]) -> Table:
    rows = []
    for score in scores:
        figures = (score.mean_position_m, score.max_position_m, score.mean_heading_rad, score.max_heading_rad)
        scaled = [f"{scale * value:.2f}" for scale, value in zip((100.0, 100.0, _DEG, _DEG), figures, strict=True)]
        counts = (str(score.images), f"{100.0 * score.tracked:.1f}")
        rows.append((score.name, *counts, *scaled, f"{score.ms_per_image:.2f}"))
    titles = "position (cm)", "largest (cm)", "heading (°)", "largest (°)", "time (ms)"
    return _table(rows, "recording", "images", "tracked (%)", *titles)


def _table(rows: Sequence[Sequence[str]], *titles: str) -> Table:
    narrow = (title.replace(" (", "\n(") for title in titles)  # so that a recording's name has room
    return plain_table(*narrow, rows=rows, overflow="fold")


def _as_json(tree: Any) -> str:
    import json

    return json.dumps(tree, indent=2, ensure_ascii=False)
