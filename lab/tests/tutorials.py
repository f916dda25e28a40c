"""What the tutorials say is done: their files are written and their commands run, in the order of the page."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Iterable
from pathlib import Path

import pytest
from team_writing import write_bag

from touchline.cli import main
from touchline_lab.experiments.schulz_runs import AS_BUILT, walk

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ("tutorial-mirror", "tutorial-humanoid", "tutorial-own-detector", "tutorial-match")


def blocks(page: str, language: str) -> list[str]:
    """The fenced blocks of a language on a page."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def commands(page: str) -> list[str]:
    """The commands of a page."""
    return [line for block in blocks(page, "sh") for line in block.splitlines() if line]


def do(lines: Iterable[str], folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Run commands in a folder as a shell would; what they print. Fails at the first that does."""
    printed = ""
    for line in lines:
        words = [name for word in shlex.split(line) for name in _names(word, folder)]
        if words[0] == "cp":
            shutil.copy(folder / words[1], folder / words[2])
            continue
        assert words[0] == "touchline"
        status = main(words[1:])
        told = capsys.readouterr()
        assert status == 0, f"{line}\n{told.out}\n{told.err}"
        printed += told.out
    return printed


def booster_bag(path: Path, seconds: float) -> None:
    """A walk in the messages of Booster's robots."""
    write_bag(walk("hsl-s-9x6", AS_BUILT, 3, seconds), path, 3)


def _names(word: str, folder: Path) -> list[str]:
    if "*" not in word:
        return [word]
    return sorted(path.relative_to(folder).as_posix() for path in folder.glob(word))
