"""The picture of a range regression: over an image, pairs and polynomial, and what is left between them."""

import cv2
import numpy as np
import numpy.typing as npt

from touchline.geometry import FloatArray, Int32Array
from touchline.palette import BLUE, ORANGE, SKY, VERMILLION, bgr
from touchline.perception.stages import SHIFT, Paint, enlarged, fixed_point, with_legend
from touchline.published.iris_fusion.range_regression import RangeRegression
from touchline.types import ImageArray

_WIDTH_PX, _HEIGHT_PX, _MARGIN_PX = 900, 450, 70
_INK, _GRID, _LIMIT = (40, 40, 40), (216, 221, 216), (138, 148, 138)
_TICKS = 6
_RINGS_M = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0)


def range_picture(regression: RangeRegression, seen: tuple[str, ImageArray] | None = None) -> ImageArray:
    """Range over radius above the residuals in centimetres over the range. BGR.

    seen: name and pixels (H, W, 3) of an image with pairs; it stands beside, with pairs and rings of equal range.
    """
    pairs = regression.pairs
    radii = np.linspace(regression.first_px, regression.last_px, 500)
    curve = np.column_stack((radii, regression.polynomial(radii)))
    above = _Chart("radius (px)", "range (m)", pairs.radius_px, pairs.range_m)
    above.line([(regression.last_px, above.low[1]), (regression.last_px, above.high[1])], _LIMIT)
    above.line(curve, bgr(VERMILLION))
    above.dots(pairs.radius_px, pairs.range_m)
    residuals_cm = 100.0 * regression.residuals_m
    below = _Chart("range (m)", "pair - polynomial (cm)", pairs.range_m, np.append(residuals_cm, 0.0))
    below.line([(below.low[0], 0.0), (below.high[0], 0.0)], bgr(VERMILLION))
    below.dots(pairs.range_m, residuals_cm)
    picture = with_legend(
        np.vstack((above.canvas, below.canvas)),
        [
            (pairs.origin, bgr(BLUE)),
            (f"polynomial of degree {regression.degree}", bgr(VERMILLION)),
            ("last pair: continued from here", _LIMIT),
        ],
    )
    if seen is None:
        return picture
    image = _over_image(regression, *seen)
    height = picture.shape[0]
    image = cv2.resize(image, (round(image.shape[1] * height / image.shape[0]), height)).astype(np.uint8)
    return np.hstack((image, picture))


class _Chart:
    """An empty chart about points (N,), (N,), with a grid and its numbers."""

    def __init__(self, across: str, up: str, x: FloatArray, y: FloatArray) -> None:
        self.low, self.high = np.array([x.min(), y.min()]), np.array([x.max(), y.max()])
        room = 0.05 * np.maximum(self.high - self.low, 1e-6)
        self.low, self.high = self.low - room, self.high + room
        self.canvas: ImageArray = np.full((_HEIGHT_PX, _WIDTH_PX, 3), 255, np.uint8)
        for tick in _ticks(self.low[0], self.high[0]):
            u = int(self._pixels([(tick, self.low[1])])[0, 0] >> SHIFT)
            cv2.line(self.canvas, (u, _MARGIN_PX // 2), (u, _HEIGHT_PX - _MARGIN_PX), _GRID, 1)
            self._words(f"{tick:g}", u - 10, _HEIGHT_PX - _MARGIN_PX + 20)
        for tick in _ticks(self.low[1], self.high[1]):
            v = int(self._pixels([(self.low[0], tick)])[0, 1] >> SHIFT)
            cv2.line(self.canvas, (_MARGIN_PX, v), (_WIDTH_PX - _MARGIN_PX // 2, v), _GRID, 1)
            self._words(f"{tick:g}", 10, v + 5)
        self._words(across, _WIDTH_PX // 2 - 40, _HEIGHT_PX - 15)
        self._words(up, 10, 22)

    def line(self, points: npt.ArrayLike, paint: Paint) -> None:
        """Draw a path (N, 2)."""
        cv2.polylines(self.canvas, [self._pixels(points)], False, paint, 2, cv2.LINE_AA, SHIFT)

    def dots(self, x: FloatArray, y: FloatArray) -> None:
        """Draw points (N,), (N,)."""
        for at in self._pixels(np.column_stack((x, y))).tolist():
            cv2.circle(self.canvas, (at[0], at[1]), 3 << SHIFT, bgr(BLUE), -1, cv2.LINE_AA, SHIFT)

    def _words(self, text: str, u: int, v: int) -> None:
        cv2.putText(self.canvas, text, (u, v), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _INK, 1, cv2.LINE_AA)

    def _pixels(self, points: npt.ArrayLike) -> Int32Array:
        size = np.array([_WIDTH_PX - 1.5 * _MARGIN_PX, _HEIGHT_PX - 1.5 * _MARGIN_PX])
        u, v = (size * (np.asarray(points) - self.low) / (self.high - self.low)).T
        return fixed_point(np.column_stack((_MARGIN_PX + u, _HEIGHT_PX - _MARGIN_PX - v)), 1.0)


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers between two others, about five."""
    power = 10.0 ** np.floor(np.log10((high - low) / _TICKS))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if (high - low) / (factor * power) <= _TICKS)
    return [round(float(step * k), 9) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def _over_image(regression: RangeRegression, name: str, image: ImageArray) -> ImageArray:
    """An image with its pairs, the places that the polynomial gives them, and rings of equal range."""
    pairs, (u, v) = regression.pairs, regression.pairs.optics.center
    radii = np.linspace(regression.first_px, regression.last_px, 2000)
    ranges = regression.polynomial(radii)
    zoom = max(1.0, 2.0 * _HEIGHT_PX / image.shape[0])
    canvas = enlarged(image, zoom)

    def at(radius_px: npt.ArrayLike, angle_rad: npt.ArrayLike) -> Int32Array:
        around = np.column_stack((np.cos(angle_rad), np.sin(angle_rad)))
        return fixed_point(np.array([u, v]) + np.reshape(radius_px, (-1, 1)) * around, zoom)

    named_px, free_rad = 0.0, float(np.mean(pairs.angle_rad)) + 0.75 * np.pi  # where few pairs are
    for ring_m in _RINGS_M:
        if not ranges[0] <= ring_m <= ranges[-1]:
            continue
        ring_px = float(np.interp(ring_m, ranges, radii))
        ring = at(np.full(181, ring_px), np.linspace(0.0, 2.0 * np.pi, 181))
        cv2.polylines(canvas, [ring], True, (255, 255, 255), 1, cv2.LINE_AA, SHIFT)
        if ring_px - named_px > 0.03 * image.shape[0]:
            named_px = ring_px
            place = (at(ring_px, [free_rad])[0] >> SHIFT).tolist()
            for paint, width in ((_INK, 4), ((255, 255, 255), 1)):  # legible on white lines, too
                cv2.putText(canvas, f"{ring_m:g} m", place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, paint, width, cv2.LINE_AA)
    here = np.array([file == name for file in pairs.files])
    angles = pairs.angle_rad[here]
    for place in (at(pairs.radius_px[here], angles) >> SHIFT).tolist():
        cv2.drawMarker(canvas, place, bgr(ORANGE), cv2.MARKER_TILTED_CROSS, 11, 2, cv2.LINE_AA)
    for place in at(np.interp(pairs.range_m[here], ranges, radii), angles).tolist():
        cv2.circle(canvas, place, 9 << SHIFT, bgr(SKY), 1, cv2.LINE_AA, SHIFT)
    return with_legend(canvas, [(f"pairs of {name}", bgr(ORANGE)), ("their ranges by the polynomial", bgr(SKY))])
