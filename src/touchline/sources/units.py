"""Numbers in another unit than the format's: told by their size, as no robot could have measured them otherwise."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray
from touchline.sources.tables import Line, Table, parse_clean, read_lines, to_number

TIME_UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
_EPOCH_S = (1e9, 4e9)  # the years 2001 to 2096
HEAD_ROWS = 3000  # one minute of a sensor


def first_rows(table: Table, names: tuple[str, ...], count: int = HEAD_ROWS) -> FloatArray:
    """(N, k) the numbers of a table's first rows as they stand there, of any size; NaN where a cell is no number."""
    wanted = [table.columns[name] for name in names]
    blocks: list[FloatArray] = [np.empty((0, len(names)))]
    found = 0
    for lines in read_lines(table):
        values = parse_clean(lines, table.width)
        blocks.append(_cells(lines, wanted) if values is None else values[:, wanted])
        found += len(lines)
        if found >= count:
            break
    return np.concatenate(blocks)[:count]


def _cells(lines: Sequence[Line], wanted: Sequence[int]) -> FloatArray:
    """(N, k) as `first_rows`, where not every line is a row of numbers."""
    rows: list[list[float]] = []
    for line in lines:
        cells = line.text.split(",")
        numbers = (to_number(cells[at].strip()) if at < len(cells) else None for at in wanted)
        rows.append([np.nan if number is None else number for number in numbers])
    return np.array(rows, dtype=np.float64)


def time_unit(times: npt.ArrayLike, shortest_s: float, longest_s: float) -> str | None:
    """The unit that times (N,) are in, of TIME_UNITS; None where they may well be seconds.

    shortest_s, longest_s: what the distance of two of them can be. Times that count from 1970 need no distance.
    """
    known = np.asarray(times, dtype=np.float64)
    known = known[np.isfinite(known)]
    steps = np.diff(known)
    steps = steps[steps > 0.0]
    for unit, per_second in TIME_UNITS.items():
        if len(known) and _EPOCH_S[0] <= float(np.median(known)) / per_second <= _EPOCH_S[1]:
            return unit
    if not len(steps) or float(np.median(steps)) <= longest_s:
        return None
    for unit, per_second in TIME_UNITS.items():
        if shortest_s <= float(np.median(steps)) / per_second <= longest_s:
            return unit
    return None


def advice_on_times(table: Table) -> str:
    """What a message adds about a table of which no time can be used; empty if nothing is known."""
    unit = time_unit(first_rows(table, ("t",))[:, 0], 5e-4, 2.0)
    return "" if unit is None else f": its times look like {unit}, t is in seconds"
