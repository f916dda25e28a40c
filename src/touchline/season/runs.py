"""A season's recordings localised: a task each, its run's folder and its row; a journal from which a run goes on."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

from touchline.api import prepare
from touchline.errors import InputError, TouchlineError
from touchline.evaluation.estimates import EstimateTable
from touchline.evaluation.run import Run
from touchline.evaluation.run_folder import new_folder
from touchline.evaluation.workers import ENDED, Workers
from touchline.files.new import replace_file
from touchline.files.opened import read_text
from touchline.messages import unexpected
from touchline.season.recordings import at_hand, fingerprint, folder_names, is_address, keep
from touchline.season.tables import Row, row_of, write_estimates, write_runs
from touchline.sources import BagOptions, open_source
from touchline.types import Prior, Status

JOURNAL = "journal.jsonl"
REPORTS = ("all", "failed", "none")
_MAX_BYTES = 1_000_000_000
Item = TypeVar("Item")


@dataclass(frozen=True, slots=True)
class Command:
    """What is done with each recording: it decides the numbers, and a journal goes on only with the same.

    settings: a file, as of `touchline run --config`; report: which runs get one, of `REPORTS`.
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

    def to_dict(self) -> dict[str, Any]:
        """As the journal keeps it: the text of the settings' file, and the versions that the numbers depend on."""
        settings = None if self.config is None else read_text(Path(self.config), 1_000_000)
        versions = {name: version(name) for name in ("touchline", "numpy", "numba")}
        return {**asdict(self), "overrides": list(self.overrides), "config": settings, "versions": versions}


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
) -> list[Row]:
    """Localise recordings, each into a folder of its own below `output`; the rows of all, in their order.

    Journal and tables stand there, too. A folder with the journal of the same command goes on: what is done and has not
    changed since is not done again, and what was begun is begun anew. on_row: takes each row as it comes, and how many
    are left. An address as `output` gets the runs' folders and the tables; its journal stays in the working folder.
    Raises InputError for a folder that is there without such a journal.
    """
    away = is_address(output)
    folder = Path("runs") / f"{output.rsplit('/', 1)[-1]}.season" if away else Path(output)
    names = folder_names(recordings)
    journal = _Journal.opened(folder, command)
    prints = {recording: fingerprint(recording) for recording in recordings}
    rows = {name: row for name, row in journal.rows.items() if prints.get(row["recording"]) == row["inputs"] != ""}
    tasks = []
    for recording, name in zip(recordings, names, strict=True):
        if name in rows and rows[name]["recording"] == recording:
            continue
        rows.pop(name, None)
        tasks.append(Task(recording, f"{output}/{name}" if away else str(folder / name), command))
    targets = {task.recording: task.target for task in tasks}
    for done, (row, estimates) in enumerate(workers.unordered(localize_one, tasks, _ended), start=1):
        row = {**row, "inputs": prints[row["recording"]]}
        try:
            if estimates is not None:
                _place(targets[row["recording"]], partial(write_estimates, table=estimates))
        except Exception as error:  # one recording's is no end of the others
            row["failure"] = row["failure"] or (str(error) if isinstance(error, TouchlineError) else unexpected(error))
        rows[row["run"]] = row
        journal.append(row)
        on_row(row, len(tasks) - done)
    found = [rows[name] for name in names]
    for place in [str(folder), *([output] if away else [])]:
        _place(place, partial(write_runs, rows=found))
    return found


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

    def __init__(self, path: Path, rows: dict[str, Row]) -> None:
        self._path, self.rows = path, rows

    @classmethod
    def opened(cls, folder: Path, command: Command) -> _Journal:
        """The journal in a folder; a new one in a new folder. Raises InputError for any other folder."""
        path, head = folder / JOURNAL, json.loads(json.dumps(command.to_dict()))
        if not path.is_file():
            new_folder(folder, folder.name)
            replace_file(path, f"{json.dumps({'command': head})}\n".encode())
            return cls(path, {})
        lines = read_text(path, _MAX_BYTES).split("\n")
        try:
            known = json.loads(lines[0])["command"]
            rows = [json.loads(line) for line in lines[1:-1]]  # what was cut off has no line's end
            done = {str(row["run"]): row for row in rows if {"recording", "inputs"} <= row.keys()}
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError(f"{path}: is no journal of touchline run; choose another folder") from None
        if known != head:
            other = [key for key in head if known.get(key) != head[key]]
            raise InputError(f"{path}: is of another command (other {', '.join(other)}); choose another folder")
        replace_file(path, "\n".join([*lines[:-1], ""]).encode())
        return cls(path, done)

    def append(self, row: Row) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row, ensure_ascii=False) + "\n")
            file.flush()
            os.fsync(file.fileno())
