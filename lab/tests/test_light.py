"""The experiment light: where paint is, by the renderer, and what counts as found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from touchline.perception.profiles import on_one_line
from touchline.types import LinePoints, Observation
from touchline_lab.experiments import light
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.run import Simulation

pytestmark = pytest.mark.slow  # rendering


@pytest.fixture(scope="module")
def seen_truth() -> tuple[Simulation, Any]:
    """A robot with a mirror whose carpet ends right behind the lines, and the truth of its first image."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(light, "IMAGES", 1)
        run = light.simulation("mirror", "dark surround", 0)
    return run, light.images(run)[0][1]


def observation(pixels: np.ndarray) -> Observation:
    """Line points at pixels (N, 2)."""
    count = len(pixels)
    return Observation(0, LinePoints(np.zeros((count, 2)), np.tile(np.eye(2), (count, 1, 1)), np.ones(count), pixels))


def test_paint_is_what_the_lines_add_to_an_image(seen_truth: tuple[Simulation, Any]) -> None:
    _, truth = seen_truth
    assert truth.paint.min() > -1e-3
    assert truth.paint.max() <= 1.0
    assert 0.002 < float((truth.paint > 0.5).mean()) < 0.2
    assert truth.outer.any()
    assert not truth.outer.all()


def test_what_lies_on_paint_is_right_and_finds_it(seen_truth: tuple[Simulation, Any]) -> None:
    run, truth = seen_truth
    assert isinstance(run.camera_model, SimulatedOmniCamera)
    lines, outer = light.score(run, observation(truth.places), truth)
    assert lines.precision == lines.recall == outer.recall == 1.0
    inner, outer = light.score(run, observation(truth.places[~truth.outer]), truth)
    assert outer.recall < 0.2 < inner.recall < 1.0


def test_what_lies_beside_paint_is_wrong(seen_truth: tuple[Simulation, Any]) -> None:
    run, truth = seen_truth
    bare = np.argwhere(truth.paint < 0.01)[::997, ::-1].astype(np.float64)
    none = truth._replace(paint=np.zeros_like(truth.paint))
    assert light.score(run, observation(bare), none)[0].precision == 0.0
    assert light.score(run, observation(np.zeros((0, 2))), truth)[0].recall == 0.0


def test_an_exposure_suits_what_it_sees() -> None:
    """A hundredth of the light: a longer exposure first, then gain."""
    radiance = np.full((64, 64, 3), 0.05, dtype=np.float32)
    usual, dim = light.exposed(radiance), light.exposed(0.01 * radiance)
    assert usual[1] == 1.0
    assert usual[0] * 0.16 * 0.05 == pytest.approx(0.2, rel=1e-3)
    assert dim == (30.0, 8.0)


def test_points_beside_a_floor_count_in_a_row_alone() -> None:
    """Rows x, y, ..., px beside floor: six on a line, two aside, one with carpet on both sides."""
    rows = np.zeros((9, 8))
    rows[:6, 0], rows[:6, 1] = np.arange(6) * 0.25, 2.0
    rows[6:, :2] = [[0.5, 2.6], [3.0, 0.0], [-3.0, 0.0]]
    rows[:8, 7] = 3.0
    np.testing.assert_array_equal(on_one_line(rows, 1.5, 0.05, 4), [True] * 6 + [False, False, True])
