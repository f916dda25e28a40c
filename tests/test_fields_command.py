"""`touchline fields`, mounted as the command mounts it."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
import typer
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


def test_without_a_name_all_presets_are_listed_with_sizes_and_crossings() -> None:
    listed = answer()
    for name in preset_names():
        assert row(listed, name)
    assert row(listed, "msl-18x12")[-9:] == ["18", "m", "12", "m", "0.125", "m", "12", "18", "2"]
    assert row(listed, "indoor-9x6")[-3:] == ["8", "6", "2"]


def test_a_preset_is_shown_with_its_letters_and_counts() -> None:
    shown = answer("msl-22x14")
    assert row(shown, "A") == ["A", "field", "length", "22"]
    assert row(shown, "E") == ["E", "penalty", "area", "depth", "2.25"]
    assert row(shown, "crossings")[-3:] == ["12,", "18,", "2"]
    assert row(shown, "goal", "posts") == ["goal", "posts", "4", "(white)"]
    assert row(shown, "same")[-1] == "yes"
    assert row(answer("indoor-9x6"), "C")[-1] == "none"


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


def test_show_is_a_word_of_its_own() -> None:
    shown = answer("show", "hsl-m-14x9")
    assert row(shown, "G") == ["G", "corner", "arc", "radius", "0.5"]
    assert row(shown, "goals") == ["goals", "2.6", "m", "wide", "inside,", "1.6", "m", "high,", "0.7", "m", "deep"]


def test_a_picture_of_another_kind_or_place_is_refused(tmp_path: Path) -> None:
    assert "written as .png or .jpg" in refusal("spl-9x6", "--output", str(tmp_path / "field.txt"))
    (tmp_path / "no").write_text("a file, no folder")
    assert "cannot be written" in refusal("spl-9x6", "--output", str(tmp_path / "no" / "field.png"))


def test_a_new_field_is_a_yaml_file(tmp_path: Path) -> None:
    assert "a field is written as .yaml or .yml" in refusal("new", "hall", "A=12", "--output", str(tmp_path / "a.txt"))


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    assert refusal("msl-22x41") == "msl-22x41: no such field; did you mean 'msl-22x14'?"
    assert "no such field" in refusal("show")


def test_a_field_of_ones_own_is_written_and_can_be_shown(tmp_path: Path) -> None:
    path = tmp_path / "my-field.yaml"
    said = answer("new", "lab", "A=18", "b=8", "C=4.465", "D=2.465", "--output", str(path))
    assert str(path) in said
    field = load_field(path)
    assert (field.name, field.length, field.width) == ("lab", 18.0, 8.0)
    assert len(field.crossings) == 32
    assert row(answer(str(path)), "B")[-1] == "8"


def test_the_new_file_has_the_name_of_the_field_unless_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    answer("new", "hall", "A=14.5", "--base", "humanoid-adult-14x9")
    assert open_field("hall.yaml").length == 14.5


def test_sizes_may_be_measured_to_the_middle_of_the_lines(tmp_path: Path) -> None:
    path = tmp_path / "tape.yaml"
    answer("new", "tape", "A=18", "--measured-to", "middle", "--output", str(path))
    assert load_field(path).length == 18.125


def test_a_new_field_takes_the_width_of_the_hall_s_goals(tmp_path: Path) -> None:
    path = tmp_path / "hall.yaml"
    answer("new", "hall", "--base", "hsl-s-9x6", "--goal-width", "1.8", "-o", str(path))
    assert {abs(post.y) for post in load_field(path).posts} == {0.95}


def test_an_existing_file_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "my-field.yaml"
    path.write_text("mine", encoding="utf-8")
    assert "not overwritten" in refusal("new", "lab", "A=18", "--output", str(path))
    assert path.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["A"], "A: expected LETTER=METRES, for example A=18"),
        (["A=wide"], "A=wide: expected LETTER=METRES"),
        (["A=18", "a=19"], "a=19: the letter A is given twice"),
        (["Z=1"], "letter Z: is not one of the rulebook's"),
        (["C=15"], "letters C, B: the penalty area width of 15 m does not fit"),
        (["--base", "nowhere"], "nowhere: no such field"),
    ],
)
def test_bad_letters_are_refused_and_nothing_is_written(arguments: list[str], words: str, tmp_path: Path) -> None:
    path = tmp_path / "my-field.yaml"
    assert refusal("new", "lab", *arguments, "--output", str(path)).startswith(words)
    assert not path.exists()


def test_what_sizes_cannot_reach_to_is_refused_with_what_they_can() -> None:
    result = CliRunner().invoke(app, ["fields", "new", "lab", "A=18", "--measured-to", "rim"])
    assert result.exit_code == 2
    assert "'edge', 'middle'" in result.output


@pytest.mark.parametrize("columns", ["40", "60", "75", "80"])
def test_a_narrow_terminal_cuts_no_name(monkeypatch: pytest.MonkeyPatch, columns: str) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    listed = answer()
    for name in preset_names():
        assert row(listed, name)
    assert "…" not in listed


def test_options_may_stand_before_the_name(tmp_path: Path) -> None:
    picture = tmp_path / "field.png"
    answer("--output", str(picture), "--scale", "20", "spl-9x6")
    drawn = cv2.imread(str(picture))
    assert drawn is not None
    assert drawn.shape == (148, 208, 3)
    assert "draw one field: touchline fields NAME --output" in refusal("--output", str(tmp_path / "all.png"))


def test_the_letters_that_came_from_the_base_are_told(tmp_path: Path) -> None:
    said = answer("new", "lab", "A=12", "B=9", "C=5", "D=3", "H=2", "--output", str(tmp_path / "lab.yaml"))
    line = next(line for line in said.splitlines() if line.startswith("as in msl-22x14:"))
    assert "E=2.25, F=0.75, G=0.75, I=3.6, J=0.15, K=0.125" in line
    assert not any(f" {letter}=" in line for letter in "ABCDH")
    assert "warning" not in said


def test_a_new_field_with_the_name_of_a_preset_is_warned_of(tmp_path: Path) -> None:
    said = answer("new", "msl-18x12", "A=18", "B=12", "--output", str(tmp_path / "mine.yaml"))
    assert "warning: msl-18x12 is the name of a preset, too" in said


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


def test_help_names_both_ways() -> None:
    assert "--output" in answer("--help")
    assert "NAME|FILE" in answer("--help")
    assert "LETTER=METRES" in answer("new", "--help")
    assert "--output" in answer("msl-18x12", "--help")
