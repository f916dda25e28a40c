"""lu2013-exposure: rows, pictures and counts, on a coarse grid in one place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from touchline.camera.exposure import ExposureSettings
from touchline.sources import open_source
from touchline_lab.experiments import EXPERIMENTS, lu2013_exposure
from touchline_lab.experiments.harness import write_result


def test_the_experiment_draws_surface_path_and_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lu2013_exposure, "_GRID", 5)
    monkeypatch.setattr(lu2013_exposure, "_STEP_STOPS", 0.5)
    monkeypatch.setattr(lu2013_exposure, "public_recording", lambda name: None)
    result = EXPERIMENTS["lu2013-exposure"].run(seeds=1)
    named = [(robot, name) for robot in ("robot as built", "ideal robot") for name in lu2013_exposure.CASES]
    assert [row[:2] for row in result.rows] == named
    for rows in (result.rows[:3], result.rows[3:]):
        lamps, dull, sun = (float(row[4]) for row in rows)
        assert sun < lamps < dull  # more light, shorter exposure
    assert " of 6 searches" in result.notes[0]
    assert "not found" in result.notes[-1]
    files = write_result(result, tmp_path)
    assert {f"lu2013-exposure-{name}.png" for name in ("surface", "path", "images")} <= {file.name for file in files}


def test_the_recorded_places_come_with_their_lightings(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lu2013_exposure, "_STEP_STOPS", 1.0)
    recording = open_source(shared_data / "omni_exposure")
    places = lu2013_exposure._recorded_cases(recording, ExposureSettings())
    assert [[case.name for case in cases] for cases in places] == [["dim", "lamps", "sun"]] * (len(recording) // 3)
    assert all(np.all(np.isfinite(case.entropy)) for cases in places for case in cases)
    assert all(cases[0].peak > cases[1].peak >= cases[2].peak for cases in places)
    lamps, sun = places[0][1:]
    change = lu2013_exposure._change(lamps, sun, ExposureSettings(check_every=1))
    assert abs(change.loss) <= 0.0057  # the search's entropy is over the same ring as the curve's
