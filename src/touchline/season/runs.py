"""A season's recordings localised: a task for each. The table of what is done is what a season resumes from."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NamedTuple

from touchline.api import prepare, settings_given
from touchline.errors import InputError, TouchlineError
from touchline.evaluation.run_folder import new_folder
from touchline.evaluation.summary import RunSummary
from touchline.evaluation.workers import Workers
from touchline.files.opened import read_text
from touchline.messages import unexpected
from touchline.season.recordings import fetched, fingerprint, folder_names, is_address, open_store, upload
from touchline.season.table import Row, Table, row_of
from touchline.sources import BagOptions, open_source
from touchline.systems import system_info
from touchline.types import Prior, Status

_PACKAGES = ("touchline", "numpy", "numba")


@dataclass(frozen=True, slots=True)
class Command:
    """What is done with each recording. config: a file of settings; report: which runs get a report.

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
    report: Literal["all", "failed", "none"] = "all"

    def __post_init__(self) -> None:
        file = None if self.config is None else Path(self.config)
        settings_given(system_info(self.system), file, self.overrides, self.preset)

    def to_dict(self) -> dict[str, Any]:
        """What the numbers depend on: all but the report, with the file's hash and the versions of packages."""
        known = asdict(self) | {name: version(name) for name in _PACKAGES}
        del known["report"]
        if self.config is not None:
            known["config"] = hashlib.sha256(read_text(Path(self.config), 1_000_000).encode()).hexdigest()[:16]
        return dict(json.loads(json.dumps(known)))


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

    The table stands there, too. What has a row is not done again unless it failed or its files have changed; recordings
    that are not given now keep their rows. on_row: gets each row as it comes, and how many are left.
    Raises InputError for a folder that exists without such a table, for a table of another command, and for a folder
    in which another process is at work.
    """
    for address in filter(is_address, recordings):
        open_store(address)  # a missing package is reported before the work
    place = output.rstrip("/") if is_address(output) else str(Path(output).absolute())
    if not (table := Table(place)).exists:
        if not is_address(place):
            new_folder(Path(place), place)
        table.write()
    with _alone_in(place):
        table, known = Table(place), command.to_dict()
        _check_same(known, table)
        names = folder_names(recordings, {row["recording"]: name for name, row in table.rows.items()})
        prints = {recording: fingerprint(recording) for recording in recordings}
        done = {name for name, row in table.rows.items() if not row["failure"] and row["inputs"]}
        tasks = [
            Task(recording, f"{place}/{name}", command)
            for recording, name in zip(recordings, names, strict=True)
            if name not in done or table.rows[name]["inputs"] != prints[recording]
        ]
        for finished, row in enumerate(workers.map(localize_one, tasks, ordered=False), start=1):
            row |= {"inputs": prints[row["recording"]], "command": json.dumps(known)}
            table.rows[row["run"]] = row
            table.write(names)
            on_row(row, len(tasks) - finished)
        return [table.rows[name] for name in names]


def _check_same(command: Mapping[str, Any], table: Table) -> None:
    """Raises InputError if another command has done any of the rows."""
    for other in table.commands:
        words = [f"{key} {other.get(key)}, here {known}" for key, known in command.items() if other.get(key) != known]
        if words:
            raise InputError(f"{table.path}: is of another command ({'; '.join(words)}); choose another folder")


def localize_one(task: Task) -> Row:
    """Localise one recording; what goes wrong is its row's `failure`, and the others go on."""
    row: Row = {"run": task.target.rsplit("/", 1)[-1], "recording": task.recording, "failure": ""}
    try:
        with fetched(task.recording) as path, TemporaryDirectory() as scratch:
            folder = Path(scratch) / row["run"] if is_address(task.target) else Path(task.target)
            shutil.rmtree(folder, ignore_errors=True)  # begun and not finished, or of other inputs
            summary = _localized(path, folder, task.command)
            row |= row_of(summary)
            row["failure"] = _failure(summary)
            if is_address(task.target):
                upload(folder, task.target)
    except TouchlineError as error:
        row["failure"] = str(error)
    except Exception as error:  # a fault of a system, or of one recording's decoder
        row["failure"] = unexpected(error)
    return row


def _localized(path: Path, folder: Path, command: Command) -> RunSummary:
    source = open_source(path, command.follow_links, BagOptions.from_dict(dict(command.bag) or None))
    prepared = prepare(
        source, command.system, prior=Prior(own_half=command.own_half), config=command.config,
        overrides=command.overrides, preset=command.preset, seed=command.seed,
    )  # fmt: skip

    def wants_report(summary: RunSummary) -> bool:
        lost = not summary.status[Status.TRACKING] or summary.failure is not None
        return summary.ended != "interrupted" and (command.report == "all" or lost)

    report = None if command.report == "none" else wants_report
    summary = prepared.execute(new_folder(folder, folder.name), report=report)[0].summary
    if summary.ended == "interrupted":  # by a signal to this process: begun, not done
        raise KeyboardInterrupt
    return summary


def _failure(summary: RunSummary) -> str:
    """Why a run is of no use; empty if it is of use."""
    if summary.failure is not None or summary.status[Status.TRACKING] or summary.unmoved_frames:
        return summary.failure or ""
    why = summary.why_not_localised
    return f"none of {summary.frames} images was localised{f': {why}' if why else ''}"


@contextmanager
def _alone_in(place: str) -> Iterator[None]:
    """Raises InputError if another process is in such a block for the folder; stores and Windows have no such locks."""
    if is_address(place) or sys.platform == "win32":
        yield
        return
    import fcntl

    held = os.open(place, os.O_RDONLY)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise InputError(f"{place}: another touchline season is at work here; wait, or choose another folder") from None
    finally:
        os.close(held)
