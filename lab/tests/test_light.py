"""The experiment light: where paint is, by the renderer, and what counts as found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from touchline.motion import LeanFilter
from touchline.perception import LinePointDetector, LinePointSettings, detector_for, observe
from touchline.perception.profiles import on_one_line
from touchline.types import LinePoints, Observation
from touchline_lab.experiments import light
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.run import Simulation


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


def test_a_touch_line_at_the_carpets_end_is_found_and_a_robots_foot_is_none(
    seen_truth: tuple[Simulation, Any],
) -> None:
    """Carpet on one side, dark floor on the other: 3 % of it was found before."""
    run, truth = seen_truth
    radiance, _ = run.camera_model.paint_ratio(run.world, run.state(0.4), run.track.pose_at(0.4))
    image = run.camera_model.sensor.develop(radiance, *light.exposed(radiance), np.random.default_rng(0))
    recalls = []
    for dark_floor in (False, True):
        settings = LinePointSettings.model_validate({"paper": {"dark_floor": dark_floor}})
        detector = LinePointDetector(run.camera, settings)
        detector.learn([image])
        lines, outer = light.score(run, Observation(0, detector.detect(image)), truth)
        assert lines.precision >= 0.98
        recalls.append(outer.recall)
    assert recalls[0] < 0.2
    assert recalls[1] >= 0.8


def test_points_beside_a_floor_count_in_a_row_alone() -> None:
    """Rows x, y, ..., px beside floor: six on a line, two aside, one with carpet on both sides."""
    rows = np.zeros((9, 8))
    rows[:6, 0], rows[:6, 1] = np.arange(6) * 0.25, 2.0
    rows[6:, :2] = [[0.5, 2.6], [3.0, 0.0], [-3.0, 0.0]]
    rows[:8, 7] = 3.0
    np.testing.assert_array_equal(on_one_line(rows, 1.5, 0.05, 4), [True] * 6 + [False, False, True])


@pytest.mark.parametrize("camera", light.CAMERAS)
def test_a_passing_cloud_hides_no_lines(camera: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A third of the light, bluer or warmer, with the exposure and the colours of before; at worst none was found."""
    monkeypatch.setattr(light, "IMAGES", 3)
    run, cold, recalls, precisions = light.simulation(camera, light.CLOUD, 20), light._BLUER, [], []
    for bluer in (0.0 * cold, cold, -cold):
        monkeypatch.setattr(light, "_BLUER", bluer)
        detector, leaning = detector_for(run.camera, run.field), LeanFilter()
        frames = light.images(run, cloud=bool(bluer.any()))
        each = [light.score(run, observe(leaning.at_image(frame), detector, 8.0), truth)[0] for frame, truth in frames]
        precisions += [one.precision for one in each]
        recalls.append(np.mean([one.recall for one in each]))
    assert min(recalls[1:]) >= 0.9 * recalls[0]
    assert np.mean(precisions) >= 0.96
    assert min(precisions) >= 0.93  # three or four of sixty points
