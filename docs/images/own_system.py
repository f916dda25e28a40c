"""Makes the pictures of docs/touchline.md, from the recording of the demo and from the simulator.

python docs/images/own_system.py [FOLDER]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.localization.estimator.compass_fault import CompassFaultFilter
from touchline.localization.registration.registration import TRACKING, Registration
from touchline.localization.search.pose_search import PoseSearch
from touchline.palette import BLUE, GREEN, ORANGE, VERMILLION
from touchline.sources import open_source
from touchline.systems import RobotSetup, open_system
from touchline.types import LinePoints, Prior
from touchline_lab.experiments.drives import driven

EXAMPLE = Path(__file__).parents[2] / "examples" / "omni_msl_track_short"
FRAME = 20  # the image of the first two pictures
OFF = np.array([0.45, -0.35, 0.2])  # where registration begins, beside the truth (m, m, rad)
SECONDS = 30.0
SECTOR_RAD, NEAR_M = -np.pi / 3.0, 5.0  # the narrow view of the second picture
LIKELY = 0.02  # probability from which a mode is drawn


def main(folder: Path) -> None:
    """Write all pictures."""
    field, points, truth = seen_in_the_demo()
    pictures = {
        "registration": registration(field, points, truth),
        "search": search(field, points, truth),
        "learning": learning(),
        "compass": compass(),
    }
    for name, figure in pictures.items():
        figure.savefig(folder / f"touchline-{name}.png", dpi=110)


def seen_in_the_demo() -> tuple[FieldModel, LinePoints, FloatArray]:
    """Field, line points of one image (robot frame), and where the robot stood (3,)."""
    source = open_source(EXAMPLE)
    assert source.truth is not None
    system = open_system("touchline", RobotSetup(source.field, source.camera))
    for _, frame in zip(range(FRAME + 1), source, strict=False):
        estimate = system.step(frame)
    assert estimate.observation is not None
    return source.field, estimate.observation.points, np.array(source.truth[FRAME])


def registration(field: FieldModel, points: LinePoints, truth: FloatArray) -> Figure:
    """The points on the field at the start, after some steps and at the end, darker the more they weigh."""
    figure, axes = plt.subplots(1, 3, figsize=(11.0, 3.6), layout="constrained")
    begun = Registration(field.distance_map())
    for each, steps in zip(axes, (0, 3, len(TRACKING.widths_m)), strict=True):
        plan = TRACKING._replace(widths_m=TRACKING.widths_m[:steps])
        pose = begun.register(points.positions_m, points.covariances_m2, truth + OFF, plan).pose
        width_m = float(TRACKING.widths_m[min(steps, len(TRACKING.widths_m) - 1)])
        on_field = Pose(*pose).transform(points.positions_m)
        offsets_m, _ = field.distance_map().look_up(on_field)
        influence = (1.0 + offsets_m**2 / (width_m**2 + 0.08**2)) ** -2
        _lines(each, field)
        each.scatter(*on_field.T, s=14, c=1.0 - 0.9 * influence, cmap="gray", vmin=0.0, vmax=1.0, zorder=3)
        _robot(each, Pose(*truth), GREEN, "where it stands")
        _robot(each, Pose(*pose), VERMILLION, "registered")
        off_cm = 100.0 * float(np.hypot(*(pose[:2] - truth[:2])))
        each.set_title(f"{steps} steps, next kernel {width_m:.2f} m: {off_cm:.1f} cm off", fontsize=9)
        each.set_xlim(truth[0] - 5.5, truth[0] + 5.5)
        each.set_ylim(truth[1] - 4.5, truth[1] + 4.5)
    axes[0].legend(fontsize=7, loc="lower left")
    return figure


def search(field: FieldModel, points: LinePoints, truth: FloatArray) -> Figure:
    """The modes of all points, and of the near ones in a sector of 120 degrees."""
    figure, axes = plt.subplots(1, 2, figsize=(11.0, 4.0), layout="constrained")
    ahead = np.array([np.cos(SECTOR_RAD), np.sin(SECTOR_RAD)])  # half of a unit vector along it lies within 60 degrees
    ranges_m = np.hypot(*points.positions_m.T)
    near = (points.positions_m @ ahead >= 0.5 * ranges_m) & (ranges_m < NEAR_M)
    views = (np.full(len(ranges_m), True), "all points"), (near, f"120° out to {NEAR_M:g} m")
    for each, (kept, name) in zip(axes, views, strict=True):
        positions, spreads = points.positions_m[kept], np.ascontiguousarray(points.covariances_m2[kept])
        found = PoseSearch(field, Registration(field.distance_map()))
        modes = found.everywhere(np.ascontiguousarray(positions), spreads)
        _lines(each, field)
        shown = [mode for mode in modes if mode.probability >= LIKELY]
        for mode in reversed(shown):
            _robot(each, mode.pose, VERMILLION, f"{100.0 * mode.probability:.0f} %", 0.3 + 0.7 * mode.probability)
        each.scatter(*Pose(*truth).transform(positions).T, s=5, color=BLUE, zorder=2)
        _robot(each, Pose(*truth), GREEN, "")
        each.set_title(f"{name}: {len(shown)} places", fontsize=9)
        for mode in shown:
            each.annotate(
                f"{100.0 * mode.probability:.0f} %", mode.pose[:2], (6, 6), textcoords="offset points", fontsize=8
            )
    return figure


def learning() -> Figure:
    """Position errors of a robot whose camera.yaml is the design's, with self-calibration and without."""
    changes = ("camera.known_from=design", "camera.mirror.range_spread=0.01")
    drive = driven("straight-tracks", 3, SECONDS, *changes)
    setup = drive.setup
    figure, axes = plt.subplots(1, 2, figsize=(11.0, 3.2), layout="constrained", sharey=True)
    for each, learns in zip(axes, (True, False), strict=True):
        system = open_system("touchline", setup, {"self_calibration": learns})
        system.reset(Prior(Pose(*drive.truth[0])))
        estimates = [system.step(frame) for frame in drive.frames]
        errors = np.array([one.pose[:2] for one in estimates]) - drive.truth[:, :2]
        stated = np.sqrt([np.trace(one.covariance[:2, :2]) for one in estimates])
        each.fill_between(drive.times_s, 0.0, 200.0 * stated, color=ORANGE, alpha=0.35, label="2 σ as stated")
        each.plot(drive.times_s, 100.0 * np.hypot(*errors.T), color=BLUE, label="error")
        each.set(xlabel="time (s)", title=f"self_calibration={str(learns).lower()}", ylim=(0.0, 8.0))
    axes[0].set_ylabel("position (cm)")
    axes[0].legend()
    return figure


def compass() -> Figure:
    """Probability that the pose is at its end, by the compass alone, which turns round for 10 s and once for good; of a
    robot that it had agreed with for long, and of one that was found two seconds before.
    """
    figure, each = plt.subplots(figsize=(11.0, 2.6), layout="constrained")
    each.axvspan(40.0, 50.0, color="0.88")
    each.axvspan(80.0, 120.0, color="0.88")
    for found_s, color, label in ((0.0, BLUE, "followed since 0 s"), (78.0, VERMILLION, "found at 78 s")):
        compass = CompassFaultFilter()
        compass.begin(0.0)
        times_s = np.arange(found_s, 120.0, 0.1)
        probabilities = []
        for time_s in times_s:
            failed = 40.0 <= time_s < 50.0 or time_s >= 80.0
            compass.update(np.pi if failed else 0.0, 0.1)
            probabilities.append(1.0 / (1.0 + np.exp(-compass.log_odds)))
        each.plot(times_s, probabilities, color=color, label=label)
    each.set(xlabel="time (s); grey: the compass is half a turn off", ylabel="probability", ylim=(-0.02, 1.02))
    each.legend(loc="lower left")
    return figure


def _lines(axes: Axes, field: FieldModel) -> None:
    tables = field.line_tables
    for x, y, dx, dy in tables.segments[:, :4]:
        axes.plot([x, x + dx], [y, y + dy], color="0.7", linewidth=1.5, zorder=1)
    for x, y, radius in tables.arcs[:, :3]:
        around = np.linspace(0.0, 2.0 * np.pi, 90)
        if radius > 1.0:
            axes.plot(x + radius * np.cos(around), y + radius * np.sin(around), color="0.7", linewidth=1.5, zorder=1)
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])


def _robot(axes: Axes, pose: Pose, color: str, label: str, alpha: float = 1.0) -> None:
    nose: Sequence[float] = pose.transform(np.array([[0.7, 0.0]]))[0]
    axes.plot(*pose[:2], "o", color=color, markersize=8, alpha=alpha, label=label, zorder=4)
    axes.plot([pose.x, nose[0]], [pose.y, nose[1]], color=color, linewidth=2.5, alpha=alpha, zorder=4)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
