"""Settings: pydantic trees of a system's parts; defaults < preset < file < --set KEY=VALUE.

What we have added to a paper is switched in the group `paper` of the part that it belongs to. Whoever sets it finds all
of them in one block: `paper.particles.roughening` is `roughening` in the group `paper` of the part `particles`. The
preset `paper` is the value that turns an addition off (`added`).
"""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from touchline.errors import InputError
from touchline.files.yaml_text import YamlError, read_yaml_mapping, yaml_line, yaml_value
from touchline.messages import listed, shown


class Settings(BaseModel):
    """Base of every settings tree: frozen, and an unknown key is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _true_is_no_number(cls, value: Any, info: ValidationInfo) -> Any:
        """In YAML `yes`, `on` and `true` are truths; taken for the number 1 they would hide a mistake."""
        kinds = set(_kinds(cls.model_fields[str(info.field_name)].annotation))
        if _holds_bool(value) and kinds & {int, float} and bool not in kinds:
            raise ValueError(f"a number is wanted, not true or false (got {shown(value)})")
        return value


PAPER = "paper"  # the group of switches, and the preset that turns them all to the paper's form


def added(default: Any, *, paper: Any, description: str, **limits: Any) -> Any:
    """A setting that switches an addition of ours. paper: the value with which the system does what its paper says."""
    return Field(default, json_schema_extra={PAPER: paper}, description=description, **limits)


def _kinds(annotation: Any) -> Iterator[Any]:
    """All types that an annotation names, inside of tuples and unions, too."""
    arguments = get_args(annotation)
    if not arguments:
        yield annotation
    for argument in arguments:
        yield from _kinds(argument)


def _holds_bool(value: Any) -> bool:
    return isinstance(value, bool) or (isinstance(value, list | tuple) and any(_holds_bool(part) for part in value))


_SAID = 4  # mistakes told at once
_ALIKE = 0.7  # share of letters in which a word has to agree with the one that was meant
SettingsT = TypeVar("SettingsT", bound=Settings)


def load_settings(
    model: type[SettingsT],
    file: Path | None = None,
    overrides: Sequence[str] = (),
    section: str | None = None,
    elsewhere: Mapping[str, type[Settings]] | None = None,
    preset: str | None = None,
) -> SettingsT:
    """Settings from the defaults, then a preset, then a YAML file (or one section of it), then `a.b=value` overrides.

    preset: a name under which fields hold another value (`added`). elsewhere: other settings by the name of what they
    belong to, for whoever mixes them up.

    Raises InputError with the nearest known key for an unknown one, and for a value that does not fit, each with its
    line in the file.
    """
    tree = read_yaml_mapping(file) if file is not None else {}
    if section is not None:
        tree = tree[section]
    tree = _handed_out(model, tree)
    changed = set()
    for item in overrides:
        key, value = _read_override(model, item)
        said: dict[str, Any] = {}
        _put(said, key.split("."), value, item)
        for path, each in _values(_handed_out(model, said)):
            _put(tree, list(path), each, item)
            changed.add(path)
    if preset is not None:
        tree = merged(preset_values(model, preset), tree)
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        where = () if section is None else (section,)
        raise InputError(_explain(model, error, file, where, changed, elsewhere or {})) from None


def _read_override(model: type[Settings], item: str) -> tuple[str, Any]:
    """Key and value of `KEY=VALUE`. Raises InputError for what is none."""
    key, separator, text = item.partition("=")
    if not separator or not key.strip():
        numbers = (f"{row[0]}={row[1]}" for row in settings_rows(model) if isinstance(row[1], int | float))
        raise InputError(f"--set {item}: expected KEY=VALUE, for example --set {next(numbers, 'key=1')}")
    try:
        return key.strip(), yaml_value(text)
    except YamlError as error:
        raise InputError(f"--set {item:.200}: the value is not readable ({error.what})") from None


def settings_from_mapping(model: type[SettingsT], changes: Mapping[str, Any]) -> SettingsT:
    """Settings from the defaults and what differs: a tree of groups, or keys with dots (`{"matching.c_m": 0.3}`).

    Raises InputError with the nearest known key for an unknown one, and for a value that does not fit.
    """
    try:
        return model.model_validate(_handed_out(model, tree_of(changes)))
    except ValidationError as error:
        raise InputError(f"settings: {_explain(model, error, None, (), set(), {})}") from None


def settings_rows(model: type[Settings]) -> Iterator[tuple[str, Any, str]]:
    """Each leaf setting as (dotted key, default, description): in the order of the tree, the block `paper` last."""
    rows = [(shown_key(key), info) for key, info in _leaves(model)]
    for key, info in sorted(rows, key=lambda row: row[0].startswith(f"{PAPER}.")):
        yield key, info.get_default(call_default_factory=True), info.description or ""


def settings_tree(settings: Settings) -> dict[str, Any]:
    """All values as they would stand in a settings file, the block `paper` last."""
    tree, block = _without_paper(settings.model_dump(mode="json"))
    return {**tree, PAPER: block} if block else tree


def preset_values(model: type[Settings], preset: str = PAPER) -> dict[str, Any]:
    """The tree of all values that stand under a preset's name, each in its part's group; empty if there are none."""
    tree: dict[str, Any] = {}
    for key, info in _leaves(model):
        extra = info.json_schema_extra
        if isinstance(extra, dict) and preset in extra:
            _put(tree, key.split("."), extra[preset], key)
    return tree


def merged(tree: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """A tree with the values of another one, which win."""
    both = dict(tree)
    for key, value in over.items():
        inside = both.get(key)
        both[key] = merged(inside, value) if isinstance(inside, Mapping) and isinstance(value, Mapping) else value
    return both


def leaves(tree: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a tree by their dotted keys."""
    return {".".join(path): value for path, value in _values(tree)}


def tree_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `leaves`."""
    tree: dict[str, Any] = {}
    for key, value in values.items():
        _put(tree, str(key).split("."), value, f"{key}={value}")
    return tree


def shown_key(key: str) -> str:
    """A key as users have it: `particles.paper.roughening` is `paper.particles.roughening`."""
    return ".".join(map(str, _in_block(tuple(key.split(".")))))


def _leaves(model: type[Settings], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    for name, info in model.model_fields.items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, Settings):
            yield from _leaves(info.annotation, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", info


def _without_paper(tree: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A tree without its groups `paper`, and what stands in them as one block."""
    block: dict[str, Any] = dict(tree.get(PAPER, {}))
    rest: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping) and key != PAPER:
            rest[key], inside = _without_paper(value)
            if inside:
                block[key] = inside
        elif key != PAPER:
            rest[key] = value
    return {key: value for key, value in rest.items() if value != {}}, block


def _handed_out(model: type[Settings], tree: Mapping[str, Any]) -> dict[str, Any]:
    """A tree as users write it with each switch of the block `paper` in its part's own group.

    Raises InputError for a switch that stands there already: users have it in the block alone.
    """
    block, rest = tree.get(PAPER), {key: value for key, value in tree.items() if key != PAPER}
    for path, _ in _values(rest):
        if PAPER in path:
            key = ".".join(path)
            raise InputError(f"unknown setting '{key}': did you mean '{shown_key(key)}'?")
    return rest if block is None else merged(rest, _with_parts(model, block))


def _values(tree: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """The path of each value of a tree, with the value."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _values(value, (*path, str(key)))
        else:
            yield (*path, str(key)), value


def _with_parts(model: type[Settings], block: Any) -> dict[str, Any]:
    """What stands in a block `paper`, as a tree of a group's parts; what belongs to none of them stays in `paper`."""
    if not isinstance(block, Mapping):
        return {PAPER: block}
    tree: dict[str, Any] = {}
    own = _group_at(model, (PAPER,))
    for key, value in block.items():
        part = _group_at(model, (str(key),)) if key != PAPER else None
        if part is not None and (own is None or key not in own.model_fields):
            tree[key] = _with_parts(part, value)
        else:
            tree.setdefault(PAPER, {})[key] = value
    return tree


def _put(tree: dict[str, Any], path: list[str], value: Any, item: str) -> None:
    for part in path[:-1]:
        tree = tree.setdefault(part, {})
        if not isinstance(tree, dict):
            raise InputError(f"--set {item}: '{part}' is a value, not a group of settings")
    tree[path[-1]] = value


def _explain(
    model: type[Settings],
    error: ValidationError,
    file: Path | None,
    section: tuple[str, ...],
    changed: set[Any],
    elsewhere: Mapping[str, type[Settings]],
) -> str:
    """What is wrong, each mistake with its line in the file unless it came from a change of the key on top of it."""
    sentences = []
    for problem in error.errors():
        location = problem["loc"]
        ours = any(location[: len(path)] == path or location == path[: len(location)] != () for path in changed)
        line = yaml_line(file, (*section, *_in_block(location))) if file is not None and not ours else None
        sentence = _sentence(model, problem, elsewhere)
        sentences.append(sentence if line is None else f"line {line}: {sentence}")
        if file is not None and not ours and len(sentences) == 1:
            sentences[0] = f"{file}{': ' if line is None else ', '}{sentences[0]}"
    more = f"; and {len(sentences) - _SAID} more mistakes" if len(sentences) > _SAID else ""
    return "; ".join(sentences[:_SAID]) + more


def _in_block(location: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """Where users have what stands in a part's group `paper`: in the one block."""
    return (PAPER, *(part for part in location if part != PAPER)) if PAPER in location else location


def _sentence(model: type[Settings], problem: ErrorDetails, elsewhere: Mapping[str, type[Settings]]) -> str:
    known = [key for key, _, _ in settings_rows(model)]
    key = shown_key(".".join(str(part) for part in problem["loc"]))
    if problem["type"] == "extra_forbidden":
        if problem["loc"][-1] == PAPER and isinstance(problem["input"], Mapping):  # a part without switches
            key = f"{key}.{next(iter(problem['input']), '')}"
        owners = [name for name, other in elsewhere.items() if _has_key(other, key)]
        if owners:
            return f"setting '{key}' belongs to {listed(owners)}, not to the chosen system"
        return f"unknown setting '{key}': {_nearest_key(key, [*known, *_keys_beside(model, problem)])}"
    if problem["type"] == "value_error":  # from a check of our own, which says it all
        return f"{key}: {problem['ctx']['error']}" if key else str(problem["ctx"]["error"])
    if problem["type"] == "model_type":
        inside = sorted({other[len(key) + 1 :].split(".")[0] for other in known if other.startswith(f"{key}.")})
        return f"'{key}' is a group of settings, not a value{': ' * bool(inside)}{', '.join(inside)}"
    hint = "; none is written null" if str(problem["input"]).lower() == "none" else ""
    return f"setting '{key}': {problem['msg'].lower()} (got {shown(problem['input'])}){hint}"


def _has_key(model: type[Settings], key: str) -> bool:
    """Whether it is the key of a setting, or of a group of them."""
    return any(f"{known}.".startswith(f"{key}.") for known, _, _ in settings_rows(model))


def _group_at(model: type[Settings], path: Sequence[int | str]) -> type[Settings] | None:
    """The group of settings at a path of keys and, in lists, numbers; None if there is no group."""
    annotation: Any = model
    for part in path:
        if isinstance(part, int):
            annotation = get_args(annotation)[0] if get_args(annotation) else None
        elif isinstance(annotation, type) and issubclass(annotation, Settings):
            info = annotation.model_fields.get(part)
            annotation = None if info is None else info.annotation
    return annotation if isinstance(annotation, type) and issubclass(annotation, Settings) else None


def _keys_beside(model: type[Settings], problem: ErrorDetails) -> list[str]:
    """The keys that an entry of a list may have, where the unknown one stands in such an entry."""
    *parents, _ = problem["loc"]
    group = _group_at(model, parents)
    if group is None or not any(isinstance(part, int) for part in parents):
        return []
    return [".".join(map(str, (*parents, name))) for name in group.model_fields]


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
