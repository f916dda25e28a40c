"""What moves during the exposure: a body that sways while the shutter rolls or stays open."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

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

pytestmark = pytest.mark.slow  # rendering


@pytest.fixture(scope="module")
def walk() -> Simulation:
    """A humanoid that walks on the spot before a camera whose last row is exposed 30 ms after the first."""
    return Simulation(open_scenario("walk-in-place", seconds=1.5, changes=["camera.rolling_shutter_ms=30"]))


def test_rates_of_leaning_are_the_slopes_of_the_lean(walk: Simulation) -> None:
    times = walk.track.times_s[20:-20]
    rates = np.array([walk.track.leaning_at(float(t)) for t in times])
    np.testing.assert_allclose(rates, np.gradient(walk.track.attitude, STEP_S, axis=0)[20:-20], atol=1e-9)
    assert np.degrees(np.abs(rates).max()) > 15.0


@pytest.mark.slow
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
