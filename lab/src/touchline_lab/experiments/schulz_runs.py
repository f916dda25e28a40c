"""What the experiments with humanoids share: walks at the observation level or recorded, and tracks of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from touchline.config import load_settings
from touchline.evaluation.runner import robot_setup
from touchline.field import open_field
from touchline.geometry import BoolArray, Pose
from touchline.motion import MotionHistory
from touchline.published.nimbro_lines.system import NimbroLines, NimbroLinesSettings
from touchline.systems import RobotSetup
from touchline.types import Frame, Observation, Prior
from touchline_lab.experiments.clutter import false_crossings
from touchline_lab.experiments.drives import Drive, Track, drive_of, followed
from touchline_lab.experiments.harness import tell
from touchline_lab.experiments.scenes import public_recording, random_place
from touchline_lab.simulation.observation.feature_noise import PINHOLE_FEATURES
from touchline_lab.simulation.observation.features import leaning
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

OURS, PAPER = "nimbro-lines", "the paper's own form"
SCENARIO = "humanoid-walk"
RECORDINGS = ("humanoid_9x6_walk", "humanoid_hsl_pan")
FIELDS = {"indoor-9x6": "coloured goals, poles", "humanoid-kid-9x6": "white goals, no poles"}
NEAR_M = 0.4  # the paper counts how many poses are within it
RIGHT_M, RIGHT_RAD = 0.5, math.radians(20.0)
_START_M, _START_RAD = 0.3, math.radians(10.0)
_NODS = 0.125  # of the head, from side to side and back, per second

# what is painted counts as lines: the circle, too, and the marks that the paper does not name
NO_MARKS = "paper.features.marks=false"
WITHOUT_LINES = (*(f"features.use.{kind}=false" for kind in ("lines", "crossings")), NO_MARKS)
TRACKING_ALONE = ("particles.random_ratio=0", "particles.max_random_ratio=0")  # without global localization
ONLY_LINES = (*(f"features.use.{kind}=false" for kind in ("posts", "poles")), NO_MARKS)


class Robot(NamedTuple):
    """How well a robot is built, and what is about it.

    lean_deg: by how much the camera's roll and pitch err in each image; None: as the simulator has it. askew_deg: by
    how much they err all the time, which no covariance tells. worn: share of the lines and crossings that are not
    found. away_s: so long it looks at the field and so long away from it, by turns. pan_deg: by how much its head turns
    to either side. changes: of the scenario.
    """

    name: str
    lean_deg: float | None = None
    askew_deg: float = 0.0
    worn: float = 0.0
    away_s: float = 0.0
    pan_deg: float = 0.0
    changes: tuple[str, ...] = ()


_CLOSE_BY = ("others.robots=4", "others.moving=true", "others.near_m=1.5", "others.speed_m_s=0.5")
AS_BUILT = Robot("as built", 0.7, 0.7, 0.25, 2.0, changes=_CLOSE_BY)
AS_SIMULATED = Robot("as simulated")
PANNING = Robot("head panning ± 60°", pan_deg=60.0)
IDEAL = Robot("ideal", 0.0, changes=("others.robots=0", "others.balls=0"))


def walk(field_name: str, robot: Robot, seed: int, seconds: float, changes: Sequence[str] = ()) -> Drive:
    """A humanoid walks from target area to target area; its frames hold features at the observation level."""
    changed = (f"field={field_name}", *robot.changes, *changes)
    noise = PINHOLE_FEATURES.model_copy(
        update={
            "lean_deg": PINHOLE_FEATURES.lean_deg if robot.lean_deg is None else robot.lean_deg,
            "found_ratio": PINHOLE_FEATURES.found_ratio * (1.0 - robot.worn),
            "line_ratio": PINHOLE_FEATURES.line_ratio * (1.0 - robot.worn),
        }
    )
    simulation = Simulation(open_scenario(SCENARIO, seed, seconds, changed), "points", feature_noise=noise)
    frames = tuple(_seen(simulation, robot, index) for index in range(len(simulation)))
    return drive_of(simulation, RobotSetup(simulation.field, height_m=PINHOLE_FEATURES.height_m), frames)


def _seen(simulation: Simulation, robot: Robot, index: int) -> Frame:
    frame = simulation.frame(index)
    time_s = frame.stamp_ns / 1e9
    if robot.away_s and time_s % (2.0 * robot.away_s) >= robot.away_s:
        return replace(frame, observation=Observation(frame.stamp_ns))
    pan_rad = math.radians(robot.pan_deg) * math.sin(2.0 * math.pi * _NODS * time_s)
    roll, pitch = np.radians(robot.askew_deg) * np.random.default_rng([simulation.scenario.seed, 25]).standard_normal(2)
    seen = leaning(simulation.features(index, pan_rad), float(roll), float(pitch), PINHOLE_FEATURES.height_m)
    return replace(frame, observation=seen)


def settings(form: str = OURS, *changes: str) -> NimbroLinesSettings:
    """Those of the system, or of the paper's own form, with changes as `features.use.lines=false`."""
    return load_settings(NimbroLinesSettings, None, changes, preset="paper" if form == PAPER else None)


def start_about(truth: Pose, seed: int) -> Pose:
    """A pose within 0.3 m and 10° of the truth."""
    rng = np.random.default_rng([seed, 21])
    away_m, direction = _START_M * math.sqrt(rng.random()), rng.uniform(-math.pi, math.pi)
    return Pose(
        truth.x + away_m * math.cos(direction),
        truth.y + away_m * math.sin(direction),
        truth.heading + rng.uniform(-_START_RAD, _START_RAD),
    )


def tracked(
    walked: Drive,
    seed: int,
    chosen: NimbroLinesSettings | Mapping[str, Any] | None = None,
    prior: Prior | None = None,
    forget_s: float = math.inf,
    system: str = OURS,
) -> Track:
    """A system's track of a walk. prior: what it is told at the start; None: a pose near the true one.

    forget_s: when it is told that it may be anywhere.
    """
    start = Prior(start_about(Pose(*walked.truth[0]), seed)) if prior is None else prior
    return followed(system, walked, [seed, 22], chosen, start, forget_s)


def dead_reckoned(walked: Drive) -> Track:
    """The odometry alone, from the true start on."""
    history, pose, poses = MotionHistory(), Pose(*walked.truth[0]), []
    for frame in walked.frames:
        pose = pose.compose(history.take(frame).pose)
        poses.append(pose)
    return Track(walked.times_s, np.array(poses), walked.truth, np.ones(len(poses), dtype=np.bool_))


def recorded_walk(name: str, form: str = OURS) -> Drive | None:
    """A recording with what nimbro-lines, or the paper's own form of it, sees in its images; None where not found."""
    recording = public_recording(name)
    if recording is None:
        return None
    setup = robot_setup(recording)
    system = NimbroLines(setup, settings(form), np.random.default_rng(0))
    seen: list[Frame] = []
    for frame in recording:
        seen.append(replace(frame, image=None, observation=system.step(frame).observation))
        tell(f"images of {name}, {len(seen)}")
    return drive_of(recording, setup, seen)


def with_false_crossings(share: float, walked: Drive, seed: int) -> Drive:
    """A walk of whose crossings so many are none."""
    everywhere = np.ones(len(walked.frames), np.bool_)
    return false_crossings(share)(walked, everywhere, np.random.default_rng([seed, 23]))


def random_areas(field_name: str, seed: int, areas: int = 4) -> tuple[str, ...]:
    """A change of the scenario: target areas anywhere on the field, half a metre inside its lines."""
    field, rng = open_field(field_name), np.random.default_rng([seed, 24])
    places = [random_place(field, rng, 0.5) for _ in range(areas)]
    return (f"motion.waypoints={[[round(p.x, 2), round(p.y, 2), 0.0] for p in places]}",)


def either_end(track: Track) -> Track:
    """Of each pose and its twin at the field's other end the nearer one to the truth."""
    turned = track.turned
    nearer = turned.distances_m + turned.turns_rad < track.distances_m + track.turns_rad
    return replace(track, poses=np.where(nearer[:, np.newaxis], turned.poses, track.poses))


def right_of(track: Track) -> BoolArray:
    """(N,) whether the pose is within 0.5 m and 20°."""
    return track.within(RIGHT_M, RIGHT_RAD)


def believed(track: Track) -> float:
    """Share of the frames that are right and believed."""
    return float(np.mean(right_of(track) & track.tracking))


def time_until_right(track: Track, from_s: float = 0.0) -> float:
    """Seconds from a time until the pose is right, believed, and stays so for two seconds; inf if never."""
    good = right_of(track) & track.tracking
    for index in np.flatnonzero(good & (track.times_s >= from_s)):
        stays = (track.times_s >= track.times_s[index]) & (track.times_s < track.times_s[index] + 2.0)
        if good[stays].all():
            return float(track.times_s[index] - from_s)
    return math.inf
