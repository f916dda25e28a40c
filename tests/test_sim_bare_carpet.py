"""The wide loops of the renderer against their plain twins: bare carpet, nets, samples."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest

from touchline.field import open_field
from touchline.geometry import FloatArray
from touchline.simulation.rendering.bare_carpet import PLACE_ROWS, POINT_ROWS, find_plain, look_up_light, look_up_pile
from touchline.simulation.rendering.carpet import pile_pyramid
from touchline.simulation.rendering.ground_shading import sift_ground
from touchline.simulation.rendering.illumination import FLAGS_PER_M, SUN_TIGHT_M, light_at, sun_at, sunward
from touchline.simulation.rendering.nets import net_share
from touchline.simulation.rendering.paint import build_paint, mark_paint, paint_at, shape_depth, shape_row
from touchline.simulation.rendering.pile import FIRST_TEXEL_M, LEVELS, TILE_TEXELS, pile_at, samples_within
from touchline.simulation.rendering.sampling import fill_samples
from touchline.simulation.rendering.scene import Scene
from touchline.simulation.world.hall import default_world
from touchline.simulation.world.lights import Lights, Window
from touchline.simulation.world.world import RobotActor, WorldState


def test_the_pile_is_looked_up_as_point_by_point_at_every_level_and_on_both_sides_of_the_middle() -> None:
    rng = np.random.default_rng(1)
    pyramid = pile_pyramid(rng)
    points = np.zeros((POINT_ROWS, 5000), dtype=np.float32)
    points[:2] = rng.uniform(-13.0, 13.0, (2, 5000))
    points[2] = FIRST_TEXEL_M**2 * 4.0 ** rng.uniform(-1.5, LEVELS + 0.5, 5000)
    expected = [pile_at(pyramid, float(x), float(y), float(square)) for x, y, square in points[:3].T]
    look_up_pile(points, 4990, pyramid)
    assert np.abs(points[0, :4990] - expected[:4990]).max() < 0.02, "of a standard deviation of 1"
    assert np.abs(points[0, :4990] - expected[:4990]).mean() < 1e-3


def test_the_pile_repeats_with_its_tile() -> None:
    pyramid = pile_pyramid(np.random.default_rng(2))
    points = np.zeros((POINT_ROWS, 2), dtype=np.float32)
    points[0] = 0.4567, 0.4567 - TILE_TEXELS * FIRST_TEXEL_M
    points[1] = 1.2345
    look_up_pile(points, 2, pyramid)
    assert points[0, 0] == pytest.approx(points[0, 1], abs=0.02)


def test_carpet_is_plain_only_where_a_pixel_reaches_no_paint_and_no_edge_of_sunlight() -> None:
    rng, count = np.random.default_rng(4), 4000
    grid = build_paint(open_field("indoor-9x6"), (), (12.0, 9.0, 3.0))
    shape = (round(grid.frame[3] * 0.25 * FLAGS_PER_M), round(grid.frame[2] * 0.25 * FLAGS_PER_M))
    flags = np.zeros(shape, dtype=np.uint8)
    mark_paint(grid, FLAGS_PER_M, flags, (1, 32, 64))
    flags[:, : shape[1] // 8] |= 128  # sunlight ends within 0.1 m
    flags[:, : shape[1] // 16] |= 16  # and here within 0.03 m
    cast, landing = np.ones((9, count), dtype=np.float32), np.empty((4, count), dtype=np.float32)
    landing[:2] = rng.uniform(((-5.9,), (-4.4,)), ((5.9,), (4.4,)), (2, count))
    landing[2], landing[3] = 10.0 ** rng.uniform(-2.5, -0.3, count), 1.0  # far above the pile's finest levels
    extents = np.stack((np.zeros(count), np.zeros(count), 0.5 * landing[2])).astype(np.float32)
    flag, plain = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    frame = np.array([*grid.frame[:2], shape[1], shape[0]])
    words = flags.reshape(-1).view(np.uint32)
    find_plain(cast, extents, landing, count, words, frame, np.zeros(5), False, flag, plain)
    cells = ((landing[1] - frame[1]) * FLAGS_PER_M).astype(int), ((landing[0] - frame[0]) * FLAGS_PER_M).astype(int)
    assert np.array_equal(flag, flags[cells])
    assert 0.3 < plain.mean() < 0.8
    for x, y, reach in landing[:3, plain == 1].T.astype(float):
        assert max(shape_depth(shape_row(grid.shapes, k), x, y, 1.0) for k in range(len(grid.shapes))) < -reach
    assert not plain[flag & 16 > 0].any()
    assert not plain[(flag & 128 > 0) & (landing[2] > SUN_TIGHT_M)].any()
    find_plain(cast, extents, landing, count, words, frame, np.array([0.1, 0.3, 0.1, 2.0, 1.0]), False, flag, plain)
    wide = landing[2] > 0.2
    over_seam = np.abs((landing[0] / 2.0 + 0.37) - np.round(landing[0] / 2.0 + 0.37)) * 2.0 < landing[2] - 0.1
    assert not plain[wide & over_seam].any()


def test_what_is_plain_is_bare_to_a_close_look_too() -> None:
    rng, count = np.random.default_rng(7), 20000
    window = Window("north", -2.0, 1.5, 1.0, 3.0)
    lights = Lights(ambient=0.5, sun=2.0, sun_azimuth_rad=1.4, sun_elevation_rad=0.6, windows=(window,))
    field = open_field("indoor-9x6")
    world = dataclasses.replace(default_world(field, 3), lights=lights, robots=(RobotActor(1.0, 0.6, 0.5),))
    scene = Scene(world)
    scene.update(WorldState())
    s = scene.arrays(np.zeros(1, dtype=np.int32), np.zeros(0, dtype=np.int16), np.zeros(0))
    turn, rise = rng.uniform(-np.pi, np.pi, count), -(10.0 ** rng.uniform(-0.9, 0.5, count))
    cast, extents, landing = (np.zeros((rows, count), dtype=np.float32) for rows in (9, 3, 4))
    cast[2:6] = np.full(count, 0.8), np.cos(turn), np.sin(turn), rise
    cast[6] = 0.8 / -rise
    cast[8] = (cast[6] ** 2 + 0.64) / 0.8
    extents[2] = rng.uniform(0.2, 0.4, count) * 0.006 * cast[8]
    landing[:2] = rng.uniform(((-4.8,), (-3.3,)), ((4.8,), (3.3,)), (2, count))
    landing[2] = extents[2] * rng.uniform(1.1, 2.0, count)
    landing[3] = 1.5 * (0.006 * cast[8]) ** 2
    texture = np.tile(np.float32([[0.0015], [0.0005], [-0.0005], [0.0015], [0.006]]), count)
    flag, plain = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    find_plain(cast, extents, landing, count, s.flag_words, s.flag_frame, s.carpet, True, flag, plain)
    marks, places = np.empty((4, count), dtype=np.float32), np.empty((PLACE_ROWS, count), dtype=np.float32)
    points, edges = np.empty((POINT_ROWS, 4 * count), dtype=np.float32), np.zeros(count, dtype=np.bool_)

    def sifted(rays: npt.NDArray[np.int32]) -> tuple[int, int, int]:
        found: tuple[int, int, int] = sift_ground(
            rays, landing, cast, extents, texture, True, flag, s.shapes, s.cell_starts, s.cell_items, s.paint_frame,
            s.carpet, s.casters, s.caster_cells, s.sun, s.windows, marks, np.empty(count, dtype=np.int32), places,
            points, 0, edges,
        )  # fmt: skip
        return found

    rays = np.flatnonzero(plain).astype(np.int32)
    assert 2000 < len(rays) < 15000
    assert sifted(rays.copy()) == (0, len(rays), len(rays))
    assert np.all(places[5, : len(rays)] == 1.0), "in nobody's shadow"
    assert not edges.any()
    left, bare, _ = sifted(np.flatnonzero(plain == 0).astype(np.int32))
    assert left > 500
    assert bare > 500
    assert edges.sum() > 500


def test_the_pile_at_two_levels_is_not_plain() -> None:
    texels = np.array([0.5, 0.97, 1.02, 2.0, 3.9, 4.1, 8.0, 16.3, 25.0])
    landing = np.zeros((4, len(texels)), dtype=np.float32)
    landing[2], landing[3] = 0.01, texels * FIRST_TEXEL_M**2
    cast, extents = np.ones((9, len(texels)), dtype=np.float32), np.full((3, len(texels)), 0.01, dtype=np.float32)
    flag, plain = np.empty(len(texels), dtype=np.int32), np.empty(len(texels), dtype=np.int32)
    words, frame = np.zeros(4, dtype=np.uint32), np.array([-2.0, -2.0, 4.0, 4.0])
    find_plain(cast, extents, landing, len(texels), words, frame, np.zeros(5), False, flag, plain)
    assert plain.tolist() == [0, 0, 0, 1, 0, 0, 1, 0, 1], "below one texel its four samples are looked up"


def corners(px: float, py: float, qx: float, qy: float) -> FloatArray:
    """A grid of 9 x 9 points (81, 2) over the parallelogram with corners at +-p +-q."""
    a, b = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-1.0, 1.0, 9))
    return np.stack((a * px + b * qx, a * py + b * qy), axis=-1).reshape(-1, 2)


def test_edges_of_paint_are_told_wherever_a_pixels_samples_see_them() -> None:
    rng = np.random.default_rng(5)
    grid = build_paint(open_field("indoor-9x6"), (), (12.0, 9.0, 3.0))
    told, seen = 0, 0
    for _ in range(3000):
        x, y = rng.uniform((-4.8, -3.3), (4.8, 3.3))
        deep, wide, angle, turn = rng.uniform((0.01, 0.005, 0.0, 0.0), (0.1, 0.05, np.pi, np.pi))
        p = samples_within(
            0.25 * np.cos(turn), 0.25 * np.sin(turn), -0.25 * np.sin(turn), 0.25 * np.cos(turn), deep, wide,
            np.cos(angle), np.sin(angle), True,
        )  # fmt: skip
        paint, near = paint_at(*grid, x, y, *p)
        others = {paint_at(*grid, x + dx, y + dy)[0] for dx, dy in corners(*p)}
        assert near or others == {paint}
        told, seen = told + near, seen + (len(others) > 1)
    assert told < 1.2 * seen, "and hardly anywhere else"


def test_edges_of_sunlight_are_told_wherever_a_pixels_samples_see_them() -> None:
    rng = np.random.default_rng(6)
    windows = sunward(np.array([[1.0, 4.5, -2.0, 1.5, 1.0, 3.0, 2.0, 1.0, 0.1]]), np.radians(70.0), np.radians(35.0))
    sun = np.array([2.0, np.cos(np.radians(70.0)), np.sin(np.radians(70.0)), np.tan(np.radians(35.0))])
    casters = np.array([[-1.0, 1.0, 0.25, 0.8], [-1.6, 0.4, 0.1, 0.3]])
    told, seen = 0, 0
    for _ in range(4000):
        x, y = rng.uniform((-5.0, -1.5), (3.0, 3.5))
        deep, wide, angle = rng.uniform((0.01, 0.005, 0.0), (0.1, 0.05, np.pi))
        p = samples_within(0.25, 0.1, -0.1, 0.25, deep, wide, np.cos(angle), np.sin(angle), True)
        lit, near = sun_at(sun, windows, casters, x, y, 0.0, 0.0, *p)
        others = {sun_at(sun, windows, casters, x + dx, y + dy, 0.0, 0.0)[0] for dx, dy in corners(*p)}
        assert near or others == {lit}
        told, seen = told + near, seen + (len(others) > 1)
    assert told < 1.5 * seen, "and not in many other places"


def test_light_on_bare_carpet_is_the_share_of_the_map_and_the_sun() -> None:
    rng = np.random.default_rng(3)
    light, frame = rng.uniform(0.2, 1.0, (40, 60, 2)).astype(np.float32), np.array([-3.7, -2.4, 8.0])
    places = np.zeros((PLACE_ROWS, 1000), dtype=np.float32)
    places[:2] = rng.uniform((-4.5,), (4.5,), (2, 1000))
    places[2], places[5] = rng.random(1000) < 0.5, rng.uniform(0.4, 1.0, 1000)
    expected = []
    for x, y, sunlit, _, _, share in places[:6].T:
        lamps, carpet = (light_at(light, frame, channel, float(x), float(y)) for channel in (0, 1))
        expected.append(carpet * (share + (0.8 / lamps if sunlit else 0.0)))
    look_up_light(places, 1000, light, frame, 0.8)
    assert places[0] == pytest.approx(np.array(expected), rel=1e-4)


def test_the_share_that_a_net_lets_by_is_that_of_its_meshes_over_the_rays_width() -> None:
    mesh, thread, angle, distance = 0.12, 0.011, 0.004, 2.5
    net = (distance, 0.0, 0.0, 1.0, 1.5, 0.0, 1.0, mesh, thread)  # across x, 2.5 m ahead
    fine = np.linspace(-0.5, 0.5, 401) * distance * angle
    for turn, height in ((0.0, 0.6), (0.01, 0.63), (0.0231, 0.557), (0.05, 0.61)):
        ux, uy = np.cos(turn), np.sin(turn)
        far = distance / ux
        aside, up = far * uy + fine * far / distance / ux, height + fine * far / distance
        gaps = [np.mean(np.abs(p - mesh * np.round(p / mesh)) > 0.5 * thread) for p in (aside, up)]
        assert net_share(net, height, ux, uy, 0.0, angle, 10.0) == pytest.approx(gaps[0] * gaps[1], abs=0.02)
    assert net_share(net, 0.6, 1.0, 0.0, 0.0, angle, 2.4) == 1.0, "what the ray meets stands before the net"
    assert net_share(net, 1.2, 1.0, 0.0, 0.0, angle, 10.0) == 1.0, "above the net"


@pytest.mark.parametrize("side", [2, 3])
def test_samples_lie_on_a_grid_between_the_rays_of_the_neighbours(side: int) -> None:
    rows, columns = np.mgrid[:5, :7].astype(np.float32)
    rays = np.stack([a * columns + b * rows for a, b in ((1, 0), (0, 1), (2, 3), (1, 1), (-1, 2), (0.5, 0))], axis=-1)
    rays[2, 4] = np.nan  # beside pixel (2, 3): the step to the other side counts alone
    pixels = np.array([0, 2 * 7 + 3, 4 * 7 + 6], dtype=np.int32)
    samples = np.empty((6, 3 * side * side), dtype=np.float32)
    fill_samples(rays, pixels, side, samples)
    steps = (np.arange(side) + 0.5) / side - 0.5
    down, right = np.meshgrid(steps, steps, indexing="ij")
    for number, pixel in enumerate(pixels):
        v, u = divmod(int(pixel), 7)
        block = slice(number * side * side, (number + 1) * side * side)
        assert samples[0, block] == pytest.approx(u + right.ravel(), abs=1e-5)
        assert samples[1, block] == pytest.approx(v + down.ravel(), abs=1e-5)
        assert samples[2, block] == pytest.approx((2 * (u + right) + 3 * (v + down)).ravel(), abs=1e-4)
