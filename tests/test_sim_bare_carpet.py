"""The wide loops of the renderer against their plain twins: bare carpet, nets, samples."""

from __future__ import annotations

import numpy as np
import pytest

from touchline.simulation.bare_carpet import PLACE_ROWS, POINT_ROWS, look_up_light, look_up_pile
from touchline.simulation.carpet import pile_pyramid
from touchline.simulation.illumination import light_at
from touchline.simulation.nets import net_share
from touchline.simulation.pile import FIRST_TEXEL_M, LEVELS, TILE_TEXELS, pile_at
from touchline.simulation.sampling import fill_samples


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
