"""What the commands print: results and tables on stdout, progress, warnings and complaints on stderr."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from touchline.compiling import leave_out_c_wrappers

if TYPE_CHECKING:
    from touchline.evaluation import ErrorTable

DEBUG_VARIABLE = "TOUCHLINE_DEBUG"
_MIN_COLUMNS, _USUAL_COLUMNS, _PIPE_WIDTH = 20, 80, 400  # columns of a terminal
_LINE_EVERY_S = 10.0


class _Output(Console):
    def on_broken_pipe(self) -> None:
        """Tell `main`, instead of ending the process from here."""
        raise BrokenPipeError


def output() -> Console:
    """The console for results: plain text where it is not a terminal, long lines unbroken.

    Raises BrokenPipeError if its reader has gone.
    """
    console = _Output(highlight=False, soft_wrap=True, markup=False)
    if console.width < _MIN_COLUMNS:  # COLUMNS=0, as some services have it, left tables without columns
        console.width = _USUAL_COLUMNS
    return console


def wide_output() -> Console:
    """The same; where it is no terminal, so wide that each row of a table is one line, for grep."""
    console = output()
    if not console.is_terminal:
        console.width = _PIPE_WIDTH
    return console


def print_json(tree: Any) -> None:
    """A result for programs."""
    typer.echo(json.dumps(tree, indent=2, ensure_ascii=False))


def say(*lines: str, style: str | None = None) -> None:
    """Lines of a result."""
    for line in lines:
        output().print(line, style=style)


def errors_console() -> Console:
    """The console for progress and complaints."""
    return Console(stderr=True, highlight=False, soft_wrap=True, markup=False)


def complain(message: str) -> None:
    """One message on stderr."""
    errors_console().print(Text.assemble(("error: ", "bold red"), message))


def warn(message: str) -> None:
    """Something that the user should know, on stderr."""
    errors_console().print(message, style="yellow")


def plain_table(
    *titles: str, rows: Iterable[Iterable[str | Text]] = (), numbers_from: int | None = 1, **column: Any
) -> Table:
    """A table without lines. numbers_from: the first column of numbers; None: all are words. column: as Rich has it."""
    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    for index, title in enumerate(titles):
        is_number = numbers_from is not None and index >= numbers_from
        table.add_column(title, justify="right" if is_number else "left", **column)
    for row in rows:
        table.add_row(*row)
    return table


@contextmanager
def steps_shown(title: str, total: int, compiles: bool = False) -> Iterator[Callable[..., None]]:
    """A bar on a terminal while something goes on; what to call after every step, or with how many are `completed`.

    compiles: as it may.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    console = errors_console()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(title, total=total)
        with announce_compiling(console.print) if compiles else nullcontext():
            yield lambda *_, **to: progress.update(task, **(to or {"advance": 1}))


@contextmanager
def shown_progress(name: str, begins: str) -> Iterator[Callable[[str], None]]:
    """Shows how far something has come as it is reported: a terminal in one place, else a line every ten seconds."""
    terminal = errors_console()
    said_s = time.monotonic()
    with terminal.status(f"{name}: {begins}") as status:

        def report(progress: str) -> None:
            nonlocal said_s
            status.update(f"{name}: {progress}")
            if not terminal.is_terminal and time.monotonic() - said_s > _LINE_EVERY_S:
                said_s = time.monotonic()
                terminal.print(f"{name}: {progress}")

        yield report


def print_errors(errors: ErrorTable) -> None:
    """The error statistics, cm and degrees, and what was left out of them."""
    from touchline.evaluation.metrics import COLUMNS

    output().print(plain_table("error", *COLUMNS, rows=((name, *values) for name, values in errors.rows())))
    say(*errors.notes(), style="dim")


@contextmanager
def announce_compiling(say: Callable[[str], None]) -> Iterator[None]:
    """Says, once, that the inner loops are being compiled, if they are: that is what a first start waits for."""
    said = False

    def tell(_: Any) -> None:
        nonlocal said
        if not said:
            say("compiling the inner loops, once on this machine: a minute or two (or ahead: touchline compile)")
        said = True

    with on_compiling(tell):
        yield


@contextmanager
def on_compiling(tell: Callable[[Any], None]) -> Iterator[None]:
    """Calls `tell` with what Numba says of each function that it begins to compile."""
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            tell(event.data)

        def on_end(self, event: Any) -> None: ...

    leave_out_c_wrappers()
    with event.install_listener("numba:compile", Listener()):
        yield
