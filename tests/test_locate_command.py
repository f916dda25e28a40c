"""`touchline locate`: what it prints, what it refuses, what it draws."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from line_scenes import view
from model_scans import FIELDS

from touchline.cli import main
from touchline.field import open_field
from touchline.geometry import Pose

TRUTH = Pose(3.2, -1.4, 0.5)


@pytest.fixture(autouse=True)
def _workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def points(tmp_path: Path) -> Path:
    path = tmp_path / "points.csv"
    seen = view(open_field("msl-18x12"), TRUTH, np.random.default_rng(0))
    np.savetxt(path, seen, delimiter=",", header="x_m,y_m", comments="")
    return path


def test_the_table_shows_the_pose_its_residual_and_the_twin(points: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["locate", str(points)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "100 different points" in lines[0]
    assert "from the nearest line on average" in lines[0]
    assert lines[1].startswith("the field msl-18x12 is assumed")
    rows = {line.split("  ")[0]: line.split() for line in lines[3:]}
    places = [tuple(map(float, rows[name][-5:-2])) for name in ("pose", "hypothesis 1")]
    for expected in (TRUTH, TRUTH.mirrored()):
        assert any(np.allclose(place, expected, atol=0.05) for place in places)
    assert float(rows["pose"][-1]) < 10.0  # cm


def test_a_heading_leaves_one_pose(points: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["locate", str(points), "--heading", "0.6", "--field", "msl-18x12"]) == 0
    out = capsys.readouterr().out
    assert "hypothesis" not in out
    assert "assumed" not in out
    assert "no other pose explains the points as well" in out


def test_json_holds_everything(points: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["locate", str(points), "--json", "--heading", "-2.5"]) == 0
    tree = json.loads(capsys.readouterr().out)
    twin = TRUTH.mirrored()
    assert [tree["pose"][key] for key in ("x_m", "y_m", "heading_rad")] == pytest.approx(twin, abs=0.05)
    assert np.array(tree["covariance"]).shape == (3, 3)
    assert tree["points"] == 100
    assert (tree["field"], tree["field_assumed"]) == ("msl-18x12", True)
    assert tree["hypotheses"] == []
    assert 0 < tree["median_distance_m"] <= tree["mean_distance_m"] < 0.1
    assert tree["deviations_better_than_chance"] > 3


def test_the_points_are_drawn_on_the_field(points: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["locate", str(points), "--heading", "0.5", "--output", "drawn.png"]) == 0
    assert "drawn into drawn.png" in capsys.readouterr().out
    picture = cv2.imread("drawn.png")
    blue = np.all(np.abs(picture.astype(int) - (255, 120, 0)) < 30, axis=2)
    red = np.all(np.abs(picture.astype(int) - (0, 0, 220)) < 30, axis=2)
    assert blue.sum() > 1000
    rows, columns = np.nonzero(red)
    assert columns.mean() > picture.shape[1] / 2  # x > 0 is on the right
    assert rows.mean() > picture.shape[0] / 2  # y < 0 is below
    assert main(["locate", str(points), "--output", "drawn.png"]) == 2
    assert "exists already" in capsys.readouterr().err


def test_scatter_is_refused_with_status_1_and_the_reason(small_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scan = small_data / "real" / "msl_scans" / "mops_2017-03-31.points.csv"
    assert main(["locate", str(scan), "--field", str(FIELDS / "mops_2017-03-31.yaml"), "--json"]) == 1
    captured = capsys.readouterr()
    assert "fit no pose better than scatter would" in captured.err
    assert "mops_2017-03-31.points.csv" in captured.err
    tree = json.loads(captured.out)
    assert tree["pose"] is None
    assert "fit no pose" in tree["refused"]
    assert tree["best_refused"]["mean_distance_m"] > 0.3
    assert tree["deviations_better_than_chance"] < 3


def test_too_few_points_are_refused_with_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "few.csv").write_text("x,y\n1,2\n2,1\n")
    assert main(["locate", "few.csv"]) == 1
    assert "2 different points are too few" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["missing.csv"], "missing.csv: cannot be read"),
        (["broken.csv"], "broken.csv, line 2: the x 'a' is not a number"),
        (["photo.png"], "photo.png: an image needs its camera model; give it with --camera FILE"),
        (["photo.png", "--camera", "none.yaml"], "none.yaml"),
        (["broken.csv", "--field", "msl-18x13"], "msl-18x12"),
        (["broken.csv", "--output", "drawn.gif"], "a picture is written as .png or .jpg"),
        (["broken.csv", "--heading", "north"], "'--heading'"),
        (["good.csv", "--heading", "180"], "more than a whole turn: is it in radians? 180 degrees are 3.1416 rad"),
        (["good.csv", "--heading", "nan"], "the heading nan is not an angle"),
        (["good.csv", "--heading", "-inf"], "the heading -inf is not an angle"),
        (["."], ".: is a folder; expected one CSV file of line points or one image"),
        (["good.csv", "--field", "good.csv"], "good.csv: no such preset (known: hsl-l-22x14"),
    ],
)
def test_bad_input_ends_with_status_2_and_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], complaint: str
) -> None:
    (tmp_path / "broken.csv").write_text("x_m,y_m\na,1\n")
    np.savetxt("good.csv", np.random.default_rng(0).normal(size=(20, 2)), delimiter=",", header="x,y", comments="")
    (tmp_path / "photo.png").write_bytes(b"none")
    assert main(["locate", *arguments]) == 2
    captured = capsys.readouterr()
    assert complaint in captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""


def test_a_photograph_is_located_and_its_overlay_saved(
    small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The documented distances: 2.35 m to the halfway line and 2.56 m to the nearer touch line, good to 15 cm."""
    photograph = small_data / "real" / "omni" / "nubot_a.png"
    camera = small_data / "real" / "omni" / "nubot_a.camera.yaml"
    assert main(["locate", str(photograph), "--camera", str(camera), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert abs(tree["pose"]["x_m"]) == pytest.approx(2.35, abs=0.15)
    assert 5.9375 - abs(tree["pose"]["y_m"]) == pytest.approx(2.56, abs=0.15)
    assert tree["picture"] == str(Path("runs") / "nubot_a-locate-1" / "overlay.png")
    overlay = cv2.imread(str(tmp_path / tree["picture"]))
    assert overlay.shape[1] > 900


def test_an_image_without_lines_is_refused_and_its_overlay_saved_nevertheless(
    small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noise = np.random.default_rng(0).normal(0, 2, (480, 480, 3))
    cv2.imwrite("green.png", np.clip(np.array([75, 140, 80]) + noise, 0, 255).astype(np.uint8))
    camera = small_data / "omni_msl_track" / "camera.yaml"
    assert main(["locate", "green.png", "--camera", str(camera), "--output", "seen.png"]) == 1
    assert "too few to tell a pose" in capsys.readouterr().err
    assert (tmp_path / "seen.png").is_file()


def test_an_image_without_carpet_is_refused_by_name(small_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite("grey.png", np.full((480, 480, 3), 120, dtype=np.uint8))
    camera = small_data / "omni_msl_track" / "camera.yaml"
    assert main(["locate", "grey.png", "--camera", str(camera)]) == 1
    assert "grey.png: no green carpet found" in capsys.readouterr().err
    deep = cv2.imread("grey.png").astype(np.uint16) * 16
    cv2.imwrite("deep.png", deep)
    assert main(["locate", "deep.png", "--camera", str(camera)]) == 1
    assert "(read as an image of 16 bits per channel; 8 are expected)" in capsys.readouterr().err


def test_an_image_of_another_size_is_refused_by_name(small_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cv2.imwrite("small.png", np.full((240, 320, 3), 120, dtype=np.uint8))
    assert main(["locate", "small.png", "--camera", str(small_data / "omni_msl_track" / "camera.yaml")]) == 2
    assert "small.png: is of 320 x 240 pixels; the camera file says 480 x 480" in capsys.readouterr().err


def test_the_field_of_the_recording_is_hinted_at(points: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (points.parent / "images").mkdir()
    image_s = points.rename(points.parent / "images" / points.name)
    assert main(["locate", str(image_s)]) == 0
    assert "recording" not in capsys.readouterr().out
    beside = points.parent / "field.yaml"
    beside.write_text((FIELDS / "nubot-lab-18x8.yaml").read_text())
    assert main(["locate", str(image_s)]) == 0
    assert f"tells another; its recording has --field {beside}\n" in capsys.readouterr().out
    assert main(["locate", str(image_s), "--heading", "2.1"]) == 1
    assert f"msl-18x12 was assumed; its recording has --field {beside})" in capsys.readouterr().err
    assert main(["locate", str(image_s), "--field", "msl-18x12"]) == 0
    assert "field.yaml" not in capsys.readouterr().out


def test_a_wrong_heading_is_refused_with_the_best_pose(points: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["locate", str(points), "--heading", "2.1", "--json"]) == 1
    captured = capsys.readouterr()
    assert "Check the heading (2.100 rad, in the field frame), the field" in captured.err
    assert "(--field was not given: msl-18x12 was assumed)" in captured.err
    assert json.loads(captured.out)["best_refused"]["mean_distance_m"] > 0.2


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_full_disk_gives_one_message(points: Path, options: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "touchline", "locate", str(points), "--heading", "0.5", *options]
        plain = {**os.environ, "TOUCHLINE_DEBUG": ""}
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False, env=plain)
    assert ended.returncode == 1
    assert ended.stderr == "error: the output: No space left on device\n"


def test_the_help_says_where_the_overlay_goes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["locate", "--help"]) == 0
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "overlay.png in runs/NAME-locate-N" in said


def test_a_wrong_field_is_doubted_and_the_right_one_named(small_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured = small_data / "real" / "nubot_robot1.csv"
    assert main(["locate", str(measured), "--field", str(FIELDS / "nubot-lab-18x8.yaml")]) == 0
    out = capsys.readouterr().out
    assert "in doubt: 38 % of the points lie more than 25 cm from every line" in out
    assert "of the points lie outside the carpet" in out
    assert "The points fit the field msl-18x12 far better, 6.1 cm from the lines on average: --field msl-18x12" in out
    sigma_m = next(line for line in out.splitlines() if line.startswith("± of the pose")).split()[4]
    assert float(sigma_m) > 0.3


def test_wrong_ranges_are_refused_with_the_scale_that_fits_and_fitted_when_asked(
    small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = np.loadtxt(small_data / "real" / "nubot_robot1.csv", delimiter=",", skiprows=1)[::6]
    np.savetxt(tmp_path / "long.csv", 1.15 * measured, delimiter=",", header="x_m,y_m", comments="")
    arguments = ["locate", "long.csv", "--field", "msl-18x12"]
    assert main(arguments) == 1
    assert "With all ranges times 0.869" in capsys.readouterr().err
    assert main([*arguments, "--fit-scale", "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert tree["scale"]["factor"] == pytest.approx(1.0 / 1.15, abs=3.0 * tree["scale"]["deviation"])
    assert tree["scale"]["deviation"] < 0.01
    assert tree["doubts"] == tree["better"] == []
    assert abs(tree["pose"]["x_m"]) == pytest.approx(4.117, abs=0.05)


def test_the_field_that_an_image_through_a_lens_fits_better_is_named_by_the_distance_that_it_leaves(
    small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Looked at anew, as its lines are thinner; with the camera's errors fitted, as at the pose."""
    walk = small_data / "humanoid_9x6_walk"
    arguments = ["locate", str(walk / "images" / "000007.jpg"), "--camera", str(walk / "camera.yaml"), "--json"]
    assert main([*arguments, "--attitude", "0,0", "--output", str(tmp_path / "wrong.png")]) == 0
    tree = json.loads(capsys.readouterr().out)
    alike = {"indoor-9x6", "humanoid-kid-9x6", "hsl-s-9x6"}  # in what this image shows, to 0.1 mm
    assert {one["field"] for one in tree["better"]} <= alike
    assert len(tree["better"]) == 1
    assert tree["better"][0]["mean_distance_m"] < 0.7 * tree["mean_distance_m"]


def test_a_wrong_field_that_most_points_fit_is_doubted_and_the_right_one_named(
    small_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The two fields share circle and halfway line: 12 % of the points, a touch line, lie far off."""
    photograph = small_data / "real" / "omni" / "nubot_a.png"
    camera = photograph.with_suffix(".camera.yaml")
    arguments = ["locate", str(photograph), "--camera", str(camera), "--json"]
    assert main([*arguments, "--field", "msl-22x14", "--output", "wrong.png"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert "another field, for many of them lie in one row" in tree["doubts"][0]
    assert tree["better"][0]["field"] == "msl-18x12"
    assert np.sqrt(tree["covariance"][0][0]) > 0.2
    assert main([*arguments, "--field", "msl-18x12", "--output", "right.png"]) == 0
    assert json.loads(capsys.readouterr().out)["doubts"] == []
