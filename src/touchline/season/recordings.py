"""Which recordings a command means: paths, folders of recordings, and addresses of an object store (fsspec)."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from touchline.errors import InputError, TouchlineError
from touchline.files.new import file_name
from touchline.sources.bags.kinds import find_bag


def is_address(text: str) -> bool:
    """Whether it is the address of an object store (s3://bucket/recording), not a path."""
    return "://" in text


def find_recordings(given: Sequence[str]) -> list[str]:
    """The recordings that are meant, in order, each once: a recording itself, all recordings in a folder at any depth,
    and addresses as they are. Paths are absolute, so that a cluster's workers find them.

    Raises InputError for a folder without recordings.
    """
    found = [each if is_address(each) else _absolute(Path(each)) for text in given for each in _meant(text)]
    return list(dict.fromkeys(found))


def _absolute(path: Path) -> str:
    """The absolute path; a link keeps its name, which is the recording's."""
    return str(path.resolve() if path.name in ("", "..") else path.parent.resolve() / path.name)


def _meant(text: str) -> Iterator[str]:
    path = Path(text)
    if is_address(text):
        yield text.rstrip("/")
    elif path.is_dir() and not _is_recording(path):
        inside = list(_inside(path))
        if not inside:
            raise InputError(f"{path}: neither a recording nor a folder that holds recordings")
        yield from inside
    else:
        yield str(path)  # the run says what is wrong with it


def _is_recording(path: Path) -> bool:
    return (path / "sequence.yaml").is_file() or find_bag(path) is not None


def _inside(folder: Path) -> Iterator[str]:
    try:
        below = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({error.strerror})") from None
    for path in below:
        if _is_recording(path):
            yield str(path)
        elif path.is_dir() and not path.is_symlink() and not path.name.startswith("."):
            yield from _inside(path)


def folder_names(recordings: Sequence[str], known: Mapping[str, str]) -> list[str]:
    """The name of each recording's run: the recording's own, with a number where several have the same.

    known: names of runs by their recordings, which stay as they are.
    """
    names = dict(known)
    for recording in recordings:
        name = unique = file_name(recording.rstrip("/").rsplit("/", 1)[-1])
        number = 1
        while recording not in names and unique in names.values():
            number += 1
            unique = f"{name}-{number}"
        names.setdefault(recording, unique)
    return [names[recording] for recording in recordings]


def fingerprint(recording: str) -> str:
    """A hash of the names, sizes and times of a recording's files: another hash means that the recording has changed.

    Of an address, the files' names and sizes. Empty where the files cannot be listed.
    """
    try:
        if is_address(recording):
            system, place = open_store(recording)
            files = system.find(place, detail=True).items()
            rows = [f"{name} {entry.get('size')}" for name, entry in sorted(files)]
        else:
            path = Path(recording)
            paths = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
            rows = [f"{each} {(seen := each.stat()).st_size} {seen.st_mtime_ns}" for each in paths]
    except Exception:  # each store has its own
        return ""
    return hashlib.sha256("\n".join(rows).encode()).hexdigest()[:16]


@contextmanager
def fetched(recording: str) -> Iterator[Path]:
    """The recording as a path for as long as the block lasts. Raises TouchlineError if an address cannot be fetched."""
    if not is_address(recording):
        yield Path(recording)
        return
    with TemporaryDirectory() as scratch:
        with opened(recording, "fetched") as (system, path):
            target = Path(scratch) / path.rsplit("/", 1)[-1]
            system.get(path, str(target), recursive=True)
        try:
            yield target
        except TouchlineError as error:
            raise TouchlineError(str(error).replace(str(target), recording)) from None


def upload(folder: Path, address: str) -> None:
    """Copy a folder to an address, in place of an older one. Raises TouchlineError if it cannot be written."""
    with opened(address, "written") as (system, path):
        if system.exists(path):
            system.rm(path, recursive=True)
        system.makedirs(path.rpartition("/")[0], exist_ok=True)
        system.put(str(folder), path, recursive=True)


@contextmanager
def opened(address: str, what: str) -> Iterator[tuple[Any, str]]:
    """An address's file system and the path in it. Errors within the block become a TouchlineError: not `what`."""
    system, path = open_store(address)
    try:
        yield system, path
    except Exception as error:  # each store has its own
        raise TouchlineError(f"{address}: cannot be {what} ({type(error).__name__}: {error})") from None


def open_store(address: str) -> tuple[Any, str]:
    """An address's file system and the path in it. Raises InputError where its package is not installed."""
    try:
        from fsspec.core import url_to_fs

        system, path = url_to_fs(address)
    except ImportError as error:
        raise InputError(
            f"{address}: needs pip install 'touchline[season]' and its store's package ({error})"
        ) from None
    except ValueError as error:
        raise InputError(f"{address}: {error}") from None
    return system, str(path)
