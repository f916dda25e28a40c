"""iris-tracks (figure 16): three tracks against the truth. iris-track (figure 17): from A to B, by mode."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments.iris_eyes import iris_setup
from touchline.experiments.iris_points import toured
from touchline.experiments.iris_runs import SYSTEMS, IrisDrive, covered, drive, missed_note
from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, percent, spread
from touchline.experiments.scenes import BLUE, MAGENTA, RED, field_axes, new_figure
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.types import Mode

CYAN = "#00a3c4"
SCENARIO = "tour-20"
FROM_A_TO_B = ((-3.5, -2.0, 0.0), (-1.0, 1.5, 60.0), (1.2, -1.2, -30.0), (3.6, 1.9, 20.0))
HIDDEN_S = ((6.0, 2.0), (10.0, 1.5))
SECONDS = 16.0


def iris_tracks(seeds: int) -> ExperimentResult:
    """Figure 16: odometry, particle filter and fusion along the tour of iris-points."""
    every = [toured(seed) for seed in follow(range(seeds), "tours")]
    drives = [driven for driven in every if driven.found]
    rows = []
    for system in SYSTEMS:
        distances = [driven.distances_m(system) for driven in drives]
        thirds = [_thirds([100.0 * float(part.mean()) for part in np.array_split(d, 3)]) for d in distances]
        jitters = [driven.jitter(system) for driven in drives]
        rows.append(
            (
                system,
                spread([100.0 * float(d.mean()) for d in distances]),
                " / ".join(f"{np.mean([third[k] for third in thirds]):.2f}" for k in range(3)) if thirds else "–",
                spread([100.0 * float(d.max()) for d in distances]),
                spread([math.degrees(float(np.abs(d.errors(system)[:, 2]).mean())) for d in drives], 3),
                spread([100.0 * position for position, _ in jitters], 3),
                spread([math.degrees(heading) for _, heading in jitters], 4),
            )
        )
    fused, alone = (spread([100.0 * d.jitter(s)[0] for d in drives], 3) for s in ("sensor fusion", "particle filter"))
    return ExperimentResult(
        "iris-tracks",
        "Figure 16 of Ismail et al. 2021: tracks by odometry, particle filter and fusion",
        seeds,
        ("system", "mean (cm)", "by thirds (cm)", "largest (cm)", "heading (°)", "jitter (cm)", "jitter (°)"),
        tuple(rows),
        Headline("jitter of the fusion; of its particle filter alone", "smoother",
                 f"{fused} cm; {alone} cm"),
        (
            "The drives of iris-points, all images, moving or standing. Jitter: root mean square change of the error "
            "from image to image. Blue the truth, red the track, as in the paper.",
            *missed_note(every),
        ),
        tuple(("figure16", _three_tracks(driven)) for driven in drives[:1]),
    )  # fmt: skip


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


def from_a_to_b(seed: int, level: str = "images", changes: tuple[str, ...] = ()) -> IrisDrive:
    """A drive across the 9 x 6 m field during which the camera is covered twice; level: `images` or `points`."""
    scenario = open_scenario(SCENARIO, seed, SECONDS, changes)
    waypoints = {"kind": "waypoints", "waypoints": FROM_A_TO_B, "dwell_s": 1.0, "speed_m_s": 1.2}
    motion = type(scenario.motion).model_validate(waypoints)
    simulation = Simulation(scenario.model_copy(update={"motion": motion}), level)
    first, second = (covered(*hidden) for hidden in HIDDEN_S)
    frames = (second(first(frame)) for frame in simulation)
    return drive(frames, simulation.truth.samples(), iris_setup(simulation, seed), seed)


def iris_track(seeds: int) -> ExperimentResult:
    """Figure 17: which mode the fusion is in along the way from A to B."""
    every = [from_a_to_b(seed) for seed in follow(range(seeds), "drives")]
    drives = [driven for driven in every if driven.found]
    counts = [Counter(driven.modes) for driven in drives]
    rows = [
        (
            mode.value,
            percent([count[mode] / len(driven.modes) for count, driven in zip(counts, drives, strict=True)]),
            *_errors(drives, mode),
        )
        for mode in Mode
    ]
    odometry = percent([c[Mode.ODOMETRY] / len(d.modes) for c, d in zip(counts, drives, strict=True)])
    largest = spread([100.0 * float(driven.distances_m("sensor fusion").max()) for driven in drives])
    hidden = " and ".join(f"{seconds:g} s at {start:g} s" for start, seconds in HIDDEN_S)
    return ExperimentResult(
        "iris-track",
        "Figure 17 of Ismail et al. 2021: from A to B, with the mode of the fusion",
        seeds,
        ("mode", "share of the images", "mean error (cm)", "largest (cm)"),
        tuple(rows),
        Headline("images by odometry alone; largest error on the way", "most; –", f"{odometry}; {largest} cm"),
        (
            "A robot as built, its images at 10 Hz through its own masks, rays and regression. "
            f"The camera is covered for {hidden}, so that the odometry has to do; the paper's image gave the "
            "particle filter so little that odometry was the mode most of the way.",
            "Cyan: omnivision, or omnivision and odometry; magenta: odometry alone; black: the truth.",
            *missed_note(every),
        ),
        tuple(("figure17", _modes_figure(driven)) for driven in drives[:1]),
    )


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
