"""`StrEnum` as of Python 3.11: a member prints, formats and serializes as its value."""

from __future__ import annotations

from enum import Enum


class StrEnum(str, Enum):
    """Base of enumerations whose members are texts."""

    __str__ = str.__str__
    __format__ = str.__format__  # type: ignore[assignment]

    @staticmethod
    def _generate_next_value_(name: str, start: int, count: int, last_values: list[str]) -> str:
        """Return the name in lower case, for members made by `auto()`."""
        return name.lower()
