"""The omni camera's two mappings are each other's inverse and follow the table."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from syrupy.assertion import SnapshotAssertion

from touchline.camera import OmniCamera, open_camera
from touchline.camera.base import ground_jacobian
from touchline.errors import InputError


def camera(bearings: int = 1, handedness: int = -1) -> OmniCamera:
    """A mirror of known closed form: range = 0.8 tan(radius / 160), the rows of a tilted one off by up to 5 %."""
    radii = np.arange(10.0, 230.0, 2.0)
    angles = np.arange(bearings) * 2.0 * math.pi / bearings
    ranges = (1.0 + (0.05 if bearings > 1 else 0.0) * np.cos(angles))[:, None] * 0.8 * np.tan(radii / 160.0)
    return OmniCamera(480, 480, (241.3, 238.2), 30.0, 225.0, handedness, 0.3, radii, angles, ranges)


@pytest.mark.parametrize("bearings", [1, 24])
@pytest.mark.parametrize("handedness", [1, -1])
@settings(max_examples=60, deadline=None)
@given(radius=st.floats(10.01, 227.9), angle=st.floats(-math.pi, math.pi))
def test_round_trip_is_within_a_hundredth_of_a_pixel(
    bearings: int, handedness: int, radius: float, angle: float
) -> None:
    cam = camera(bearings, handedness)
    pixel = np.array([[241.3 + radius * math.cos(angle), 238.2 + radius * math.sin(angle)]])
    assert np.abs(cam.image_from_ground(cam.ground_from_image(pixel)) - pixel).max() <= 0.01


def test_ground_point_follows_the_documented_formula() -> None:
    cam = camera()
    pixel = np.array([[241.3 + 90.0, 238.2]])  # along u: atan2 = 0, so the bearing is the mount's yaw
    distance = 0.8 * math.tan(90.0 / 160.0)
    np.testing.assert_allclose(
        cam.ground_from_image(pixel), [[distance * math.cos(0.3), distance * math.sin(0.3)]], rtol=1e-4
    )
    pixel = np.array([[241.3, 238.2 + 90.0]])  # along v: a quarter turn, clockwise for handedness -1
    bearing = 0.3 - math.pi / 2.0
    np.testing.assert_allclose(
        cam.ground_from_image(pixel), [[distance * math.cos(bearing), distance * math.sin(bearing)]], rtol=1e-4
    )


def test_rows_are_met_at_their_bearing() -> None:
    cam = camera(bearings=8)
    eighth = 1.0 + 0.05 * math.cos(math.pi / 4)
    for bearing, factor in ((0.0, 1.05), (math.pi / 4, eighth), (math.pi, 0.95), (math.pi / 8, (1.05 + eighth) / 2)):
        angle = (bearing - 0.3) * -1
        point = cam.ground_from_image([[241.3 + 100 * math.cos(angle), 238.2 + 100 * math.sin(angle)]])[0]
        assert math.hypot(*point) == pytest.approx(factor * 0.8 * math.tan(100 / 160), rel=1e-4)
        assert math.atan2(point[1], point[0]) == pytest.approx(bearing if bearing < 3.1 else math.pi, abs=1e-9)


def test_outside_the_table_there_is_no_ground() -> None:
    cam = camera()
    assert np.isnan(cam.ground_from_image([[241.3, 238.2], [241.3 + 229.0, 238.2]])).all()
    assert np.isnan(cam.image_from_ground([[0.01, 0.0], [1e4, 0.0]])).all()


def test_jacobian_is_the_slope_of_the_table() -> None:
    cam = camera()
    jacobian = ground_jacobian(cam.ground_from_image, [[241.3 + 120.0, 238.2]])[0]
    slope = 0.8 / 160.0 / math.cos(120.0 / 160.0) ** 2
    radial = np.array([math.cos(0.3), math.sin(0.3)])
    np.testing.assert_allclose(jacobian[:, 0], slope * radial, rtol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(jacobian[:, 1]), 0.8 * math.tan(120 / 160) / 120.0, rtol=2e-3)


GOOD = {
    "model": "omni", "width": 10, "height": 10, "center": [5, 5], "inner_radius_px": 1, "outer_radius_px": 4,
    "handedness": 1, "mount_yaw": 0.0, "range_table": {"radius_px": [0, 5], "range_m": [0, 1]},
}  # fmt: skip


WRONG: list[dict[str, object]] = [
    {"model": "spherical"},
    {"center": [5]},
    {"center": None},
    {"handedness": 2},
    {"inner_radius_px": 9},
    {"inner_radius_px": "a"},
    {"width": 10.5},
    {"range_table": {"radius_px": [0, 5]}},
    {"range_table": {"radius_px": [0, 5, 4], "range_m": [0, 1, 2]}},
    {"range_table": {"radius_px": [0, 5], "range_m": [1, float("nan")]}},
    {"range_table": {"radius_px": [0, 5], "range_m": [0, 1, 2]}},
    {"range_table": {"radius_px": [0, 5], "bearing_rad": [0, 1], "range_m": [[0, 1]]}},
    {"range_table": {"radius_px": [0, 5], "bearing_rad": [0, 0], "range_m": [[0, 1], [0, 1]]}},
    *(
        {"range_table": {"radius_px": [0, 5], "bearing_rad": [0.0, 1.0], "range_m": [[0, 1], [0, 1]]}
         | {"bearing_offset_rad": offsets}}
        for offsets in ([[0.0, 0.0]], [[0.0, 0.0], [0.0, 2.0]], [[0.0, 0.0], ["x", 0.0]])
    ),
    {"range_table": {"radius_px": [0, 5], "bearing_offset_rad": [0.0, 0.0], "range_m": [0, 1]}},
]  # fmt: skip


def test_a_bad_camera_file_gets_one_message(tmp_path: Path, snapshot: SnapshotAssertion) -> None:
    path, told = tmp_path / "camera.yaml", []
    without = [{k: v for k, v in GOOD.items() if k != key} for key in GOOD if key != "model"]
    for tree in [*(GOOD | change for change in WRONG), *without]:
        path.write_text(yaml.safe_dump(tree))
        with pytest.raises(InputError) as error:
            open_camera(path)
        told.append(str(error.value).replace(str(tmp_path), ""))
    assert told == snapshot


def test_what_a_camera_file_may_leave_out(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    seen_from: dict[str, object] = {"viewpoint_height_m": 0.5}
    for more in ({}, {"inner_radius_px": 0}, seen_from, seen_from | {"use_attitude": True}):
        path.write_text(yaml.safe_dump(GOOD | more))
        read = open_camera(path)
        assert isinstance(read, OmniCamera)
        assert read.inner_radius_px == more.get("inner_radius_px", 1)
        assert read.viewpoint_height_m == more.get("viewpoint_height_m")
        assert read.use_attitude is more.get("use_attitude", False)


# --- a mirror that turns bearings -------------------------------------------------------------------------------------


def turning_camera(handedness: int = -1) -> OmniCamera:
    """The tilted mirror of `camera`, whose bearings are off by up to 1.5°, the more the nearer to the centre."""
    plain = camera(24, handedness)
    offsets = 0.026 * np.sin(plain.bearings_rad)[:, np.newaxis] * 20.0 / plain.radius_px
    return replace(plain, bearing_offset_rad=offsets)


@pytest.mark.parametrize("handedness", [1, -1])
@settings(max_examples=60, deadline=None)
@given(radius=st.floats(10.5, 227.5), angle=st.floats(-math.pi, math.pi))
def test_round_trip_holds_where_bearings_are_turned(handedness: int, radius: float, angle: float) -> None:
    cam = turning_camera(handedness)
    pixel = np.array([[241.3 + radius * math.cos(angle), 238.2 + radius * math.sin(angle)]])
    assert np.abs(cam.image_from_ground(cam.ground_from_image(pixel)) - pixel).max() <= 0.001


def test_a_turned_bearing_is_the_formulas_and_its_tables_offset() -> None:
    cam, plain = turning_camera(), camera(24)
    angle = -(math.pi / 2.0 - 0.3)  # the formula's bearing is 90°, a row of the table
    pixel = np.array([[241.3 + 40.0 * math.cos(angle), 238.2 + 40.0 * math.sin(angle)]])
    seen, turned = plain.ground_from_image(pixel)[0], cam.ground_from_image(pixel)[0]
    assert math.hypot(*turned) == pytest.approx(math.hypot(*seen), rel=1e-9)
    assert math.atan2(turned[1], turned[0]) == pytest.approx(math.pi / 2.0 + 0.026 * 20.0 / 40.0, abs=1e-6)


def test_offsets_are_read_in_the_order_of_their_bearings(tmp_path: Path) -> None:
    table = {
        "radius_px": [0, 5], "bearing_rad": [3.0, 1.0], "range_m": [[0, 3], [0, 1]],
        "bearing_offset_rad": [[0.03, 0.03], [0.01, 0.01]],
    }  # fmt: skip
    file = tmp_path / "camera.yaml"
    file.write_text(yaml.safe_dump(GOOD | {"range_table": table}))
    offsets = open_camera(file).bearing_offset_rad
    assert offsets is not None
    assert offsets.tolist() == [[0.01, 0.01], [0.03, 0.03]]
