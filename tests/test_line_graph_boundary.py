"""The field's boundary against drawn cells: things behind the field are cut off, what stands on it is left out."""

from __future__ import annotations

import numpy as np

from touchline.camera import PinholeCamera
from touchline.geometry import Pose3
from touchline.perception.line_graph.colour_classes import CLASSES, FULL, GREEN, CountArray
from touchline.perception.line_graph.field_boundary import cut_to_edges
from touchline.perception.line_graph.image_plane import make_lens

ROWS, COLUMNS = 60, 94
_POSE = Pose3.from_roll_pitch_yaw(0.0, 0.4, 0.0, (0.0, 0.0, 1.0))
LENS = make_lens(PinholeCamera(8 * COLUMNS, 8 * ROWS, 500.0, 500.0, 376.0, 240.0, np.zeros(5), _POSE))


def cut(carpet: np.ndarray, scanned: np.ndarray) -> np.ndarray:
    """Heights (columns,) after the cut of scanned ones, with green up to those of the carpet."""
    counts: CountArray = np.zeros((CLASSES, ROWS, COLUMNS), dtype=np.uint8)
    height = np.arange(ROWS, 0, -1)[:, np.newaxis]
    counts[GREEN] = np.where(height <= np.rint(carpet), FULL, 0)
    ends = scanned.copy()
    cut_to_edges(LENS, counts, ends)
    return ends


def corner() -> np.ndarray:
    """A corner of the carpet: two edges that meet at column 60."""
    columns = np.arange(COLUMNS)
    return np.minimum(30.0 + 0.25 * columns, 45.0 - 0.5 * (columns - 60))


def test_a_box_and_a_wall_behind_the_field_are_cut_off() -> None:
    true = corner()
    carpet, scanned = true.copy(), true.copy()
    scanned[20:32] += 12.0
    carpet[20:32] += 12.0  # a green box: carpet all the way up
    scanned[80:] += 9.0  # a white wall
    ends = cut(carpet, scanned)
    np.testing.assert_allclose(ends, true, atol=0.1)


def test_what_hides_an_edge_stays_left_out() -> None:
    scanned = corner()
    scanned[40:50] -= 15.0
    np.testing.assert_allclose(cut(scanned, scanned), scanned)


def test_the_edge_of_a_goal_before_the_carpet_is_none() -> None:
    """A straight lower edge of many columns, with carpet that goes on beside it."""
    scanned = corner()
    scanned[10:50] = np.minimum(scanned[10:50], 30.0)
    np.testing.assert_allclose(cut(scanned, scanned), scanned)
