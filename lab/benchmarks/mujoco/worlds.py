"""Where the robot walks: the simulation of RoboCup's MuJoCo soccer server in this process, or a hall that is rendered.

Each has `step`, 20 ms of physics with targets of the joints, and `place`, which puts the robot down. What comes back is
what the server tells its players: joints, gyro, the torso's true pose, and the markers of its field.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

os.environ.setdefault("MUJOCO_GL", "egl")  # it is read when MuJoCo is imported first

from rcsssmj.games.soccer.server.soccer_action_parser import SoccerActionParser
from rcsssmj.games.soccer.server.soccer_command_parser import SoccerCommandParser
from rcsssmj.games.soccer.sim.soccer_sim import SoccerSimulation
from rcsssmj.games.soccer.soccer_fields import create_soccer_field
from rcsssmj.sim.actions import InitRequest

from touchline.field import FieldModel
from touchline.field.letters import field_from_letters

CYCLE_S = 0.02
TEAM, MODEL, SERVER_FIELD = "Touchline", "T1", "fifa7vs7"
TOKEN = re.compile(rb"[()]|[^\s()]+")
LEGS = [f"{side}le{k}" for side in "lr" for k in range(1, 7)]
HEAD = ["he1", "he2"]
OTHERS = [*HEAD, "te1", *(f"{side}ae{k}" for side in "lr" for k in range(1, 5))]
POSTURE = {"lae2": -1.3, "rae2": 1.3, "lae4": -0.5, "rae4": 0.5}  # the arms (rad)


class Targets(NamedTuple):
    """Angles (rad) by the server's names of the effectors; stiffness: 0 is limp."""

    angles: Mapping[str, float]
    stiffness: float = 1.0

    def rows(self) -> Iterator[tuple[str, float, float, float]]:
        """Name, angle (rad), gain (Nm/rad), damping (Nm s/rad) of each."""
        for name, angle in self.angles.items():
            gain, damping = (400.0, 6.0) if name in LEGS else (30.0, 1.0)
            yield name, angle, self.stiffness * gain, damping if self.stiffness else 1.0


class Seen(NamedTuple):
    """A marker: azimuth, elevation (rad) and distance (m) from the camera."""

    name: str
    azimuth_rad: float
    elevation_rad: float
    distance_m: float


class Percept(NamedTuple):
    """What a player is told. joints: rad, by the server's names without `q_`; gyro (3,) rad/s; position (3,) m and
    attitude (3, 3) of the torso; seen: None in the cycles without vision.
    """

    time_s: float
    joints: dict[str, float]
    gyro: np.ndarray
    position_m: np.ndarray
    attitude: np.ndarray
    seen: list[Seen] | None


class World(Protocol):
    """Physics around one robot."""

    field: FieldModel

    def step(self, targets: Targets) -> Percept:
        """20 ms on."""

    def place(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Put the robot down, upright."""


def attitude(quaternion: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) of a quaternion w, x, y, z."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def parse(message: bytes) -> Percept:
    """A message of the server: S-expressions, angles in degrees."""
    stack: list[list[Any]] = [[]]
    for token in TOKEN.findall(message):
        if token == b"(":
            stack.append([])
        elif token == b")":
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(token.decode())
    joints, parts = {}, {}
    for name, *rest in stack[0]:
        if name == "HJ":
            (_, joint), (_, angle), _ = rest
            joints[joint.removeprefix("q_")] = math.radians(float(angle))
        else:
            parts[name] = rest
    seen = None
    if "See" in parts:
        seen = [
            Seen(name, math.radians(float(polar[2])), math.radians(float(polar[3])), float(polar[1]))
            for name, polar, *_ in parts["See"]
            if name not in ("P", "B") and polar[0] == "pol"
        ]
    numbers = {name: np.array([float(each) for each in parts[name][1][1:]]) for name in ("GYR", "pos", "quat")}
    time_s = float(parts["time"][0][1])
    return Percept(time_s, joints, np.radians(numbers["GYR"]), numbers["pos"], attitude(numbers["quat"]), seen)


def message(targets: Targets) -> bytes:
    """Targets as the server takes them: name, angle (deg), speed, gain, damping, torque."""
    rows = (f"({name} {math.degrees(q):.3f} 0 {kp} {kd} 0)" for name, q, kp, kd in targets.rows())
    return "".join((*rows, "(syn)")).encode()


def server_field() -> FieldModel:
    """The server's field as its markers stand: those of goal and penalty areas at their full width to either side,
    where half is meant, so these areas are drawn twice as wide as its rules say; its corner arcs have no marker.
    """
    its = create_soccer_field(SERVER_FIELD)
    assert its.penalty_area_dim is not None
    letters = {
        "A": its.field_dim[0], "B": its.field_dim[1], "C": 2.0 * its.penalty_area_dim[1], "E": its.penalty_area_dim[0],
        "D": 2.0 * its.goalie_area_dim[1], "F": its.goalie_area_dim[0], "G": 0.0, "H": 2.0 * its.center_circle_radius,
        "I": its.penalty_spot_distance, "J": 0.2, "K": its.line_width, "L": its.field_border,
    }  # fmt: skip
    field = field_from_letters("rcsssmj-7vs7", letters, measured_to="middle")
    x, y, high = 0.5 * its.field_dim[0], 0.5 * its.goal_dim[1], its.goal_dim[2]
    shape = {"y_posts": (-y, y), "post_width": 2.0 * its.goal_post_radius, "post_shape": "round", "height": high}
    return replace(field, goals=[replace(goal, x=math.copysign(x, goal.x), **shape) for goal in field.goals])


class InProcess:
    """The server's own simulation, without its network."""

    def __init__(self) -> None:
        self.field = server_field()
        self._sim = SoccerSimulation(create_soccer_field(SERVER_FIELD))
        self._sim.init()
        self._sim.step([])  # one that a player joins in its first cycle fails
        (player,) = self._sim.add_players([InitRequest(MODEL, TEAM, 1)])
        assert player is not None
        self._player, self._actions = player, SoccerActionParser()

    def step(self, targets: Targets) -> Percept:
        """20 ms on."""
        self._player.set_actions(self._actions.parse_action(message(targets), self._player.agent_id.prefix))
        self._sim.step([])
        self._sim.generate_perceptions()
        return parse("".join(each.to_sexp() for each in self._player.perceptions).encode())

    def place(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Put the robot down, upright."""
        where = f"{x_m:.4f} {y_m:.4f} 0.6735 {math.degrees(heading_rad):.3f}"
        for command in SoccerCommandParser().parse(f"(agent (unum 1) (team {TEAM}) (move {where}))".encode()):
            command.perform(self._sim)
