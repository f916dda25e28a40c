"""YAML files: what could bring a parser down is refused first, and every mistake is told with its line."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from touchline.errors import InputError
from touchline.files.opened import read_text

MAX_BYTES = 1_000_000
MAX_DEPTH = 100
MAX_ALIASES = 50
MAX_VALUES = 200_000  # two seconds to load; a camera of 72 directions has 30,000
_MAX_EXPANDED = 1_000_000  # characters with every alias written out: each may stand for many others
_MAX_DIRECTIVES = 10  # libyaml compares each with all before it
_MAX_INTEGER = 2**63


class YamlError(Exception):
    """What is wrong with a text, without its place. line: from 1; None for the whole text."""

    def __init__(self, what: str, line: int | None = None) -> None:
        super().__init__(what if line is None else f"line {line}: {what}")
        self.what = what
        self.line = line


def read_yaml_mapping(path: Path) -> dict[str, Any]:
    """A YAML file whose top level is a mapping; InputError names the file and line of what is wrong."""
    loaded = read_yaml(path)
    if loaded is None:
        return {}
    if not isinstance(loaded, dict):
        raise InputError(f"{path}: expected keys and values at the top level, found a {type(loaded).__name__}")
    return loaded


def read_yaml(path: Path) -> Any:
    """What a YAML file holds; InputError names the file and line of what is wrong, a key that stands twice as well.

    Refused are also more than 1 MB, 100 levels, 50 aliases or 200,000 values, and integers beyond 63 bits.
    """
    text = read_text(path, MAX_BYTES)
    try:
        return yaml_value(text)
    except YamlError as error:
        raise InputError(f"{path}{': ' if error.line is None else ', '}{error}") from None


def yaml_value(text: str) -> Any:
    """What a YAML text says, within the bounds of `read_yaml`. Raises YamlError."""
    try:
        text.encode()  # an argument of the command may hold bytes that are no text
        _check_bounds(text)
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        deep = "nesting depth" in problem  # libyaml's own bound, which is met before the first event
        what = f"is nested deeper than {MAX_DEPTH} levels" if deep else f"is not valid YAML ({problem})"
        raise YamlError(what, None if mark is None else mark.line + 1) from None
    except UnicodeEncodeError:
        raise YamlError("is not a text") from None


def yaml_line(path: Path, keys: Sequence[str | int]) -> int | None:
    """The line in a YAML file in which an entry begins, named by keys and, in lists, numbers from 0; of what is not
    there the nearest entry around it. None without any.
    """
    try:
        text = read_text(path, MAX_BYTES)
        _check_bounds(text)
        node = yaml.compose(text, Loader=_Loader)
    except (InputError, YamlError, yaml.YAMLError):
        return None
    line = None
    for key in keys:
        if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
            node = node.value[key]
            line = node.start_mark.line + 1
            continue
        inside = node.value if isinstance(node, yaml.MappingNode) else []
        entries = [(name, value) for name, value in inside if name.value == str(key)]
        if not entries:
            break
        line, node = entries[-1][0].start_mark.line + 1, entries[-1][1]
    return line


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """Plain values only, no key twice, and no number that nothing could be measured with."""

    def construct_document(self, node: yaml.Node) -> Any:
        _refuse_twice(node)  # before merged keys (<<) are put among the others: these may come again
        return super().construct_document(node)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Merged keys among the others: of a key that comes again the last one counts, wherever it is merged next."""
        super().flatten_mapping(node)
        node.value = list({getattr(key, "value", id(key)) if isinstance(key, yaml.ScalarNode) else id(key): (key, value)
                           for key, value in node.value}.values())  # fmt: skip

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            value = super().construct_object(node, deep)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):  # it only looks like a date, …
            written = f"{node.value:.40}" if isinstance(node, yaml.ScalarNode) else "a list or mapping"
            raise YamlError(f"holds a value that cannot be read ({written})", node.start_mark.line + 1) from None
        if isinstance(value, int) and abs(value) >= _MAX_INTEGER:
            raise YamlError(f"the number {node.value:.20}… is too large", node.start_mark.line + 1)
        return value


def _check_bounds(text: str) -> None:
    """Raises YamlError for what takes a loader very long, or more stack than there is.

    The parser tells of one bracket, dash or value after the other, in constant memory. A look at the bytes alone would
    have to guess what is quoted.
    """
    if text.startswith("%") + text.count("\n%") > _MAX_DIRECTIVES:
        raise YamlError(f"holds more than {_MAX_DIRECTIVES} lines that begin with %")
    sizes: dict[str, int | None] = {}  # characters that an alias of each anchor stands for; None inside of it
    opened: list[tuple[str | None, int]] = []  # anchor of each list or mapping around, and the size before it
    size, aliases = 0, 0
    for values, event in enumerate(yaml.parse(text, Loader=_Loader)):
        line = event.start_mark.line + 1  # type: ignore[union-attr]
        if values > MAX_VALUES:
            raise YamlError(f"holds more than {MAX_VALUES} values", line)
        anchor = getattr(event, "anchor", None)
        if isinstance(event, yaml.CollectionStartEvent):
            opened.append((anchor, size))
            if len(opened) > MAX_DEPTH:
                raise YamlError(f"is nested deeper than {MAX_DEPTH} levels", line)
            size += 1
            if anchor is not None:
                sizes[anchor] = None
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, before = opened.pop()
            if anchor is not None:
                sizes[anchor] = size - before
        elif isinstance(event, yaml.ScalarEvent):
            size += len(event.value) + 1
            if anchor is not None:
                sizes[anchor] = len(event.value) + 1
        elif isinstance(event, yaml.AliasEvent):
            aliases += 1
            behind = sizes.get(str(event.anchor), 0)  # of an unknown one the loader tells
            if behind is None:
                raise YamlError(f"*{event.anchor} stands inside of what it stands for", line)
            size += behind
            if aliases > MAX_ALIASES:
                raise YamlError(f"holds more than {MAX_ALIASES} aliases (*{event.anchor:.40})", line)
            if size > _MAX_EXPANDED:
                raise YamlError(f"with its aliases written out it is larger than {_MAX_EXPANDED // 1_000_000} MB", line)


def _refuse_twice(root: yaml.Node) -> None:
    """Raises YamlError for a key that stands twice in a mapping anywhere below a node: the later one would win."""
    seen, waiting = {id(root)}, [root]  # an alias leads to what was seen already
    while waiting:
        node = waiting.pop()
        parts = list(node.value) if isinstance(node, yaml.SequenceNode) else []
        lines: dict[str, int] = {}
        for key, value in node.value if isinstance(node, yaml.MappingNode) else []:
            parts += [key, value]
            line = key.start_mark.line + 1
            if isinstance(key, yaml.ScalarNode) and key.value in lines:
                before = "" if lines[key.value] == line else f" in line {lines[key.value]}"
                raise YamlError(f"'{key.value}' stands{before or ' there'} already; keep one", line)
            if isinstance(key, yaml.ScalarNode):
                lines[key.value] = line
        new = [part for part in parts if id(part) not in seen]
        seen.update(map(id, new))
        waiting += reversed(new)
