"""Systems on the entries of a suite, and the files of results: a line for each drive, so that a run can go on."""

import filecmp
import json
import math
import resource
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from touchline.camera import OmniCamera, PerspectiveCamera
from touchline.errors import InputError
from touchline.evaluation.runner import robot_setup
from touchline.evaluation.workers import Workers
from touchline.files.new import replace_file
from touchline.files.opened import read_text, text_lines
from touchline.geometry import Pose
from touchline.sources import Recording, open_source
from touchline.systems import open_system, paper_settings, system_info
from touchline.systems.ordered import OrderedSystem
from touchline.types import Estimate, Frame, Prior
from touchline_lab.bench.exchange import read_answers, read_start, track_of_answers, write_inputs
from touchline_lab.bench.scoring import DriveScore, score_of
from touchline_lab.bench.suite import MIRROR, Entry, Suite, digest
from touchline_lab.experiments.drives import Drive, drive_of, track_of
from touchline_lab.experiments.harness import about
from touchline_lab.experiments.scenes import public_recording

PAPER = ":paper"  # behind a system's name: its paper's own form
_MS = 1e3
_MAX_BYTES = 100_000_000  # of a file of results
_REFERENCE = np.linspace(0.0, 1.0, 20_000)


class Scored(NamedTuple):
    """One drive of one system. inputs: the hash of what it was given."""

    entry: str
    system: str
    inputs: str
    score: DriveScore


def takes(system: str, track: str) -> bool:
    """Whether a system has what it needs on a track."""
    return (OmniCamera if track == MIRROR else PerspectiveCamera) in system_info(system.removesuffix(PAPER)).cameras


def opened(entry: Entry, folder: Path) -> tuple[Recording, Drive, str] | None:
    """An entry's inputs as a recording, as any program gets them, its truth, and their hash; None without its files."""
    if entry.row.recording:
        source = public_recording(entry.row.recording)
        if source is None:
            return None
        assert source.truth is not None
        truth = np.asarray(source.truth.poses)
        start = Prior(Pose(*truth[0].tolist())) if entry.row.start_known else None
        return source, Drive(robot_setup(source), (), truth, source.events, start), files_digest(source.folder)
    drive = entry.drive()
    assert drive is not None
    write_inputs(drive, folder / entry.name, entry.name)
    return open_source(folder / entry.name), drive, digest(drive)


def files_digest(folder: Path) -> str:
    """A hash of a recording's files: of its tables what they hold, of its images the names and sizes."""
    import hashlib

    found = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        inside = read_text(path, 10_000_000) if path.suffix in (".csv", ".yaml", ".tum") else str(path.stat().st_size)
        found.update(f"{path.relative_to(folder)} {inside}".encode())
    return found.hexdigest()[:16]


def reference_ms() -> float:
    """The time of a fixed loop on this core: what updates are set beside."""
    times_s = []
    for _ in range(5):
        begun_s = time.thread_time()
        for _ in range(20):
            np.sqrt(_REFERENCE * _REFERENCE + 1.0).sum()
        times_s.append(time.thread_time() - begun_s)
    return _MS * min(times_s)


def scores_of(task: tuple[Entry, tuple[str, ...]]) -> list[Scored]:
    """What systems make of an entry; none where its files are not here."""
    entry, systems = task
    with TemporaryDirectory() as folder:
        found = opened(entry, Path(folder))
        if found is None:
            return []
        source, drive, inputs = found
        given = read_start(source.folder) if not entry.row.recording else drive.prior
        return [Scored(entry.name, system, inputs, _scored(entry, source, drive, given, system)) for system in systems]


def _scored(entry: Entry, source: Recording, drive: Drive, start: Prior | None, system: str) -> DriveScore:
    name = system.removesuffix(PAPER)
    settings = paper_settings(name) if system.endswith(PAPER) else None
    stepped = OrderedSystem(open_system(name, robot_setup(source), settings, np.random.default_rng(entry.robot)))
    if start is not None:
        stepped.reset(start)
    estimates: list[Estimate] = []
    times_s: list[float] = []
    reference = reference_ms()
    for frame in source:
        begun_s = time.thread_time()
        estimates.append(stepped.step(frame))
        times_s.append(time.thread_time() - begun_s)
    reference = min(reference, reference_ms())
    stamps_s = source.image_stamps / 1e9
    of = replace(drive, frames=[Frame(int(stamp)) for stamp in source.image_stamps])
    track = replace(track_of(of, estimates), times_s=stamps_s)
    ms = _MS * float(np.median(times_s))
    mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    score = score_of(track, entry.moments_s(of), entry.row.either_end)
    return replace(score, ms=ms, reference=ms / reference, mb=mb)


def export(entry: Entry, folder: Path, mcap: bool = True) -> str:
    """Write an entry's inputs into a folder, as a folder and as MCAP; returns their hash.

    What an earlier export has written is left. Raises InputError for a folder of that name that holds something else.
    """
    drive = entry.drive()
    if drive is None:
        return ""  # a public recording: everybody has its files
    target = folder / entry.name
    made = target.with_name(f"{entry.name}.part")
    shutil.rmtree(made, ignore_errors=True)  # of an export that was interrupted
    write_inputs(drive, made, entry.name)
    if target.exists():
        names = [path.name for path in made.iterdir()]
        same, _, _ = filecmp.cmpfiles(made, target, names, shallow=False)
        shutil.rmtree(made)
        if len(same) < len(names):
            raise InputError(f"{target}: exists already with other contents; choose another folder")
    else:
        made.rename(target)
    if mcap and not target.with_suffix(".mcap").exists():
        from touchline.sources.bags.with_rosbags import Codec
        from touchline.sources.bags.writing import McapWriter, write_recording

        codec = Codec()
        write_recording(open_source(target), McapWriter(target.with_suffix(".mcap"), codec), codec)
    return digest(drive)


def answers_scored(task: tuple[Entry, Path]) -> list[Scored]:
    """What a program's file of an entry is worth; none without the file, or without the entry's."""
    entry, results = task
    path = next((p for end in (".csv", ".tum") if (p := results / f"{entry.name}{end}").is_file()), None)
    if path is None:
        return []
    if entry.row.recording:
        source = public_recording(entry.row.recording)
        if source is None:
            return []
        drive, inputs = drive_of(source), files_digest(source.folder)
    else:
        made = entry.drive()
        assert made is not None
        drive, inputs = made, digest(made)
    track = track_of_answers(drive.times_s, drive.truth, read_answers(path))
    score = score_of(track, entry.moments_s(drive), entry.row.either_end)
    return [Scored(entry.name, results.name, inputs, score)]


# --- files of results -------------------------------------------------------------------------------------------------


def read_results(path: Path) -> tuple[dict[str, Any], list[Scored]]:
    """A file of results: what its first line says, and every drive. A last line that was cut off is left out.

    Raises InputError for a file that is none.
    """
    head: dict[str, Any] = {}
    found = []
    for number, line in enumerate(text_lines(path), start=1):
        try:
            tree = json.loads(line)
            if number == 1:
                head = tree | {"suite": tree["suite"]}
                continue
            score = tree.pop("score")
            measured: dict[str, Any] = {name: _value(name, value) for name, value in score.items()}
            found.append(Scored(**tree, score=DriveScore(**measured)))
        except (ValueError, KeyError, TypeError, AttributeError):
            if line.endswith("\n"):
                raise InputError(f"{path}, line {number}: is no line of a file of results") from None
    if not head:
        raise InputError(f"{path}: holds no results")
    return head, found


def _value(name: str, cell: Any) -> Any:
    """A figure of a drive from its cell, as `_cell` writes it."""
    if name == "recover_s":
        return tuple(float(wait) for wait in cell)
    if name in ("images", "wrong", "wrong_times"):
        return int(cell)
    if name in ("ms", "reference", "mb"):
        return None if cell is None else float(cell)
    return math.nan if cell is None else float(cell)


def result_line(scored: Scored) -> str:
    """One drive as a line: strict JSON, NaN as null, infinity as a word."""
    score = scored.score.to_dict() | {"recover_s": [_cell(wait) for wait in scored.score.recover_s]}
    tree = {**scored._asdict(), "score": {name: _cell(value) for name, value in score.items()}}
    return json.dumps(tree, allow_nan=False) + "\n"


def _cell(value: Any) -> Any:
    if not isinstance(value, float):
        return value
    if math.isnan(value):
        return None
    return "inf" if math.isinf(value) else round(value, 9)


def run_suite(
    suite: Suite, entries: Sequence[Entry], systems: Sequence[str], path: Path, workers: Workers
) -> Iterator[int]:
    """Run systems on entries and write each drive's figures behind those that the file holds; yields after every entry
    how many are done. What the file holds is not run again.

    Raises InputError where the file is of another suite.
    """
    done = _begun(suite, path)
    tasks = []
    for entry in entries:
        left = tuple(s for s in systems if takes(s, entry.row.track) and (entry.name, s) not in done)
        if left:
            tasks.append((entry, left))
    yield from written(path, workers.map(scores_of, tasks), len(entries) - len(tasks))


def score_answers(suite: Suite, entries: Sequence[Entry], results: Path, path: Path, workers: Workers) -> Iterator[int]:
    """Score a program's files as `run_suite` does."""
    done = _begun(suite, path)
    tasks = [(entry, results) for entry in entries if (entry.name, results.name) not in done]
    yield from written(path, workers.map(partial(answers_scored), tasks), len(entries) - len(tasks))


def written(path: Path, results: Iterator[Sequence[Scored]], done: int) -> Iterator[int]:
    """Write results behind those of a file; yields how many entries are done."""
    yield done
    with path.open("a", encoding="utf-8") as file:
        for number, scored in enumerate(results, start=done + 1):
            file.write("".join(map(result_line, scored)))
            file.flush()
            yield number


def _begun(suite: Suite, path: Path) -> set[tuple[str, str]]:
    """Entries and systems that a file holds; a new one gets its first line."""
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"suite": suite.name} | about()) + "\n", encoding="utf-8")
        return set()
    head, found = read_results(path)
    if head["suite"] != suite.name:
        raise InputError(f"{path}: holds results of {head['suite']}, not of {suite.name}; choose another file")
    if cut := len(text := read_text(path, _MAX_BYTES)) - (text.rfind("\n") + 1):  # a line that was not finished
        replace_file(path, text[:-cut].encode())
    return {(scored.entry, scored.system) for scored in found}


def by_row(found: Sequence[Scored], suite: Suite) -> Mapping[tuple[str, str], list[DriveScore]]:
    """The drives' figures by row and system, rows in the suite's order."""
    order = {row.name: [] for row in suite.rows}  # type: ignore[var-annotated]
    for scored in found:
        order.setdefault(scored.entry.rpartition("-")[0], []).append(scored)
    table: dict[tuple[str, str], list[DriveScore]] = {}
    for name, each in order.items():
        for scored in each:
            table.setdefault((name, scored.system), []).append(scored.score)
    return table
