"""The colours of a detector: learned from its first images or read from a file. The light's tint is followed; when the
green fades they are learned again.
"""

import numpy as np

from touchline.geometry import BoolArray, FloatArray, IndexArray
from touchline.perception.colour import NoCarpetError
from touchline.perception.colour_file import load_colours
from touchline.perception.line_graph.colour_classes import (
    CELL_PX,
    FULL,
    GREEN,
    NO_TINT,
    ColourClasses,
    CountArray,
    classes_of_model,
    learn_classes,
    tinted_classes,
)
from touchline.perception.self_learning import GreenWatch
from touchline.types import ImageArray

_MIN_TINT, _MAX_TINT = 0.04, 0.4  # change of the carpet's colour (logarithm) that is followed, and the most
_EVERY, _MIN_CELLS = 3, 50  # one in so many cells is looked at, and so many of carpet tell it
_MIN_FIELD = 500  # cells of a field: with less, all of the ground is looked at
_GREENISH = 0.35  # of the learned carpet's excess of green, from which on a colour may be carpet in other light


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
        self._learned = self.classes
        self._tint = NO_TINT
        self._ground: tuple[IndexArray, IndexArray] | None = None  # pixels that see it
        self._images: list[ImageArray] = []
        self._green = GreenWatch()

    @property
    def is_learning(self) -> bool:
        """Whether the next image is to be learned from."""
        return self._kept is None and len(self._images) < self._frames

    def learn(self, image: ImageArray, near: BoolArray, around: BoolArray) -> None:
        """Learn from an image (H, W, 3): the first serves at once, all together once they are there.

        near, around: as in `learn_classes`. Raises NoCarpetError where no carpet is seen and no colours are known.
        """
        self._images.append(image)
        if len(self._images) not in (1, self._frames):
            return
        try:
            self.classes = self._learned = learn_classes(self._images, near, around, self._yuv)
            self._tint = NO_TINT
        except NoCarpetError:
            self._images.pop()
            if self.classes is None:
                raise

    def follow(self, image: ImageArray) -> None:
        """Take on the tint that an image (H, W, 3) gives the carpet, bright or dark: clouds pass, lamps go on."""
        if self._learned is None or self._ground is None or not self._learned.local:
            return
        rows, columns = self._ground
        colours = image[rows, columns].astype(np.float64)
        shares = colours / np.maximum(colours.sum(axis=1, keepdims=True), 1.0)
        green = self._learned.model.green / self._learned.model.green.sum()
        carpet = shares[shares[:, 1] - 1.0 / 3.0 > _GREENISH * (green[1] - 1.0 / 3.0)]
        if len(carpet) < _MIN_CELLS:
            return
        tint = np.exp(np.clip(np.log(np.maximum(np.median(carpet, axis=0), 1e-3) / green), -_MAX_TINT, _MAX_TINT))
        if np.abs(np.log(tint / self._tint)).max() > _MIN_TINT:
            self._tint, self.classes = tint, tinted_classes(self._learned, tint)

    def watch(self, counts: CountArray, horizon: BoolArray, ends: FloatArray) -> None:
        """Begin to learn anew when much less of the ground is green than usual, for some images in a row.

        counts: of the classes. horizon: (rows, columns) cells that see the ground. ends: (columns,) height of the
        field's boundary.
        """
        if self._kept is not None:
            return
        inside = horizon & (np.arange(len(horizon))[:, np.newaxis] >= len(horizon) - ends)
        rows, columns = (cells[::_EVERY] for cells in np.nonzero(inside if inside.sum() > _MIN_FIELD else horizon))
        self._ground = CELL_PX * rows + CELL_PX // 2, CELL_PX * columns + CELL_PX // 2
        self._green.is_faded(float(counts[GREEN][horizon].sum()) / (FULL * max(int(horizon.sum()), 1)))
        if self._green.has_faded:
            self._images, self._green = [], GreenWatch()
