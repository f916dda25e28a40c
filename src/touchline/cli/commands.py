"""All commands, mounted: one file per command group. Nothing heavy is imported before a command needs it."""

import os
import sys
import warnings
from typing import Annotated, Any

import typer

from touchline.cli import (
    calibrate,
    check,
    convert,
    evaluate,
    fields,
    live,
    locate,
    run,
    season,
    systems,
    view,
)
from touchline.cli.compile import compile_loops
from touchline.cli.console import DEBUG_VARIABLE, warn
from touchline.cli.plugin_commands import CommandGroup
from touchline.packed_loops import take_packed_loops

app = typer.Typer(
    cls=CommandGroup,
    help="Tells a soccer robot where it stands on the field, from the white lines it sees.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("demo")(run.demo)
app.command("run")(run.run)
app.command("season")(season.season)
app.command("locate")(locate.locate)
app.command("evaluate")(evaluate.evaluate)
app.command("compare")(evaluate.compare)
app.command("check")(check.check)
app.command("view")(view.view)
app.command("convert")(convert.convert)
app.command("live")(live.live)
app.command("play")(live.play)
app.command("systems")(systems.systems)
app.command("compile")(compile_loops)
app.add_typer(fields.fields_app, name="fields")
app.add_typer(calibrate.calibrate_app, name="calibrate")

# Click's errors, wherever this version of Typer keeps Click: beside it, or inside itself.
CLICK_EXCEPTION: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


def _show_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        typer.echo(f"touchline {version('touchline')}")
        raise typer.Exit


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    warn(str(message))


@app.callback()
def _options(
    debug: Annotated[
        bool, typer.Option("--debug", envvar=DEBUG_VARIABLE, help="Show the traceback of an unexpected error.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    warnings.showwarning = _show_warning
    if debug:
        os.environ[DEBUG_VARIABLE] = "1"
    if not {"-h", "--help"} & set(sys.argv):  # which needs no Numba
        take_packed_loops()
