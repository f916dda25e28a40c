"""`touchline fields measure`: the sizes that differ are found with an honest deviation, what was not seen is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from line_scenes import view

from touchline.calibration.field_sizes.fit import nearest_lines
from touchline.calibration.field_sizes.measure import FieldMeasurement, Verdict, measure_field
from touchline.calibration.field_sizes.sizes import line_velocities, sizes_of
from touchline.cli import main
from touchline.errors import NoFitError
from touchline.field import FieldModel, field_from_letters, open_field
from touchline.geometry import Pose
from touchline.types import LinePoints

RULES = open_field("msl-18x12")


def seen_points(field: FieldModel, places: int, seed: int = 0, scale: float = 1.0) -> list[LinePoints]:
    """What a robot sees from places all over a field, with ranges that are too long by a factor and a shaking head."""
    rng, seen = np.random.default_rng(seed), []
    for _ in range(places):
        pose = Pose(rng.uniform(-7.5, 7.5), rng.uniform(-4.5, 4.5), rng.uniform(-3.0, 3.0))
        points = view(field, pose, rng, count=120, reach_m=7.5, noise=0.01, clutter=0.05)
        points = scale * points * (1.0 + points @ (0.003 * rng.standard_normal(2)))[:, np.newaxis]
        variances = (0.01 + 0.01 * np.hypot(*points.T)) ** 2
        covariances = np.eye(2) * variances[:, np.newaxis, np.newaxis]
        seen.append(LinePoints(points, covariances, np.ones(len(points)), np.full_like(points, np.nan)))
    return seen


def by_letter(found: FieldMeasurement) -> dict[str, tuple[float, float, Verdict]]:
    return {one.size.letter: (one.change_m, one.deviation_m, one.verdict) for one in found.sizes}


@pytest.fixture(scope="module")
def venue() -> FieldModel:
    """12 cm longer than the rules say, its circle 5 cm smaller in radius."""
    return field_from_letters("venue", {"A": 18.12, "H": 3.9}, RULES)


def test_a_longer_field_with_a_smaller_circle_is_found(venue: FieldModel) -> None:
    """By a camera whose ranges are 0.4 % too long."""
    found = measure_field(seen_points(venue, 32, scale=1.004), RULES, 0.005, "measured")
    sizes = by_letter(found)
    for letter, change_m in (("A", 0.12), ("H", -0.10)):
        change, deviation, verdict = sizes[letter]
        assert verdict is Verdict.OTHERWISE
        assert change == pytest.approx(change_m, abs=2.0 * deviation)
        assert deviation < 0.04
    assert all(sizes[letter][2] is Verdict.AS_GIVEN for letter in "BCEF")
    assert found.field.name == "measured"
    assert found.field.length == pytest.approx(18.12, abs=0.06)
    assert found.field.width == RULES.width
    assert found.field.circles[0, 2] == pytest.approx(1.9375 - 0.05, abs=0.02)


def test_a_field_by_the_rules_is_left() -> None:
    found = measure_field(seen_points(RULES, 10), RULES)
    assert Verdict.OTHERWISE not in [one.verdict for one in found.sizes]
    assert np.array_equal(found.field.segments, RULES.segments)


@pytest.mark.slow
def test_a_larger_field_is_not_told_from_longer_ranges() -> None:
    found = measure_field(seen_points(RULES, 12, scale=1.012), RULES)
    assert Verdict.OTHERWISE not in [one.verdict for one in found.sizes]
    assert found.fit.scale == pytest.approx(-0.012, abs=0.003)


def test_what_was_not_seen_is_said() -> None:
    """From the middle neither goal line is in view."""
    near = [points.usable(3.0) for points in seen_points(RULES, 40, seed=3)]
    seen = [points for points in near if len(points) > 40]
    sizes = by_letter(measure_field(seen[:10], RULES))
    assert sizes["A"][2] is Verdict.NOT_OBSERVED


def test_another_field_is_refused() -> None:
    with pytest.raises(NoFitError, match="none of 4 observations fits spl-9x6"):
        measure_field(seen_points(RULES, 4), open_field("spl-9x6"))


def test_a_field_without_letters_is_measured_by_its_lines(venue: FieldModel) -> None:
    plain = replace(RULES, letters={}, segments=RULES.segments[[0, 1, 2, 3, 4]])
    sizes = sizes_of(plain)
    assert not sizes.lettered
    assert next(size.meaning for size in sizes.sizes) == "between the lines at x = ± 8.94 m"
    moved = sizes.field(np.array([0.1, -0.06, 0.02]))
    assert moved.length == pytest.approx(18.1)
    assert moved.width == pytest.approx(11.94)
    assert moved.circles[0, 2] == pytest.approx(1.9375 + 0.01)
    assert np.abs(moved.segments[:, 0]).max() == pytest.approx(8.9375 + 0.05)
    assert sizes_of(replace(RULES, letters={})).lettered  # the lines are a preset's


def test_distances_change_with_the_sizes_as_their_derivatives_say() -> None:
    sizes = sizes_of(RULES)
    rng, change = np.random.default_rng(0), np.array([0.05, -0.04, 0.03, 0.02, -0.03, 0.01, 0.04])
    points = rng.uniform((-9.3, -6.3), (9.3, 6.3), (300, 2))
    before, _, moves = nearest_lines(RULES, points, line_velocities(sizes, np.zeros(7)))
    after, _, _ = nearest_lines(sizes.field(1e-3 * change), points, line_velocities(sizes, np.zeros(7)))
    told = np.isfinite(before) & np.isfinite(after) & (np.abs(after - before) < 0.01)
    assert np.count_nonzero(told) > 100
    np.testing.assert_allclose((before - after)[told], 1e-3 * (moves @ change)[told], atol=1e-5)


@pytest.mark.slow
def test_the_command_prints_each_size_and_writes_the_field(
    small_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "hall.yaml"
    recording = small_data / "omni_9x6_points"
    assert main(["fields", "measure", str(recording), "--output", str(output)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "H centre circle diameter 1.500 1.49" in said or "H centre circle diameter 1.500 1.50" in said
    assert "No size is surely otherwise." in said
    assert "right to ± 1.0 % (--range-error)" in said
    assert open_field(output).name == "hall"
    assert main(["fields", "measure", str(recording), "--output", str(output)]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize("wrong", ["hsl-m-14x9"])
def test_the_right_field_is_named(wrong: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some views fit by the lines that both fields share: sizes from these alone would be the wrong field's."""
    monkeypatch.setattr("touchline.calibration.field_sizes.measure.preset_names", lambda: ("spl-9x6", "msl-18x12"))
    with pytest.raises(NoFitError, match=rf"of 12 observations fits? {wrong} .*: --field msl-18x12"):
        measure_field(seen_points(RULES, 12), open_field(wrong))
