"""What the tests of simulated scenarios share."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from touchline.geometry import Pose
from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.robot.track import STEP_S, Track
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

NAMES = (
    "calibration-strip", "chessboard", "humanoid-fisheye", "humanoid-walk", "kidnap", "light-changes", "lighting-1",
    "lighting-2", "lighting-3", "marked-points", "match", "match-day", "occlusion-12", "occlusion-25", "occlusion-50",
    "straight-tracks", "tour-20", "walk-in-place", "worn-hall",
)  # fmt: skip
SECONDS = {"calibration-strip": 3.5, "chessboard": 4.0, "kidnap": 2.6, "marked-points": 3.0, "walk-in-place": 1.0}


def shortened(name: str, seconds: float | None = None, seed: int | None = None) -> Simulation:
    """A scenario at reduced length, its robot as designed."""
    return Simulation(open_scenario(name, seed, seconds or SECONDS.get(name, 1.5), ["ideal=true"]))


class Recordings(dict[str, Path]):
    """Every scenario at reduced length, written when first asked for: no process writes what its tests do not need."""

    def __init__(self, parent: Path) -> None:
        super().__init__()
        self.parent = parent

    def __missing__(self, name: str) -> Path:
        self[name] = self.parent / name
        write_recording(shortened(name), self[name])
        return self[name]


def content(folder: Path) -> dict[str, str]:
    """Each file of a folder with a fingerprint of its bytes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def scenario_file(folder: Path, text: str) -> Path:
    """A scenario of one's own."""
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def table(path: Path) -> list[dict[str, str]]:
    """A CSV file as one mapping for each row."""
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    return [dict(zip(header.split(","), row.split(","), strict=True)) for row in rows]


def standing_track(pose: Pose, seconds: float) -> Track:
    """A robot that doesn't move."""
    n = round(seconds / STEP_S) + 1
    zeros = np.zeros((n, 3))
    poses = np.tile(pose.as_array(), (n, 1))
    return Track(poses, zeros, zeros.copy(), np.zeros((n, 2)), np.zeros(n, dtype=np.bool_))
