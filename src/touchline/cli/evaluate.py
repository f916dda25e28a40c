"""`touchline evaluate`: the error table of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from touchline.cli.options import FollowLinks


def evaluate(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="The folder of a run, or a trajectory.tum.", show_default=False)
    ],
    truth: Annotated[
        Path | None,
        typer.Option(help="True poses in TUM format (default: the recording's).", show_default=False),
    ] = None,
    skip: Annotated[int, typer.Option(min=0, metavar="N", help="Leave out the first N frames.")] = 0,
    follow_links: FollowLinks = False,
) -> None:
    """Print the error table: mean, median, standard deviation, maximum of x, y, position (cm) and heading (°)."""
    from touchline.cli.console import errors_console, output, print_errors
    from touchline.evaluation import Run
    from touchline.evaluation import evaluate as errors_of

    if run.is_dir() and (incomplete := Run(run).incomplete):
        errors_console().print(f"warning: {run}: {incomplete}", style="yellow", markup=False)
    print_errors(output(), errors_of(run, truth, skip, follow_links))
