"""`touchline bench`: point sets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchline.cli import main
from touchline.errors import InputError
from touchline.geometry import Pose
from touchline.localization.registration.registration import Registration
from touchline_lab.points.localizers import ByRprop, point_localizer, point_systems
from touchline_lab.points.point_set import PointSet, read_point_set

FILE = Path(__file__).parents[2] / "tests" / "data" / "points" / "msl_18x12.npz"
KEYS = {"mean_position_m", "mean_heading_rad", "times_bound", "success", "us_per_update"}


@pytest.fixture(scope="module")
def point_set() -> PointSet:
    return read_point_set(FILE)


@pytest.fixture
def small_file(tmp_path: Path) -> Path:
    """The first frames of the point set."""
    return written(tmp_path / "small.npz")


def written(path: Path, frames: int = 6, **changed: Any) -> Path:
    with np.load(FILE) as arrays:
        kept = {name: arrays[name] for name in arrays.files}
    count = int(kept["offsets"][frames])
    for name in ("points", "is_outlier"):
        kept[name] = kept[name][:count]
    for name in ("truth", "init", "compass"):
        kept[name] = kept[name][:frames]
    kept["offsets"] = kept["offsets"][: frames + 1]
    kept.update(changed)
    np.savez(path, **{name: value for name, value in kept.items() if value is not None})
    return path


def test_the_figures_as_json(small_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "points", str(small_file), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert set(tree) == {"name", "file", "init", "compass", "none", "bound"}
    assert all(set(tree[way]) == KEYS for way in ("init", "compass", "none"))
    assert tree["none"]["success"] == 1.0
    assert tree["init"]["mean_position_m"] < 0.03


def test_other_systems_are_asked_the_same(point_set: PointSet) -> None:
    assert {*point_systems()} == {"touchline", "nubot-mti", "nubot-mcl", "nubot-mcl-alone", "iris-fusion"}
    points, truth, start = point_set.points[0], Pose(*point_set.truth[0]), Pose(*point_set.init[0])
    rprop = ByRprop(point_set.field)
    stepped = point_localizer("nubot-mcl", point_set.field)
    near, facing = rprop.from_pose(points, start), rprop.from_heading(points, truth.heading)
    for found in (near, facing, stepped.from_pose(points, start)):
        assert found is not None
        assert found.distance_to(truth) < 0.1


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"truth": None}, "it has no 'truth'"),
        ({"truth": np.zeros((2, 3))}, "'truth' has 2 rows for 6 frames"),
        ({"truth": np.full((6, 3), np.nan)}, "finite numbers"),
        ({"offsets": np.array([0, 5])}, "'offsets' does not cut"),
        ({"noise": np.zeros(3)}, "'noise'"),
        ({"segments": np.zeros((0, 4))}, "no rows"),
        ({"points": np.zeros((4, 3))}, "expected (any, 2)"),
        ({"is_outlier": np.zeros(3, np.bool_)}, "'is_outlier' has 3 rows"),
    ],
)
def test_what_is_no_point_set_is_told(tmp_path: Path, changed: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError) as error:
        read_point_set(written(tmp_path / "wrong.npz", **changed))
    assert told in str(error.value)


def test_a_file_of_another_kind_is_told(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(InputError, match="is no point set"):
        read_point_set(tmp_path / "text.npz")


def test_a_point_set_may_name_its_noise(tmp_path: Path) -> None:
    exact = read_point_set(written(tmp_path / "exact.npz", noise=np.array([0.0, 0.001, 0.001])))
    usual = read_point_set(written(tmp_path / "usual.npz"))
    assert exact.bound()[0] < 0.2 * usual.bound()[0]


def test_an_unknown_system_is_named_with_the_nearest(small_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "points", str(small_file), "--system", "nubot-mit"]) == 2
    assert "did you mean 'nubot-mti'" in capsys.readouterr().err


def test_a_descent_that_ends_beside_the_pose_is_noticed_and_the_pose_found(point_set: PointSet) -> None:
    """One metre and 45° off most descents end beside the pose, where less than a half of the points is explained."""
    own = point_localizer("touchline", point_set.field)
    found, descended = 0, 0
    for points, truth in zip(point_set.points[:20], point_set.truth, strict=False):
        start = Pose(truth[0] + 0.6, truth[1] - 0.8, truth[2] + np.pi / 4.0)
        pose = own.from_pose(points, start)
        assert pose is not None
        found += pose.distance_to(Pose(*truth)) < 0.2
        alone = Registration(point_set.field.distance_map()).register(
            points.positions_m, points.covariances_m2, np.array(start)
        )
        descended += bool(np.hypot(*(alone.pose[:2] - truth[:2])) < 0.2)
    assert descended < 15
    assert found == 20
