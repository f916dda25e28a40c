"""`touchline calibrate lines` on drawn mirrors: errors of ranges, centre and lean beside what is stated of them.

    python lab/benchmarks/calibrate_mirrors.py [--first 100] [--mirrors 20] [--images 5]

Each seed is a robot as built, its mirror leaning and displaced, a tangent's or a hyperbola's, on a field whose
lines are scuffed, others driving about. Every other robot turns on the spot, the rest stand at places drawn anywhere.
Each is calibrated four times: with the field as it is drawn; with a file that has all lines along their outer edges;
with that and each line a centimetre aside (one standard deviation); and with the points up to four metres alone, to see
ranges beyond the last line. The search is not part of it: fits begin at the tangent that is nearest to the true mirror.
Seeds below 100 are for tuning. About half a minute for each mirror.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence

import numpy as np
from calibrate_cameras import redrawn

from touchline.calibration.lines.calibration import LineCalibration, check, refined
from touchline.calibration.lines.equations import BEND_X, HEIGHT_M, LOG_SCALE, WIDTHS, Seen
from touchline.calibration.lines.images import (
    camera_of,
    generic_camera,
    known_camera,
    merged_looks,
    mirror_circle,
    points_through,
)
from touchline.calibration.lines.mirror_shape import MirrorShape
from touchline.calibration.lines.range_curve import KNOTS
from touchline.calibration.lines.search import Candidate
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.types import ImageArray
from touchline_lab.experiments.scenes import random_place
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import MotionSettings, open_scenario

PROFILES = "recorded", "hyperbolic"
FIELDS = "msl-18x12", "msl-22x14"
RANGES_M = 1.0, 2.0, 4.0, 6.0, 8.0
# how far each line lies aside (m), whether all are told by their outer edges, and how far points are seen (m)
CASES = {
    "as drawn": (0.0, False, math.inf),
    "outer edges": (0.0, True, math.inf),
    "outer edges, lines aside": (0.01, True, math.inf),
    "points to 4 m": (0.0, False, 4.0),
}
_MIN_POINTS = 25  # of an image that takes part
_USUAL = np.arange(5.0, 100.0, 5.0)  # percentiles of the points' radii
_BEARINGS = 2.0 * np.pi * np.arange(48) / 48
_AWAY = np.column_stack((np.cos(_BEARINGS), np.sin(_BEARINGS)))


def drawn_images(seed: int, count: int) -> tuple[Simulation, list[Pose], list[ImageArray]]:
    """A robot as built, where it stands and what it sees."""
    rng = np.random.default_rng([seed, 43])
    changes = [f"field={FIELDS[seed // 4 % 2]}", f"camera.mirror.profile={PROFILES[seed // 2 % 2]}"]
    scenario = open_scenario("straight-tracks", seed, 0.2, changes)
    simulation = Simulation(scenario, "points")
    images, poses, place = [], [], random_place(simulation.field, rng, 1.0)
    for k in range(count):
        if seed % 2:
            place = random_place(simulation.field, rng, 1.0)
        pose = Pose(place.x, place.y, place.heading + 2.0 * math.pi * k / count)
        poses.append(pose)
        motion = MotionSettings(kind="stand", pose=(pose.x, pose.y, math.degrees(pose.heading)))
        simulation = Simulation(scenario.model_copy(update={"motion": motion}))
        images.append(simulation.image(0))
    return simulation, poses, images


def begin(truth: SimulatedOmniCamera, poses: Sequence[Pose]) -> Candidate:
    """The tangent that is nearest to a mirror, at the true poses: what the search is there to find."""
    design = truth.design
    radii = design.image_from_ground(np.column_stack((np.linspace(1.0, 8.0, 40), np.zeros(40)))) - design.center
    radius = np.hypot(*radii.T)
    seen = np.isfinite(radius)
    radius, logs = radius[seen], np.log(np.linspace(1.0, 8.0, 40)[seen])
    turns = np.linspace(0.4, 1.5, 400)[:, np.newaxis] / radius.max()
    gaps = logs - np.log(np.tan(turns * radius))
    best = int(np.argmin(gaps.std(axis=1)))
    mirror = np.array([*design.center, gaps[best].mean(), turns[best, 0], 0.0, 0.0])
    return Candidate(mirror, np.array([[p.x, p.y, p.heading + design.mount_yaw_rad] for p in poses]), 0.0)


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
    turn = -truth.design.mount_yaw_rad
    c, s = math.cos(turn), math.sin(turn)
    wanted = points @ np.array([[c, s], [-s, c]])  # x along u
    placed = shape.ground(pixels)
    shifted = [(shape.ground(pixels + step) - placed) for step in np.eye(2)]
    px_m = np.sqrt(np.sum(np.square(shifted), axis=(0, 2)) / 2.0)[:, np.newaxis]
    columns = []
    for k in (0, 1, LOG_SCALE, *((BEND_X, BEND_X + 1) if bends else ())):
        moved = shape.parameters.copy()
        moved[k] += 1e-5
        other = MirrorShape(moved, shape.handedness, shape.knot_px, shape.origin_m)
        columns.append(((other.ground(pixels) - placed) / 1e-5 / px_m).ravel())
    columns += [(np.tile(axis, (len(points), 1)) / px_m).ravel() for axis in np.eye(2)]  # the origin
    step = np.linalg.lstsq(np.column_stack(columns), ((wanted - placed) / px_m).ravel(), rcond=None)[0]
    return np.asarray(step[[0, 1, 3, 4] if bends else [0, 1]])


def found_pixels(simulation: Simulation, poses: Sequence[Pose], images: Sequence[ImageArray]) -> list[FloatArray]:
    """Pixels (N, 2) of each image's line points: two looks, as `calibrate_images` takes them."""
    truth, field, circle = simulation.camera_model, simulation.field, mirror_circle(images)
    size = images[0].shape[1], images[0].shape[0]
    first = points_through(generic_camera(circle, size), images, field.line_width)
    lines = calibrated(first, truth, poses, field)
    rough = camera_of(lines, size, truth.design.inner_radius_px, circle.radius_px)
    return merged_looks(lines, points_through(rough, images, field.line_width))


def calibrated(
    pixels: Sequence[FloatArray], truth: SimulatedOmniCamera, poses: Sequence[Pose], field: FieldModel
) -> LineCalibration:
    """The calibration from pixels (N, 2) of each image and a field as a file has it."""
    design = truth.design
    used = [k for k, one in enumerate(pixels) if len(one) >= _MIN_POINTS]
    if not used:
        raise NoFitError("hardly any line points")
    radius = design.outer_radius_px
    seen = [Seen(np.ascontiguousarray(pixels[k]), float(design.handedness), radius / KNOTS) for k in used]
    start = begin(truth, [poses[k] for k in used])
    return refined(start, 1.0, seen, np.array(design.center), radius, field)


def scores(lines: LineCalibration, truth: SimulatedOmniCamera) -> dict[str, list[tuple[float, float]]]:
    """Errors and standard deviations of each quantity: ranges %, centre px, lean degrees, the drawing cm."""
    shape, sure, size = lines.shape, lines.certainty, (truth.design.width, truth.design.height)
    camera = known_camera(lines, size, 30.0, truth.design.outer_radius_px)
    first, last = shape.range_m(np.array([lines.first_px, lines.last_px]))
    errors, radii = range_errors(shape, truth, np.array(RANGES_M))
    sigmas = sure.range_ratio(shape, radii)
    known = (radii > camera.inner_radius_px) & (radii < camera.outer_radius_px) & np.isfinite(errors)
    found: dict[str, list[tuple[float, float]]] = {}
    for r, error, sigma in zip(np.array(RANGES_M)[known], errors[known], sigmas[known], strict=True):
        where = "nearer than points" if r < first else "beyond points" if r > last else f"at {r:g} m"
        found.setdefault(f"range {where}, %", []).append((100 * error, 100 * sigma))
    away = np.concatenate([np.hypot(*(one - shape.center).T) for one in lines.pixels])[sure.residuals < WIDTHS[-1]]
    seen = shape.range_m(np.percentile(away, _USUAL))
    mean = float(np.sqrt(np.nanmean(range_errors(shape, truth, seen)[0] ** 2)))
    found["ranges where points lie, %"] = [(100 * mean, 100 * lines.range_ratio)]
    found["centre, px"] = list(zip(askew(shape, truth, seen, bends=False), sure.center_px, strict=True))
    bend, to_deg = askew(shape, truth, seen, bends=True)[2:], math.degrees(0.5 * HEIGHT_M)
    found["lean, °"] = [(to_deg * e, to_deg * s) for e, s in zip(bend, sure.bend_per_m, strict=True)]
    return found


def main() -> None:
    """Print a row for each mirror, and the figures of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--mirrors", type=int, default=20)
    parser.add_argument("--images", type=int, default=5)
    given = parser.parse_args()
    all_found: dict[str, dict[str, list[tuple[float, float]]]] = {case: {} for case in CASES}
    for seed in range(given.first, given.first + given.mirrors):
        simulation, poses, images = drawn_images(seed, given.images)
        truth = simulation.camera_model
        assert isinstance(truth, SimulatedOmniCamera)
        pixels = found_pixels(simulation, poses, images)
        for case, (paint_m, edges, reach_m) in CASES.items():
            on = redrawn(simulation.field, paint_m, edges, np.random.default_rng([seed, 42]))
            near = [one[np.hypot(*truth.ground_from_image(one).T) < reach_m] for one in pixels]
            try:
                lines = calibrated(near if math.isfinite(reach_m) else pixels, truth, poses, on)
                check(lines, whole_view=math.isinf(reach_m))
            except NoFitError as error:
                print(f"{seed}, {case}: refused: {error}", flush=True)
                continue
            row = scores(lines, truth)
            for name, pairs in row.items():
                all_found[case].setdefault(name, []).extend(pairs)
            said = "; ".join(f"{name} " + ", ".join(f"{e:+.2f} ± {s:.2f}" for e, s in p) for name, p in row.items())
            print(f"{seed}, {case}: {said}; drawing {100 * lines.certainty.edge_m[0]:+.1f} cm", flush=True)
    for case, rows in all_found.items():
        for name in sorted(rows):
            error, sigma = np.array(rows[name]).T
            z2 = (error / sigma) ** 2
            print(
                f"{case}: {name}: rms {np.sqrt(np.mean(error**2)):.2f}, stated {np.sqrt(np.mean(sigma**2)):.2f}, "
                f"NEES {z2.mean():.2f} (largest {z2.max():.1f}, of {len(z2)})"
            )


if __name__ == "__main__":
    main()
