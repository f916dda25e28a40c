"""iris-points (Table I): errors at 20 places of the 9 x 6 m field. iris-tracks (figure 16): three tracks of the same
tours against the truth. iris-track (figure 17): from A to B, by mode.
"""

import functools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import product

import numpy as np
from matplotlib.figure import Figure

from touchline import palette
from touchline.evaluation.metrics import ErrorStatistics
from touchline.field import FieldModel, open_field
from touchline.field.error_map import error_map
from touchline.geometry import FloatArray, IntArray, runs_of
from touchline.types import Mode
from touchline_lab.experiments import iris_runs as iris
from touchline_lab.experiments.drives import Drive, drive_of
from touchline_lab.experiments.harness import (
    NONE,
    ExperimentResult,
    Headline,
    Row,
    follow,
    interval,
    percent,
    seed_range,
    spread,
)
from touchline_lab.experiments.injections import covered
from touchline_lab.experiments.scenes import BLUE, INK, MAGENTA, RED, dots, new_figure, public_recording, way
from touchline_lab.simulation.scenario import open_scenario

SCENARIO, PLACES = "tour-20", 20
IMAGE_HZ = 2.0  # four images at each place; the paper names no rate
TILTED = ("camera.mirror.tilt_deg=[0.5, 0.0]", "camera.mirror.tilt_spread_deg=0", "camera.mirror.shift_spread_mm=0")
PUBLIC = "omni_9x6_points"
# Table I: mean, standard deviation, maximum of x (cm), y (cm), θ (degrees)
PAPER = {
    "odometry": ((24.1, 35.6, 2.7), (18.4, 17.1, 2.0), (53.5, 73.3, 6.2)),
    "particle filter": ((5.7, 8.3, 2.2), (5.8, 6.3, 1.7), (25.1, 19.9, 5.5)),
    "sensor fusion": ((10.5, 7.6, 1.9), (7.8, 6.8, 1.2), (26.5, 21.8, 4.4)),
}
_FIGURES = (("mean", "mean"), ("std", "std_abs"), ("max", "max"), ("median", "median"))
FROM_S = 5.0  # images count as tracked or not from here on
COLUMNS = (
    "system", "robots", "figure", "x paper", "x its form here", "x (cm)", "y paper", "y its form here", "y (cm)",
    "θ paper", "θ its form here", "θ (°)", "jitter (cm)", "ideal: x (cm)", "ideal: y (cm)", "ideal: θ (°)",
)  # fmt: skip
_Statistics = tuple[ErrorStatistics, ...]  # of x, y (m) and heading (rad)


@lru_cache(maxsize=64)
def tour(seed: int, level: str = "images", changes: tuple[str, ...] = (), paper: bool = False) -> iris.IrisDrive:
    """One drive through 20 random places, two seconds at each, of a robot as built unless the changes say otherwise.

    level: `images`, IMAGE_HZ of them, seen through the robot's own masks, rays and regression; or `points`, 10 Hz, with
    the geometry and the errors of these. paper: by the paper's own form. Kept for the experiments that show the same.
    """
    return iris.drive(_taken(seed, level, changes), seed, paper)


@lru_cache(maxsize=1)
def _taken(seed: int, level: str, changes: tuple[str, ...]) -> Drive:
    """A tour, kept for the other form."""
    rate = (f"camera.rate_hz={IMAGE_HZ:g}",) if level == "images" else ()
    return drive_of(*iris.open_iris(open_scenario(SCENARIO, seed, changes=[*rate, *changes]), level, seed))


def all_tours(seeds: int) -> tuple[iris.Runs, iris.Runs]:
    """By form the tours of all seeds at the observation level, and of the first robots on images."""
    at_points = iris.by_form(seeds, "tours", tour)
    robots = list(follow(seed_range(min(seeds, iris.IMAGE_ROBOTS)), "tours on images"))
    on_images = {form: [tour(seed, "images", (), form != iris.FORMS[0]) for seed in robots] for form in iris.FORMS[:2]}
    return at_points, on_images


def recorded_tour(seed: int, paper: bool = False) -> iris.IrisDrive | None:
    """The recording with 8 places, from its images; None where it is not found. paper: by the paper's own form."""
    source = public_recording(PUBLIC)
    return None if source is None else iris.drive(drive_of(source), seed, paper)


def standing(driven: iris.IrisDrive) -> list[IntArray]:
    """Which images (M,) were taken at each place, in order: neighbours with the same true pose.

    No more than 20 places: a simulated tour begins anew after them.
    """
    still = (np.diff(driven.truth, axis=0) == 0.0).all(axis=1)
    return [np.arange(first, last + 1, dtype=np.int64) for first, last in runs_of(still)[:PLACES]]


def errors_at_places(driven: iris.IrisDrive, system: str) -> FloatArray:
    """Mean error (P, 3) of the images at each place, m, m, rad."""
    errors = driven.tracks[system].errors
    return np.array([errors[images].mean(axis=0) for images in standing(driven)]).reshape(-1, 3)


def iris_points(seeds: int) -> ExperimentResult:
    """Table I on simulated tours, and on the recording with 8 places."""
    runs, images = all_tours(seeds)
    tilted = {"as built": [tour(seed, "points", TILTED) for seed in follow(seed_range(seeds), "tours, mirror tilted")]}
    robots = follow(seed_range(len(images["as built"])), "tilted, on images")
    tilted_images = {"as built": [tour(seed, "images", TILTED) for seed in robots]}
    recorded: iris.Runs = {form: [] for form in iris.FORMS[:2]}
    for form, seed in follow(list(product(recorded, seed_range(seeds))), "recorded tours"):
        driven = recorded_tour(seed, form != iris.FORMS[0])
        recorded[form] += [] if driven is None else [driven]
    rows = [row for system in iris.SYSTEMS for row in _rows(system, runs, system, with_paper=True)]
    for name, some in (
        ("on images", images), ("mirror tilted by 0.5°", tilted), ("mirror tilted by 0.5°, on images", tilted_images),
    ):  # fmt: skip
        rows += _rows(f"{iris.FUSION}, {name}", some, iris.FUSION)
    if recorded["as built"]:
        rows += [row for system in iris.SYSTEMS for row in _rows(f"{system}, recorded", recorded, system)]
    return ExperimentResult(
        "Table I of Ismail et al. 2021: errors of odometry, particle filter and fusion at 20 places",
        COLUMNS,
        rows,
        _headline(runs, tilted_images["as built"]),
        (*_NOTES, _RECORDED if recorded["as built"] else _NOT_FOUND,
         *iris.missed_note(runs, images, tilted, tilted_images, recorded)),
        (("error-map", error_map_figure(open_field("indoor-9x6"))),
         *(("places", _places_figure(driven)) for driven in [each for each in runs["as built"] if standing(each)][:1])),
    )  # fmt: skip


_NOTES = (
    f"{PLACES} random places per seed, two seconds at each, robots as built. Where nothing else is said, at the "
    "observation level, 10 Hz, with the geometry and the errors of the robot's own eyes: rays every 2.5°, one "
    "polynomial of the range, which its own head has marked. On images, rendered ones go through its masks and rays, "
    f"{IMAGE_HZ:g} per second. Its form here: with the system's preset `paper`.",
    "The error at a place is the mean over the images taken there. Jitter: root mean square change of the error from "
    "image to image, moving or not. Standard deviations are of |error|.",
    "Odometry and particle filter are alone from where the robot was found on: measuring wheels and gyro; the "
    "particles' own mean, moved by the same wheels and gyro, with nothing of the fusion. The paper's gyro hardly "
    "drifts; ours does, by 0.2 to 0.5 degrees per second.",
    f"Tracked: of the images from {FROM_S:g} s on, of drives in which the robot is never found, too; the errors are "
    "of those in which it is.",
)
_RECORDED = f"Recorded: the images of {PUBLIC}, 8 places, six images at each; the seeds are those of the particles."
_NOT_FOUND = f"The recording {PUBLIC} was not found; TOUCHLINE_DATA names the folder of the recordings."


def _headline(runs: iris.Runs, tilted: Sequence[iris.IrisDrive]) -> Headline:
    def means(drives: Sequence[iris.IrisDrive]) -> str:
        x, y = (_figure(_statistics(drives, iris.FUSION), axis, "mean") for axis in (0, 1))
        return f"{x} cm in x, {y} cm in y, {_tracked(drives)} tracked"

    turn = _figure(_statistics(runs["as built"], iris.FUSION), 2, "mean")
    return Headline(
        "fusion, mean error at 20 places", "10.5 cm in x, 7.6 cm in y, 1.9°",
        f"{means(runs['as built'])}, {turn}°; its form {means(runs['its form here'])}; ideal {means(runs['ideal'])}; "
        f"tilted 0.5°, on images, {means(tilted)}",
    )  # fmt: skip


def _tracked(drives: Sequence[iris.IrisDrive]) -> str:
    """Share of the images from 5 s on in which the robot is tracked, drives in which it is never found among them."""
    return percent([driven.tracked_ratio(FROM_S) for driven in drives])


def _statistics(drives: Sequence[iris.IrisDrive], system: str) -> list[_Statistics]:
    """Those at the places of each drive, if the robot was found before the last of them."""
    errors = [found for driven in drives if len(found := errors_at_places(driven, system))]
    return [tuple(map(ErrorStatistics.of, each.T)) for each in errors]


def _rows(name: str, runs: Mapping[str, Sequence[iris.IrisDrive]], system: str, with_paper: bool = False) -> list[Row]:
    """runs: by form."""
    ours, paper, ideal = (_statistics(runs.get(form, ()), system) for form in iris.FORMS)
    jitter = spread([100.0 * driven.jitter(system)[0] for driven in runs["as built"] if driven.found])
    rows: list[Row] = []
    for k, (title, key) in enumerate(_FIGURES):
        theirs = [f"{value:g}" for value in PAPER[system][k]] if with_paper and k < len(PAPER[system]) else [NONE] * 3
        cells = [text for axis in range(3) for text in (theirs[axis], *(_figure(f, axis, key) for f in (paper, ours)))]
        best = [_figure(ideal, axis, key, among=spread) for axis in range(3)]
        first = (name, str(len(ours)), title, *cells, jitter) if k == 0 else ("", "", title, *cells, "")
        rows.append((*first, *best))
    if system == iris.FUSION:
        shares = [_tracked(runs.get(form, ())) for form in iris.FORMS]
        rows.append(("", "", "tracked", NONE, shares[1], shares[0], *[""] * 7, shares[2], "", ""))
    return rows


def _figure(statistics: Sequence[_Statistics], axis: int, key: str, among: Callable[..., str] | None = None) -> str:
    """One figure of x, y or heading over the robots; a mean has its interval where nothing else is asked."""
    values = np.array([getattr(each[axis], key) for each in statistics])
    summary = among or (interval if key == "mean" else spread)
    return summary(np.degrees(values), 3) if axis == 2 else summary(100.0 * values)


def error_map_figure(field: FieldModel) -> Figure:
    """Figure 9: the field and its error map, y to the left and x upwards, lines black."""
    titles = (f"(a) {field.name}", "(b) error map")
    figure, (plan, errors) = new_figure(1, 2, (8.0, 5.6), titles, ("y (m)", "x (m)"))
    found = error_map(field)
    low = found.origin_m
    high = low + found.resolution_m * (np.array(found.values.shape[::-1]) - 1)
    for line in field.polylines():
        plan.plot(line[:, 1], line[:, 0], color=INK, linewidth=1.2)
    shown = errors.imshow(found.picture(), cmap="gray", vmin=0, vmax=255, extent=(high[1], low[1], low[0], high[0]))
    figure.colorbar(shown, ax=errors, shrink=0.7, label=f"error (255 is {found.farthest_m:g} m)")
    for axes in (plan, errors):
        axes.grid(visible=False)
        axes.set(aspect="equal", xlim=(high[1], low[1]), ylim=(low[0], high[0]))
    return figure


def _places_figure(driven: iris.IrisDrive) -> Figure:
    """As figure 15: the places, with what odometry and fusion say of each."""
    figure, (axes,) = new_figure(size_in=(8.0, 5.8), field=driven.field)
    true = driven.truth[[images[0] for images in standing(driven)]]
    for number, (x, y, _) in enumerate(true, start=1):
        axes.annotate(str(number), (x, y), xytext=(5, 5), textcoords="offset points", fontsize=8)
    dots(axes, true, BLUE, 8, label="truth", zorder=3)
    for system, color in ((iris.ODOMETRY, MAGENTA), (iris.FUSION, RED)):
        dots(axes, true + errors_at_places(driven, system), color, label=system, zorder=4)
    axes.legend(frameon=False, loc="upper right", fontsize=8)
    return figure


# --- figures 16 and 17: tracks ----------------------------------------------------------------------------------------


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
    return iris.drive(_taken_to_b(seed, level, changes), seed, paper)


@functools.lru_cache(maxsize=1)
def _taken_to_b(seed: int, level: str, changes: tuple[str, ...]) -> Drive:
    """The drive, kept for the other form."""
    scenario = open_scenario(SCENARIO, seed, SECONDS, changes)
    waypoints = {"kind": "waypoints", "waypoints": FROM_A_TO_B, "dwell_s": 1.0, "speed_m_s": 1.2}
    motion = type(scenario.motion).model_validate(waypoints)
    taken = drive_of(*iris.open_iris(scenario.model_copy(update={"motion": motion}), level, seed))
    return functools.reduce(lambda drive, hidden: covered(drive, *hidden), HIDDEN_S, taken)


def iris_track(seeds: int) -> ExperimentResult:
    """Figure 17: which mode the fusion is in along the way from A to B."""
    runs = iris.by_form(seeds, "drives", from_a_to_b)
    robots = follow(seed_range(min(seeds, iris.IMAGE_ROBOTS)), "drives on images")
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
