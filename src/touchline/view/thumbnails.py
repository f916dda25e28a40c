"""Small pictures of a run: the image with what was seen in it, as the report's slider shows it."""

from __future__ import annotations

import cv2

from touchline.evaluation.runner import Thumbnails
from touchline.motion.attitude import view_at
from touchline.sources import Recording
from touchline.types import Estimate, Frame, Status
from touchline.view.overlay import overlay_image

_WIDTH_PX, _JPEG_QUALITY = 320, 70


def thumbnails(source: Recording) -> Thumbnails:
    """What draws small pictures of a recording's frames: the image, what was seen, field lines where tracked."""

    def draw(frame: Frame, estimate: Estimate, lean: tuple[float, float] | None) -> bytes | None:
        if frame.image is None:
            return None
        field = source.field if estimate.status is Status.TRACKING else None
        view = view_at(source.camera, frame, lean)
        drawn = overlay_image(frame.image, view, field, estimate.pose, estimate.observation, 1)
        height, width = frame.image.shape[:2]
        scale = min(1.0, _WIDTH_PX / width)
        size = (max(1, round(scale * width)), max(1, round(scale * height)))
        small = cv2.resize(drawn[:height], size, interpolation=cv2.INTER_AREA)  # without the legend below
        done, code = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        return code.tobytes() if done else None

    return draw
