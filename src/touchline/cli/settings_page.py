"""docs/settings.md: every constant with its value, unit and reason, from the settings themselves."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from touchline.config import Settings, settings_rows

_INTRODUCTION = """\
# Settings

Every constant that the papers leave open, and those that they fix, with the value that is used here and why.
A value is changed with `--set KEY=VALUE` or in a YAML file given with `--config`; the file holds the same keys as a
tree, so `matching.c_m` is `c_m` below `matching`. None is written `null`. What a run used is in its `summary.json`.

This page is written by `touchline systems --markdown > docs/settings.md`; a test compares it with the code.
"""
_UNITS = (
    ("_per_m", "1/m"),
    ("_per_s", "1/s"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_px", "px"),
    ("_s", "s"),
    ("_m", "m"),
)


def settings_page() -> str:
    """The page as Markdown."""
    from touchline.localization.one_shot.locate import LocateSettings
    from touchline.systems import DEFAULT_SYSTEM, SYSTEMS

    sections = [_INTRODUCTION]
    for info in SYSTEMS.values():
        sections.append(f"## {info.name}\n\n{_sentence(info.description)}.\n\n{_table(list(_rows(info.settings)))}")
    shared = set(_rows(SYSTEMS[DEFAULT_SYSTEM].settings))
    own = [row for row in _rows(LocateSettings) if row not in shared]
    about = f"""\
One observation without any history: `touchline locate` and `touchline.locate`. In Python `locate_points` takes them as
`settings`. The groups `matching` and `weights` are those of {DEFAULT_SYSTEM}."""
    return "\n".join([*sections, f"## locate\n\n{about}\n\n{_table(own)}"])


def unit_of(key: str) -> str:
    """The unit that the name of a setting ends with; an en dash where it has none."""
    return next((unit for suffix, unit in _UNITS if key.endswith(suffix)), "–")


def _table(rows: list[str]) -> str:
    return "\n".join(["| setting | value | unit | what it is, and why |", "|---|---:|---|---|", *rows]) + "\n"


def _rows(settings: type[Settings]) -> Iterator[str]:
    for key, default, description in settings_rows(settings):
        unit = unit_of(key)  # which has a column of its own here
        yield f"| `{key}` | {_value(default)} | {unit} | {_sentence(description).replace(f' ({unit})', '')} |"


def _value(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return {None: "none", True: "true", False: "false"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}".replace("|", "\\|")
