"""The command `touchline check`: a table or JSON, and an exit status to build on."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from small_recordings import borrow, write_recording

from touchline.cli import main


@pytest.fixture
def good(tmp_path: Path, small_data: Path) -> Path:
    return borrow(small_data / "omni_msl_track", tmp_path / "track", frames=8)


def test_warnings_end_with_0(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (good / "imu.csv").write_text((good / "imu.csv").read_text() + "spoiled\n")
    assert main(["check", str(good)]) == 0
    out = capsys.readouterr().out
    assert "warning" in out.splitlines()[1]
    assert "imu.csv, line" in out.splitlines()[1]
    assert "0 errors, 1 warning" in out


def test_errors_end_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_recording(tmp_path / "small", frames=2)
    assert main(["check", str(folder)]) == 1
    captured = capsys.readouterr()
    assert captured.out.splitlines()[1].split()[:2] == ["error", "camera.yaml"]
    assert captured.err == ""


def test_what_cannot_be_read_ends_with_2_and_one_message(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_recording(tmp_path / "small", frames=2, field="msl")
    assert main(["check", str(folder)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "field 'msl' is not known" in captured.err
    assert "Traceback" not in captured.err


def test_json_holds_the_findings_and_nothing_else(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(good), "--json"]) == 0
    tree = json.loads(capsys.readouterr().out)
    assert tree["recording"] == "omni_msl_track_short"
    assert set(tree["counts"]) == {"ok", "note", "warning", "error"}
    assert sum(tree["counts"].values()) == len(tree["findings"])
    assert set(tree["findings"][0]) == {"check", "severity", "where", "what", "advice", "code"}


def test_names_with_brackets_are_printed_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_recording(tmp_path / "small", frames=2, name="[bold]night[/bold]")
    main(["check", str(folder)])
    assert "[bold]night[/bold]: 2 images" in capsys.readouterr().out
