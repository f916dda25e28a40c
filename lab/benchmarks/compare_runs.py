"""The safety net of moves and renames: what every system computes, written down, and two checkouts compared.

    python lab/benchmarks/compare_runs.py REVISION            this checkout against another revision of it
    python lab/benchmarks/compare_runs.py --write FILE.npz    only this checkout's numbers
    python lab/benchmarks/compare_runs.py --files A.npz B.npz two files that were written before

Written are poses, covariances, statuses, residuals and hypotheses of all systems on the recordings found in
TOUCHLINE_DATA (or in shared/data beside the checkout), humanoids' from nowhere and from the true start, and on 44
scenarios at observation level; matching, global search and particles on the points set.

The package is whichever Python finds first: PYTHONPATH=OTHER/src writes another checkout's numbers by this script. A
row that another checkout has no part for is left out by name. `--only TEXT` takes the rows whose name contains the
text. Exit status 1 if anything differs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("TOUCHLINE_DATA", ROOT.parent / "shared" / "data"))
MIRROR_SYSTEMS = ("touchline", "nubot-mti", "nubot-mcl", "nubot-mcl-alone", "iris-fusion")
HUMANOID_SYSTEMS = ("touchline", "nimbro-lines")
SECONDS = 20.0
POINT_FRAMES = 200
NUBOT_PLACES = ("", ".published.nubot", ".published.nubot.particles", ".particles.nubot_particles")
STATUSES = ("tracking", "searching", "lost")
MIRROR_SCENARIOS = (  # name, seed, changes
    *((name, seed, ()) for name in ("match", "straight-tracks", "tour-20") for seed in (0, 1, 2)),
    *((name, seed, ()) for name in ("kidnap", "occlusion-12", "occlusion-25", "occlusion-50") for seed in (0, 1)),
    *(
        (name, 0, ("ideal=true",))
        for name in ("match", "straight-tracks", "tour-20", "kidnap", "occlusion-12", "occlusion-25", "occlusion-50")
    ),
    ("match", 3, ("disturbances.kidnap_every_s=4", "disturbances.covered_images=0")),
    ("match", 4, ("sensors.imu.compass_drift_deg=10",)),
    ("straight-tracks", 3, ("camera.delay_s=0.1", "camera.stamped=arrived")),
    ("straight-tracks", 4, ("camera.mirror.vibration_deg=0.3",)),
    ("straight-tracks", 5, ("camera.known_from=design", "camera.mirror.tilt_spread_deg=0.6")),
)
HUMANOID_SCENARIOS = tuple(
    (field, seed, changes)
    for field in ("indoor-9x6", "humanoid-kid-9x6", "hsl-s-9x6")
    for seed, changes in (
        (0, ()),
        (1, ()),
        (0, ("ideal=true",)),
        (0, ("disturbances.kidnap_every_s=8", "disturbances.covered_images=8")),
        (2, ("others.robots=4", "others.moving=true", "others.near_m=1.5")),
    )
)
Rows = Iterator[tuple[str, Callable[[], np.ndarray]]]


def table(estimates: Iterable) -> np.ndarray:
    """(N, 20): stamp, pose, covariance, status, residual, points, hypotheses, probabilities, scales of each."""
    nan = float("nan")
    return np.array(
        [
            (
                *(e.stamp_ns, *e.pose, *np.ravel(e.covariance), STATUSES.index(e.status), e.residual_m, e.points),
                len(e.hypotheses),
                nan if e.probability is None else e.probability,
                nan if e.twin_probability is None else e.twin_probability,
                nan if e.odometry is None else sum(e.odometry.errors),
            )
            for e in estimates
        ]
    )


def drive(source, name: str, start=None) -> np.ndarray:
    from touchline.systems import RobotSetup, open_system
    from touchline.types import Prior

    setup = RobotSetup(source.field, getattr(source, "camera", None), source.wheel_directions_rad)
    system = open_system(name, setup)
    system.reset(None if start is None else Prior(start))
    return table([system.step(frame) for frame in source])


def recordings() -> Rows:
    from touchline.sources import open_source

    for folder in sorted(DATA.glob("omni_*")):
        for name in MIRROR_SYSTEMS:
            yield f"{folder.name} {name}", lambda folder=folder, name=name: drive(open_source(folder), name)
    for folder in sorted(DATA.glob("humanoid_*")):
        for name in HUMANOID_SYSTEMS:
            yield f"{folder.name} {name}", lambda folder=folder, name=name: drive(open_source(folder), name)
            yield f"{folder.name} started {name}", lambda folder=folder, name=name: from_true_start(folder, name)


def from_true_start(folder: Path, name: str) -> np.ndarray:
    from touchline.sources import open_source

    source = open_source(folder)
    return drive(source, name, source.truth[0])


@lru_cache(maxsize=1)
def simulated(scenario: str, seed: int, changes: tuple[str, ...]):
    """A drive at observation level, kept for the next system that takes it."""
    from touchline_lab.simulation.run import Simulation
    from touchline_lab.simulation.scenario import open_scenario

    simulation = Simulation(open_scenario(scenario, seed, SECONDS, list(changes)), "points")
    return Frames(simulation, list(simulation))


class Frames(list):
    """The frames of a simulation and what is told of its robot."""

    def __init__(self, simulation, frames: list) -> None:
        super().__init__(frames)
        self.field, self.camera = simulation.field, simulation.camera
        self.wheel_directions_rad, self.start = simulation.wheel_directions_rad, simulation.truth[0]


def scenarios() -> Rows:
    for scenario, seed, changes in MIRROR_SCENARIOS:
        for name in MIRROR_SYSTEMS:
            yield (
                " ".join((scenario, f"seed {seed}", *changes, name)),
                lambda made=(scenario, seed, changes), name=name: drive(simulated(*made), name),
            )


def humanoids() -> Rows:
    for field, seed, changes in HUMANOID_SCENARIOS:
        for name in HUMANOID_SYSTEMS:
            made = ("humanoid-walk", seed, (f"field={field}", *changes))
            title = " ".join(("humanoid-walk", field, f"seed {seed}", *changes))
            yield f"{title} {name}", lambda made=made, name=name: drive(simulated(*made), name)
            yield f"{title} started {name}", lambda made=made, name=name: walk_from_true_start(made, name)


def walk_from_true_start(made: tuple, name: str) -> np.ndarray:
    walk = simulated(*made)
    return drive(walk, name, walk.start)


def named(name: str):
    """A part of NuBot's by its name, from wherever this checkout has it."""
    for place in NUBOT_PLACES:
        try:
            return getattr(import_module(f"touchline.localization{place}"), name)
        except (ImportError, AttributeError):
            continue
    raise ImportError(f"{name} is in none of the places known to this script")


def point_sets() -> Rows:
    from touchline.field import open_field
    from touchline.geometry import Pose

    try:
        matcher_of, search_of, settings_of, range_weights = (
            named(name) for name in ("Matcher", "GlobalSearch", "WeightSettings", "range_weights")
        )
        particles_of, particle_settings_of = (named(name) for name in ("NubotParticles", "NubotParticleSettings"))
    except ImportError as error:
        print(f"points: left out, {error}")
        return

    path = DATA / "points" / "msl_18x12.npz"
    if not path.is_file():
        return
    data = np.load(path)
    field = open_field("msl-18x12")
    matcher = matcher_of(field.distance_map())
    search = search_of(matcher, field.length, field.width)
    offsets = data["offsets"]
    views = [np.ascontiguousarray(data["points"][offsets[i] : offsets[i + 1]]) for i in range(POINT_FRAMES)]
    weights = [range_weights(view, settings_of()) for view in views]

    def matching() -> np.ndarray:
        found = (matcher.match(v, w, Pose(*s)) for v, w, s in zip(views, weights, data["init"], strict=False))
        return np.array([(*m.pose, m.error, m.mean_distance_m, *np.ravel(m.covariance)) for m in found])

    def global_search() -> np.ndarray:
        fixes = (search.locate(v, w, float(h)) for v, w, h in zip(views, weights, data["compass"], strict=False))
        return np.array([(*f.match.pose, f.match.error, f.accepted) for f in fixes])

    def particles() -> np.ndarray:
        rows = []
        for index, (view, weight) in enumerate(zip(views[:50], weights, strict=False)):
            rng = np.random.default_rng(index)
            mcl = particles_of(matcher, field.length, field.width, rng, particle_settings_of())
            mcl.restart(float(data["compass"][index]))
            found = mcl.update(view, weight)
            rows.append((*found.pose, *np.ravel(found.covariance)))
        return np.array(rows)

    yield "points matching", matching
    yield "points global", global_search
    yield "points particles", particles


def write(path: Path, only: str) -> None:
    import touchline

    print(f"the package in {Path(touchline.__file__).parent}", flush=True)
    if not (DATA / "points").is_dir():
        print(f"The full recordings are not in {DATA}, so only scenarios run; TOUCHLINE_DATA names their folder.")
    rows = {}
    for source in (point_sets, scenarios, humanoids, recordings):
        for name, measure in source():
            if only in name:
                begun_s = time.perf_counter()
                rows[name] = measure()
                print(f"{name}: {len(rows[name])} rows, {time.perf_counter() - begun_s:.1f} s", flush=True)
    np.savez_compressed(path, **rows)


def write_revision(revision: str, path: Path, only: str) -> None:
    """The same of another revision's package, in a checkout of its own, by this script."""
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder) / "checkout"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(checkout), revision], check=True)
        try:
            command = [sys.executable, __file__, "--write", str(path), "--only", only]
            environment = {
                **os.environ,
                "PYTHONPATH": f"{checkout / 'src'}{os.pathsep}{checkout / 'lab' / 'src'}",
                "TOUCHLINE_DATA": str(DATA),
            }
            subprocess.run(command, cwd=checkout, env=environment, check=True, stdout=subprocess.DEVNULL)
        finally:
            subprocess.run([*git, "remove", "--force", str(checkout)], check=True)


def compare(before: Path, after: Path, only: str) -> bool:
    """Prints one line per row. Returns whether all are equal to the last bit, NaN as NaN."""
    old, new = ({name: table for name, table in np.load(path).items() if only in name} for path in (before, after))
    for name in sorted(set(old) ^ set(new)):
        print(f"{name}: only {'before' if name in old else 'after'}")
    both = [name for name in old if name in new]
    different = [name for name in both if not np.array_equal(old[name], new[name], equal_nan=True)]
    for name in both:
        print(f"{name}: {difference(name, old[name], new[name]) if name in different else 'equal'}")
    print(f"{len(both) - len(different)} of {len(both)} rows are equal")
    return not different and set(old) == set(new)


def difference(name: str, a: np.ndarray, b: np.ndarray) -> str:
    """Where two tables of one row differ, and by how much in the pose."""
    if a.shape != b.shape:
        return f"DIFFERS, {a.shape} before, {b.shape} after"
    frames = np.flatnonzero(~((a == b) | (np.isnan(a) & np.isnan(b))).all(axis=1))
    first = 0 if name.startswith("points") else 1  # the stamp stands before the pose
    x, y, turn = np.abs(a - b)[:, first : first + 3].T
    away_m, turn_deg = np.hypot(x, y), np.degrees(np.minimum(turn, 2.0 * np.pi - turn))
    text = (
        f"DIFFERS in {len(frames)} of {len(a)} frames, from {frames[0]} on; pose by {np.nanmean(away_m):.3g} m, "
        f"{np.nanmean(turn_deg):.3g}° in the mean, {np.nanmax(away_m):.3g} m, {np.nanmax(turn_deg):.3g}° at most"
    )
    if not first:
        return text
    tracking = [int(np.count_nonzero(table[:, 13] == 0.0)) for table in (a, b)]
    return text if tracking[0] == tracking[1] else f"{text}; tracking {tracking[0]} before, {tracking[1]} after"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", nargs="?", help="the revision to compare this checkout with")
    parser.add_argument("--write", type=Path, metavar="FILE.npz")
    parser.add_argument("--files", type=Path, nargs=2, metavar=("A.npz", "B.npz"))
    parser.add_argument("--only", default="", metavar="TEXT")
    arguments = parser.parse_args()
    if arguments.files:
        return 0 if compare(*arguments.files, arguments.only) else 1
    if arguments.write:
        write(arguments.write, arguments.only)
        return 0
    if not arguments.revision:
        parser.error("name a revision, --write or --files")
    with tempfile.TemporaryDirectory() as folder:
        before, after = Path(folder) / "before.npz", Path(folder) / "after.npz"
        write_revision(arguments.revision, before, arguments.only)
        write(after, arguments.only)
        return 0 if compare(before, after, arguments.only) else 1


if __name__ == "__main__":
    raise SystemExit(main())
