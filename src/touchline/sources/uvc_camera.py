"""A camera at a USB port, through OpenCV (V4L2 on Linux): offers `set` and `grab` to the exposure control."""

import math
import time
from typing import Any

import cv2
import numpy as np

from touchline.errors import InputError, TouchlineError
from touchline.types import ImageArray

_MANUAL, _UNITS_PER_MS = 1.0, 10.0  # V4L2: exposure_auto 1 is manual; exposure_absolute counts 100 µs


class UvcCamera:
    """One V4L2/UVC camera with automatic exposure off, unless it is to stay as it is (automatic).

    gain_units: driver's units of a gain of 1 and of one more: gain g is set as gain_units[0] + (g - 1) · gain_units[1].
    stale_images: thrown away after a change, exposed before it took effect. capture: an opened cv2.VideoCapture, or
    anything like it. Raises InputError if the camera can't be opened, TouchlineError if it refuses a setting.
    """

    def __init__(
        self,
        device: int | str = 0,
        gain_units: tuple[float, float] = (1.0, 1.0),
        stale_images: int = 2,
        capture: Any = None,
        automatic: bool = False,
    ) -> None:
        self._name = f"camera {device}"
        self._capture = cv2.VideoCapture(device) if capture is None else capture
        if not self._capture.isOpened():
            raise InputError(f"{self._name}: cannot be opened; is it plugged in and free?")
        self._gain_units = gain_units
        self._stale_images = stale_images
        self._stale = 0
        if not automatic:
            self._want(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL, "manual exposure")

    def set(self, exposure_ms: float, gain: float) -> None:
        """Use these settings from the next image on."""
        if not (math.isfinite(exposure_ms) and math.isfinite(gain) and exposure_ms > 0.0 and gain > 0.0):
            raise InputError(f"{self._name}: exposure and gain must be positive, found {exposure_ms} ms and {gain}")
        first, each = self._gain_units
        self._want(cv2.CAP_PROP_EXPOSURE, max(round(exposure_ms * _UNITS_PER_MS), 1), f"exposure {exposure_ms:g} ms")
        self._want(cv2.CAP_PROP_GAIN, round(first + (gain - 1.0) * each), f"gain {gain:g}")
        self._stale = self._stale_images

    def grab(self) -> ImageArray:
        """The next image (H, W, 3), B, G, R, exposed with the settings set last."""
        while self._stale > 0:
            self._capture.grab()
            self._stale -= 1
        for _ in range(3):  # a USB camera loses a frame now and then
            done, image = self._capture.read()
            if done:
                return np.asarray(image, dtype=np.uint8)
            time.sleep(0.01)
        raise TouchlineError(f"{self._name}: gives no image any more; has it been unplugged?")

    def close(self) -> None:
        """Let go of the camera."""
        self._capture.release()

    def _want(self, setting: int, value: float, words: str) -> None:
        if not self._capture.set(setting, value):
            raise TouchlineError(f"{self._name}: refuses {words}; its driver's settings: v4l2-ctl --list-ctrls")
