"""iris-disturbances: a covered camera, a slip of the wheels, a drifting gyro, one at a time. No figure of the paper."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from touchline.evaluation.experiments.iris_runs import Disturb, IrisDrive, covered, drifting, drive, slipped
from touchline.evaluation.experiments.result import ExperimentResult, Headline
from touchline.evaluation.experiments.scenes import BLUE, RED, new_figure
from touchline.geometry import FloatArray
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.types import Status

START_S, SECONDS = 8.0, 18.0
COVERED_S, SLIP_M, DRIFT_RAD_S = 3.0, 0.3, math.radians(1.0)
FAR_M, NEAR_M, BACK_S = 0.3, 0.1, 2.0
FIELDS = ("indoor-9x6", "msl-18x12")
KINDS = ("nothing", "covered", "slip", "drift")
PER_SEED = 4  # drives of each kind, field and scenario
SCENARIOS = ("tour-20", "match")


@dataclass(frozen=True, eq=False, slots=True)
class Outcome:
    """What a disturbance did to the fused pose. ends_s: when the disturbance was over, since the first located image.

    far_s: how long the pose was more than 30 cm off; back_m: largest error from 2 s after the end on; lost_s: how long
    the status was lost.
    """

    drive: IrisDrive
    ends_s: float
    far_s: float
    back_m: float
    lost_s: float
    largest_m: float

    @property
    def times_s(self) -> FloatArray:
        """Time since the disturbance began (N,)."""
        since: FloatArray = self.drive.stamp_ns / 1e9 - START_S
        return since


def disturbed_drive(kind: str, scenario_name: str, field: str, seed: int, level: str = "points") -> Outcome:
    """One drive with a disturbance that begins 8 s after its start; nothing else happens in it.

    kind: one of KINDS. Raises KeyError for another.
    """
    scenario = open_scenario(scenario_name, seed, SECONDS)
    mishaps = scenario.mishaps.model_copy(update={"shove_every_s": 0.0})
    simulation = Simulation(scenario.model_copy(update={"field": field, "mishaps": mishaps}), level)
    wheels = simulation.wheel_directions_rad
    direction = float(np.random.default_rng([seed, 5]).uniform(-math.pi, math.pi))
    disturb: Disturb
    disturb, lasts_s = {
        "nothing": (lambda frame: frame, 0.0),
        "covered": (covered(START_S, COVERED_S), COVERED_S),
        "slip": (slipped(START_S, SLIP_M, direction, wheels), 0.15),
        "drift": (drifting(START_S, DRIFT_RAD_S), 0.0),
    }[kind]
    frames = (disturb(frame) for frame in simulation)
    camera = simulation.camera if level == "images" else None
    driven = drive(frames, simulation.truth.samples(), simulation.field, camera, wheels, seed)
    return _outcome(driven, START_S + lasts_s)


def _outcome(driven: IrisDrive, ends_s: float) -> Outcome:
    times_s = driven.stamp_ns / 1e9
    distances_m = driven.distances_m("sensor fusion")
    period_s = float(np.median(np.diff(times_s)))
    lost = np.array([status is Status.LOST for status in driven.statuses])
    return Outcome(
        driven,
        ends_s,
        period_s * float(np.count_nonzero(distances_m > FAR_M)),
        float(distances_m[times_s >= ends_s + BACK_S].max()),
        period_s * float(np.count_nonzero(lost)),
        float(distances_m.max()),
    )
