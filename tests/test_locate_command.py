"""`touchline locate`: what it prints, what it refuses, what it draws."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from line_scenes import view
from syrupy.assertion import SnapshotAssertion

from touchline.cli import main
from touchline.field import open_field
from touchline.geometry import Pose

TRUTH = Pose(3.2, -1.4, 0.5)
BROKEN = {
    "empty.csv": "",
    "none.csv": "x_m,y_m\n",
    "header.csv": "1.0,2.0\n3,4\n",
    "word.csv": "x_m,y_m\n1,2\n3,abc\n",
    "short.csv": "x_m,y_m\n1,2\n\n3\n",
    "nan.csv": "x_m,y_m\n1,nan\n",
    "negative.csv": "x_m,y_m,weight\n1,2,1\n1,2,-1\n",
    "few.csv": "x,y\n" + "1,2\n3,4\n5,6\n7,8\n9,1\n1,9\n2,9\n" * 2,
    "photo.png": "none",
}
ARGUMENTS = [
    *(name for name in BROKEN if name != "few.csv"),
    "missing.csv",
    "binary.csv",
    ".",
    "photo.png --camera none.yaml",
    "word.csv --field msl-18x13",
    "word.csv --output drawn.gif",
    "word.csv --heading north",
    "points.csv --heading 180",
    "points.csv --heading nan",
    "points.csv --heading=-inf",
    "points.csv --field points.csv",
    "points.csv --output there.png",
    "few.csv",
    "points.csv --heading 1.8",
]


@pytest.fixture(autouse=True)
def _workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With points seen from a place."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    for name, text in BROKEN.items():
        Path(name).write_text(text)
    Path("binary.csv").write_bytes(b"\xff\xfe\x00\x81")
    Path("there.png").touch()
    write("points.csv", view(open_field("msl-18x12"), TRUTH, np.random.default_rng(0)))


def write(name: str, points: np.ndarray) -> None:
    np.savetxt(name, points, delimiter=",", header="x_m,y_m", comments="")


def test_what_is_refused(capsys: pytest.CaptureFixture[str], snapshot: SnapshotAssertion) -> None:
    said = {}
    for arguments in ARGUMENTS:
        status = main(["locate", *arguments.split()])
        captured = capsys.readouterr()
        assert captured.out == ""
        said[arguments] = f"{status}: {captured.err.partition(': the best one')[0]}".rstrip()
    assert said == snapshot


def test_json_holds_everything(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["locate", "points.csv", "--json", "--heading", "-2.5"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert [tree["pose"][key] for key in ("x_m", "y_m", "heading_rad")] == pytest.approx(TRUTH.mirrored(), abs=0.05)
    assert np.array(tree["covariance"]).shape == (3, 3)
    assert (tree["points"], tree["field"], tree["field_assumed"]) == (100, "msl-18x12", True)
    assert tree["hypotheses"] == []
    assert 0 < tree["median_distance_m"] <= tree["mean_distance_m"] < 0.1
    assert tree["deviations_better_than_chance"] > 3


def test_the_points_are_drawn_on_the_field(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["locate", "points.csv", "--heading", "0.5", "--output", "drawn.png"]) == 0
    assert "drawn into drawn.png" in capsys.readouterr().out
    picture = cv2.imread("drawn.png")
    assert picture is not None
    blue = np.all(np.abs(picture.astype(int) - (255, 120, 0)) < 30, axis=2)
    red = np.all(np.abs(picture.astype(int) - (0, 0, 220)) < 30, axis=2)
    assert blue.sum() > 1000
    rows, columns = np.nonzero(red)
    assert columns.mean() > picture.shape[1] / 2  # x > 0 is on the right
    assert rows.mean() > picture.shape[0] / 2  # y < 0 is below


def test_a_photograph_is_located_and_its_overlay_saved(small_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The documented distances: 2.35 m to the halfway line and 2.56 m to the nearer touch line, good to 15 cm."""
    photograph = small_data / "real" / "omni" / "nubot_a.png"
    camera = small_data / "real" / "omni" / "nubot_a.camera.yaml"
    assert main(["locate", str(photograph), "--camera", str(camera), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert abs(tree["pose"]["x_m"]) == pytest.approx(2.35, abs=0.15)
    assert 5.9375 - abs(tree["pose"]["y_m"]) == pytest.approx(2.56, abs=0.15)
    assert tree["picture"] == str(Path("runs") / "nubot_a-locate-1" / "overlay.png")
    assert cv2.imread(tree["picture"]).shape[1] > 900  # type: ignore[union-attr]


def test_an_image_without_lines_is_refused_and_its_overlay_saved(small_data: Path) -> None:
    noise = np.random.default_rng(0).normal(0, 2, (480, 480, 3))
    cv2.imwrite("green.png", np.clip(np.array([75, 140, 80]) + noise, 0, 255).astype(np.uint8))
    camera = small_data / "omni_msl_track" / "camera.yaml"
    assert main(["locate", "green.png", "--camera", str(camera), "--output", "seen.png"]) == 1
    assert Path("seen.png").is_file()


def test_a_wrong_field_is_doubted_and_the_right_one_named(small_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured = small_data / "real" / "nubot_robot1.csv"
    assert main(["locate", str(measured), "--field", str(small_data / "fields" / "nubot-lab-18x8.yaml"), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert len(tree["doubts"]) == 3  # other places, points far from lines, and beyond the carpet
    assert tree["better"][0]["field"] == "msl-18x12"
    assert np.sqrt(tree["covariance"][0][0]) > 0.3


def test_wrong_ranges_are_refused_with_the_scale_that_fits(
    small_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = np.loadtxt(small_data / "real" / "nubot_robot1.csv", delimiter=",", skiprows=1)[::6]
    write("long.csv", 1.15 * measured)
    arguments = ["locate", "long.csv", "--field", "msl-18x12"]
    assert main(arguments) == 1
    assert "With all ranges times 0.869" in capsys.readouterr().err
    assert main([*arguments, "--fit-scale", "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert tree["scale"]["factor"] == pytest.approx(1.0 / 1.15, abs=3.0 * tree["scale"]["deviation"])
    assert tree["scale"]["deviation"] < 0.01
    assert tree["doubts"] == tree["better"] == []
