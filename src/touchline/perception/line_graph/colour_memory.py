"""The colours of a detector: learned from its first images or read from a file. The light's tint is followed; when the
green fades they are learned again.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numba import njit

from touchline.geometry import BoolArray, FloatArray, IntArray
from touchline.perception.colour import NoCarpetError
from touchline.perception.colour_file import load_colours
from touchline.perception.line_graph.colour_classes import (
    CELL_PX,
    FULL,
    GREEN,
    ColourClasses,
    CountArray,
    classes_of_model,
    learn_classes,
    tinted_classes,
)
from touchline.perception.self_learning import FirstImages
from touchline.perception.tint import Tint
from touchline.types import ImageArray

_EVERY = 3  # one in so many cells is looked at for the light's tint
_MAX_LOOKS = 500  # of such cells: the most that are looked at, which tell a median
_MIN_FIELD = 500  # cells of a field: with less, all of the ground is looked at


class ColourMemory:
    """What an image's colours are taken for, and when that is learned."""

    def __init__(self, colour_file: str | None, frames: int, yuv: bool) -> None:
        """Raises InputError for a colour file that can't be read. frames: images that are learned from."""
        self._kept = None if colour_file is None else classes_of_model(load_colours(colour_file), yuv)
        self._first, self._yuv, self._tint = FirstImages(frames), yuv, Tint()
        self.forget()

    def forget(self) -> None:
        """Forget what was learned."""
        self.classes: ColourClasses | None = self._kept
        self._learned = self.classes
        self._tint.forget()
        self._ground: IntArray | None = None  # pixels that see it
        self._first.begin()

    @property
    def is_learning(self) -> bool:
        """Whether the next image is to be learned from."""
        return self._kept is None and not self._first.are_learned

    def learn(self, image: ImageArray, masks: Callable[[], tuple[BoolArray, BoolArray, IntArray]]) -> None:
        """Learn from an image (H, W, 3): the first serves at once, all together once they are there.

        masks: makes near, around and reach of `learn_classes`. Raises NoCarpetError where no carpet is seen and no
        colours are known.
        """
        try:
            self._first.take(image, lambda images: self._learn_from(images, masks()))
        except NoCarpetError:
            if self.classes is None:
                raise

    def _learn_from(self, images: Sequence[ImageArray], masks: tuple[BoolArray, BoolArray, IntArray]) -> None:
        near, around, sides = masks
        self.classes = self._learned = learn_classes(images, near, around, self._yuv, sides)
        self._tint.forget()

    def follow(self, image: ImageArray) -> None:
        """Take on the tint that an image (H, W, 3) gives the carpet, bright or dark: clouds pass, lamps go on.

        A colour file's colours stay.
        """
        learned = self._learned
        if learned is None or self._ground is None or not learned.local:
            return
        if self._tint.follow(image, self._ground, learned.model.green):
            self.classes = tinted_classes(learned, self._tint.value)

    def watch(self, counts: CountArray, horizon: BoolArray, ends: FloatArray) -> None:
        """Begin to learn anew when much less of the ground is green than usual, for some images in a row.

        counts: of the classes. horizon: (rows, columns) cells that see the ground. ends: (columns,) height of the
        field's boundary.
        """
        if self._kept is not None:
            return
        self._ground, green = _look_at_ground(counts, horizon, ends)
        self._first.watch(green)


@njit(cache=True)
def _look_at_ground(counts: CountArray, horizon: BoolArray, ends: FloatArray) -> tuple[IntArray, float]:
    """Pixels (N, 2: v, u) of one in so many cells of the field, or of all ground, and the share of green in this."""
    rows, columns = horizon.shape
    pixels, ground, field, green = np.empty((2, rows * columns, 2), dtype=np.int64), 0, 0, 0
    for row in range(rows):
        for column in range(columns):
            if not horizon[row, column]:
                continue
            v, u = CELL_PX * row + CELL_PX // 2, CELL_PX * column + CELL_PX // 2
            pixels[0, ground, 0], pixels[0, ground, 1] = v, u
            ground, green = ground + 1, green + counts[GREEN, row, column]
            if row >= rows - ends[column]:
                pixels[1, field, 0], pixels[1, field, 1] = v, u
                field += 1
    kind, count = (1, field) if field > _MIN_FIELD else (0, ground)
    looked_at = pixels[kind, : count : max(_EVERY, -(-count // _MAX_LOOKS))]
    return looked_at, green / (FULL * max(ground, 1))
