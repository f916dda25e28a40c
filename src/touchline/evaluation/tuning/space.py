"""Which settings are searched, and between which values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from touchline.config import Settings, leaves, load_settings, settings_rows, settings_tree
from touchline.errors import InputError
from touchline.messages import did_you_mean

Value = float | int | bool | str
_EXAMPLE = "expected KEY=LOW:HIGH, KEY=LOW:HIGH:log or KEY=A,B,C"


@dataclass(frozen=True, slots=True)
class Dimension:
    """One setting: numbers from low to high (log: by their logarithm), whole ones if `whole`, or one of `choices`."""

    key: str
    low: float = 0.0
    high: float = 0.0
    log: bool = False
    whole: bool = False
    choices: tuple[Value, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        if self.choices:
            return {"key": self.key, "choices": list(self.choices)}
        return {"key": self.key, "low": self.low, "high": self.high, "log": self.log, "whole": self.whole}


def dimension_from_text(text: str, model: type[Settings]) -> Dimension:
    """KEY=LOW:HIGH, KEY=LOW:HIGH:log or KEY=A,B,C of a system's settings. Raises InputError for anything else."""
    key, equals, values = (part.strip() for part in text.partition("="))
    if not (key and equals and values):
        raise InputError(f"--search {text}: {_EXAMPLE}")
    known = {row[0]: row[1] for row in settings_rows(model)}
    if key not in known:
        meant = did_you_mean(key, list(known))
        hint = f"{meant} " if meant.startswith("did you mean") else ""
        raise InputError(f"--search {text}: there is no setting '{key}'; {hint}touchline systems NAME lists them")
    if ":" in values:
        return _range(text, key, values.split(":"), known[key], model)
    choices = tuple(_taken(text, key, one, model) for one in values.split(","))
    if len(set(choices)) < 2:
        raise InputError(f"--search {text}: one value leaves nothing to search; {_EXAMPLE}")
    return Dimension(key, choices=choices)


def _range(text: str, key: str, parts: list[str], default: Any, model: type[Settings]) -> Dimension:
    if len(parts) not in (2, 3) or (len(parts) == 3 and parts[2] != "log"):
        raise InputError(f"--search {text}: {_EXAMPLE}")
    if isinstance(default, bool) or not isinstance(default, int | float):
        raise InputError(f"--search {text}: '{key}' is no number; give the values to choose from: {key}=A,B")
    ends = [_taken(text, key, part, model) for part in parts[:2]]
    try:
        low, high = (float(end) for end in ends)
    except ValueError:
        raise InputError(f"--search {text}: {_EXAMPLE}") from None
    log = len(parts) == 3
    if not (math.isfinite(low) and math.isfinite(high) and low < high) or (log and low <= 0.0):
        raise InputError(f"--search {text}: LOW has to be below HIGH{', and above 0 for log' if log else ''}")
    return Dimension(key, low, high, log, whole=isinstance(default, int))


def _taken(text: str, key: str, value: str, model: type[Settings]) -> Value:
    """What a setting makes of a value. Raises InputError if it takes none such."""
    try:
        loaded: Any = load_settings(model, None, [f"{key}={value}"])
    except InputError as error:
        raise InputError(f"--search {text}: {error}") from None
    return value_at(loaded, key)


def value_at(settings: Settings, key: str) -> Value:
    """The value of a dotted key, as users write it (`paper.` first)."""
    value = leaves(settings_tree(settings))[key]
    return value if isinstance(value, float | int | bool | str) else str(value)
