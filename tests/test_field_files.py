"""field.yaml files: presets that follow the rules, files of recordings, and what is refused with which words."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from touchline.errors import InputError
from touchline.field import FieldModel, load_field, open_field, preset_names

MINIMAL = "length: 9.0\nwidth: 6.0\nline_width: 0.05\nsegments:\n- [0.0, -3.0, 0.0, 3.0]\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "field.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_field(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    return message[len(str(path)) :]


def outer(field: FieldModel, x: float, y: float) -> bool:
    """Whether the outer edge of a line passes through x, y."""
    return math.isclose(field.line_distances([(x, y)])[0], 0.5 * field.line_width, abs_tol=1e-9)


@pytest.mark.parametrize(
    ("name", "recording"),
    [
        ("msl-18x12", "omni_msl_track"),
        ("msl-18x12", "omni_msl_match"),
        ("indoor-9x6", "humanoid_9x6_walk"),
        ("indoor-9x6", "omni_9x6_points"),
    ],
)
def test_presets_equal_the_fields_of_the_recordings(name: str, recording: str, shared_data: Path) -> None:
    assert open_field(name) == load_field(shared_data / recording / "field.yaml")


def sizes(field: FieldModel) -> str:
    """By its letters, and what they leave out."""
    letters = " ".join(f"{letter}={size:g}" for letter, size in field.letters.items())
    posts = sorted({(abs(p.x), abs(p.y), p.diameter, p.height, p.kind, p.colors_from_ground) for p in field.posts})
    arcs = sorted({round(float(radius), 4) for _, _, radius, *_ in field.arcs})
    return f"{field.name}: {letters}; line {field.line_width:g}; arcs {arcs}; posts {posts}"


def test_presets_have_the_sizes_of_the_rules(snapshot: SnapshotAssertion) -> None:
    assert "\n".join(sizes(open_field(name)) for name in preset_names()) == snapshot


def test_sizes_reach_to_the_outer_edge_of_lines() -> None:
    field = open_field("msl-22x14")
    for x, y in ((11.0, 0.3), (0.3 + 2.0, 7.0), (11.0 - 2.25, 0.3), (10.0, 3.45), (10.25, 0.3), (-2.0, 0.0)):
        assert outer(field, x, y), (x, y)
    assert [11.0 - 3.6, 0.0] in field.discs[:, :2].tolist()


def test_spl_9x6_has_the_sizes_of_its_rule_book_to_the_middle_of_the_lines() -> None:
    field = open_field("spl-9x6")
    on_lines = [(4.5, 2.5), (2.0, 3.0), (4.5 - 0.6, 0.5), (4.2, 1.1), (4.5 - 1.65, 1.5), (3.5, 2.0), (0.75, 0.0)]
    np.testing.assert_allclose(field.line_distances(on_lines), 0.0, atol=1e-9)
    assert [3.2, 0.0, 0.1] in field.discs.tolist()


@pytest.mark.parametrize("name", preset_names())
def test_presets_are_symmetric(name: str) -> None:
    assert open_field(name).is_symmetric


def test_a_field_with_one_area_only_is_not_symmetric() -> None:
    field = open_field("indoor-9x6")
    half = FieldModel(name="half", length=9, width=6, line_width=0.05, segments=field.segments[:8])
    assert not half.is_symmetric


def test_polylines_follow_the_lines_in_steps() -> None:
    field = open_field("msl-18x12")
    lines = field.polylines(step_m=0.1)
    assert len(lines) == 17 + 1 + 4
    for line in lines:
        np.testing.assert_allclose(field.line_distances(line), 0.0, atol=1e-6)
        assert np.linalg.norm(np.diff(line, axis=0), axis=1).max() <= 0.1 + 1e-9
    np.testing.assert_allclose(lines[0][[0, -1]], field.segments[0].reshape(2, 2))
    np.testing.assert_allclose(lines[17][0], lines[17][-1], atol=1e-12)


def test_optional_keys_may_be_missing(tmp_path: Path) -> None:
    field = load_field(write(tmp_path, MINIMAL))
    assert (field.name, field.border) == ("field", 1.0)
    assert [len(rows) for rows in (field.segments, field.circles, field.arcs, field.discs)] == [1, 0, 0, 0]
    assert (field.goals, field.poles, field.posts) == ((), (), ())


@pytest.mark.parametrize("name", preset_names())
def test_a_written_field_loads_as_an_equal_one(name: str, tmp_path: Path) -> None:
    field, path = open_field(name), tmp_path / "copy.yaml"
    field.to_yaml(path)
    again = load_field(path)
    assert again == field
    assert hash(again) == hash(field)
    assert (again.letters, again.description) == (field.letters, field.description)


def test_fields_that_differ_in_one_number_are_not_equal() -> None:
    field = open_field("spl-9x6")
    segments = field.segments.copy()
    segments[3, 1] += 1e-6
    other = FieldModel(name=field.name, length=9.05, width=6.05, line_width=0.05, segments=segments)
    assert field != other
    assert field != "spl-9x6"


def test_a_recording_folder_or_a_file_is_opened_like_a_name(tmp_path: Path) -> None:
    path = write(tmp_path, MINIMAL)
    assert open_field(tmp_path) == open_field(path) == open_field(str(path))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("msl-18x21", "msl-18x21: no such field; did you mean 'msl-18x12'?"),
        (
            "?",
            "known: hsl-l-22x14, hsl-m-14x9, hsl-s-9x6, humanoid-adult-14x9, humanoid-kid-9x6, indoor-9x6, msl-18x12, "
            "msl-22x14, spl-9x6",
        ),
        ("missing.yaml", "missing.yaml: no such field file; presets: hsl-l-22x14"),
    ],
)
def test_an_unknown_field_is_answered_with_the_known_ones(name: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        open_field(name)
    assert words in str(caught.value)


GOAL = "goals:\n- {x: 4.5, y_posts: [-1, 1], post_width: 0.1, post_shape: round, height: 1, depth: 0.5, color: white}\n"
POLE = "poles:\n- {x: 0, y: 3.3, diameter: 0.2, height: 1, bands_from_ground: [blue]}\n"


BAD = [
    MINIMAL.replace("length: 9.0\n", ""),
    MINIMAL.replace("9.0", "long"),
    MINIMAL.replace("9.0", "-9.0"),
    MINIMAL.replace("0.05", "0"),
    MINIMAL.replace("6.0", ".nan"),
    MINIMAL.replace("6.0", "true"),
    MINIMAL + "border: -1\n",
    MINIMAL + "- [1.0, 2.0, 3.0]\n",
    MINIMAL + "- [1, 2, 3, x]\n",
    MINIMAL + "- [1, 2, 1, 2]\n",
    MINIMAL + "- 5\n",
    MINIMAL + "circles: [[0, 0, 0]]\n",
    MINIMAL + "circles: 3\n",
    MINIMAL + "arcs:\n- [0, 0, 1, 0, 1]\n- [0, 0, 1, 2, 2]\n",
    MINIMAL + "discs:\n- [0, 0, -1]\n",
    MINIMAL + "segment:\n- [0, 0, 1, 1]\n",
    "length: 9\nwidth: 6\nline_width: 0.05\n",
    MINIMAL + "letters: 5\n",
    MINIMAL + "letters: {A: big}\n",
    MINIMAL + GOAL.replace("x: 4.5", "x: here"),
    MINIMAL + GOAL.replace("depth", "deep"),
    MINIMAL + GOAL.replace(", color: white", ""),
    MINIMAL + GOAL.replace("round", "oval"),
    MINIMAL + GOAL.replace("[-1, 1]", "2"),
    MINIMAL + GOAL.replace("height: 1", "height: 0"),
    MINIMAL + "goals:\n- post\n",
    MINIMAL + POLE.replace("[blue]", "[]"),
    MINIMAL + POLE.replace("0.2", "-0.2"),
    MINIMAL + "circles: [[0, 0\n",
    "- 1\n- 2\n",
    "",
    "\0picture",
]


def test_a_bad_field_file_is_refused_with_line_key_and_row(tmp_path: Path, snapshot: SnapshotAssertion) -> None:
    assert "\n".join(refusal(write(tmp_path, text)) for text in BAD) == snapshot


def test_rows_of_another_shape_are_refused_in_python_too() -> None:
    with pytest.raises(InputError, match="segments: expected rows of 4 numbers"):
        FieldModel(name="f", length=9, width=6, line_width=0.05, segments=np.zeros((2, 3)))
    with pytest.raises(InputError, match="arcs, row 1: holds a value that is not finite"):
        FieldModel(name="f", length=9, width=6, line_width=0.05, arcs=[(0, 0, 1, 0, math.inf)])


def test_the_same_field_again_is_the_same_model_and_one_with_another_remark_is_not(tmp_path: Path) -> None:
    for name, more in (("one", ""), ("same", ""), ("other", "description: with letters\n")):
        (tmp_path / name).mkdir()
        write(tmp_path / name, MINIMAL + more)
    one, same, other = (open_field(tmp_path / name) for name in ("one", "same", "other"))
    assert one is same
    assert other is not one
    assert other.description == "with letters"
