"""`touchline mark`: click points, colour regions and lines in images, on a page in the browser."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from touchline.cli.console import say
from touchline.errors import InputError
from touchline.files.new import write_new_file
from touchline.messages import counted

_MAX_IMAGES = 200


def mark(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="Images to mark, one or more.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="DIR", help="Where the files go (default: the recording, or the images' folder)."
        ),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page; 0: any that is free.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
) -> None:
    """Mark images on a local page: points (marks.csv), colours (regions.yaml), field lines (pixels.csv).

    touchline mark board/images/000000.jpg   then touchline calibrate camera board/marks.csv -o camera.yaml
    """
    from touchline.view.marking.clicks import files_of, read_clicks
    from touchline.view.marking.server import MarkServer

    folder = output if output is not None else _folder_of(images[0])
    pictures = _pictures(images, folder)
    files = list(pictures)

    def save(text: bytes) -> list[str]:
        texts = files_of(read_clicks(text, files), files)
        if not texts:
            raise InputError("nothing is marked yet")
        _refuse_existing(folder, list(texts))
        for name, content in texts.items():
            write_new_file(folder / name, content.encode())
        return [str(folder / name) for name in texts]

    try:
        server = MarkServer(pictures, save, port)
    except OSError as error:
        raise InputError(f"--port {port}: cannot be used ({error.strerror}); take another, or 0") from None
    say(f"{counted(len(files), 'image')} to mark at {server.url} (this machine alone; Ctrl-C ends without saving)")
    if browser and _has_screen():
        import webbrowser

        webbrowser.open(server.url)
    say(*(f"written: {name}" for name in server.serve()))


def _has_screen() -> bool:
    """Whether there is one to open a browser on: without it, one in the terminal would be taken."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def _folder_of(image: Path) -> Path:
    """The recording that an image lies in, or its own folder."""
    for folder in (image.parent, image.parent.parent):
        if (folder / "sequence.yaml").is_file() or (folder / "images.csv").is_file():
            return folder
    return image.parent


def _pictures(images: list[Path], folder: Path) -> dict[str, bytes]:
    """PNG files by the names that the marks give them: relative to the folder of the marks where they lie in it."""
    import cv2

    from touchline.files.images import read_image

    if len(images) > _MAX_IMAGES:
        raise InputError(f"{len(images)} images are too many to mark at once; {_MAX_IMAGES} are the most")
    pictures: dict[str, bytes] = {}
    for path in images:
        inside = path.resolve().is_relative_to(folder.resolve())
        name = path.resolve().relative_to(folder.resolve()).as_posix() if inside else path.name
        if any(letter in ',"' or not letter.isprintable() for letter in name):
            raise InputError(f"{path}: a name with commas or quotes cannot stand in marks.csv; rename the image")
        if name in pictures:
            raise InputError(f"{path}: two images are called {name}; mark them apart")
        done, code = cv2.imencode(".png", read_image(path))
        if not done:
            raise InputError(f"{path}: cannot be shown")
        pictures[name] = code.tobytes()
    return pictures


def _refuse_existing(folder: Path, names: list[str]) -> None:
    """Before any is written: all can be, or none."""
    for name in names:
        if (folder / name).exists():
            raise InputError(f"{folder / name}: exists already and is not overwritten; see --output")
