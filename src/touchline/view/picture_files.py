"""Pictures into files."""

from pathlib import Path

import cv2

from touchline.errors import InputError
from touchline.files.new import PICTURE_ENDINGS, check_new_file, write_new_file
from touchline.types import ImageArray


def check_new_picture(path: Path) -> None:
    """Raises InputError unless a picture can be written there without overwriting anything."""
    check_new_file(path, PICTURE_ENDINGS, "a picture")


def save_picture(path: Path, picture: ImageArray) -> None:
    """Write an image (H, W, 3), BGR, into a new file, as its ending says. Raises InputError if that cannot be done."""
    try:
        done, code = cv2.imencode(path.suffix.lower(), picture)
    except cv2.error:
        done = False
    if not done:
        raise InputError(f"{path}: the picture cannot be encoded")
    write_new_file(path, code.tobytes())
