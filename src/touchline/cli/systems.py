"""`touchline systems`: what can be run, and with which settings."""

from __future__ import annotations

from typing import Annotated

import typer

from touchline.errors import InputError

_WIDE, _WIDTH_OF_MEANINGS = 400, 20  # characters


def systems(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Show this system's settings.", show_default=False)
    ] = None,
    markdown: Annotated[
        bool, typer.Option("--markdown", help="Print every setting of all systems as the page docs/settings.md.")
    ] = False,
) -> None:
    """List the systems, or one system's settings with their defaults."""
    if markdown:
        if name is not None:
            raise InputError(f"--markdown prints all systems on one page: leave out {name}")
        from touchline.cli.settings_page import settings_page

        typer.echo(settings_page(), nl=False)
        return
    from rich.table import Table

    from touchline.cli.console import output
    from touchline.systems import DEFAULT_SYSTEM, SYSTEMS, system_info

    table = Table(box=None, header_style="dim", pad_edge=False, padding=(0, 2, 0, 0))
    if name is None:
        table.add_column("system", no_wrap=True)
        table.add_column("what it is")
        for info in SYSTEMS.values():
            mark = " (default)" if info.name == DEFAULT_SYSTEM else ""
            table.add_row(f"{info.name}{mark}", info.description)
        out = output()
        out.print(table, soft_wrap=False)
        out.print("touchline systems NAME: the settings of one; touchline run --system NAME runs it", style="dim")
        return
    from touchline.config import settings_rows

    info = system_info(name)
    table.add_column("setting", no_wrap=True)
    table.add_column("default", justify="right")
    table.add_column("what it means")
    for key, default, description in settings_rows(info.settings):
        table.add_row(key, _short(default), description)
    console = output()
    console.print(f"{info.name}: {info.description}")
    least = console.measure(table, options=console.options.update(width=_WIDE)).minimum + _WIDTH_OF_MEANINGS
    console.width = max(console.width, least)  # a setting's name is for typing: rather let the terminal break a line
    console.print(table, soft_wrap=False)
    console.print("touchline run --set KEY=VALUE changes one; none is written null", style="dim", markup=False)


def _short(value: object) -> str:
    if value is None:
        return "none"
    return f"{value:g}" if isinstance(value, float) else str(value)
