"""`touchline bench`: point sets, localizers of other programs, recordings."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchline.cli import main
from touchline.errors import InputError, TouchlineError
from touchline.evaluation import outside_program
from touchline.evaluation.outside_program import OutsideProgram
from touchline.geometry import Pose
from touchline.localization.registration.registration import Registration
from touchline_lab.points.localizers import ByRprop, point_localizer, point_systems
from touchline_lab.points.point_set import PointSet, read_point_set

FILE = Path(__file__).parents[2] / "tests" / "data" / "points" / "msl_18x12.npz"
EXAMPLES = Path(__file__).parents[2] / "examples" / "bench_points"
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


def test_the_figures_as_a_table(small_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "points", str(small_file)]) == 0
    out = capsys.readouterr().out
    assert "the compass" in out
    assert "Cramér-Rao bound" in out


def test_other_systems_are_asked_the_same(point_set: PointSet) -> None:
    assert point_systems() == ("touchline", "nubot-mti", "nubot-mcl", "nubot-mcl-alone", "iris-fusion")
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


def test_the_example_program_answers_with_its_start(small_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = shlex.join([sys.executable, str(EXAMPLES / "localizer.py")])
    assert main(["bench", "points", str(small_file), "--program", command, "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    with np.load(small_file) as arrays:
        away = np.hypot(*(arrays["init"] - arrays["truth"])[:, :2].T).mean()
    assert tree["init"]["mean_position_m"] == pytest.approx(away)
    assert tree["none"]["success"] == 0.0


def test_the_example_in_another_language_answers_the_same(tmp_path: Path, point_set: PointSet) -> None:
    built, compiler = tmp_path / "localizer", shutil.which("c++")
    if compiler is None:  # it can only be read then
        assert all(f'"{kind}"' in (EXAMPLES / "localizer.cpp").read_text() for kind in ("init", "compass", "none"))
        return
    subprocess.run([compiler, "-O1", "-std=c++17", str(EXAMPLES / "localizer.cpp"), "-o", str(built)], check=True)
    start = Pose(*point_set.init[0])
    with OutsideProgram(str(built), point_set.field) as program:
        assert program.from_pose(point_set.points[0], start) == pytest.approx(start)
        assert program.from_heading(point_set.points[0], 0.5) is None
        assert program.from_nothing(point_set.points[0]) is None


@pytest.mark.parametrize(
    ("program", "told"),
    [
        ("import sys; sys.stdin.readline(); print('1 2', flush=True); sys.stdin.read()", "expected X Y HEADING"),
        ("import sys; sys.stdin.readline(); print('1 2 nan', flush=True); sys.stdin.read()", "expected X Y HEADING"),
        ("import sys; sys.stdin.readline()", "ended|reads no more"),
    ],
)
def test_a_program_that_answers_wrong_is_told(point_set: PointSet, program: str, told: str) -> None:
    with (
        OutsideProgram(shlex.join([sys.executable, "-c", program]), point_set.field) as outside,
        pytest.raises(TouchlineError, match=told),
    ):
        outside.from_nothing(point_set.points[0])


KNOWS = """
import math, sys
poses = {}
for line in open(sys.argv[1]):
    t, x, y, _, _, _, s, c = map(float, line.split())
    poses[round(t, 2)] = x, y, 2.0 * math.atan2(s, c)
head = sys.stdin.readline().split()
for _ in range(int(head[2]) + int(head[3])):
    sys.stdin.readline()
for line in sys.stdin:
    kind, stamp_s, steps, rows = line.split()
    assert kind == "image"
    moved = [sys.stdin.readline().split() for _ in range(int(steps))]
    assert all(len(step) == 4 and float(step[0]) <= float(stamp_s) + 0.1 for step in moved)
    seen = [sys.stdin.readline().split(",")[0] for _ in range(int(rows))]
    kinds = "line L T X post penalty_mark centre_circle none boundary"
    assert seen and set(seen) <= set(kinds.split()), seen
    print("none" if float(stamp_s) < 0.5 else " ".join(map(repr, poses[round(float(stamp_s), 2)])), flush=True)
"""


def test_a_program_follows_a_recording_image_by_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk, knows = Path(__file__).parents[2] / "tests" / "data" / "mujoco" / "percepts", tmp_path / "knows.py"
    knows.write_text(KNOWS)
    command = shlex.join([sys.executable, str(knows), str(walk / "ground_truth.tum")])
    assert main(["bench", str(walk), "--program", command, "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert tree["system"] == command
    (row,) = tree["recordings"]
    assert row["images"] > 20
    assert row["max_position_m"] < 0.02
    assert row["tracked"] == 1.0  # from the first pose on


def test_the_example_stream_answers_with_the_odometry(capsys: pytest.CaptureFixture[str]) -> None:
    walk = Path(__file__).parents[2] / "tests" / "data" / "mujoco" / "percepts"
    assert main(["bench", str(walk), "--program", shlex.join([sys.executable, str(EXAMPLES / "stream.py")])]) == 0
    assert "percepts" in capsys.readouterr().out


def test_a_program_that_never_answers_is_told(point_set: PointSet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outside_program, "MAX_WAIT_S", 0.2)
    silent = shlex.join([sys.executable, "-c", "import sys; sys.stdin.read()"])
    with OutsideProgram(silent, point_set.field) as outside, pytest.raises(TouchlineError, match="wait in a buffer"):
        outside.from_nothing(point_set.points[0])


def test_a_program_takes_no_images(small_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = shlex.join([sys.executable, str(EXAMPLES / "stream.py")])
    assert main(["bench", str(small_data / "omni_msl_track"), "--program", command]) == 1
    assert "observations.csv" in capsys.readouterr().err


def test_a_program_that_is_none_is_told(small_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "points", str(small_file), "--program", "/does/not/exist"]) == 2
    assert "/does/not/exist" in capsys.readouterr().err
    assert main(["bench", "points", str(small_file), "--program", ""]) == 2
    assert "list index" not in capsys.readouterr().err
    assert main(["bench", "points", str(small_file), "--program", "x", "--system", "touchline"]) == 2
    assert main(["bench", "points", str(small_file), "--system", "nubot-mit"]) == 2
    assert "did you mean 'nubot-mti'" in capsys.readouterr().err


def test_a_recording_is_compared_with_its_truth(small_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", str(small_data / "omni_msl_track"), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["recordings"]
    assert row["tracked"] == 1.0
    assert row["mean_position_m"] < 0.02
    assert main(["bench", str(small_data / "omni_msl_track")]) == 0
    assert "omni_msl_track" in capsys.readouterr().out


def test_one_recordings_failure_is_a_row_and_what_is_broken_is_named(
    small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    games = tmp_path / "games"
    for name in ("a", "b", "c"):
        shutil.copytree(small_data / "omni_msl_kidnap", games / name)
    (games / "b" / "camera.yaml").unlink()
    next(iter(sorted((games / "c" / "images").iterdir()))).write_bytes(b"no image")
    with (games / "c" / "odometry.csv").open("a") as file:
        file.write("99.0,x,0,0\n")
    (tmp_path / "list.txt").write_text("games/c\ngames/b\n")
    assert main(["bench", str(games), "--system", "nubot-mti", "--json"]) == 1
    said = capsys.readouterr()
    assert "1 recording failed, the first: b: failed: " in said.err
    rows = json.loads(said.out)["recordings"]
    assert [row["name"] for row in rows] == ["a", "b", "c"]
    assert "camera.yaml: is missing" in rows[1]["failure"]
    assert rows[0]["problems"] == rows[0]["failure"] == rows[2]["failure"] == ""
    assert main(["bench", str(tmp_path / "list.txt"), "--system", "nubot-mti"]) == 1
    first, second = [line for line in capsys.readouterr().out.splitlines() if line[:2] in ("c ", "b ")]
    assert "1 × broken image" in first
    assert "1 × broken row" in first
    assert second.split() == ["b", "failed"]


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
