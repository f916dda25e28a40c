"""`touchline evaluate`: the error table of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from touchline.cli.console import print_errors, warn
from touchline.cli.options import FollowLinks


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
