"""What looks like a field line and is none: threads of nets, and what lies askew between two lines."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from touchline.camera import GroundView, PinholeCamera
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose3
from touchline.perception.line_graph import LineGraphDetector, LineGraphSettings
from touchline.perception.line_graph.image_plane import grounds_from_pixels, image_plane
from touchline.perception.line_graph.refine import _MAX_LEAN_PX, _lean_of_halves
from touchline.types import ImageArray

CARPET, PAINT = np.array([45.0, 90.0, 75.0]), np.array([225.0, 228.0, 226.0])


def camera() -> PinholeCamera:
    pose = Pose3.from_roll_pitch_yaw(0.0, 0.5, 0.0, (0.0, 0.0, 0.8))
    return PinholeCamera(320, 240, 260.0, 260.0, 159.5, 119.5, np.zeros(5), pose)


def crossed(spacing_m: float | None) -> ImageArray:
    """A line 1.4 m ahead that thin others cross, so far apart."""
    detector = LineGraphDetector(camera(), LineGraphSettings(), open_field("indoor-9x6"))
    v, u = np.mgrid[0:480, 0:640] / 2.0 - 0.25
    plane = image_plane(detector.lens, GroundView(camera()))
    ground: FloatArray = grounds_from_pixels(plane, np.column_stack((u.ravel(), v.ravel()))).reshape(480, 640, 2)
    x, y = ground[..., 0], ground[..., 1]
    white = np.abs(x - 1.4) < 0.02
    if spacing_m is not None:
        white |= (np.abs((y / spacing_m + 0.5) % 1.0 - 0.5) * spacing_m < 0.008) & (np.abs(x - 1.4) < 0.4)
    image = cv2.blur(np.where(white[..., np.newaxis], PAINT, CARPET), (3, 3))[::2, ::2]
    return np.clip(image + np.random.default_rng(1).normal(0.0, 2.0, image.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("spacing_m", "found"), [(None, True), (0.5, True), (0.1, False), (0.15, False)])
def test_what_many_others_cross_is_a_thread_of_a_net(spacing_m: float | None, found: bool) -> None:
    detector = LineGraphDetector(camera(), LineGraphSettings(), open_field("indoor-9x6"))
    lines = detector.detect(crossed(spacing_m), GroundView(camera())).lines
    across = [line for line in lines.ends_m if np.ptp(line[:, 1]) > 0.8 and np.abs(line[:, 0] - 1.4).max() < 0.05]
    assert len(across) == found


def test_points_of_two_lines_side_by_side_make_no_third() -> None:
    """Pixels are the unit here. Both lie 3 apart; a bent line of the same size is one line."""
    along = np.linspace(0.0, 60.0, 13)
    line = np.array([0.0, 0.0, 60.0, 3.0])
    askew = np.column_stack((along, np.where(along < 30.0, 0.0, 3.0)))
    bent = np.column_stack((along, 0.05 * along + 0.002 * (along - 30.0) ** 2))
    every = np.arange(len(along))
    assert _lean_of_halves.py_func(askew, every, line) == pytest.approx(0.75, rel=0.05)
    assert _lean_of_halves.py_func(bent, every, line) == 0.0
    assert _lean_of_halves.py_func(askew[[0, 12]], np.arange(2), line) == 0.0
    assert _lean_of_halves.py_func(2.0 * askew, every, 2.0 * line) > _MAX_LEAN_PX
