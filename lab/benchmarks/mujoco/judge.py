"""Systems on walks in RoboCup's MuJoCo soccer server: errors, NEES, wrong while tracking.

    python lab/benchmarks/mujoco/judge.py hall [--walks 10] [--seconds 20] [--systems touchline,nimbro-lines] [--keep D]
    python lab/benchmarks/mujoco/judge.py percepts [--walks 100] [--seconds 60] [--calm]

Each walk is made (walks.py), kept where --keep says so, and localised from its true start; walks that are kept already
are not made again. Needs `pip install 'touchline-lab[mujoco]'`.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import touchline
from touchline.evaluation.metrics import errors_given_end
from touchline.types import Status

WRONG_M, WRONG_RAD = 0.5, np.radians(15.0)
FIRST_SEED = 100  # of the walks that judge


class Walk(NamedTuple):
    """One walk: errors (N, 3) (m, m, rad), where the end is open those of the nearer twin; their NEES over three (N,);
    which of its images were tracked (N,).
    """

    errors: np.ndarray
    nees: np.ndarray
    tracked: np.ndarray

    @property
    def wrong(self) -> np.ndarray:
        """(N,) which images were tracked at a wrong place."""
        off = (np.hypot(*self.errors[:, :2].T) > WRONG_M) | (np.abs(self.errors[:, 2]) > WRONG_RAD)
        return self.tracked & off


def localized(recording: Path, system: str, folder: Path) -> Walk:
    """One system on one walk, from its true start."""
    source = touchline.open_source(recording)
    assert source.truth is not None
    truth = source.truth.samples()
    run = touchline.run(recording, system, output=folder, start=truth.values[0].tolist())
    table = run.estimates
    errors = errors_given_end(table.trajectory, truth, table.end_open).values
    covariances = table.covariance[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3).astype(np.float64)
    nees = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariances + 1e-12 * np.eye(3)), errors) / 3.0
    return Walk(errors, nees, table.has_status(Status.TRACKING))


def made(kind: str, seeds: range, seconds: float, calm: bool, folder: Path) -> Iterator[Path]:
    """The walks, made where they are missing."""
    for seed in seeds:
        path = folder / f"{kind}-{seed}"
        if not (path / "sequence.yaml").exists():  # the last file of a walk
            shutil.rmtree(path, ignore_errors=True)
            program = [sys.executable, str(Path(__file__).with_name("walks.py")), str(path), "--world", kind]
            given = ["--seconds", str(seconds), "--seed", str(seed), *(["--calm"] if calm else [])]
            subprocess.run([*program, *given], check=True, stderr=subprocess.DEVNULL)
        yield path


def row(system: str, walks: list[Walk]) -> str:
    """A system's line of the table."""
    tracked = [np.hypot(*walk.errors[walk.tracked, :2].T) for walk in walks]
    medians = [100.0 * float(np.median(each)) for each in tracked if len(each)]
    late = [100.0 * float(np.quantile(each, 0.95)) for each in tracked if len(each)]
    nees = [float(np.mean(walk.nees[walk.tracked])) for walk in walks if walk.tracked.any()]
    images, count = sum(len(walk.tracked) for walk in walks), sum(int(walk.tracked.sum()) for walk in walks)
    wrong = sum(int(walk.wrong.sum()) for walk in walks)
    spread = f"{np.median(medians):.1f} ({min(medians):.1f} to {max(medians):.1f}) | {np.median(late):.1f}"
    return f"| {system} | {len(walks)} | {spread} | {np.median(nees):.2f} | {100.0 * count / images:.1f} | {wrong} |"


def main() -> None:
    """What the head of this file says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("hall", "percepts"))
    parser.add_argument("--walks", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--systems", default="touchline,nimbro-lines")
    parser.add_argument("--calm", action="store_true")
    parser.add_argument("--keep", type=Path)
    given = parser.parse_args()
    systems = given.systems.split(",")
    walks: dict[str, list[Walk]] = {system: [] for system in systems}
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        seeds = range(given.first_seed, given.first_seed + given.walks)
        for number, path in enumerate(made(given.kind, seeds, given.seconds, given.calm, folder)):
            for system in systems:
                walks[system].append(localized(path, system, Path(scratch) / f"{system}-{number}"))
                print(path.name, row(system, walks[system][-1:]), flush=True)
    print(
        "\n| system | walks | median (cm; min to max) | 95 % (cm) | NEES/3 | tracked (%) | wrong, tracking (images) |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|")
    for system in systems:
        print(row(system, walks[system]))


if __name__ == "__main__":
    main()
