"""Which recordings a command means: paths, folders of recordings, lists, and addresses of an object store (fsspec)."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from touchline.errors import InputError, TouchlineError
from touchline.files.new import file_name
from touchline.files.opened import text_lines
from touchline.sources.bags.kinds import find_bag

_LISTS = (".txt", ".lst")


def is_address(text: str) -> bool:
    """Whether it names an object store (s3://bucket/recording), not a path."""
    return "://" in text


def is_season(given: Sequence[str], output: str | None = None) -> bool:
    """Whether more than one recording is meant, or one that is fetched from a store or whose results go there."""
    if len(given) != 1 or is_address(output or ""):
        return True
    path = Path(given[0])
    listed = path.suffix in _LISTS and path.is_file()
    return is_address(given[0]) or listed or (path.is_dir() and not _is_recording(path) and any(_inside(path)))


def find_recordings(given: Sequence[str]) -> list[str]:
    """The recordings that are meant, in order, each once: a recording itself; all that a folder holds, at any depth;
    those that a text file lists, a line each; an address as it is. Paths are whole ones: a cluster's workers find
    them, too, and a journal tells another folder's recordings apart.

    Raises InputError for what is not there, and for a folder or list without recordings.
    """
    found = [each if is_address(each) else _whole(Path(each)) for text in given for each in _meant(text)]
    return list(dict.fromkeys(found))


def _whole(path: Path) -> str:
    """The path from the root; a link keeps its name, which is the recording's."""
    return str(path.resolve() if path.name in ("", "..") else path.parent.resolve() / path.name)


def _meant(text: str) -> Iterator[str]:
    path = Path(text)
    if is_address(text):
        yield text.rstrip("/")
    elif path.suffix in _LISTS and path.is_file():
        lines = [line.strip() for line in text_lines(path)]
        named = [line for line in lines if line and not line.startswith("#")]
        if not named:
            raise InputError(f"{path}: lists no recording; expected a path in each line")
        for line in named:
            yield from _meant(line if is_address(line) else str(path.parent / line))
    elif path.is_dir() and not _is_recording(path):
        inside = list(_inside(path))
        if not inside:
            raise InputError(f"{path}: neither a recording nor a folder that holds recordings")
        yield from inside
    else:
        yield str(path)  # what is wrong with it is told by the run


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


def folder_names(recordings: Sequence[str], known: Mapping[str, str] | None = None) -> list[str]:
    """A folder's name for each recording: its own, with a number where several have the same.

    known: recording -> name, of recordings that have theirs.
    """
    names = dict(known or {})
    taken = set(names.values())
    for recording in recordings:
        if recording in names:
            continue
        name = file_name(Path(recording).name if not is_address(recording) else recording.rsplit("/", 1)[-1])
        number = 1
        while (unique := name if number == 1 else f"{name}-{number}") in taken:
            number += 1
        names[recording] = unique
        taken.add(unique)
    return [names[recording] for recording in recordings]


def names_in(place: str) -> set[str]:
    """The names of what lies in a folder or below an address; none where it is not there.

    Raises TouchlineError if it cannot be read.
    """
    try:
        if not is_address(place):
            return {path.name for path in Path(place).iterdir()}
        system, path = open_store(place)
        return {name.rstrip("/").rsplit("/", 1)[-1] for name in system.ls(path, detail=False)}
    except FileNotFoundError:
        return set()
    except InputError:
        raise
    except Exception as error:  # each store has its own
        raise TouchlineError(f"{place}: cannot be read ({type(error).__name__}: {error})") from None


def fingerprint(recording: str) -> str:
    """A hash of the names, sizes and times of a recording's files: another one means that it has changed.

    Of an address, its files' names and sizes. Empty where it cannot be looked at.
    """
    try:
        if is_address(recording):
            system, place = open_store(recording)
            try:
                found = system.find(place, detail=True)
            except Exception:  # each store has its own
                return ""
            rows = [f"{name} {entry.get('size')}" for name, entry in sorted(found.items())]
        else:
            path = Path(recording)
            files = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
            rows = [f"{each} {(seen := each.stat()).st_size} {seen.st_mtime_ns}" for each in files]
    except (OSError, TouchlineError):
        return ""
    return hashlib.sha256("\n".join(rows).encode()).hexdigest()[:16]


@contextmanager
def at_hand(recording: str) -> Iterator[Path]:
    """The recording as a path, for as long as the block lasts: an address is fetched.

    Raises TouchlineError if it cannot be.
    """
    if not is_address(recording):
        yield Path(recording)
        return
    system, path = open_store(recording)
    with TemporaryDirectory() as scratch:
        target = Path(scratch) / path.rsplit("/", 1)[-1]
        try:
            system.get(path, str(target), recursive=True)
        except Exception as error:  # each store has its own
            raise TouchlineError(f"{recording}: cannot be fetched ({type(error).__name__}: {error})") from None
        try:
            yield target
        except TouchlineError as error:
            raise TouchlineError(str(error).replace(str(target), recording)) from None


def keep(folder: Path, address: str) -> None:
    """Copy a finished file or folder to an address, in place of an older one. Raises TouchlineError if it cannot be."""
    system, path = open_store(address)
    try:
        if folder.is_dir() and system.exists(path):
            system.rm(path, recursive=True)
        system.makedirs(path.rpartition("/")[0], exist_ok=True)
        system.put(str(folder), path, recursive=True)
    except Exception as error:  # each store has its own
        raise TouchlineError(f"{address}: cannot be written ({type(error).__name__}: {error})") from None


def open_store(address: str) -> tuple[Any, str]:
    """An address's file system and the path in it. Raises InputError where none is installed."""
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
