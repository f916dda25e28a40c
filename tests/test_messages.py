"""The words that messages are put together from."""

from __future__ import annotations

from touchline.messages import counted, frames_in_words, length_unit, listed, without_numbers


def test_the_unit_of_a_length() -> None:
    units = [length_unit(number, 60.0) for number in (900.0, 6000.0, 6001.0, 18000.0)]
    assert units == ["centimetres", "centimetres", "millimetres", "millimetres"]


def test_things_are_listed_and_counted() -> None:
    assert [listed(["a", "b", "c"][:count]) for count in range(4)] == ["", "a", "a and b", "a, b and c"]
    assert [counted(count, "image") for count in range(3)] == ["0 images", "1 image", "2 images"]
    assert frames_in_words([3]) == "frame 3"
    assert frames_in_words([3, 4], shown=2) == "frames 3, 4"
    assert frames_in_words([3, 4, 9, 10], shown=2) == "frames 3, 4 and 2 more"
    assert without_numbers("frame 12 is 0.25 s late") == "frame … is … s late"
