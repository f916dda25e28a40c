"""The page of settings: every setting with its value, unit and reason, from the settings themselves."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from touchline.cli.systems import shown_value
from touchline.config import Settings, preset_values, settings_rows, shown_key
from touchline.localization.one_shot.locate import LocateSettings
from touchline.messages import counted
from touchline.systems import SYSTEMS

_INTRODUCTION = """\
# Settings

What may be set, with the value that is used here and why. A value is changed with `--set KEY=VALUE` or in a YAML file
given with `--config`; the file holds the same keys as a tree, so `matching.c_m` is `c_m` below `matching`. None is
written `null`. What a run used is in its `summary.json`.

Settings that several systems share come first; each stands here once. Those under `paper` are switches to the papers'
exact form; the column *paper* has what `--preset paper` makes of each. What nobody has had a
reason to change is a named constant beside its use in the code.

`touchline systems NAME` prints the settings of one system.
"""
_UNITS = (
    ("_per_m", "1/m"),
    ("_per_s", "1/s"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_px", "px"),
    ("_deg", "°"),
    ("_s", "s"),
    ("_m", "m"),
)


class Row(NamedTuple):
    """The cells of a setting. paper: its value in the preset; empty if that leaves it alone."""

    key: str
    value: str
    paper: str
    unit: str
    about: str


def settings_page() -> str:
    """The page as Markdown."""
    infos = list(SYSTEMS.values())
    owners: dict[Row, tuple[str, ...]] = {}  # of each row: the systems that have it
    for info in infos:
        for row in _rows(info.settings):
            owners[row] = (*owners.get(row, ()), info.name)
    sections = [_INTRODUCTION]
    for names in sorted(dict.fromkeys(owners.values()), key=len, reverse=True):
        if len(names) == 1:
            break
        whom = "all systems" if len(names) == len(infos) else f"{', '.join(names[:-1])} and {names[-1]}"
        sections.append(f"## Shared by {whom}\n\n{_table([row for row in owners if owners[row] == names])}")
    for info in infos:
        own = [row for row in owners if owners[row] == (info.name,)]
        table = f"\n{_table(own)}" if own else ""
        sections.append(f"## {info.name}\n\n{_sentence(info.description)}.\n{_count(info.settings)}\n{table}")
    own = [row for row in _rows(LocateSettings) if row not in owners]
    about = """\
One observation without any history: `touchline locate` and `touchline.locate`. In Python `locate_points` takes them as
`settings`. The groups `matching` and `weights` are those of nubot-mti."""
    return "\n".join([*sections, f"## locate\n\n{about}\n\n{_table(own)}"])


def _count(settings: type[Settings]) -> str:
    keys = [key for key, _, _ in settings_rows(settings)]
    switches = sum("paper" in key.split(".") for key in keys)
    paper = f", and {switches} switches under `paper`" if switches > 1 else ", and one switch under `paper`"
    return f"{counted(len(keys) - switches, 'setting')} with the shared ones{paper * bool(switches)}."


def unit_of(key: str) -> str:
    """The unit that the name of a setting ends with; an en dash where it has none."""
    return next((unit for suffix, unit in _UNITS if key.endswith(suffix)), "–")


def _table(rows: list[Row]) -> str:
    """Markdown; the column of the preset only where one of the settings has a value of its own in it."""
    cells = [row if any(each.paper for each in rows) else (row.key, row.value, *row[3:]) for row in rows]
    if cells and len(cells[0]) == len(Row._fields):
        head = ["| setting | value | paper | unit | what it is, and why |", "|---|---:|---:|---|---|"]
    else:
        head = ["| setting | value | unit | what it is, and why |", "|---|---:|---|---|"]
    return "\n".join([*head, *(f"| {' | '.join(row)} |" for row in cells)]) + "\n"


def _rows(settings: type[Settings]) -> Iterator[Row]:
    paper = {shown_key(key): shown_value(value) for key, value in _leaves(preset_values(settings))}
    for key, default, description in settings_rows(settings):
        unit = unit_of(key)  # which has a column of its own here
        about = _sentence(description).replace(f" ({unit})", "").replace(" (degrees)", "")
        yield Row(f"`{key}`", shown_value(default), paper.get(key, ""), unit, about)


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted key and value of each leaf."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}".replace("|", "\\|")
