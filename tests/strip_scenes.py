"""Recordings of a calibration strip, rendered in linear light through a mirror whose ranges differ by direction."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from touchline.camera import OmniCamera
from touchline.geometry import FloatArray
from touchline.types import ImageArray

EDGES_M = [0.6, 0.73, 0.86, 1.01, 1.17, 1.35, 1.55, 1.79, 2.06, 2.38, 2.78, 3.3, 3.98, 4.97, 6.5]
HALF_WIDTH_M = 0.2
GREEN, BLACK, WHITE, BODY = (0.05, 0.25, 0.06), (0.03, 0.03, 0.03), (0.7, 0.7, 0.7), (0.01, 0.01, 0.01)
BODY_PX = 32.0
DIRECTIONS = 16
YAW_RAD, HANDEDNESS = 0.4, 1


def tilted_camera(size: int = 400) -> OmniCamera:
    """A straight (not mirrored) camera whose mirror sits aside: 2 % off outwards on one side, inwards on the other."""
    radii = np.arange(0.0, 168.0)
    rows = np.arange(0.0, 2.0 * math.pi, math.radians(3.0))
    stretched = radii / 0.84 * (1.0 + 0.02 * np.cos(rows - 0.7))[:, np.newaxis]
    ranges = 0.0115 * stretched / (1.0 - stretched / 222.5) ** 0.72
    return OmniCamera(size, size, (203.3, 196.8), BODY_PX + 2, 165.0, HANDEDNESS, YAW_RAD, radii, rows, ranges)


def strip_image(camera: OmniCamera, bearing_rad: float, edges_m: list[float] = EDGES_M, seed: int = 0) -> ImageArray:
    """What the camera sees of a strip at a bearing on green ground: averaged in linear light, then gamma 2.2."""
    total = np.zeros((camera.height, camera.width, 3))
    for points, body in looked_at(camera):
        colour = ground_colour(points, bearing_rad, edges_m)
        colour[body] = BODY
        total += colour.reshape(total.shape)
    light = cv2.GaussianBlur(total / 9.0, (0, 0), 0.7)
    noise = np.random.default_rng(seed).normal(0.0, 1.5, light.shape)
    return np.clip(np.rint(255.0 * light ** (1 / 2.2) + noise), 0, 255).astype(np.uint8)


@lru_cache(maxsize=1)
def looked_at(camera: OmniCamera) -> list[tuple[FloatArray, npt.NDArray[np.bool_]]]:
    """Ground points (N, 2) of nine samples of every pixel, and which of them see the robot's own body."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    samples = []
    for dv in (-1 / 3, 0.0, 1 / 3):
        for du in (-1 / 3, 0.0, 1 / 3):
            pixels = np.column_stack((u.ravel() + du, v.ravel() + dv))
            samples.append((camera.ground_from_image(pixels), np.hypot(*(pixels - camera.center).T) < BODY_PX))
    return samples


def ground_colour(points: FloatArray, bearing_rad: float, edges_m: list[float]) -> FloatArray:
    """Linear B, G, R (N, 3) of ground points (N, 2): strip, carpet, a white line, a white wall behind the strip."""
    along = points @ (math.cos(bearing_rad), math.sin(bearing_rad))
    across = points @ (-math.sin(bearing_rad), math.cos(bearing_rad))
    patch = np.searchsorted(edges_m, along) - 1
    on_strip = (np.abs(across) <= HALF_WIDTH_M) & (patch >= 0) & (patch < len(edges_m) - 1)
    colour = np.tile(np.array(GREEN), (len(points), 1))
    colour[np.abs(points[:, 0] - 2.9) < 0.06] = WHITE
    colour[np.hypot(*points.T) > 6.9] = WHITE
    colour[on_strip & (patch % 2 == 0)] = BLACK
    colour[on_strip & (patch % 2 == 1)] = WHITE
    colour[np.isnan(points[:, 0])] = BODY
    return colour


def write_strip_recording(folder: Path, camera: OmniCamera, directions: int = DIRECTIONS) -> Path:
    """A calibration recording: one image per direction all around. Its camera.yaml holds size and a rough centre."""
    (folder / "images").mkdir(parents=True)
    about = {
        "format": 1, "name": "strip", "field": "msl-18x12", "camera": "omni", "rate_hz": 1,
        "sensor": {"gamma": 2.2}, "patch_edges_m": EDGES_M, "patch_colors": ["black", "white"] * 7,
        "patch_half_width_m": HALF_WIDTH_M,
    }  # fmt: skip
    (folder / "sequence.yaml").write_text(yaml.safe_dump(about))
    rough = {"model": "omni", "width": camera.width, "height": camera.height, "center": [199.5, 199.5]}
    (folder / "camera.yaml").write_text(yaml.safe_dump(rough))
    rows = ["t,file,bearing_rad"]
    for k in range(directions):
        bearing = math.remainder(0.13 + k * 2.0 * math.pi / directions, 2.0 * math.pi)
        image = strip_image(camera, bearing, seed=k)
        (folder / f"images/{k:02d}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
        rows.append(f"{k + 0.5},images/{k:02d}.png,{bearing:.6f}")
    (folder / "images.csv").write_text("\n".join(rows) + "\n")
    return folder
