"""Settings and the YAML files that hold them."""

from __future__ import annotations

from pathlib import Path

import pytest

from touchline.calibration.colour import read_regions
from touchline.camera import open_camera
from touchline.config import Settings, load_settings, settings_from_mapping
from touchline.errors import InputError
from touchline.field import open_field
from touchline.files.yaml_text import read_yaml, yaml_line
from touchline.sources import open_source


class Wheel(Settings):
    radius_m: float = 0.1
    driven: bool = True
    teeth: int | None = None
    places: tuple[tuple[float, float], ...] = ()


class Robot(Settings):
    name: str = ""
    wheel: Wheel = Wheel()
    wheels: tuple[Wheel, ...] = ()


def yaml_file(folder: Path, text: str, name: str = "robot.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "wheel:\n  driven: no\n  radius_m: yes",
            r"robot.yaml, line 3: wheel.radius_m: a number is wanted, not true or",
        ),
        (
            "wheel: {teeth: off}",
            r"robot.yaml, line 1: wheel.teeth: a number is wanted, not true or false \(got False\)",
        ),
        ("wheels:\n- teeth: 3\n- places:\n  - [1, 2]\n  - [1, on]", r"line 3: wheels.1.places: a number is wanted"),
        ("wheel:\n\n  radius_m: wide", r"robot.yaml, line 3: setting 'wheel.radius_m': input should be a valid number"),
        (
            "wheels:\n- teeth: 3\n- teath: 3",
            r"robot.yaml, line 3: unknown setting 'wheels.1.teath': did you mean 'wheels.1.teeth'",
        ),
        ("wheel: {teeth: none}", r"setting 'wheel.teeth': .* \(got 'none'\); none is written null"),
        ("name: 1\nwheel:\n  radius_m: [", r"robot.yaml, line 4: is not valid YAML"),
    ],
)
def test_what_does_not_fit_is_told_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_settings(Robot, yaml_file(tmp_path, text))


def test_truths_are_truths_where_a_truth_is_wanted(tmp_path: Path) -> None:
    settings = load_settings(Robot, yaml_file(tmp_path, "wheel: {driven: no, teeth: 3, places: [[1, 2.5]]}"))
    assert settings.wheel == Wheel(driven=False, teeth=3, places=((1.0, 2.5),))


TWICE = "line 3: 'width' stands in line 1 already; keep one"


def test_a_key_that_stands_twice_is_refused_in_every_kind_of_file(tmp_path: Path) -> None:
    path = yaml_file(tmp_path, "width: 1\nheight: 2\nwidth: 3", "field.yaml")
    for reader in (read_yaml, open_field, open_camera, read_regions, lambda file: load_settings(Robot, file)):
        with pytest.raises(InputError, match=f"field.yaml, {TWICE}"):
            reader(path)
    recording = tmp_path / "recording"
    recording.mkdir()
    yaml_file(recording, "width: 1\nheight: 2\nwidth: 3", "sequence.yaml")
    with pytest.raises(InputError, match=f"sequence.yaml, {TWICE}"):
        open_source(recording)


def test_keys_may_come_again_in_another_mapping_and_over_merged_ones(tmp_path: Path) -> None:
    text = "base: &base {a: 1, b: 2}\none: {a: 1}\ntwo:\n  <<: *base\n  a: 3"
    assert read_yaml(yaml_file(tmp_path, text))["two"] == {"a": 3, "b": 2}
    assert read_yaml(yaml_file(tmp_path, text))["one"] == {"a": 1}
    inside = "base: &base {a: 1}\nover:\n  two: &two\n    <<: *base\n    a: 3\nthree: {<<: *two}"
    assert read_yaml(yaml_file(tmp_path, inside))["three"] == {"a": 3}


@pytest.mark.parametrize("text", ["2026-13-45", "!!float x", "0b_"])
def test_what_only_looks_like_a_date_or_a_number_is_told(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"robot\.yaml, line 1: holds a value that cannot be read"):
        read_yaml(yaml_file(tmp_path, f"name: {text}"))
    with pytest.raises(InputError, match=r"--set name=.*not readable"):
        load_settings(Robot, None, [f"name={text}"])


def test_the_line_of_an_entry_is_that_of_the_nearest_one_that_is_there(tmp_path: Path) -> None:
    path = yaml_file(tmp_path, "a:\n  b:\n  - 1\n  - c: 2\n\nd: 3")
    assert [yaml_line(path, keys) for keys in (["a", "b", 1, "c"], ["a", "b", 5], ["d", "e"], ["f"])] == [4, 2, 6, None]
    assert yaml_line(tmp_path / "nowhere.yaml", ["a"]) is None


class Drive(Settings):
    wheel: Wheel = Wheel()
    slack_m: float = 0.0


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("slak_m", "did you mean 'slack_m'"),
        ("wheel.radius", "did you mean 'wheel.radius_m'"),
        ("grease", "known: slack_m, wheel"),
    ],
)
def test_an_unknown_key_is_refused_with_what_is_known(key: str, said: str) -> None:
    with pytest.raises(InputError, match=f"unknown setting '{key}': {said}"):
        load_settings(Drive, None, [f"{key}=1"])
    with pytest.raises(InputError, match=f"settings: unknown setting '{key}': {said}"):
        settings_from_mapping(Drive, {key: 1})
