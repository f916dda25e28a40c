"""`touchline calibrate lines --model pinhole|fisheye` on drawn humanoids: errors and NEES of each parameter.

    python lab/benchmarks/calibrate_cameras.py [--model pinhole|fisheye|mujoco] [--first 100] [--cameras 30] [--images 8]
        [--lean 0.3] [--center 0.0025] [--paint 0.0] [--edges]

Each seed is a robot as built: mount, height, focal length, principal point and distortion of its lens are drawn, and
what is about it. It stands at places that nobody measured, leaning each time by as much as drawn (--lean: degrees).
--center: how far (of the width, one standard deviation) principal points lie beside the images' middles.
--paint: how far (m, one standard deviation) each painted line lies beside where the field's file has it; --edges: the
file has the lines' outer edges. Seeds below 100 are for tuning. --model mujoco: the T1 of RoboCup's MuJoCo soccer
server steps on the spot at each place (needs `pip install 'touchline[mujoco]'`); it leans as it does, and roll, pitch
and height are compared with their means over all moments at which an image may be taken; of the images that took part,
each one's own are, too. "Middle" is the pitch of the ray through the image's middle.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from touchline.calibration.perspective_bundle import CENTER_V, FOCAL, HEIGHT, NAMES, PITCH, ROLL
from touchline.calibration.perspective_lines import calibrate_perspective_lines
from touchline.camera import PerspectiveCamera, PinholeCamera
from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.types import ImageArray
from touchline_lab.experiments.scenes import random_place
from touchline_lab.simulation.cameras.perspective import SimulatedPerspectiveCamera, humanoid_camera, kid_size_camera
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELDS = "indoor-9x6", "humanoid-kid-9x6", "hsl-s-9x6"
SHOWN = *(NAMES[k] for k in (ROLL, PITCH, HEIGHT, FOCAL)), "middle"
UNITS, SCALES = ("°", "°", "cm", "%", "°"), np.array([180.0 / math.pi, 180.0 / math.pi, 100.0, 100.0, 180.0 / math.pi])
BARS = 0.2, 0.2, 1.0, 1.0, 0.2
CYCLES = 50, 80  # of 20 ms, after which MuJoCo's robot takes an image
AHEAD_M = 1.5  # what is looked at lies so far away at least


def drawn_camera(model: str, center: float, rng: np.random.Generator) -> PerspectiveCamera:
    """A humanoid's camera as built; center: how far principal points lie aside, as a share of the width."""
    designed = humanoid_camera() if model == "pinhole" else kid_size_camera()
    off = rng.standard_normal(8)
    pitch, height_m = (rng.uniform(0.35, 0.6), rng.uniform(0.5, 1.2)) if model == "pinhole" else (0.55, 0.52)
    mount = Pose3.from_roll_pitch_yaw(
        0.03 * off[0], pitch + 0.03 * off[1], 0.0, (0.0, 0.0, height_m * (1 + 0.03 * off[2]))
    )
    focal = designed.fx * math.exp(0.1 * off[3])
    cx, cy = 0.5 * (np.array([designed.width, designed.height]) - 1.0) + center * designed.width * off[4:6]
    lens = (
        designed.distortion
        * (1.0 + 0.2 * off[6])
        * ([1, 1 + 0.2 * off[6], off[7], off[7], 1] if model == "pinhole" else 1.0)
    )
    return replace(designed, fx=focal, fy=focal, cx=float(cx), cy=float(cy), distortion=lens, base_from_camera=mount)


def drawn_images(
    seed: int, model: str, count: int, lean_deg: float, center: float
) -> tuple[list[PerspectiveCamera], list[ImageArray], FieldModel]:
    """A camera, what it sees and the field."""
    rng = np.random.default_rng([seed, 41])
    changes = [f"field={FIELDS[seed % len(FIELDS)]}", "others.robots=4", f"camera.kind={model}"]
    simulation = Simulation(open_scenario("humanoid-walk", seed, 20.0, changes))
    camera = drawn_camera(model, center, rng)
    eye = SimulatedPerspectiveCamera(camera)
    images = []
    for k in range(count):
        pose = _place(simulation.field, rng)
        roll, pitch = np.radians(lean_deg) * rng.standard_normal(2)
        state = simulation.state(2.0 * k)
        images.append(eye.render(simulation.world, state, pose, (float(roll), float(pitch)), 8.0, 2.4, rng))
    return [camera], images, simulation.field


def _place(field: FieldModel, rng: np.random.Generator) -> Pose:
    """Anywhere on the field, some of it ahead."""
    while True:
        place, aim = random_place(field, rng, 0.3), random_place(field, rng, 0.5)
        if place.distance_to(aim) > AHEAD_M:
            return Pose(place.x, place.y, math.atan2(aim.y - place.y, aim.x - place.x))


def mujoco_images(seed: int, count: int) -> tuple[list[PerspectiveCamera], list[ImageArray], FieldModel]:
    """The same of the server's robot, on a field of the Humanoid Soccer League; its camera at each image, then at all
    moments at which one may be taken.
    """
    os.environ.setdefault("MUJOCO_GL", "egl")
    sys.path.insert(0, str(Path(__file__).parent / "mujoco"))
    from gait import Gait
    from hall import FOCAL_PX, HEIGHT, WIDTH, Hall
    from walks import TILT_RAD
    from worlds import HEAD, LEGS, OTHERS, POSTURE, Targets

    field, rng = open_field("hsl-s-9x6"), np.random.default_rng([seed, 41])
    hall, seen, images = Hall(field, rng), [], []
    still = {**dict.fromkeys((*OTHERS, *LEGS), 0.0), **POSTURE, HEAD[0]: 0.0, HEAD[1]: TILT_RAD}
    for k in range(count + 1):
        pose, gait = _place(field, rng), Gait()
        hall.place(pose.x, pose.y, pose.heading)
        percept = hall.step(Targets(still))
        for cycle in range(int(rng.integers(*CYCLES)) if k < count else CYCLES[1] - 1):
            if k == count and cycle >= CYCLES[0]:
                seen.append(hall.eye)
            lean = Pose3(percept.attitude, np.zeros(3)).roll_pitch_yaw()[:2]
            legs = gait.step(0.02, np.zeros(3), np.array(lean), percept.gyro[:2]).ravel().tolist()
            percept = hall.step(Targets({**still, **dict(zip(LEGS, legs, strict=True))}))
        seen.append(hall.eye)
        if k < count:
            images.append(hall.image())
    hall.close()
    lens = FOCAL_PX, FOCAL_PX, 0.5 * (WIDTH - 1), 0.5 * (HEIGHT - 1)
    return [PinholeCamera(WIDTH, HEIGHT, *lens, np.zeros(5), mount) for mount in seen], images, field


def redrawn(field: FieldModel, paint_m: float, edges: bool, rng: np.random.Generator) -> FieldModel:
    """The field as a file may have it: each line a little aside, and all at their outer edges where asked."""
    segments, circles, half = field.segments.copy(), field.circles.copy(), 0.5 * field.line_width * edges
    inner = np.abs(np.abs(segments[:, 0]) - np.abs(segments[:, 0]).max()) > 1e-6
    across = np.abs(segments[:, 0] - segments[:, 2]) < 1e-6
    for row, front in zip(segments, inner & across, strict=True):
        column = 0 if abs(row[0] - row[2]) < 1e-6 else 1
        row[[column, column + 2]] += (
            np.sign(row[column]) * half * (-1.0 if front else 1.0) + paint_m * rng.standard_normal()
        )
    circles[:, 2] += half + paint_m * rng.standard_normal(len(circles))
    return replace(field, segments=segments, circles=circles)


def state_of(camera: PerspectiveCamera) -> FloatArray:
    """(10,) as of `perspective_bundle`."""
    roll, pitch, _ = camera.base_from_camera.roll_pitch_yaw()
    middle = 0.5 * (camera.width - 1.0), 0.5 * (camera.height - 1.0)
    height = math.log(float(camera.base_from_camera.translation_m[2]))
    k1, k2, third, fourth = camera.distortion[:4].tolist()
    more = (k2 - k1**2 if camera.model == "pinhole" else k2, third, fourth)
    return np.array([roll, pitch, height, math.log(camera.fx), k1, camera.cx - middle[0], camera.cy - middle[1], *more])


def main() -> None:
    """Print a row for each camera, and the figures of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", choices=("pinhole", "fisheye", "mujoco"), default="pinhole")
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--cameras", type=int, default=30)
    parser.add_argument("--images", type=int, default=8)
    parser.add_argument("--lean", type=float, default=0.3)
    parser.add_argument("--center", type=float, default=0.0025)
    parser.add_argument("--paint", type=float, default=0.0)
    parser.add_argument("--edges", action="store_true")
    given = parser.parse_args()
    errors, sigmas, own = [], [], []
    for seed in range(given.first, given.first + given.cameras):
        if given.model == "mujoco":
            cameras, images, field = mujoco_images(seed, given.images)
        else:
            cameras, images, field = drawn_images(seed, given.model, given.images, given.lean, given.center)
        on = redrawn(field, given.paint, given.edges, np.random.default_rng([seed, 42]))
        try:
            found = calibrate_perspective_lines(images, on, cameras[0].model)
        except NoFitError as error:
            print(f"{seed}: refused: {error}")
            continue
        states = np.array([state_of(camera) for camera in cameras])
        true = states[given.images if given.model == "mujoco" else 0 :].mean(axis=0)
        rows = np.vstack((np.eye(len(SHOWN) - 1, len(true)), np.zeros(len(true))))
        rows[-1, [PITCH, CENTER_V]] = 1.0, -1.0 / cameras[0].fy
        scale = SCALES * [1.0, 1.0, math.exp(true[HEIGHT]), 1.0, 1.0]
        errors.append(rows @ (found.fit.state - true) * scale)
        sigmas.append(np.sqrt(np.diag(rows @ found.fit.covariance @ rows.T)) * scale)
        parts = [f"{e:+.2f} ± {s:.2f} {unit}" for e, s, unit in zip(errors[-1], sigmas[-1], UNITS, strict=True)]
        print(f"{seed}: {', '.join(parts)}", flush=True)
        if given.model == "mujoco":
            leans = np.array([stand.lean for stand in found.fit.stands])
            own += list((found.fit.state[:3] + leans - states[list(found.used), :3]) * scale[:3])
    if not errors:
        return
    error, sigma = np.array(errors), np.array(sigmas)
    for each, (name, bar, unit) in enumerate(zip(SHOWN, BARS, UNITS, strict=True)):
        e, z2 = error[:, each], (error[:, each] / sigma[:, each]) ** 2
        print(
            f"{name}: rms {np.sqrt(np.mean(e**2)):.2f} {unit}, largest {np.abs(e).max():.2f}, within {bar:g}: "
            f"{np.count_nonzero(np.abs(e) <= bar)} of {given.cameras}, NEES {z2.mean():.2f} (largest {z2.max():.1f})"
        )
    for name, bar, unit, e in zip(SHOWN, BARS, UNITS, np.transpose(own), strict=False):
        print(
            f"each image's own {name}: median {np.median(np.abs(e)):.2f} {unit}, largest {np.abs(e).max():.2f}, "
            f"within {bar:g}: {np.count_nonzero(np.abs(e) <= bar)} of {len(e)}"
        )


if __name__ == "__main__":
    main()
