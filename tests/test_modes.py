"""The mode of a fusing system: in estimates.csv, summary.json, the report and on the console; and nowhere else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from touchline.errors import InputError
from touchline.evaluation.estimates import COLUMNS, HEADER, read_estimates
from touchline.evaluation.run_folder import RunFolder
from touchline.geometry import Pose
from touchline.types import Estimate, Mode, Status

ALWAYS = "probability,twin_probability,end_probability,protection_m,protection_rad,statistics,reason"


def estimate(index: int, mode: Mode | None) -> Estimate:
    return Estimate(index * 100_000_000, Pose(0.1 * index, 0.0, 0.0), np.eye(3) * 1e-4, Status.TRACKING, mode=mode)


def written(folder: Path, modes: list[Mode | None]) -> Path:
    folder.mkdir()
    with RunFolder(folder) as rows:
        for index, mode in enumerate(modes):
            rows.write(estimate(index, mode))
    return folder / "estimates.csv"


def test_modes_are_written_and_come_back(tmp_path: Path) -> None:
    modes: list[Mode | None] = [Mode.OMNIVISION, Mode.BOTH, Mode.ODOMETRY]
    path = written(tmp_path / "run", modes)
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0] == f"{HEADER},mode,{ALWAYS}"
    assert [line.split(",")[len(COLUMNS)] for line in lines[1:]] == ["omnivision", "omnivision+odometry", "odometry"]
    table = read_estimates(path)
    assert table.has_modes
    assert [tuple(Mode)[k] for k in table.mode] == modes


def test_without_modes_the_columns_are_those_of_always(tmp_path: Path) -> None:
    for name, modes in (("plain", [None, None]), ("empty", [])):
        path = written(tmp_path / name, list(modes))
        assert path.read_text(encoding="utf-8").splitlines()[0] == f"{HEADER},{ALWAYS}"
        assert not read_estimates(path).has_modes


def test_an_unknown_mode_is_named_with_its_line(tmp_path: Path) -> None:
    path = written(tmp_path / "run", [Mode.BOTH, Mode.BOTH])
    path.write_text(path.read_text(encoding="utf-8").replace("omnivision+odometry,", "smell,"), encoding="utf-8")
    with pytest.raises(InputError, match=r"line 2: 'smell'"):
        read_estimates(path)
