"""Humanoids whose kinematics are 2 to 4° off: their stills, and how they walk. Rendered, in the lamps' light or in sun.

    python lab/benchmarks/attitudes.py stills [--first 300] [--robots 10] [--places 10] [--sun LOW HIGH]
    python lab/benchmarks/attitudes.py walk [--first 300] [--robots 10] [--seconds 20] [--sun LOW HIGH]

Each seed is a robot on one of three fields, with two to five others about it; its camera.yaml has roll and pitch wrong
by 2 to 4° together. stills: at each place `touchline.locate` gets all that one image shows, without a start, and
`touchline` two seconds of stepping on the spot, with a start 0.2 m and 6° off. walk: from such a start, between places
that are drawn. Right is what lies within 0.3 m; without a start, of the pose or of its twin where the field
is symmetric. --sun: so many times the lamps, low through
windows, exposed so that most patches are clipped. Seeds below 300 are for tuning.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Iterator

import numpy as np

from touchline import locate
from touchline.camera import PinholeCamera
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.systems import RobotSetup, open_system
from touchline.types import Estimate, Prior, Status
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELDS = "hsl-s-9x6", "humanoid-kid-9x6", "indoor-9x6"
WRONG_M, RIGHT_DEG, OFF_DEG = 0.3, 0.3, (2.0, 4.0)
START_M, START_RAD = 0.2, math.radians(6.0)
STEP_M = 2.0  # between places, each way
ANGLES_RAD = np.linspace(0.05, 0.5, 10)


def simulated(kind: str, seconds: float, sun: list[float] | None, seed: int, place: int) -> Simulation:
    """A robot that stands (stills) or walks (walk)."""
    rng, field = np.random.default_rng([seed, 51, place]), FIELDS[seed % len(FIELDS)]
    reach = np.array([3.9, 2.4])
    ways = [rng.uniform(-reach, reach)]
    for _ in range(9 if kind == "walk" else 0):
        ways.append(np.clip(ways[-1] + rng.uniform(-STEP_M, STEP_M, 2), -reach, reach))
    poses = [[*np.round(way, 2).tolist(), round(float(rng.uniform(-180, 180)))] for way in ways]
    moves = f"motion.waypoints={poses}" if kind == "walk" else f"motion.pose={poses[0]}"
    changes = [
        f"field={field}",
        "calibration.kind=none",
        "camera.rate_hz=4",
        moves,
        f"others.robots={rng.integers(2, 6)}",
    ]
    if sun is not None:
        level, height, way = rng.uniform(sun[0], sun[1]), rng.uniform(14, 40), rng.uniform(30, 150)
        changes += [
            f"light.sun={level:.2f}",
            f"light.sun_elevation_deg={height:.0f}",
            f"light.windows={rng.integers(3, 7)}",
        ]
        changes += [f"light.sun_azimuth_deg={way:.0f}", f"camera.exposure_ms={8.0 * rng.uniform(0.7, 1.3):.1f}"]
    return Simulation(
        open_scenario("humanoid-walk" if kind == "walk" else "walk-in-place", 1000 * seed + place, seconds, changes)
    )


def stated_camera(camera: PinholeCamera, seed: int) -> PinholeCamera:
    """The camera as this robot's camera.yaml has it."""
    rng = np.random.default_rng([seed, 52])
    size, way = math.radians(rng.uniform(*OFF_DEG)), rng.uniform(0.0, 2.0 * math.pi)
    return camera.corrected(np.array([size * math.sin(way), size * math.cos(way), 0.0, 0.0]), ANGLES_RAD)


def start(run: Simulation, seed: int, place: int) -> Pose:
    """The start that the system is given."""
    rng, true = np.random.default_rng([seed, 53, place]), run.truth[0]
    x, y = START_M / math.sqrt(2.0) * rng.standard_normal(2)
    return Pose(true.x + x, true.y + y, true.heading + START_RAD * rng.standard_normal())


def attitude_errors_deg(run: Simulation, known: PinholeCamera, estimate: Estimate) -> FloatArray:
    """Roll and pitch (2,) by which the camera, as it was learned, looks elsewhere than it does: the IMU's constant
    tilt is in it, as images alone tell the sum of both.
    """
    assert estimate.camera_errors is not None
    assert isinstance(run.camera, PinholeCamera)
    learned = known.corrected(estimate.camera_errors, ANGLES_RAD).base_from_camera
    off = learned.rotation @ run.camera.base_from_camera.rotation.T
    imu = run.sensors.imu
    tilt = imu.values[:, :2] - np.array([run.track.attitude_at(1e-9 * stamp) for stamp in imu.stamp_ns.tolist()])
    return np.degrees(np.array([off[2, 1], off[0, 2]]) + tilt.mean(axis=0))


def distance_m(pose: Pose, true: Pose, field: FieldModel) -> float:
    """From the true place, or from its twin where nothing tells it."""
    return min(pose.distance_to(one) for one in ((true, true.mirrored()) if field.is_symmetric else (true,)))


def stills(given: argparse.Namespace) -> None:
    """A row for each robot."""
    totals_by: dict[str, Counter[str]] = {"locate": Counter(), "touchline": Counter()}
    for seed in range(given.first, given.first + given.robots):
        counts = {name: Counter[str]() for name in totals_by}
        for place in range(given.places):
            for name, verdict in _still(simulated("stills", 2.0, given.sun, seed, place), seed, place):
                counts[name][verdict] += 1
        print(
            f"{seed}: " + "; ".join(f"{name} {dict(sorted(each.items()))}" for name, each in counts.items()), flush=True
        )
        for name, each in counts.items():
            totals_by[name] += each
    for name, each in totals_by.items():
        print(f"{name}: " + ", ".join(f"{verdict} {count}" for verdict, count in each.most_common()))


def _still(run: Simulation, seed: int, place: int) -> Iterator[tuple[str, str]]:
    camera = run.camera
    assert isinstance(camera, PinholeCamera)
    known = stated_camera(camera, seed)
    system = open_system("touchline", RobotSetup(run.field, known, run.wheel_directions_rad))
    system.reset(Prior(start(run, seed, place)))
    estimate: Estimate | None = None
    for index, frame in enumerate(run):
        estimate = system.step(frame)
        if index:
            continue
        assert estimate.observation is not None
        try:
            found = locate(estimate.observation, run.field, camera=known)
        except NoFitError:
            yield "locate", "refused"
        else:
            right = distance_m(found.pose, run.truth[0], run.field) <= WRONG_M
            yield "locate", f"{'right' if right else 'WRONG'}{', doubted' if found.doubts else ''}"
    assert estimate is not None
    right = estimate.pose.distance_to(run.truth[-1]) <= WRONG_M
    tracked = estimate.status == Status.TRACKING
    yield "touchline", ("right" if right else "WRONG") if tracked else "not tracked"


def walk(given: argparse.Namespace) -> None:
    """A row for each robot, and the figures of all."""
    errors, ends, totals = [], [], np.zeros(4, dtype=int)
    for seed in range(given.first, given.first + given.robots):
        run = simulated("walk", given.seconds, given.sun, seed, 0)
        camera = run.camera
        assert isinstance(camera, PinholeCamera)
        known = stated_camera(camera, seed)
        system = open_system("touchline", RobotSetup(run.field, known, run.wheel_directions_rad))
        system.reset(Prior(start(run, seed, 0)))
        own, beyond = [], 0
        for index, frame in enumerate(run):
            estimate = system.step(frame)
            if estimate.status == Status.TRACKING:
                own.append(estimate.pose.distance_to(run.truth[index]))
                beyond += estimate.protection_m is not None and own[-1] > estimate.protection_m
        wrong = int(np.sum(np.array(own) > WRONG_M))
        totals += len(run), len(own), wrong, beyond
        ends.append(attitude_errors_deg(run, known, estimate) if own else np.full(2, np.nan))
        errors += own
        last = f"{100.0 * own[-1]:.1f} cm" if estimate.status == Status.TRACKING else "not tracked"
        print(
            f"{seed}: tracked {len(own)} of {len(run)}, mean {100.0 * np.mean(own or [np.nan]):.1f} cm, {wrong} wrong; "
            f"at the end {last}, roll {ends[-1][0]:+.2f}°, pitch {ends[-1][1]:+.2f}°",
            flush=True,
        )
    images, tracked, wrong, beyond = totals.tolist()
    within, share = np.sum(np.abs(ends) <= RIGHT_DEG, axis=0), 100.0 * tracked / images
    mean, farthest = (100.0 * float(figure(errors or [np.nan])) for figure in (np.mean, np.max))
    print(
        f"tracked {share:.1f} % of {images}, mean {mean:.1f} cm, farthest {farthest:.0f}, {wrong} farther than "
        f"{100.0 * WRONG_M:.0f} cm, {beyond} beyond the level; roll and pitch within {RIGHT_DEG:g}° at the end: "
        f"{within[0]} and {within[1]} of {given.robots}"
    )


def main() -> None:
    """Print a row for each robot, and the sums."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("stills", "walk"))
    parser.add_argument("--first", type=int, default=300)
    parser.add_argument("--robots", type=int, default=10)
    parser.add_argument("--places", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--sun", type=float, nargs=2, metavar=("LOW", "HIGH"))
    given = parser.parse_args()
    (stills if given.what == "stills" else walk)(given)


if __name__ == "__main__":
    main()
