"""The rulebook's letters in a drawing of the field: a dimension line and a label for each size that is drawn."""

import cv2
import numpy as np

from touchline.field.drawing import Color, FieldView
from touchline.field.model import FieldModel
from touchline.geometry import FloatArray
from touchline.types import ImageArray

_INK: Color = (25, 25, 25)
_LABEL: Color = (170, 240, 255)
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_CAPITAL_PX = 22.0  # height of a capital letter of that font at scale 1
_ASIDE_M = 0.35  # between a line and the dimension beside it

Ends = tuple[tuple[float, float], tuple[float, float]]


def draw_letters(picture: ImageArray, field: FieldModel, view: FieldView) -> ImageArray:
    """A copy of a drawing of the field, uint8 (H, W, 3) BGR in that view, with the letters that the field knows.

    Letters that draw nothing (M to Q) and sizes of zero are left out.
    """
    drawn = picture.copy()
    ends = dimension_lines(field)
    for start, end in ends.values():
        _draw_dimension(drawn, view.picture_from_field([start, end]))
    for letter, line in ends.items():
        _draw_label(drawn, view, f"{letter} {field.letters[letter]:g}", _label_place(letter, line))
    return drawn


def dimension_lines(field: FieldModel) -> dict[str, Ends]:
    """Both ends, m in the field frame, of the dimension line of each letter that the field knows and that is drawn."""
    size = {letter: field.letters.get(letter, 0.0) for letter in "ABCDEFGHIJKL"}
    x, y = 0.5 * size["A"], 0.5 * size["B"]
    edge = min(0.6 * size["L"], _ASIDE_M) if size["L"] else -_ASIDE_M  # beyond the lines, where there is carpet
    front = x - size["E"]
    lane = 0.5 * (max(size["C"], size["D"] + 4.0 * _ASIDE_M) + size["D"]) / 2.0  # between the areas' sides
    diagonal = 0.5 * size["H"] * np.sqrt(0.5)
    lines: dict[str, Ends] = {
        "A": ((-x, -y - edge), (x, -y - edge)),
        "B": ((-x - edge, -y), (-x - edge, y)),
        "C": ((0.5 * (front + x - size["F"]), -0.5 * size["C"]), (0.5 * (front + x - size["F"]), 0.5 * size["C"])),
        "D": ((x - 0.5 * size["F"], -0.5 * size["D"]), (x - 0.5 * size["F"], 0.5 * size["D"])),
        "E": ((front, -0.5 * size["C"] - _ASIDE_M), (x, -0.5 * size["C"] - _ASIDE_M)),
        "F": ((x - size["F"], -lane), (x, -lane)),
        "G": ((x - size["G"], y + edge), (x, y + edge)),
        "H": ((-diagonal, -diagonal), (diagonal, diagonal)),
        "I": ((-x, 0.0), (-x + size["I"], 0.0)),
        "J": ((-0.5 * size["J"], 0.0), (0.5 * size["J"], 0.0)),
        "K": ((-0.5 * size["K"], 0.75 * y), (0.5 * size["K"], 0.75 * y)),
        "L": ((x, -0.75 * y), (x + size["L"], -0.75 * y)),
    }
    return {letter: ends for letter, ends in lines.items() if size[letter] > 0.0}


def _label_place(letter: str, line: Ends) -> tuple[float, float]:
    """Where the middle of a label goes (m, field frame): on its line, off what else is drawn there."""
    along = {"A": 0.25, "B": 0.25, "C": 0.85, "D": 0.65, "H": 1.15, "I": 0.6}.get(letter, 0.5)
    (x1, y1), (x2, y2) = line
    aside_x, aside_y = {"F": (0.0, -0.35), "G": (-1.0, 0.0), "J": (-0.9, 0.35), "K": (0.7, 0.0)}.get(letter, (0.0, 0.0))
    return x1 + along * (x2 - x1) + aside_x, y1 + along * (y2 - y1) + aside_y


def _draw_dimension(picture: ImageArray, ends: FloatArray) -> None:
    """A line between two pixels (2, 2) with a stroke across each end."""
    start, end = ends
    length = float(np.hypot(*(end - start)))
    across = np.array([start[1] - end[1], end[0] - start[0]]) / max(length, 1e-9) * 5.0
    for one, other in ((start, end), (start - across, start + across), (end - across, end + across)):
        first, last = (tuple(int(value) for value in np.round(place)) for place in (one, other))
        cv2.line(picture, first, last, _INK, 1, cv2.LINE_AA)


def _draw_label(picture: ImageArray, view: FieldView, text: str, place_m: tuple[float, float]) -> None:
    """Dark letters on a light box, of a size that can be read, kept within the picture."""
    scale = float(np.clip(0.26 * view.pixels_per_metre, 8.0, 26.0)) / _CAPITAL_PX
    (width, height), below = cv2.getTextSize(text, _FONT, scale, 1)
    u, v = view.picture_from_field([place_m])[0]
    margin = 3
    left = int(np.clip(u - 0.5 * width, margin, max(margin, view.width - width - margin)))
    base = int(np.clip(v + 0.5 * height, height + margin, max(height + margin, view.height - below - margin)))
    corners = (left - margin, base - height - margin), (left + width + margin, base + margin)
    cv2.rectangle(picture, *corners, _LABEL, -1)
    cv2.putText(picture, text, (left, base), _FONT, scale, _INK, 1, cv2.LINE_AA)
