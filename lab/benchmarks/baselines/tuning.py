"""Settings of a baseline by random search on the suite's robots for tuning: the least mean cost wins.

touchline bench export touchline-bench-1 INPUTS --first-seed 0 --robots 2
python lab/benchmarks/baselines/tuning.py amcl INPUTS 30
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from exchange import Drive, read_drive

from touchline_lab.bench.exchange import Answers, track_of_answers
from touchline_lab.bench.scoring import score_of
from touchline_lab.bench.suite import Entry, open_suite

SEARCHED = {
    "amcl": {"sigma_m": (0.05, 0.3), "random_ratio": (0.02, 0.4), "power": (0.05, 1.0), "travel": (0.03, 0.3),
             "turn": (0.03, 0.3), "slow": (0.002, 0.1), "fast": (0.05, 0.6), "tracked_m": (0.1, 0.5)},
    "marker_search": {"fits_m": (0.1, 0.6), "fits_per_m": (0.01, 0.15), "near_m": (0.4, 3.0), "lost_s": (1.0, 8.0),
                      "gain": (0.1, 1.0)},
}  # fmt: skip
WHOLE = {"marker_search": {"min_markers": (2, 3, 4)}}


def main(name: str, inputs: Path, trials: int) -> None:
    """The first trial is the settings as they are."""
    module, rng = importlib.import_module(name), np.random.default_rng(0)
    suite = open_suite("touchline-bench-1")
    chosen = []
    for row in suite.rows:
        for robot in range(*suite.tuning):
            entry = Entry(row, robot)
            if (inputs / entry.name).is_dir() and (name == "amcl" or row.track == "humanoid"):
                drive = entry.drive()
                assert drive is not None
                chosen.append((entry, drive, read_drive(inputs / entry.name)))
    best_cm = np.inf
    for trial in range(trials):
        settings = module.Settings()
        if trial:
            low_high = SEARCHED[name].items()
            drawn: dict[str, Any] = {key: float(np.exp(rng.uniform(*np.log(ends)))) for key, ends in low_high}
            drawn |= {key: int(rng.choice(values)) for key, values in WHOLE.get(name, {}).items()}
            settings = replace(settings, **drawn)
        costs = [cost(module, settings, entry, drive, read) for entry, drive, read in chosen]
        if (mean_cm := 100.0 * float(np.mean(costs))) < best_cm:
            best_cm = mean_cm
            print(f"trial {trial}: {mean_cm:.1f} cm, {settings}", flush=True)


def cost(module: Any, settings: Any, entry: Entry, drive: Any, read: Drive) -> float:
    """Of one drive."""
    answers = list(module.follow(read, settings))
    poses, covariances, tracking = (np.array(column) for column in zip(*answers, strict=True))
    stamps = np.rint(1e9 * drive.times_s).astype(np.int64)
    track = track_of_answers(drive.times_s, drive.truth, Answers(stamps, poses, tracking, covariances))
    return score_of(track, entry.moments_s(drive), entry.row.either_end).cost_m


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]))
