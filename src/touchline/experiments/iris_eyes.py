"""The eyes of the IRIS robot: rays every 2.5 degrees, masks of HSV and HSL, ranges by a regression of its own.

Ismail et al. 2021, section II.B, figures 6, 7 and 14.
"""

from __future__ import annotations

import numpy as np

from touchline.calibration.range_pairs import Optics, RangePairs
from touchline.calibration.range_regression import RangeRegression, fit_range
from touchline.camera import require_omni
from touchline.experiments.drives import Drive, drive_of
from touchline.simulation.cameras.omni import SimulatedOmniCamera
from touchline.simulation.observation.goal_clutter import GoalClutter
from touchline.simulation.observation.observed_lines import IRIS_PATHS
from touchline.simulation.observation.point_errors import ObservationNoise
from touchline.simulation.run import Eyes, Simulation
from touchline.simulation.scenario import Scenario
from touchline.simulation.world.calibration_layout import STRIP_EDGES_M
from touchline.systems import RobotSetup

DIRECTIONS = 24
MARK_NOISE_PX = 0.3
# How HsvLineDetector errs on rendered images: `benchmarks/fit_observation_level.py --iris`
IRIS_NOISE = ObservationNoise(
    noise_px=0.0509, tail=1.056, oblique_sine=0.407, thin_px=0.271, kept_ratio=0.947, phase_px=0.3,
    found_ratio=0.977, thin_half_px=0.931, thin_slope_px=0.0714, coarse_half_m=0.2787, coarse_slope_m=0.0037,
    flat_half=0.174, flat_slope=0.11, blur_px=4.61, long_slope_px=0.896, bar_ratio=0.707, bar_half_m=5.18,
    bar_slope_m=0.0537, mark_ratio=0.582, grazed_ratio=0.355, grazed_factor=6.64, mixed_ratio=0.997,
    mixed_factor=2.08, contrast_px=1.23, false_points=0.0396,
    white_goals=GoalClutter(
        net_points=50.0, net_half_m=2.87, net_slope_m=0.474, net_near_m=2.77, side_points=4.49, side_half_m=3.5,
        side_slope_m=0.596
    ),
    coloured_goals=GoalClutter(
        net_points=90.1, net_half_m=3.0, net_slope_m=0.474, net_near_m=2.66, side_points=12.9, side_half_m=1.69,
        side_slope_m=1.25
    ),
    covered_goals=GoalClutter(
        net_points=40.2, net_half_m=2.58, net_slope_m=0.437, net_near_m=2.71, side_points=7.06, side_half_m=2.98,
        side_slope_m=0.8
    ),
)  # fmt: skip


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


def iris_drive(scenario: Scenario, level: str, seed: int) -> Drive:
    """The drive of `open_iris`."""
    simulation, setup = open_iris(scenario, level, seed)
    return drive_of(simulation, setup)


def open_iris(scenario: Scenario, level: str, seed: int) -> tuple[Simulation, RobotSetup]:
    """A run and the robot in it, who looks through the regression that its own head has marked.

    level: `images`, through its masks and rays; or `points`, with the geometry and the errors of these.
    """
    simulation = Simulation(scenario, level)
    known = range_regression(simulation, np.random.default_rng([seed, 14])).camera()
    if level == "points":
        simulation = Simulation(scenario, level, eyes=Eyes(IRIS_PATHS, IRIS_NOISE, known))
    return simulation, RobotSetup(simulation.field, known, simulation.wheel_directions_rad)
