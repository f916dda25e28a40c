"""The folder of one run: written row by row while the run goes on, never over an older one."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from touchline.errors import InputError
from touchline.evaluation.estimates import csv_row, header
from touchline.evaluation.tum import stamp_from_text, tum_line
from touchline.new_files import file_name
from touchline.opened_files import UnreadableError, read_text
from touchline.types import Estimate

TRAJECTORY = "trajectory.tum"
ESTIMATES = "estimates.csv"
SUMMARY = "summary.json"
REPORT = "report.html"
RUNS = Path("runs")
_MOST_SUMMARY_BYTES = 20_000_000


def new_folder(output: Path | None, name: str, parent: Path = RUNS) -> Path:
    """Make the folder `output`, or the first free `parent/name-N`; a name that would be a path is made one.

    Raises InputError if `output` exists already or the folder cannot be made.
    """
    name = file_name(name)
    try:
        if output is not None:
            output.mkdir(parents=True)
            return output
        parent.mkdir(parents=True, exist_ok=True)
        for number in itertools.count(1):
            folder = parent / f"{name}-{number}"
            try:
                folder.mkdir()
            except FileExistsError:
                continue
            return folder
    except FileExistsError:
        raise InputError(f"{output or parent}: exists already; nothing is overwritten, choose another folder") from None
    except OSError as error:
        raise InputError(f"{error.filename}: the folder cannot be made ({error.strerror}); see --output") from None
    raise AssertionError("unreachable: itertools.count does not end")


class RunFolder:
    """Writes trajectory.tum and estimates.csv as estimates come in, and summary.json at the end."""

    def __init__(self, folder: Path) -> None:
        self.path = folder
        self._trajectory = (folder / TRAJECTORY).open("x+", encoding="utf-8", newline="\n")
        self._estimates = (folder / ESTIMATES).open("x+", encoding="utf-8", newline="\n")
        self._begun = False

    def write(self, estimate: Estimate) -> None:
        """Add one line to each file: the estimate, or the prediction while the robot is lost."""
        row = csv_row(estimate)
        self._begin(estimate)
        self._trajectory.write(tum_line(estimate.stamp_ns, estimate.pose))
        self._estimates.write(row)

    def forget_from(self, stamp_ns: int) -> None:
        """Remove all lines at a stamp or later: a clock was set back, and the run goes on from there."""
        for file, separator in ((self._trajectory, " "), (self._estimates, ",")):
            file.seek(0)
            kept = [line for line in file if not _is_at_or_after(line.partition(separator)[0], stamp_ns)]
            file.seek(0)
            file.writelines(kept)
            file.truncate()

    def close(self) -> None:
        """Bring all rows to the disk."""
        self._begin(None)
        self._trajectory.close()
        self._estimates.close()

    def _begin(self, estimate: Estimate | None) -> None:
        """The header: which columns there are depends on the first estimate."""
        if not self._begun:
            self._estimates.write(header(estimate))
            self._begun = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


def _is_at_or_after(seconds: str, stamp_ns: int) -> bool:
    """Whether a time as it is written is not before a stamp; a header has none and stays."""
    try:
        return stamp_from_text(seconds) >= stamp_ns
    except ValueError:
        return False


def write_summary(folder: Path, summary: dict[str, Any]) -> None:
    """Write summary.json; what is not a finite number becomes null."""
    text = json.dumps(_finite(summary), indent=2, ensure_ascii=False, allow_nan=False)
    (folder / SUMMARY).write_text(text + "\n", encoding="utf-8")


def read_summary(folder: Path) -> dict[str, Any]:
    """Read summary.json. Raises InputError if it is missing or not what `run` writes."""
    path = folder / SUMMARY
    try:
        loaded = json.loads(read_text(path, _MOST_SUMMARY_BYTES))
    except UnreadableError as error:
        raise InputError(f"{error}; is {folder} the folder of a run?") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not valid JSON") from None
    if not isinstance(loaded, dict):
        raise InputError(f"{path}: expected a JSON object, as `touchline run` writes it")
    return loaded


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
