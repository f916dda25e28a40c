"""The colours of a detector: learned from its first images or read from a file, learned again when the green fades."""

import numpy as np
import numpy.typing as npt

from touchline.perception.colour import NoCarpetError
from touchline.perception.colour_file import load_colours
from touchline.perception.line_graph.colour_classes import (
    FULL,
    GREEN,
    ColourClasses,
    CountArray,
    classes_of_model,
    learn_classes,
)
from touchline.perception.self_learning import GreenWatch
from touchline.types import ImageArray

Mask = npt.NDArray[np.bool_]


class ColourMemory:
    """What an image's colours are taken for, and when that is learned."""

    def __init__(self, colour_file: str | None, frames: int, yuv: bool) -> None:
        """Raises InputError for a colour file that can't be read. frames: images that are learned from."""
        self._kept = None if colour_file is None else classes_of_model(load_colours(colour_file), yuv)
        self._frames, self._yuv = frames, yuv
        self.forget()

    def forget(self) -> None:
        """Forget what was learned."""
        self.classes: ColourClasses | None = self._kept
        self._images: list[ImageArray] = []
        self._green = GreenWatch()

    @property
    def is_learning(self) -> bool:
        """Whether the next image is to be learned from."""
        return self._kept is None and len(self._images) < self._frames

    def learn(self, image: ImageArray, near: Mask, around: Mask) -> None:
        """Learn from an image (H, W, 3): the first serves at once, all together once they are there.

        near, around: as in `learn_classes`. Raises NoCarpetError where no carpet is seen and no colours are known.
        """
        self._images.append(image)
        if len(self._images) not in (1, self._frames):
            return
        try:
            self.classes = learn_classes(self._images, near, around, self._yuv)
        except NoCarpetError:
            self._images.pop()
            if self.classes is None:
                raise

    def watch(self, counts: CountArray, horizon: Mask) -> None:
        """Begin to learn anew when much less of the ground is green than usual, for some images in a row.

        counts: of the classes. horizon: (rows, columns) cells that see the ground.
        """
        if self._kept is not None:
            return
        self._green.is_faded(float(counts[GREEN][horizon].sum()) / (FULL * max(int(horizon.sum()), 1)))
        if self._green.has_faded:
            self._images, self._green = [], GreenWatch()
