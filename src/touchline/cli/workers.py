"""`--workers` and `--dask`: where tasks are computed."""

from __future__ import annotations

from typing import Annotated

import typer

WorkerCount = Annotated[
    int, typer.Option("--workers", min=1, metavar="N", help="So many processes; the numbers are the same.")
]
DaskAddress = Annotated[
    str | None, typer.Option("--dask", metavar="ADDRESS", help="On a Dask cluster (tcp://HOST:PORT; extra tune).")
]
