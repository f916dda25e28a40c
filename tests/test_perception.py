"""Line points: where painted lines are, and nowhere else."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from synthetic import CROSS, WHITE, distances, line_field, mirror_camera, paint_ground

from touchline.camera import OmniCamera
from touchline.camera.base import ground_jacobian
from touchline.errors import InputError, TouchlineError
from touchline.geometry import FloatArray
from touchline.perception import LinePointDetector, LinePointSettings, SelfLearningDetector, line_points, observe
from touchline.perception.colour import NoCarpetError
from touchline.perception.covered import is_covered
from touchline.perception.field_boundary import green_ends, inside_green
from touchline.perception.path_samples import BODY, PathSamples, no_samples, sample_paths
from touchline.perception.scan_lines import build_scan_lines
from touchline.perception.self_learning import FirstImages, LearningPaper, LearningSettings
from touchline.perception.tint import Tint
from touchline.types import Frame, ImageArray, LinePoints, Observation

CAMERA = mirror_camera()


def detected(image: ImageArray, camera: OmniCamera = CAMERA, **settings: object) -> LinePoints:
    detector = LinePointDetector(camera, LinePointSettings(**settings))  # type: ignore[arg-type]
    detector.learn([image])
    return detector.detect(image)


@pytest.fixture(scope="module")
def cross_image() -> ImageArray:
    return paint_ground(CAMERA, line_field(CROSS))


def test_points_lie_on_the_lines_to_a_fraction_of_a_pixel(cross_image: ImageArray) -> None:
    points = detected(cross_image)
    ranges = np.hypot(*points.positions_m.T)
    off = distances(points, CROSS)
    assert len(points) >= 80
    assert np.median(off[ranges < 3.0]) < 0.004
    assert np.quantile(off, 0.95) < 0.05
    pixel_m = np.abs(ground_jacobian(CAMERA.ground_from_image, points.pixels)).max(axis=(1, 2))
    assert np.quantile(off / pixel_m, 0.9) < 0.35


@pytest.mark.parametrize("light", [0.35, 1.1])
def test_dim_and_bright_light_need_no_other_settings(light: float) -> None:
    image = paint_ground(CAMERA, line_field(CROSS, light=light))
    points = detected(image)
    assert len(points) >= 75
    assert np.median(distances(points, CROSS)) < 0.01


def test_covariance_grows_with_range_and_has_the_pixels_scale(
    cross_image: ImageArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_points, "NOISE_M", 0.0)
    points = detected(cross_image, noise_px=0.5)
    ranges = np.hypot(*points.positions_m.T)
    spread = np.sqrt(np.linalg.eigvalsh(points.covariances_m2)[:, 1])
    slope = 0.8 / 160.0 * (1.0 + (ranges / 0.8) ** 2)  # derivative of 0.8 tan(radius / 160)
    np.testing.assert_allclose(spread, 0.5 * slope, rtol=0.03)


def test_the_robots_own_body_is_masked() -> None:
    """A white panel beside the robot, with green around it, hangs together with its body."""

    def panel(points: FloatArray) -> FloatArray:
        colours = line_field([(1.0, 0.0, 1.8)])(points)
        colours[(points[:, 0] < 0.0) & (points[:, 0] > -0.42) & (np.abs(points[:, 1]) < 0.12)] = WHITE
        return colours

    points = detected(paint_ground(CAMERA, panel))
    assert len(points) >= 30
    assert np.all(points.positions_m[:, 0] > 1.0)


def test_an_image_without_carpet_is_refused_in_words() -> None:
    grey = np.full((480, 480, 3), 120, np.uint8)
    with pytest.raises(TouchlineError, match="no green carpet"):
        LinePointDetector(CAMERA).learn([grey])


def test_an_image_of_another_size_is_refused_in_words(cross_image: ImageArray) -> None:
    detector = LinePointDetector(CAMERA)
    detector.learn([cross_image])
    with pytest.raises(InputError, match="the camera file says"):
        detector.detect(cross_image[:-2])


def test_detection_before_learning_is_refused(cross_image: ImageArray) -> None:
    with pytest.raises(TouchlineError, match="learn"):
        LinePointDetector(CAMERA).detect(cross_image)


def test_self_learning_skips_covered_images_and_follows_the_light(cross_image: ImageArray) -> None:
    black = np.zeros_like(cross_image)
    detector = SelfLearningDetector(CAMERA)
    assert len(observe(Frame(0, black), detector).points) == 0
    assert len(observe(Frame(1, None), detector).points) == 0
    usual = len(detector.observe(Frame(2, cross_image)).points)
    for k in range(10):
        detector.observe(Frame(3 + k, cross_image))
    # lamps of another colour, and dim: what was green is not any more, until it is learned again
    tinted = np.clip(cross_image * np.array([0.55, 0.75, 0.75]), 0, 255).astype(np.uint8)
    counts = [len(detector.observe(Frame(20 + k, tinted)).points) for k in range(12)]
    assert usual >= 80
    assert counts[-1] >= 0.9 * usual


@pytest.mark.parametrize("tint", [(1.35, 1.0, 0.7), (0.7, 1.0, 1.3)])
def test_the_tint_of_the_light_is_followed_from_image_to_image(
    cross_image: ImageArray, tint: tuple[float, ...]
) -> None:
    """A cloud, or the evening: the first such image shows the lines, and so does the first one after it."""
    tinted = np.clip(0.6 * cross_image * tint, 0, 255).astype(np.uint8)
    counts = {}
    for again in (True, False):
        detector = SelfLearningDetector(CAMERA, None, LearningSettings(frames=1, paper=LearningPaper(again=again)))
        counts[again] = [
            len(detector.observe(Frame(k, each)).points) for k, each in enumerate((cross_image, tinted) * 2)
        ]
    usual = counts[True][0]
    assert min(counts[True]) > 0.9 * usual
    assert counts[False][1] < 0.5 * usual


def test_carpet_that_glosses_is_no_tint_to_a_mirror() -> None:
    """White light on top of the carpet's own makes it pale, and its paint no other colour."""
    carpet, pixels = np.array([60.0, 120.0, 70.0]), np.argwhere(np.ones((10, 10), dtype=np.bool_))
    glossy, warm = (np.full((10, 10, 3), each, dtype=np.uint8) for each in (carpet + 40.0, carpet * (1.2, 1.0, 0.8)))
    assert Tint().follow(glossy, pixels, carpet)
    assert not Tint(warmth=True).follow(glossy, pixels, carpet)
    assert Tint(warmth=True).follow(warm, pixels, carpet)


@pytest.mark.parametrize("warmth", [True, False])
def test_carpet_that_the_sun_brings_to_an_image_s_limit_is_no_tint(warmth: bool) -> None:
    """What its G would be is not seen; three quarters of the carpet lie in such a patch."""
    carpet, pixels = np.array([60.0, 120.0, 70.0]), np.argwhere(np.ones((20, 20), dtype=np.bool_))
    image = np.full((20, 20, 3), carpet, dtype=np.uint8)
    image[:, 5:] = np.minimum(3.0 * carpet * (1.1, 1.0, 0.9), 255.0)
    assert not Tint(warmth).follow(image, pixels, carpet)


def test_points_that_a_frame_brings_are_taken_as_they_are() -> None:
    points = LinePoints(np.ones((3, 2)), np.zeros((3, 2, 2)), np.ones(3), np.full((3, 2), np.nan))
    for detector in (SelfLearningDetector(CAMERA), None):
        assert observe(Frame(0, observation=Observation(0, points)), detector).points is points


def test_sampling_is_bilinear() -> None:
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (480, 480, 3)).astype(np.uint8)
    lines = build_scan_lines(CAMERA, 8, 2, 42.0, 200.0)
    n = len(lines.samples)
    signal, table = rng.normal(size=3).astype(np.float32), rng.integers(0, 3, (64, 64, 64)).astype(np.uint8)
    body = rng.random((480, 480)) < 0.1
    samples = no_samples(n)
    sample_paths(image, lines, np.flatnonzero(lines.at_samples(body)), signal, table, samples)
    colours, levels, classes = samples.values[:3].T, samples.values[3], samples.classes
    u, v = lines.samples.T
    j, i = u.astype(int), v.astype(int)
    fu, fv = (u - j)[:, None], (v - i)[:, None]
    grey = image.astype(float)
    wanted = (1 - fv) * ((1 - fu) * grey[i, j] + fu * grey[i, j + 1]) + fv * (
        (1 - fu) * grey[i + 1, j] + fu * grey[i + 1, j + 1]
    )
    np.testing.assert_allclose(colours, wanted, atol=1e-3)
    np.testing.assert_allclose(levels, wanted @ signal, atol=2e-3)
    b, g, r = (colours.astype(int) >> 2).T
    np.testing.assert_array_equal(classes, np.where(body[i, j], BODY, table[b, g, r]))


def test_scan_lines_cover_all_directions_and_stay_inside() -> None:
    lines = build_scan_lines(CAMERA, 72, 10, 42.0, 200.0)
    assert len(lines.starts) == 2 * 72 + 10 + 1
    u, v = lines.samples.T
    assert u.min() >= 0
    assert v.max() <= 479
    first = lines.samples[lines.starts[:144:2]] - CAMERA.center
    angles = np.sort(np.mod(np.arctan2(first[:, 1], first[:, 0]), 2 * np.pi))
    np.testing.assert_allclose(np.diff(angles), 2 * np.pi / 72, atol=1e-9)
    np.testing.assert_allclose(np.hypot(*first.T), 42.0)
    for k in range(144, 154):
        path = lines.samples[lines.starts[k] : lines.starts[k + 1]]
        steps = np.hypot(*np.diff(path, axis=0).T)
        assert np.all((steps > 0.9) & (steps < 1.1))
        np.testing.assert_allclose(path[lines.closed[k]], path[0], atol=1e-9)


def test_the_greens_end_bridges_lines_but_not_walls() -> None:
    rays, length = 24, 100
    starts = np.cumsum([0] + [length, 20] * rays).astype(np.int64)
    classes = np.ones(starts[-1], np.uint8)
    for ray in range(rays):
        first = starts[2 * ray]
        classes[first + 50 : first + 58] = 2  # a line across all rays
        if ray < 12:
            classes[first + 70 : first + length] = 0  # a wall on one side
    classes[starts[8] : starts[9]] = 0  # a rod along one ray
    ends = np.zeros(rays)
    green_ends(starts, rays, samples_of(classes), np.full(length, 10, np.int64), 40.0 + np.arange(length), ends)
    np.testing.assert_array_equal(ends, [109.0] * 12 + [139.0] * 12)
    angles = np.array([0.25, 0.25, 0.75, 0.75]) * 2 * np.pi
    radii = np.array([105.0, 115.0, 115.0, 145.0])
    rows = np.zeros((4, 7))
    rows[:, 2:4] = 100.0 + radii[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    np.testing.assert_array_equal(inside_green(rows, 100.0, 100.0, ends, np.full(4, 2.0)), [True, False, True, False])


def samples_of(classes: npt.NDArray[np.uint8], grey: float = 200.0) -> PathSamples:
    """Samples of these classes, all of one grey level."""
    samples = no_samples(len(classes))
    samples.values[:3] = grey
    return samples._replace(classes=classes)


def test_overexposed_ground_does_not_end_the_green() -> None:
    """Under direct sun carpet is white all over; in the shade behind it lines are seen again."""
    starts = np.cumsum([0] + [100, 20] * 12).astype(np.int64)
    classes = np.ones(starts[-1], np.uint8)
    for ray in range(12):
        classes[starts[2 * ray] + 20 : starts[2 * ray] + 60] = 2
    ends = np.zeros(12)
    for grey, end in ((200.0, 59.0), (255.0, 139.0)):
        green_ends(starts, 12, samples_of(classes, grey), np.full(100, 10, np.int64), 40.0 + np.arange(100), ends)
        np.testing.assert_array_equal(ends, end)


def test_a_range_table_that_begins_late_leaves_no_points_without_covariance(cross_image: ImageArray) -> None:
    late = replace(CAMERA, radius_px=CAMERA.radius_px[100:], range_m=CAMERA.range_m[:, 100:])
    points = detected(cross_image, late)
    assert len(points) >= 30
    assert np.all(np.isfinite(points.covariances_m2))


def test_a_failed_lesson_changes_nothing(cross_image: ImageArray) -> None:
    detector = LinePointDetector(CAMERA)
    detector.learn([cross_image])
    before = detector.detect(cross_image).positions_m, detector.body.copy(), detector.colours
    with pytest.raises(NoCarpetError):
        detector.learn([np.full((480, 480, 3), 120, np.uint8)])
    np.testing.assert_array_equal(detector.detect(cross_image).positions_m, before[0])
    np.testing.assert_array_equal(detector.body, before[1])
    assert detector.colours is before[2]


def test_reset_forgets_the_colours_and_says_what_is_missing(cross_image: ImageArray) -> None:
    detector = SelfLearningDetector(CAMERA)
    assert detector.learns_colours
    seen = detector.observe(Frame(0, cross_image))
    assert len(seen.points) > 0
    assert seen.problem is None
    detector.reset()
    grey = np.full((480, 480, 3), 120, np.uint8)
    grey[:240] = 180
    seen = detector.observe(Frame(1, grey))
    assert len(seen.points) == 0
    assert seen.problem is not None
    assert "no green carpet" in seen.problem
    with pytest.raises(TouchlineError, match="no colours yet"):
        detector.stages(cross_image)
    with pytest.raises(InputError, match="the camera file says"):
        detector.observe(Frame(2, cross_image[:-20]))


def test_a_covered_camera_is_told_from_a_dim_one(cross_image: ImageArray) -> None:
    rng = np.random.default_rng(0)
    assert is_covered(np.clip(rng.normal(7, 6, (480, 480, 3)), 0, 255).astype(np.uint8))
    assert not is_covered((cross_image * 0.2).astype(np.uint8))
    assert is_covered(np.full((5, 5, 3), 9, np.uint8))


def test_stages_are_pictures_of_each_step(cross_image: ImageArray) -> None:
    detector = LinePointDetector(CAMERA)
    detector.learn([cross_image])
    pictures = detector.stages(cross_image)
    assert list(pictures) == [
        "colour classes", "white against this green", "scan lines", "field boundary", "line points",
    ]  # fmt: skip
    for picture in pictures.values():
        assert picture.dtype == np.uint8
        assert picture.std() > 5
    assert math.isclose(pictures["line points"].shape[0], 960)


def test_an_image_whose_green_has_faded_is_not_learned_from_with_the_others() -> None:
    first, taken, learned = FirstImages(3), np.zeros((4, 1, 1, 3), dtype=np.uint8), list[int]()
    for k, share in enumerate((0.5, 0.1, 0.5, 0.5)):
        taken[k] = k
        first.take(taken[k], lambda images: learned.extend([int(each[0, 0, 0]) for each in images]))
        assert not first.watch(share)
    assert learned == [0, 0, 2, 3]
    assert first.are_learned


def test_an_image_without_carpet_takes_no_other_with_it() -> None:
    first, learned = FirstImages(3), list[int]()

    def learn(images: Sequence[ImageArray]) -> None:
        if images[-1][0, 0, 0] == 9:
            raise NoCarpetError("no carpet")
        learned[:] = [int(each[0, 0, 0]) for each in images]

    for number in (1, 2, 9, 3):
        with suppress(NoCarpetError):
            first.take(np.full((1, 1, 3), number, dtype=np.uint8), learn)
        first.watch(0.1 if number == 9 else 0.5)
    assert learned == [1, 2, 3]
