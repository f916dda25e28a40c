"""Replays: what each system makes of recorded drives and short recordings. `replays.yaml` lists them with their facts.

A row of the list: `drive` (of tests/data/drives) or `recording` (of tests/data), `system`, and where they differ from
the usual `settings`, `preset`, `start` (nothing, own half, zone, true), `without` (what of a frame is hidden), `forget`
(the images before which the system is reset), `images` (so many alone), `every` (one in so many).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml
from drives import Drive, open_drive
from llvmlite.binding import get_host_cpu_name

from touchline.config import load_settings
from touchline.errors import NoFitError
from touchline.evaluation.runner import robot_setup
from touchline.geometry import FloatArray, IntArray, Pose, wrap_angle
from touchline.localization.one_shot.locate import locate
from touchline.sources import open_source
from touchline.systems import RobotSetup, open_system, system_info
from touchline.systems.ordered import OrderedSystem
from touchline.types import Estimate, Frame, Prior, Status

DATA = Path(__file__).parent / "data"
LIST, GOLDENS = Path(__file__).with_name("replays.yaml"), DATA / "goldens" / "replays.npz"
ZONE = np.diag([2.0, 2.0, 1.0])
WRONG_M, WRONG_RAD = 0.5, math.radians(15.0)
POSE_UNIT = 1e-7  # m, rad
LOOK_EVERY = 16  # images after which a golden file keeps where to look
FACTS = ("error_m", "wrong", "codes")
MACHINE = f"NumPy {np.__version__}, OpenCV {cv2.__version__}, {get_host_cpu_name()}"


class Facts(NamedTuple):
    """error_m: mean error of tracked poses, None without any. wrong: how many of them are more than 0.5 m or 15° off.

    codes: of all problems reported.
    """

    error_m: float | None
    wrong: int
    codes: list[str]


class Locating:
    """`locate` as a system: each image alone."""

    def __init__(self, setup: RobotSetup) -> None:
        self.setup = setup

    def reset(self, prior: Prior | None = None) -> None: ...

    def step(self, frame: Frame) -> Estimate:
        assert frame.observation is not None
        try:
            found = locate(frame.observation, self.setup.field, camera=self.setup.camera)
        except NoFitError:
            return Estimate(frame.stamp_ns, Pose(0.0, 0.0, 0.0), np.eye(3), Status.LOST)
        status = Status.SEARCHING if found.doubts or found.hypotheses else Status.TRACKING
        chance = found.chance.significance
        return Estimate(
            frame.stamp_ns, found.pose, found.covariance, status, found.mean_distance_m, found.points,
            found.hypotheses, statistics={"chance": chance},
        )  # fmt: skip


def rows() -> list[dict[str, Any]]:
    """All rows of the list."""
    return list(yaml.safe_load(LIST.read_text(encoding="utf-8")))


def name_of(row: Mapping[str, Any]) -> str:
    """A row in words: all but its facts."""
    first, system, *more = (key for key in row if key not in FACTS)
    return ", ".join((f"{row[first]}: {row[system]}", *(f"{key} {row[key]}" for key in more)))


@lru_cache(maxsize=2)
def source_of(drive: str | None, recording: str | None) -> Drive:
    """What a row replays."""
    if drive is not None:
        return open_drive(drive)
    source = open_source(DATA / str(recording))
    assert source.truth is not None
    frames = list(source)
    kept = [k for k, frame in enumerate(frames) if k < len(source.truth)]
    truth = np.array([source.truth[k] for k in kept])
    return Drive(robot_setup(source), [frames[k] for k in kept], truth, None)


def replayed(row: Mapping[str, Any]) -> tuple[list[Estimate], FloatArray]:
    """The estimates of a row, and the true poses (N, 3)."""
    of = source_of(row.get("drive"), row.get("recording"))
    chosen = slice(None, row.get("images"), row.get("every"))
    system = OrderedSystem(opened(row, of.setup))
    system.reset(start_of(row.get("start", "as recorded"), of))
    estimates = []
    for k, frame in enumerate(of.frames[chosen]):
        if k in row.get("forget", ()):
            system.reset()
        estimates.append(system.step(replace(frame, **hidden(row.get("without", ())))))
    return estimates, of.truth[chosen]


def opened(row: Mapping[str, Any], setup: RobotSetup) -> Any:
    """The system of a row."""
    if "camera" in row.get("without", ()):
        setup = replace(setup, camera=None)
    if "height" in row.get("without", ()):
        setup = replace(setup, height_m=None)
    if row["system"] == "locate":
        return Locating(setup)
    kind = system_info(row["system"]).settings
    changes = [f"{key}={value}" for key, value in row.get("settings", {}).items()]
    return open_system(row["system"], setup, load_settings(kind, None, changes, preset=row.get("preset")))


def hidden(names: Iterable[str]) -> dict[str, Any]:
    return {name: () if name in ("game", "evidence") else None for name in names if name not in ("camera", "height")}


def start_of(said: Any, of: Drive) -> Prior | None:
    if said == "as recorded":
        return of.start
    if said in ("true", "zone"):
        return Prior(Pose(*of.truth[0].tolist()), covariance=ZONE if said == "zone" else None)
    return {"nothing": None, "own half": Prior(own_half=True)}[said]


def facts_of(estimates: Sequence[Estimate], truth: FloatArray) -> Facts:
    """What must stay."""
    tracked = [
        (e.pose, Pose(*t)) for e, t in zip(estimates, truth.tolist(), strict=True) if e.status is Status.TRACKING
    ]
    away_m = [pose.distance_to(true) for pose, true in tracked]
    turned = [abs(wrap_angle(pose.heading - true.heading)) for pose, true in tracked]
    wrong = sum(m > WRONG_M or rad > WRONG_RAD for m, rad in zip(away_m, turned, strict=True))
    return Facts(float(np.mean(away_m)) if away_m else None, wrong, sorted({c for e in estimates for c in codes(e)}))


def codes(estimate: Estimate) -> Iterator[str]:
    """Of an estimate's problems."""
    for problem in estimate.problems:
        yield problem.code


def trajectory(estimates: Sequence[Estimate]) -> tuple[IntArray, FloatArray]:
    """What a golden file keeps of estimates: poses (3, N) in POSE_UNIT, and of all else (K, N) float32 of 16 bits."""
    poses = np.rint(np.array([e.pose for e in estimates]).T / POSE_UNIT).astype(np.int32)
    others = np.array([list(_others(e, k)) for k, e in enumerate(estimates)], dtype=np.float32).T.copy()
    return poses, (others.view(np.int32) & ~0xFF).view(np.float32)


def _others(e: Estimate, k: int) -> Iterator[float]:
    nan = math.nan
    look = e.look if k % LOOK_EVERY == 0 else None
    yield nan if look is None else look.bearing_rad + look.nats
    yield from (np.trace(e.covariance[:2, :2]), e.covariance[2, 2] + e.covariance[0, 2])
    yield from (list(Status).index(e.status), e.residual_m, e.points, len(e.hypotheses), len(e.problems))
    yield sum(other.pose.x + other.pose.y for other in e.hypotheses)
    for value in (e.probability, e.end_probability, e.protection_m):
        yield nan if value is None else value
    yield nan if e.odometry is None else sum(e.odometry.errors)
    yield nan if e.camera_errors is None else float(np.abs(e.camera_errors).sum())
    yield sum(e.statistics.values())
