"""How large things may be: the message names the bound, and nothing asks for memory before."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from touchline.camera import open_camera
from touchline.cli import main
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

BEARINGS = [k / 200 for k in range(999)]
OMNI = {
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
PINHOLE = {"model": "pinhole", "width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
PINHOLE |= {"mount": {"x": 0.0, "y": 0.0, "z": 0.5, "roll": 0.0, "pitch": 0.5, "yaw": 0.0}}


def written(path: Path, tree: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(tree, sort_keys=False, default_flow_style=None))
    return path


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"width": 10**9}, r"line \d+: 'width' is 1e\+09; a side has 20000 pixels at most"),
        (
            {"width": 8000, "height": 8000},
            "the image is 8000×8000 pixels, more than 50 megapixels; TOUCHLINE",
        ),
        ({"height": float("nan")}, r"line \d+: 'height' must be a number, found nan"),
        ({"height": "1e400"}, r"line \d+: 'height' must be a number, found '1e400'"),
        ({"center": [1e30, 0.0]}, r"line \d+: 'center' is 1e\+30; an image has 20000 pixels a side at most"),
        ({"outer_radius_px": 1e12}, r"line \d+: 'outer_radius_px' is 1e\+12; an image has 20000 pixels a side at most"),
        ({"range_table": {"radius_px": [0, 1e12], "range_m": [0, 7]}}, r"line \d+: 'range_table.radius_px' is 1e\+12"),
        (
            {
                "range_table": {
                    "radius_px": [0, 2e4],
                    "bearing_rad": [k / 200 for k in range(999)],
                    "range_m": [[0, 7] for _ in BEARINGS],
                }
            },
            r"'range_table' is too large: with 999 bearings up to 20000 px it would have 1.28e\+03 MB, and 500 MB are",
        ),
        ({"use_atitude": True}, r"line \d+: 'use_atitude' is not a key of an omni camera; did you mean 'use_attitude'"),
        (
            {"range_table": {"radius_px": [0, 9], "range_m": [0, 7], "bearings": [0]}},
            "'range_table.bearings' is not",
        ),
    ],
)
def test_a_mirror_s_file_has_bounds_and_no_unknown_keys(tmp_path: Path, change: dict[str, Any], what: str) -> None:
    path = written(tmp_path / "camera.yaml", {**OMNI, **change})
    with pytest.raises(InputError, match=r"camera\.yaml(:|, line \d+:)") as refused:
        open_camera(path)
    assert re.search(what, str(refused.value)), str(refused.value)


def test_a_perspective_camera_s_file_has_bounds_and_no_unknown_keys(tmp_path: Path) -> None:
    for change, what in (
        (
            {"distorsion": [0.0] * 5},
            r"line \d+: 'distorsion' is not a key of a pinhole camera; did you mean 'dist",
        ),
        ({"mount": {**PINHOLE["mount"], "jaw": 0.0}}, "'mount.jaw' is not a key of 'mount'; did you mean 'yaw'"),  # type: ignore[dict-item]
        (
            {"mount": {**PINHOLE["mount"], "pitch": "steep"}},
            r"line \d+: 'mount: pitch' must be a number, found",
        ),  # type: ignore[dict-item]
        ({"height": 30_000}, r"line \d+: 'height' is 30000; a side has 20000 pixels at most"),
    ):
        with pytest.raises(InputError, match=what):
            open_camera(written(tmp_path / "camera.yaml", {**PINHOLE, **change}))


def test_remarks_may_stand_in_a_camera_s_file(tmp_path: Path) -> None:
    assert open_camera(written(tmp_path / "a.yaml", {**OMNI, "by": "the lab"})).width == 480
    assert open_camera(written(tmp_path / "b.yaml", {**PINHOLE, "lens": "4 mm"})).width == 640


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"length": 1e9}, r"line \d+: length: 1e\+09 m is more than any field has \(200 m at most\)"),
        ({"border": 500}, r"line \d+: border: 500 m is more than any field has \(200 m at most\)"),
        (
            {"segments": [[0, 0, 1, 0], [0, 0, 1e9, 0]]},
            r"line \d+: segments, row 2: 1e\+09 m is too far; a field has 200 m",
        ),
        ({"circles": [[0, 0, 1e9]]}, "circles, row 1: .* a field has 200 m at most"),
        ({"arcs": [[0, -1e9, 1, 0.0, 1e9]]}, r"arcs, row 1: -1e\+09 m is too far"),
        (
            {"segments": [[0, 0, 1, 0.001 * i] for i in range(1001)]},
            "1001 rows are too many; 1000 are the most",
        ),
        ({"length": float("nan")}, r"line \d+: length: expected a number, found nan"),
        ({"width": "9" * 40}, r"line \d+: width: expected a number"),
        ({"length": [1.0] * 50_000}, r"length: expected a number, found \[1.0, 1.0, .*\.\.\.\]"),
    ],
)
def test_a_field_has_bounds(tmp_path: Path, change: dict[str, Any], what: str) -> None:
    field = {"length": 9.0, "width": 6.0, "line_width": 0.05, "border": 1.0, "segments": [[0, 0, 1, 0]]}
    with pytest.raises(InputError, match=what) as refused:
        load_field(written(tmp_path / "field.yaml", {**field, **change}))
    assert len(str(refused.value)) < 400


def test_goals_and_letters_have_bounds(capsys: pytest.CaptureFixture[str]) -> None:
    field = open_field("msl-18x12")
    goal = dataclasses.replace(field.goals[0], y_posts=(1.0, 1e9))
    with pytest.raises(InputError, match="goals, row 1: y_posts is too far; a field has 200 m at most"):
        dataclasses.replace(field, goals=[goal])
    with pytest.raises(InputError, match="200 m at most"):
        field_from_letters("f", {"A": 1e9}, base="msl-18x12")
    assert main(["fields", "new", "f.yaml", "A=1e9"]) == 2
    assert "200 m" in capsys.readouterr().err


def test_a_map_has_500_megabytes_at_most() -> None:
    field = open_field("msl-18x12")
    with pytest.raises(InputError, match=r"0\.002 m is too fine .* MB, and 500 MB are the most"):
        field.distance_map(0.002)
    with pytest.raises(InputError, match="500 MB are the most"):
        field.distance_map(1e-320)


@pytest.mark.parametrize(
    ("system", "change", "bound"),
    [
        ("nubot-mcl", "particles.particles=100000000", "10000000"),
        ("nubot-mcl", "particles.particles_all_headings=100000000", "10000000"),
        ("iris-fusion", "particles.particles=100000000", "10000000"),
        ("iris-fusion", "lines.ray_step_deg=0.000001", "0.036"),
        ("nubot-mti", "line_points.radial_scan_lines=10001", "10000"),
        ("nubot-mti", "line_points.circles=10001", "10000"),
        ("nubot-mti", "learning.frames=100000000", "1000"),
    ],
)
def test_settings_of_numbers_have_bounds(system: str, change: str, bound: str) -> None:
    with pytest.raises(InputError, match=f"should be (less|greater) than or equal to {bound} "):
        load_settings(SYSTEMS[system].settings, None, [change])


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_whole_number_of_a_system_has_an_upper_bound(name: str) -> None:
    def unbounded(model: Any, prefix: str = "") -> list[str]:
        found = []
        for key, info in model.model_fields.items():
            if hasattr(info.annotation, "model_fields"):
                found += unbounded(info.annotation, f"{prefix}{key}.")
            elif info.annotation is int and not any("le=" in repr(part).lower() for part in info.metadata):
                found.append(prefix + key)
        return found

    assert unbounded(SYSTEMS[name].settings) == []


def test_grids_and_scan_lines_have_bounds(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"positions 1e-06 m apart are 3e\+14; 10000000 are the most"):
        sample_positions(18.0, 12.0, 1e-6, 1.0)
    with pytest.raises(InputError, match=r"headings 1e-09 rad apart are too many; 0\.001 is the least"):
        PoseGrid(18.0, 12.0, 0.5, 1.0, 1e-9)
    camera = open_camera(written(tmp_path / "camera.yaml", {**OMNI, "outer_radius_px": 20_000}))
    with pytest.raises(InputError, match=r"10000 radial scan lines and 0 circles .* samples; 10000000 are the most"):
        build_scan_lines(camera, 10_000, 0, 52.0, 20_000.0)  # type: ignore[arg-type]


def test_an_observation_has_ten_million_points_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    many = np.broadcast_to(np.zeros(2), (10_000_001, 2))  # takes no memory
    with pytest.raises(InputError, match="10000001 points: one observation holds 10000000 at most"):
        locate_points(many, open_field("msl-18x12"))
    ones = np.broadcast_to(1.0, (10_000_001,))
    with pytest.raises(InputError, match="one observation holds 10000000 at most"):
        LinePoints(many, np.broadcast_to(np.eye(2), (10_000_001, 2, 2)), ones, many)
    monkeypatch.setattr(points_file, "MAX_OBSERVED_POINTS", 3)
    (tmp_path / "points.csv").write_text("x,y\n" + "1,2\n" * 4)
    with pytest.raises(InputError, match="holds more than 3 points, the most of one observation"):
        read_points(tmp_path / "points.csv")
