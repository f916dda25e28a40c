"""`StrEnum` as of Python 3.11: a member prints, formats and serializes as its value."""

from __future__ import annotations

from enum import Enum


class StrEnum(str, Enum):
    """Base of enumerations whose members are texts."""

    __str__ = str.__str__
    __format__ = str.__format__  # type: ignore[assignment]
