"""The lines of a recording's tables as they are, each with its time to the nanosecond."""

from collections.abc import Iterator
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import NamedTuple

from touchline.files.opened import MAX_LINE, open_bytes

MAX_STAMP_NS = 2**63 - 1


class Rows(NamedTuple):
    """Lines that have the same time. stamp_ns: of the line before where there is no time to be read. header: whether
    it is the one before the first row, which has no time. cells: of the (first) line.
    """

    stamp_ns: int
    text: str
    header: bool
    cells: tuple[str, ...]


def decimal_ns(text: str) -> int | None:
    """Seconds as decimal text in nanoseconds; None if it is none, or beyond what 63 bits hold."""
    try:
        exact = Decimal(text.strip()) * 1_000_000_000
        if not abs(exact) < MAX_STAMP_NS:  # NaN compares as an error
            return None
        return int(exact.to_integral_value())
    except InvalidOperation:
        return None


def decimal_seconds(stamp_ns: int) -> str:
    """Nanoseconds as seconds in decimal text, which `decimal_ns` reads back."""
    sign, rest = "-" if stamp_ns < 0 else "", abs(stamp_ns)
    text = f"{sign}{rest // 1_000_000_000}.{rest % 1_000_000_000:09d}".rstrip("0")
    return text + "0" if text.endswith(".") else text


def read_rows(path: Path) -> Iterator[Rows]:
    """A CSV file (the header's column `t` is the time) or a TUM file (no header, separated by spaces).

    Bytes that are no UTF-8 are replaced: no table of numbers has any.
    """
    spaces = path.suffix == ".tum"
    position, last, waiting = 0, 0, ""
    first: tuple[str, ...] = ()
    with open_bytes(path) as file:
        if not spaces:
            header = file.readline(MAX_LINE).decode("utf-8", errors="replace")
            names = [name.strip().strip('"') for name in header.lstrip("\ufeff").split(",")]
            position = names.index("t") if "t" in names else 0
            yield Rows(MAX_STAMP_NS, header, True, tuple(names))
        while line := file.readline(MAX_LINE).decode("utf-8", errors="replace"):
            cells = tuple(line.split() if spaces else (cell.strip() for cell in line.split(",")))
            stamp = decimal_ns(cells[position]) if position < len(cells) else None
            if waiting and stamp is not None and stamp != last:
                yield Rows(last, waiting, False, first)
                waiting = ""
            if not waiting:
                first = cells
            waiting += line
            last = last if stamp is None else stamp
    if waiting:
        yield Rows(last, waiting, False, first)
