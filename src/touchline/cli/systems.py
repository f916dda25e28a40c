"""`touchline systems`: what can be run, and with which settings."""

from typing import Annotated, Any

import typer

from touchline.cli.console import output, plain_table, say

_WIDE, _WIDTH_OF_MEANINGS = 400, 20  # characters


def systems(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="Show this system's settings.")] = None,
) -> None:
    """List the systems, or one system's settings with their defaults."""
    from touchline.systems import DEFAULT_SYSTEM, SYSTEMS, system_info

    if name is None:
        marks = {DEFAULT_SYSTEM: " (default)"}
        rows = ((f"{info.name}{marks.get(info.name, '')}", info.description) for info in SYSTEMS.values())
        table = plain_table("system", "what it is", rows=rows, numbers_from=None)
        table.columns[0].no_wrap = True
        output().print(table, soft_wrap=False)
        say("touchline systems NAME: the settings of one; touchline run --system NAME runs it", style="dim")
        return
    from touchline.config import settings_rows

    info = system_info(name)
    settings = ((key, shown_value(default), description) for key, default, description in settings_rows(info.settings))
    table = plain_table("setting", "default", "what it means", rows=settings)
    table.columns[0].no_wrap, table.columns[2].justify = True, "left"
    console = output()
    console.print(f"{info.name}: {info.description}")
    least = console.measure(table, options=console.options.update(width=_WIDE)).minimum + _WIDTH_OF_MEANINGS
    console.width = max(console.width, least)  # a setting's name is for typing: rather let the terminal break a line
    console.print(table, soft_wrap=False)
    say("touchline run --set KEY=VALUE changes one; none is written null", style="dim")


def shown_value(value: Any) -> str:
    """A setting's value as people write it."""
    if value is None or isinstance(value, bool):
        return {None: "none", True: "true", False: "false"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)
