"""Recorded drives: what a simulated robot saw and measured, kept in tests/data/drives and read without the simulator.

`record_drives.py` writes them. Kept are positions of line points to 2 mm, their standard deviations along and across
the bearing to 4 %, samples of sensors to 10⁻⁵ (m, rad, rad/s), all else as float32; pixels are not kept.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from touchline.camera import camera_from_mapping
from touchline.geometry import ByteArray, FloatArray, Pose, Pose3
from touchline.systems import RobotSetup
from touchline.types import (
    Crossings,
    Evidence,
    Frame,
    GameState,
    Landmarks,
    LinePoints,
    Lines,
    Observation,
    Prior,
    Samples,
)

FOLDER = Path(__file__).parent / "data" / "drives"
SENSORS = ("odometry", "wheels", "gyro", "compass", "tilt")
FEATURES: Mapping[str, Any] = {"lines": Lines, "crossings": Crossings, "landmarks": Landmarks}
PLACE_M, CONFIDENCE, SAMPLE = 2e-3, 1.0 / 32.0, 1e-5  # units in which numbers are kept
LEAST_SIGMA_M, SIGMA_STEPS = 1e-3, 24.0  # of the logarithm in which standard deviations are kept


@dataclass(frozen=True, eq=False)
class Drive:
    """setup: what a system is given. truth (N, 3): x, y (m), heading (rad) at the frames. start: given at the start."""

    setup: RobotSetup
    frames: list[Frame]
    truth: FloatArray
    start: Prior | None

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.frames)


def open_drive(name: str) -> Drive:
    """A recorded drive by its name."""
    with np.load(FOLDER / f"{name}.npz") as file:
        data = dict(file)
    about = json.loads(str(data.pop("about")))
    camera = about["camera"] and camera_from_mapping(about["camera"], FOLDER / name)
    start = about["start"] and Prior(Pose(*about["start"]))
    setup = RobotSetup(about["field"], camera, about["wheels"], about["height_m"])
    return Drive(setup, list(_frames(data, about)), data["truth"].astype(np.float64), start)


def _frames(data: dict[str, Any], about: Mapping[str, Any]) -> Iterator[Frame]:
    stamps = np.cumsum(data["stamp_ns"]).tolist()
    logs = {name: _logs(data, name) for name in SENSORS if name in data}
    points = _points(data)
    features = {name: _features(data, name, about["colors"]) for name in FEATURES if f"{name}_count" in data}
    for k, stamp_ns in enumerate(stamps):
        seen = {name: rows[k] for name, rows in features.items()}
        head = about["heads"].get(str(k))
        yield Frame(
            stamp_ns,
            observation=Observation(stamp_ns, points[k], **seen),
            base_from_camera=head and Pose3.from_roll_pitch_yaw(*head),
            evidence=tuple(Evidence(**said) for said in about["evidence"].get(str(k), ())),
            game=tuple(GameState(**said) for said in about["game"].get(str(k), ())),
            **{name: samples[k] for name, samples in logs.items()},
        )


def _ends(data: Mapping[str, Any], name: str) -> list[slice]:
    """The rows of each frame."""
    ends = np.cumsum(data[f"{name}_count"]).tolist()
    return [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]


def _whole(planes: ByteArray, kind: type[Any]) -> FloatArray:
    """Integers (K, M) from their bytes (B, K, M), which a file packs better."""
    return np.ascontiguousarray(np.moveaxis(planes, 0, -1)).view(kind)[..., 0].astype(np.float64)


def _logs(data: Mapping[str, Any], name: str) -> list[Samples | None]:
    stamps, values = np.cumsum(data[f"{name}_ns"]), SAMPLE * np.cumsum(_whole(data[name], np.int32), axis=1).T
    return [Samples(stamps[rows], values[rows]) if rows.stop > rows.start else None for rows in _ends(data, name)]


def _points(data: Mapping[str, Any]) -> list[LinePoints]:
    places = PLACE_M * _whole(data["points"], np.int16).T
    along, across = (LEAST_SIGMA_M * np.exp(data["points_sigmas"] / SIGMA_STEPS)) ** 2
    bearings = np.arctan2(places[:, 1], places[:, 0])
    c, s = np.cos(bearings), np.sin(bearings)
    beside = (along - across) * c * s
    covariances = np.stack((along * c * c + across * s * s, beside, beside, along * s * s + across * c * c), axis=-1)
    confidences, pixels = CONFIDENCE * data["points_confidences"], np.full(places.shape, np.nan)
    columns = places, covariances.reshape(-1, 2, 2), confidences, pixels
    return [LinePoints(*(column[rows] for column in columns)) for rows in _ends(data, "points")]


def _features(data: Mapping[str, Any], name: str, colors: list[list[str]]) -> list[Any]:
    kind, found = FEATURES[name], []
    known = [column.name for column in fields(kind) if f"{name}_{column.name}" in data]
    for rows in _ends(data, name):
        columns = {column: data[f"{name}_{column}"][rows] for column in known}
        columns |= {column: values.astype(np.float64) for column, values in columns.items() if column != "kinds"}
        columns["pixels"] = np.full((rows.stop - rows.start, *kind.SHAPES["pixels"]), np.nan)
        if name == "landmarks":
            columns["colors"] = tuple(map(tuple, colors[rows]))
        found.append(kind(**columns))
    return found
