"""Images as they are localised, with what was seen and the projected field lines: for whoever looks at them."""

import time

from touchline.camera import Camera
from touchline.field import FieldModel
from touchline.motion import LeanFilter
from touchline.types import Estimate, Frame
from touchline.view.run_pictures import thumbnail

_EVERY_S, _WIDTH_PX = 0.2, 640  # a picture costs as much as an estimate


class Overlays:
    """Draws them, five a second at most."""

    def __init__(self, field: FieldModel | None) -> None:
        self._field = field
        self._leaning = LeanFilter()
        self._last_s = -_EVERY_S

    def picture(self, camera: Camera | None, frame: Frame, estimate: Estimate) -> bytes | None:
        """A JPEG; None where there is no image, or one was drawn just now."""
        self._leaning.add(frame)
        if camera is None or time.monotonic() < self._last_s + _EVERY_S:
            return None
        self._last_s = time.monotonic()
        return thumbnail(camera, self._field, frame, estimate, self._leaning.lean(frame.stamp_ns), _WIDTH_PX)
