"""The folder of one run, never written over an older one.

Each row is in the file as soon as it is known, and on the disk within a second; summary.json stands there from the
beginning and is replaced as the run goes on. What a crash or a full disk leaves can be read and evaluated."""

import itertools
import json
import math
import os
import time
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, cast

from pydantic import ValidationError
from typing_extensions import Self

from touchline.errors import InputError, TouchlineError
from touchline.evaluation.estimates import csv_row, header
from touchline.evaluation.summary import UNFINISHED, RunSummary
from touchline.evaluation.tum import stamp_from_text, tum_line
from touchline.files.new import file_name, replace_file
from touchline.files.opened import UnreadableError, open_bytes, read_text
from touchline.types import Estimate

TRAJECTORY = "trajectory.tum"
ESTIMATES = "estimates.csv"
SUMMARY = "summary.json"
REPORT = "report.html"
RUNS = Path("runs")
_MAX_SUMMARY_BYTES = 20_000_000
_BETWEEN_SYNCS_S = 0.9


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
    except ValueError as error:  # a character that no path has
        raise InputError(f"output: {str(output)!r} is no path ({error})") from None
    raise AssertionError("unreachable: itertools.count does not end")


class RunFolder:
    """Writes trajectory.tum and estimates.csv as estimates come in, and keeps summary.json beside them.

    description: what summary.json says of the run besides its progress. What cannot be written raises TouchlineError
    with the file's name; the rows before it stay whole.
    """

    def __init__(self, folder: Path, description: RunSummary | None = None) -> None:
        self.path = folder
        self._description = description or RunSummary()
        self._trajectory = _Rows(folder / TRAJECTORY)
        self._estimates = _Rows(folder / ESTIMATES)
        self._begun = False
        self._synced_s = time.monotonic()

    def write(self, estimate: Estimate) -> None:
        """Add one line to each file: the estimate, or the prediction while the robot is lost."""
        row = csv_row(estimate)
        self._begin(estimate)
        self._trajectory.add(tum_line(estimate.stamp_ns, estimate.pose))
        self._estimates.add(row)

    @property
    def sync_is_due(self) -> bool:
        """Whether `sync` is to be called: it has not been for almost a second."""
        return time.monotonic() - self._synced_s >= _BETWEEN_SYNCS_S

    def sync(self, progress: RunSummary) -> None:
        """Bring the rows to the disk, and to summary.json the description with how far the run is."""
        self._trajectory.sync()
        self._estimates.sync()
        write_summary(self.path, self._description.updated(progress))
        self._synced_s = time.monotonic()

    def forget_from(self, stamp_ns: int) -> None:
        """Remove all lines at a stamp or later: a clock was set back, and the run goes on from there."""
        self._trajectory.cut(" ", stamp_ns)
        self._estimates.cut(",", stamp_ns)

    def close(self) -> None:
        """Bring all rows to the disk."""
        try:
            self._begin(None)
            self._trajectory.sync()
            self._estimates.sync()
        finally:
            self._trajectory.close()
            self._estimates.close()

    def _begin(self, estimate: Estimate | None) -> None:
        """The header: which columns there are depends on the first estimate."""
        if not self._begun:
            self._estimates.add(header(estimate))
            self._begun = True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()


class _Rows:
    """A new text file of rows in the order of time, each in the file as soon as it is added, or not at all."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = cast(BinaryIO, path.open("xb+", buffering=0))
        self._size = 0

    def add(self, row: str) -> None:
        data = row.encode()
        try:
            written = self._file.write(data)
            while written < len(data):  # a disk about to be full takes a part, and then says why
                written += self._file.write(data[written:])
        except OSError as error:
            self._file.seek(self._size)
            self._file.truncate()
            raise TouchlineError(
                f"{self._path}: cannot be written ({error.strerror}); the rows before are whole"
            ) from None
        self._size += len(data)

    def sync(self) -> None:
        try:
            os.fsync(self._file.fileno())
        except OSError as error:
            raise TouchlineError(f"{self._path}: cannot be written ({error.strerror})") from None

    def cut(self, separator: str, stamp_ns: int) -> None:
        """Take away the rows at a stamp or later, which are the last ones."""
        self._size = 0
        with open_bytes(self._path) as file:
            for line in file:
                if _is_at_or_after(line.decode().partition(separator)[0], stamp_ns):
                    break
                self._size += len(line)
        self._file.truncate(self._size)
        self._file.seek(self._size)

    def close(self) -> None:
        self._file.close()


def _is_at_or_after(seconds: str, stamp_ns: int) -> bool:
    """Whether a time as it is written is not before a stamp; a header has none and stays."""
    try:
        return stamp_from_text(seconds) >= stamp_ns
    except ValueError:
        return False


def write_summary(folder: Path, summary: RunSummary) -> None:
    """Write summary.json; what is not a finite number becomes null. Raises TouchlineError if it cannot be written."""
    text = json.dumps(_finite(summary.model_dump()), indent=2, ensure_ascii=False, allow_nan=False)
    replace_file(folder / SUMMARY, (text + "\n").encode(errors="backslashreplace"))  # a path may be no UTF-8


def read_summary(folder: Path) -> RunSummary:
    """Read summary.json; where there are only rows, that the run is unfinished.

    Raises InputError if it is missing or not what `run` writes.
    """
    path = folder / SUMMARY
    if not path.exists() and (folder / ESTIMATES).is_file():
        return RunSummary(ended=UNFINISHED)
    try:
        return RunSummary.model_validate(json.loads(read_text(path, _MAX_SUMMARY_BYTES)))
    except UnreadableError as error:
        raise InputError(f"{error}; is {folder} the folder of a run?") from None
    except ValidationError as error:
        key = ".".join(map(str, error.errors()[0]["loc"]))
        what = f"'{key}' is not as" if key else "expected a JSON object, as"
        raise InputError(f"{path}: {what} `touchline run` writes it") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not valid JSON") from None


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
