"""A mirror of closed form and images painted through it: what detection must find is known exactly."""

from __future__ import annotations

import math

import numpy as np

from touchline.camera import OmniCamera
from touchline.geometry import FloatArray
from touchline.types import ImageArray, LinePoints

GREEN, WHITE, GREY, YELLOW, BLACK = (75, 140, 80), (230, 230, 230), (120, 120, 120), (40, 220, 220), (20, 20, 20)
BODY_PX = 40.0
CROSS = [(1.0, 0.0, 1.8), (0.0, 1.0, -1.2)]  # two lines for `line_field`


def mirror_camera(size: int = 480) -> OmniCamera:
    """range = 0.8 tan(radius / 160 px), front at the top of the image, mirrored as most mirrors are."""
    radii = np.arange(0.0, 226.0)
    center = (size - 1) / 2.0
    return OmniCamera(
        size, size, (center, center), BODY_PX + 2, 220.0, -1, -math.pi / 2, radii, np.zeros(1),
        0.8 * np.tan(radii / 160.0)[np.newaxis],
    )  # fmt: skip


def paint_ground(camera: OmniCamera, colour_at, noise: float = 1.0, seed: int = 0, samples: int = 3) -> ImageArray:  # type: ignore[no-untyped-def]
    """The image of a ground whose colour (N, 3) at points (N, 2) is given by a function; anti-aliased, with noise.

    Beyond the camera's table there is grey wall, in the middle the robot's black body.
    """
    shifts = (np.arange(samples) + 0.5) / samples - 0.5
    total = np.zeros((camera.height, camera.width, 3))
    for dv in shifts:
        for du in shifts:
            v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
            pixels = np.column_stack((u.ravel() + du, v.ravel() + dv))
            ground = camera.ground_from_image(pixels)
            colour = np.full((len(ground), 3), GREY, dtype=float)
            seen = ~np.isnan(ground[:, 0])
            colour[seen] = colour_at(ground[seen])
            radius = np.hypot(*(pixels - camera.center).T)
            colour[radius < BODY_PX] = BLACK
            total += colour.reshape(total.shape)
    image = total / samples**2 + np.random.default_rng(seed).normal(0.0, noise, total.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def line_field(lines: list[tuple[float, float, float]], half_width: float = 0.0625, light: float = 1.0):  # type: ignore[no-untyped-def]
    """Colour function of endless lines (a, b, c) with a x + b y = c, (a, b) of unit length, white on green."""

    def colour_at(points: FloatArray) -> FloatArray:
        colours = np.tile(np.array(GREEN, dtype=float), (len(points), 1))
        for a, b, c in lines:
            colours[np.abs(points @ (a, b) - c) <= half_width] = WHITE
        return colours * light

    return colour_at


def distances(points: LinePoints, lines: list[tuple[float, float, float]]) -> FloatArray:
    """(N,) of the points from the nearest line of `line_field` (m)."""
    return np.min([np.abs(points.positions_m @ (a, b) - c) for a, b, c in lines], axis=0)
