"""iris-tracks (figure 16): three tracks against the truth. iris-track (figure 17): from A to B, by mode."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np
from matplotlib.figure import Figure

from touchline import palette
from touchline.experiments.iris_eyes import open_iris
from touchline.experiments.iris_points import all_tours
from touchline.experiments.iris_runs import IMAGE_ROBOTS, SYSTEMS, IrisDrive, by_form, covered, drive, missed_note
from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, interval, percent, spread
from touchline.experiments.scenes import BLUE, MAGENTA, RED, field_axes, new_figure
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import RobotSetup
from touchline.types import Frame, Mode

CYAN = palette.SKY
SCENARIO = "tour-20"
FROM_A_TO_B = ((-3.5, -2.0, 0.0), (-1.0, 1.5, 60.0), (1.2, -1.2, -30.0), (3.6, 1.9, 20.0))
HIDDEN_S = ((6.0, 2.0), (10.0, 1.5))
SECONDS = 16.0


def iris_tracks(seeds: int) -> ExperimentResult:
    """Figure 16: odometry, particle filter and fusion along the tour of iris-points."""
    runs, images = all_tours(seeds)
    found = {form: [driven for driven in drives if driven.found] for form, drives in runs.items()}
    on_images = {form: [driven for driven in drives if driven.found] for form, drives in images.items()}
    rows = [_track_row(system, system, found) for system in SYSTEMS]
    rows.append(_track_row("sensor fusion, on images", "sensor fusion", on_images))
    fused, alone = (_jitter(found["as built"], system) for system in ("sensor fusion", "particle filter"))
    return ExperimentResult(
        "iris-tracks",
        "Figure 16 of Ismail et al. 2021: tracks by odometry, particle filter and fusion",
        seeds,
        (
            "system", "robots", "mean its form here (cm)", "mean (cm)", "by thirds (cm)", "largest (cm)",
            "heading (°)", "jitter its form here (cm)", "jitter (cm)", "jitter (°)", "ideal: mean (cm)",
            "ideal: jitter (cm)",
        ),
        tuple(rows),
        Headline("jitter of the fusion; of its particle filter alone", "smoother",
                 f"{fused} cm; {alone} cm; ideal {_jitter(found['ideal'], 'sensor fusion')} cm; "
                 f"{_jitter(found['ideal'], 'particle filter')} cm"),
        (
            "The drives of iris-points, all images, moving or standing. Jitter: root mean square change of the error "
            "from image to image. Blue the truth, red the track, as in the paper, which tells no figures.",
            *missed_note([driven for some in (runs, images) for drives in some.values() for driven in drives]),
        ),
        tuple(("figure16", _three_tracks(driven)) for driven in found["as built"][:1]),
    )  # fmt: skip


def _track_row(name: str, system: str, found: Mapping[str, Sequence[IrisDrive]]) -> tuple[str, ...]:
    ours = found["as built"]
    distances = [driven.distances_m(system) for driven in ours]
    thirds = [_thirds([100.0 * float(part.mean()) for part in np.array_split(d, 3)]) for d in distances]
    return (
        name,
        str(len(ours)),
        _mean(found["its form here"], system),
        _mean(ours, system),
        " / ".join(f"{np.mean([third[k] for third in thirds]):.2f}" for k in range(3)) if thirds else "–",
        spread([100.0 * float(d.max()) for d in distances]),
        spread([math.degrees(float(np.abs(d.errors(system)[:, 2]).mean())) for d in ours], 3),
        _jitter(found["its form here"], system),
        _jitter(ours, system),
        spread([math.degrees(d.jitter(system)[1]) for d in ours], 4),
        _mean(found["ideal"], system),
        _jitter(found["ideal"], system),
    )


def _mean(drives: Sequence[IrisDrive], system: str) -> str:
    return interval([100.0 * float(driven.distances_m(system).mean()) for driven in drives])


def _jitter(drives: Sequence[IrisDrive], system: str) -> str:
    return spread([100.0 * driven.jitter(system)[0] for driven in drives], 3)


def _thirds(means: list[float]) -> tuple[float, float, float]:
    return means[0], means[1], means[2]


def _three_tracks(driven: IrisDrive) -> Figure:
    figure, axes = new_figure(1, 3, width_in=13.0, height_in=3.8)
    for each, system, letter in zip(axes, SYSTEMS, "abc", strict=True):
        field_axes(each, driven.field)
        each.plot(*driven.truth[:, :2].T, color=BLUE, linewidth=1.4, zorder=2)
        each.plot(*driven.tracks[system][:, :2].T, color=RED, linewidth=0.9, zorder=3)
        each.set_title(f"({letter}) {system}", fontsize=10)
    return figure


def from_a_to_b(seed: int, level: str = "images", changes: tuple[str, ...] = (), paper: bool = False) -> IrisDrive:
    """A drive across the 9 x 6 m field during which the camera is covered twice; level: `images` or `points`."""
    simulation, setup, frames = _driven(seed, level, changes)
    return drive(frames, simulation.truth.samples(), setup, seed, paper)


@lru_cache(maxsize=1)
def _driven(seed: int, level: str, changes: tuple[str, ...]) -> tuple[Simulation, RobotSetup, tuple[Frame, ...]]:
    """The drive's frames, kept for the other form."""
    scenario = open_scenario(SCENARIO, seed, SECONDS, changes)
    waypoints = {"kind": "waypoints", "waypoints": FROM_A_TO_B, "dwell_s": 1.0, "speed_m_s": 1.2}
    motion = type(scenario.motion).model_validate(waypoints)
    simulation, setup = open_iris(scenario.model_copy(update={"motion": motion}), level, seed)
    first, second = (covered(*hidden) for hidden in HIDDEN_S)
    return simulation, setup, tuple(second(first(frame)) for frame in simulation)


def iris_track(seeds: int) -> ExperimentResult:
    """Figure 17: which mode the fusion is in along the way from A to B."""
    runs = by_form(list(follow(range(seeds), "drives")), lambda seed, *form: from_a_to_b(seed, "points", *form))
    robots = follow(range(min(seeds, IMAGE_ROBOTS)), "drives on images")
    runs["on images"] = [from_a_to_b(seed) for seed in robots]
    found = {name: [driven for driven in drives if driven.found] for name, drives in runs.items()}
    ours = found["as built"]
    rows = [
        (mode.value, *(_share(found[form], mode) for form in ("its form here", "as built", "on images", "ideal")),
         *(cell for form in ("its form here", "as built", "on images", "ideal") for cell in _errors(found[form], mode)))
        for mode in Mode
    ]  # fmt: skip
    largest, ideal = (
        spread([100.0 * float(driven.distances_m("sensor fusion").max()) for driven in found[form]])
        for form in ("as built", "ideal")
    )
    hidden = " and ".join(f"{seconds:g} s at {start:g} s" for start, seconds in HIDDEN_S)
    named = ("its form here", "ours", f"on images ({len(found['on images'])} robots)", "ideal")
    return ExperimentResult(
        "iris-track",
        "Figure 17 of Ismail et al. 2021: from A to B, with the mode of the fusion",
        seeds,
        ("mode", *(f"share: {name}" for name in named),
         *(f"{name}: {what} (cm)" for name in named for what in ("mean error", "largest"))),
        tuple(rows),
        Headline("images by odometry alone; largest error on the way", "most; –",
                 f"{_share(ours, Mode.ODOMETRY)}; {largest} cm; ideal {ideal} cm"),
        (
            "Robots as built at 10 Hz, at the observation level with the geometry and the errors of their own eyes; on "
            "images through their own masks, rays and regression. "
            f"The camera is covered for {hidden}, so that the odometry has to do; the paper's image gave the "
            "particle filter so little that odometry was the mode most of the way.",
            "Cyan: omnivision, or omnivision and odometry; magenta: odometry alone; black: the truth.",
            *missed_note([driven for drives in runs.values() for driven in drives]),
        ),
        tuple(("figure17", _modes_figure(driven)) for driven in ours[:1]),
    )  # fmt: skip


def _share(drives: Sequence[IrisDrive], mode: Mode) -> str:
    return percent([Counter(driven.modes)[mode] / len(driven.modes) for driven in drives])


def _errors(drives: Sequence[IrisDrive], mode: Mode) -> tuple[str, str]:
    """Mean and largest distance from the truth in a mode."""
    distances = [
        100.0 * driven.distances_m("sensor fusion")[np.array([m is mode for m in driven.modes])] for driven in drives
    ]
    known = [d for d in distances if len(d)]
    return spread([float(d.mean()) for d in known]), spread([float(d.max()) for d in known])


def _modes_figure(driven: IrisDrive) -> Figure:
    figure, (axes,) = new_figure(width_in=8.0, height_in=5.8)
    field_axes(axes, driven.field)
    axes.plot(*driven.truth[:, :2].T, color="black", linewidth=1.0, zorder=2, label="truth")
    alone = np.array([mode is Mode.ODOMETRY for mode in driven.modes])
    track = driven.tracks["sensor fusion"]
    for here, color, label in ((~alone, CYAN, "omnivision, or both"), (alone, MAGENTA, "odometry")):
        axes.plot(*track[here, :2].T, "o", color=color, markersize=4, zorder=3, label=label)
    for letter, (x, y, _) in zip("AB", driven.truth[[0, -1]], strict=True):
        axes.annotate(letter, (x, y), xytext=(8, 8), textcoords="offset points", fontsize=12, weight="bold")
    axes.legend(frameon=False, loc="upper left", fontsize=8)
    return figure
