"""A run written down as a recording folder in the folder format."""

import math
import shutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from touchline.errors import InputError, TouchlineError
from touchline.geometry import FloatArray, wrap_angle
from touchline.sources.observations import HEADER, OBSERVATIONS, observation_rows
from touchline.types import Frame, ImageArray, Samples
from touchline.types.game import PHASES, STAYS
from touchline_lab.simulation.run import Simulation, image_name
from touchline_lab.simulation.sequence import JPEG_QUALITY

_MARK_NOISE_PX = 0.15  # of marks that somebody has clicked at, or a detector has found


def write_recording(simulation: Simulation, folder: Path, on_frame: Callable[[Frame], None] | None = None) -> None:
    """Write all frames into a new folder: images, or observations.csv at the level of points.

    `on_frame` is called after each and may set the exposure of the next.
    Raises InputError if the folder exists already or can't be made. What can't be finished is taken away again.
    """
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise InputError(f"{folder}: exists already and is not overwritten; choose another name") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror})") from None
    try:
        _write_all(simulation, folder, on_frame)
    except BaseException as error:  # an interruption too: half a recording would be in the way of the next try
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError):
            raise TouchlineError(f"{error.filename or folder}: cannot be written ({error.strerror})") from None
        raise


def _write_all(simulation: Simulation, folder: Path, on_frame: Callable[[Frame], None] | None) -> None:
    simulation.field.to_yaml(folder / "field.yaml")
    images = simulation.level == "images"
    _write_yaml(folder / "sequence.yaml", {**simulation.sequence, **({} if images else {"camera": "none"})})
    last_ns = int(simulation.image_stamps[-1]) + 200_000_000  # a little more than the images need
    sensors = simulation.sensors
    _write_samples(folder / "odometry.csv", "t,x,y,theta", sensors.odometry, last_ns)
    _write_samples(folder / "wheels.csv", "t,a,b", sensors.wheels, last_ns)
    _write_samples(folder / "imu.csv", "t,roll,pitch,yaw,gx,gy,gz", sensors.imu, last_ns)
    if simulation.game_states:
        _write_samples(folder / "game_states.csv", "t,phase,penalised,first_half", _said(simulation), last_ns)
    _write_truth(folder / "ground_truth.tum", simulation)
    if not images:
        _write_observations(simulation, folder, on_frame)
        return
    _write_yaml(folder / "camera.yaml", simulation.camera_yaml)
    (folder / "images").mkdir()
    rows = []
    for index, frame in enumerate(simulation):
        assert frame.image is not None
        (folder / frame.name).write_bytes(encoded(frame.image))
        exposure = f"{simulation.image_times_s[index]:.4f},{frame.name},{frame.exposure_ms:.3f},{frame.gain:.3f}"
        rows.append(",".join([exposure, *_extra(simulation, index).values()]))
        if on_frame is not None:
            on_frame(frame)
    header = ",".join(["t,file,exposure_ms,gain", *_extra(simulation, 0)])
    _write_lines(folder / "images.csv", [header, *rows])
    _write_calibration(simulation, folder)


def _write_observations(simulation: Simulation, folder: Path, on_frame: Callable[[Frame], None] | None) -> None:
    """observations.csv: the line points, lines, crossings, posts and poles of every frame."""
    rows = [HEADER]
    for index, frame in enumerate(simulation):
        assert frame.observation is not None
        rows += observation_rows(replace(simulation.features(index), points=frame.observation.points))
        if on_frame is not None:
            on_frame(frame)
    _write_lines(folder / OBSERVATIONS, rows)


def encoded(image: ImageArray) -> bytes:
    """An image as the JPEG file that a recording holds: quality 92, chroma at half the resolution."""
    sampling = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420]
    done, code = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, *sampling])
    if not done:
        raise TouchlineError("an image could not be encoded as JPEG")
    return code.tobytes()


def _extra(simulation: Simulation, index: int) -> dict[str, str]:
    """Columns of images.csv that some runs have, and what stands there."""
    values = {}
    if simulation.layout.strip_heading_rad is not None:
        bearing = wrap_angle(simulation.layout.strip_heading_rad - simulation.truth[index].heading)
        values["bearing_rad"] = f"{bearing:.6f}"
    if simulation.scenario.camera.delay_s > 0.0:
        values["arrival_s"] = f"{simulation.arrival_stamps[index] / 1e9:.4f}"
    return values


def _write_samples(path: Path, header: str, samples: Samples, last_ns: int) -> None:
    count = int(np.searchsorted(samples.stamp_ns, last_ns, side="right"))
    rows = zip(samples.stamp_ns[:count].tolist(), samples.values[:count].tolist(), strict=True)
    _write_lines(path, [header, *(",".join([f"{t / 1e9:.3f}", *(f"{value:.6f}" for value in row)]) for t, row in rows)])


def _said(simulation: Simulation) -> Samples:
    """What the referee says, as numbers."""
    said = simulation.game_states
    rows = [[PHASES.index(one.phase), 2 * (one.penalty == STAYS) or bool(one.penalty), one.first_half] for one in said]
    return Samples(np.array([one.stamp_ns for one in said]), np.array(rows, dtype=np.float64))


def _write_truth(path: Path, simulation: Simulation) -> None:
    lines = []
    for time_s, (x, y, heading) in zip(simulation.image_times_s, simulation.truth.poses, strict=True):
        qz, qw = math.sin(0.5 * heading), math.cos(0.5 * heading)
        lines.append(f"{time_s:.4f} {x:.6f} {y:.6f} 0.000000 0.000000 0.000000 {qz:.9f} {qw:.9f}")
    _write_lines(path, lines)


def _write_calibration(simulation: Simulation, folder: Path) -> None:
    """marks.csv and regions.yaml, where the scenario has something to calibrate with."""
    layout = simulation.layout
    rng = np.random.default_rng([simulation.scenario.seed, 8])
    if layout.points:
        lines = ["file,name,u,v,x_m,y_m"]
        names, places = list(layout.points), np.array(list(layout.points.values()))
        for index in range(len(simulation)):
            ground = simulation.truth[index].inverse().transform(places)
            pixels = _project(simulation, index, ground) + _MARK_NOISE_PX * rng.standard_normal(ground.shape)
            for name, (x, y), (u, v) in zip(names, ground, pixels, strict=True):
                if _inside_image(simulation, u, v):
                    known = f"{x:.5f},{y:.5f}" if layout.known else ","
                    lines.append(f"{image_name(index)},{name},{u:.3f},{v:.3f},{known}")
        _write_lines(folder / "marks.csv", lines)
    if layout.regions:
        _write_yaml(folder / "regions.yaml", list(_regions(simulation)))


def _regions(simulation: Simulation) -> Iterable[dict[str, Any]]:
    for name, polygon in simulation.layout.regions:
        pixels = _project(simulation, 0, simulation.truth[0].inverse().transform(polygon))
        if all(_inside_image(simulation, u, v) for u, v in pixels):
            yield {"file": image_name(0), "class": name, "polygon": np.round(pixels, 2).tolist()}


def _project(simulation: Simulation, index: int, ground: FloatArray) -> FloatArray:
    attitude = simulation.track.attitude_at(float(simulation.image_times_s[index]))
    return simulation.camera_model.project(ground, attitude)


def _inside_image(simulation: Simulation, u: float, v: float) -> bool:
    design = simulation.camera_model.design
    inside = 0.0 <= u <= design.width - 1.0 and 0.0 <= v <= design.height - 1.0
    return inside and bool(design.sees(np.array([[u, v]]))[0])


def _write_yaml(path: Path, tree: Any) -> None:
    path.write_text(yaml.safe_dump(tree, sort_keys=False, width=118, default_flow_style=None), encoding="utf-8")


def _write_lines(path: Path, lines: Iterable[str]) -> None:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
