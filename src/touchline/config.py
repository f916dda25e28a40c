"""Settings: pydantic trees with the paper's values as defaults; defaults < file < --set KEY=VALUE."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from touchline.errors import InputError


class Settings(BaseModel):
    """Base of every settings tree: frozen, and an unknown key is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False)


_SAID = 4  # mistakes told at once
_ALIKE = 0.7  # share of letters in which a word has to agree with the one that was meant
SettingsT = TypeVar("SettingsT", bound=Settings)


def load_settings(
    model: type[SettingsT],
    file: Path | None = None,
    overrides: Sequence[str] = (),
    section: str | None = None,
    elsewhere: Mapping[str, type[Settings]] | None = None,
) -> SettingsT:
    """Settings from the defaults, then a YAML file (or one section of it), then `a.b=value` overrides.

    elsewhere: other settings by the name of what they belong to, for whoever mixes them up.
    Raises InputError with the nearest known key for an unknown one, and for a value that does not fit.
    """
    tree = read_yaml_mapping(file) if file is not None else {}
    if section is not None:
        tree = tree[section]
    for item in overrides:
        key, separator, text = item.partition("=")
        if not separator or not key.strip():
            known, default, _ = next(row for row in settings_rows(model) if isinstance(row[1], int | float))
            raise InputError(f"--set {item}: expected KEY=VALUE, for example --set {known}={default}")
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise InputError(f"--set {item}: the value is not readable ({error})") from None
        _put(tree, key.strip().split("."), value, item)
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        given = [item.partition("=")[0].strip() for item in overrides]
        in_file = file is not None and not all(_is_about(problem, given) for problem in error.errors())
        raise InputError((f"{file}: " if in_file else "") + _explain(model, error, elsewhere or {})) from None


def read_yaml_mapping(path: Path) -> dict[str, Any]:
    """A YAML file whose top level is a mapping; InputError names the file and line of what is wrong."""
    try:
        loaded = yaml.load(path.read_text(encoding="utf-8"), Loader=_YAML_LOADER)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not a text file") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark is not None else ""
        raise InputError(f"{path}{line}: is not valid YAML ({getattr(error, 'problem', error)})") from None
    if loaded is None:
        return {}
    if not isinstance(loaded, dict):
        raise InputError(f"{path}: expected keys and values at the top level, found a {type(loaded).__name__}")
    return loaded


_YAML_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def settings_rows(model: type[Settings], prefix: str = "") -> Iterator[tuple[str, Any, str]]:
    """Each leaf setting as (dotted key, default, description), in the order of the tree."""
    for name, info in model.model_fields.items():
        key = f"{prefix}{name}"
        if isinstance(info.annotation, type) and issubclass(info.annotation, Settings):
            yield from settings_rows(info.annotation, f"{key}.")
        else:
            yield key, info.get_default(call_default_factory=True), info.description or ""


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """A sentence that names the nearest known words, or all of them."""
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"did you mean '{near[0]}'?" if near else f"known: {', '.join(sorted(known))}"


def _put(tree: dict[str, Any], path: list[str], value: Any, item: str) -> None:
    for part in path[:-1]:
        tree = tree.setdefault(part, {})
        if not isinstance(tree, dict):
            raise InputError(f"--set {item}: '{part}' is a value, not a group of settings")
    tree[path[-1]] = value


def _explain(model: type[Settings], error: ValidationError, elsewhere: Mapping[str, type[Settings]]) -> str:
    known = [key for key, _, _ in settings_rows(model)]
    sentences = []
    for problem in error.errors():
        key = ".".join(str(part) for part in problem["loc"])
        if problem["type"] == "extra_forbidden":
            nearest = _nearest_key(key, [*known, *_keys_beside(model, problem)])
            owners = [name for name, other in elsewhere.items() if _has_key(other, key)]
            sentences.append(
                f"setting '{key}' belongs to {' and '.join(owners)}, not to the chosen system"
                if owners
                else f"unknown setting '{key}': {nearest}"
            )
        elif problem["type"] == "value_error":  # from a check of our own, which says it all
            sentences.append(f"{key}: {problem['ctx']['error']}" if key else str(problem["ctx"]["error"]))
        elif problem["type"] == "model_type":
            inside = sorted({other[len(key) + 1 :].split(".")[0] for other in known if other.startswith(f"{key}.")})
            sentences.append(f"'{key}' is a group of settings, not a value{': ' * bool(inside)}{', '.join(inside)}")
        else:
            sentences.append(f"setting '{key}': {problem['msg'].lower()} (got {problem['input']!r})")
    more = f"; and {len(sentences) - _SAID} more mistakes" if len(sentences) > _SAID else ""
    return "; ".join(sentences[:_SAID]) + more


def _is_about(problem: ErrorDetails, given: Sequence[str]) -> bool:
    """Whether a mistake is one of the overrides', not of the file's."""
    key = ".".join(str(part) for part in problem["loc"])
    return any(f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.") for other in given) and bool(key)


def _has_key(model: type[Settings], key: str) -> bool:
    """Whether it is the key of a setting, or of a group of them."""
    return any(f"{known}.".startswith(f"{key}.") for known, _, _ in settings_rows(model))


def _keys_beside(model: type[Settings], problem: ErrorDetails) -> list[str]:
    """The keys that an entry of a list may have, where the unknown one stands in such an entry."""
    *parents, _ = problem["loc"]
    annotation: Any = model
    for part in parents:
        if isinstance(part, int):
            annotation = get_args(annotation)[0] if get_args(annotation) else None
        elif isinstance(annotation, type) and issubclass(annotation, Settings):
            annotation = annotation.model_fields[str(part)].annotation
    inside = any(isinstance(part, int) for part in parents)
    if not (inside and isinstance(annotation, type) and issubclass(annotation, Settings)):
        return []
    return [".".join(map(str, (*parents, name))) for name in annotation.model_fields]


def _nearest_key(key: str, known: Sequence[str]) -> str:
    """Whatever the key may stand for: a neighbour spelt alike, the same leaf elsewhere, or all of its group."""
    parent, _, leaf = key.rpartition(".")
    start = f"{parent}." if parent else ""
    neighbours = sorted({other[len(start) :].split(".")[0] for other in known if other.startswith(start)})
    if near := difflib.get_close_matches(leaf, neighbours, n=1, cutoff=_ALIKE):
        return f"did you mean '{start}{near[0]}'?"
    leaves = {other.rpartition(".")[2]: other for other in reversed(known)}
    if near := difflib.get_close_matches(leaf, leaves, n=1, cutoff=_ALIKE):
        return f"did you mean '{leaves[near[0]]}'?"
    return f"known{f' in {parent}' if parent else ''}: {', '.join(neighbours)}"
