"""What installed packages bring: systems, commands, calibrations, compiled loops, by Python's entry points.

A name that is taken twice is reported in one sentence and left out; nothing is imported before it is used.
"""

import warnings
from collections.abc import Container
from importlib.metadata import EntryPoint, entry_points
from typing import Any


class PluginWarning(UserWarning):
    """An installed package brings something that cannot be used."""


def entry_points_of(group: str, own: Container[str] = ()) -> dict[str, EntryPoint]:
    """The entry points of a group by name, those of Touchline itself first, in the order of their packages.

    own: names that Touchline has without an entry point.
    """
    found: dict[str, EntryPoint] = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: not entry.value.startswith("touchline.")):
        if entry.name in own:
            _leave_out(entry, "touchline has the name")
            continue
        first = found.setdefault(entry.name, entry)
        if first.value != entry.value:
            _leave_out(entry, f"{package_of(first)} has the name")
    return found


def package_of(entry: EntryPoint) -> str:
    """The name of the package that brings an entry point."""
    return entry.dist.name if entry.dist is not None else entry.module.partition(".")[0]


def load(entry: EntryPoint, kind: type[Any] | None = None) -> Any:
    """What an entry point leads to; None, and a warning, if it cannot be imported or is not of its kind."""
    try:
        value = entry.load()
    except Exception as error:  # whatever a stranger's module raises
        return _leave_out(entry, f"{type(error).__name__}: {error}")
    if kind is not None and not isinstance(value, kind):
        return _leave_out(entry, f"it is no {kind.__name__}")
    return value


def _leave_out(entry: EntryPoint, why: str) -> None:
    text = f"{entry.group}: '{entry.name}' of {package_of(entry)} is left out: {why}"
    warnings.warn(text, PluginWarning, stacklevel=3)
