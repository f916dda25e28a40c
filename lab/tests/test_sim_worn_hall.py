"""What real halls have: worn lines, cables, a narrow carpet, people beside the robot, a lens that scatters light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from touchline.geometry import FloatArray
from touchline_lab.simulation.cameras.image_sensor import ImageSensor
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

pytestmark = pytest.mark.slow  # rendering

PLAIN = ("others.robots=0", "others.balls=0", "clutter=false", "motion.kind=stand", "disturbances.shove_every_s=0")


def standing(*changes: str) -> Simulation:
    """A robot that stands 2 m before the middle of the field, alone in its hall."""
    given = ["others.moving=false", "others.near_m=0", "motion.pose=[-2, 1.5, 0]", *PLAIN, *changes]
    fresh = [f"motion.{key}" for key in ("speed_m_s=1.2", "acceleration_m_s2=2", "turn_rad_s=2", "margin_m=0.8")]
    return Simulation(open_scenario("match", seconds=1.0, changes=["ideal=true", *fresh, *given]))


def radiance(simulation: Simulation) -> npt.NDArray[np.float32]:
    view = simulation.world, simulation.state(0.1), simulation.truth[0]
    return simulation.camera_model.radiance(*view).copy()


def seen_at(simulation: Simulation, field_points: FloatArray) -> npt.NDArray[np.float32]:
    """(N, 3) radiance at points (N, 2) of the field."""
    pixels = simulation.camera_model.project(simulation.truth[0].inverse().transform(field_points))
    columns, rows = np.rint(pixels).astype(int).T
    return np.asarray(radiance(simulation)[rows, columns])


def halfway_line() -> FloatArray:
    return np.column_stack((np.zeros(200), np.linspace(-2.0, 4.0, 200)))


def test_scuffed_lines_show_the_carpet_in_patches_and_dirt_darkens_them() -> None:
    clean = seen_at(standing(), halfway_line())
    scuffed = seen_at(standing("hall.scuffed=0.4"), halfway_line())
    dirty = seen_at(standing("hall.dirt=0.5"), halfway_line())
    bare = scuffed[:, 0] < 0.5 * clean[:, 0]  # red: the carpet has a tenth of the paint's
    assert 0.05 < bare.mean() < 0.6
    assert np.allclose(scuffed[~bare].mean(axis=0), clean[~bare].mean(axis=0), rtol=0.25)
    assert 0.6 < dirty.mean() / clean.mean() < 0.95


def test_cables_lie_on_the_carpet_from_its_edge_inwards_and_come_from_the_seed() -> None:
    simulation = standing("hall.cables=5")
    marks = simulation.world.marks
    assert len(marks) > 5 * 10
    assert marks == standing("hall.cables=5").world.marks
    half = 0.5 * np.array(simulation.world.carpet)
    first = np.array([marks[0].x, marks[0].y])
    assert np.abs(np.abs(first) - half).min() < 0.2
    changed = np.abs(radiance(simulation) - radiance(standing())).max(axis=2) > 0.01
    assert changed.sum() > 20


def test_bloom_scatters_light_around_what_is_bright_and_keeps_its_sum() -> None:
    spot = np.full((240, 320, 3), 0.01, dtype=np.float32)
    spot[110:130, 150:170] = 2.0
    plain, glowing = (ImageSensor(bloom=part).develop(spot, 12.0, 1.7, None).astype(int) for part in (0.0, 0.1))
    assert np.all(glowing[120, 176] > plain[120, 176] + 20)
    assert np.all(glowing[10, 10] - plain[10, 10] < glowing[120, 176] - plain[120, 176])
    even = np.full((240, 320, 3), 0.1, dtype=np.float32)
    without, scattered = (ImageSensor(bloom=part).develop(even, 12.0, 1.7, None) for part in (0.0, 0.1))
    assert np.array_equal(without, scattered)
