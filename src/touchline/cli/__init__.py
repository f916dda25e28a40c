"""The `touchline` command: one file per command group. Nothing heavy is imported before a command needs it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated

import typer

from touchline.cli import calibrate, check, evaluate, experiment, fields, locate, run, simulate, systems, view
from touchline.cli.compile import compile_loops
from touchline.cli.console import DEBUG_VARIABLE, complain
from touchline.cli.run import INTERRUPTED
from touchline.errors import TouchlineError

app = typer.Typer(
    help="Tells a soccer robot where it stands on the field, from the white lines it sees.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("demo")(run.demo)
app.command("run")(run.run)
app.command("locate")(locate.locate)
app.command("evaluate")(evaluate.evaluate)
app.command("check")(check.check)
app.command("view")(view.view)
app.command("simulate")(simulate.simulate)
app.command("experiment")(experiment.experiment)
app.command("systems")(systems.systems)
app.command("compile")(compile_loops)
app.add_typer(fields.fields_app, name="fields")
app.add_typer(calibrate.calibrate_app, name="calibrate")

# Click's errors, wherever this version of Typer keeps Click: beside it, or inside itself.
_CLICK_EXCEPTION: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"touchline {version('touchline')}")
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[
        bool, typer.Option("--debug", envvar=DEBUG_VARIABLE, help="Show the traceback of an unexpected error.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    if debug:
        os.environ[DEBUG_VARIABLE] = "1"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line (default: that of the process). Returns the exit status.

    0: done. 1: the run failed. 2: bad arguments or input. 130: interrupted. Errors go to stderr in one message.
    """
    given = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    try:
        status = typer.main.get_command(app).main(given, prog_name="touchline", standalone_mode=False)
        sys.stdout.flush()
    except TouchlineError as error:
        return _complain(str(error), error.exit_status)
    except _CLICK_EXCEPTION as error:
        return _complain(_usage_message(error), 2)
    except (KeyboardInterrupt, typer.Abort):
        return _complain("interrupted", INTERRUPTED)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        _drop_output()
        return 0
    except OSError as error:
        if os.environ.get(DEBUG_VARIABLE):
            raise
        _drop_output()
        return _complain(f"{error.filename or 'the output'}: {error.strerror or error}", 1)
    except Exception as error:
        if os.environ.get(DEBUG_VARIABLE):
            raise
        said = f"{type(error).__name__}: {error}"
        return _complain(f"unexpected {said} (touchline --debug {' '.join(given)} shows the traceback)", 1)
    if status == INTERRUPTED:  # Typer's word for a Ctrl-C
        return _complain("interrupted", INTERRUPTED)
    return status if isinstance(status, int) else 0


def _drop_output() -> None:
    """Send what stdout still holds nowhere, so that Python doesn't try again at its end."""
    with suppress(OSError, ValueError):  # a stdout that is no file needs nothing
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _usage_message(error: Exception) -> str:
    """One line of what is wrong with the arguments, and where to read on."""
    said = str(getattr(error, "format_message", lambda: error)()).strip()
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "touchline"
    return f"{said if said.endswith(('.', '?', '!')) else said + '.'} See {command} --help"


def _complain(message: str, status: int) -> int:
    complain(message)
    return status
