"""A recording of any kind written as a folder."""

import shutil
from collections.abc import Callable
from pathlib import Path, PurePosixPath

from touchline.errors import InputError
from touchline.files.opened import UnreadableError
from touchline.sources.bags.layout import TABLES, WHOLE
from touchline.sources.folder import Recording


def write_folder(recording: Recording, folder: Path, on_image: Callable[[], None] | None = None) -> None:
    """Copy a recording's files as they are into a new folder; its images as they are stored.

    on_image: called after every image. Raises InputError where an image's name leads out of the folder.
    """
    folder.mkdir(parents=True)
    for name in (*WHOLE, *TABLES):
        if (recording.folder / name).is_file():
            shutil.copyfile(recording.file(name), folder / name)
    for row, name in recording.listed_images():
        path = PurePosixPath(name)
        if path.is_absolute() or ".." in path.parts or "\0" in name:
            raise InputError(f"{recording.path}: the image name {name!r} leads out of the recording; it is not written")
        if (folder / path).exists():
            continue  # a name that stands twice is one file
        try:
            data = recording.image_store.file_bytes(row, name)
        except UnreadableError:
            continue  # as it is in the source: a row without its file
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        with (folder / path).open("xb") as file:
            file.write(data)
        if on_image is not None:
            on_image()
