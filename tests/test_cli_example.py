"""The whole way on the bundled recording: demo, view, and the same in Python."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import pytest

import touchline
from touchline.cli import main
from touchline.cli.run import EXAMPLE, example_recording
from touchline.errors import InputError


@pytest.fixture(autouse=True)
def _workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_bundled_recording_is_small_and_whole() -> None:
    source = touchline.open_source(example_recording())
    assert source.name == EXAMPLE
    assert len(source) == 60
    assert source.truth is not None
    assert len(source.truth) == 60
    assert sum(path.stat().st_size for path in example_recording().rglob("*") if path.is_file()) < 6e6
    for _ in source:
        pass
    assert list(source.problems) == []


def test_demo_copies_the_recording_for_those_who_have_no_checkout(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--copy", "examples/mine"]) == 0
    assert capsys.readouterr().out == "examples/mine: the bundled recording; touchline run examples/mine localises it\n"
    assert len(touchline.open_source("examples/mine")) == 60
    assert main(["demo", "--copy", "examples/mine"]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.slow
def test_demo_prints_the_table_and_three_lines_of_python_do_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo"]) == 0
    out = capsys.readouterr().out
    assert "report: runs/demo-1/report.html" in out
    run = touchline.run(example_recording(), output="same")
    assert run.errors is not None
    assert touchline.evaluate("runs/demo-1") == touchline.evaluate(run.folder) == run.errors
    assert str(run.errors).splitlines()[1] in out
    assert run.errors.position.mean < 0.02
    assert len(run.estimates) == 60
    assert Path("runs/demo-1/report.html").read_text().count("data:image/jpeg;base64,") >= 5


def test_python_refuses_what_the_command_refuses() -> None:
    with pytest.raises(InputError, match="did you mean 'nubot-mti'"):
        touchline.run(example_recording(), system="nubot")
    with pytest.raises(InputError, match="no such recording"):
        touchline.run("nowhere")
    with pytest.raises(AttributeError, match="no attribute 'walk'"):
        touchline.walk  # noqa: B018
    assert not Path("runs").exists()


def test_everything_public_can_be_reached() -> None:
    for name in touchline.__all__:
        assert callable(getattr(touchline, name))
        assert name in dir(touchline)
    assert touchline.__version__


@pytest.mark.parametrize(
    ("system", "stages"),
    [
        ("touchline", ["colour-classes", "scan-lines", "field-boundary", "line-points", "birds-eye-view", "overlay"]),
        ("iris-fusion", ["hsv-threshold", "convex-hull", "hsl-threshold", "bitwise-and", "distances-along-rays"]),
    ],
)
def test_view_draws_the_stages_of_the_named_system(
    system: str, stages: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["view", str(example_recording()), "--stages", "--frame", "0", "--output", "stages", "--system"]
    assert main([*arguments, system]) == 0
    assert f"as {system} has it after 1 image" in capsys.readouterr().out
    names = [path.name for path in sorted(Path("stages").iterdir())]
    assert [name[3:-4] for name in names if name[3:-4] in stages] == stages
    assert names[-1] == "stages.png"
    assert min(cv2.imread("stages/stages.png").shape[:2]) > 1000


@pytest.mark.slow
def test_view_takes_the_first_image_that_shows_where_the_robot_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["view", str(example_recording()), "--system", "iris-fusion", "--output", "located"]) == 0
    found = re.search(rf"{EXAMPLE}-(\d+): .*; x -5\..*\(tracking, ", capsys.readouterr().out)
    assert found is not None
    assert int(found[1]) > 0


def test_view_of_an_image_finds_its_pose_or_the_mirrored_one(capsys: pytest.CaptureFixture[str]) -> None:
    example = example_recording()
    image, camera = example / "images" / "000005.jpg", example / "camera.yaml"
    assert main(["view", str(image), "--camera", str(camera), "--field", "msl-18x12", "--output", "a"]) == 0
    truth = touchline.open_source(example).truth
    assert truth is not None
    assert abs(float(capsys.readouterr().out.split(" x ")[1].split()[0])) == pytest.approx(abs(truth[5].x), abs=0.1)
    assert [path.name for path in Path("a").iterdir()] == ["01-overlay.png"]


def test_view_of_an_image_without_field_shows_the_points(capsys: pytest.CaptureFixture[str]) -> None:
    example = example_recording()
    image, camera = example / "images" / "000005.jpg", example / "camera.yaml"
    assert main(["view", str(image), "--camera", str(camera)]) == 0
    assert "give the field with --field" in capsys.readouterr().out
    assert Path("runs/000005-view-1/01-overlay.png").is_file()
