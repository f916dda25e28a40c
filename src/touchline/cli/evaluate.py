"""`touchline evaluate`, `touchline compare`: the error table of a run; runs of one recording side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from touchline.cli.console import output as console
from touchline.cli.console import plain_table, print_errors, warn
from touchline.cli.options import FollowLinks
from touchline.files.new import check_new_file, write_new_file


def evaluate(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a run, or a trajectory.tum.")],
    truth: Annotated[Path | None, typer.Option(help="True poses in TUM format (default: the recording's).")] = None,
    skip: Annotated[int, typer.Option(min=0, metavar="N", help="Leave out the first N frames.")] = 0,
    follow_links: FollowLinks = False,
) -> None:
    """Print the error table: mean, median, standard deviation, maximum of x, y, position (cm) and heading (°)."""
    from touchline.evaluation import Run
    from touchline.evaluation import evaluate as errors_of

    if run.is_dir() and (incomplete := Run(run).incomplete):
        warn(f"warning: {run}: {incomplete}")
    print_errors(errors_of(run, truth, skip, follow_links))


# --- compare ----------------------------------------------------------------------------------------------------------


def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN RUN...", help="Folders of two to six runs.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="PAGE.html", help="A new page with paths and curves.")
    ] = None,
) -> None:
    """Put runs of one recording side by side: errors, what differs in their settings, where they part.

    touchline compare runs/match-1 runs/match-2 -o compared.html
    """
    from touchline.evaluation.compare import COLUMNS, comparison_page, parting_lines
    from touchline.evaluation.compare import compare as compared_runs

    if output is not None:
        check_new_file(output, (".html", ".htm"), "a page")
    compared = compared_runs(runs)
    rows = ((name, *values) for name, values in compared.figures())
    out = console()
    out.print(plain_table("run", *COLUMNS, rows=rows, overflow="fold"), soft_wrap=False)
    if compared.why_no_truth:
        out.print(f"no errors: {compared.why_no_truth}", style="dim")
    differing = [(key, *values) for key, values in compared.differing_settings()]
    table = plain_table("what differs", *(one.name for one in compared.runs), rows=differing, overflow="fold")
    out.print(table if differing else "settings, seeds and versions are the same", soft_wrap=False)
    for line in parting_lines(compared):
        out.print(line)
    if output is not None:
        write_new_file(output, comparison_page(compared).encode(errors="replace"))
        out.print(f"page: {output}")
