"""Three photographs of real mirrors: the lines that people marked are found, what is only white is not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from touchline.camera import OmniCamera, open_camera
from touchline.field import open_field
from touchline.geometry import FloatArray
from touchline.localization.one_shot.locate import locate_points
from touchline.localization.registration.weights import WeightSettings, precision_weights
from touchline.perception import LinePointDetector
from touchline.perception.colour import GREEN
from touchline.types import ImageArray, LinePoints


def photograph(small_data: Path, letter: str) -> tuple[ImageArray, OmniCamera, dict[str, Any]]:
    """Image, camera and marks. Photographs b and c have no calibration: that of a, scaled to their mirror, serves."""
    folder = small_data / "real" / "omni"
    image = cv2.imread(str(folder / f"nubot_{letter}.png"))
    marks = json.loads((folder / f"nubot_{letter}.json").read_text())
    camera = open_camera(folder / "nubot_a.camera.yaml")
    if letter != "a":
        scale = marks["mirror_outer_radius_px"] / 220.0
        camera = replace(
            camera,
            width=image.shape[1],
            height=image.shape[0],
            center=tuple(marks["u0v0"]),
            inner_radius_px=marks["robot_body_radius_px"] + 3.0,
            outer_radius_px=marks["mirror_outer_radius_px"] - 5.0,
            radius_px=camera.radius_px * scale,
        )
    return image.astype(np.uint8), camera, marks


def detect(image: ImageArray, camera: OmniCamera) -> LinePoints:
    detector = LinePointDetector(camera)
    detector.learn([image])
    return detector.detect(image)


def nearest(marks: list[list[int]], points: LinePoints) -> FloatArray:
    offsets = np.array(marks, dtype=float)[:, np.newaxis] - points.pixels
    return np.hypot(offsets[..., 0], offsets[..., 1]).min(axis=1)


@pytest.mark.parametrize("letter", ["a", "b", "c"])
def test_marked_lines_are_found_and_nothing_else(small_data: Path, letter: str) -> None:
    image, camera, marks = photograph(small_data, letter)
    points = detect(image, camera)
    unsure = marks["on_line_low_confidence_idx"]
    sure = [pixel for k, pixel in enumerate(marks["on_line"]) if k not in unsure]
    assert len(points) >= 60
    assert np.mean(nearest(sure, points) <= 6.0) >= 0.75
    assert np.all(nearest(marks["white_or_bright_not_line"], points) > 3.0)


def test_the_calibrated_photograph_is_localized(small_data: Path) -> None:
    image, camera, _ = photograph(small_data, "a")
    points = detect(image, camera)
    field = open_field("msl-18x12")
    weights = precision_weights(points, WeightSettings())
    pose = locate_points(points.positions_m, field, weights=weights).pose
    assert abs(pose.x) == pytest.approx(2.35, abs=0.15)
    assert field.width / 2 - abs(pose.y) == pytest.approx(2.56, abs=0.15)
    near = np.hypot(*points.positions_m.T) < 6.0
    deviations = field.line_distances(pose.transform(points.positions_m[near]))
    assert np.mean(deviations <= 0.15) >= 0.85


@pytest.mark.parametrize("letter", ["a"])
@pytest.mark.parametrize("cast", [(1.15, 1.0, 0.9), (0.85, 1.0, 1.1), (1.2, 1.2, 1.2), (0.5, 0.5, 0.5)])
def test_neither_a_colour_cast_nor_other_light_mixes_them_up(
    small_data: Path, letter: str, cast: tuple[float, float, float]
) -> None:
    image, camera, marks = photograph(small_data, letter)
    cast_image = np.clip(image * np.array(cast), 0, 255).astype(np.uint8)
    detector = LinePointDetector(camera)
    detector.learn([cast_image])
    assert detector.colours is not None
    classes = detector.colours.classify(cast_image)
    assert np.mean([classes[v, u] == GREEN for u, v in marks["green_not_line"]]) >= 0.95
    assert not any(classes[v, u] == GREEN for u, v in marks["on_line"])
