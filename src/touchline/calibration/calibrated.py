"""What a calibration writes."""

from typing import NamedTuple

from touchline.types import ImageArray


class Calibrated(NamedTuple):
    """text: of the camera.yaml. picture: (H, W, 3) BGR, what it was learned from. words: what was found, and how well.

    left_out: messages about images that were not used.
    """

    text: str
    picture: ImageArray
    words: str
    left_out: tuple[str, ...] = ()
