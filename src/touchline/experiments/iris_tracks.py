"""iris-tracks (figure 16): three tracks against the truth. iris-track (figure 17): from A to B, by mode."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from touchline import palette
from touchline.experiments import iris_runs as iris
from touchline.experiments.drives import Drive
from touchline.experiments.harness import NONE, ExperimentResult, Headline, Row, follow, interval, percent, spread
from touchline.experiments.injections import covered
from touchline.experiments.iris_points import all_tours
from touchline.experiments.scenes import BLUE, MAGENTA, RED, dots, new_figure, way
from touchline.simulation.scenario import open_scenario
from touchline.types import Mode

SCENARIO = "tour-20"
FROM_A_TO_B = ((-3.5, -2.0, 0.0), (-1.0, 1.5, 60.0), (1.2, -1.2, -30.0), (3.6, 1.9, 20.0))
HIDDEN_S = ((6.0, 2.0), (10.0, 1.5))
SECONDS = 16.0


def iris_tracks(seeds: int) -> ExperimentResult:
    """Figure 16: odometry, particle filter and fusion along the tour of iris-points."""
    runs, images = all_tours(seeds)
    found, on_images = iris.found_of(runs), iris.found_of(images)
    fused, alone, best, best_alone = (
        f"{_jitter(found[form], system)} cm"
        for form in ("as built", "ideal")
        for system in (iris.FUSION, iris.PARTICLES)
    )
    rows = [_track_row(system, system, found) for system in iris.SYSTEMS]
    return ExperimentResult(
        "Figure 16 of Ismail et al. 2021: tracks by odometry, particle filter and fusion",
        (
            "system", "robots", "mean its form here (cm)", "mean (cm)", "by thirds (cm)", "largest (cm)",
            "heading (°)", "jitter its form here (cm)", "jitter (cm)", "jitter (°)", "ideal: mean (cm)",
            "ideal: jitter (cm)",
        ),
        [*rows, _track_row(f"{iris.FUSION}, on images", iris.FUSION, on_images)],
        Headline("jitter of the fusion; of its particle filter alone", "smoother",
                 f"{fused}; {alone}; ideal {best}; {best_alone}"),
        (
            "The drives of iris-points, all images, moving or standing. Jitter: root mean square change of the error "
            "from image to image. Blue the truth, red the track, as in the paper, which tells no figures.",
            *iris.missed_note(runs, images),
        ),
        [("figure16", _three_tracks(driven)) for driven in found["as built"][:1]],
    )  # fmt: skip


def _track_row(name: str, system: str, found: Mapping[str, Sequence[iris.IrisDrive]]) -> Row:
    ours = found["as built"]
    distances_cm = [100.0 * driven.tracks[system].distances_m for driven in ours]
    thirds = [[float(part.mean()) for part in np.array_split(d, 3)] for d in distances_cm]
    turns = [float(driven.tracks[system].turns_rad.mean()) for driven in ours]
    paper, ideal = (found.get(form, ()) for form in ("its form here", "ideal"))
    return (
        name,
        str(len(ours)),
        _mean(paper, system),
        _mean(ours, system),
        " / ".join(f"{np.mean(third):.2f}" for third in zip(*thirds, strict=True)) or NONE,
        spread([float(d.max()) for d in distances_cm]),
        spread([math.degrees(turn) for turn in turns], 3),
        _jitter(paper, system),
        _jitter(ours, system),
        spread([math.degrees(driven.jitter(system)[1]) for driven in ours], 4),
        _mean(ideal, system),
        _jitter(ideal, system),
    )


def _mean(drives: Sequence[iris.IrisDrive], system: str) -> str:
    return interval([100.0 * float(driven.tracks[system].distances_m.mean()) for driven in drives])


def _jitter(drives: Sequence[iris.IrisDrive], system: str) -> str:
    return spread([100.0 * driven.jitter(system)[0] for driven in drives], 3)


def _three_tracks(driven: iris.IrisDrive) -> Figure:
    titles = [f"({letter}) {system}" for letter, system in zip("abc", iris.SYSTEMS, strict=True)]
    figure, axes = new_figure(1, 3, (13.0, 3.8), titles, field=driven.field)
    for each, system in zip(axes, iris.SYSTEMS, strict=True):
        way(each, driven.truth, BLUE, 1.4, zorder=2)
        way(each, driven.tracks[system].poses, RED, 0.9, zorder=3)
    return figure


def from_a_to_b(seed: int, level: str = "images", changes: tuple[str, ...] = (), paper: bool = False) -> iris.IrisDrive:
    """A drive across the 9 x 6 m field during which the camera is covered twice; level: `images` or `points`."""
    return iris.drive(_taken(seed, level, changes), seed, paper)


@functools.lru_cache(maxsize=1)
def _taken(seed: int, level: str, changes: tuple[str, ...]) -> Drive:
    """The drive, kept for the other form."""
    scenario = open_scenario(SCENARIO, seed, SECONDS, changes)
    waypoints = {"kind": "waypoints", "waypoints": FROM_A_TO_B, "dwell_s": 1.0, "speed_m_s": 1.2}
    motion = type(scenario.motion).model_validate(waypoints)
    taken = iris.iris_drive(scenario.model_copy(update={"motion": motion}), level, seed)
    return functools.reduce(lambda drive, hidden: covered(drive, *hidden), HIDDEN_S, taken)


def iris_track(seeds: int) -> ExperimentResult:
    """Figure 17: which mode the fusion is in along the way from A to B."""
    runs = iris.by_form(seeds, "drives", from_a_to_b)
    robots = follow(range(min(seeds, iris.IMAGE_ROBOTS)), "drives on images")
    runs["on images"] = [from_a_to_b(seed) for seed in robots]
    found = iris.found_of(runs)
    ours = found["as built"]
    named = {"its form here": "its form here", "as built": "ours",
             "on images": f"on images ({len(found['on images'])} robots)", "ideal": "ideal"}  # fmt: skip
    rows = [
        (mode.value, *(_share(found[form], mode) for form in named),
         *(cell for form in named for cell in _errors(found[form], mode)))
        for mode in Mode
    ]  # fmt: skip
    largest, ideal = (
        spread([100.0 * float(driven.fused.distances_m.max()) for driven in found[form]])
        for form in ("as built", "ideal")
    )
    hidden = " and ".join(f"{seconds:g} s at {start:g} s" for start, seconds in HIDDEN_S)
    return ExperimentResult(
        "Figure 17 of Ismail et al. 2021: from A to B, with the mode of the fusion",
        ("mode", *(f"share: {name}" for name in named.values()),
         *(f"{name}: {what} (cm)" for name in named.values() for what in ("mean error", "largest"))),
        rows,
        Headline("images by odometry alone; largest error on the way", "most; –",
                 f"{_share(ours, Mode.ODOMETRY)}; {largest} cm; ideal {ideal} cm"),
        (
            "Robots as built at 10 Hz, at the observation level with the geometry and the errors of their own eyes; on "
            "images through their own masks, rays and regression. "
            f"The camera is covered for {hidden}, so that the odometry has to do; the paper's image gave the "
            "particle filter so little that odometry was the mode most of the way.",
            "Cyan: omnivision, or omnivision and odometry; magenta: odometry alone; black: the truth.",
            *iris.missed_note(runs),
        ),
        [("figure17", _modes_figure(driven)) for driven in ours[:1]],
    )  # fmt: skip


def _share(drives: Sequence[iris.IrisDrive], mode: Mode) -> str:
    return percent([Counter(driven.modes)[mode] / len(driven.modes) for driven in drives])


def _errors(drives: Sequence[iris.IrisDrive], mode: Mode) -> tuple[str, str]:
    """Mean and largest distance from the truth in a mode."""
    distances_cm = [100.0 * driven.fused.distances_m[np.array([m is mode for m in driven.modes])] for driven in drives]
    known = [d for d in distances_cm if len(d)]
    return spread([float(d.mean()) for d in known]), spread([float(d.max()) for d in known])


def _modes_figure(driven: iris.IrisDrive) -> Figure:
    figure, (axes,) = new_figure(size_in=(8.0, 5.8), field=driven.field)
    way(axes, driven.truth, "black", zorder=2, label="truth")
    alone = np.array([mode is Mode.ODOMETRY for mode in driven.modes])
    for here, color, label in ((~alone, palette.SKY, "omnivision, or both"), (alone, MAGENTA, "odometry")):
        dots(axes, driven.fused.poses[here], color, zorder=3, label=label)
    for letter, (x, y, _) in zip("AB", driven.truth[[0, -1]], strict=True):
        axes.annotate(letter, (x, y), xytext=(8, 8), textcoords="offset points", fontsize=12, weight="bold")
    axes.legend(frameon=False, loc="upper left", fontsize=8)
    return figure
