"""Draws figures of README.md, figures.md and touchline.md from docs/benchmark/figures.json, and from nothing else.

python docs/images/figures.py                    # draws
python docs/images/figures.py --measure FOLDER   # measures first; FOLDER holds the public recordings and point sets
"""

from __future__ import annotations

import importlib.metadata
import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import touchline
from touchline.evaluation.latency import cpu_name
from touchline.field.distances import nearest_line_points
from touchline.geometry import FloatArray, Pose
from touchline.localization.registration.kernels import Plan
from touchline.localization.registration.registration import TRACKING, Registration
from touchline_lab.points.bench import bench_points
from touchline_lab.points.bound import mean_errors
from touchline_lab.points.localizers import point_localizer
from touchline_lab.points.point_set import PointSet, read_point_set

ROOT = Path(__file__).parents[2]
FILE = ROOT / "docs" / "benchmark" / "figures.json"
SPEED = FILE.with_name("speed.json")  # written by lab/benchmarks/speed.py
WAITING = {
    "demo": ("first `touchline demo` in an empty cache, processor time", "s", 1.0, "≤ 0.5 ×"),
    "compile": ("`touchline compile`, processor time", "s", 1.0, "≤ 0.5 ×"),
    "locate": ("`touchline locate POINTS.csv`, code cached", "s", 1.0, "0.7 s"),
    "locate warm": ("`touchline.locate` once more", "ms", 1e3, "30 ms"),
}
RECORDINGS = {
    "omni_msl_track": ("quiet run, three standing robots", "mean ≤ 1.5, largest ≤ 6, heading ≤ 0.3"),
    "omni_msl_match": ("eight robots, a third of the view hidden, two shoves", "never 20 off"),
    "omni_msl_sun": ("sun patches, hard shadows, a cloud", "never 20 off"),
    "omni_msl_kidnap": ("covered, carried away, twice", "right within 5 images"),
    "omni_9x6_points": ("9 × 6 m field, lines of 5 cm", "–"),
}
SYSTEMS = ("touchline", "nubot-mti", "nubot-mcl", "iris-fusion")
BENCHED = {
    "touchline": "Gauss–Newton at the points' covariance",
    "nubot-mti": "RPROP, weights by the points' covariance",
}
NO_KERNEL = Plan(np.zeros(6), 1e9, TRACKING.floor_m2, TRACKING.clutter_per_m)
_STEPS = 6


def measured(folder: Path) -> dict[str, Any]:
    """Everything that is drawn."""
    points = read_point_set(folder / "points" / "msl_18x12.npz")
    benches = {name: bench_points(points, point_localizer(name, points.field)).to_dict() for name in BENCHED}
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return {
        "commit": commit.stdout.strip(),
        "machine": cpu_name(),
        "load": os.getloadavg()[0],
        "versions": {name: importlib.metadata.version(name) for name in ("touchline", "numpy", "scipy", "numba")},
        "points": benches,
        "losses": losses(points),
        "recordings": {name: {system: errors_of(folder / name, system) for system in SYSTEMS} for name in RECORDINGS},
    }


def errors_of(recording: Path, system: str) -> dict[str, float]:
    """Mean and largest error (m, rad) of all images, and of the position where the robot is tracked."""
    errors = touchline.run(recording, system=system).errors
    assert errors is not None
    found = {
        f"{name}_{key}": getattr(getattr(errors, name), key)
        for name in ("x", "y", "heading")
        for key in ("mean", "max")
    }
    tracked = errors.tracked_position or errors.position
    return found | {"tracked_mean": tracked.mean, "tracked_max": tracked.max}


def losses(points: PointSet) -> dict[str, list[float]]:
    """Mean position and heading error over the bound, with more known at each step."""
    registration = Registration(points.field.distance_map())
    ways: dict[str, Callable[[int, FloatArray, FloatArray], FloatArray]] = {
        "clutter left out": lambda k, at, spread: registration.fit(at, spread, points.init[k]).pose,
        "and without the robust kernel": lambda k, at, spread: (
            registration.fit(at, spread, points.truth[k], NO_KERNEL).pose
        ),
        "and each point on the line that is nearest at the true pose": lambda k, at, spread: _with_known_lines(
            points, at, spread, points.truth[k]
        ),
    }
    assert points.clutter is not None
    found: dict[str, list[FloatArray]] = {"all points": [], **{name: [] for name in ways}}
    for k, truth in enumerate(points.truth):
        every, kept = points.points[k], ~points.clutter[k]
        at, spread = (np.ascontiguousarray(part[kept]) for part in (every.positions_m, every.covariances_m2))
        poses = [registration.fit(every.positions_m, every.covariances_m2, points.init[k]).pose]
        poses += [way(k, at, spread) for way in ways.values()]
        for errors, pose in zip(found.values(), poses, strict=True):
            errors.append(np.array([math.dist(pose[:2], truth[:2]), abs(math.remainder(pose[2] - truth[2], math.tau))]))
    bound = np.mean([mean_errors(points.bound_of(k)) for k in range(len(points))], axis=0)
    return {name: (np.mean(errors, axis=0) / bound).tolist() for name, errors in found.items()}


def _with_known_lines(points: PointSet, at: FloatArray, spread: FloatArray, truth: FloatArray) -> FloatArray:
    """The pose (3,) by least squares on tangents of the lines where the points (N, 2) lie nearest at the truth."""
    seen = Pose(*truth.tolist()).transform(at)
    places = nearest_line_points(points.field.line_tables, seen)
    normals = (seen - places) / np.maximum(np.hypot(*(seen - places).T), 1e-12)[:, np.newaxis]
    ratio = np.hypot(*(places - truth[:2]).T) / np.hypot(*at.T)  # noise that grows with the range is that of the line's
    spread, pose = spread * np.clip(ratio**2, 0.5, 2.0)[:, np.newaxis, np.newaxis], truth.copy()
    for _ in range(_STEPS):
        cosine, sine = math.cos(pose[2]), math.sin(pose[2])
        turned = at @ np.array([[cosine, sine], [-sine, cosine]])
        in_robot = normals @ np.array([[cosine, -sine], [sine, cosine]])
        variances = np.einsum("ni,nij,nj->n", in_robot, spread, in_robot)
        slopes = np.column_stack((normals, normals[:, 1] * turned[:, 0] - normals[:, 0] * turned[:, 1]))
        residuals = np.einsum("ni,ni->n", normals, turned + pose[:2] - places)
        pose -= np.linalg.solve(slopes.T / variances @ slopes, slopes.T @ (residuals / variances))
    return pose


def drawn(found: dict[str, Any]) -> dict[str, list[str]]:
    """The lines of each table, by its name."""
    own = found["points"]["touchline"]
    bound = f"{_cm(own['bound']['position_m'])} and {math.degrees(own['bound']['heading_rad']):.3f}°"
    beside = "; other programs ran beside it" if found["load"] > 1.0 else ""
    benched = [
        f"| {name}, {how} | {_cm(one['mean_position_m'])}, {math.degrees(one['mean_heading_rad']):.3f}° "
        f"| {one['times_bound']:.2f} | {one['us_per_update']:.0f} µs "
        f"| {'; '.join(format(100.0 * of[way]['success'], '.1f') for way in ('init', 'compass', 'none'))} |"
        for name, how in BENCHED.items()
        for of in [found["points"][name]]
        for one in [of["init"]]
    ]
    mti = {name: found["recordings"][name]["nubot-mti"] for name in RECORDINGS}
    turns = {name: f"{math.degrees(of['heading_mean']):.3f}" for name, of in mti.items()}
    return {
        "points": [f"The bound is {bound}; {found['machine']}, one core, the call included{beside}.", "",
                   "| localizer | mean error | × bound | time | found (%): from the start; a compass; nothing |",
                   "|---|---:|---:|---:|---:|", *benched],
        "losses": ["| known | position | heading |", "|---|---:|---:|",
                   *(f"| {name} | {p:.3f} | {h:.3f} |" for name, (p, h) in found["losses"].items())],
        "nubot-mti": ["| recording | what happens | mean x / y | largest x / y | mean heading | aim |",
                      "|---|---|---:|---:|---:|---|",
                      *(f"| {name} | {what} | {_pair(mti[name], 'x_mean', 'y_mean')} | "
                        f"{_pair(mti[name], 'x_max', 'y_max')} | {turns[name]} | {aim} |"
                        for name, (what, aim) in RECORDINGS.items())],
        "systems": [f"| recording | {' | '.join(SYSTEMS)} |", "|---|" + "---:|" * len(SYSTEMS),
                    *(f"| {name} | " + " | ".join(_pair(of[s], "tracked_mean", "tracked_max") for s in SYSTEMS) + " |"
                      for name, of in found["recordings"].items())],
    }  # fmt: skip


def drawn_speed(found: dict[str, Any]) -> dict[str, list[str]]:
    """The same of what a team waits for."""
    rows = ["| what | at a2f8f31 | now | ratio | aim |", "|---|---:|---:|---:|---:|"]
    for key, (what, unit, scale, aim) in WAITING.items():
        before, now = (scale * found[key][when] for when in ("before", "now"))
        rows.append(f"| {what} | {before:.3g} {unit} | {now:.3g} {unit} | {now / before:.2f} | {aim} |")
    beside = f", {found['cores']} cores; others' programs beside it, load {found['load']:.0f}"
    return {"speed": [f"{found['machine']}{beside}.", "", *rows]}


def _cm(metres: float) -> str:
    return f"{100.0 * metres:.2f} cm"


def _pair(of: dict[str, float], one: str, other: str) -> str:
    return " / ".join(f"{100.0 * of[key]:.2f}" for key in (one, other))


def main(arguments: list[str]) -> None:
    """Measure, if asked to, and draw."""
    if arguments[:1] == ["--measure"]:
        FILE.write_text(json.dumps(measured(Path(arguments[1])), indent=1) + "\n", encoding="utf-8")
    tables = drawn(json.loads(FILE.read_text(encoding="utf-8")))
    tables |= drawn_speed(json.loads(SPEED.read_text(encoding="utf-8")))
    for page in (ROOT / "README.md", ROOT / "docs" / "figures.md", ROOT / "docs" / "touchline.md"):
        text = page.read_text(encoding="utf-8")
        for name, lines in tables.items():
            between = rf"(<!-- drawn: {name} -->\n).*?(<!-- end -->)"
            text = re.sub(between, lambda m, lines=lines: m[1] + "\n".join(lines) + "\n" + m[2], text, flags=re.DOTALL)
        page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
