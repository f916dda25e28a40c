"""Writes tests/data/drives by the simulator: `python lab/tests/record_drives.py [NAME…]`.

A drive is one of a simulated robot at observation level, with faults of the catalogue in it.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Sequence, Sized
from dataclasses import asdict, fields, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from drives import CONFIDENCE, FEATURES, FOLDER, LEAST_SIGMA_M, PLACE_M, SAMPLE, SENSORS, SIGMA_STEPS

from touchline.camera import Camera, OmniCamera
from touchline.geometry import BoolArray, ByteArray, FloatArray, IntArray, Pose, Pose3
from touchline.types import Evidence, Frame, LinePoints, Observation, Prior
from touchline_lab.experiments.catalogue import CATALOGUE, CLOUD, MIRROR, walk_of_points
from touchline_lab.experiments.catalogue import FEATURES as WALK
from touchline_lab.experiments.drives import Drive, drive_of, driven
from touchline_lab.experiments.injections import Change, Fault, Random, seen_as, with_steps
from touchline_lab.experiments.schulz_runs import (
    AS_BUILT,
    AS_SIMULATED,
    PANNING,
    Robot,
    random_areas,
    start_about,
    walk,
)
from touchline_lab.simulation.cameras.omni import omni_mapping
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

TABLE_STEP = 3
MAX_POINTS = 120  # of an image of a drive with faults
AFTER_S = 25.0  # of a drive that are not recorded: robots are carried there
HEAD_M = np.array([0.0, 0.0, 1.1])
CALM = ("others.robots=0", "others.balls=0")
MATCH_DAY = (
    "game.half_s=50", "game.every_s=5",
    "motion.waypoints=[[-3.0,1.5,0],[-1.0,-1.5,0],[2.0,1.0,0],[3.0,-2.0,0],[-2.0,0.5,0]]",
)  # fmt: skip
STAND = ("motion.kind=stand", "motion.speed_m_s=1.2", "motion.acceleration_m_s2=2.0", "motion.turn_rad_s=2.0")
SLOW, HALF = "motion.speed_m_s=1.0", "camera.black_sectors_deg=[[0,180]]"
LENS = "lens"
STEADY = AS_BUILT._replace(away_s=0.0)


class Recorded(NamedTuple):
    """kind: MIRROR, WALK (features) or CLOUD (points of a humanoid). where: scenario of a mirror, else the field.

    faults: names in the catalogue, each from a time until another (s). start: whether it is given about the true pose.
    """

    kind: str
    where: str
    seconds: float
    faults: tuple[tuple[str, float, float], ...] = ()
    seed: int = 0
    changes: tuple[str, ...] = ()
    start: bool = True
    robot: Robot = STEADY
    told: Callable[[Drive], Drive] = lambda drive: drive


def random_odometry(drive: Drive, wrong: BoolArray, rng: Random) -> Drive:
    """Steps that have nothing to do with the motion."""
    begin, end = drive.times_s[np.flatnonzero(wrong)[[0, -1]]].tolist()

    def steps(at_s: FloatArray, moved: FloatArray) -> FloatArray:
        during = ((at_s >= begin) & (at_s <= end))[:, np.newaxis]
        return np.where(during, rng.permutation(moved) * rng.choice((-1.0, 1.0), moved.shape), moved)

    return with_steps(drive, steps)


def with_heads(drive: Drive) -> Drive:
    """The robot reports where its camera is."""

    def turned(frame: Frame) -> Frame:
        pan_rad = math.radians(PANNING.pan_deg) * math.sin(2.0 * math.pi * 0.125 * frame.stamp_ns / 1e9)
        return replace(frame, base_from_camera=Pose3.from_roll_pitch_yaw(0.0, 0.35, pan_rad, HEAD_M))

    return replace(drive, frames=[turned(frame) for frame in drive.frames])


def with_team(drive: Drive) -> Drive:
    """A team mate says where it sees the robot, and one that is not known the contrary."""
    frames = list(drive.frames)
    for k in range(10, len(frames), 8):
        x, y, _ = drive.truth[k].round(2).tolist()
        right = Evidence("player 2", 0.9, place_m=(x, y), message=k)
        wrong = Evidence("stranger", 0.8, own_half=x > 0.0, known=False)
        frames[k] = replace(frames[k], evidence=(right, wrong) if k % 3 else (right,))
    return replace(drive, frames=frames)


OWN_FAULTS: dict[str, Change] = {"odometry random": random_odometry}

_M, _T, _H = "match", "straight-tracks", "hsl-s-9x6"
DRIVES = {
    # mirrors
    "match": Recorded(MIRROR, _M, 10.0),
    "match-unknown": Recorded(MIRROR, _M, 8.0, seed=1, changes=("motion.speed_m_s=1.5",), start=False),
    "tracks": Recorded(MIRROR, _T, 8.0),
    "tracks-arrived": Recorded(MIRROR, _T, 10.0, seed=3, changes=("camera.delay_s=0.1", "camera.stamped=arrived")),
    "tracks-tilted": Recorded(
        MIRROR, _T, 10.0, seed=5, changes=("camera.known_from=design", "camera.mirror.tilt_spread_deg=0.6")
    ),
    "mirror-askew": Recorded(
        MIRROR, _T, 7.0, seed=6, changes=("camera.known_from=design", "camera.mirror.tilt_spread_deg=2.0")
    ),
    "outside": Recorded(
        MIRROR, _M, 6.0,
        changes=("motion.kind=waypoints", "motion.margin_m=0.8", "motion.waypoints=[[6,1,0],[10.4,4,0]]"),
    ),
    "tour": Recorded(MIRROR, "tour-20", 8.0),
    "tour-unknown": Recorded(MIRROR, "tour-20", 8.0, seed=1, start=False),
    "stand": Recorded(MIRROR, _M, 4.0, changes=STAND),
    "kidnap-dark": Recorded(MIRROR, "kidnap", 7.0),
    "kidnap": Recorded(MIRROR, _M, 8.0, (("kidnapped", 3.0, 4.0),), changes=(SLOW,)),
    "kidnap-covered": Recorded(MIRROR, _T, 8.0, (("kidnapped, covered", 3.0, 4.5),)),
    "shoved": Recorded(MIRROR, _M, 7.0, (("shoved", 3.0, 4.0),), seed=1, changes=(SLOW,)),
    "occlusion-50": Recorded(MIRROR, "occlusion-50", 7.0),
    "half-view": Recorded(MIRROR, _M, 8.0, changes=(HALF,), start=False),
    "slips": Recorded(
        MIRROR, _M, 9.0, (("wheels spin, 2 m/s", 2.0, 3.0), ("wheels spin, camera covered", 5.0, 6.0)), changes=(SLOW,)
    ),
    "odometry-turns-wrong": Recorded(MIRROR, _M, 8.0, (("odometry turns the wrong way", 3.0, 99.0),)),
    "odometry-goes-wrong": Recorded(MIRROR, _M, 8.0, (("odometry goes the wrong way", 3.0, 99.0),), seed=1),
    "odometry-all-wrong": Recorded(MIRROR, _T, 8.0, (("odometry has all signs wrong", 0.0, 99.0),)),
    "odometry-scaled": Recorded(MIRROR, _M, 9.0, (("odometry × 1.3", 3.0, 99.0),), seed=2),
    "odometry-frozen": Recorded(MIRROR, _M, 9.0, (("odometry frozen", 3.0, 6.0),), changes=(SLOW,)),
    "odometry-missing": Recorded(MIRROR, _M, 8.0, (("odometry missing", 3.0, 6.0),), changes=(SLOW,)),
    "odometry-random": Recorded(MIRROR, _M, 8.0, (("odometry random", 3.0, 99.0),)),
    "gyro-wrong": Recorded(MIRROR, _M, 6.0, (("gyro turns the wrong way", 2.0, 99.0),)),
    "clock-fast": Recorded(MIRROR, _M, 9.0, (("camera's clock 300 ms fast", 0.0, 99.0),)),
    "clock-slow": Recorded(MIRROR, _T, 9.0, (("camera's clock 100 ms slow", 3.0, 99.0),)),
    "clock-random": Recorded(MIRROR, _M, 8.0, (("images 0–600 ms late at random", 2.0, 99.0),)),
    "clock-back": Recorded(
        MIRROR, _T, 8.0,
        (("camera's clock back an hour", 6.0, 99.0), ("stamps repeated", 2.0, 2.5), ("stamps run backwards", 4.0, 4.5)),
    ),
    "images-repeat": Recorded(MIRROR, _M, 7.0, (("the same image with new stamps", 3.0, 5.0),)),
    "images-mirrored": Recorded(MIRROR, _M, 7.0, (("mirrored", 3.0, 99.0),), changes=(SLOW,)),
    "images-turned": Recorded(MIRROR, _M, 8.0, (("turned by 20°", 3.0, 99.0),), changes=(SLOW,)),
    "images-turn": Recorded(MIRROR, _T, 7.0, (("spinning, 0.5 rad/s", 2.0, 5.0),)),
    "camera-ahead": Recorded(MIRROR, _M, 9.0, (("camera 0.3 m farther ahead", 2.0, 99.0),)),
    "ranges": Recorded(MIRROR, _M, 7.0, (("ranges × 1.1", 0.0, 99.0),)),
    "field-larger": Recorded(MIRROR, _M, 7.0, (("larger field told", 0.0, 99.0),), start=False),
    "neighbour": Recorded(MIRROR, _T, 7.0, (("a neighbour field's lines besides", 1.0, 99.0),)),
    "covered": Recorded(MIRROR, _M, 8.0, (("camera covered", 2.0, 6.0),), seed=1, changes=(SLOW,)),
    "heap": Recorded(MIRROR, _M, 8.0, (("a blob, carried, instead", 3.0, 6.0),), changes=(SLOW,)),
    "garbage": Recorded(
        MIRROR, _M, 8.0, (("uniform garbage, instead", 2.0, 4.0), ("a ring of 1 m, besides", 5.0, 99.0))
    ),
    "crowd": Recorded(MIRROR, _M, 7.0, (("20–40 % robots and nets", 0.0, 99.0),), start=False),
    "one-line": Recorded(MIRROR, _T, 8.0, (("one line only", 2.0, 6.0),)),
    "compass-turned": Recorded(MIRROR, _M, 12.0, (("compass turned for 10 s", 2.0, 99.0),), changes=(SLOW, *CALM)),
    "compass-stuck": Recorded(MIRROR, _M, 8.0, (("compass stuck", 3.0, 99.0),), start=False),
    "compass-drifts": Recorded(MIRROR, _M, 9.0, (("compass drifts, 5°/s", 1.0, 99.0),), seed=2),
    "half-wrong": Recorded(MIRROR, _M, 9.0, (("wrong half told", 0.0, 99.0),), seed=2),
    # humanoids
    "walk-referee": Recorded(WALK, _H, 62.0, changes=(*MATCH_DAY, "camera.rate_hz=4"), start=False, robot=AS_SIMULATED),
    "walk-team": Recorded(WALK, _H, 14.0, seed=4, changes=random_areas(_H, 4), start=False, told=with_team),
    "lens": Recorded(LENS, "humanoid-walk", 10.0),
    "lens-unknown": Recorded(LENS, "humanoid-walk", 10.0, seed=1, changes=("field=humanoid-kid-9x6",), start=False),
    "fisheye": Recorded(LENS, "humanoid-fisheye", 10.0),
    "walk-hsl": Recorded(WALK, _H, 15.0, robot=AS_BUILT),
    "walk-kid": Recorded(WALK, "humanoid-kid-9x6", 15.0, seed=1, changes=random_areas("humanoid-kid-9x6", 1)),
    "walk-indoor": Recorded(WALK, "indoor-9x6", 15.0, seed=2, changes=random_areas("indoor-9x6", 2), start=False),
    "walk-large": Recorded(WALK, "hsl-l-22x14", 12.0),
    "walk-pans": Recorded(WALK, _H, 18.0, seed=3, changes=random_areas(_H, 3), robot=PANNING, told=with_heads),
    "walk-kidnap": Recorded(WALK, "humanoid-kid-9x6", 18.0, (("kidnapped", 6.0, 8.0),)),
    "walk-falls": Recorded(WALK, _H, 30.0, (("three falls, garbage while lying", 5.0, 99.0),)),
    "walk-odometry-wrong": Recorded(WALK, _H, 18.0, (("odometry turns the wrong way", 4.0, 99.0),)),
    "walk-head": Recorded(WALK, _H, 18.0, (("head pans and nobody tells", 4.0, 99.0),)),
    "walk-low": Recorded(WALK, _H, 15.0, (("camera 5° lower", 0.0, 99.0),)),
    "walk-crossings": Recorded(
        WALK, "humanoid-kid-9x6", 16.0,
        (("60 % of the crossings are none", 3.0, 8.0), ("four bars of nets besides", 9.0, 99.0)),
    ),
    "cloud": Recorded(CLOUD, _H, 15.0, start=False),
    "cloud-kid": Recorded(CLOUD, "humanoid-kid-9x6", 15.0, (("20–40 % robots and nets", 0.0, 99.0),)),
    "cloud-low": Recorded(CLOUD, _H, 14.0, (("camera 3° lower", 0.0, 99.0),)),
    "cloud-mirrored": Recorded(CLOUD, _H, 12.0, (("mirrored", 3.0, 99.0),)),
}  # fmt: skip


def drive_as(recipe: Recorded) -> Drive:
    """The drive with its faults."""
    kind, where, seed, changes = recipe.kind, recipe.where, recipe.seed, recipe.changes
    seconds = recipe.seconds + (AFTER_S if any("kidnap" in name for name, _, _ in recipe.faults) else 2.0)
    if kind == MIRROR:
        drive = driven(where, seed, seconds, *changes)
    elif kind == WALK:
        drive = walk(where, recipe.robot, seed, seconds, changes)
    elif kind == CLOUD:
        drive = walk_of_points(where, seed, seconds, changes)
    else:
        drive = walk_of_all(where, seed, seconds, changes)
    drive = recipe.told(drive)
    start, count = start_about(Pose(*drive.truth[0].tolist()), seed), len(drive.until(recipe.seconds).frames)
    drive = replace(drive, prior=Prior(start) if recipe.start else None)
    known = {each.name: each.change for each in CATALOGUE if each.robots == kind} | OWN_FAULTS
    for name, begin_s, end_s in recipe.faults:
        drive = Fault(name, begin_s, end_s, known[name]).laid_into(drive, np.random.default_rng([seed, 7]))
    drive = replace(drive, frames=drive.frames[:count], truth=drive.truth[:count])
    if not recipe.faults:
        return drive
    rng = np.random.default_rng(seed)
    return seen_as(drive, lambda _, seen: replace(seen, points=_few(seen.points, rng)))


def _few(points: LinePoints, rng: Random) -> LinePoints:
    return points.rows(rng.permutation(len(points)) < MAX_POINTS)


def walk_of_all(scenario: str, seed: int, seconds: float, changes: Sequence[str]) -> Drive:
    """The walk of a humanoid that sees points and features through a camera that is described."""
    run = Simulation(open_scenario(scenario, seed, seconds, changes), "points")
    seen = [replace(run.features(k), points=run.points(k)) for k in range(len(run))]
    return drive_of(run, None, [replace(f, observation=o) for f, o in zip(run, seen, strict=True)])


# --- files ------------------------------------------------------------------------------------------------------------


def packed(drive: Drive) -> dict[str, Any]:
    """What the file of a drive holds."""
    frames, seen = drive.frames, [frame.observation or Observation(frame.stamp_ns) for frame in drive.frames]
    tables = {"stamp_ns": _steps([frame.stamp_ns for frame in frames]), "truth": drive.truth.astype(np.float32)}
    for name in SENSORS:
        logs = [log for frame in frames if (log := getattr(frame, name)) is not None]
        if logs:
            tables[f"{name}_count"] = _counts(getattr(frame, name) or () for frame in frames)
            tables[f"{name}_ns"] = _steps(np.concatenate([log.stamp_ns for log in logs]))
            values = np.rint(np.concatenate([log.values for log in logs]).T / SAMPLE)
            tables[name] = _planes(np.diff(values, prepend=0.0), np.int32)
    points = LinePoints.joined([one.points for one in seen])
    tables["points_count"] = _counts(one.points for one in seen)
    tables["points"] = _planes(np.rint(points.positions_m.T / PLACE_M), np.int16)
    tables["points_confidences"] = np.rint(points.confidences / CONFIDENCE).astype(np.uint8)
    bearings = np.arctan2(*points.positions_m.T[::-1])
    ways = [np.column_stack((np.cos(angles), np.sin(angles))) for angles in (bearings, bearings + 0.5 * math.pi)]
    sigmas = np.sqrt([np.einsum("ni,nij,nj->n", way, points.covariances_m2, way) for way in ways])
    steps = SIGMA_STEPS * np.log(np.maximum(sigmas, LEAST_SIGMA_M) / LEAST_SIGMA_M)
    tables["points_sigmas"] = np.minimum(np.rint(steps), 255).astype(np.uint8)
    colors: list[Any] = []
    for name, kind in FEATURES.items():
        rows = kind.joined([getattr(one, name) for one in seen])
        if len(rows):
            tables[f"{name}_count"] = _counts(getattr(one, name) for one in seen)
            for column in (field.name for field in fields(kind) if field.name not in ("pixels", "colors")):
                values = getattr(rows, column)
                tables[f"{name}_{column}"] = values if column == "kinds" else values.astype(np.float32)
            colors = list(getattr(rows, "colors", colors))
    return tables | {"about": np.array(json.dumps(about(drive) | {"colors": colors}))}


def about(drive: Drive) -> dict[str, Any]:
    """All that is no table."""
    setup, frames = drive.setup, list(enumerate(drive.frames))
    heads = {k: f.base_from_camera for k, f in frames if f.base_from_camera is not None}
    return {
        "field": setup.field.name,
        "camera": _mapping(setup.camera),
        "wheels": setup.wheel_directions_rad,
        "height_m": setup.height_m,
        "start": None if drive.prior is None else drive.prior.pose,
        "heads": {k: [*head.roll_pitch_yaw(), head.translation_m.tolist()] for k, head in heads.items()},
        "evidence": {k: [asdict(said) for said in f.evidence] for k, f in frames if f.evidence},
        "game": {k: [asdict(said) for said in f.game] for k, f in frames if f.game},
    }


def _mapping(camera: Camera | None) -> dict[str, Any] | None:
    """What camera.yaml says, of a mirror's table only every TABLE_STEPth row and column."""
    if not isinstance(camera, OmniCamera):
        return None if camera is None else camera.mapping()
    mapping = omni_mapping(camera)
    for key, values in mapping["range_table"].items():
        table = np.array(values)[..., ::TABLE_STEP]
        mapping["range_table"][key] = (table[::TABLE_STEP] if table.ndim == 2 else table).round(5).tolist()
    return mapping


def _planes(numbers: FloatArray, kind: type[Any]) -> ByteArray:
    """Numbers (K, M) as bytes (B, K, M) of integers."""
    whole = numbers.astype(kind)
    return np.moveaxis(whole[..., np.newaxis].view(np.uint8), -1, 0).copy()


def _counts(tables: Iterable[Sized]) -> IntArray:
    return np.array([len(each) for each in tables], dtype=np.int64)


def _steps(stamps: npt.ArrayLike) -> IntArray:
    return np.diff(np.asarray(stamps, dtype=np.int64), prepend=0)


def main(names: Sequence[str]) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in names or DRIVES:
        drive, path = drive_as(DRIVES[name]), FOLDER / f"{name}.npz"
        np.savez_compressed(path, **packed(drive))
        print(f"{name}: {len(drive.frames)} images, {path.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
