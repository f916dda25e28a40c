"""A recording reads inside its own folder, and writes nowhere but into the output; anything else is asked for."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from small_recordings import borrow, edit_line, write_recording

from touchline.calibration.colour import calibrate_recording
from touchline.cli import main
from touchline.errors import InputError
from touchline.evaluation import evaluate
from touchline.evaluation.run_folder import new_folder
from touchline.published.iris_fusion.range_pairs import recording_pairs
from touchline.sources import open_source
from touchline.view.look import look_at_recording

ELSEWHERE = "what lies elsewhere is only read with --follow-links"
TABLES = ("odometry.csv", "wheels.csv", "imu.csv", "camera_pose.csv", "observations.csv")
NEEDED = ("sequence.yaml", "camera.yaml", "field.yaml", "images.csv", "ground_truth.tum")


def put_elsewhere(folder: Path, name: str) -> None:
    """Move a file of a recording out of it, and link to it."""
    away = folder.parent / "elsewhere"
    away.mkdir(exist_ok=True)
    shutil.move(folder / name, away / name.replace("/", "-"))
    (folder / name).symlink_to(away / name.replace("/", "-"))


@pytest.fixture
def folder(tmp_path: Path, small_data: Path) -> Path:
    return borrow(small_data / "omni_msl_track", tmp_path / "recording", 12)


@pytest.mark.parametrize("name", NEEDED)
def test_a_needed_file_that_is_a_link_out_of_the_folder_has_to_be_asked_for(folder: Path, name: str) -> None:
    put_elsewhere(folder, name)
    with pytest.raises(InputError, match=rf"{name}: leads out of .*recording, and {ELSEWHERE}"):
        open_source(folder)
    source = open_source(folder, follow_links=True)
    assert source.camera is not None
    assert all(frame.problem is None for frame in source)


def test_a_sensor_s_table_elsewhere_is_told_and_left_out(folder: Path) -> None:
    (folder / "observations.csv").write_text("t,kind,x_m,y_m\n0.0,none,,\n")
    (folder / "camera_pose.csv").write_text("t,x,y,z,roll,pitch,yaw\n0.0,0,0,1,0,0,0\n")
    for name in TABLES:
        put_elsewhere(folder, name)
    source = open_source(folder)
    assert source.sensor_files == ()
    assert [problem.file for problem in source.problems if ELSEWHERE in problem.message] == [*TABLES[-1:], *TABLES[:-1]]
    assert len(open_source(folder, follow_links=True).sensor_files) == 3


@pytest.mark.parametrize("way", ["absolute", "dots", "link"])
def test_an_image_elsewhere_is_missing(folder: Path, way: str) -> None:
    elsewhere = folder.parent / "elsewhere.jpg"
    shutil.copy(folder / "images" / "000000.jpg", elsewhere)
    if way == "link":
        (folder / "images" / "000003.jpg").unlink()
        (folder / "images" / "000003.jpg").symlink_to(elsewhere)
    else:
        named = str(elsewhere) if way == "absolute" else "images/../../elsewhere.jpg"
        edit_line(folder / "images.csv", 5, 1, named)
    frames = list(open_source(folder))
    assert ELSEWHERE in (frames[3].problem or "")
    assert sum(frame.problem is not None for frame in frames) == 1
    assert all(frame.problem is None for frame in open_source(folder, follow_links=True))


def test_links_and_dots_that_stay_inside_are_no_matter(folder: Path) -> None:
    shutil.move(folder / "images", folder / "pictures")
    (folder / "images").symlink_to("pictures")
    edit_line(folder / "images.csv", 5, 1, f"pictures/../{folder.name}/../images/000003.jpg")
    edit_line(folder / "images.csv", 6, 1, str(folder / "images" / "000004.jpg"))
    (folder.parent / "friday").symlink_to(folder)
    (folder / folder.name).mkdir()
    for path in (folder, folder.parent / "friday"):
        assert [frame.problem for frame in open_source(path) if frame.problem is not None] == []


def test_a_name_that_is_too_long_is_one_image_s_problem(folder: Path) -> None:
    edit_line(folder / "images.csv", 5, 1, f"images/{'a' * 300}.jpg")  # others in that folder were read before
    problems = [frame.problem or "" for frame in open_source(folder)]
    assert ["File name too long" in problem for problem in problems] == [k == 3 for k in range(12)]


def test_what_a_calibration_reads_beside_it_stays_inside_too(folder: Path) -> None:
    (folder / "marks.csv").write_text("file,name,u,v,x_m,y_m\n")
    put_elsewhere(folder, "marks.csv")
    with pytest.raises(InputError, match=rf"marks.csv: .*{ELSEWHERE}"):
        recording_pairs(open_source(folder))
    regions = folder / "regions.yaml"
    regions.write_text("- {file: ../elsewhere.jpg, class: green, box: [10, 10, 40, 40]}\n")
    with pytest.raises(InputError, match=rf"elsewhere.jpg: leads out of .*{ELSEWHERE}"):
        calibrate_recording(open_source(folder))
    with pytest.raises(InputError, match=r"elsewhere\.jpg: is missing"):
        calibrate_recording(open_source(folder, follow_links=True))
    put_elsewhere(folder, "regions.yaml")
    with pytest.raises(InputError, match=rf"regions.yaml: .*{ELSEWHERE}"):
        calibrate_recording(open_source(folder))


@pytest.mark.parametrize(
    ("name", "made"),
    [("../../evil", "evil"), ("/a/evil", "a-evil"), ("a\\b\nc", "a-b c"), ("", "unnamed"), ("ü" * 300, "ü" * 100)],
)
def test_the_name_of_a_recording_is_no_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, made: str
) -> None:
    folder = write_recording(tmp_path / "recording", name=name)
    (tmp_path / "here" / "there").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here" / "there")
    source = open_source(folder)
    assert source.name == name.replace("\n", " ")[:200]  # on one line, not too long
    assert new_folder(None, source.name) == Path("runs") / f"{made}-1"
    assert list((tmp_path / "here").iterdir()) == [tmp_path / "here" / "there"]
    assert {path.name for path in tmp_path.iterdir()} == {"recording", "here"}


@pytest.mark.slow
def test_every_command_that_opens_a_recording_can_be_asked(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder.parent)
    put_elsewhere(folder, "images.csv")
    put_elsewhere(folder, "ground_truth.tum")
    asked = ["--follow-links"]
    assert main(["run", "recording", "-o", "first"]) == 2
    assert "images.csv: leads out of recording" in " ".join(capsys.readouterr().err.split())
    assert main(["run", "recording", "-o", "first", *asked]) == 0
    assert main(["evaluate", "first"]) == 2
    assert main(["evaluate", "first", *asked]) == 0
    assert evaluate("first", follow_links=True).frames == 6  # of 12: the others come before motion confirms the pose
    assert main(["check", "recording"]) == 2
    assert main(["check", "recording", *asked]) in (0, 1)
    assert main(["view", "recording", "-o", "pictures"]) == 2
    assert main(["view", "recording", "-o", "pictures", *asked]) == 0
    assert look_at_recording(folder, 3, follow_links=True).field_from_robot is not None
    for calibration, file in (("colour", "c.npz"), ("mirror", "m.yaml"), ("range", "r.yaml")):
        capsys.readouterr()
        main(["calibrate", calibration, "recording", "-o", file])
        assert "--follow-links" in " ".join(capsys.readouterr().err.split())
        main(["calibrate", calibration, "recording", "-o", file, *asked])
        assert "--follow-links" not in " ".join(capsys.readouterr().err.split())
