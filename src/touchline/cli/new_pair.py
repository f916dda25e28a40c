"""The two files that a calibration writes: its result, and a picture of it."""

from __future__ import annotations

from pathlib import Path

from touchline.errors import InputError
from touchline.files.new import check_new_file

CAMERA_ENDINGS = (".yaml", ".yml")


def new_files(output: Path, endings: tuple[str, ...], what: str, picture: Path | None) -> Path:
    """The picture's file: the one that was asked for, or the output's name with .png.

    Raises InputError unless both can be written without overwriting anything, and say by their endings what they are.
    """
    check_new_file(output, endings, what)
    if picture is not None:
        _check_picture(picture)
        return picture
    beside = output.with_suffix(".png")
    if beside.exists():
        raise InputError(
            f"{beside}: exists already and is not overwritten; the picture of {output.name} needs another name: "
            "--picture FILE"
        )
    _check_picture(beside)
    return beside


def _check_picture(path: Path) -> None:
    from touchline.view.picture_files import check_new_picture

    check_new_picture(path)


def print_lines(words: str, *files: Path) -> None:
    """What was found, and which files were written."""
    from touchline.cli.console import output

    console = output()
    console.print(words, markup=False)
    for file in files:
        console.print(f"written: {file}", markup=False)
