"""The renderer against closed forms: projections, paint, occlusion, light, supersampling."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from touchline.camera.pinhole import PinholeCamera
from touchline.errors import InputError
from touchline.field import FieldModel, open_field
from touchline.geometry import Pose
from touchline_lab.simulation.cameras.base import Motion, field_from_body
from touchline_lab.simulation.cameras.mirror import solve_mirror, tangent_range
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.cameras.perspective import SimulatedPerspectiveCamera, humanoid_camera
from touchline_lab.simulation.rendering.casting import CAST_ROWS, cast_rays
from touchline_lab.simulation.rendering.paint import build_paint, paint_at
from touchline_lab.simulation.world.hall import default_world
from touchline_lab.simulation.world.lights import Lights
from touchline_lab.simulation.world.world import PAINTS, GroundMark, RobotActor, World, WorldState

pytestmark = pytest.mark.slow  # rendering

Camera = SimulatedOmniCamera | SimulatedPerspectiveCamera
POSE = Pose(-1.3, 0.8, 0.4)


@pytest.fixture(scope="module")
def field() -> FieldModel:
    return open_field("indoor-9x6")


@pytest.fixture(scope="module")
def omni() -> SimulatedOmniCamera:
    return SimulatedOmniCamera.from_mirror(solve_mirror(tangent_range()))


@pytest.fixture(scope="module")
def pinhole() -> SimulatedPerspectiveCamera:
    return SimulatedPerspectiveCamera(humanoid_camera(roll=0.02, yaw=-0.03))


def plain_world(field: FieldModel, **changes: object) -> World:
    """Even light, clean carpet, nothing beside the field."""
    bare = dataclasses.replace(field, goals=(), poles=())
    world = default_world(bare, lights=Lights(ambient=1.0), clutter=False)
    return dataclasses.replace(world, carpet_contrast=0.0, **changes)  # type: ignore[arg-type]


def green(camera: Camera, world: World, state: WorldState | None = None, **options: object) -> npt.NDArray[np.float64]:
    """Green radiance (H, W)."""
    image = camera.radiance(world, state or WorldState(), POSE, **options)  # type: ignore[arg-type]
    return image[..., 1].astype(np.float64)


def test_the_perspective_cameras_rays_are_the_inverse_of_its_projection(pinhole: SimulatedPerspectiveCamera) -> None:
    attitude = (0.05, -0.04)
    rows, columns = np.mgrid[150:470:20, 10:745:20]
    rays = pinhole._grid.rays[rows.ravel(), columns.ravel()].astype(np.float64)
    rotation = field_from_body(Pose(0.0, 0.0, 0.0), attitude)[:9].reshape(3, 3)
    origin, direction = rays[:, :3] @ rotation.T, rays[:, 3:] @ rotation.T
    falling = direction[:, 2] < -0.02
    ground = (origin - direction * (origin[:, 2] / direction[:, 2])[:, np.newaxis])[falling, :2]
    pixels = pinhole.project(ground, attitude)
    assert np.max(np.abs(pixels - np.column_stack((columns.ravel(), rows.ravel()))[falling])) < 2e-3


def test_a_table_camera_keeps_to_its_table_and_continues_beyond_the_horizon(omni: SimulatedOmniCamera) -> None:
    camera = SimulatedOmniCamera(omni.design, height_m=0.8)
    rays = camera._grid.rays[239, 240:].astype(np.float64)
    radius = np.hypot(0.5, np.arange(len(rays)) + 0.5)
    slope = -rays[:, 5] / np.hypot(rays[:, 3], rays[:, 4])
    expected = 0.8 / (1.57 * np.tan(0.0071 * radius))  # negative beyond the horizon at 221.2 px
    seen = (radius > 5.0) & (radius < 231.0)
    assert np.max(np.abs(slope - expected)[seen]) < 2e-3


def test_paint_is_found_as_by_plain_geometry(field: FieldModel) -> None:
    marks = (GroundMark(1.0, 0.5, 0.3, 0.4, 0.2, PAINTS["black"]),)
    msl = open_field("msl-18x12")
    for model in (field, msl):
        grid = build_paint(model, marks, (24.0, 18.0, 5.0))
        rng = np.random.default_rng(5)
        points = rng.uniform((-10.0, -7.0), (10.0, 7.0), (4000, 2))
        near_arcs = rng.uniform((8.0, 5.0), (9.0, 6.0), (2000, 2))
        for x, y in np.concatenate((points, near_arcs)):
            found = paint_at(grid, float(x), float(y))
            assert found == plain_paint(model, marks, float(x), float(y))


def plain_paint(field: FieldModel, marks: tuple[GroundMark, ...], x: float, y: float) -> int:
    """The NumPy twin of `paint_at`: every shape of the field, one after the other."""
    for number in range(len(marks), 0, -1):
        mark = marks[number - 1]
        dx, dy = x - mark.x, y - mark.y
        c, s = math.cos(mark.heading), math.sin(mark.heading)
        if abs(dx * c + dy * s) <= 0.5 * mark.length and abs(dy * c - dx * s) <= 0.5 * mark.width:
            return number
    half = 0.5 * field.line_width
    start, end = field.segments[:, :2], field.segments[:, 2:]
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    offset = np.array([x, y]) - 0.5 * (start + end)
    length = 0.5 * np.linalg.norm(end - start, axis=1) + half
    on = np.abs(np.sum(offset * along, axis=1)) <= length
    on &= np.abs(offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]) <= half
    rings = np.abs(np.hypot(x - field.circles[:, 0], y - field.circles[:, 1]) - field.circles[:, 2]) <= half
    discs = np.hypot(x - field.discs[:, 0], y - field.discs[:, 1]) <= 0.5 * field.discs[:, 2]
    cx, cy, radius, first, last = field.arcs.T
    arc_rows = np.abs(np.hypot(x - cx, y - cy) - radius) <= half
    turn = np.mod(np.arctan2(y - cy, x - cx) - first + half / radius, 2.0 * np.pi)
    arc_rows &= turn <= np.mod(last - first, 2.0 * np.pi) + 2.0 * half / radius
    return 0 if on.any() or rings.any() or discs.any() or arc_rows.any() else -1


def test_cast_rays_are_turned_as_by_matrices() -> None:
    rays = np.random.default_rng(2).normal(size=(6, 500)).astype(np.float32)
    pose = field_from_body(Pose(1.0, -2.0, 0.7), (0.1, -0.2))
    cast = np.empty((CAST_ROWS, 300), dtype=np.float32)
    cast_rays(rays, 200, 300, pose.astype(np.float32), cast)
    rotation, rays = pose[:9].reshape(3, 3), rays[:, 200:].astype(np.float64)
    origin, direction = (rotation @ rays[:3]).T + pose[9:], (rotation @ rays[3:]).T
    level = np.hypot(direction[:, 0], direction[:, 1])
    assert np.allclose(cast[:3].T, origin, atol=1e-5)
    assert np.allclose(cast[3:6].T, direction / level[:, np.newaxis], rtol=2e-5, atol=1e-5)
    falling = direction[:, 2] < -0.05
    assert np.allclose(cast[6, falling], (-origin[:, 2] * level / direction[:, 2])[falling], rtol=1e-4, atol=1e-4)


def test_motion_blurs_along_the_way_and_a_rolling_shutter_skews(field: FieldModel) -> None:
    world = plain_world(field, marks=(GroundMark(*POSE.compose(Pose(2.5, 0.0, 0.0)), 3.0, 0.1, PAINTS["black"]),))
    still = green(SimulatedPerspectiveCamera(), world)
    sideways = Motion(0.0, 2.0, 0.0)
    blurred = green(SimulatedPerspectiveCamera(), world, motion=sideways, exposure_ms=30.0)
    skewed = green(SimulatedPerspectiveCamera(blur_steps=1, readout_s=0.03), world, motion=sideways)

    def middles(image: npt.NDArray[np.float64], row: int) -> tuple[float, float]:
        weight = np.clip(1.0 - image[row, 250:500] / np.median(image[row, 250:500]), 0.05, None) - 0.05
        columns = np.arange(250, 500)
        middle = float(np.sum(weight * columns) / np.sum(weight))
        return middle, float(np.sqrt(np.sum(weight * (columns - middle) ** 2) / np.sum(weight)))

    assert middles(blurred, 300)[0] == pytest.approx(middles(still, 300)[0], abs=1.0), "the middle of the exposure"
    assert middles(blurred, 300)[1] > 1.1 * middles(still, 300)[1]
    early, late = (middles(skewed, row)[0] - middles(still, row)[0] for row in (150, 400))
    assert early < -1.0 < 1.0 < late, "the robot goes left: early rows see the mark further left"


def test_mistakes_are_refused_in_words(field: FieldModel, omni: SimulatedOmniCamera) -> None:
    world = plain_world(field)
    with pytest.raises(InputError, match="the robot at 50, 0 is outside the hall"):
        omni.render(world, WorldState(), Pose(50.0, 0.0, 0.0))
    with pytest.raises(InputError, match="exposure and gain are positive"):
        omni.render(world, WorldState(), POSE, exposure_ms=-1.0)
    with pytest.raises(InputError, match="robot 0 at 20, 0 is outside the hall"):
        plain_world(field, robots=(RobotActor(20.0, 0.0, 0.0),))
    with pytest.raises(InputError, match="1 robots and 0 balls, but the world has 0 and 0"):
        omni.render(world, WorldState(robots=((0.0, 0.0, 0.0),)), POSE)
    with pytest.raises(InputError, match="does not hold the carpet"):
        dataclasses.replace(world, hall=(5.0, 5.0, 3.0))
    with pytest.raises(InputError, match="'mount' is missing"):
        PinholeCamera.from_mapping(dict.fromkeys(("width", "height", "fx", "fy", "cx", "cy"), 100), Path("camera"))
