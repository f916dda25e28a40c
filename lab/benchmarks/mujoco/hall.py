"""A hall around the server's robot: any field's lines on carpet, goals, other robots, a ball, two lamps; rendered.

MuJoCo's renderer draws off screen by EGL (Mesa's will do: Debian's libegl1 and libgl1-mesa-dri), one to two seconds an
image on a processor. The physics are the server's; robots that stand about are looked at, not bumped into.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
from rcsssmj.resources.spec_provider import ModelSpecProvider
from worlds import CYCLE_S, MODEL, Percept, Targets, attitude

from touchline.field import FieldModel
from touchline.geometry import Pose3

WIDTH, HEIGHT, FOCAL_PX = 640, 480, 420.0
PAINT_M, PIECES = 0.001, 96  # height of the paint; straight pieces of a circle
NOISE = 2.5  # standard deviation of a pixel's values
PUSH_S = 0.1
SENSORS = {"q": 1, "torso_quat": 4, "torso_pos": 3, "torso_gyro": 3}
WHITE, CARPET, FLOOR, WALL = (0.9, 0.9, 0.9, 1), (0.12, 0.36, 0.14, 1), (0.35, 0.3, 0.27, 1), (0.6, 0.6, 0.65, 1)
GEOM = mujoco.mjtGeom


class Hall:
    """A `World` with images: `image` renders what the robot's camera sees now; `push` gives the robot a shove."""

    def __init__(self, field: FieldModel, rng: np.random.Generator, robots: int = 4) -> None:
        self.field, self._rng = field, rng
        self._model = _physics().compile()
        self._data = mujoco.MjData(self._model)
        self._seen_model = _scene(field, rng, robots).compile()
        self._seen = mujoco.MjData(self._seen_model)
        self._renderer: mujoco.Renderer | None = None
        self._push_n, self._push_steps = np.zeros(3), 0
        self._actuators = {self._model.actuator(k).name: k for k in range(self._model.nu)}

    def step(self, targets: Targets) -> Percept:
        """20 ms on."""
        for name, angle, gain, damping in targets.rows():
            at, speed = self._actuators[f"{name}_pos"], self._actuators[f"{name}_vel"]
            self._model.actuator_gainprm[at, 0], self._model.actuator_biasprm[at, 1] = gain, -gain
            self._model.actuator_gainprm[speed, 0], self._model.actuator_biasprm[speed, 2] = damping, -damping
            self._data.ctrl[at] = angle
        self._push_steps -= 1
        self._data.xfrc_applied[1, :3] = self._push_n if self._push_steps >= 0 else 0.0
        mujoco.mj_step(self._model, self._data, round(CYCLE_S / self._model.opt.timestep))
        sensors = {self._model.sensor(k).name: self._data.sensor(k).data for k in range(self._model.nsensor)}
        joints = {name.removeprefix("q_"): float(at[0]) for name, at in sensors.items() if name.startswith("q_")}
        turn = attitude(sensors["torso_quat"])
        return Percept(self._data.time, joints, sensors["torso_gyro"].copy(), sensors["torso_pos"].copy(), turn, None)

    def place(self, x_m: float, y_m: float, heading_rad: float) -> None:
        """Put the robot down, upright."""
        self._data.qpos[:] = 0.0
        self._data.qvel[:] = 0.0
        half = 0.5 * heading_rad
        self._data.qpos[:7] = x_m, y_m, 0.6735, math.cos(half), 0.0, 0.0, math.sin(half)
        mujoco.mj_forward(self._model, self._data)

    def push(self, newtons: np.ndarray) -> None:
        """A force (3,) on the torso, for a tenth of a second."""
        self._push_n, self._push_steps = newtons, round(PUSH_S / CYCLE_S)

    def image(self) -> np.ndarray:
        """What the camera sees (480, 640, 3), BGR."""
        if self._renderer is None:
            self._renderer = mujoco.Renderer(self._seen_model, HEIGHT, WIDTH)
        self._follow()
        self._renderer.update_scene(self._seen, "eye")
        image = self._renderer.render()[..., ::-1] + NOISE * self._rng.standard_normal((HEIGHT, WIDTH, 3))
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    @property
    def eye(self) -> Pose3:
        """The camera now, as `base_from_camera`: x ahead, y left, z up; in the hall's frame."""
        self._follow()
        seen = self._seen.camera("eye")
        optical = seen.xmat.reshape(3, 3)  # x right, y up, z back
        return Pose3(np.stack((-optical[:, 2], -optical[:, 0], optical[:, 1]), axis=1), seen.xpos.copy())

    def _follow(self) -> None:
        """The robot that is looked through is where that of the physics is."""
        self._seen.qpos[: self._model.nq] = self._data.qpos
        mujoco.mj_forward(self._seen_model, self._seen)

    def close(self) -> None:
        """Give the renderer back."""
        if self._renderer is not None:
            self._renderer.close()


def _robot() -> Any:
    return ModelSpecProvider().load_robot_spec(MODEL)


def _physics() -> Any:
    """The robot on a plane."""
    spec = _robot()
    spec.option.timestep = 0.005
    spec.worldbody.add_geom(type=GEOM.mjGEOM_PLANE, size=[60.0, 60.0, 1.0])
    return spec


def _scene(field: FieldModel, rng: np.random.Generator, robots: int) -> Any:
    """The robot with a camera, and all that it sees."""
    spec = _physics()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.1, 0.1, 0.1]
    spec.worldbody.geoms[0].rgba = FLOOR
    head = spec.body("H2")
    fovy = math.degrees(2.0 * math.atan(0.5 * HEIGHT / FOCAL_PX))
    head.add_camera(name="eye", pos=spec.site("camera").pos, xyaxes=[0, -1, 0, 0, 0, 1], fovy=fovy)
    for x, y in rng.uniform(-4.0, 4.0, (2, 2)):
        spec.worldbody.add_light(pos=[x, y, 5.0], dir=[-0.1 * x, -0.1 * y, -1.0], diffuse=[0.5, 0.5, 0.5], cutoff=85)
    _paint(spec.worldbody, field)
    for goal in field.goals:
        _add_goal(spec.worldbody, goal)
    long_m, wide_m = 0.5 * field.length + 4.0, 0.5 * field.width + 4.0
    for side in (-1.0, 1.0):
        for at, size in (([side * long_m, 0], [0.1, wide_m]), ([0, side * wide_m], [long_m, 0.1])):
            spec.worldbody.add_geom(type=GEOM.mjGEOM_BOX, pos=[*at, 1.5], size=[*size, 1.5], rgba=WALL)
    reach = 0.5 * np.array([field.length, field.width])
    ball = rng.uniform(-0.8, 0.8, 2) * reach
    spec.worldbody.add_geom(type=GEOM.mjGEOM_SPHERE, pos=[*ball, 0.11], size=[0.11, 0, 0], rgba=(0.95, 0.9, 0.85, 1))
    for number in range(robots):
        _add_robot(spec, number, rng.uniform(-0.9, 0.9, 2) * reach, rng.uniform(-math.pi, math.pi))
    return spec


def _paint(world: Any, field: FieldModel) -> None:
    """Carpet and lines: boxes a millimetre high."""
    half = [0.5 * field.length + field.border, 0.5 * field.width + field.border]
    world.add_geom(type=GEOM.mjGEOM_BOX, pos=[0, 0, 0.0005], size=[*half, 0.0005], rgba=CARPET)
    wide = 0.5 * field.line_width
    pieces = [(*ends, wide) for ends in field.segments]
    turns = [(cx, cy, radius, 0.0, 2.0 * math.pi) for cx, cy, radius in field.circles]
    for cx, cy, radius, start, end in (*turns, *field.arcs):
        count = math.ceil(PIECES * ((end - start) % (2.0 * math.pi) or 2.0 * math.pi) / (2.0 * math.pi))
        at = np.linspace(start, start + ((end - start) % (2.0 * math.pi) or 2.0 * math.pi), count + 1)
        x, y = cx + radius * np.cos(at), cy + radius * np.sin(at)
        pieces += [(*ends, 0.01) for ends in zip(x[:-1], y[:-1], x[1:], y[1:], strict=True)]
    for number, (x1, y1, x2, y2, beyond) in enumerate(pieces):
        half_m, turn = 0.5 * math.hypot(x2 - x1, y2 - y1), 0.5 * math.atan2(y2 - y1, x2 - x1)
        world.add_geom(
            type=GEOM.mjGEOM_BOX, pos=[0.5 * (x1 + x2), 0.5 * (y1 + y2), PAINT_M * (1.0 + 0.1 * (number % 4))],
            size=[half_m + beyond, wide, 0.5 * PAINT_M], quat=[math.cos(turn), 0, 0, math.sin(turn)], rgba=WHITE,
        )  # fmt: skip
    for cx, cy, diameter in field.discs:
        size = [0.5 * diameter, 0.5 * PAINT_M, 0]
        world.add_geom(type=GEOM.mjGEOM_CYLINDER, pos=[cx, cy, PAINT_M], size=size, rgba=WHITE)


def _add_goal(world: Any, goal: Any) -> None:
    """Posts, crossbar, and a net as a thin grey wall."""
    radius, outwards = 0.5 * goal.post_width, math.copysign(goal.depth, goal.x)
    for y in goal.y_posts:
        size = [radius, 0.5 * goal.height, 0]
        world.add_geom(type=GEOM.mjGEOM_CYLINDER, pos=[goal.x, y, 0.5 * goal.height], size=size, rgba=WHITE)
    middle, half = sum(goal.y_posts) / 2.0, 0.5 * abs(goal.y_posts[1] - goal.y_posts[0])
    bar = {"pos": [goal.x, middle, goal.height], "quat": [math.sqrt(0.5), math.sqrt(0.5), 0, 0]}
    world.add_geom(type=GEOM.mjGEOM_CYLINDER, size=[radius, half, 0], rgba=WHITE, **bar)
    size = [0.01, half, 0.5 * goal.height]
    world.add_geom(type=GEOM.mjGEOM_BOX, pos=[goal.x + outwards, middle, size[2]], size=size, rgba=(0.7, 0.7, 0.7, 0.4))


def _add_robot(spec: Any, number: int, at: np.ndarray, heading_rad: float) -> None:
    """Another robot that stands still: its bodies without joints."""
    other = _robot()
    for joint in list(other.joints):
        other.delete(joint)
    half = 0.5 * heading_rad
    frame = spec.worldbody.add_frame(pos=[*at, 0.0], quat=[math.cos(half), 0, 0, math.sin(half)])
    frame.attach_body(other.body("torso"), f"other{number}-", "")
