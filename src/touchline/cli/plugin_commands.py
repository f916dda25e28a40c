"""Commands that installed packages bring as entry points `touchline.commands`; `--help` imports none of them."""

from functools import cached_property
from importlib.metadata import EntryPoint
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from touchline.errors import InputError
from touchline.plugins import entry_points_of, load, package_of

_LAB = {  # commands of touchline-lab, with their lines of help
    "simulate": "Simulate a robot on a field and write a recording with the true poses.",
    "experiment": "Rerun an experiment of a paper, or one of ours, and print its figures beside the paper's.",
    "bench": "Measure how exact, how sure and how fast a localizer is.",
    "tune": "Search the settings of a system that fit recordings or simulated robots best.",
}


class CommandGroup(TyperGroup):
    """The commands of this package, then those of others, which are imported when they are called."""

    @cached_property
    def others(self) -> dict[str, EntryPoint]:
        """The commands of other packages."""
        return entry_points_of("touchline.commands", self.commands)

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands."""
        return [*super().list_commands(ctx), *self.others]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A command of this package; of another a line of help in its place."""
        if cmd_name in self.commands or cmd_name not in self.others:
            return super().get_command(ctx, cmd_name)
        line = _LAB.get(cmd_name, f"A command of {package_of(self.others[cmd_name])}.")
        return TyperCommand(cmd_name, help=line, callback=None)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Import the command that is called."""
        name = args[0]
        if name in self.commands or name not in (*self.others, *_LAB):
            return super().resolve_command(ctx, args)
        if name not in self.others:
            raise InputError(f"touchline {name} is a command of another package: pip install touchline-lab")
        found = load(self.others[name])
        if found is None:
            raise InputError(f"touchline {name}: {package_of(self.others[name])}, which brings it, cannot be imported")
        return name, _command(name, found), args[1:]


def _command(name: str, found: Any) -> Any:
    """A Typer application as a group of commands, a function as one command."""
    app = found
    if not isinstance(found, typer.Typer):
        app = typer.Typer(
            pretty_exceptions_enable=False,
            rich_markup_mode="rich",
            add_completion=False,
            context_settings={"help_option_names": ["-h", "--help"]},
        )
        app.command(name)(found)
    command = typer.main.get_command(app)
    command.name = name
    return command
