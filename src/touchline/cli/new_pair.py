"""The two files that a calibration writes: its result, and a picture of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from touchline.cli.console import say, warn
from touchline.errors import InputError
from touchline.files.new import check_new_file, write_new_file

if TYPE_CHECKING:
    from touchline.calibration.calibrated import Calibrated
    from touchline.types import ImageArray

NewFile = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The file to write; a new one.")]
NewPicture = Annotated[
    Path | None,
    typer.Option("--picture", metavar="FILE", help="A picture of it (default: the output's name with .png)."),
]

CAMERA_ENDINGS = (".yaml", ".yml")


def new_files(output: Path, endings: tuple[str, ...], what: str, picture: Path | None) -> Path:
    """The picture's file: the one that was asked for, or the output's name with .png.

    Raises InputError unless both can be written without overwriting anything, and say by their endings what they are.
    """
    check_new_file(output, endings, what)
    beside = output.with_suffix(".png")
    if picture is None and beside.exists():
        raise InputError(
            f"{beside}: exists already and is not overwritten; the picture of {output.name} needs another name: "
            "--picture FILE"
        )
    from touchline.view.picture_files import check_new_picture

    check_new_picture(picture or beside)
    return picture or beside


def print_lines(words: str, *files: Path) -> None:
    """What was found, and which files were written."""
    say(words, *(f"written: {file}" for file in files))


def calibration_of_a_paper(name: str) -> Callable[..., Calibrated]:
    """The calibration `mirror`, `range` or `imu` of a paper, which an entry point leads to."""
    from touchline.plugins import entry_points_of, load

    entry = entry_points_of("touchline.calibrations").get(name)
    found: Callable[..., Calibrated] | None = None if entry is None else load(entry)
    if found is None:
        raise InputError(f"calibrate {name} is not installed with this touchline: install it again")
    return found


def write_calibrated(found: Calibrated, output: Path, picture: Path) -> None:
    """Write a calibration's two files, and say what was found and left out."""
    for message in found.left_out:
        warn(f"left out: {message}")
    write_pair(output, found.text, picture, found.picture, found.words)


def write_pair(output: Path, text: str, picture: Path, drawn: ImageArray, words: str) -> None:
    """Write both, B, G, R of the picture, and say what was found."""
    from touchline.view.picture_files import save_picture

    write_new_file(output, text.encode())
    save_picture(picture, drawn)
    print_lines(words, output, picture)
