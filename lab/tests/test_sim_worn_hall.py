"""What real halls have: worn lines, cables, a narrow carpet, people beside the robot, a lens that scatters light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from touchline.geometry import FloatArray
from touchline_lab.simulation.cameras.image_sensor import ImageSensor
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

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


def test_fully_scuffed_lines_are_gone() -> None:
    red, green = seen_at(standing("hall.scuffed=1"), halfway_line())[:, :2].mean(axis=0)
    assert green > 2.5 * red


def test_the_carpet_may_end_right_behind_the_lines_on_a_dark_floor() -> None:
    simulation = standing("hall.carpet_border_m=0.2", "hall.dark_floor=true")
    edge = 0.5 * simulation.field.width
    inside, beyond = seen_at(simulation, np.array([[-2.0, edge + 0.1], [-2.0, edge + 0.6]]))
    assert inside[1] > 2.0 * inside[0], "green"
    assert beyond.max() < 0.3 * inside[1]
    assert np.ptp(beyond) < 0.3 * beyond.max(), "grey"
    assert seen_at(standing(), np.array([[-2.0, edge + 0.6]]))[0, 1] > 0.5 * inside[1], "elsewhere it goes on"


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


def test_people_keep_beside_the_robot_and_hide_lines_at_both_levels() -> None:
    simulation = Simulation(open_scenario("match", seconds=20.0, changes=["ideal=true", "others.people=2"]))
    alone = Simulation(open_scenario("match", seconds=20.0, changes=["ideal=true"]))
    own = simulation.track.poses[::5, :2]
    gaps = np.hypot(*(simulation.others.people[:, :, :2] - own[:, np.newaxis]).transpose(2, 0, 1))
    assert gaps.min() > 0.5
    assert 0.6 < np.median(gaps) < 2.0
    np.testing.assert_array_equal(simulation.others.robots, alone.others.robots)
    assert simulation.world.robots[-1].shape == "person"
    many, all_of_them = (sum(len(run.points(k)) for k in range(0, len(run), 10)) for run in (simulation, alone))
    assert 0.5 * all_of_them < many < 0.97 * all_of_them
    image, other = simulation.image(100), alone.image(100)
    assert 0.01 < np.mean(np.abs(image.astype(int) - other).max(axis=2) > 30) < 0.4


def test_vignetting_darkens_the_corners_alone() -> None:
    even = np.full((240, 320, 3), 0.1, dtype=np.float32)
    plain = ImageSensor(optics_blur_sigma_px=0.0).develop(even, 12.0, 1.7, None)
    dark = ImageSensor(optics_blur_sigma_px=0.0, vignetting=0.5).develop(even, 12.0, 1.7, None)
    assert np.abs(plain[120, 160].astype(int) - dark[120, 160]).max() <= 1
    assert (dark[1, 1] / plain[1, 1]) ** 2.2 == pytest.approx(np.full(3, 0.5), abs=0.03)


def test_bloom_scatters_light_around_what_is_bright_and_keeps_its_sum() -> None:
    spot = np.full((240, 320, 3), 0.01, dtype=np.float32)
    spot[110:130, 150:170] = 2.0
    plain, glowing = (ImageSensor(bloom=part).develop(spot, 12.0, 1.7, None).astype(int) for part in (0.0, 0.1))
    assert np.all(glowing[120, 176] > plain[120, 176] + 20)
    assert np.all(glowing[10, 10] - plain[10, 10] < glowing[120, 176] - plain[120, 176])
    even = np.full((240, 320, 3), 0.1, dtype=np.float32)
    without, scattered = (ImageSensor(bloom=part).develop(even, 12.0, 1.7, None) for part in (0.0, 0.1))
    assert np.array_equal(without, scattered)


def test_a_glossy_carpet_is_paler_far_off_and_coloured_lamps_tint_everything() -> None:
    places = np.array([[-1.0, 1.0], [5.0, 1.0]])
    matt, glossy = (seen_at(standing(f"hall.gloss={gloss}"), places) for gloss in (0.0, 0.4))
    shares = [seen[:, 1] / seen.sum(axis=1) for seen in (matt, glossy)]  # of green
    assert shares[1][1] < shares[1][0] < shares[0].min()
    white = seen_at(standing("light.ambient=0"), places)
    warm = seen_at(standing("light.ambient=0", "light.tints=[[1.2, 1, 0.5]]"), places)
    np.testing.assert_allclose(warm, white * [1.2, 1.0, 0.5], rtol=0.12)  # but for what is fixed to the robot
