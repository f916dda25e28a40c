"""All commands, mounted: one file per command group. Nothing heavy is imported before a command needs it."""

import os
import sys
from typing import Annotated

import typer

from touchline.cli import (
    bench,
    calibrate,
    check,
    convert,
    evaluate,
    experiment,
    fields,
    live,
    locate,
    mark,
    run,
    season,
    simulate,
    systems,
    tune,
    view,
)
from touchline.cli.compile import compile_loops
from touchline.cli.console import DEBUG_VARIABLE
from touchline.cli.viewer import ViewCommand
from touchline.packed_loops import take_packed_loops

app = typer.Typer(
    help="Tells a soccer robot where it stands on the field, from the white lines it sees.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("demo")(run.demo)
app.command("run", cls=ViewCommand)(run.run)
app.command("season")(season.season)
app.command("locate")(locate.locate)
app.command("evaluate")(evaluate.evaluate)
app.command("compare")(evaluate.compare)
app.command("check")(check.check)
app.command("view", cls=ViewCommand)(view.view)
app.command("mark")(mark.mark)
app.command("simulate")(simulate.simulate)
app.command("convert")(convert.convert)
app.command("live", cls=ViewCommand)(live.live)
app.command("play")(live.play)
app.command("experiment")(experiment.experiment)
app.command("tune")(tune.tune)
app.command("systems")(systems.systems)
app.command("compile")(compile_loops)
app.add_typer(bench.bench_app, name="bench")
app.add_typer(fields.fields_app, name="fields")
app.add_typer(calibrate.calibrate_app, name="calibrate")

# Click's errors, wherever this version of Typer keeps Click: beside it, or inside itself.
CLICK_EXCEPTION: type[Exception] = next(c for c in typer.BadParameter.__mro__ if c.__name__ == "ClickException")


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
    if not {"-h", "--help"} & set(sys.argv):  # which needs no Numba
        take_packed_loops()
