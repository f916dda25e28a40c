"""New files: never over an older file, in folders that are made where they are missing, and whole or not at all."""

import os
from contextlib import suppress
from pathlib import Path

from touchline.errors import InputError, TouchlineError

PICTURE_ENDINGS = (".png", ".jpg", ".jpeg")
_MAX_NAME = 200  # bytes; file systems take 255, and something is put behind it


def file_name(words: str) -> str:
    """A name as one file or folder can have it: no path, nothing that can't be printed, not too long."""
    plain = "".join("-" if letter in "/\\" or not letter.isprintable() else letter for letter in words)
    return plain.encode()[:_MAX_NAME].decode(errors="ignore").strip(". -") or "unnamed"


def check_new_file(path: Path, endings: tuple[str, ...], what: str = "the file") -> None:
    """Whether a file can be written there later: asked before the work for it begins.

    endings: of the name, in lower case, the usual two first; what: what the file is, for the message.
    Raises InputError for another ending, for a file that exists, and where no folder can be made.
    """
    if path.suffix.lower() not in endings:
        raise InputError(f"{path}: {what} is written as {' or '.join(endings[:2])}")
    check_new_path(path)


def check_new_path(path: Path) -> None:
    """Whether a file or folder can be made there later. Raises InputError if it exists, or if nothing can be made."""
    try:
        exists = path.exists()
        nearest = next(folder for folder in path.absolute().parents if folder.exists())
    except (OSError, ValueError) as error:  # a name too long, a folder that may not be looked into
        raise InputError(f"{path}: cannot be written ({getattr(error, 'strerror', None) or error})") from None
    if exists:
        raise InputError(f"{path}: exists already and is not overwritten; choose another name")
    if not nearest.is_dir():
        raise InputError(f"{path}: cannot be written ({nearest} is no folder)")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError(f"{path}: cannot be written (nothing may be made in {nearest})")


def write_new_file(path: Path, data: bytes) -> None:
    """Write a file, and make its folder where it is missing. Raises InputError if it exists or cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({path.parent}: {error.strerror})") from None
    try:
        path.open("xb").close()
    except FileExistsError:
        raise InputError(f"{path}: exists already and is not overwritten; choose another name") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    try:
        replace_file(path, data)
    except TouchlineError as error:
        with suppress(OSError):
            path.unlink()
        raise InputError(str(error)) from None


def replace_file(path: Path, data: bytes) -> None:
    """Write a file of which there may be an older version: beside it, on the disk, and then in its place.

    A crash or a full disk leaves the older version as it was. Raises TouchlineError, which names the file.
    """
    beside = path.with_name(f"{path.name}.part")
    try:
        with beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except OSError as error:
        with suppress(OSError):
            beside.unlink()
        raise TouchlineError(f"{path}: cannot be written ({error.strerror})") from None
