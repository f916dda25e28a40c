"""What the commands print: error tables in cm and degrees on stdout, complaints on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from touchline.evaluation import ErrorTable

DEBUG_VARIABLE = "TOUCHLINE_DEBUG"
_MIN_COLUMNS, _USUAL_COLUMNS = 20, 80  # columns of a terminal


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


def errors_console() -> Console:
    """The console for progress and complaints."""
    return Console(stderr=True, highlight=False, soft_wrap=True, markup=False)


def complain(message: str) -> None:
    """One message on stderr."""
    errors_console().print(Text.assemble(("error: ", "bold red"), message))


def error_table(errors: ErrorTable) -> Table:
    """The error statistics, cm and degrees."""
    from touchline.evaluation.metrics import COLUMNS

    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("error")
    for title in COLUMNS:
        table.add_column(title, justify="right")
    for name, values in errors.rows():
        table.add_row(name, *values)
    return table


def print_errors(console: Console, errors: ErrorTable) -> None:
    """The error table and what was left out of it."""
    console.print(error_table(errors))
    console.print(errors.left_out(), style="dim")


@contextmanager
def told_of_compiling(say: Callable[[str], None]) -> Iterator[None]:
    """Says, once, that the inner loops are being compiled, if they are: that is what a first start waits for."""
    from numba.core import event

    class Listener(event.Listener):
        told = False

        def on_start(self, event: Any) -> None:
            if not self.told:
                say(
                    "compiling the inner loops, once on this machine: some twenty seconds (or ahead: touchline compile)"
                )
                self.told = True

        def on_end(self, event: Any) -> None: ...

    with event.install_listener("numba:compile", Listener()):
        yield
