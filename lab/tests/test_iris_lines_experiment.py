"""iris-lines and iris-timing, with fewer runs than by default."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from touchline.field import open_field
from touchline_lab.experiments import EXPERIMENTS, iris_lines, timing
from touchline_lab.experiments.harness import write_result
from touchline_lab.simulation.world.calibration_layout import STRIP_EDGES_M


@pytest.fixture(scope="module")
def place() -> tuple[object, dict[tuple[str, str], iris_lines.Detection]]:
    return iris_lines._one_place(open_field(iris_lines.FIELD), 0, ideal=True)


@pytest.mark.parametrize("condition", iris_lines.CONDITIONS)
def test_the_same_settings_serve_in_every_light(
    place: tuple[object, dict[tuple[str, str], iris_lines.Detection]], condition: str
) -> None:
    found = place[1][condition, "automatic"]
    assert len(found.points) >= 90
    assert np.mean(found.distances_m > iris_lines.FALSE_M) <= 0.0169
    assert np.median(found.distances_m) < 0.0018
    assert np.quantile(found.distances_m, 0.9) < 0.016


def test_thresholds_of_another_light_fail_as_the_paper_says(
    place: tuple[object, dict[tuple[str, str], iris_lines.Detection]],
) -> None:
    one, _, dim = iris_lines.CONDITIONS
    assert len(place[1][one, "set by hand under 1"].points) >= 90
    assert len(place[1][dim, "set by hand under 1"].points) == 0


def test_the_regression_ends_at_its_last_pair(
    place: tuple[object, dict[tuple[str, str], iris_lines.Detection]],
) -> None:
    for found in place[1].values():
        assert np.all(np.hypot(*found.points.positions_m.T) < STRIP_EDGES_M[-1] + 0.2)


def test_the_page_holds_a_row_for_each_light_and_kind_of_thresholds(
    place: tuple[object, dict[tuple[str, str], iris_lines.Detection]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(iris_lines, "_one_place", lambda *_, **__: place)
    found = EXPERIMENTS["iris-lines"].run(1)
    assert [row[:2] for row in found.rows] == [(c, t) for c in iris_lines.CONDITIONS for t in iris_lines.THRESHOLDS]
    assert [name for name, _ in found.pictures] == ["detection", "points", "regression"]
    assert len(write_result(found, tmp_path)) == 5


def test_timing_reports_the_update_its_parts_and_other_numbers_of_particles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "UPDATES", 120)
    monkeypatch.setattr(timing, "IMAGES", 10)
    monkeypatch.setattr(timing, "PARTICLES", (100, 600, 1000))
    found = timing.iris_timing(1)
    assert [row[0].partition(":")[0] for row in found.rows[:2]] == ["one update", "of it"]
    assert found.rows[0][1] == "1.6 ms"
    assert len(found.rows) == 3 + len(timing.PARTICLES)
    assert float(found.rows[0][3].split()[0]) > float(found.rows[1][3].split()[0])
