"""`touchline run` with many recordings: a line for each as it is done, and what the tables hold."""

import os
from collections.abc import Sequence

from touchline.cli.console import announce_compiling, errors_console, say
from touchline.compiling import load_loops_lean
from touchline.errors import TouchlineError
from touchline.evaluation.workers import open_workers
from touchline.messages import counted
from touchline.season import Command, find_recordings, localize_all
from touchline.season.tables import RUNS_CSV, Row


def run_all(given: Sequence[str], output: str, command: Command, workers: int | None, dask: str | None) -> None:
    """Localise all recordings that are meant. Raises TouchlineError, at the end, if any failed."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    recordings = find_recordings(given)
    load_loops_lean()
    count = min(workers or os.cpu_count() or 1, len(recordings))
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with (
        Progress(*columns, console=errors_console()) as progress,
        announce_compiling(progress.console.print),
        open_workers(count, dask) as hands,
    ):
        task = progress.add_task("recordings", total=len(recordings))

        def on_row(row: Row, left: int) -> None:
            progress.update(task, completed=len(recordings) - left)
            progress.console.print(line_of(row), markup=False, highlight=False)

        def on_begin(left: int) -> None:
            progress.update(task, completed=len(recordings) - left)

        rows = localize_all(recordings, output, command, hands, on_row, on_begin)
    failed = [row for row in rows if row["failure"]]
    say(f"{counted(len(rows), 'recording')}, {len(failed)} failed: {output}/{RUNS_CSV}")
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
