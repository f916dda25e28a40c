"""Pictures into files."""

from __future__ import annotations

from pathlib import Path

import cv2

from touchline.errors import InputError
from touchline.types import ImageArray

PICTURE_ENDINGS = (".png", ".jpg", ".jpeg")


def check_new_picture(path: Path) -> None:
    """Raises InputError unless a picture can be written there without overwriting anything."""
    if path.suffix.lower() not in PICTURE_ENDINGS:
        raise InputError(f"{path}: pictures are written as .png or .jpg")
    if path.exists():
        raise InputError(f"{path}: exists already and is not overwritten; choose another name")


def save_picture(path: Path, picture: ImageArray) -> None:
    """Write an image (H, W, 3), BGR, as the file's ending says. Raises InputError if that cannot be done."""
    try:
        done, code = cv2.imencode(path.suffix.lower(), picture)
    except cv2.error:
        done = False
    if not done:
        raise InputError(f"{path}: the picture cannot be encoded")
    try:
        path.write_bytes(code.tobytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
