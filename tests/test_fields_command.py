"""`touchline fields`, mounted as the command mounts it."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import pytest
import typer
from syrupy.assertion import SnapshotAssertion
from typer.testing import CliRunner

from touchline.cli.fields import fields_app
from touchline.errors import InputError
from touchline.field import load_field, open_field, preset_names

app = typer.Typer()


@app.callback()
def parent() -> None:
    """A parent like the real one."""


app.add_typer(fields_app, name="fields")


def answer(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["fields", *arguments])
    assert result.exit_code == 0, (result.output, result.exception)
    return result.output


def refusal(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["fields", *arguments])
    assert isinstance(result.exception, InputError), result.output
    return str(result.exception)


def row(text: str, *first: str) -> list[str]:
    return next(line.split() for line in text.splitlines() if line.split()[: len(first)] == list(first))


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


def said(text: str) -> str:
    """Without the layout, which is Rich's."""
    lines = (re.sub(r"[─━╭╮╰╯│┃┏┓┗┛┡┩└┘├┤┬┴┼═╞╡]+", " ", line) for line in text.splitlines())
    return "\n".join(" ".join(line.split()) for line in lines if line.strip())


@pytest.mark.parametrize("arguments", ["", "msl-22x14", "indoor-9x6", "show hsl-m-14x9"])
def test_fields_are_listed_and_shown(arguments: str, snapshot: SnapshotAssertion) -> None:
    assert said(answer(*arguments.split())) == snapshot


NEW = """
new lab A=12 B=9 C=5 D=3 H=2
new msl-18x12 A=18 B=12
new tape A=18 --measured-to middle
new hall --base hsl-s-9x6 --goal-width 1.8
"""
REFUSED = """
msl-22x41
show
new lab A
new lab A=wide
new lab A=18 a=19
new lab Z=1
new lab C=15
new lab --base nowhere
new lab A=12 --output a.txt
new lab A=12 --output mine.yaml
spl-9x6 --output field.txt
"""


def test_new_fields_say_what_came_from_the_base(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, snapshot: SnapshotAssertion
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "\n".join(f"{line}: {said(answer(*line.split()))}" for line in NEW.strip().splitlines()) == snapshot
    assert open_field("lab.yaml").width == 9.0
    assert open_field("tape.yaml").length == 18.125
    assert {abs(post.y) for post in open_field("hall.yaml").posts} == {0.95}


def test_what_cannot_be_meant_is_refused_and_nothing_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, snapshot: SnapshotAssertion
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text("mine", encoding="utf-8")
    assert "\n".join(f"{line}: {refusal(*line.split())}" for line in REFUSED.strip().splitlines()) == snapshot
    assert [(path.name, path.read_text(encoding="utf-8")) for path in tmp_path.iterdir()] == [("mine.yaml", "mine")]


def test_a_file_and_a_recording_are_shown_like_a_preset(small_data: Path) -> None:
    shown = answer(str(small_data / "omni_9x6_points"))
    assert row(shown, "line", "width") == ["line", "width", "0.05"]
    assert row(shown, "poles") == ["poles", "2", "(blue-yellow-blue,", "yellow-blue-yellow)"]
    assert shown == answer(str(small_data / "omni_9x6_points" / "field.yaml"))


def test_a_field_is_drawn_into_a_new_picture(tmp_path: Path) -> None:
    picture = tmp_path / "field.png"
    assert str(picture) in answer("spl-9x6", "--output", str(picture), "--scale", "20")
    drawn = cv2.imread(str(picture))
    assert drawn is not None
    assert drawn.shape == (148, 208, 3)
    assert "not overwritten" in refusal("spl-9x6", "--output", str(picture))


def test_a_field_of_ones_own_is_written_and_can_be_shown(tmp_path: Path) -> None:
    path = tmp_path / "my-field.yaml"
    said = answer("new", "lab", "A=18", "b=8", "C=4.465", "D=2.465", "--output", str(path))
    assert str(path) in said
    field = load_field(path)
    assert (field.name, field.length, field.width) == ("lab", 18.0, 8.0)
    assert len(field.crossings) == 32
    assert row(answer(str(path)), "B")[-1] == "8"


@pytest.mark.parametrize("columns", ["40", "60", "75", "80"])
def test_a_narrow_terminal_cuts_no_name(monkeypatch: pytest.MonkeyPatch, columns: str) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    listed = answer()
    for name in preset_names():
        assert row(listed, name)
    assert "…" not in listed


def test_a_file_that_is_named_like_no_preset_and_is_no_field_is_told_as_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("x").write_text("junk", encoding="utf-8")
    Path("junk.yaml").write_text("junk", encoding="utf-8")
    said = refusal("x")
    assert said.startswith("x: no such preset (known: hsl-l-22x14,")
    assert said.endswith(
        "the file of this name is no field file: x: expected keys and values at the top level, found a str"
    )
    assert refusal("junk.yaml") == "junk.yaml: expected keys and values at the top level, found a str"
