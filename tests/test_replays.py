"""What each system makes of recorded drives stays what it is: facts of `replays.yaml`, and golden trajectories."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from drives import FOLDER
from replays import GOLDENS, MACHINE, POSE_UNIT, facts_of, name_of, replayed, rows, trajectory

SAME_M, NEAR_M = 1e-6, 0.01  # by how much poses may differ: on the machine named in the golden file, elsewhere
SAME_RATIO = 1e-4  # of all else, on that machine
MAX_DRIVES_BYTES = 4_000_000


@cache
def goldens() -> dict[str, Any]:
    return dict(np.load(GOLDENS))


@pytest.mark.parametrize("row", [pytest.param(row, id=name_of(row)) for row in rows()])
def test_a_replay_gives_what_it_gave(row: dict[str, Any]) -> None:
    estimates, truth = replayed(row)
    golden = [goldens()[f"{name_of(row)}, {part}"] for part in ("poses", "others")]
    found, facts, same = trajectory(estimates), facts_of(estimates, truth), str(goldens()["machine"]) == MACHINE
    assert found[0].shape == golden[0].shape
    away = POSE_UNIT * np.abs(found[0] - golden[0])
    if same:
        differs = (away > SAME_M).any(axis=0) | ~np.isclose(found[1], golden[1], SAME_RATIO, 1e-7, equal_nan=True).all(
            axis=0
        )
        assert not differs.any(), f"other from image {np.argmax(differs)} on; `make goldens` if that is right"
    else:
        assert np.median(np.hypot(*away[:2])) < NEAR_M
    assert facts.codes == row["codes"]
    assert facts.wrong <= row["wrong"] + (0 if same else 0.05 * len(estimates))
    assert (facts.error_m is None) == (row["error_m"] is None)
    assert facts.error_m is None or facts.error_m <= row["error_m"]


def test_drives_are_small_and_all_are_replayed() -> None:
    files = list(FOLDER.glob("*.npz"))
    assert sum(path.stat().st_size for path in files) < MAX_DRIVES_BYTES
    assert {path.stem for path in files} == {row["drive"] for row in rows() if "drive" in row}
    assert len(rows()) == len({name_of(row) for row in rows()})
