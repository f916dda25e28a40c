"""What moves during the exposure: a body that sways while the shutter rolls or stays open."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest
from line_profiles import line_offsets, projected_lines

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline_lab.simulation.cameras.base import Motion
from touchline_lab.simulation.cameras.perspective import SimulatedPerspectiveCamera
from touchline_lab.simulation.robot.track import STEP_S
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario
from touchline_lab.simulation.world.hall import default_world
from touchline_lab.simulation.world.lights import Lights
from touchline_lab.simulation.world.world import PAINTS, GroundMark, World, WorldState

READOUT_S = 0.03
ROWS = (100, 240, 330, 420)


@pytest.fixture(scope="module")
def walk() -> Simulation:
    """A humanoid that walks on the spot before a camera whose last row is exposed 30 ms after the first."""
    return Simulation(open_scenario("walk-in-place", seconds=1.5, changes=["camera.rolling_shutter_ms=30"]))


def test_each_row_of_a_rolling_shutter_sees_the_lean_of_its_own_instant(walk: Simulation) -> None:
    """Near a row the image is that of a still camera with the lean of that row's time; up to 3 px off the middle's."""
    camera = walk.camera_model
    assert isinstance(camera, SimulatedPerspectiveCamera)
    by_own_lean, by_lean_of_the_middle = [], []
    for index in range(0, len(walk), 2):
        time_s = float(walk.image_times_s[index])
        image = walk.image(index)
        for row in ROWS:
            own_s = time_s + (row / 479.0 - 0.5) * READOUT_S
            for found, instant_s in ((by_own_lean, own_s), (by_lean_of_the_middle, time_s)):
                lean = walk.track.attitude_at(instant_s)
                project = partial(camera.project, attitude=lean)
                places, normals, half, _ = projected_lines(project, walk.field, walk.truth[index], (752, 480))
                near = np.abs(places[:, 1] - row) < 8.0
                found.append(line_offsets(image, places[near], normals[near], half[near], 6.0))
    own, middle = (np.abs(np.concatenate(found)) for found in (by_own_lean, by_lean_of_the_middle))
    clear = np.isfinite(own) & np.isfinite(middle)
    assert np.count_nonzero(clear) > 100
    assert np.median(own[clear]) < 0.25
    assert np.percentile(own[clear], 90) < 0.6
    assert np.percentile(middle[clear], 90) > 1.0


def test_rates_of_leaning_are_the_slopes_of_the_lean(walk: Simulation) -> None:
    times = walk.track.times_s[20:-20]
    rates = np.array([walk.track.leaning_at(float(t)) for t in times])
    np.testing.assert_allclose(rates, np.gradient(walk.track.attitude, STEP_S, axis=0)[20:-20], atol=1e-9)
    assert np.degrees(np.abs(rates).max()) > 15.0


def test_a_swaying_body_blurs_edges_by_how_far_they_move_while_the_shutter_is_open() -> None:
    camera, pitch_rate, exposure_ms = SimulatedPerspectiveCamera(blur_steps=16), 0.8, 20.0
    world = _band_across_the_view()
    still = _edge_width(camera.radiance(world, WorldState(), Pose(0.0, 0.0, 0.0)))
    moving = Motion(0.0, 0.0, 0.0, pitch_rate=pitch_rate)
    blurred = _edge_width(camera.radiance(world, WorldState(), Pose(0.0, 0.0, 0.0), (0.0, 0.0), moving, exposure_ms))
    lean = 0.5 * pitch_rate * 1e-3 * exposure_ms
    ends = [camera.project(np.array([[2.0, 0.0]]), (0.0, side * lean))[0, 1] for side in (-1.0, 1.0)]
    moved_px = abs(ends[1] - ends[0])
    assert moved_px > 5.0
    assert still < 2.0
    assert blurred == pytest.approx(0.8 * moved_px, abs=0.3), "from 10 to 90 % of an even blur"


def _band_across_the_view() -> World:
    field = dataclasses.replace(open_field("indoor-9x6"), goals=(), poles=())
    band = GroundMark(3.0, 0.0, 0.0, 2.0, 6.0, PAINTS["black"])  # from 2 to 4 m before the robot
    world = default_world(field, lights=Lights(ambient=1.0), clutter=False)
    return dataclasses.replace(world, carpet_contrast=0.0, seam_spacing=0.0, marks=(band,))


def _edge_width(radiance: FloatArray) -> float:
    """Rows from 10 to 90 % of the way from dark band to carpet, in the middle column."""
    green = radiance[200:330, 400, 1].astype(np.float64)
    share = (green - green.min()) / (green.max() - green.min())
    rows = np.arange(len(share))
    rising = np.flatnonzero(share > 0.5)[0]
    window = slice(max(rising - 15, 0), rising + 15)
    crossed = [float(np.interp(level, share[window], rows[window])) for level in (0.1, 0.9)]
    return crossed[1] - crossed[0]
