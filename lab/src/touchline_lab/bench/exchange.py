"""Inputs written out as recordings without truth, for any program; poses that come back, as TUM or CSV."""

import csv
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from touchline.camera import OmniCamera, PerspectiveCamera
from touchline.errors import InputError
from touchline.evaluation.metrics import associate
from touchline.evaluation.tum import read_tum, seconds_text, stamp_from_text, write_tum
from touchline.files.opened import text_lines
from touchline.geometry import FloatArray, Pose
from touchline.sources.observations import HEADER, OBSERVATIONS, observation_rows
from touchline.types import Prior, Samples, Status
from touchline_lab.experiments.drives import Drive, Track
from touchline_lab.simulation.cameras.omni import omni_mapping
from touchline_lab.simulation.cameras.perspective import humanoid_camera

START = "start.tum"
_COVARIANCE = ("cov_xx", "cov_xy", "cov_xt", "cov_yy", "cov_yt", "cov_tt")
_POSE = ("t", "x", "y", "theta")


def write_inputs(drive: Drive, folder: Path, name: str) -> None:
    """Write what a drive's robot saw and measured as a recording; its start, where one is told, as start.tum.

    Neither truth nor events are in it. Raises OSError for what can't be written.
    """
    folder.mkdir(parents=True)
    drive.field.to_yaml(folder / "field.yaml")
    camera = drive.setup.camera or humanoid_camera()
    about: dict[str, Any] = {"format": 1, "name": name, "field": drive.field.name, "camera": camera.model}
    if drive.setup.wheel_directions_rad is not None:
        a, b = drive.setup.wheel_directions_rad
        about["wheels"] = {"a_dir_rad": a, "b_dir_rad": b}
    assert isinstance(camera, OmniCamera | PerspectiveCamera)
    described = omni_mapping(camera) if isinstance(camera, OmniCamera) else camera.mapping()
    for file, tree in (("sequence.yaml", about), ("camera.yaml", described)):
        (folder / file).write_text(yaml.safe_dump(tree, sort_keys=False), encoding="utf-8")
    if drive.prior is not None and drive.prior.pose is not None:
        stamp_ns = np.array([drive.frames[0].stamp_ns], np.int64)
        write_tum(folder / START, Samples(stamp_ns, drive.prior.pose.as_array()[np.newaxis]))
    rows = [row for f in drive.frames if f.observation is not None for row in observation_rows(f.observation.usable())]
    _write(folder / OBSERVATIONS, HEADER, rows)
    for sensor, header in (("odometry", "t,x,y,theta"), ("wheels", "t,a,b")):
        _write_sensors(folder / f"{sensor}.csv", header, [_log(drive, sensor)], [header.count(",")])
    imu = [_log(drive, sensor) for sensor in ("tilt", "compass", "gyro")]
    _write_sensors(folder / "imu.csv", "t,roll,pitch,yaw,gx,gy,gz", imu, [2, 1, 3])


def _log(drive: Drive, sensor: str) -> Samples | None:
    return Samples.joined([getattr(frame, sensor) for frame in drive.frames])


def _write_sensors(path: Path, header: str, logs: Sequence[Samples | None], widths: Sequence[int]) -> None:
    """One table of sensors that are sampled together; a cell is empty where one of them has no sample."""
    known = [log for log in logs if log is not None]
    if not known:
        return
    stamps = np.unique(np.concatenate([log.stamp_ns for log in known]))
    values = np.full((len(stamps), sum(widths)), np.nan)
    for log, begin, width in zip(logs, np.cumsum([0, *widths]).tolist(), widths, strict=False):
        if log is not None:
            values[np.searchsorted(stamps, log.stamp_ns), begin : begin + width] = log.values
    cells = (["" if math.isnan(v) else f"{v:.6f}" for v in row] for row in values.tolist())
    rows = zip(stamps.tolist(), cells, strict=True)
    _write(path, header, (",".join([seconds_text(stamp_ns), *row]) for stamp_ns, row in rows))


def _write(path: Path, header: str, rows: Iterable[str]) -> None:
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")


def read_start(folder: Path) -> Prior | None:
    """The start that a folder of inputs tells; None where there is none."""
    path = folder / START
    return Prior(Pose(*read_tum(path).values[0].tolist())) if path.is_file() else None


class Answers(NamedTuple):
    """Poses of a program. stamp_ns (N,), poses (N, 3), tracking (N,), covariances (N, 3, 3), NaN where not stated."""

    stamp_ns: np.ndarray
    poses: FloatArray
    tracking: np.ndarray
    covariances: FloatArray


def read_answers(path: Path) -> Answers:
    """A TUM file, each of whose poses is one that is tracked, or a CSV with t,x,y,theta and, where known, the upper
    triangle of the covariance (cov_xx, cov_xy, cov_xt, cov_yy, cov_yt, cov_tt) and status (tracking or another word).

    An empty file holds no pose. Raises InputError that names file and line.
    """
    if path.stat().st_size == 0:  # never sure
        return Answers(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.bool_), np.zeros((0, 3, 3)))
    if path.suffix == ".tum":
        log = read_tum(path)
        return Answers(log.stamp_ns, log.values, np.ones(len(log), np.bool_), np.full((len(log), 3, 3), np.nan))
    reader = csv.DictReader(text_lines(path, newline=""))
    names = reader.fieldnames or ()
    if missing := [name for name in _POSE if name not in names]:
        raise InputError(f"{path}, line 1: {', '.join(missing)} missing; expected the header {','.join(_POSE)}[,…]")
    upper = [name for name in _COVARIANCE if name in names]
    stamps, rows = [], []
    for row in reader:
        try:
            stamps.append(stamp_from_text(row["t"]))
            tracking = row.get("status", Status.TRACKING.value) == Status.TRACKING.value
            stated = [float(row[name] or "nan") for name in _COVARIANCE] if len(upper) == 6 else [math.nan] * 6
            rows.append([*(float(row[name]) for name in _POSE[1:]), float(tracking), *stated])
        except (TypeError, ValueError) as error:
            raise InputError(f"{path}, line {reader.line_num}: {error}") from None
        if len(stamps) > 1 and stamps[-1] <= stamps[-2]:
            raise InputError(f"{path}, line {reader.line_num}: the time does not increase; sort the file by time")
    table = np.array(rows, dtype=np.float64).reshape(-1, 10)
    covariances = table[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    return Answers(np.array(stamps, np.int64), table[:, :3], table[:, 3] > 0.0, covariances)


def track_of_answers(times_s: FloatArray, truth: FloatArray, answers: Answers) -> Track:
    """Answers beside the truth (N, 3) at the images (N,); an image without one is not tracked, its pose is NaN."""
    count = len(times_s)
    poses, tracking = np.full((count, 3), np.nan), np.zeros(count, np.bool_)
    covariances = np.full((count, 3, 3), np.nan)
    if len(answers.stamp_ns):
        match = associate(np.rint(1e9 * times_s).astype(np.int64), answers.stamp_ns)
        there = match >= 0
        poses[there], tracking[there] = answers.poses[match[there]], answers.tracking[match[there]]
        covariances[there] = answers.covariances[match[there]]
        tracking &= np.isfinite(poses).all(axis=1)
    return Track(times_s, poses, truth, tracking, covariances)
