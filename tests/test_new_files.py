"""What is written goes where nothing is yet; its folder is made; its name says what it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from touchline.cli import main
from touchline.errors import InputError
from touchline.files.new import check_new_file, write_new_file

STRIP, MARKS, PHOTO = "strip", "marks.csv", "photo.png"


def test_a_missing_folder_is_made(tmp_path: Path) -> None:
    file = tmp_path / "a" / "b" / "camera.yaml"
    check_new_file(file, (".yaml",))
    assert not file.parent.exists()  # asking makes nothing
    write_new_file(file, b"model: omni")
    assert file.read_bytes() == b"model: omni"


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text("mine")
    for write in (lambda: check_new_file(file, (".yaml",)), lambda: write_new_file(file, b"other")):
        with pytest.raises(InputError, match=r"camera\.yaml: exists already and is not overwritten"):
            write()
    assert file.read_text() == "mine"


def test_a_file_in_the_place_of_a_folder_is_told_before_the_work_and_after(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a file, no folder")
    file = tmp_path / "a" / "b" / "camera.yaml"
    for write in (lambda: check_new_file(file, (".yaml",)), lambda: write_new_file(file, b"other")):
        with pytest.raises(InputError, match=r"camera\.yaml: cannot be written"):
            write()


def test_a_folder_in_which_nothing_may_be_made_is_told_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.access", lambda path, mode: False)  # the tests may run as root, who may write anywhere
    with pytest.raises(InputError, match=r"camera\.yaml: cannot be written \(nothing may be made in "):
        check_new_file(tmp_path / "a" / "camera.yaml", (".yaml",))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["mirror", STRIP, "--output", "x.txt"], "x.txt: a camera is written as .yaml or .yml"),
        (["range", MARKS, "--output", "x"], "x: a camera is written as .yaml or .yml"),
        (["colour", PHOTO, "--output", "x.yaml"], "x.yaml: a colour table is written as .npz"),
        (["range", MARKS, "--output", "x.yaml", "--picture", "x.gif"], "x.gif: a picture is written as .png or .jpg"),
        (["mirror", STRIP, "--output", "old.yaml"], "old.yaml: exists already and is not overwritten"),
        (
            ["mirror", STRIP, "--output", "drawn.yaml"],
            "drawn.png: exists already and is not overwritten; the picture of drawn.yaml needs another name: --picture",
        ),
        (["mirror", STRIP, "--output", "x.yaml", "--picture", "drawn.png"], "drawn.png: exists already"),
        (["range", MARKS, "--output", "old.yaml/x.yaml"], "old.yaml/x.yaml: cannot be written"),
    ],
)
def test_a_calibration_is_told_of_its_output_before_it_begins(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / STRIP).mkdir()
    for name in (MARKS, PHOTO, "old.yaml", "drawn.png"):
        (tmp_path / name).write_text("nothing to calibrate from")
    before = sorted(tmp_path.iterdir())
    assert main(["calibrate", *arguments]) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert sorted(tmp_path.iterdir()) == before
