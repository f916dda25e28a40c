"""What the tests of simulated scenarios share."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from touchline.camera import OmniCamera
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.sources import Recording
from touchline.systems import RobotSetup, open_system
from touchline.types import Status
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


def errors_of(source: Simulation | Recording, camera: OmniCamera) -> FloatArray:
    """(N, 2) how far nubot-mti is from the truth, distance (m) and heading (rad), in the frames in which it tracks."""
    system = open_system("nubot-mti", RobotSetup(source.field, camera))
    assert source.truth is not None
    errors = []
    for index, frame in enumerate(source):
        estimate, truth = system.step(frame), source.truth[index]
        if estimate.status is Status.TRACKING:
            turned = abs(wrap_angle(estimate.pose.heading - truth.heading))
            errors.append((estimate.pose.distance_to(truth), turned))
    return np.array(errors).reshape(-1, 2)


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
