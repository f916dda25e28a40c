"""Calibration scenarios write inputs that fit their images."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import yaml
from simulated import Recordings, shortened, table

from touchline.sources import open_source


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    return Recordings(tmp_path_factory.mktemp("simulated"))


class TestCalibrationInputs:
    @pytest.mark.slow
    def test_the_strip_lies_at_the_bearing_of_each_image(self, recordings: Recordings) -> None:
        folder = recordings["calibration-strip"]
        recording = open_source(folder)
        simulation = shortened("calibration-strip")
        edges = np.array(recording.sequence["patch_edges_m"])
        colours = recording.sequence["patch_colors"]
        assert len(edges) == 15
        for index, row in enumerate(table(folder / "images.csv")):
            image = recording.image(index)
            assert image is not None
            bearing = float(row["bearing_rad"])
            middles = 0.5 * (edges[1:9] + edges[:8])
            ground = middles[:, np.newaxis] * [[math.cos(bearing), math.sin(bearing)]]
            pixels = np.rint(simulation.camera_model.project(ground)).astype(int)
            for (u, v), colour in zip(pixels, colours, strict=False):
                assert (image[v, u].min() > 120) == (colour == "white"), (index, colour)

    @pytest.mark.slow
    def test_chessboard_corners_are_where_opencv_finds_them(self, recordings: Recordings) -> None:
        folder = recordings["chessboard"]
        marks = [row for row in table(folder / "marks.csv") if row["file"] == "images/000000.jpg"]
        assert len(marks) == 35
        image = open_source(folder).image(0)
        assert image is not None
        found, corners = cv2.findChessboardCornersSB(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (7, 5))
        assert found
        told = np.array([(float(row["u"]), float(row["v"])) for row in marks])
        gaps = np.hypot(*(told[:, np.newaxis] - corners.reshape(1, -1, 2)).transpose(2, 0, 1)).min(axis=1)
        assert np.median(gaps) < 0.4
        assert gaps.max() < 1.0

    def test_fixed_marks_move_in_the_image_and_their_place_is_not_told(self, recordings: Recordings) -> None:
        rows = table(recordings["walk-in-place"] / "marks.csv")
        assert {row["name"] for row in rows} == {"near-left", "near-right", "far-left", "far-right"}
        assert {(row["x_m"], row["y_m"]) for row in rows} == {("", "")}
        v = np.array([float(row["v"]) for row in rows if row["name"] == "near-left"])
        assert v.max() - v.min() > 5.0

    def test_marked_points_are_dark_in_the_image_and_regions_have_their_colours(self, recordings: Recordings) -> None:
        folder = recordings["marked-points"]
        image = open_source(folder).image(0)
        assert image is not None
        rows = [row for row in table(folder / "marks.csv") if row["file"] == "images/000000.jpg"]
        near = [row for row in rows if math.hypot(float(row["x_m"]), float(row["y_m"])) < 2.0]
        assert len(near) > 15
        dark = [image[round(float(row["v"])), round(float(row["u"]))].max() < 100 for row in near]
        assert np.mean(dark) > 0.7  # rods and coloured squares hide some
        regions = yaml.safe_load((folder / "regions.yaml").read_text(encoding="utf-8"))
        classes = [region["class"] for region in regions]
        assert sorted(classes) == ["black", "blue", "cyan", "green", "magenta", "orange", "white", "yellow"]
        blue, green, red = (
            np.array([cv2.mean(image, _inside(image, region["polygon"]))[c] for region in regions]) for c in range(3)
        )
        at = {name: classes.index(name) for name in classes}
        assert green[at["green"]] > 1.2 * max(blue[at["green"]], red[at["green"]])
        assert min(blue[at["white"]], green[at["white"]], red[at["white"]]) > 150
        assert max(blue[at["black"]], green[at["black"]], red[at["black"]]) < 90
        assert blue[at["blue"]] > 1.3 * red[at["blue"]]
        assert min(red[at["yellow"]], green[at["yellow"]]) > 1.5 * blue[at["yellow"]]
        assert red[at["orange"]] > 1.3 * green[at["orange"]]


def _inside(image: np.ndarray, polygon: list[list[float]]) -> np.ndarray:
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillPoly(mask, [np.rint(polygon).astype(np.int32)], 255)
    return mask
