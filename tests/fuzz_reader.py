"""A reader of files as the fuzz test sees it, and the small recording from which many begin."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import small_recordings
from fakes import CAMERA_YAML
from fuzz_mutations import mutated

from touchline.sources import Recording

OBSERVATIONS = """t,kind,x_m,y_m,x2_m,y2_m,orientation_rad,cov_xx,cov_xy,cov_yy,cov2_xx,cov2_xy,cov2_yy,color,confidence
0.1,point,1.0,0.5,,,,0.01,0.001,0.02,,,,,0.9
0.1,line,1.0,0.5,2.0,0.6,,0.01,0.001,0.02,0.01,0,0.02,,
0.2,L,1.5,-0.5,,,0.7,,,,,,,,0.5
0.2,goal,4.0,0.0,,,,,,,,,,white,
0.3,pole,1.0,3.0,,,,,,,,,,yellow-blue-yellow,1
0.4,none,,,,,,,,,,,,,
0.5,boundary,2.0,2.0,,,,,,,,,,,
"""
SEQUENCE = """format: 1
name: small
description: a small recording
field: msl-18x12
camera: omni
rate_hz: 10.0
events: [{t: 0.3, kind: slip}, {t: 0.4, kind: occluded, frames: 2}]
imu: {tilt_and_yaw_lag_s: 0.02}
wheels: {a_dir_rad: 0.785, b_dir_rad: 2.356}
sensor: {gamma: 2.2, k: 1.0, full_well_electrons: 10000, read_noise_electrons: 10, white_balance_rgb: [1, 1, 1]}
patch_edges_m: [0.5, 1.0, 1.5]
patch_colors: [white, black]
patch_half_width_m: 0.2
"""
POSES = "t,x,y,z,roll,pitch,yaw\n" + "".join(f"{k / 10},0.1,0.0,0.5,0.0,0.4,{k / 20}\n" for k in range(12))


@dataclass(frozen=True, slots=True)
class Reader:
    """seeds: contents of files that it takes. read: is given the path of a hostile one, which stands at `file`.

    share: how often it is asked, among the others; slow ones are asked less.
    """

    name: str
    file: Path
    seeds: Sequence[bytes]
    read: Callable[[Path], object]
    share: float = 1.0
    mutate: Callable[[Sequence[bytes], random.Random], bytes] = field(default=mutated)

    def try_one(self, data: bytes) -> None:
        """Read a hostile file; whatever the reader raises is raised on."""
        self.file.write_bytes(data)
        self.read(self.file)


def new_folder(workplace: Path, name: str) -> Path:
    folder = workplace / name.replace("/", "-")
    folder.mkdir()
    return folder


def small_recording(folder: Path) -> Path:
    """Every kind of file that a recording may have."""
    shutil.rmtree(folder)
    small_recordings.write_recording(folder, frames=3)
    (folder / "sequence.yaml").write_text(SEQUENCE)
    (folder / "camera.yaml").write_text(CAMERA_YAML.replace("width: 96\nheight: 96", "width: 48\nheight: 32"))
    (folder / "observations.csv").write_text(OBSERVATIONS)
    (folder / "camera_pose.csv").write_text(POSES)
    return folder


def read_recording(source: Recording) -> None:
    for frame in source:
        assert frame.stamp_ns is not None
    _ = (source.name, source.events, source.rate_hz, source.wheel_directions_rad, source.linear, source.sensor_files)
    _ = [str(problem) for problem in source.problems]
    if source.truth is not None:
        source.truth.nearest(0)
    _ = source.field.crossings
    _ = source.camera.image_from_ground(np.array([[1.0, 0.5]]))
