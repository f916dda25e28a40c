"""`touchline calibrate lines` on drawn robots: errors of each quantity beside what is stated of it, and NEES.

    python lab/benchmarks/calibrate.py mirror|pinhole|fisheye [--first 100] [--robots 20] [--images 8]
        [--lean 0.3] [--center 0.0025] [--paint 0.0] [--edges]

Each seed is a robot as built, on a field with others about; seeds below 100 are for tuning. --paint: how far (m, one
standard deviation) each painted line lies beside where the field's file has it; --edges: the file has the lines' outer
edges. mirror: leaning and displaced, a tangent's or a hyperbola's; every other robot turns on the spot, the rest stand
anywhere. pinhole, fisheye: mount, height, focal length, principal point (--center: of the width, one standard
deviation) and distortion are drawn; the robot leans at each place as drawn (--lean: degrees). "Middle" is the pitch of
the ray through the image's middle. Each robot takes about half a minute.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace

import numpy as np

from touchline.calibration.lines.calibration import LineCalibration
from touchline.calibration.lines.equations import BEND_X, HEIGHT_M, LOG_SCALE, WIDTHS
from touchline.calibration.lines.images import calibrate_images, known_camera
from touchline.calibration.lines.mirror_shape import MirrorShape
from touchline.calibration.perspective_bundle import CENTER_V, FOCAL, HEIGHT, NAMES, PITCH, ROLL
from touchline.calibration.perspective_lines import calibrate_perspective_lines
from touchline.camera import PerspectiveCamera
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, Pose3
from touchline_lab.experiments.scenes import random_place
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.cameras.perspective import SimulatedPerspectiveCamera, humanoid_camera, kid_size_camera
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import MotionSettings, open_scenario

FIELDS, MIRROR_FIELDS = ("indoor-9x6", "humanoid-kid-9x6", "hsl-s-9x6"), ("msl-18x12", "msl-22x14")
RANGES_M = np.array([1.0, 2.0, 4.0, 6.0, 8.0])
TO_DEG = 180.0 / math.pi
SHOWN = "roll, °", "pitch, °", "height, cm", "focal length, %", "middle, °"
AHEAD_M = 1.5  # what a humanoid looks at lies so far away at least
_USUAL = np.arange(5.0, 100.0, 5.0)  # percentiles of the points' radii
_AWAY = np.stack([f(2.0 * np.pi * np.arange(48) / 48) for f in (np.cos, np.sin)], axis=1)
Scores = dict[str, list[tuple[float, float]]]  # errors and standard deviations of each quantity


def redrawn(field: FieldModel, paint_m: float, edges: bool, rng: np.random.Generator) -> FieldModel:
    """The field as a file may have it: each line a little aside, and all at their outer edges where asked."""
    segments, circles, half = field.segments.copy(), field.circles.copy(), 0.5 * field.line_width * edges
    inner = np.abs(np.abs(segments[:, 0]) - np.abs(segments[:, 0]).max()) > 1e-6
    across = np.abs(segments[:, 0] - segments[:, 2]) < 1e-6
    for row, front, is_across in zip(segments, inner & across, across, strict=True):
        columns = [0, 2] if is_across else [1, 3]
        aside = np.sign(row[columns[0]]) * half * (-1.0 if front else 1.0)
        row[columns] += aside + paint_m * rng.standard_normal()
    circles[:, 2] += half + paint_m * rng.standard_normal(len(circles))
    return replace(field, segments=segments, circles=circles)


def of_humanoid(given: argparse.Namespace, seed: int) -> Scores:
    """A humanoid's errors."""
    rng = np.random.default_rng([seed, 41])
    changes = [f"field={FIELDS[seed % len(FIELDS)]}", "others.robots=4", f"camera.kind={given.kind}"]
    simulation = Simulation(open_scenario("humanoid-walk", seed, 20.0, changes))
    camera = drawn_camera(given.kind, given.center, rng)
    eye, images = SimulatedPerspectiveCamera(camera), []
    for k in range(given.images):
        pose = aiming(simulation.field, rng)
        roll, pitch = np.radians(given.lean) * rng.standard_normal(2)
        state = simulation.state(2.0 * k)
        images.append(eye.render(simulation.world, state, pose, (float(roll), float(pitch)), 8.0, 2.4, rng))
    on = redrawn(simulation.field, given.paint, given.edges, np.random.default_rng([seed, 42]))
    found, true = calibrate_perspective_lines(images, on, camera.model), state_of(camera)
    rows = np.vstack((np.eye(len(NAMES))[[ROLL, PITCH, HEIGHT, FOCAL]], np.zeros(len(NAMES))))
    rows[-1, [PITCH, CENTER_V]] = 1.0, -1.0 / camera.fy
    scale = np.array([TO_DEG, TO_DEG, 100.0 * math.exp(true[HEIGHT]), 100.0, TO_DEG])
    errors = rows @ (found.fit.state - true) * scale
    sigmas = np.sqrt(np.diag(rows @ found.fit.covariance @ rows.T)) * scale
    return {name: [(e, s)] for name, e, s in zip(SHOWN, errors.tolist(), sigmas.tolist(), strict=True)}


def drawn_camera(model: str, center: float, rng: np.random.Generator) -> PerspectiveCamera:
    """A humanoid's camera as built; center: how far principal points lie aside, as a share of the width."""
    designed, off = humanoid_camera() if model == "pinhole" else kid_size_camera(), rng.standard_normal(8)
    pitch, height_m = (rng.uniform(0.35, 0.6), rng.uniform(0.5, 1.2)) if model == "pinhole" else (0.55, 0.52)
    place = 0.0, 0.0, height_m * (1.0 + 0.03 * off[2])
    mount = Pose3.from_roll_pitch_yaw(0.03 * off[0], pitch + 0.03 * off[1], 0.0, place)
    focal = designed.fx * math.exp(0.1 * off[3])
    cx, cy = 0.5 * (np.array([designed.width, designed.height]) - 1.0) + center * designed.width * off[4:6]
    more = [1.0, 1.0 + 0.2 * off[6], off[7], off[7], 1.0] if model == "pinhole" else 1.0
    lens = designed.distortion * (1.0 + 0.2 * off[6]) * more
    return replace(designed, fx=focal, fy=focal, cx=float(cx), cy=float(cy), distortion=lens, base_from_camera=mount)


def aiming(field: FieldModel, rng: np.random.Generator) -> Pose:
    """Anywhere on the field, some of it ahead."""
    while True:
        place, aim = random_place(field, rng, 0.3), random_place(field, rng, 0.5)
        if place.distance_to(aim) > AHEAD_M:
            return Pose(place.x, place.y, math.atan2(aim.y - place.y, aim.x - place.x))


def state_of(camera: PerspectiveCamera) -> FloatArray:
    """(10,) as of `perspective_bundle`."""
    roll, pitch, _ = camera.base_from_camera.roll_pitch_yaw()
    u, v = camera.cx - 0.5 * (camera.width - 1.0), camera.cy - 0.5 * (camera.height - 1.0)
    height = math.log(float(camera.base_from_camera.translation_m[2]))
    k1, k2, third, fourth = camera.distortion[:4].tolist()
    second = k2 - k1**2 if camera.model == "pinhole" else k2
    return np.array([roll, pitch, height, math.log(camera.fx), k1, u, v, second, third, fourth])


def of_mirror(given: argparse.Namespace, seed: int) -> Scores:
    """A mirror's errors."""
    rng = np.random.default_rng([seed, 43])
    profile = ("recorded", "hyperbolic")[seed // 2 % 2]
    changes = [f"field={MIRROR_FIELDS[seed // 4 % 2]}", f"camera.mirror.profile={profile}"]
    scenario = open_scenario("straight-tracks", seed, 0.2, changes)
    simulation = Simulation(scenario, "points")
    field, truth, images = simulation.field, simulation.camera_model, []
    assert isinstance(truth, SimulatedOmniCamera)
    place = random_place(field, rng, 1.0)
    for k in range(given.images):
        place = random_place(field, rng, 1.0) if seed % 2 else place
        heading_deg = TO_DEG * place.heading + 360.0 * k / given.images
        motion = MotionSettings(kind="stand", pose=(place.x, place.y, heading_deg))
        images.append(Simulation(scenario.model_copy(update={"motion": motion})).image(0))
    on = redrawn(field, given.paint, given.edges, np.random.default_rng([seed, 42]))
    return mirror_scores(calibrate_images(images, on, truth.design.handedness).lines, truth)


def range_errors(shape: MirrorShape, truth: SimulatedOmniCamera, ranges_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors (N,) of ranges (N,), as shares, means of all directions; and the radii (N,) where they are seen (px)."""
    pixels = truth.project((ranges_m[:, np.newaxis, np.newaxis] * _AWAY).reshape(-1, 2))
    found = np.hypot(*shape.ground(pixels).T).reshape(len(ranges_m), -1)
    radii = np.hypot(*(pixels - shape.axis).T).reshape(len(ranges_m), -1)
    return np.log(found / ranges_m[:, np.newaxis]).mean(axis=1), radii.mean(axis=1)


def askew(shape: MirrorShape, truth: SimulatedOmniCamera, ranges_m: FloatArray, bends: bool) -> FloatArray:
    """What has to be added to the centre (2,) and, if it bends, to the lean (2,) to put ranges (N,) where they are."""
    points = (ranges_m[:, np.newaxis, np.newaxis] * _AWAY).reshape(-1, 2)
    pixels = truth.project(points)
    wanted = Pose(0.0, 0.0, -truth.design.mount_yaw_rad).transform(points)  # x along u
    placed = shape.ground(pixels)
    shifted = [(shape.ground(pixels + step) - placed) for step in np.eye(2)]
    px_m = np.sqrt(np.sum(np.square(shifted), axis=(0, 2)) / 2.0)[:, np.newaxis]
    columns = [(np.tile(axis, (len(points), 1)) / px_m).ravel() for axis in np.eye(2)]  # the origin
    for k in (0, 1, LOG_SCALE, *((BEND_X, BEND_X + 1) if bends else ())):
        moved = shape.parameters + 1e-5 * (np.arange(len(shape.parameters)) == k)
        other = MirrorShape(moved, shape.handedness, shape.knot_px, shape.origin_m)
        columns.append(((other.ground(pixels) - placed) / 1e-5 / px_m).ravel())
    step = np.linalg.lstsq(np.column_stack(columns), ((wanted - placed) / px_m).ravel(), rcond=None)[0]
    return np.asarray(step[5:] if bends else step[2:4])


def mirror_scores(lines: LineCalibration, truth: SimulatedOmniCamera) -> Scores:
    """Of ranges, centre, lean."""
    shape, sure, size = lines.shape, lines.certainty, (truth.design.width, truth.design.height)
    camera = known_camera(lines, size, 30.0, truth.design.outer_radius_px)
    first, last = shape.range_m(np.array([lines.first_px, lines.last_px]))
    errors, radii = range_errors(shape, truth, RANGES_M)
    known = (radii > camera.inner_radius_px) & (radii < camera.outer_radius_px) & np.isfinite(errors)
    found: Scores = {}
    for r, error, sigma in zip(RANGES_M[known], errors[known], sure.range_ratio(shape, radii[known]), strict=True):
        where = "nearer than points" if r < first else "beyond points" if r > last else f"at {r:g} m"
        found.setdefault(f"range {where}, %", []).append((100.0 * error, 100.0 * sigma))
    away = np.concatenate([np.hypot(*(one - shape.center).T) for one in lines.pixels])[sure.residuals < WIDTHS[-1]]
    seen = shape.range_m(np.percentile(away, _USUAL))
    mean = float(np.sqrt(np.nanmean(range_errors(shape, truth, seen)[0] ** 2)))
    found["ranges where points lie, %"] = [(100.0 * mean, 100.0 * lines.range_ratio)]
    found["centre, px"] = list(zip(askew(shape, truth, seen, bends=False), sure.center_px, strict=True))
    bend, to_deg = askew(shape, truth, seen, bends=True), 0.5 * HEIGHT_M * TO_DEG
    found["lean, °"] = [(to_deg * e, to_deg * s) for e, s in zip(bend, sure.bend_per_m, strict=True)]
    return found


def main() -> None:
    """Print a row for each robot, and the figures of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("mirror", "pinhole", "fisheye"))
    for name, count in (("first", 100), ("robots", 20), ("images", 8)):
        parser.add_argument(f"--{name}", type=int, default=count)
    for name, value in (("lean", 0.3), ("center", 0.0025), ("paint", 0.0)):
        parser.add_argument(f"--{name}", type=float, default=value)
    parser.add_argument("--edges", action="store_true")
    given = parser.parse_args()
    together: Scores = {}
    for seed in range(given.first, given.first + given.robots):
        try:
            row = (of_mirror if given.kind == "mirror" else of_humanoid)(given, seed)
        except NoFitError as error:
            print(f"{seed}: refused: {error}", flush=True)
            continue
        for name, pairs in row.items():
            together.setdefault(name, []).extend(pairs)
        parts = (f"{name} " + ", ".join(f"{e:+.2f} ± {s:.2f}" for e, s in pairs) for name, pairs in row.items())
        print(f"{seed}: {'; '.join(parts)}", flush=True)
    for name, pairs in together.items():
        error, sigma = np.array(pairs).T
        z2 = (error / sigma) ** 2
        print(
            f"{name}: rms {np.sqrt(np.mean(error**2)):.2f}, stated {np.sqrt(np.mean(sigma**2)):.2f}, largest "
            f"{np.abs(error).max():.2f}, NEES {z2.mean():.2f} (largest {z2.max():.1f}, of {len(z2)})"
        )


if __name__ == "__main__":
    main()
