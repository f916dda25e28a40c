"""How large things may be: the message names the bound, and nothing asks for memory before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from syrupy.assertion import SnapshotAssertion

from touchline.camera import open_camera
from touchline.config import load_settings
from touchline.errors import InputError
from touchline.field import field_from_letters, load_field, open_field
from touchline.localization.one_shot import points_file
from touchline.localization.one_shot.locate import locate_points
from touchline.localization.one_shot.points_file import read_points
from touchline.localization.search.pose_grid import PoseGrid, sample_positions
from touchline.perception.scan_lines import build_scan_lines
from touchline.systems import SYSTEMS
from touchline.types import LinePoints

OMNI: dict[str, Any] = {
    "model": "omni",
    "width": 480,
    "height": 480,
    "center": [239.5, 239.5],
    "inner_radius_px": 52,
    "outer_radius_px": 220,
    "handedness": -1,
    "mount_yaw": -1.5708,
    "range_table": {"radius_px": [52, 110, 190], "range_m": [0.61, 1.55, 7.0]},
}
MOUNT = {"x": 0.0, "y": 0.0, "z": 0.5, "roll": 0.0, "pitch": 0.5, "yaw": 0.0}
PINHOLE = {"model": "pinhole", "width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
PINHOLE |= {"mount": MOUNT}
FIELD = {"length": 9.0, "width": 6.0, "line_width": 0.05, "border": 1.0, "segments": [[0, 0, 1, 0]]}
BEARINGS = [k / 200 for k in range(999)]
LARGE = {"radius_px": [0, 2e4], "bearing_rad": BEARINGS, "range_m": [[0, 7] for _ in BEARINGS]}
WRONG: dict[str, tuple[Any, dict[str, Any], tuple[dict[str, Any], ...]]] = {
    "omni": (
        open_camera,
        OMNI,
        (
            {"width": 10**9},
            {"width": 8000, "height": 8000},
            {"height": float("nan")},
            {"height": "1e400"},
            {"center": [1e30, 0.0]},
            {"outer_radius_px": 1e12},
            {"range_table": {"radius_px": [0, 1e12], "range_m": [0, 7]}},
            {"range_table": LARGE},
            {"use_atitude": True},
            {"range_table": {"radius_px": [0, 9], "range_m": [0, 7], "bearings": [0]}},
        ),
    ),
    "pinhole": (
        open_camera,
        PINHOLE,
        (
            {"distorsion": [0.0] * 5},
            {"mount": {**MOUNT, "jaw": 0.0}},
            {"mount": {**MOUNT, "pitch": "steep"}},
            {"height": 30_000},
        ),
    ),
    "field": (
        load_field,
        FIELD,
        (
            {"length": 1e9},
            {"border": 500},
            {"segments": [[0, 0, 1, 0], [0, 0, 1e9, 0]]},
            {"circles": [[0, 0, 1e9]]},
            {"arcs": [[0, -1e9, 1, 0.0, 1e9]]},
            {"segments": [[0, 0, 1, 0.001 * i] for i in range(1001)]},
            {"length": float("nan")},
            {"width": "9" * 40},
            {"length": [1.0] * 50_000},
        ),
    ),
}


def written(path: Path, tree: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(tree, sort_keys=False, default_flow_style=None))
    return path


@pytest.mark.parametrize("kind", WRONG)
def test_files_have_bounds_and_no_unknown_keys(tmp_path: Path, kind: str, snapshot: SnapshotAssertion) -> None:
    read, right, changes = WRONG[kind]
    said = []
    for change in changes:
        with pytest.raises(InputError) as refused:
            read(written(tmp_path / "file.yaml", {**right, **change}))
        said.append(str(refused.value).replace(f"{tmp_path}/", ""))
    assert "\n".join(said) == snapshot


def test_letters_and_maps_have_bounds() -> None:
    with pytest.raises(InputError, match="200 m at most"):
        field_from_letters("f", {"A": 1e9}, base="msl-18x12")
    for fine_m in (0.002, 1e-320):
        with pytest.raises(InputError, match="500 MB are the most"):
            open_field("msl-18x12").distance_map(fine_m)


@pytest.mark.parametrize(
    ("system", "change", "bound"),
    [
        ("nubot-mcl", "particles.particles=100000000", "10000000"),
        ("nubot-mcl", "particles.particles_all_headings=100000000", "10000000"),
        ("iris-fusion", "particles.particles=100000000", "10000000"),
        ("iris-fusion", "lines.ray_step_deg=0.000001", "0.036"),
        ("nubot-mti", "line_points.circles=10001", "10000"),
        ("nubot-mti", "learning.frames=100000000", "1000"),
    ],
)
def test_settings_of_numbers_have_bounds(system: str, change: str, bound: str) -> None:
    with pytest.raises(InputError, match=f"should be (less|greater) than or equal to {bound} "):
        load_settings(SYSTEMS[system].settings, None, [change])


def test_grids_and_scan_lines_have_bounds(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="10000000 are the most"):
        sample_positions(18.0, 12.0, 1e-6, 1.0)
    with pytest.raises(InputError, match=r"0\.001 is the least"):
        PoseGrid(18.0, 12.0, 0.5, 1.0, 1e-9)
    camera = open_camera(written(tmp_path / "camera.yaml", {**OMNI, "outer_radius_px": 20_000}))
    with pytest.raises(InputError, match="10000000 are the most"):
        build_scan_lines(camera, 10_000, 0, 52.0, 20_000.0)  # type: ignore[arg-type]


def test_an_observation_has_ten_million_points_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    many = np.broadcast_to(np.zeros(2), (10_000_001, 2))  # takes no memory
    with pytest.raises(InputError, match="one observation holds 10000000 at most"):
        locate_points(many, open_field("msl-18x12"))
    ones = np.broadcast_to(1.0, (10_000_001,))
    with pytest.raises(InputError, match="one observation holds 10000000 at most"):
        LinePoints(many, np.broadcast_to(np.eye(2), (10_000_001, 2, 2)), ones, many)
    monkeypatch.setattr(points_file, "MAX_OBSERVED_POINTS", 3)
    (tmp_path / "points.csv").write_text("x,y\n" + "1,2\n" * 4)
    with pytest.raises(InputError, match="holds more than 3 points, the most of one observation"):
        read_points(tmp_path / "points.csv")
