"""Photographs of a real field, where they are found: their lines are found, a white goal is none, poses are right."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
from conftest import FULL_DATA

PHOTOGRAPHS = sorted((FULL_DATA / "real" / "spl_photos").glob("*.jpg"))


def labelled_lines_are_found_and_a_white_goal_is_none() -> None:
    """Every sixth of them; `python benchmarks/spl_photos.py` prints the figures of all."""
    spec = importlib.util.spec_from_file_location("spl_photos", Path(__file__).parents[1] / "benchmarks/spl_photos.py")
    assert spec is not None
    assert spec.loader is not None
    spl_photos = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = spl_photos  # dataclasses look themselves up
    spec.loader.exec_module(spl_photos)
    scores = spl_photos.measure(PHOTOGRAPHS[::6])
    assert scores.found >= 0.75 * scores.labelled
    assert np.median(scores.angles_deg) <= 3.0
    assert 0.5 <= np.median(scores.gaps_m) <= 0.65
    assert len(scores.goal_frames) <= 1
    assert scores.refused == 0
    assert sum(off_m < 0.15 for off_m in (*scores.sure_m, *scores.doubted_m)) >= 5
    assert max(scores.sure_m) < 0.25


if PHOTOGRAPHS:  # they are GPL and none of the project's
    test_labelled_lines_are_found_and_a_white_goal_is_none = labelled_lines_are_found_and_a_white_goal_is_none
