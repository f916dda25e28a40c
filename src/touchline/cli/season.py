"""`touchline season`: many recordings in, a run folder for each and a table of all out."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from touchline.cli.console import errors_console, say, steps_shown
from touchline.cli.options import (
    BagBase,
    BagCamera,
    BagField,
    BagLate,
    ConfigFile,
    DaskAddress,
    FollowLinks,
    FromZero,
    Overrides,
    OwnHalf,
    Preset,
    Seed,
    SystemName,
    Topics,
    WorkerCount,
    bag_options,
)
from touchline.compiling import load_loops_lean
from touchline.errors import TouchlineError
from touchline.messages import counted

if TYPE_CHECKING:
    from touchline.season.table import Row


def season(
    recordings: Annotated[
        list[str],
        typer.Argument(metavar="RECORDING...", help="Recordings, folders that hold some, addresses."),
    ],
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="FOLDER", help="Folder or address for the runs and the table.")
    ],
    system: SystemName = None,
    own_half: OwnHalf = False,
    config: ConfigFile = None,
    settings: Overrides = None,
    preset: Preset = None,
    seed: Seed = 0,
    follow_links: FollowLinks = False,
    topics: Topics = None,
    field: BagField = None,
    camera: BagCamera = None,
    base: BagBase = None,
    late: BagLate = 0.0,
    from_zero: FromZero = False,
    report: Annotated[Literal["all", "failed", "none"], typer.Option(help="Which runs get a report.")] = "all",
    workers: WorkerCount = None,
    dask: DaskAddress = None,
) -> None:
    """Localise many recordings: a run folder for each, and a table with a row for each, runs.csv.

    The same command resumes a season that was cut off: what has a row in the table is not done again.
    """
    from touchline.evaluation.workers import open_workers
    from touchline.season import Command, find_recordings, localize_all
    from touchline.systems import DEFAULT_SYSTEM

    bag = bag_options(topics, field, camera, base, late, from_zero).to_dict()
    file = None if config is None else str(config.resolve())
    name, given = system or DEFAULT_SYSTEM, tuple(settings or ())
    command = Command(name, file, given, preset, own_half, seed, follow_links, bag, report)
    found = find_recordings(recordings)
    count = min(workers or os.cpu_count() or 1, len(found))
    load_loops_lean()
    with steps_shown("recordings", len(found), compiles=True) as advance, open_workers(count, dask) as hands:

        def on_row(row: Row, left: int) -> None:
            advance(completed=len(found) - left)
            errors_console().print(line_of(row))

        rows = localize_all(found, output, command, hands, on_row)
    failed = [row for row in rows if row["failure"]]
    say(f"{counted(len(rows), 'recording')}, {len(failed)} failed: {output}")
    if failed:
        raise TouchlineError(f"{counted(len(failed), 'recording')} failed, the first: {line_of(failed[0])}")


def line_of(row: Row) -> str:
    """A recording's row as a line of text."""
    if row["failure"]:
        return f"{row['run']}: failed: {row['failure']}"
    tracked = 100.0 * row["tracking"] / max(row["images"], 1)
    words = f"{row['run']}: {counted(row['images'], 'image')}, {tracked:.0f} % tracked"
    error_m = row.get("tracked_position_mean_m") or row.get("position_mean_m")
    words += "" if error_m is None else f", {100.0 * error_m:.1f} cm"
    if open_images := row["end_open_images"]:
        words += f"; in {open_images} the other end of the field fits as well"
    return f"{words}; {row['notices']}" if row["notices"] else words
