"""Every study's table with few and short runs is what it was: rows in lab/tests/studies.yaml.

`python lab/tests/test_studies.py [NAME…]` renews them. Numbers are compared to 2 % or a digit, words as they are.
"""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from touchline_lab.experiments import EXPERIMENTS, own_humanoids
from touchline_lab.experiments.harness import write_result

ROWS = Path(__file__).parent / "studies.yaml"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
SHORT: dict[str, dict[str, Any]] = {
    "xiong-samples": {},
    "xiong-kidnap": {"kidnap.PER_SEED": 1, "kidnap.SECONDS": 8.0},
    "xiong-convergence": {},
    "own-humanoids": {
        "own_humanoids.FIELDS": {"indoor-9x6": "coloured"}, "own_humanoids.RECORDINGS": (),
        "own_humanoids.CASES": own_humanoids.CASES[:1],
        "own_humanoids.SECONDS": 8.0, "own_humanoids.SECONDS_FROM_NOWHERE": 6.0, "own_humanoids.STARTS_FROM_NOWHERE": 1,
    },
    "schulz-accuracy": {
        "schulz_accuracy.SECONDS": 2.0, "schulz_accuracy.SECONDS_WITH_FALSE": 2.0,
        "schulz_accuracy.SECONDS_FROM_NOWHERE": 1.0, "schulz_accuracy.STARTS_FROM_NOWHERE": 1,
        "schulz_accuracy.FALSE_SHARES": (0.5,), "schulz_accuracy.FIELDS": {"indoor-9x6": "coloured goals, poles"},
    },
    "schulz-lines-only": {"schulz_lines_only.SECONDS": 2.0},
    "schulz-belief": {"schulz_belief.HEADINGS": 36},
    "schulz-imu": {},
    "schulz-games": {"schulz_games.GAMES": 1, "schulz_games.SECONDS": 33.0},
    "play": {"faulty_play.SECONDS": 10.0},
}  # fmt: skip
FAST = ("schulz-accuracy", "schulz-lines-only")


def rows_of(name: str, monkeypatch: pytest.MonkeyPatch, folder: Path) -> list[list[str]]:
    monkeypatch.setenv("TOUCHLINE_DATA", str(folder))
    monkeypatch.chdir(folder)
    for key, value in SHORT[name].items():
        module, _, constant = key.partition(".")
        monkeypatch.setattr(importlib.import_module(f"touchline_lab.experiments.{module}"), constant, value)
    result = EXPERIMENTS[name].run(1)
    assert all(path.stat().st_size for path in write_result(result, folder))
    assert {len(row) for row in result.rows} == {len(result.columns)}
    return [list(row) for row in result.rows]


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in FAST else pytest.mark.slow) for n in SHORT])
def test_a_studys_table_is_what_it_was(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    was = yaml.safe_load(ROWS.read_text(encoding="utf-8"))[name]
    now = rows_of(name, monkeypatch, tmp_path)
    assert [[NUMBER.sub("#", cell) for cell in row] for row in now] == [
        [NUMBER.sub("#", c) for c in row] for row in was
    ]
    for before, after in zip(was, now, strict=True):
        numbers = [[float(each) for cell in row for each in NUMBER.findall(cell)] for row in (before, after)]
        assert numbers[1] == pytest.approx(numbers[0], rel=0.02, abs=0.011), before[0]


if __name__ == "__main__":
    import tempfile

    known = yaml.safe_load(ROWS.read_text(encoding="utf-8")) if ROWS.exists() else {}
    for study in sys.argv[1:] or SHORT:
        with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as scratch:
            known[study] = rows_of(study, patch, Path(scratch))
    ROWS.write_text(yaml.safe_dump(known, allow_unicode=True, width=1000, default_flow_style=None), encoding="utf-8")
