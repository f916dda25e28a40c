"""The tutorials as they stand, images and calibration included: `make tutorials`, some minutes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tutorials import PAGES, blocks, commands, do


@pytest.mark.parametrize("page", PAGES)
def test_every_command_and_program_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for text in blocks(page, "yaml"):
        (tmp_path / "turning.yaml").write_text(text, encoding="utf-8")
    do(commands(page), tmp_path, capsys)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["errors"]["position_m"]["median"] < 0.1
    for program in blocks(page, "python"):
        exec(compile(program, f"{page}.md", "exec"), {})
        assert capsys.readouterr().out
