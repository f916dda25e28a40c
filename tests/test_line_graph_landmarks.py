"""Posts, goals, poles and penalty marks against the truth of images; white posts in drawn images."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from touchline.camera import GroundView, PinholeCamera
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose3
from touchline.perception.line_graph import LineGraphDetector, LineGraphPaper, LineGraphSettings
from touchline.types import ImageArray, LandmarkKind

GREEN, WHITE, GREY = (70, 130, 60), (235, 240, 235), (150, 155, 155)
HEIGHT_M, PITCH = 1.0, math.radians(20.0)
POSE = Pose3.from_roll_pitch_yaw(0.0, PITCH, 0.0, (0.0, 0.0, HEIGHT_M))
CAMERA = PinholeCamera(640, 480, 450.0, 450.0, 319.5, 239.5, np.zeros(5), POSE)
GOAL_X = 3.0


def pixel(x: float, y: float, z: float = 0.0) -> tuple[float, float]:
    """Where the camera sees a place (m, robot frame)."""
    away, aside, up = x, y, z - HEIGHT_M
    depth = away * math.cos(PITCH) - up * math.sin(PITCH)
    down = -up * math.cos(PITCH) - away * math.sin(PITCH)
    return 319.5 - 450.0 * aside / depth, 239.5 + 450.0 * down / depth


def paint(image: ImageArray, corners: list[tuple[float, float]], colour: tuple[int, int, int]) -> None:
    points = np.rint(16.0 * np.array(corners)).astype(np.int32)
    cv2.fillPoly(image, [points], colour, cv2.LINE_AA, 4)


def hall() -> ImageArray:
    """Carpet up to 5 m before a grey wall, a goal line across at 3 m and a line that runs away at the left."""
    image = np.full((480, 640, 3), GREY, dtype=np.uint8)
    image[round(pixel(5.0, 0.0)[1]) :] = GREEN
    for x0, y0, x1, y1 in ((GOAL_X - 0.03, 4.0, GOAL_X + 0.03, -4.0), (1.2, 0.56, 4.5, 0.5)):
        paint(image, [pixel(x0, y0), pixel(x1, y0), pixel(x1, y1), pixel(x0, y1)], WHITE)
    return image


def upright(image: ImageArray, x: float, y: float, height: float, half_width: float = 0.05) -> None:
    corners = ((1, 0.0), (1, height), (-1, height), (-1, 0.0))
    paint(image, [pixel(x, y + side * half_width, z) for side, z in corners], WHITE)


def found(image: ImageArray, paper: LineGraphPaper | None = None) -> dict[str, FloatArray]:
    """Kind -> (N, 2) of what is found in an image with some noise."""
    noise = np.random.default_rng(5).normal(0.0, 3.0, image.shape)
    image = np.clip(image + noise, 0, 255).astype(np.uint8)
    settings = LineGraphSettings(paper=paper or LineGraphPaper())
    seen = LineGraphDetector(CAMERA, settings, open_field("humanoid-kid-9x6")).detect(image, GroundView(CAMERA))
    return {str(kind): seen.landmarks.positions_m[seen.landmarks.kinds == kind] for kind in LandmarkKind}


def test_white_posts_stand_on_the_goal_line() -> None:
    image = hall()
    for y in (1.3, -1.3):
        upright(image, GOAL_X, y, 1.2)
    landmarks = found(image)
    posts = landmarks["post"]
    assert len(posts) == 2, "the line that runs away is none"
    np.testing.assert_allclose(posts[np.argsort(posts[:, 1])], [[GOAL_X, -1.3], [GOAL_X, 1.3]], atol=0.05)
    np.testing.assert_allclose(landmarks["goal"], [[GOAL_X, 0.0]], atol=0.05)
    assert len(found(image, LineGraphPaper(white_marks=False))["post"]) == 0


@pytest.mark.parametrize(
    ("beyond", "height", "half_width"),
    [
        (GOAL_X, 0.5, 0.05),
        (GOAL_X, 2.4, 0.05),
        (GOAL_X, 1.2, 0.3),
        (GOAL_X + 0.6, 1.2, 0.05),
        (GOAL_X - 0.5, 1.2, 0.05),
    ],
    ids=["a robot's leg", "a pillar", "a board", "behind the line", "before the line"],
)
def test_what_looks_a_little_like_a_white_post_is_none(beyond: float, height: float, half_width: float) -> None:
    image = hall()
    upright(image, GOAL_X + beyond, -0.8, height, half_width)
    assert len(found(image)["post"]) == 0


def disc(image: ImageArray, x: float, y: float, radius: float) -> None:
    turn = np.linspace(0.0, 2.0 * math.pi, 40)
    paint(image, [pixel(x + radius * math.cos(t), y + radius * math.sin(t)) for t in turn], WHITE)


def test_a_penalty_mark_is_found_a_ball_is_none() -> None:
    image = hall()
    disc(image, 2.0, -0.4, 0.05)
    marks = found(image)["penalty_mark"]
    np.testing.assert_allclose(marks, [[2.0, -0.4]], atol=0.03)
    ball = hall()
    u, v = pixel(2.0, -0.4, 0.07)
    cv2.circle(ball, (round(u), round(v)), round(450.0 * 0.07 / 2.2), WHITE, -1, cv2.LINE_AA)
    assert len(found(ball)["penalty_mark"]) == 0


YELLOW, BLUE = (20, 190, 220), (180, 70, 40)


def stand(
    image: ImageArray, x: float, y: float, half_width: float, bands: list[tuple[int, int, int]], top: float
) -> None:
    """Something upright with bands of one height from the ground up to a top (m)."""
    for k, colour in enumerate(bands):
        low, high = top * k / len(bands), top * (k + 1) / len(bands)
        corners = ((1, low), (1, high), (-1, high), (-1, low))
        paint(image, [pixel(x, y + side * half_width, z) for side, z in corners], colour)


def coloured(image: ImageArray) -> dict[tuple[str, tuple[str, ...]], FloatArray]:
    noise = np.random.default_rng(5).normal(0.0, 3.0, image.shape)
    image = np.clip(image + noise, 0, 255).astype(np.uint8)
    seen = LineGraphDetector(CAMERA, LineGraphSettings(), open_field("indoor-9x6")).detect(image, GroundView(CAMERA))
    marks = seen.landmarks
    return {(str(k), c): p for k, c, p in zip(marks.kinds, marks.colors, marks.positions_m, strict=True)}


def test_a_coloured_post_that_leaves_the_image_stands_where_its_foot_is() -> None:
    image = hall()
    stand(image, GOAL_X, 0.9, 0.05, [YELLOW], 1.8)
    stand(image, 2.4, -0.7, 0.1, [BLUE, YELLOW, BLUE], 1.0)
    found = coloured(image)
    assert set(found) == {("post", ("yellow",)), ("pole", ("blue", "yellow", "blue"))}
    np.testing.assert_allclose(found["post", ("yellow",)], [GOAL_X + 0.05, 0.9], atol=0.04)
    np.testing.assert_allclose(found["pole", ("blue", "yellow", "blue")], [2.5, -0.7], atol=0.06)


@pytest.mark.parametrize("foot", ["on the wall", "as a board", "behind a robot"])
def test_colours_that_stand_on_no_carpet_or_are_too_wide_are_no_post(foot: str) -> None:
    image = hall()
    if foot == "on the wall":
        stand(image, 7.0, 0.9, 0.05, [YELLOW], 1.8)
    else:
        stand(image, GOAL_X, 0.9, 0.15 if foot == "as a board" else 0.05, [YELLOW], 1.8)
    if foot == "behind a robot":
        u, v = pixel(GOAL_X, 0.9, 0.15)
        cv2.rectangle(image, (round(u) - 25, round(v)), (round(u) + 25, round(v) + 60), (40, 40, 40), -1)
    assert not coloured(image)
