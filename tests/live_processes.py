"""`touchline live` in a process of its own, killed in the middle: `make processes`."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np


def benchmark() -> Any:
    path = Path(__file__).parents[1] / "lab" / "benchmarks" / "live_link.py"
    spec = importlib.util.spec_from_file_location("live_link", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_killed_in_the_middle_a_new_process_relocalises_and_goes_on() -> None:
    live = benchmark()
    played = live.play(seconds=30.0, rate_hz=15.0, system="nubot-mti", trouble=live.Trouble(kill_at_s=5.0))
    again = live.tracking_again(played, played.killed_s)
    assert again is not None
    after_s, _, off_m = again
    assert after_s < 20.0
    assert off_m < 0.1
    last = list(played.answers)[-100:]
    assert np.median([live.off_m(played, stamp) for stamp in last]) < 0.03
