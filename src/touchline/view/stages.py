"""Each stage's picture, from the image to the field lines drawn over it: one file each and one sheet of all."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from touchline.types import ImageArray
from touchline.view.picture_files import save_picture

_TILE_PX = 640
_TITLE_PX = 40
_GAP_PX = 12
_PAPER = (24, 24, 24)


def contact_sheet(pictures: Mapping[str, ImageArray], columns: int = 3) -> ImageArray:
    """All pictures on one sheet (H, W, 3), each under its title, in tiles of one width; a row as high as it needs."""
    tiles = [_tile(f"{number}  {title}", picture) for number, (title, picture) in enumerate(pictures.items(), start=1)]
    columns = min(columns, len(tiles))
    rows = [tiles[first : first + columns] for first in range(0, len(tiles), columns)]
    return np.vstack([_row(row, columns) for row in rows])


def _row(tiles: Sequence[ImageArray], columns: int) -> ImageArray:
    height, width = max(len(tile) for tile in tiles), tiles[0].shape[1]
    row: ImageArray = np.full((height, columns * width, 3), _PAPER[0], dtype=np.uint8)
    for number, tile in enumerate(tiles):
        row[: len(tile), number * width : (number + 1) * width] = tile
    return row


def save_pictures(pictures: Mapping[str, ImageArray], folder: Path) -> list[Path]:
    """Write NN-title.png for each picture into an existing folder, and stages.png, the sheet of all, if there are more
    than one. Returns the paths.
    """
    paths = []
    for number, (title, picture) in enumerate(pictures.items(), start=1):
        word = "-".join("".join(c if c.isalnum() else " " for c in title.replace("'", "")).split()).lower()
        paths.append(folder / f"{number:02d}-{word}.png")
        save_picture(paths[-1], picture)
    if len(pictures) > 1:
        paths.append(folder / "stages.png")
        save_picture(paths[-1], contact_sheet(pictures))
    return paths


def _tile(title: str, picture: ImageArray) -> ImageArray:
    height, width = picture.shape[:2]
    scale = min(_TILE_PX / width, _TILE_PX / height)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    tile = np.full((size[1] + _TITLE_PX + _GAP_PX, _TILE_PX + 2 * _GAP_PX, 3), _PAPER[0], dtype=np.uint8)
    left, top = _GAP_PX + (_TILE_PX - size[0]) // 2, _TITLE_PX
    tile[top : top + size[1], left : left + size[0]] = small
    ink = (235, 235, 235)
    cv2.putText(tile, title, (_GAP_PX, _TITLE_PX - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.65, ink, 1, cv2.LINE_AA)
    return tile
