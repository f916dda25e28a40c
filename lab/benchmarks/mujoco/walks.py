"""A humanoid of RoboCup's MuJoCo soccer server walks: recordings with truth, of images or of the server's own percepts.

    python lab/benchmarks/mujoco/walks.py FOLDER --world hall [--field hsl-s-9x6] [--seconds 20] [--seed 0] [--calm]
    python lab/benchmarks/mujoco/walks.py FOLDER --world percepts [--seconds 60] [--seed 0]

`hall` renders images along the walk and gives pushes; `percepts` is the server's simulation in this process, on its own
field. Without --calm there are falls (the legs go limp; the robot gets up where it lies, turned) and, with percepts,
kidnaps. Needs `pip install 'touchline-lab[mujoco]'`.

The robot's sensors are as built, errors drawn per seed: joints' zeros, the IMU's lean (late, noisy, off), the gyro's
bias, odometry by the standing leg's joints and the gyro, and kinematics of the camera whose roll, pitch, height and
focal length are off by as much as `touchline` expects of a robot that nobody calibrated.
"""

from __future__ import annotations

import argparse
import math
from collections import deque
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml
from gait import Gait, foot, rotation
from worlds import CYCLE_S, HEAD, LEGS, OTHERS, POSTURE, InProcess, Percept, Targets, World

from touchline.field import FieldModel, open_field
from touchline.geometry import Pose3, wrap_angle
from touchline.localization.camera_errors.perspective import DEVIATIONS
from touchline.sources.observations import HEADER

WALK_M_S, TURN_RAD_S, REACH_M = 0.25, 0.6, 0.4  # of a waypoint that is taken for reached
PAN_RAD, PAN_S, TILT_RAD = 0.8, 5.0, 0.35
IMAGE_CYCLES, PERCEPT_CYCLES = 6, 2  # an image each 120 ms, a percept each 40, as the server gives them
LIMP_S, LIE_S, EVENT_S = 0.8, 2.0, 15.0  # an event each so many seconds, in the mean
PUSH_N = 60.0
AZIMUTH_RAD, DISTANCE_RATIO, DISTANCE_M = math.radians(0.5), 0.03, 0.02  # noise of percepts
JOINT_RAD, LEAN_RAD, LEAN_NOISE_RAD, LAG_CYCLES = math.radians(0.3), math.radians(0.4), math.radians(0.3), 1
GYRO_RAD_S = math.radians(0.3)
HEADERS = {
    "odometry": "t,x,y,theta",
    "imu": "t,roll,pitch,yaw,gx,gy,gz",
    "camera_pose": "t,x,y,z,roll,pitch,yaw",
    "images": "t,file,exposure_ms,gain",
    "observations": HEADER,
}
KINDS = {"l": "L", "t": "T", "x": "X", "p": "penalty_mark", "g": "post"}
NECK = Pose3(np.eye(3), np.array([0.0625, 0.0, 0.243]))
HEAD_M, EYE_M = np.array([0.0, 0.0, 0.06185]), np.array([0.05, 0.0, 0.12])


class Errors(NamedTuple):
    """Of one robot's sensors. camera: roll, pitch (rad), height ratio, focal ratio."""

    joints: dict[str, float]
    lean_rad: np.ndarray
    gyro_rad_s: float
    camera: np.ndarray

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Errors:
        """Those of a robot as built, with a camera that nobody calibrated."""
        names = [*("hj1", "hj2"), *(f"{side}lj{k}" for side in "lr" for k in range(1, 7))]
        joints = dict(zip(names, JOINT_RAD * rng.standard_normal(len(names)), strict=True))
        lean, gyro = LEAN_RAD * rng.standard_normal(2), GYRO_RAD_S * rng.choice((-1.0, 1.0))
        return cls(joints, lean, gyro, np.array(DEVIATIONS) * rng.standard_normal(4))


class Kinematics:
    """What the robot makes of its joints, IMU and gyro: odometry (x, y, theta), lean, the camera in the base frame."""

    def __init__(self, errors: Errors, rng: np.random.Generator) -> None:
        self._errors, self._rng = errors, rng
        self.odometry, self.lean_rad, self.camera = np.zeros(3), np.zeros(2), Pose3.identity()
        self._late: deque[np.ndarray] = deque(maxlen=LAG_CYCLES + 1)
        self._feet: dict[int, np.ndarray] = {}

    def update(self, percept: Percept) -> None:
        """Take one cycle."""
        true = Pose3(percept.attitude, np.zeros(3)).roll_pitch_yaw()
        self._late.append(np.array(true[:2]))
        self.lean_rad = self._late[0] + self._errors.lean_rad + LEAN_NOISE_RAD * self._rng.standard_normal(2)
        joints = {name: angle + self._errors.joints.get(name, 0.0) for name, angle in percept.joints.items()}
        level = Pose3.from_roll_pitch_yaw(*self.lean_rad).rotation
        feet = {}
        for side, letter in ((1, "l"), (-1, "r")):
            angles = np.array([joints[f"{letter}lj{k}"] for k in range(1, 7)])
            feet[side] = level @ foot(angles, side)[0]
        self._walk(feet, float(percept.gyro[2]) + self._errors.gyro_rad_s)
        height_m = -min(at[2] for at in feet.values())
        head = NECK.compose(Pose3(rotation(2, joints["hj1"]), np.zeros(3)))
        head = head.compose(Pose3(rotation(1, joints["hj2"]), HEAD_M)).compose(Pose3(np.eye(3), EYE_M))
        off_roll, off_pitch, height, _ = self._errors.camera
        off = Pose3.from_roll_pitch_yaw(off_roll, off_pitch).rotation
        place = level @ head.translation_m + np.array([0.0, 0.0, height_m])
        self.camera = Pose3(level @ head.rotation @ off, place * np.array([1.0, 1.0, 1.0 + height]))

    def _walk(self, feet: dict[int, np.ndarray], rate_rad_s: float) -> None:
        """Where the torso has moved over the foot that bears: the lower one."""
        if self._feet:
            stance = min(feet, key=lambda side: feet[side][2])
            turn_rad, (x, y, theta) = CYCLE_S * rate_rad_s, self.odometry
            step = self._feet[stance][:2] - rotation(2, turn_rad)[:2, :2] @ feet[stance][:2]
            ahead = rotation(2, theta)[:2, :2] @ step
            self.odometry = np.array([x + ahead[0], y + ahead[1], wrap_angle(theta + turn_rad)])
        self._feet = feet


class Walker:
    """Walks from waypoint to waypoint, its head panning; falls, kidnaps, pushes come as drawn."""

    def __init__(self, world: World, rng: np.random.Generator, calm: bool) -> None:
        self._world, self._rng, self._calm = world, rng, calm
        self._reach = 0.5 * np.array([world.field.length, world.field.width]) - 0.3
        self._gait, self._time_s, self._limp_s, self._next_s = Gait(), 0.0, -1.0, math.inf if calm else 6.0
        self._pan_s = float(rng.uniform(0.0, PAN_S))
        x, y = rng.uniform(-0.8, 0.8, 2) * self._reach
        world.place(x, y, rng.uniform(-math.pi, math.pi))
        self._goal = self._waypoint(np.array([x, y]))
        self.percept = world.step(Targets({**dict.fromkeys((*OTHERS, *LEGS), 0.0), **POSTURE}))
        self.events: list[dict[str, Any]] = []

    def _waypoint(self, at: np.ndarray) -> np.ndarray:
        return np.clip(at + self._rng.uniform(-4.0, 4.0, 2), -self._reach, self._reach)

    def step(self) -> Percept:
        """20 ms on."""
        self._time_s += CYCLE_S
        if self._limp_s >= 0.0:
            return self._fall()
        if self._time_s > self._next_s:
            self._next_s = self._time_s + self._rng.exponential(EVENT_S)
            self._begin_event()
        p = self.percept
        roll, pitch, yaw = Pose3(p.attitude, np.zeros(3)).roll_pitch_yaw()
        away = self._goal - p.position_m[:2]
        if np.hypot(*away) < REACH_M:
            self._goal = self._waypoint(p.position_m[:2])
        turn = wrap_angle(math.atan2(away[1], away[0]) - yaw)
        speed = WALK_M_S * max(math.cos(turn), 0.0) * min(self._time_s, 1.0)
        velocity = np.array([speed, 0.0, np.clip(turn, -TURN_RAD_S, TURN_RAD_S) * min(self._time_s, 1.0)])
        legs = self._gait.step(CYCLE_S, velocity, np.array([roll, pitch]), p.gyro[:2])
        pan = PAN_RAD * math.sin(2.0 * math.pi * (self._time_s + self._pan_s) / PAN_S)
        angles = {**dict.fromkeys(OTHERS, 0.0), **POSTURE, **dict(zip(HEAD, (pan, TILT_RAD), strict=True))}
        self.percept = self._world.step(Targets({**angles, **dict(zip(LEGS, legs.ravel().tolist(), strict=True))}))
        if self.percept.attitude[2, 2] < 0.7:  # it has fallen by itself
            self._limp_s = 0.0
        return self.percept

    def _begin_event(self) -> None:
        push = getattr(self._world, "push", None)
        kind = self._rng.choice(["fall", "kidnap"] if push is None else ["push", "fall"])
        self.events.append({"t": round(self._time_s, 3), "kind": str(kind)})
        if kind == "fall":
            self._limp_s = 0.0
        elif kind == "push" and push is not None:
            push(np.append(PUSH_N * self._rng.standard_normal(2), 0.0))
        else:
            self._put_down(self._rng.uniform(-0.8, 0.8, 2) * self._reach, self._rng.uniform(-math.pi, math.pi))

    def _fall(self) -> Percept:
        """Limp, then lying, then up again where it lies, turned by what getting up turns it."""
        self._limp_s += CYCLE_S
        limp = Targets({**dict.fromkeys((*OTHERS, *LEGS), 0.0), **POSTURE}, 0.0 if self._limp_s < LIMP_S else 0.05)
        self.percept = self._world.step(limp)
        if self._limp_s > LIMP_S + LIE_S:
            yaw = Pose3(self.percept.attitude, np.zeros(3)).roll_pitch_yaw()[2]
            self._put_down(self.percept.position_m[:2], yaw + math.radians(15.0) * self._rng.standard_normal())
        return self.percept

    def _put_down(self, at: np.ndarray, heading_rad: float) -> None:
        self._world.place(float(at[0]), float(at[1]), float(heading_rad))
        self._gait, self._limp_s, self._goal = Gait(), -1.0, self._waypoint(at)


def record(world: World, folder: Path, seconds: float, seed: int, calm: bool) -> None:
    """Walk, and write the recording."""
    rng = np.random.default_rng([seed, 27])
    errors = Errors.drawn(rng)
    walker, kinematics = Walker(world, rng, calm), Kinematics(errors, rng)
    folder.mkdir(parents=True)
    rows: dict[str, list[str]] = {name: [] for name in (*HEADERS, "truth")}
    image = getattr(world, "image", None)
    if image is not None:
        (folder / "images").mkdir()
    due, cycles = False, PERCEPT_CYCLES if image is None else IMAGE_CYCLES
    for cycle in range(round(seconds / CYCLE_S)):
        percept = walker.step()
        kinematics.update(percept)
        t = f"{cycle * CYCLE_S + CYCLE_S:.3f}"
        rows["odometry"].append(_row(t, kinematics.odometry))
        rates = percept.gyro + np.array([0.0, 0.0, errors.gyro_rad_s])
        rows["imu"].append(_row(t, [*kinematics.lean_rad, math.nan, *rates]))
        rows["camera_pose"].append(_row(t, [*kinematics.camera.translation_m, *kinematics.camera.roll_pitch_yaw()]))
        due = due or cycle % cycles == 0
        if not due or (image is None and percept.seen is None):  # the server lets its players see in every other cycle
            continue
        due = False
        heading = Pose3(percept.attitude, np.zeros(3)).roll_pitch_yaw()[2]
        half = 0.5 * heading
        x, y = percept.position_m[:2]
        rows["truth"].append(f"{t} {x:.6f} {y:.6f} 0 0 0 {math.sin(half):.9f} {math.cos(half):.9f}")
        if image is not None:
            name = f"images/{len(rows['images']):06d}.jpg"
            cv2.imwrite(str(folder / name), image(), [cv2.IMWRITE_JPEG_QUALITY, 92])
            rows["images"].append(f"{t},{name},10.0,1.0")
        else:
            rows["observations"] += _seen_rows(t, percept, kinematics.camera, world.field.goals[0].height, rng)
    _write(folder, world.field, rows, walker.events, errors)


def _row(t: str, values: Any) -> str:
    return ",".join([t, *("" if math.isnan(value) else f"{value:.6f}" for value in values)])


def _seen_rows(t: str, percept: Percept, camera: Pose3, goal_m: float, rng: np.random.Generator) -> list[str]:
    """The server's markers with noise, laid on the ground by the robot's kinematics; in each row its covariance.

    goal_m: height of the goals, at whose top their markers stand.
    """
    rows = []
    for name, azimuth, elevation, distance_m in percept.seen or ():
        azimuth += AZIMUTH_RAD * rng.standard_normal()
        elevation += AZIMUTH_RAD * rng.standard_normal()
        range_sd = DISTANCE_RATIO * distance_m + DISTANCE_M
        distance_m += range_sd * rng.standard_normal()
        flat = math.cos(elevation)
        ray = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
        ahead, drop_m = (camera.rotation @ ray)[:2], camera.translation_m[2] - (goal_m if name[0] == "g" else 0.0)
        flat_m = math.sqrt(max(distance_m**2 - drop_m**2, 0.01))  # along the ground: how high a marker is, is known
        x, y = camera.translation_m[:2] + flat_m * ahead / np.hypot(*ahead)
        bearing = math.atan2(y, x)
        turn = rotation(2, bearing)[:2, :2]
        xx, xy, _, yy = (turn @ np.diag([range_sd**2, (distance_m * AZIMUTH_RAD) ** 2]) @ turn.T).ravel()
        rows.append(f"{t},{KINDS[name[0]]},{x:.4f},{y:.4f},,,,{xx:.6f},{xy:.6f},{yy:.6f},,,,,1")
    return rows or [f"{t},none,,,,,,,,,,,,,"]


def _write(folder: Path, field: FieldModel, rows: dict[str, list[str]], events: list[Any], errors: Errors) -> None:
    field.to_yaml(folder / "field.yaml")
    images = bool(rows["images"])
    sequence = {
        "format": 1, "name": folder.name, "field": field.name, "camera": "pinhole" if images else "none",
        "rate_hz": round(1.0 / ((IMAGE_CYCLES if images else PERCEPT_CYCLES) * CYCLE_S), 3), "events": events,
        "description": "A T1 walks by the physics of RoboCup's MuJoCo soccer server.",
    }  # fmt: skip
    (folder / "sequence.yaml").write_text(yaml.safe_dump(sequence, sort_keys=False))
    for name, header in HEADERS.items():
        if rows[name] and (images or name != "camera_pose"):
            (folder / f"{name}.csv").write_text("\n".join([header, *rows[name], ""]))
    (folder / "ground_truth.tum").write_text("\n".join([*rows["truth"], ""]))
    if images:
        from hall import FOCAL_PX, HEIGHT, WIDTH

        focal_px = round(FOCAL_PX * (1.0 + float(errors.camera[3])), 3)
        camera = {
            "model": "pinhole", "width": WIDTH, "height": HEIGHT, "fx": focal_px, "fy": focal_px,
            "cx": (WIDTH - 1) / 2, "cy": (HEIGHT - 1) / 2, "distortion": [0.0] * 5,
            "mount": {"x": 0.1, "y": 0.0, "z": 1.0, "roll": 0.0, "pitch": TILT_RAD, "yaw": 0.0},
        }  # fmt: skip
        (folder / "camera.yaml").write_text(yaml.safe_dump(camera, sort_keys=False))


def main() -> None:
    """What the head of this file says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--world", choices=("hall", "percepts"), required=True)
    parser.add_argument("--field", default="hsl-s-9x6")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--calm", action="store_true")
    given = parser.parse_args()
    if given.folder.exists():
        parser.error(f"{given.folder}: exists already; choose another name")
    if given.world == "hall":
        from hall import Hall

        hall = Hall(open_field(given.field), np.random.default_rng([given.seed, 9]))
        record(hall, given.folder, given.seconds, given.seed, given.calm)
        hall.close()
    else:
        record(InProcess(), given.folder, given.seconds, given.seed, given.calm)


if __name__ == "__main__":
    main()
