"""`--view` and `--rrd`: the interactive viewer, in a window, in a browser, in a file."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from touchline.cli import INTERRUPTED
from touchline.cli.console import errors_console, say
from touchline.cli.interrupts import interruptible
from touchline.errors import InputError, TouchlineError

if TYPE_CHECKING:
    from touchline.view.viewer import Screen

_VIEW, _WINDOW, _WEB = "--view", "window", "web"
_LOOK_S = 0.2

ShowIn = Annotated[
    str | None, typer.Option(_VIEW, metavar="[web]", help="Show it in the viewer: a window, or a browser (extra view).")
]
KeepIn = Annotated[
    Path | None, typer.Option("--rrd", metavar="FILE.rrd", help="Keep what the viewer shows, for later.")
]


class ViewCommand(TyperCommand):
    """A command whose `--view` may stand alone: it is a window then."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As Click does it, which wants a value behind each option."""
        whole = [
            f"{_VIEW}={_WINDOW}" if arg == _VIEW and after not in (_WEB, _WINDOW) else arg
            for arg, after in pairwise([*args, ""])
        ]
        return super().parse_args(ctx, whole)


@contextmanager
def shown_in(view: str | None, rrd: Path | None, stays: bool = True) -> Iterator[Screen | None]:
    """Within it the screen takes frames; None if nobody looks. stays: a page in a browser is served on until Ctrl-C.

    Raises InputError where Rerun is missing and for options that are wrong, TouchlineError if no viewer starts.
    """
    if view is None and rrd is None:
        yield None
        return
    if view is not None and rrd is not None:
        raise InputError("--view and --rrd exclude each other: the viewer itself can save what it shows")
    from touchline.view.viewer import open_screen

    screen = open_screen(view, rrd)
    if screen.url is not None:
        errors_console().print(f"the viewer is at {screen.url}")
    begun, watched = True, stays
    try:
        yield screen
    except InputError:
        begun = False
        raise
    except TouchlineError as error:
        watched = stays and error.exit_status != INTERRUPTED
        raise
    except KeyboardInterrupt:  # before the run began
        watched = False
        raise
    finally:
        _finish(screen, rrd if begun else None, begun and watched)
        if rrd is not None and not begun:
            rrd.unlink()


def _finish(screen: Screen, rrd: Path | None, wanted: bool) -> None:
    """Hand all on. A page is served until Ctrl-C, if it is wanted."""
    screen.finish()
    if rrd is not None:
        say(f"for the viewer: {rrd} (rerun {rrd} opens it)")
    if screen.url is not None and wanted:
        errors_console().print("Ctrl-C ends the viewer")
        with interruptible() as stop:
            while not stop():
                threading.Event().wait(_LOOK_S)
    screen.close()
