"""Colours of the line graph: worn paint beside white walls, colours learned again or kept; kernels against NumPy."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from touchline.camera import GroundView, PinholeCamera
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.perception.colour import Carpet, _most_frequent_green, colour_model
from touchline.perception.colour_ellipses import FIXED, learned_ellipse, learned_names, tinted_chroma
from touchline.perception.line_graph import LineGraphDetector, LineGraphSettings
from touchline.perception.line_graph.colour_classes import (
    BLUE,
    CELL_PX,
    CLASSES,
    FIRST_WHITE,
    FULL,
    GREEN,
    MAGENTA,
    ORANGE,
    OTHER,
    WHITE,
    carpet_light,
    classes_of_model,
    colour_codes,
    count_classes,
    learn_classes,
    paint_above,
    suppress_fringes,
)
from touchline.perception.line_graph.colour_memory import ColourMemory
from touchline.perception.line_graph.contrast import contrasts, learn_contrast, white_blocks
from touchline.perception.line_graph.field_lines import FoundLines, _without_faint
from touchline.perception.line_graph.skeleton import NO_SKELETON, low_pass, rank_cells
from touchline.perception.self_learning import FADED_FRAMES
from touchline.types import ImageArray

CARPET, WORN, WALL = (45, 90, 75), (105, 130, 125), (240, 240, 240)
SIDES = np.full((120, 2), 6)


def worn_field(carpet: tuple[int, int, int] = CARPET) -> ImageArray:
    """Carpet with worn lines before a white wall, with a white post that stands on it."""
    image = np.full((240, 320, 3), carpet, dtype=np.uint8)
    cv2.line(image, (0, 150), (319, 120), WORN, 6, cv2.LINE_AA)
    cv2.line(image, (60, 100), (180, 239), WORN, 8, cv2.LINE_AA)
    image[:80] = WALL
    image[:130, 250:262] = WALL
    noise = np.random.default_rng(3).normal(0.0, 4.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def everywhere() -> np.ndarray:
    return np.ones((240, 320), dtype=np.bool_)


def test_paint_is_learned_from_worn_lines_not_from_walls() -> None:
    model = learn_classes([worn_field()], everywhere(), everywhere(), yuv=False).model
    np.testing.assert_allclose(model.green, CARPET, atol=3.0)
    np.testing.assert_allclose(model.white, WORN, atol=8.0)


def test_a_grey_thing_before_the_camera_is_no_carpet() -> None:
    """A polished dome fills a third of the image, hardly greenish but all of one hue; turf has many."""
    image = worn_field()
    rng = np.random.default_rng(5)
    turf = np.array(CARPET) * rng.uniform(0.6, 1.4, (240, 320, 1)) + rng.normal(0.0, 14.0, image.shape)
    image = np.where(np.all(image > 200, axis=-1)[..., np.newaxis], image, np.clip(turf, 0, 255)).astype(np.uint8)
    image[160:] = (101, 117, 104)
    pixels = cv2.GaussianBlur(image, (0, 0), 2.5).reshape(-1, 3).astype(np.float64)
    np.testing.assert_allclose(_most_frequent_green(pixels), [45 / 210, 75 / 210], atol=0.02)


def test_colours_are_learned_from_what_stands_on_the_carpet_not_from_posters() -> None:
    image = worn_field()
    blue, poster = (120, 60, 25), (70, 30, 15)
    image[90:200, 20:34] = blue
    image[10:60, 100:140] = poster
    learned = learn_classes([image], everywhere(), everywhere(), yuv=False).model
    assert learned_names(learned.ellipses) == ("blue",)
    seen = np.array([blue, [0.5 * value for value in blue]], dtype=np.float64)
    assert colour_codes(seen, learned).tolist() == [BLUE, BLUE]
    assert colour_codes(seen, replace(learned, ellipses=FIXED)).tolist() == [BLUE, OTHER]  # not in the shade
    image[90:200, 20:34] = CARPET
    assert learn_classes([image], everywhere(), everywhere(), yuv=False).model.ellipses == FIXED


def shaded_scene() -> tuple[LineGraphDetector, ImageArray, np.ndarray, np.ndarray]:
    """Hardly green carpet whose left part lies in the shade; its detector, and where paint and where shade is."""
    rng, field = np.random.default_rng(1), open_field("humanoid-kid-9x6")
    mount = Pose3.from_roll_pitch_yaw(0.0, 0.45, 0.0, (0.0, 0.0, 1.0))
    camera = PinholeCamera(640, 480, 450.0, 450.0, 319.5, 239.5, np.zeros(5), mount)
    v, u = np.mgrid[:480, :640]
    ground = GroundView(camera).ground_from_image(np.column_stack((u.ravel(), v.ravel())).astype(np.float64))
    places = Pose(1.5, 0.3, 0.1).transform(np.nan_to_num(ground, nan=1e6))
    paint = field.line_distances(places) < 0.5 * field.line_width
    paint, shade = paint.reshape(u.shape), u < 260 + 0.3 * (v - 240)
    image = np.where(paint[..., np.newaxis], (217.0, 202.0, 200.0), (150.0, 168.0, 150.0))
    turf = cv2.GaussianBlur(rng.normal(0.0, 1.0, u.shape), (0, 0), 1.0)
    image *= np.exp(0.06 * turf / turf.std())[..., np.newaxis]
    image[shade] *= (0.5, 0.6, 0.52)
    image[np.isnan(ground[:, 0]).reshape(u.shape)] = WALL
    image = cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0.0, 3.0, image.shape)
    return LineGraphDetector(camera, LineGraphSettings(), field), np.clip(image, 0, 255).astype(np.uint8), paint, shade


def test_shaded_paint_in_the_colour_of_sunlit_carpet_is_found_by_the_carpet_beside_it() -> None:
    detector, image, paint, shade = shaded_scene()
    seen = detector.detect(image, GroundView(detector.camera))
    assert detector.classes is not None
    assert detector.classes.least_contrast > 0.0
    u, v = np.rint(seen.points.pixels).astype(int).T
    near = cv2.dilate(paint.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    assert near[v, u].mean() > 0.98  # none along the edge of the shade
    for part in (shade, ~shade):
        found = np.zeros(paint.shape, dtype=np.uint8)
        found[v, u] = 1
        columns = (paint & part).any(axis=0)
        assert (cv2.dilate(found, np.ones((1, 13), np.uint8)) & part).any(axis=0)[columns].mean() > 0.9


@pytest.mark.parametrize(("floor", "is_line"), [((70, 72, 75), True), ((170, 168, 165), False)])
def test_paint_beside_a_dark_floor_is_white(floor: tuple[int, ...], is_line: bool) -> None:
    """A touch line with carpet on one side alone, and the brink of a pale floor, which is as white but no line."""
    blocks = np.empty((60, 60, 3), dtype=np.float32)
    blocks[:, :30], blocks[:, 30:33], blocks[:, 33:] = (110, 150, 120), (200, 200, 200), floor
    white = white_blocks(blocks, np.full((60, 2), 4), 0.15)
    assert bool(white[10:50, 30:33].all()) is is_line
    assert not white[:, :29].any()
    assert not white[:, 34:].any()


def test_a_shadow_on_textured_carpet_is_no_floor() -> None:
    """At its edge, too, paint has to be less coloured than both sides."""
    rng, reach = np.random.default_rng(7), np.full((200, 2), 4)
    blocks = np.multiply.outer(np.exp(0.06 * rng.normal(size=(200, 60))), (110.0, 150.0, 120.0))
    blocks *= np.exp(0.06 * rng.normal(size=blocks.shape))
    blocks[:, 30:] *= 0.35
    carpet = blocks.astype(np.float32)
    np.testing.assert_array_equal(contrasts(carpet, reach, dark=2.0), contrasts(carpet, reach))
    assert not white_blocks(carpet, reach, 0.15).any()


def test_where_colours_tell_paint_the_carpet_beside_it_is_not_asked() -> None:
    assert learn_classes([worn_field()], everywhere(), everywhere(), False, SIDES).least_contrast == 0.0


def test_carpet_without_any_texture_teaches_paint_where_lines_are_drawn_on_it() -> None:
    image, ground, reach = np.full((480, 752, 3), (50, 110, 70), np.uint8), np.ones((480, 752), np.bool_), 6
    sides = np.full((240, 2), reach)
    model = learn_classes([worn_field()], everywhere(), everywhere(), False, SIDES).model
    assert learn_contrast([image], ground, sides, model) is None
    image[100:106] = image[300:306] = (230, 235, 232)
    found = learn_contrast([image], ground, sides, model)
    assert found is not None
    assert found.paint == pytest.approx([230.0, 235.0, 232.0], rel=0.6)  # in the light that the model was learned in


def test_a_colour_file_s_classes_are_those_that_were_marked() -> None:
    model = learn_classes([worn_field()], everywhere(), everywhere(), yuv=False).model
    mauve = np.array([[100.0, 75.0, 110.0]])
    tinted = tinted_chroma(np.repeat(mauve, 40, axis=0), model.white)
    ellipses = (*FIXED[:3], learned_ellipse(tinted, FIXED[3], 0.0), FIXED[4])
    b, g, r = mauve[0].astype(int)
    for colours, wanted in ((model, False), (replace(model, ellipses=ellipses), True)):
        table = classes_of_model(colours, yuv=False).tables[0]
        assert (table[((b >> 3) << 11) | ((g >> 2) << 5) | (r >> 3)] == MAGENTA) == wanted


def test_faint_lines_are_left_out_beside_strong_ones_only() -> None:
    points = np.zeros((8, 5))
    points[:, 2] = np.repeat((0, 1), 4)
    points[:, 3] = 1.0
    points[:, 4] = np.repeat((1.0, 0.5), 4)
    found = FoundLines(np.arange(8.0).reshape(2, 4), np.array([0.9, 0.8]), points)
    kept = _without_faint(found)
    assert len(kept.planes) == len(kept.confidences) == 1
    assert len(kept.points) == 4
    points[:4, 4] = 0.6
    assert len(_without_faint(found).planes) == 2


def test_colours_are_learned_again_when_the_green_fades() -> None:
    memory = ColourMemory(None, 1, yuv=False)
    memory.learn(worn_field(), lambda: (everywhere(), everywhere(), SIDES))
    assert not memory.is_learning
    counts = np.zeros((CLASSES, 30, 40), dtype=np.uint8)
    horizon = np.ones((30, 40), dtype=np.bool_)
    counts[GREEN] = FULL
    memory.watch(counts, horizon, np.full(40, 30.0))
    counts[GREEN] = 2
    for _ in range(FADED_FRAMES - 1):
        memory.watch(counts, horizon, np.full(40, 30.0))
    assert not memory.is_learning
    memory.watch(counts, horizon, np.full(40, 30.0))
    assert memory.is_learning
    memory.learn(worn_field((30, 60, 50)), lambda: (everywhere(), everywhere(), SIDES))
    assert memory.classes is not None
    np.testing.assert_allclose(memory.classes.model.green, (30, 60, 50), atol=3.0)


def test_a_carpet_without_blue_and_red_is_followed() -> None:
    """A simulator's pure green: where a channel shows nothing its tint is as strong as any is taken to be."""
    memory, usual = ColourMemory(None, 1, yuv=False), worn_field((0, 150, 0))
    memory.learn(usual, lambda: (everywhere(), everywhere(), SIDES))
    counts = np.zeros((CLASSES, 30, 40), dtype=np.uint8)
    counts[GREEN] = FULL
    memory.watch(counts, np.ones((30, 40), dtype=np.bool_), np.full(40, 20.0))
    memory.follow(usual)
    assert memory.classes is not None
    assert np.isfinite(memory.classes.model.green).all()


def test_cells_count_as_numpy_does() -> None:
    image = worn_field()
    table = np.random.default_rng(1).choice(np.array([1, 3, 8, 40, 200], dtype=np.uint8), 1 << 16)
    rows, columns = 240 // CELL_PX, 320 // CELL_PX
    counts = np.empty((CLASSES, rows, columns), dtype=np.uint8)
    same = np.stack((table, table))
    count_classes(
        image, same, np.full((rows, columns), 100, dtype=np.uint8), np.zeros((rows, columns), np.uint8), counts
    )
    b, g, r = (image[..., k].astype(np.int64) for k in range(3))
    codes = table[((b >> 3) << 11) | ((g >> 2) << 5) | (r >> 3)]

    looked_at = np.indices(codes.shape).sum(axis=0) % 2 == 0

    def in_cells(mask: np.ndarray) -> np.ndarray:
        return 2 * (mask & looked_at).reshape(rows, CELL_PX, columns, CELL_PX).sum(axis=(1, 3))

    np.testing.assert_array_equal(counts[WHITE], in_cells(codes >= 100))
    for kind in range(1, CLASSES):
        np.testing.assert_array_equal(counts[kind], in_cells(codes == kind))


@pytest.mark.parametrize("passes", [1, 3])
def test_low_pass_and_ranks_as_numpy_does(passes: int) -> None:
    white: FloatArray = np.random.default_rng(2).integers(0, 64, (30, 40)).astype(np.float64)
    smooth, ranks = np.empty_like(white), np.empty(white.shape, dtype=np.uint8)
    low_pass(white, np.full(30, passes), smooth)
    expected = white
    for _ in range(passes):
        padded = np.pad(expected, 1, mode="edge")
        along = 0.25 * padded[:, :-2] + 0.5 * padded[:, 1:-1] + 0.25 * padded[:, 2:]
        expected = 0.25 * along[:-2] + 0.5 * along[1:-1] + 0.25 * along[2:]
    np.testing.assert_allclose(smooth, expected)
    rank_cells(smooth, ranks, 0.75)
    padded = np.pad(smooth, 1, mode="edge")
    count = np.zeros(smooth.shape, dtype=np.int64)
    for row in range(3):
        for column in range(3):
            if (row, column) != (1, 1):
                count += padded[row : row + 30, column : column + 40] >= smooth
    np.testing.assert_array_equal(ranks, np.where((count < 3) & (smooth >= 0.75), count, NO_SKELETON))


def test_orange_beside_white_is_a_fringe_a_ball_is_none() -> None:
    counts = np.zeros((CLASSES, 6, 8), dtype=np.uint8)
    counts[GREEN] = FULL
    counts[WHITE, :, 1], counts[GREEN, :, 1] = 30, 20
    counts[ORANGE, 2, 2] = 10  # beside a line, few pixels
    counts[ORANGE, 2, 5] = 10  # alone on the carpet
    counts[ORANGE, 4, 2] = 50  # beside a line, most of the cell
    suppress_fringes(counts)
    assert counts[ORANGE, 2, 2] == 0
    assert counts[ORANGE, 2, 5] == 10
    assert counts[ORANGE, 4, 2] == 50


def test_carpet_that_the_sun_washes_out_is_green_and_lines_on_it_are_white() -> None:
    """Carpet whose G is at its limit, a patch of it as wide as the image; a line runs through both."""
    image = np.zeros((240, 320, 3), dtype=np.uint8)
    image[:] = (71, 138, 97)
    image[:, 160:] = (146, 251, 222)
    image[120:128] = (200, 205, 200)
    image[120:128, 160:] = 255
    carpet = Carpet(np.tile([71.0, 138.0, 97.0], (50, 1)) + np.random.default_rng(0).normal(0.0, 4.0, (50, 3)),
                    np.array([71.0, 138.0, 97.0]), np.array([0.232, 0.317]), 0.01**2 * np.eye(2), 3.0)  # fmt: skip
    classes = classes_of_model(colour_model(carpet, np.array([200.0, 205.0, 200.0])), yuv=False)
    light, washed = np.ones((30, 40)), np.zeros((30, 40), dtype=np.uint8)
    model = (float(classes.model.green.sum()), classes.model.signal)
    carpet_light(image, classes.tables, model, (light, washed, np.zeros((30, 40))))
    assert washed[:, 22:].all()
    assert not washed[:, :18].any()
    white_from = np.clip(FIRST_WHITE + (classes.white_from - FIRST_WHITE) * light, 0, classes.white_until)
    counts = np.empty((CLASSES, 30, 40), dtype=np.uint8)
    count_classes(image, classes.tables, white_from.astype(np.uint8), washed, counts)
    assert (counts[GREEN, :14, 22:] == 64).all()
    assert (counts[WHITE, 15] == 64).all()


def test_paint_is_told_by_what_it_exceeds_the_carpet_by_that_the_sun_brings_to_an_image_s_limit() -> None:
    """Colours that were learned with such a patch in view take it for carpet; all of its G and all paint is 255."""
    green, white = np.array([93.0, 152.0, 84.0]), np.array([173.0, 190.0, 172.0])
    patch, paint = np.array([206, 255, 184]), np.full(3, 255)
    pixels = np.repeat((green, patch), 50, axis=0) + np.random.default_rng(0).normal(0.0, 4.0, (100, 3))
    carpet = Carpet(pixels, green, np.array([0.255, 0.283]), 0.03**2 * np.eye(2), 3.0)
    model = colour_model(carpet, white)
    classes = classes_of_model(model, yuv=False)
    image = np.zeros((240, 320, 3), dtype=np.uint8)
    image[:, :160], image[:, 160:] = green, patch
    light, base = np.ones((2, 30, 40))
    base *= float(model.signal @ model.green)
    washed = np.zeros((30, 40), dtype=np.uint8)
    carpet_light(image, classes.tables, (float(model.green.sum()), model.signal), (light, washed, base))
    above = paint_above(base, light, (model.white, model.signal))

    def signal(colour: FloatArray, column: int) -> float:
        return float((model.signal @ colour - base[15, column]) / above[15, column])

    for carpet_there, paint_there, far, near in ((green, white, 5, 16), (patch, paint, 34, 23)):
        assert signal(carpet_there, far) == pytest.approx(0.0, abs=0.02)
        assert signal(paint_there, far) == pytest.approx(1.0, abs=0.02)
        assert signal(carpet_there, near) == pytest.approx(0.0, abs=0.02)  # three cells beside the edge
        assert signal(paint_there, near) > 0.7
