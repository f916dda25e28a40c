"""Tiny recordings for tests: written in milliseconds, broken at will."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import yaml

IMAGE_PERIOD_S = 0.1
SENSOR_PERIOD_S = 0.02
WIDTH, HEIGHT = 48, 32


def write_recording(folder: Path, frames: int = 8, **sequence: object) -> Path:
    """A robot that drives a slow arc and turns left at 0.5 rad/s; images are noise. Returns the folder."""
    (folder / "images").mkdir(parents=True)
    about = {"format": 1, "name": "small", "field": "msl-18x12", "camera": "omni", "rate_hz": 10} | sequence
    (folder / "sequence.yaml").write_text(yaml.safe_dump({k: v for k, v in about.items() if v is not None}))
    noise = np.random.default_rng(1)
    image_rows, truth_rows = ["t,file,exposure_ms,gain"], []
    for index in range(frames):
        time_s = round((index + 1) * IMAGE_PERIOD_S, 3)
        image = noise.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        (folder / f"images/{index:06d}.jpg").write_bytes(cv2.imencode(".jpg", image)[1].tobytes())
        image_rows.append(f"{time_s:.4f},images/{index:06d}.jpg,12.000,1.700")
        x, y, heading = arc_pose(time_s)
        truth_rows.append(f"{time_s:.4f} {x:.6f} {y:.6f} 0 0 0 {np.sin(heading / 2):.9f} {np.cos(heading / 2):.9f}")
    (folder / "images.csv").write_text("\n".join(image_rows) + "\n")
    (folder / "ground_truth.tum").write_text("\n".join(truth_rows) + "\n")
    write_sensors(folder, round((frames + 1) * IMAGE_PERIOD_S / SENSOR_PERIOD_S) + 1)
    return folder


def write_sensors(folder: Path, rows: int) -> None:
    """odometry.csv, wheels.csv and imu.csv of the arc."""
    odometry, wheels, imu = ["t,x,y,theta"], ["t,a,b"], ["t,roll,pitch,yaw,gx,gy,gz"]
    for index in range(rows):
        time_s = index * SENSOR_PERIOD_S
        x, y, heading = arc_pose(time_s)
        odometry.append(f"{time_s:.3f},{x:.6f},{y:.6f},{heading:.6f}")
        wheels.append(f"{time_s:.3f},{0.7 * time_s:.6f},{0.7 * time_s:.6f}")
        imu.append(f"{time_s:.3f},0.001,0.002,{heading:.6f},0.01,0.02,0.5")
    for name, lines in (("odometry", odometry), ("wheels", wheels), ("imu", imu)):
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")


def arc_pose(time_s: float) -> tuple[float, float, float]:
    """x, y, heading of a drive at 1 m/s that turns left by 0.5 rad/s."""
    heading = float(np.mod(0.5 * time_s + np.pi, 2 * np.pi) - np.pi)
    return 2.0 * float(np.sin(0.5 * time_s)), 2.0 * (1.0 - float(np.cos(0.5 * time_s))), heading


def replace_line(file: Path, line: int, text: str) -> None:
    """Put another text in place of a line, counted from 1."""
    lines = file.read_text().split("\n")
    lines[line - 1] = text
    file.write_text("\n".join(lines))


def edit_line(file: Path, line: int, column: int, value: str) -> None:
    """Put another value into a cell of a CSV file; line counted from 1, column from 0."""
    cells = file.read_text().split("\n")[line - 1].split(",")
    cells[column] = value
    replace_line(file, line, ",".join(cells))


def delete_lines(file: Path, first: int, last: int) -> None:
    """Remove the lines first to last, counted from 1."""
    lines = file.read_text().split("\n")
    file.write_text("\n".join(lines[: first - 1] + lines[last:]))


def borrow(source: Path, folder: Path, frames: int) -> Path:
    """The first frames of a public recording, copied and free to be changed."""
    (folder / "images").mkdir(parents=True)
    for file in source.iterdir():
        if file.is_file():
            (folder / file.name).write_bytes(file.read_bytes())
    for name, header in (("images.csv", 1), ("ground_truth.tum", 0)):
        lines = (folder / name).read_text().split("\n")
        (folder / name).write_text("\n".join(lines[: frames + header]) + "\n")
    for row in (folder / "images.csv").read_text().split("\n"):
        for name in (cell for cell in row.split(",") if cell.startswith("images/")):
            shutil.copy(source / name, folder / name)
    return folder
