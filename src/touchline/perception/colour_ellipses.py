"""The coloured classes as ellipses in U, V with an interval of Y, and black: fixed ones, and what pixels make of them.

H. Schulz, S. Behnke: Utilizing the structure of field lines for efficient soccer robot localization (2012), section 3,
has such ellipses for orange, blue, yellow, magenta and cyan, set by hand.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from touchline.geometry import BoolArray, FloatArray, IntArray

COLOURED = ("blue", "yellow", "orange", "magenta", "cyan")
USUAL_BLACK = 0.45  # of the carpet's luminance
_BLACKEST_CARPET = 0.8  # carpet is not black, whatever was marked
_COLOURLESS = 12.0  # distance from white in U, V
_DIMMEST, _BRIGHTEST = 0.4, 1.4  # light on the shadow side, and on the side of the lamps, against what was seen
_MIN_FROM_WHITE = 16.0  # U, V that every class keeps away from white
_ACROSS_SIGMAS, _ACROSS_LEAST = 3.0, 6.0  # across the ray of one hue; JPEG and mosaic blur the chroma
_TO_SIGMA = 1.4826  # from the median deviation


class Ellipse(NamedTuple):
    """Middle u, v and shape of an ellipse in U, V about those of the paint, and the interval of Y, full range.

    uu, uv, vv: the symmetric matrix S of `d S⁻¹ d <= 1`, d the offset from the middle.
    """

    u: float
    v: float
    uu: float
    uv: float
    vv: float
    low: float
    high: float

    @property
    def shape(self) -> FloatArray:
        """S (2, 2)."""
        return np.array([[self.uu, self.uv], [self.uv, self.vv]])


Ellipses = tuple[Ellipse, ...]
"""Of each of COLOURED."""


def _upright(u: float, v: float, half_u: float, half_v: float, low: float, high: float) -> Ellipse:
    return Ellipse(u, v, half_u**2, 0.0, half_v**2, low, high)


FIXED: Ellipses = (
    _upright(60.0, -22.0, 38.0, 22.0, 12.0, 150.0),
    _upright(-72.0, 18.0, 40.0, 26.0, 60.0, 250.0),
    _upright(-55.0, 62.0, 35.0, 28.0, 50.0, 220.0),
    _upright(12.0, 62.0, 30.0, 30.0, 30.0, 220.0),
    _upright(22.0, -62.0, 30.0, 30.0, 40.0, 240.0),
)


def luma_chroma(colours: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Y (N,) 0 to 255 and U, V (N,) about 0 of colours (N, 3) B, G, R."""
    blue, green, red = colours.T
    y = 0.114 * blue + 0.587 * green + 0.299 * red
    return y, 0.564 * (blue - y), 0.713 * (red - y)


def tinted_chroma(colours: FloatArray, white: FloatArray) -> FloatArray:
    """(N, 3) Y, U, V of colours (N, 3); U, V from those of the paint (3,) as bright, as the light tints both."""
    y, u, v = luma_chroma(colours)
    white_y, white_u, white_v = (float(value[0]) for value in luma_chroma(white[np.newaxis]))
    return np.column_stack((y, u - white_u * y / white_y, v - white_v * y / white_y))


def nearest_ellipse(tinted: FloatArray, ellipses: Ellipses, reach: float = 1.0) -> IntArray:
    """(N,) index into COLOURED of the ellipse that each colour (N, 3) Y, U, V lies in, -1 for none.

    reach: how much larger than they are the ellipses are taken. Where two overlap, the relatively nearer one counts.
    """
    nearest = np.empty(len(tinted), dtype=np.int64)
    _nearest(tinted, np.array(ellipses), reach**2, nearest)
    return nearest


@njit(cache=True, error_model="numpy")
def _nearest(tinted: FloatArray, ellipses: FloatArray, reach2: float, nearest: IntArray) -> None:
    """Which of ellipses (K, 7) colours (N, 3) lie in, into nearest (N,)."""
    for i in range(len(tinted)):
        nearest[i], least = -1, reach2
        for k in range(len(ellipses)):
            u, v, uu, uv, vv, low, high = ellipses[k]
            u, v = tinted[i, 1] - u, tinted[i, 2] - v
            size = (vv * u * u - 2.0 * uv * u * v + uu * v * v) / (uu * vv - uv * uv)
            if size < least and low < tinted[i, 0] < high:
                nearest[i], least = k, size


def learned_ellipse(tinted: FloatArray, prior: Ellipse, prior_pixels: float) -> Ellipse:
    """What pixels (N, 3) Y, U, V of one colour make of its fixed ellipse, which counts as so many pixels more.

    One surface in more or less light lies on a ray from black: its ellipse is long towards white, for its shadow side,
    and narrow across.
    """
    middle = np.median(tinted[:, 1:], axis=0)
    ray = middle / max(float(np.hypot(*middle)), 1e-9)
    along, across = tinted[:, 1:] @ ray, tinted[:, 1:] @ np.array([-ray[1], ray[0]])
    near = max(_DIMMEST * float(np.quantile(along, 0.1)), _MIN_FROM_WHITE)
    far = max(_BRIGHTEST * float(np.quantile(along, 0.9)), 2.0 * near)
    half_along = 0.5 * (far - near)
    half_across = _ACROSS_SIGMAS * _TO_SIGMA * float(np.median(np.abs(across - np.median(across)))) + _ACROSS_LEAST
    half_across = min(half_across, float(np.sqrt(max(prior.uu, prior.vv))))
    share = len(tinted) / (len(tinted) + prior_pixels)
    seen = half_along**2 * np.outer(ray, ray) + half_across**2 * (np.eye(2) - np.outer(ray, ray))
    offset = 0.5 * (near + far) * ray - (prior.u, prior.v)
    shape = share * seen + (1.0 - share) * (prior.shape + share * np.outer(offset, offset))
    u, v = (prior.u, prior.v) + share * offset
    low = _DIMMEST * float(np.quantile(tinted[:, 0], 0.1))
    high = min(_BRIGHTEST * float(np.quantile(tinted[:, 0], 0.9)), 255.0)
    low, high = share * low + (1.0 - share) * prior.low, share * high + (1.0 - share) * prior.high
    return Ellipse(float(u), float(v), float(shape[0, 0]), float(shape[0, 1]), float(shape[1, 1]), low, high)


def is_black(tinted: FloatArray, black_y: float) -> BoolArray:
    """(N,) whether each colour (N, 3) Y, U, V is colourless and darker than this luminance."""
    return (tinted[:, 0] < black_y) & (np.hypot(tinted[:, 1], tinted[:, 2]) < _COLOURLESS)


def learned_black(luma: FloatArray, carpet_y: float) -> float:
    """Below which luminance a colourless pixel is black, as a ratio of the carpet's, where pixels of these (N,) are."""
    return min(_BRIGHTEST * float(np.quantile(luma, 0.9)) / max(carpet_y, 1.0), _BLACKEST_CARPET)


def learned_names(ellipses: Ellipses) -> tuple[str, ...]:
    """Which of COLOURED were learned."""
    return tuple(name for name, now, fixed in zip(COLOURED, ellipses, FIXED, strict=True) if now != fixed)
