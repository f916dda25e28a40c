"""Fields from rulebook letters."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from touchline.errors import InputError
from touchline.field import LETTERS, FieldModel, field_from_letters, load_field, open_field, preset_names

ROWS = ("segments", "circles", "arcs", "discs")


@pytest.mark.parametrize("name", preset_names())
def test_the_letters_of_a_preset_give_its_lines(name: str) -> None:
    preset, built = open_field(name), field_from_letters(name, {}, base=name)
    for key in ROWS:  # the angles of one preset are rounded to six digits
        np.testing.assert_allclose(getattr(built, key), getattr(preset, key), atol=1e-6)
    assert (built.goals, built.poles) == (preset.goals, preset.poles)


def test_letters_of_the_old_field_on_the_base_of_the_new_give_the_old_lines() -> None:
    old = open_field("msl-18x12")
    built = field_from_letters("mine", {"A": 18, "B": 12, "C": 6.5, "D": 3.5, "I": 3.0})
    for key in ROWS:
        np.testing.assert_allclose(getattr(built, key), getattr(old, key), atol=1e-6)
    assert built.name == "mine"


def test_each_letter_is_described_and_each_preset_knows_its_own() -> None:
    assert "".join(LETTERS) == "ABCDEFGHIJKLMNOPQ"
    assert all(LETTERS.values())
    assert set(open_field("msl-22x14").letters) == set(LETTERS)
    for name in preset_names():
        assert {"A", "B", "K"} <= set(open_field(name).letters) <= set(LETTERS)


def test_sizes_measured_to_the_middle_put_the_middle_of_the_lines_there() -> None:
    sizes = {"A": 18, "B": 12, "C": 6.5, "D": 3.5, "E": 2.25, "F": 0.75, "G": 0.75, "H": 4, "I": 3, "K": 0.1}
    field = field_from_letters("tape", sizes, measured_to="middle")
    assert (field.length, field.width, field.line_width) == (18.1, 12.1, 0.1)
    places = [(9.0, 0.5), (4.0, 6.0), (6.75, 0.5), (7.5, 3.25), (8.25, 0.5), (8.5, 1.75), (2.0, 0.0)]
    np.testing.assert_allclose(field.line_distances(places), 0.0, atol=1e-9)
    assert [6.0, 0.0] in field.discs[:, :2].tolist()
    arc = next(c for c in field.crossings if c.curved and c.x > 8.0 and c.y > 5.9)
    assert (arc.x, arc.y) == pytest.approx((8.25, 6.0), abs=0.003)


def test_sizes_of_the_spl_rule_book_measured_to_the_middle_give_its_preset() -> None:
    sizes = {"A": 9, "B": 6, "C": 4, "D": 2.2, "E": 1.65, "F": 0.6, "G": 0, "H": 1.5, "I": 1.3, "J": 0.1, "K": 0.05}
    built, preset = field_from_letters("f", sizes, "spl-9x6", measured_to="middle"), open_field("spl-9x6")
    for key in ROWS:
        np.testing.assert_allclose(getattr(built, key), getattr(preset, key), atol=1e-9)


@pytest.mark.parametrize("letter", "MNOPQ")
def test_letters_of_the_technical_area_and_restart_spots_draw_nothing(letter: str) -> None:
    plain, given_letter = field_from_letters("f", {}), field_from_letters("f", {letter: 2.2})
    assert plain == given_letter
    assert given_letter.letters[letter] == 2.2


def test_goals_and_poles_move_with_the_edge_of_the_field() -> None:
    field = field_from_letters("small", {"A": 8.0, "B": 5.0}, base="indoor-9x6")
    assert [goal.x for goal in field.goals] == [3.975, -3.975]
    assert [(pole.x, pole.y) for pole in field.poles] == [(0.0, 2.8), (0.0, -2.8)]
    larger = field_from_letters("large", {"A": 10.0}, base="indoor-9x6")
    assert [goal.x for goal in larger.goals] == [4.975, -4.975]


def test_goals_can_be_as_wide_as_those_of_the_hall() -> None:
    field = field_from_letters("hall", {}, base="hsl-s-9x6", goal_width_m=1.8)
    assert [goal.y_posts for goal in field.goals] == [(-0.95, 0.95)] * 2
    for wrong in (0.0, -1.0, math.nan):
        with pytest.raises(InputError, match="goal width: expected a positive number of metres"):
            field_from_letters("hall", {}, base="hsl-s-9x6", goal_width_m=wrong)
    with pytest.raises(InputError, match="the goal of hsl-s-9x6 does not fit"):
        field_from_letters("hall", {}, base="hsl-s-9x6", goal_width_m=7.0)


@pytest.mark.parametrize(
    ("letters", "key", "count"),
    [({"G": 0}, "arcs", 0), ({"H": 0}, "circles", 0), ({"C": 0, "E": 0}, "segments", 11), ({"I": 0}, "discs", 1)],
)
def test_a_letter_of_zero_leaves_its_part_out(letters: dict[str, float], key: str, count: int) -> None:
    assert len(getattr(field_from_letters("f", letters), key)) == count


def test_a_field_of_ones_own_survives_its_file_and_is_a_base_itself(tmp_path: Path) -> None:
    field = field_from_letters("lab", {"A": 18, "B": 8, "C": 4.465, "D": 2.465})
    path = tmp_path / "lab.yaml"
    field.to_yaml(path)
    assert load_field(path) == field
    wider = field_from_letters("lab2", {"B": 9}, base=path)
    assert wider.letters == {**field.letters, "B": 9.0}


@settings(deadline=None, max_examples=50)
@given(
    st.fixed_dictionaries(
        {
            "A": st.floats(14.0, 30.0),
            "B": st.floats(10.0, 20.0),
            "C": st.floats(6.0, 8.0),
            "D": st.floats(3.0, 5.0),
            "E": st.floats(1.6, 3.0),
            "F": st.floats(0.4, 1.2),
            "H": st.floats(2.0, 5.0),
            "K": st.floats(0.05, 0.15),
        }
    )
)
def test_lines_of_any_letters_reach_to_the_sizes_they_give(letters: dict[str, float]) -> None:
    field = field_from_letters("any", letters)
    a, b, c, d, e, f, h, k = (letters[key] for key in "ABCDEFHK")
    edges = [
        (a / 2, 0.1),
        (a / 2 - e / 2, c / 2),
        (a / 2 - e, 0.1),
        (a / 2 - f / 2, d / 2),
        (a / 2 - f, 0.1),
        (h / 2, 0.0),
        (h / 2 + 0.2, b / 2),
    ]
    np.testing.assert_allclose(field.line_distances(edges), 0.5 * k, atol=1e-8)
    assert field.is_symmetric
    counts = [sum(c.kind.value == kind for c in field.crossings) for kind in "LTX"]
    assert counts == [12, 18, 2]


@pytest.mark.parametrize(
    ("letters", "words"),
    [
        ({"R": 1.0}, "letter R: is not one of the rulebook's, A to Q"),
        ({"A": -18.0}, "letter A, the field length: expected metres, found -18.0"),
        ({"B": math.nan}, "letter B, the field width: expected metres, found nan"),
        ({"A": 0.0}, "letter A, the field length: must be positive"),
        ({"K": 0.0}, "letter K, the line width: must be positive"),
        ({"C": 0.0}, "letters C, E: a penalty area needs both its width and its depth, or neither"),
        ({"F": 0.0}, "letters D, F: a goal area needs both its width and its depth, or neither"),
        ({"C": 14.0}, "letters C, B: the penalty area width of 14 m does not fit into the field width of 14 m"),
        ({"D": 6.9}, "letters D, C: the goal area width of 6.9 m does not fit into the penalty area width of 6.9 m"),
        ({"F": 2.25}, "letters F, E: the goal area depth of 2.25 m does not fit into the penalty area depth of 2.25 m"),
        ({"E": 11.0}, "letters E, A: the penalty area depth of 11 m does not fit into the field length of 22 m"),
        ({"H": 14.0}, "letters H, B: the centre circle diameter of 14 m does not fit into the field width of 14 m"),
        ({"G": 7.0}, "letters G, B: the corner arc radius of 7 m does not fit into the field width of 14 m"),
        ({"I": 11.0}, "letters I, A: the penalty mark of 11 m does not fit into the field length of 22 m"),
        ({"K": 0.8}, "letters K, F: the line width of 0.8 m does not fit into the goal area depth of 0.75 m"),
        ({"B": 2.6, "C": 0, "E": 0, "D": 0, "F": 0, "H": 0}, "letter B, the field width of 2.6 m: the goal of"),
    ],
)
def test_letters_that_make_no_field_are_refused(letters: dict[str, float], words: str) -> None:
    with pytest.raises(InputError) as caught:
        field_from_letters("f", letters)
    assert str(caught.value).startswith(words)


def test_a_base_without_letters_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "plain.yaml"
    FieldModel(name="plain", length=9, width=6, line_width=0.05, circles=[(0, 0, 1)]).to_yaml(path)
    with pytest.raises(InputError, match="has no rulebook letters to start from"):
        field_from_letters("f", {}, base=path)
