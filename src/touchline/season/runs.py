"""A season's recordings localised: a task each, its run's folder and its row; a journal from which a run goes on."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

from touchline.api import prepare, settings_given
from touchline.errors import InputError, TouchlineError
from touchline.evaluation.estimates import EstimateTable
from touchline.evaluation.run import Run
from touchline.evaluation.run_folder import new_folder
from touchline.evaluation.workers import ENDED, Workers
from touchline.files.new import replace_file
from touchline.files.opened import read_text
from touchline.messages import unexpected
from touchline.season.recordings import at_hand, fingerprint, folder_names, is_address, keep, names_in, open_store
from touchline.season.tables import Row, row_of, write_estimates, write_runs
from touchline.sources import BagOptions, open_source
from touchline.systems import system_info
from touchline.types import Prior, Status

JOURNAL = "journal.jsonl"
REPORTS = ("all", "failed", "none")
_OPTIONS = {"overrides": "set", "topics": "topic", "late_ms": "late"}  # those of other names
_PACKAGES = ("touchline", "numpy", "numba")
_MAX_BYTES = 1_000_000_000
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Command:
    """What is done with each recording: it decides the numbers, and a journal goes on only with the same.

    settings: a file, as of `touchline run --config`; report: which runs get one, of `REPORTS`, whatever others did.
    Raises InputError for what is wrong for all recordings.
    """

    system: str
    config: str | None = None
    overrides: tuple[str, ...] = ()
    preset: str | None = None
    own_half: bool = False
    seed: int = 0
    follow_links: bool = False
    bag: Mapping[str, Any] = field(default_factory=dict)
    report: str = "all"

    def __post_init__(self) -> None:
        if self.report not in REPORTS:
            raise InputError(f"--report {self.report}: expected one of {', '.join(REPORTS)}")
        file = None if self.config is None else Path(self.config)
        settings_given(system_info(self.system), file, self.overrides, self.preset)

    def to_dict(self) -> dict[str, Any]:
        """What the numbers depend on, as the journal keeps it: options by their names, versions by their packages'."""
        named = {_OPTIONS.get(key, key.replace("_", "-")): value for key, value in {**asdict(self), **self.bag}.items()}
        settings = None if self.config is None else read_text(Path(self.config), 1_000_000)
        options = {f"--{name}": value for name, value in named.items() if name not in ("bag", "report")}
        return {**options, "--config": settings, **{name: version(name) for name in _PACKAGES}}


class Task(NamedTuple):
    """One recording, and the folder of its run: a path, or an address of an object store."""

    recording: str
    target: str
    command: Command


def localize_all(
    recordings: Sequence[str],
    output: str,
    command: Command,
    workers: Workers,
    on_row: Callable[[Row, int], None] = lambda row, left: None,
    on_begin: Callable[[int], None] = lambda left: None,
) -> list[Row]:
    """Localise recordings, each into a folder of its own below `output`; the rows of all, in their order.

    Journal and tables stand there, too. A folder with the journal of the same command goes on: what is done and has not
    changed since is not done again, and what was begun or has failed is begun anew; recordings that are not given now
    keep their folders and rows. on_row: takes each row as it comes, and how many are left; on_begin: how many are, at
    first. An address as `output` gets the runs' folders and the tables; its journal stays in the working folder.
    Raises InputError for a folder that is there without such a journal, or at which another process is at work.
    """
    for address in filter(is_address, (output, *recordings)):
        open_store(address)  # what is not installed is told before the work
    away = is_address(output)
    place = output.rstrip("/") if away else str(Path(output).absolute())
    with _Journal.opened(_journal_folder(place) if away else Path(output), command) as journal:
        names = folder_names(recordings, {row["recording"]: name for name, row in journal.rows.items()})
        there = names_in(place) if journal.rows else set()
        rows = {name: row for name, row in journal.rows.items() if row["failure"] or name in there}
        tasks, prints = [], {recording: fingerprint(recording) for recording in recordings}
        for recording, name in zip(recordings, names, strict=True):
            row = rows.get(name)
            if row is None or row["failure"] or not row["inputs"] == prints[recording] != "":
                tasks.append(Task(recording, f"{place}/{name}", command))
        on_begin(len(tasks))
        for done, (found, estimates) in enumerate(workers.unordered(localize_one, tasks, _ended), start=1):
            row = {**found, "inputs": prints[found["recording"]]}
            try:
                if estimates is not None:
                    _place(f"{place}/{row['run']}", partial(write_estimates, table=estimates))
            except Exception as error:  # one recording's is no end of the others
                why = str(error) if isinstance(error, TouchlineError) else unexpected(error)
                row["failure"] = row["failure"] or why
            rows[row["run"]] = row
            journal.append(row)
            on_row(row, len(tasks) - done)
        given = [rows.pop(name) for name in names]
        for folder in [str(journal.folder), *([place] if away else [])]:
            _place(folder, partial(write_runs, rows=[*rows.values(), *given]))
    return given


def _journal_folder(address: str) -> Path:
    """Where the journal of results at an address stands: of each address another."""
    last, whole = address.rsplit("/", 1)[-1], hashlib.sha256(address.encode()).hexdigest()
    return Path("runs") / f"{last}-{whole[:8]}.season"


def _place(target: str, write: Callable[[Path], None]) -> None:
    """What `write` puts into a folder, in the folder or below the address that is meant."""
    if not is_address(target):
        write(Path(target))
        return
    with TemporaryDirectory() as scratch:
        write(Path(scratch))
        for path in Path(scratch).iterdir():
            keep(path, f"{target}/{path.name}")


def localize_one(task: Task) -> tuple[Row, EstimateTable | None]:
    """Localise one recording; what goes wrong is its row's `failure`, the others go on.

    Of its estimates a table is made by who asked: pyarrow takes 45 MB, which not each worker needs.
    """
    estimates = None
    command, row = task.command, _row_without(task, "")
    name = row["run"]
    try:
        with at_hand(task.recording) as path, TemporaryDirectory() as scratch:
            folder = Path(scratch) / name if is_address(task.target) else Path(task.target)
            shutil.rmtree(folder, ignore_errors=True)  # begun and not finished, or of inputs that have changed
            finished, failure = _localized(path, folder, command)
            if finished.summary["ended"] == "interrupted":  # by a signal to this process: begun, not done
                raise KeyboardInterrupt
            row |= _finished_row(finished, failure)
            if is_address(task.target):
                keep(folder, task.target)
            estimates = finished.estimates
    except TouchlineError as error:
        row["failure"] = str(error)
    except Exception as error:  # a fault of a system, or of one recording's decoder: a row, and not the end
        row["failure"] = unexpected(error)
    return row, estimates


def _ended(task: Task) -> tuple[Row, EstimateTable | None]:
    """What stands for a recording whose worker was ended while no other recording was at hand."""
    return _row_without(task, ENDED), None


def _row_without(task: Task, failure: str) -> Row:
    return {"run": task.target.rsplit("/", 1)[-1], "recording": task.recording, "failure": failure}


def _localized(path: Path, folder: Path, command: Command) -> tuple[Run, BaseException | None]:
    source = open_source(path, command.follow_links, BagOptions.from_dict(dict(command.bag) or None))
    prepared = prepare(
        source, command.system, prior=Prior(own_half=command.own_half), config=command.config,
        overrides=command.overrides, preset=command.preset, seed=command.seed,
    )  # fmt: skip

    def wants_report(summary: Mapping[str, Any]) -> bool:
        lost = not summary["status"][Status.TRACKING] or summary["failure"] is not None
        return summary["ended"] != "interrupted" and (command.report == "all" or lost)

    report = None if command.report == "none" else wants_report
    return prepared.execute(new_folder(folder, folder.name), report=report)


def _finished_row(finished: Run, failure: BaseException | None) -> Row:
    row = row_of(finished)
    if failure is not None:
        row["failure"] = f"{type(failure).__name__}: {failure}"
    elif not finished.summary["status"][Status.TRACKING] and not finished.summary["unmoved_frames"]:
        why = finished.summary["why_not_localised"]
        row["failure"] = f"none of {len(finished.estimates)} images was localised{f': {why}' if why else ''}"
    return row


class _Journal:
    """A line of JSON for the command, then one for each recording that is done; on the disk before the next begins."""

    def __init__(self, folder: Path, rows: dict[str, Row]) -> None:
        self.folder, self.rows = folder, rows

    @classmethod
    @contextmanager
    def opened(cls, folder: Path, command: Command) -> Iterator[_Journal]:
        """The journal in a folder; a new one in a new folder. Raises InputError for any other folder.

        As long as the block lasts no other process opens it.
        """
        is_new = not (folder / JOURNAL).is_file()
        if is_new:
            new_folder(folder, folder.name)
        with _alone_in(folder):
            head = json.loads(json.dumps(command.to_dict()))
            if is_new:
                replace_file(folder / JOURNAL, f"{json.dumps({'command': head})}\n".encode())
            yield cls(folder, cls._read(folder / JOURNAL, head))

    @staticmethod
    def _read(path: Path, head: dict[str, Any]) -> dict[str, Row]:
        """The rows of what is done, by their runs. Raises InputError for a journal of another command that did any."""
        lines = read_text(path, _MAX_BYTES).split("\n")
        try:
            known = dict(json.loads(lines[0])["command"])
            rows = [json.loads(line) for line in lines[1:-1]]  # what was cut off has no line's end
            done = {str(row["run"]): row for row in rows if {"recording", "inputs", "failure"} <= row.keys()}
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError(f"{path}: is no journal of touchline run; choose another folder") from None
        if known != head and not all(row["failure"] for row in done.values()):
            other = [key for key in {**known, **head} if known.get(key) != head.get(key)]
            words = [
                f"{key} {known.get(key)}, here {head[key]}" if key in _PACKAGES else f"other {key}" for key in other
            ]
            raise InputError(f"{path}: is of another command ({'; '.join(words)}); choose another folder")
        replace_file(path, "\n".join([json.dumps({"command": head}), *lines[1:-1], ""]).encode())
        return done

    def append(self, row: Row) -> None:
        with (self.folder / JOURNAL).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, ensure_ascii=False) + "\n")
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Raises InputError if another process is in such a block for the folder; Windows has no such locks."""
    if sys.platform == "win32":
        yield
        return
    import fcntl

    held = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{folder}: another touchline run is at work here; wait, or choose another folder"
            ) from None
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(held)
