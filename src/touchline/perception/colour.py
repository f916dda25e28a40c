"""Colours of the field, learned from its own images: green first, then white relative to the green beside it.

Pixels of one surface under brighter or darker light lie on a ray through the origin of R, G, B (a power-law response
keeps rays). The carpet is the most frequent greenish ray near the robot. White is what rises above the green beside it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from touchline.errors import TouchlineError
from touchline.geometry import BoolArray, ByteArray, FloatArray
from touchline.perception.colour_ellipses import FIXED, USUAL_BLACK, Ellipses
from touchline.types import ImageArray

OTHER, GREEN, WHITE = 0, 1, 2
_BITS = 6  # of the look-up table per channel: 64³ bytes stay in the second-level cache
CELLS = 1 << _BITS  # along each of its axes
_DARKEST_SUM = 40.0  # of B, G and R: below, the steps of the grey levels leave no colour
SMOOTH_NOISE = 2.5  # grey levels of noise that a blur leaves
_MIN_GREEN_TO_BLUE = (0.95, 0.8)  # of G against B of carpet: the second where a blue cast leaves none for the first
_CELLS = 64  # of the chromaticity histogram per axis
_MIN_EXCESS = 0.01  # of G over the mean of B and R, as a share of their sum: a blue cast leaves carpet little
_SAMPLES, _NOISE_SAMPLES = 50_000, 20_000  # pixels are plenty for statistics: of all images together, of one


NO_CARPET = (
    "no green carpet found around the robot: is the camera covered, or is camera.yaml wrong (center and "
    "inner_radius_px of a mirror, mount of a perspective camera)?"
)


class NoCarpetError(TouchlineError):
    """No greenish colour is frequent where carpet is expected."""


# chromaticities within so many standard deviations of the carpet's are green: 3.5 leave out one carpet pixel in 460
GREEN_SIGMAS = 3.5
DARKEST_GREEN = 0.2  # least brightness of green as a share of the usual: a deep shadow still has a third
# how far green may go towards white (1) along the direction that tells them apart: below the half height at which edges
# are taken
WHITEST_GREEN = 0.4


@dataclass(frozen=True, eq=False)
class ColourModel:
    """The learned colours.

    table: uint8 (64, 64, 64) class of a colour (B, G, R each shifted right by 2). green, white: (3,) B, G, R of the
    carpet and of the paint in the same light. noise: standard deviation (grey levels) of a carpet pixel against its
    neighbours. signal: (3,) weights of B, G, R; `signal @ colour` rises by 1 from this green to this white. ellipses:
    of blue, yellow, orange, magenta and cyan, black: luminance below which a colourless pixel is black, against that of
    this green; for whoever looks for these.
    """

    table: ByteArray
    green: FloatArray
    white: FloatArray
    noise: float
    signal: FloatArray
    ellipses: Ellipses = FIXED
    black: float = USUAL_BLACK

    def classify(self, image: ImageArray) -> ByteArray:
        """Class (H, W) of every pixel of an image (H, W, 3): OTHER, GREEN or WHITE."""
        return look_up(self.table, image)


def look_up(table: ByteArray, image: ImageArray) -> ByteArray:
    """What a table (n, n, n) by equal parts of B, G, R, n a power of two, holds for each pixel of an image (…, 3)."""
    found = np.empty(image.shape[:-1], dtype=np.uint8)
    shift = 8 - len(table).bit_length() + 1
    _look_up(table.view(np.uint8), np.ascontiguousarray(image).reshape(-1, 3), shift, found.reshape(-1))
    return found.view(table.dtype)


@njit(cache=True)
def _look_up(table: ByteArray, colours: ByteArray, shift: int, found: ByteArray) -> None:
    """What a table holds for colours (N, 3), each by its highest bits, into found (N,)."""
    for i in range(len(colours)):
        b, g, r = colours[i, 0] >> shift, colours[i, 1] >> shift, colours[i, 2] >> shift
        found[i] = table[np.uint64(b), np.uint64(g), np.uint64(r)]


@dataclass(frozen=True, eq=False)
class Carpet:
    """The green of the field.

    pixels: (N, 3) a sample of it, B, G, R. green: (3,) its median. center (2,), spread (2, 2): mean and covariance of
    its chromaticity. noise: `pixel_noise` of the images it comes from.
    """

    pixels: FloatArray
    green: FloatArray
    center: FloatArray
    spread: FloatArray
    noise: float


def learn_carpet(images: Sequence[ImageArray], near: BoolArray, around: BoolArray, noise: float) -> Carpet:
    """Learn from images (H, W, 3): green is the most frequent greenish colour in `near`, its spread that in `around`.

    near, around: (H, W) masks, the ring about the robot that is mostly carpet, and all of the field that is looked at.
    Raises NoCarpetError when no greenish colour is frequent near the robot.
    """
    coarse: list[ImageArray] = [cv2.GaussianBlur(image, (0, 0), 2.5).astype(np.uint8) for image in images]
    center = _most_frequent_green(_pixels(coarse, near))
    carpet = _pixels(images, around)[_members(_pixels(coarse, around), center)]
    if len(carpet) < 2:
        raise NoCarpetError(NO_CARPET)
    shares = chromaticity(carpet)
    spread = _covariance(shares) + np.eye(2) * 0.004**2
    return Carpet(carpet, np.median(carpet, axis=0), shares.mean(axis=0), spread, noise)


def colour_model(carpet: Carpet, white: FloatArray | None = None) -> ColourModel:
    """What separates white from this carpet. white (3,): the paint's B, G, R beside its green, guessed if unknown."""
    # neutral, and as bright as paint beside carpet usually is
    paint = np.full(3, min(255.0, 1.6 * float(carpet.green.max()))) if white is None else white
    signal = _signal_weights(carpet, paint)
    return ColourModel(_build_table(carpet, paint, signal), carpet.green, paint, carpet.noise, signal)


def _pixels(images: Sequence[ImageArray], mask: BoolArray) -> FloatArray:
    """Colours (N, 3) of every third pixel in the mask both ways, and of fewer where these are more than plenty."""
    every = max(round(math.sqrt(np.count_nonzero(mask) * len(images) / _SAMPLES)), 3)
    thin = mask[::every, ::every]
    return np.concatenate([image[::every, ::every][thin] for image in images]).astype(np.float64)


def chromaticity(colours: FloatArray) -> FloatArray:
    """(N, 2) shares of blue and red in colours (N, 3) B, G, R; independent of brightness."""
    total = np.maximum(channel_sums(colours), 1.0)
    return np.stack((colours[..., 0] / total, colours[..., 2] / total)).T


def channel_sums(colours: FloatArray) -> FloatArray:
    """(…) of B, G and R (…, 3), a column at a time: NumPy's own sums of so short rows take ten times as long."""
    return colours[..., 0] + colours[..., 1] + colours[..., 2]


def _most_frequent_green(pixels: FloatArray) -> FloatArray:
    """Chromaticity (2,) of the most frequent greenish colour among pixels (N, 3)."""
    usable = (pixels[:, 1] > 1.06 * pixels[:, 2]) & _neither_glaring_nor_dark(pixels)
    for least in _MIN_GREEN_TO_BLUE:
        greenish = usable & (pixels[:, 1] > least * pixels[:, 0])
        if greenish.sum() >= 0.05 * max(len(pixels), 1):
            break
    else:
        raise NoCarpetError(NO_CARPET)
    blue, red = chromaticity(pixels[greenish]).T
    histogram, edges, _ = np.histogram2d(blue, red, bins=_CELLS, range=[[0.0, 0.6], [0.0, 0.6]])
    smooth = _box_blur(histogram)
    # each counts as much as it is green: a grey thing before the camera that is hardly greenish has a narrow mode
    shares = 0.5 * (edges[1:] + edges[:-1])
    excess = 1.0 - 1.5 * (shares[:, np.newaxis] + shares)
    i, j = _climb(smooth, np.unravel_index(int(np.argmax(smooth * np.maximum(excess, _MIN_EXCESS))), smooth.shape))
    return np.array([edges[i] + edges[i + 1], edges[j] + edges[j + 1]]) / 2.0


def _climb(heights: FloatArray, start: tuple[np.intp, ...]) -> tuple[int, int]:
    """The top reached from a cell of heights (_CELLS, _CELLS) by steps to the highest of the cells beside."""
    i, j = (int(value) for value in start)
    while True:
        top, left = max(i - 1, 0), max(j - 1, 0)
        around = heights[top : i + 2, left : j + 2]
        if around.max() <= heights[i, j]:
            return i, j
        di, dj = np.unravel_index(int(np.argmax(around)), around.shape)
        i, j = top + int(di), left + int(dj)


def _members(blurred: FloatArray, center: FloatArray) -> BoolArray:
    """Which of the blurred pixels (N, 3) belong to the colour at `center`: its mode is narrowed down, then widened."""
    usable = _neither_glaring_nor_dark(blurred)
    shares = chromaticity(blurred[usable])
    near = np.empty(len(shares), dtype=np.bool_)
    _narrow_down(shares, center, near)
    usable[usable] = near
    return usable


@njit(cache=True, error_model="numpy")
def _narrow_down(shares: FloatArray, center: FloatArray, near: BoolArray) -> None:
    """Which of shares (N, 2) belong to the mode near a center (2,), into near (N,)."""
    x, y, xx, xy, yy = center[0], center[1], 0.015**2, 0.0, 0.015**2
    for _ in range(6):
        determinant, count, sums = xx * yy - xy * xy, 0, np.zeros(5)
        a, b, c = yy / determinant, -2.0 * xy / determinant, xx / determinant
        for k in range(len(shares)):
            u, v = shares[k, 0] - x, shares[k, 1] - y
            near[k] = a * u * u + b * u * v + c * v * v < 2.5**2
            if near[k]:
                count += 1
                sums[0], sums[1] = sums[0] + u, sums[1] + v
                sums[2], sums[3], sums[4] = sums[2] + u * u, sums[3] + u * v, sums[4] + v * v
        u, v = sums[0] / count, sums[1] / count
        # undoes the truncation at 2.5 sigmas; never narrower than the grey levels' own steps
        widened = 1.25 / (count - 1)
        xx, yy = (sums[2] - u * sums[0]) * widened + 0.004**2, (sums[4] - v * sums[1]) * widened + 0.004**2
        x, y, xy = x + u, y + v, (sums[3] - u * sums[1]) * widened


def _neither_glaring_nor_dark(pixels: FloatArray) -> BoolArray:
    """Which of pixels (N, 3) have a colour: neither saturated nor too dark for one."""
    brightest = np.maximum(np.maximum(pixels[:, 0], pixels[:, 1]), pixels[:, 2])
    bright: BoolArray = (brightest < 250.0) & (channel_sums(pixels) > _DARKEST_SUM)
    return bright


def _box_blur(histogram: FloatArray) -> FloatArray:
    padded = np.pad(histogram, 1)
    return sum(padded[i : i + _CELLS, j : j + _CELLS] for i in range(3) for j in range(3))  # type: ignore[return-value]


def pixel_noise(images: Sequence[ImageArray], mask: BoolArray) -> float:
    """Standard deviation (grey levels) of G against its neighbours inside the mask, from second differences in rows."""
    rows = slice(None, None, max(round(np.count_nonzero(mask) / _NOISE_SAMPLES), 1))
    spreads = [np.median(_differences(image[rows, :, 1].astype(np.float64), mask[rows], lag=1)) for image in images]
    return float(np.median(spreads)) / 0.6745


def smoothing_for(noise: float) -> float:
    """Standard deviation (px) of the blur that brings white noise down to SMOOTH_NOISE; 0 where it is low."""
    sigma = noise / (2.0 * np.sqrt(np.pi) * SMOOTH_NOISE)
    return sigma if sigma > 0.45 else 0.0


def smoothed(image: ImageArray, sigma_px: float) -> ImageArray:
    """The image, contiguous, blurred if sigma_px is not 0."""
    image = np.ascontiguousarray(image)
    return cv2.GaussianBlur(image, (0, 0), sigma_px).astype(np.uint8) if sigma_px else image


def signal_noise(images: Sequence[ImageArray], mask: BoolArray, model: ColourModel) -> float:
    """Standard deviation of the signal on green against green four pixels away, where noise is independent again."""
    spreads = []
    for image in images:
        green = mask & (model.classify(image) == GREEN)
        spreads.append(np.median(_differences(image @ model.signal, green, lag=4)))
    return float(np.median(spreads)) / 0.6745


def _differences(channel: FloatArray, mask: BoolArray, lag: int) -> FloatArray:
    """Absolute deviations of pixels from the mean of two neighbours in their row; scaled to the noise of one pixel."""
    inside = mask[:, lag:-lag] & mask[:, 2 * lag :] & mask[:, : -2 * lag]
    second = channel[:, lag:-lag] - 0.5 * (channel[:, 2 * lag :] + channel[:, : -2 * lag])
    deviations: FloatArray = np.abs(second[inside]) / np.sqrt(1.5)
    return deviations if len(deviations) else np.zeros(1)


def _signal_weights(carpet: Carpet, white: FloatArray) -> FloatArray:
    """Fisher's direction from green to white: blind to how bright the green is, as far as that varies here."""
    size = float(np.linalg.norm(carpet.green))
    ray, spread = carpet.green / size, _covariance(carpet.pixels)
    aside = np.eye(3) - np.outer(ray, ray)
    along = float(ray @ spread @ ray) + (0.1 * size) ** 2
    across = aside @ spread @ aside
    covariance = along * np.outer(ray, ray) + across + np.eye(3) * max(carpet.noise, 2.0) ** 2
    weights = np.linalg.solve(covariance, white - carpet.green)
    return weights / float(weights @ (white - carpet.green))


def _covariance(rows: FloatArray) -> FloatArray:
    """(K, K) of rows (N, K); NumPy's own takes ten times as long over so short ones."""
    off = rows - rows[0]
    columns = np.ascontiguousarray(off.T)
    sums = columns.sum(axis=1)
    return np.asarray((columns @ columns.T - np.outer(sums, sums) / len(rows)) / (len(rows) - 1))


def _build_table(carpet: Carpet, white: FloatArray, signal: FloatArray) -> ByteArray:
    table = np.empty((1 << _BITS,) * 3, dtype=np.uint8)
    _fill_table(table, carpet.green, carpet.center, np.linalg.inv(carpet.spread), white, signal)
    return table


@njit(cache=True, error_model="numpy")
def _fill_table(
    table: ByteArray, green: FloatArray, center: FloatArray, inverse: FloatArray, white: FloatArray, signal: FloatArray
) -> None:
    """The class of the middle of every cell of a table, see `ColourModel`. green, white, signal (3,): B, G, R; center
    (2,): chromaticity of the carpet, and inverse (2, 2): of its spread.
    """
    wb, wg, wr = white[0] - green[0], white[1] - green[1], white[2] - green[2]
    usual, contrast2, width = green.sum(), wb * wb + wg * wg + wr * wr, 1 << (8 - _BITS)
    flat = table.ravel()
    for i in range(flat.size):
        b = ((i >> (2 * _BITS)) + 0.5) * width
        g = ((i >> _BITS) % (1 << _BITS) + 0.5) * width
        r = (i % (1 << _BITS) + 0.5) * width
        brightness, db, dg, dr = (b + g + r) / usual, b - green[0], g - green[1], r - green[2]
        u, v = b / (b + g + r) - center[0], r / (b + g + r) - center[1]
        distance2 = u * (u * inverse[0, 0] + v * inverse[1, 0]) + v * (u * inverse[0, 1] + v * inverse[1, 1])
        # noise weighs more in the chromaticity of dark pixels, less in that of bright ones
        is_green = math.sqrt(distance2) < GREEN_SIGMAS * min(max(1.0 / brightness, 0.6), 3.0)
        is_green &= brightness > DARKEST_GREEN and db * signal[0] + dg * signal[1] + dr * signal[2] < WHITEST_GREEN
        # sun-lit carpet whose G is at its limit: B and R still go on together, up to 0.85 of G for R; from there on it
        # may be paint in tinted light (0.87 in a photograph)
        follows = abs(b - r * green[0] / max(green[2], 1e-9)) < 25.0
        is_green |= g > 246.0 and r < 0.85 * g and follows
        ahead, length2 = db * wb + dg * wg + dr * wr, db * db + dg * dg + dr * dr
        is_white = ahead > 0.3 * contrast2 and ahead > 0.8 * max(math.sqrt(length2 * contrast2), 1e-9)
        flat[i] = GREEN if is_green else WHITE if is_white else OTHER
