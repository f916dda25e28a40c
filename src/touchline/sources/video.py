"""The images of a video file, through OpenCV."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from touchline.files.images import ImageSize, too_large
from touchline.files.opened import UnreadableError, open_bytes
from touchline.sources.decoding import Decoded
from touchline.sources.problems import ProblemKind

ENDINGS = (".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm")


class VideoImages:
    """An image store (see `ImageStore`) of the images of a video, decoded one after the other.

    Raises UnreadableError if the file is no video.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._next = 0
        self._capture = self._opened()
        sides = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        if (what := too_large(ImageSize(*(int(self._capture.get(side)) for side in sides)))) is not None:
            raise UnreadableError(path, what)

    def stamps(self) -> array[int]:
        """The time of every image (ns), from 0, as the file tells it; as its rate tells it where it tells none."""
        self._restart()
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        stamps = array("q")
        while self._capture.grab():
            stamp = round(1e6 * float(self._capture.get(cv2.CAP_PROP_POS_MSEC)))
            if stamps and stamp <= stamps[-1]:
                stamp = round(len(stamps) * 1e9 / rate) if rate > 0.0 else stamps[-1] + 1
            stamps.append(stamp)
        self._restart()
        if not stamps:
            raise UnreadableError(self._path, "holds no image that can be decoded")
        return array("q", [stamp - stamps[0] for stamp in stamps])

    def decode(self, row: int, name: str, expected: tuple[int, int] | None) -> Decoded:
        """As `ImageStore` says."""
        if row < self._next:
            self._restart()
        while self._next < row and self._capture.grab():
            self._next += 1
        done, pixels = self._capture.read()
        self._next += 1
        if not done or pixels is None:
            return Decoded(None, ProblemKind.BROKEN_IMAGE, "cannot be decoded")
        return Decoded(np.asarray(pixels, dtype=np.uint8))

    def file_bytes(self, row: int, name: str) -> bytes:
        """As `ImageStore` says: a PNG file, which loses nothing of what the video holds."""
        decoded = self.decode(row, name, None)
        if decoded.pixels is None:
            raise UnreadableError(self._path, decoded.what)
        return cv2.imencode(".png", decoded.pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()

    def _restart(self) -> None:
        self._capture.release()
        self._capture, self._next = self._opened(), 0

    def _opened(self) -> Any:
        open_bytes(self._path).close()  # a regular file: OpenCV would open devices and addresses, too
        capture = cv2.VideoCapture(str(self._path.resolve()), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise UnreadableError(self._path, "is not a video that can be read")
        return capture
