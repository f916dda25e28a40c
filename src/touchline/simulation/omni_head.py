"""What an omnidirectional camera sees of its own robot: the body in the middle, the rods, the mirror's rim, the dark."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from touchline.camera import OmniCamera

_RIM_PX = 11.5  # the recorded head's mirror reaches this far beyond its outer radius, then the rim begins
_RODS_RAD = (0.019, 2.107, -2.065)
_SAMPLES = 4


def head_layer(design: OmniCamera, edge_px: float | None = None) -> npt.NDArray[np.float32]:
    """Reflectance red, green, blue (premultiplied) and share of the pixel, (H, W, 4), of what turns with the robot.

    An octagonal body a little smaller than the inner radius, three rods half a hundredth of the radius thick on each side
    at the body and twice that at the rim, a dark rim at edge_px and darkness beyond. 4 x 4 samples each
    pixel.
    """
    edge = design.outer_radius_px + _RIM_PX if edge_px is None else edge_px
    layer = np.zeros((design.height, design.width, 4))
    offsets = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    u, v = np.meshgrid(np.arange(design.width, dtype=np.float64), np.arange(design.height, dtype=np.float64))
    for dv in offsets:
        for du in offsets:
            x, y = u + du - design.center[0], v + dv - design.center[1]
            layer += _head_colours(x, y, design.inner_radius_px, edge)
    return (layer / _SAMPLES**2).astype(np.float32)


def _head_colours(
    x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], inner: float, outer: float
) -> npt.NDArray[np.float64]:
    radius = np.hypot(x, y)
    colours = np.zeros((*x.shape, 4))
    for angle in _RODS_RAD:
        along = x * np.cos(angle) + y * np.sin(angle)
        across = np.abs(y * np.cos(angle) - x * np.sin(angle))
        colours[(along > 0.0) & (across < 0.006 * radius + 0.5 + 0.008 * np.maximum(radius - inner, 0.0))] = (
            0.006,
            0.006,
            0.006,
            1.0,
        )
    unit = inner / 52.0
    side = 41.0 * unit
    body = (np.maximum(np.abs(x), np.abs(y)) < side) & (np.abs(x) + np.abs(y) < side * 1.414)
    colours[body] = (0.046, 0.044, 0.050, 1.0)
    colours[(np.abs(x) < 15.5 * unit) & (np.abs(y + 18.5 * unit) < 6.5 * unit)] = (0.16, 0.15, 0.16, 1.0)
    colours[(np.abs(x + 9.0 * unit) < 13.0 * unit) & (np.abs(y - 25.5 * unit) < 9.5 * unit)] = (0.062, 0.057, 0.09, 1.0)
    colours[np.hypot(x - 27.0 * unit, y) < 8.0 * unit] = (0.03, 0.50, 0.60, 1.0)
    colours[radius > outer] = (0.034, 0.031, 0.030, 1.0)
    colours[radius > outer + 4.0] = (0.0, 0.0, 0.0, 1.0)
    return colours
