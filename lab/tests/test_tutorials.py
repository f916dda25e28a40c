"""The tutorials' commands that need no images, in the order of their pages; `make tutorials` runs all as they stand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tutorials import DOCS, PAGES, blocks, booster_bag, commands, do


def without_images(page: str) -> list[str]:
    """The commands of a page for what a detector would have found in the simulator's images."""
    lines = [line for line in commands(page) if line.split()[1] not in ("view", "calibrate", "camera.yaml")]
    found = [line for line in lines if "turning" not in line]
    return [f"{line} --level points" if "simulate" in line and "--level" not in line else line for line in found]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_lead_to_a_robot_that_knows_where_it_is(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = without_images(page)
    assert len(lines) >= 4
    printed = do(lines, tmp_path, capsys)
    assert "position (cm)" in printed
    assert "the row is left out" not in printed  # of what the simulator wrote
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["errors"]["position_m"]["median"] < 0.1
    assert (tmp_path / "run" / "report.html").is_file()


@pytest.mark.slow
def test_the_detector_s_program_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = blocks("tutorial-own-detector", "python")
    exec(compile(program, "tutorial-own-detector.md", "exec"), {})
    told = capsys.readouterr().out.splitlines()
    assert told[0].startswith("searching")
    assert len(told) > 1


def test_a_source_of_one_s_own_is_localised(capsys: pytest.CaptureFixture[str]) -> None:
    text = (DOCS / "how-to-extend.md").read_text(encoding="utf-8")
    program = text.partition("```python\n")[2].partition("```")[0]
    exec(compile(program, "how-to-extend.md", "exec"), {})
    assert "other places" in capsys.readouterr().out


@pytest.mark.slow
def test_a_booster_robot_s_bag_is_localised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    booster_bag(tmp_path / "WALK.mcap", 4.0)
    printed = do(commands("tutorial-booster"), tmp_path, capsys)
    assert "tracking 3" in printed  # thirty and some of 32 images
    assert (tmp_path / "poses.mcap").is_file()
