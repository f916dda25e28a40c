"""The safety net of moves and renames: what every system computes, written down, and two checkouts compared.

    python benchmarks/compare_runs.py REVISION            this checkout against another revision of it
    python benchmarks/compare_runs.py --write FILE.npz    only this checkout's numbers
    python benchmarks/compare_runs.py --files A.npz B.npz two files that were written before

Each checkout runs its own copy of this script, so that interfaces may differ between them. Written are poses,
covariances, statuses and residuals of all systems on the recordings found in TOUCHLINE_DATA (or in shared/data beside
the checkout) and on five scenarios at observation level; matching, global search and particles on the points set.
`--only TEXT` takes the rows whose name contains the text. Exit status 1 if anything differs.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("TOUCHLINE_DATA", ROOT.parent / "shared" / "data"))
SYSTEMS = ("nubot-mti", "nubot-mcl", "iris-fusion")
SCENARIOS = ("match", "kidnap", "straight-tracks", "occlusion-25")
HUMANOID_FIELDS = ("indoor-9x6", "humanoid-kid-9x6")
SECONDS = 30.0
POINT_FRAMES = 200
Rows = Iterator[tuple[str, Callable[[], np.ndarray]]]


def table(estimates: Iterable) -> np.ndarray:
    """(N, 16): stamp, pose, covariance, status, residual, points of each estimate."""
    statuses = ("tracking", "searching", "lost")
    return np.array(
        [
            (e.stamp_ns, *e.pose, *np.ravel(e.covariance), statuses.index(e.status), e.residual_m, e.points)
            for e in estimates
        ]
    )


def drive(source, name: str) -> np.ndarray:
    from touchline.systems import RobotSetup, open_system

    setup = RobotSetup(source.field, getattr(source, "camera", None), source.wheel_directions_rad)
    system = open_system(name, setup)
    return table([system.step(frame) for frame in source])


def recordings() -> Rows:
    from touchline.sources import open_source

    for folder in sorted(DATA.glob("omni_*")):
        for name in SYSTEMS:
            yield f"{folder.name} {name}", lambda folder=folder, name=name: drive(open_source(folder), name)


def scenarios() -> Rows:
    from touchline.simulation.run import Simulation
    from touchline.simulation.scenario import open_scenario

    for scenario in SCENARIOS:
        for name in SYSTEMS:
            yield (
                f"{scenario} {name}",
                lambda scenario=scenario, name=name: drive(
                    Simulation(open_scenario(scenario, 0, SECONDS, ["ideal=true"]), "points"), name
                ),
            )


def humanoids() -> Rows:
    from touchline.simulation.run import Simulation
    from touchline.simulation.scenario import open_scenario

    for field in HUMANOID_FIELDS:
        for changes in ([], ["disturbances.kidnap_every_s=10", "disturbances.covered_images=10"]):
            yield (
                f"humanoid-walk {field}{' kidnapped' if changes else ''} nimbro-lines",
                lambda field=field, changes=changes: drive(
                    Simulation(open_scenario("humanoid-walk", 0, SECONDS, [f"field={field}", *changes]), "points"),
                    "nimbro-lines",
                ),
            )


def point_sets() -> Rows:
    from touchline.field import open_field
    from touchline.geometry import Pose
    from touchline.localization.published.nubot.global_search import GlobalSearch
    from touchline.localization.published.nubot.matcher import Matcher
    from touchline.localization.published.nubot.particles import NubotParticles, NubotParticleSettings
    from touchline.localization.registration.weights import WeightSettings, range_weights

    path = DATA / "points" / "msl_18x12.npz"
    if not path.is_file():
        return
    data = np.load(path)
    field = open_field("msl-18x12")
    matcher = Matcher(field.distance_map())
    search = GlobalSearch(matcher, field.length, field.width)
    offsets = data["offsets"]
    views = [np.ascontiguousarray(data["points"][offsets[i] : offsets[i + 1]]) for i in range(POINT_FRAMES)]
    weights = [range_weights(view, WeightSettings()) for view in views]

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
            mcl = NubotParticles(matcher, field.length, field.width, rng, NubotParticleSettings())
            mcl.restart(float(data["compass"][index]))
            found = mcl.update(view, weight)
            rows.append((*found.pose, *np.ravel(found.covariance)))
        return np.array(rows)

    yield "points matching", matching
    yield "points global", global_search
    yield "points particles", particles


def write(path: Path, only: str) -> None:
    if not (DATA / "points").is_dir():
        print(f"The full recordings are not in {DATA}, so only scenarios run; TOUCHLINE_DATA names their folder.")
    rows = {}
    for source in (point_sets, scenarios, humanoids, recordings):
        for name, measure in source():
            if only in name:
                rows[name] = measure()
                print(f"{name}: {len(rows[name])} rows", flush=True)
    np.savez(path, **rows)


def write_revision(revision: str, path: Path, only: str) -> None:
    """The same by another revision's own script and package, in a checkout of its own."""
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder) / "checkout"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(checkout), revision], check=True)
        try:
            command = [sys.executable, "benchmarks/compare_runs.py", "--write", str(path), "--only", only]
            environment = {**os.environ, "PYTHONPATH": str(checkout / "src"), "TOUCHLINE_DATA": str(DATA)}
            subprocess.run(command, cwd=checkout, env=environment, check=True, stdout=subprocess.DEVNULL)
        finally:
            subprocess.run([*git, "remove", "--force", str(checkout)], check=True)


def compare(before: Path, after: Path) -> bool:
    """Prints one line per row. Returns whether all are equal to the last bit."""
    old, new = np.load(before), np.load(after)
    equal = set(old.files) == set(new.files)
    for name in sorted(set(old.files) ^ set(new.files)):
        print(f"{name}: only {'before' if name in old.files else 'after'}")
    for name in (name for name in old.files if name in new.files):
        a, b = old[name], new[name]
        if a.shape == b.shape and a.tobytes() == b.tobytes():
            print(f"{name}: equal, {len(a)} rows")
            continue
        equal = False
        if a.shape != b.shape:
            print(f"{name}: DIFFERS, {a.shape} before, {b.shape} after")
            continue
        rows = np.flatnonzero(~((a == b) | (np.isnan(a) & np.isnan(b))).all(axis=1))
        most = np.nanmax(np.abs(a - b)[:, 1:4]) if len(rows) else 0.0
        first = rows[0] if len(rows) else "–"
        print(f"{name}: DIFFERS in {len(rows)} of {len(a)} rows, from {first} on, at most {most:.3g}")
    return equal


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", nargs="?", help="the revision to compare this checkout with")
    parser.add_argument("--write", type=Path, metavar="FILE.npz")
    parser.add_argument("--files", type=Path, nargs=2, metavar=("A.npz", "B.npz"))
    parser.add_argument("--only", default="", metavar="TEXT")
    arguments = parser.parse_args()
    if arguments.files:
        return 0 if compare(*arguments.files) else 1
    if arguments.write:
        write(arguments.write, arguments.only)
        return 0
    if not arguments.revision:
        parser.error("name a revision, --write or --files")
    with tempfile.TemporaryDirectory() as folder:
        before, after = Path(folder) / "before.npz", Path(folder) / "after.npz"
        write_revision(arguments.revision, before, arguments.only)
        write(after, arguments.only)
        return 0 if compare(before, after) else 1


if __name__ == "__main__":
    raise SystemExit(main())
