"""What a program gives to the public functions: taken, or refused in words that name the argument."""

import operator
import os
from collections.abc import Iterable
from pathlib import Path

from touchline.errors import InputError


def refused(what: str, expected: str, value: object) -> InputError:
    """The error for an argument of the wrong kind."""
    shown = f"{value!r:.60}" if isinstance(value, str | int | float | tuple | None) else f"a {type(value).__name__}"
    return InputError(f"{what}: expected {expected}, got {shown}")


def given_path(what: str, expected: str, value: object) -> Path:
    """A path. Raises InputError for what can't be one."""
    if not isinstance(value, str | os.PathLike):
        raise refused(what, expected, value)
    path = Path(value)
    try:
        path.exists()
    except (OSError, ValueError) as error:  # too long, or with a character that no path has
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{what}: {str(path)!r:.60} is no path ({reason})") from None
    return path


def given_seed(value: object) -> int:
    """A seed. Raises InputError for what is no whole number from 0 on."""
    try:
        seed = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        seed = -1
    if seed < 0:
        raise refused("seed", "a whole number from 0 on", value)
    return seed


def given_switch(what: str, value: object) -> bool:
    """True or False, of NumPy's, too. Raises InputError for anything else: 'no' would count as True."""
    if type(value).__name__ not in ("bool", "bool_"):
        raise refused(what, "True or False", value)
    return bool(value)


def given_numbers(what: str, expected: str, value: object, count: int) -> tuple[float, ...]:
    """So many numbers, NaN and infinity included. Raises InputError for what isn't."""
    try:
        numbers = tuple(map(float, value)) if isinstance(value, Iterable) and not isinstance(value, str | bytes) else ()
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count:
        raise refused(what, expected, value)
    return numbers
