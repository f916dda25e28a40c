"""Line points by thresholds on hue, saturation and lightness: white runs inside the hull of the green, only those."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic import (
    BLACK,
    CROSS,
    WHITE,
    YELLOW,
    distances,
    line_field,
    mirror_camera,
    paint_ground,
)

from touchline.camera import OmniCamera
from touchline.camera.base import ground_jacobian
from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.perception import observe
from touchline.perception.colour import NoCarpetError
from touchline.perception.ray_runs import RUN_COLUMNS, RayPictures, Rays, RunLimits, white_runs
from touchline.published.iris_fusion.hsv_lines import HsvLineDetector, HsvLineSettings
from touchline.types import Frame, ImageArray, LinePoints, Observation

CAMERA = mirror_camera()


def detected(image: ImageArray, camera: OmniCamera = CAMERA, **settings: object) -> LinePoints:
    return HsvLineDetector(camera, HsvLineSettings(**settings)).detect(image)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def cross_image() -> ImageArray:
    return paint_ground(CAMERA, line_field(CROSS))


def test_points_lie_on_lines_below_a_pixel(cross_image: ImageArray) -> None:
    points = detected(cross_image)
    off, ranges = distances(points, CROSS), np.hypot(*points.positions_m.T)
    assert len(points) >= 80
    assert np.median(off[ranges < 3.0]) < 0.004
    pixel_m = np.abs(ground_jacobian(CAMERA.ground_from_image, points.pixels)).max(axis=(1, 2))
    assert np.quantile(off / pixel_m, 0.9) < 0.35


@pytest.mark.parametrize("light", [0.3, 0.5, 1.0, 1.1])
def test_thresholds_follow_the_light(light: float) -> None:
    points = detected(paint_ground(CAMERA, line_field(CROSS, light=light)))
    assert len(points) >= 75
    assert np.median(distances(points, CROSS)) < 0.01


def sunny(points: FloatArray) -> FloatArray:
    """A patch of sun three times brighter than the rest, overexposed carpet in it."""
    colours = line_field(CROSS, light=0.75)(points)
    patch = (np.abs(points[:, 0] - 0.4) < 1.0) & (np.abs(points[:, 1] + 1.6) < 0.9)
    colours[patch] = np.minimum(colours[patch] * 2.4, 255.0)
    return colours


def test_the_edge_of_a_sunny_patch_is_no_line() -> None:
    points = detected(paint_ground(CAMERA, sunny))
    off = distances(points, CROSS)
    assert np.mean(off > 0.1) < 0.03
    in_sun = (np.abs(points.positions_m[:, 0] - 0.4) < 0.9) & (off < 0.05)
    assert np.sum(in_sun) >= 5


def with_patch(box: tuple[float, float, float, float], colour: tuple[int, int, int]) -> Callable[..., FloatArray]:
    """The cross and a patch x0, x1, y0, y1 (m) of a colour."""
    x0, x1, y0, y1 = box

    def colour_at(points: FloatArray) -> FloatArray:
        colours = line_field(CROSS)(points)
        x, y = points.T
        colours[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = colour
        return colours

    return colour_at


@pytest.mark.parametrize(
    ("box", "colour"),
    [((-2.0, -1.5, -0.3, 0.3), YELLOW), ((-3.0, -1.2, -0.8, 0.8), WHITE), ((-2.0, -1.6, -0.2, 0.2), BLACK)],
)
def test_balls_robots_and_wide_white_things_give_no_points(
    box: tuple[float, float, float, float], colour: tuple[int, int, int]
) -> None:
    points = detected(paint_ground(CAMERA, with_patch(box, colour)))
    assert len(points) >= 75
    stray = points.positions_m[distances(points, CROSS) > 0.1]
    corners = np.array([(x, y) for x in box[:2] for y in box[2:]])
    apart = np.hypot(*(stray[:, np.newaxis] - corners).transpose(2, 0, 1)).min(axis=1)
    assert np.all(apart < 0.35)  # a ray may cut a corner of a white thing as short as a line, and no more


def test_a_range_file_takes_the_place_of_the_camera(cross_image: ImageArray, tmp_path: Path) -> None:
    radii = np.arange(30.0, 181.0, 10.0)
    rows = ", ".join(f"{0.8 * math.tan(r / 160.0):.5f}" for r in radii)
    file = tmp_path / "range.yaml"
    text = "model: omni\nwidth: 480\nheight: 480\ncenter: [239.5, 239.5]\ninner_radius_px: 42\nouter_radius_px: 220\n"
    text += f"handedness: -1\nmount_yaw: {-math.pi / 2}\nrange_table:\n  radius_px: {radii.tolist()}\n"
    file.write_text(text + f"  range_m: [{rows}]\n")
    points = detected(cross_image, replace(CAMERA, range_m=2.0 * CAMERA.range_m), range_file=str(file))
    assert np.median(distances(points, CROSS)) < 0.01
    assert np.max(np.hypot(*(points.pixels - CAMERA.center).T)) <= 180.0
    file.write_text(text.replace("width: 480", "width: 640") + f"  range_m: [{rows}]\n")
    with pytest.raises(InputError, match=r"640 x 480.*480 x 480"):
        HsvLineDetector(CAMERA, HsvLineSettings(range_file=str(file)))


def test_images_without_carpet_or_of_another_size_are_told(cross_image: ImageArray) -> None:
    with pytest.raises(NoCarpetError, match="no green carpet"):
        detected(np.full((480, 480, 3), 120, dtype=np.uint8))
    with pytest.raises(InputError, match=r"\(480, 480, 3\)"):
        detected(cross_image[:400])


@pytest.mark.parametrize("share", [0.1, 0.15, 0.5])
def test_a_greyish_carpet_is_a_carpet(cross_image: ImageArray, share: float) -> None:
    """One real carpet has a saturation of 0.07 to 0.2, the paint beside it 0.04."""
    grey = cross_image.mean(axis=2, keepdims=True)
    pale = np.rint(share * cross_image + (1.0 - share) * grey).astype(np.uint8)
    points = detected(pale)
    assert len(points) >= 75
    assert np.median(distances(points, CROSS)) < 0.01
    noisy = 120.0 + 12.0 * np.random.default_rng(2).standard_normal((480, 480, 3))
    for tint in ((0, 0, 0), (0, 0, 12), (12, 0, 0)):  # a grey floor under any lamp is none
        with pytest.raises(NoCarpetError):
            detected(np.clip(noisy + tint, 0, 255).astype(np.uint8))


def test_frames_without_something_to_see_say_why(cross_image: ImageArray) -> None:
    detector = HsvLineDetector(CAMERA)
    seen = detector.observe(Frame(0, image=cross_image))
    assert len(seen.points) >= 80
    assert seen.problem is None
    for frame, why in (
        (Frame(1, problem="it is broken"), "broken"),
        (Frame(2), "no image"),
        (Frame(3, image=np.zeros_like(cross_image)), "black"),
        (Frame(4, image=np.where(np.arange(480)[:, None, None] < 240, cross_image * 0 + 30, 200).astype(np.uint8)),
         "carpet"),
    ):  # fmt: skip
        seen = observe(frame, detector)
        assert len(seen.points) == 0
        assert why in str(seen.problem)
    given = detected(cross_image)
    assert observe(Frame(5, observation=Observation(5, given)), detector).points is given


def test_runs_are_those_of_the_plain_twin(cross_image: ImageArray) -> None:
    """The compiled loop against straightforward NumPy, ray by ray."""
    detector = HsvLineDetector(CAMERA)
    masks = detector.masks(cross_image)
    lightness, green, lines = masks.lightness, masks.green, masks.lines
    rays = detector.rays[::2]
    out = np.empty((200, RUN_COLUMNS))
    lookup = CAMERA.lookup_constants, CAMERA.bearings_rad, CAMERA.lookup_table
    fan, limits = Rays(rays, *CAMERA.center, 42.0, 215.0), RunLimits(4, 1, 0.75, 1)
    count = white_runs(RayPictures(lines, green, lightness), fan, limits, lookup, out)
    expected = [row for k, ray in enumerate(rays) for row in plain_runs(lines, green, lightness, ray, k)]
    assert count == len(expected) >= 20
    np.testing.assert_allclose(out[:count, :4], np.array(expected)[:, :4], atol=1e-6)


def plain_runs(
    lines: ImageArray, green: ImageArray, lightness: ImageArray, ray: FloatArray, number: int
) -> list[FloatArray]:
    """Rows as `white_runs` gives them, with 42 to 215 px, 4 samples beyond, gaps of 1, at most 0.75 m, 1 green."""
    path = np.array(CAMERA.center) + np.arange(42.0, 216.0)[:, np.newaxis] * ray
    column, row = np.floor(path + 0.5).astype(int).T
    white, is_green = lines[row, column] > 0, green[row, column] > 0
    j, i = np.floor(path).astype(int).T
    fu, fv = (path - np.floor(path)).T
    light = lightness.astype(float)
    levels = (1 - fv) * ((1 - fu) * light[i, j] + fu * light[i, j + 1])
    levels += fv * ((1 - fu) * light[i + 1, j] + fu * light[i + 1, j + 1])
    closed = white.copy()
    closed[1:-1] |= white[:-2] & white[2:]
    edges = np.flatnonzero(np.diff(np.concatenate(([False], closed, [False])).astype(int)))
    rows = []
    for start, end in zip(edges[::2], edges[1::2] - 1, strict=True):
        if start == 0 or end == len(path) - 1:
            continue
        inner, outer = levels[start : end + 1][:6].max(), levels[start : end + 1][-6:].max()
        before, after = levels[max(start - 4, 0) : start], levels[end + 1 : end + 5]
        if not (is_green[max(start - 4, 0) : start].any() and is_green[end + 1 : end + 5].any()):
            continue
        k = start + int(np.argmax(levels[start : end + 1][:6]))
        half = (inner + before.min()) / 2
        while levels[k - 1] > half:
            k -= 1
        a = k - (levels[k] - half) / (levels[k] - levels[k - 1])
        k = end - int(np.argmax(levels[start : end + 1][::-1][:6]))
        half = (outer + after.min()) / 2
        while levels[k + 1] > half:
            k += 1
        b = k + (levels[k] - half) / (levels[k] - levels[k + 1])
        ends = np.array(CAMERA.center) + np.array([42.0 + a, 42.0 + b])[:, np.newaxis] * ray
        ground = CAMERA.ground_from_image(ends)
        if np.hypot(*(ground[1] - ground[0])) <= 0.75:
            rows.append(np.concatenate((ground.mean(axis=0), ends.mean(axis=0))))
    return rows
