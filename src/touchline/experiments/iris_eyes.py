"""The eyes of the IRIS robot: rays every 2.5 degrees, masks of HSV and HSL, ranges by a regression of its own.

Ismail et al. 2021, section II.B, figures 6, 7 and 14.
"""

from __future__ import annotations

import numpy as np

from touchline.calibration.range_pairs import Optics, RangePairs
from touchline.calibration.range_regression import RangeRegression, fit_range
from touchline.camera import require_omni
from touchline.simulation.cameras.omni import SimulatedOmniCamera
from touchline.simulation.run import Simulation
from touchline.simulation.world.calibration_layout import STRIP_EDGES_M
from touchline.systems import RobotSetup

DIRECTIONS = 24
MARK_NOISE_PX = 0.3


def range_regression(simulation: Simulation, rng: np.random.Generator) -> RangeRegression:
    """Figure 14: marks at the distances of the strip, seen in many directions by the robot's own head as it is built.

    One polynomial for all directions, as in the paper: what a tilted mirror does differently on two sides stays in it.
    """
    bearings = np.repeat(2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS), len(STRIP_EDGES_M))
    ranges = np.tile(STRIP_EDGES_M, DIRECTIONS)
    ground = np.column_stack((ranges * np.cos(bearings), ranges * np.sin(bearings)))
    head = simulation.camera_model
    pixels = (
        head.project(ground) if isinstance(head, SimulatedOmniCamera) else simulation.camera.image_from_ground(ground)
    )
    mirror = require_omni(simulation.camera, "marks are read in images of")
    offset = pixels + MARK_NOISE_PX * rng.standard_normal(pixels.shape) - mirror.center
    optics = Optics(
        mirror.width, mirror.height, mirror.center, mirror.handedness, mirror.mount_yaw_rad, mirror.inner_radius_px
    )
    places = tuple(f"mark {k}" for k in range(len(ranges)))
    words = f"{len(ranges)} simulated marks"
    return fit_range(
        RangePairs(np.hypot(*offset.T), ranges, np.arctan2(offset[:, 1], offset[:, 0]), places, words, optics)
    )


def iris_setup(simulation: Simulation, seed: int) -> RobotSetup:
    """The robot: on images it looks through its own regression, at the observation level through the camera's file."""
    camera = None
    if simulation.level == "images":
        camera = range_regression(simulation, np.random.default_rng([seed, 14])).camera()
    return RobotSetup(simulation.field, camera, simulation.wheel_directions_rad)
