"""Colour classes: a table over B, G, R made from luminance thresholds and ellipses in U, V; counts in cells of 8 x 8.

H. Schulz, S. Behnke: Utilizing the structure of field lines for efficient soccer robot localization (2012), section 3.
The table holds for each colour its class, or how white it is: from where on that is white depends on the light about
the cell. All algorithms behind this one work on the cells.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from touchline.geometry import BoolArray, ByteArray, FloatArray, IntArray
from touchline.perception.colour import GREEN as IS_GREEN
from touchline.perception.colour import ColourModel, channel_sums, colour_model, learn_carpet, pixel_noise
from touchline.perception.colour_ellipses import is_black, luma_chroma, nearest_ellipse, tinted_chroma
from touchline.perception.line_graph.contrast import learn_contrast
from touchline.perception.line_graph.standing_colours import standing_ellipses
from touchline.perception.tint import NO_TINT, tinted_colours
from touchline.types import ImageArray

CELL_PX = 8
WHITE, GREEN, BLACK, BLUE, YELLOW, ORANGE, MAGENTA, CYAN = range(8)  # from BLUE on as in COLOURED
CLASSES = 8
OTHER = 8
FULL = CELL_PX * CELL_PX  # pixels of a cell
_LOOKS = CELL_PX // 2  # at pixels in one of its rows
FIRST_WHITE = 16  # codes of the table from here on tell how white a colour is
WHITE_STEPS = 100.0  # such codes between carpet and paint
HALF_WHITE = 0.5  # a pixel that is half paint is white: edges lie at half height
_MIN_WHITE = 0.15  # colours less white than this are never white, whatever the light
_EVERY = 4  # pixels between the samples that tell the light, in rows evenly about each cell's middle
_SAMPLES = (CELL_PX // _EVERY) ** 2  # of these in a cell
_MIN_SAMPLES = 8.0  # of carpet, that tell its light
_LIGHT_REACH = 6  # cells to each side that the light is averaged over
_WASHED = 0.25  # least excess of G of washed-out carpet, from that of paint (0) to that of carpet (1)
_GREENER = 1.02  # than red, which yellow is not
_WASHED_BRIGHTER = 1.15  # than the carpet that was learned
_WASHED_REACH, _WASHED_SHARE = 2, 0.35  # cells to each side, and the share of them that is washed-out
_MIN_PAINT = 0.1  # signal of paint above that of the carpet about it, against that in the light that was learned
_SATURATED = 0.75  # of how white an image can get: paint is no whiter in any light
_PALEST = 1.25  # paint is brighter than the carpet beside it by at least this factor
_MIN_PIXELS = 30  # pixels that paint is learned from
_BESIDE_PX = 15  # paint lies within so many pixels of carpet
_SOLID = 0.5  # share of green about a pixel of it that is carpet
_FAINTEST_PAINT = 0.2  # of the way from carpet to a guessed white
_PAINT_ROUNDS = 3
_UNSEEN = 0.25  # share of the paint that colours alone take for carpet, from which on the carpet beside it tells
_EDGES = 0.65  # share of what is pale between carpet that is only partly paint

CountArray = ByteArray
"""(8, rows, columns): pixels of each class in each cell, at most 64."""


class ColourClasses(NamedTuple):
    """The learned classes.

    tables: uint8 (2, 65536) by the 5, 6 and 5 highest bits of B, G, R: a class, OTHER, or FIRST_WHITE and more; the
    second where the sun washes the carpet out. model: carpet and paint that it comes from. white_from: the code from
    which on a pixel is white in the light it was learned in, white_until: in any light. local: whether that goes with
    the light about each cell. least_contrast: from which on what exceeds both its sides is white, as of `Contrast`,
    where colours alone don't tell paint; else 0.
    """

    tables: ByteArray
    model: ColourModel
    white_from: float
    white_until: float
    local: bool
    least_contrast: float = 0.0


def learn_classes(
    images: Sequence[ImageArray], near: BoolArray, around: BoolArray, yuv: bool, reach: IntArray | None = None
) -> ColourClasses:
    """Learn from images (H, W, 3): the carpet's green first, then the paint beside it.

    near, around: (H, W) where carpet is expected, and all of the field that is looked at. yuv: the paper's form, one
    luminance threshold for white and an ellipse for green; else green is a range of rays from black, and white is told
    by Fisher's direction from carpet to paint and relative to the light about it.
    reach: of `contrasts`, to learn whether colours tell paint at all; None: they have to.
    Raises NoCarpetError when no greenish colour is frequent.
    """
    carpet = learn_carpet(images, near, around, pixel_noise(images, near))
    model = colour_model(carpet)
    paint = _learn_paint(images, around, model)
    if paint is not None:
        model = colour_model(carpet, paint)
    contrast = None if yuv or reach is None else learn_contrast(images, around, reach, model)
    if contrast is not None and contrast.unseen > _UNSEEN:
        model = colour_model(carpet, contrast.paint)
    if not yuv:
        model = replace(model, ellipses=standing_ellipses(images, around, model))
    classes = _classes(model, carpet.pixels if yuv else None)
    if contrast is not None and contrast.unseen > _UNSEEN:
        classes = classes._replace(least_contrast=contrast.least)
    return classes


def classes_of_model(model: ColourModel, yuv: bool) -> ColourClasses:
    """The classes of a colour table that was kept in a file."""
    colours = _cell_colours()
    carpet = colours[model.classify(colours.astype(np.uint8)) == IS_GREEN]
    return _classes(model, carpet if yuv else None)


def tinted_classes(classes: ColourClasses, tint: FloatArray) -> ColourClasses:
    """Classes that are `local` in a light that multiplies B, G, R by a tint (3,)."""
    model = classes.model
    table = relative_table(model, tint)
    tables = np.stack((table, _with_washed_carpet(table, model, tint)))
    return classes._replace(tables=tables, model=tinted_colours(model, tint))


def _classes(model: ColourModel, carpet: FloatArray | None) -> ColourClasses:
    """The classes of a model; in the paper's form with pixels (N, 3) of carpet."""
    if carpet is not None:
        table = yuv_table(model, carpet)
        return ColourClasses(np.stack((table, table)), model, float(FIRST_WHITE), 255.0, False)
    table = relative_table(model)
    tables = np.stack((table, _with_washed_carpet(table, model)))
    whitest = float((255.0 - model.green) @ model.signal)
    until = max(_SATURATED * whitest, HALF_WHITE)
    half, until = (FIRST_WHITE + WHITE_STEPS * each for each in (HALF_WHITE, until))
    return ColourClasses(tables, model, half, until, True)


def _with_washed_carpet(table: ByteArray, model: ColourModel, tint: FloatArray = NO_TINT) -> ByteArray:
    """The table with all as green that is brighter than the carpet, paler and greenish still: carpet in the sun, or
    where the edge of a line is.
    """
    colours = _cell_colours() / tint
    (carpet, paint), excess = (_excess(np.stack((model.green, model.white)))), _excess(colours)
    washed = (excess > paint + _WASHED * (carpet - paint)) & (colours[:, 1] > _GREENER * colours[:, 2])
    washed &= channel_sums(colours) > _WASHED_BRIGHTER * model.green.sum()
    return np.where(washed, GREEN, table).astype(np.uint8)


def _excess(colours: FloatArray) -> FloatArray:
    """(N,) of G over the mean of B and R, as a share of their sum."""
    return 1.5 * colours[:, 1] / channel_sums(colours) - 0.5


def relative_table(model: ColourModel, tint: FloatArray = NO_TINT) -> ByteArray:
    """The table of `ColourClasses` with green as the model has it and white by its signal, in a tinted light."""
    colours = _cell_colours() / tint
    table = colour_codes(colours, model)
    whiteness = (colours - model.green) @ model.signal
    pale = (table == OTHER) | (table == BLACK)
    table = np.where(pale & (whiteness > _MIN_WHITE), _codes(whiteness), table)
    is_green = model.classify(np.minimum(colours, 255.0).astype(np.uint8)) == IS_GREEN
    return np.where(is_green, GREEN, table).astype(np.uint8)


def yuv_table(model: ColourModel, carpet: FloatArray) -> ByteArray:
    """The same as the paper has it: white above a luminance, black below one, green in an ellipse of U, V.

    carpet: (N, 3) pixels of it, B, G, R.
    """
    colours = _cell_colours()
    table = colour_codes(colours, model)
    y, u, v = luma_chroma(colours)
    carpet_y, carpet_u, carpet_v = luma_chroma(carpet)
    low, high = np.quantile(carpet_y, (0.005, 0.995))
    spread = np.cov(np.stack((carpet_u, carpet_v))) + 2.0 * np.eye(2)
    offset = np.column_stack((u - carpet_u.mean(), v - carpet_v.mean()))
    near = np.sum(offset @ np.linalg.inv(spread) * offset, axis=1) < 3.5**2
    table[near & (y > 0.6 * low) & (y < 1.2 * high)] = GREEN
    bright = y >= _luminance_of_white(model)
    return np.where(bright, 255, table).astype(np.uint8)


def _luminance_of_white(model: ColourModel) -> float:
    y, _, _ = luma_chroma(np.stack((model.green, model.white)))
    return float(0.5 * (y[0] + y[1]))


@lru_cache(maxsize=1)
def _cell_colours() -> FloatArray:
    """(65536, 3) B, G, R of the table's entries."""
    coarse, fine = 8.0 * np.arange(32) + 3.5, 4.0 * np.arange(64) + 1.5
    return np.stack(np.meshgrid(coarse, fine, coarse, indexing="ij"), axis=-1).reshape(-1, 3)


def _codes(whiteness: FloatArray) -> FloatArray:
    return np.clip(np.rint(FIRST_WHITE + WHITE_STEPS * whiteness), FIRST_WHITE, 255)


def colour_codes(colours: FloatArray, model: ColourModel) -> IntArray:
    """(N,) which of colours (N, 3) B, G, R are black or of one of the coloured classes; OTHER for all else."""
    tinted = tinted_chroma(colours, model.white)
    table = np.full(len(colours), OTHER, dtype=np.int64)
    carpet_y = float(luma_chroma(model.green[np.newaxis])[0][0])
    table[is_black(tinted, model.black * carpet_y)] = BLACK
    kinds = nearest_ellipse(tinted, model.ellipses)
    return np.where(kinds >= 0, BLUE + kinds, table)


def _learn_paint(images: Sequence[ImageArray], around: BoolArray, model: ColourModel) -> FloatArray | None:
    """(3,) B, G, R of paint: what is paler than the carpet on both sides of it, in the light that was learned.

    Walls and posts are whiter than worn lines, but have carpet on one side at most. None where too little is seen.
    """
    found = np.concatenate([_between_carpet(image, around, model) for image in images])
    whiteness = (found - model.green) @ model.signal
    least = _FAINTEST_PAINT
    for _ in range(_PAINT_ROUNDS):
        # the brighter third: edges of lines and threads of nets are white, too, but mixed with what is behind them
        pale = found[whiteness > least]
        if len(pale) < _MIN_PIXELS:
            return None
        brightness = channel_sums(pale)
        paint: FloatArray = np.median(pale[brightness >= np.quantile(brightness, _EDGES)], axis=0)
        least = max(HALF_WHITE * float((paint - model.green) @ model.signal), _FAINTEST_PAINT)
    return paint


def _between_carpet(image: ImageArray, around: BoolArray, model: ColourModel) -> FloatArray:
    """(N, 3) colours that are brighter than carpet close by on both sides of them, as if its light were the usual."""
    smooth = cv2.blur(image, (3, 3))  # blades of turf glitter
    green = ((model.classify(image) == IS_GREEN) & around).astype(np.uint8)
    # specks of green in a wall or a ceiling are no carpet
    size = (2 * _BESIDE_PX + 1,) * 2
    green &= (cv2.blur(green.astype(np.float32), size) > _SOLID).astype(np.uint8)
    half = np.zeros((1, 2 * _BESIDE_PX + 1), dtype=np.uint8)
    half[:, : _BESIDE_PX + 1] = 1
    kernels = (half, half[:, ::-1].copy(), half.T.copy(), half[:, ::-1].T.copy())
    left, right, above, below = (cv2.dilate(green, kernel).astype(np.bool_) for kernel in kernels)
    between = ((left & right) | (above & below)) & around & (green == 0)
    blue_and_green = cv2.add(image[..., 0], image[..., 1], dtype=cv2.CV_16U)
    lit = cv2.multiply(cv2.add(blue_and_green, image[..., 2], dtype=cv2.CV_16U), green, dtype=cv2.CV_32F)
    light = cv2.blur(lit, size)[between] / np.maximum(cv2.blur(green.astype(np.float32), size)[between], 1e-3)
    colours, light = smooth[between].astype(np.float64), light / model.green.sum()
    bright = channel_sums(colours) > _PALEST * light * model.green.sum()
    return colours[bright] / light[bright, np.newaxis]


@njit(cache=True)
def count_classes(
    image: ImageArray,
    tables: ByteArray,
    white_from: ByteArray,
    washed: ByteArray,
    counts: CountArray,
) -> None:
    """Count the classes of an image (H, W, 3) in cells of 8 x 8 pixels, into counts (8, rows, columns).

    white_from: (rows, columns) code from which on a pixel is white. washed: (rows, columns) which of the tables. Every
    other pixel is looked at, as on a chessboard, so that lines along rows and columns are seen half, and counts twice.
    """
    packed = np.zeros(256, dtype=np.uint64)  # eight counters of a byte each
    for kind in range(1, CLASSES):
        packed[kind] = np.uint64(2) << np.uint64(8 * kind)
    one: Any = np.uint64(2)
    nothing: Any = np.uint64(0)
    rows, columns = counts.shape[1:]
    totals, entries = np.empty(columns, dtype=np.uint64), np.empty(_LOOKS * columns, dtype=np.uint16)
    for row in range(rows):
        totals[:] = nothing
        for v in range(CELL_PX * row, CELL_PX * row + CELL_PX):
            _entries(image[v].ravel()[3 * (v % 2) :], entries)
            for column in range(columns):
                total, least, first = totals[column], white_from[row, column], np.uint64(_LOOKS * column)
                table = tables[washed[row, column]]
                for k in range(_LOOKS):
                    code = table[np.uint64(entries[first + np.uint64(k)])]  # unsigned: none can count from the end
                    total += packed[np.uint64(code)] + (one if code >= least else nothing)
                totals[column] = total
        for kind in range(CLASSES):
            for column in range(columns):
                counts[kind, row, column] = (totals[column] >> np.uint64(8 * kind)) & np.uint64(255)


@njit(cache=True)
def _entries(line: ImageArray, entries: npt.NDArray[np.uint16]) -> None:
    """Which entry of the table every other pixel of a row (3 W,) has, into entries (N,)."""
    for u in range(len(entries)):
        b, g, r = np.uint32(line[6 * u]), np.uint32(line[6 * u + 1]), np.uint32(line[6 * u + 2])
        entries[u] = ((b >> 3) << 11) | ((g >> 2) << 5) | (r >> 3)


@njit(cache=True)
def carpet_light(
    image: ImageArray,
    tables: ByteArray,
    model: tuple[float, FloatArray],
    cells: tuple[FloatArray, ByteArray, FloatArray],
) -> None:
    """How bright the carpet about each cell is against the one that was learned, into light (rows, columns), and
    whether the sun washes it out, into washed (rows, columns); the signal of that close to it into base (rows,
    columns), which holds that of the learned one: it has to change where light and shadow meet, light only scales.

    model: B + G + R of the carpet that was learned, and the signal (3,) that tells paint from it. cells: light, which
    is 1 where no carpet is near, washed, base.
    """
    (carpet_sum, signal), (light, washed, base) = model, cells
    rows, columns = light.shape
    pad = _LIGHT_REACH  # columns to each side, so that no window leaves them
    sums = np.zeros((6, rows + 1, columns + 1 + 2 * pad))
    _sum_carpet(image, tables, signal, sums)
    one, many = np.empty((6, columns)), np.empty((2, columns))  # sums close to each cell, and farther about it
    for row in range(rows):
        near = max(row - _WASHED_REACH, 0), min(row + _WASHED_REACH + 1, rows)
        wide = max(row - _LIGHT_REACH, 0), min(row + _LIGHT_REACH + 1, rows)
        for k in range(2):
            _sum_about(sums[k], wide, _LIGHT_REACH, many[k])
        for k in range(1, 6):
            _sum_about(sums[k], near, _WASHED_REACH, one[k])
        for column in range(columns):
            across = min(column + _WASHED_REACH + 1, columns) - max(column - _WASHED_REACH, 0)
            pale = one[3, column]
            is_washed = pale > _WASHED_SHARE * (across * (near[1] - near[0]) * _SAMPLES)
            brightness = one[2, column] if is_washed else many[0, column]
            count = pale if is_washed else many[1, column]
            washed[row, column] = is_washed
            light[row, column] = brightness / (count * carpet_sum) if count > _MIN_SAMPLES else 1.0
            samples = pale if is_washed else one[1, column]
            if samples > _MIN_SAMPLES:
                base[row, column] = one[5 if is_washed else 4, column] / samples
            else:
                base[row, column] *= light[row, column]


@njit(cache=True)
def _sum_carpet(image: ImageArray, tables: ByteArray, signal: FloatArray, sums: FloatArray) -> None:
    """Integral images, of brightness, number and signal of green samples and of washed-out ones: what is summed over
    any rectangle of cells costs four look-ups.
    """
    pad, rows = _LIGHT_REACH, sums.shape[1] - 1
    columns = sums.shape[2] - 1 - 2 * pad
    for row in range(rows):
        usual = number = washed_out = washed_number = np.int64(0)  # along the row
        usual_signal = washed_signal = 0.0
        for column in range(columns):
            for v in range(CELL_PX * row + 2, CELL_PX * row + CELL_PX, _EVERY):
                for u in range(CELL_PX * column + 1, CELL_PX * column + CELL_PX, _EVERY):
                    b, g, r = np.int64(image[v, u, 0]), np.int64(image[v, u, 1]), np.int64(image[v, u, 2])
                    entry = np.uint64(((b >> 3) << 11) | ((g >> 2) << 5) | (r >> 3))
                    if tables[0, entry] == GREEN:
                        usual, number = usual + b + g + r, number + 1
                        usual_signal += signal[0] * b + signal[1] * g + signal[2] * r
                    elif tables[1, entry] == GREEN:
                        washed_out, washed_number = washed_out + b + g + r, washed_number + 1
                        washed_signal += signal[0] * b + signal[1] * g + signal[2] * r
            at = column + 1 + pad
            sums[0, row + 1, at] = usual + sums[0, row, at]
            sums[1, row + 1, at] = number + sums[1, row, at]
            sums[2, row + 1, at] = washed_out + sums[2, row, at]
            sums[3, row + 1, at] = washed_number + sums[3, row, at]
            sums[4, row + 1, at] = usual_signal + sums[4, row, at]
            sums[5, row + 1, at] = washed_signal + sums[5, row, at]
        for at in range(columns + 1 + pad, columns + 1 + 2 * pad):
            for k in range(6):
                sums[k, row + 1, at] = sums[k, row + 1, columns + pad]


@njit(cache=True)
def paint_above(base: FloatArray, light: FloatArray, model: tuple[FloatArray, FloatArray]) -> FloatArray:
    """(rows, columns) by how much the signal of paint exceeds that of the carpet about each cell, base (rows, columns):
    paint in as much light as this, or the whitest that an image can show. model: white and signal (3,) as learned.
    """
    (white, signal), paint = model, np.empty_like(light)
    for row in range(light.shape[0]):
        for column in range(light.shape[1]):
            whitest = 0.0
            for k in range(3):
                whitest += signal[k] * min(light[row, column] * white[k], 255.0)
            paint[row, column] = max(whitest - base[row, column], _MIN_PAINT)
    return paint


@njit(cache=True)
def _sum_about(sums: FloatArray, rows: tuple[int, int], reach: int, out: FloatArray) -> None:
    """Sum of rows, the last excluded, and of columns within a reach of each, from an integral image, into out
    (columns,).
    """
    top, bottom, first = sums[rows[0]], sums[rows[1]], np.uint64(_LIGHT_REACH - reach)
    last = np.uint64(_LIGHT_REACH + reach + 1)
    for column in range(len(out)):
        left, right = np.uint64(column) + first, np.uint64(column) + last
        out[column] = bottom[right] - top[right] - bottom[left] + top[left]


@njit(cache=True)
def suppress_fringes(counts: CountArray) -> None:
    """Forget orange and cyan in cells that touch white: beside sharp contrasts a Bayer mosaic makes such fringes.

    Only where the colour fills less than half of the cell; changes counts (8, rows, columns) in place.
    """
    rows, columns = counts.shape[1:]
    for row in range(rows):
        for column in range(columns):
            if counts[ORANGE, row, column] + counts[CYAN, row, column] == 0:
                continue
            sharp = False
            for r in range(max(row - 1, 0), min(row + 2, rows)):
                for c in range(max(column - 1, 0), min(column + 2, columns)):
                    sharp = sharp or counts[WHITE, r, c] + counts[BLACK, r, c] > 4
            if sharp:
                for kind in (ORANGE, CYAN):
                    if counts[kind, row, column] < FULL // 2:
                        counts[kind, row, column] = 0
