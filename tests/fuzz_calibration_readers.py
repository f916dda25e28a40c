"""Readers of loose images and odometry, and of what calibrations begin from."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
from fakes import CAMERA_YAML
from fuzz_reader import Reader, new_folder, read_recording

from touchline.calibration.lines.pixels_file import image_size, read_pixels, rough_circle
from touchline.calibration.marks import read_marks
from touchline.calibration.perspective import (
    calibrate_camera,
    lens_of,
    lens_of_marks,
    perspective_yaml,
)
from touchline.camera import PinholeCamera, open_camera
from touchline.files.yaml_text import read_yaml_mapping
from touchline.sources import BagOptions
from touchline.sources.loose import LooseOptions, odometry_rows, open_loose, parse_columns
from touchline.sources.to_folder import write_folder

_CAMERA = "camera.yaml"  # in the folder of loose images and videos, which is no recording
_ODOMETRY = "theta_deg;stamp_ns;north;east\n" + "".join(
    f"{90 + k};{1_763_780_000_000_000_000 + 20_000_000 * k};{0.1 * k:.1f};2.5\n" for k in range(10)
)
_PINHOLE = """model: pinhole
width: 48
height: 32
fx: 40.0
fy: 40.0
cx: 23.5
cy: 15.5
distortion: [-0.25, 0.06, 0.0006, -0.0004, 0.0]
mount: {x: 0.05, y: 0.0, z: 1.1, roll: 0.0, pitch: 0.5, yaw: 0.0}
"""
_CORRECTED = f"""{_PINHOLE}use_attitude: true
imu_correction: {{matrix: [[0, 1, 0, 0, 0.1], [0, 0, 1, 0, 0]], reference: [0.01, 0.02]}}
"""


def loose_readers(workplace: Path) -> list[Reader]:
    """Numbered images, a camera for them, and odometry of any columns."""
    images = new_folder(workplace, "loose")
    for index in range(4):
        cv2.imwrite(str(images / f"img-{index}.png"), _picture(index))
    seed = (images / "img-2.png").read_bytes()
    (images / _CAMERA).write_text(_PINHOLE)
    described = BagOptions(field="msl-18x12", camera=images / _CAMERA)
    camera, odometry = new_folder(workplace, "loose-camera"), new_folder(workplace, "loose-odometry")

    def with_image(path: Path) -> None:
        _converted(path.parent, workplace / "loose-1", LooseOptions(rate_hz=10.0), described)

    def with_camera(path: Path) -> None:
        read_recording(open_loose(images, LooseOptions(rate_hz=10.0), BagOptions(field="msl-18x12", camera=path)))

    def with_odometry(path: Path) -> None:
        options = LooseOptions(10.0, path, "theta_deg=theta_deg,t_ns=stamp_ns,x=east,y=3", "1763780000.000000000")
        read_recording(open_loose(images, options, described))

    def bare(path: Path) -> None:
        list(odometry_rows(path, parse_columns("t_ms=1,x_mm=2,y_cm=3,theta=4")))

    cameras = [_PINHOLE.encode(), _CORRECTED.encode(), CAMERA_YAML.encode()]
    return [
        Reader("numbered images", images / "img-2.png", [seed], with_image, 0.5),
        Reader("camera of images", camera / "camera.yaml", cameras, with_camera, 0.5),
        Reader("odometry of any columns", odometry / "odometry.csv", [_ODOMETRY.encode()], with_odometry, 1.0),
        Reader("odometry without a header", odometry / "bare.csv", [b"1 2 3 4\n5 6.5 7 8e0\n"], bare, 0.5),
    ]


def _picture(index: int) -> np.ndarray:
    image = np.full((32, 48, 3), 40, dtype=np.uint8)
    image[:, 4 * index : 4 * index + 8] = 200
    return image


def _converted(source: Path, target: Path, options: LooseOptions, described: BagOptions) -> None:
    shutil.rmtree(target, ignore_errors=True)
    recording = open_loose(source, options, described)
    write_folder(recording, target)
    read_recording(recording)


def calibration_readers(workplace: Path) -> list[Reader]:
    """Line points in pixels; marks and lenses."""
    return [*_line_points(workplace), *_perspective(workplace)]


def _line_points(workplace: Path) -> list[Reader]:
    folder = new_folder(workplace, "pixels")
    angles = np.linspace(0.0, 6.0, 40)
    rows = [f"{320 + (60 + 3 * k) * np.cos(a):.2f},{240 + (60 + 3 * k) * np.sin(a):.2f}" for k, a in enumerate(angles)]
    seed = ("u_px,v_px\n" + "\n".join(rows) + "\n").encode()

    def pixels(path: Path) -> None:
        points = [read_pixels(path)]
        image_size(None, points)
        rough_circle(points)

    return [
        Reader("line points in pixels", folder / "pixels.csv", [seed, b"v_px,x,u_px\n1,2,3\n"], pixels),
    ]


def _perspective(workplace: Path) -> list[Reader]:
    folder = new_folder(workplace, "perspective")
    (folder / "camera.yaml").write_text(_PINHOLE)
    camera = open_camera(folder / "camera.yaml")
    assert isinstance(camera, PinholeCamera)
    places = np.array([(1.5, 0.4), (1.5, -0.4), (3.0, 0.8), (3.0, -0.8), (2.0, 0.0)])
    rows = zip(camera.image_from_ground(places).tolist(), places.tolist(), strict=True)
    marks = "file,name,u,v,x_m,y_m\n" + "".join(f"images/000000.jpg,m,{u},{v},{x},{y}\n" for (u, v), (x, y) in rows)
    (folder / "marks.csv").write_text(marks)

    def of_marks(path: Path) -> None:
        read = read_marks(path)
        told = lens_of(read_yaml_mapping(folder / "camera.yaml"), path)
        perspective_yaml(calibrate_camera(read, told).camera, "found")
        perspective_yaml(calibrate_camera(read, lens_of_marks(read, (48, 32))).camera, "found")

    def of_lens(path: Path) -> None:
        lens = lens_of(read_yaml_mapping(path), path)
        perspective_yaml(calibrate_camera(read_marks(folder / "marks.csv"), lens).camera, "found")

    return [
        Reader("calibrate camera, marks.csv", folder / "hostile.csv", [marks.encode()], of_marks),
        Reader("calibrate camera, camera.yaml", folder / "hostile.yaml", [_PINHOLE.encode()], of_lens, 1.0),
    ]
