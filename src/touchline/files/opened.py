"""Opened files: only regular ones, and never more of them than fits; all reading of files goes through here."""

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, TextIO

from touchline.errors import InputError

MAX_LINE = 65536
_MEGABYTE = 1_000_000
_KINDS = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


class UnreadableError(InputError):
    """A file that cannot be read, or not all of it. what: the reason without the path; missing: there is no file."""

    def __init__(self, path: Path, what: str, missing: bool = False) -> None:
        super().__init__(f"{path}: {what}")
        self.what = what
        self.missing = missing


class OwnFolder:
    """A folder whose files name others, such as a recording: what lies elsewhere is not read unless it is asked for.

    follow_links: read whatever is named, absolute paths, `..` and links that lead out of the folder included.
    """

    def __init__(self, path: Path, follow_links: bool = False) -> None:
        self.path = path
        self.follow_links = follow_links
        self._root = os.path.realpath(path)
        self._inside: set[str] = set()  # folders in it: not followed anew for each of their files

    def file(self, name: str) -> Path:
        """The path of a file that is named relative to the folder. Raises UnreadableError if it lies elsewhere."""
        path = self.path / name
        if self.follow_links:
            return path
        parent, last = os.path.split(name)
        known = parent in self._inside and last not in ("", ".", "..") and not os.path.islink(path)  # noqa: PTH114 (the other raises, for too long a name)
        if not known and not self._is_inside(path):
            what = f"leads out of {self.path}, and what lies elsewhere is only read with --follow-links"
            raise UnreadableError(path, what)
        if not known and self._is_inside(path.parent):
            self._inside.add(parent)
        return path

    def _is_inside(self, path: Path) -> bool:
        try:
            return os.path.commonpath((self._root, os.path.realpath(path))) == self._root
        except (OSError, ValueError):  # a zero byte in the name, another drive
            return False


def open_bytes(path: Path) -> BinaryIO:
    """Open a regular file for reading. Raises UnreadableError for anything else: a pipe or a device may never end."""
    _check_regular(path)
    try:
        return path.open("rb")
    except OSError as error:
        raise _unreadable(path, error) from None


def open_text(path: Path, errors: str = "strict", newline: str | None = None) -> TextIO:
    """Open a regular file as UTF-8 text, a byte order mark left out; lines of any length are read with `text_lines`.

    Raises UnreadableError as `open_bytes`.
    """
    _check_regular(path)
    try:
        return path.open(encoding="utf-8-sig", errors=errors, newline=newline)
    except OSError as error:
        raise _unreadable(path, error) from None


def read_bytes(path: Path, max_bytes: int, more: str = "") -> bytes:
    """A whole file. more: what to do about one of more than `max_bytes`, for the message.

    Raises UnreadableError if it is larger, or cannot be read.
    """
    with open_bytes(path) as file:
        try:
            size = os.fstat(file.fileno()).st_size
            data = (
                b"" if size > max_bytes else file.read(size + 1)
            )  # memory is taken for what is asked, not for what comes
            if size < len(data) <= max_bytes:  # it grew meanwhile, or tells no size
                data += file.read(max_bytes + 1 - len(data))
        except OSError as error:
            raise _unreadable(path, error) from None
    if max(size, len(data)) > max_bytes:
        raise UnreadableError(path, f"is larger than {max_bytes / _MEGABYTE:g} MB, the most that is read{more}")
    return data


def read_text(path: Path, max_bytes: int) -> str:
    """A whole file of UTF-8 text, a byte order mark left out. Raises UnreadableError as `read_bytes`, and if it is no
    text.
    """
    try:
        return read_bytes(path, max_bytes).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError:
        raise UnreadableError(path, "is not a text file") from None


def text_lines(path: Path, errors: str = "strict", newline: str | None = None) -> Iterator[str]:
    """The lines of a text file of any length, one by one. errors, newline: as of `open`.

    Raises UnreadableError if it cannot be read, is no text, or has a line of more than MAX_LINE characters.
    """
    with open_text(path, errors, newline) as file:
        number = 0
        try:
            while line := file.readline(MAX_LINE + 1):
                number += 1
                if len(line) > MAX_LINE:
                    raise UnreadableError(path, f"line {number} is longer than {MAX_LINE} characters")
                yield line
        except OSError as error:
            raise _unreadable(path, error) from None
        except UnicodeDecodeError:
            raise UnreadableError(path, "is not a text file") from None


def _check_regular(path: Path) -> None:
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise _unreadable(path, error) from None
    if stat.S_ISDIR(mode):
        raise UnreadableError(path, f"cannot be read ({os.strerror(errno.EISDIR)})")
    if not stat.S_ISREG(mode):
        kind = next((words for is_kind, words in _KINDS if is_kind(mode)), "something else")
        raise UnreadableError(path, f"cannot be read (it is {kind}; only regular files are read)")


def _unreadable(path: Path, error: OSError | ValueError) -> UnreadableError:
    missing = isinstance(error, FileNotFoundError)
    return UnreadableError(path, f"cannot be read ({getattr(error, 'strerror', None) or error})", missing)
