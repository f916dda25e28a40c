"""iris-points: errors at 20 places of the 9 x 6 m field, by odometry, particle filter and fusion (Table I)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from touchline.evaluation.metrics import ErrorStatistics
from touchline.experiments import iris_runs as iris
from touchline.experiments.drives import Drive, drive_of
from touchline.experiments.harness import NONE, ExperimentResult, Headline, Row, follow, interval, percent, spread
from touchline.experiments.scenes import BLUE, INK, MAGENTA, RED, dots, new_figure, public_recording
from touchline.field import FieldModel, open_field
from touchline.field.error_map import error_map
from touchline.geometry import FloatArray, runs_of
from touchline.simulation.scenario import open_scenario

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
_FIGURES = (("mean", "mean"), ("std", "std_abs"), ("max", "max"))
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
    return iris.iris_drive(open_scenario(SCENARIO, seed, changes=[*rate, *changes]), level, seed)


def all_tours(seeds: int) -> tuple[iris.Runs, iris.Runs]:
    """By form the tours of all seeds at the observation level, and of the first robots on images."""
    at_points = iris.by_form(seeds, "tours", tour)
    robots = list(follow(range(min(seeds, iris.IMAGE_ROBOTS)), "tours on images"))
    on_images = {form: [tour(seed, "images", (), form != iris.FORMS[0]) for seed in robots] for form in iris.FORMS[:2]}
    return at_points, on_images


def recorded_tour(seed: int) -> iris.IrisDrive | None:
    """The recording with 8 places, from its images; None where it is not found."""
    source = public_recording(PUBLIC)
    return None if source is None else iris.drive(drive_of(source), seed)


def standing(driven: iris.IrisDrive) -> list[npt.NDArray[np.int64]]:
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
    tilted = {"as built": [tour(seed, "points", TILTED) for seed in follow(range(seeds), "tours, mirror tilted")]}
    robots = follow(range(len(images["as built"])), "tilted, on images")
    tilted_images = {"as built": [tour(seed, "images", TILTED) for seed in robots]}
    tours = map(recorded_tour, follow(range(seeds), "recorded tours"))
    recorded = {"as built": [driven for driven in tours if driven is not None]}
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
        (*_NOTES, f"{_TRACKED}: {_tracked(runs, images, tilted, tilted_images)}.",
         _RECORDED if recorded["as built"] else _NOT_FOUND,
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
)
_TRACKED = "Tracked, of the images from 5 s on, of drives in which the robot is never found, too"
_RECORDED = f"Recorded: the images of {PUBLIC}, 8 places, six images at each; the seeds are those of the particles."
_NOT_FOUND = f"The recording {PUBLIC} was not found; TOUCHLINE_DATA names the folder of the recordings."


def _headline(runs: iris.Runs, tilted: Sequence[iris.IrisDrive]) -> Headline:
    def means(drives: Sequence[iris.IrisDrive]) -> str:
        x, y = (_figure(_statistics(drives, iris.FUSION), axis, "mean") for axis in (0, 1))
        return f"{x} cm in x, {y} cm in y"

    turn = _figure(_statistics(runs["as built"], iris.FUSION), 2, "mean")
    return Headline(
        "fusion, mean error at 20 places", "10.5 cm in x, 7.6 cm in y, 1.9°",
        f"{means(runs['as built'])}, {turn}°; its form {means(runs['its form here'])}; ideal {means(runs['ideal'])}; "
        f"tilted 0.5°, on images, {means(tilted)}",
    )  # fmt: skip


def _tracked(runs: iris.Runs, images: iris.Runs, tilted: iris.Runs, tilted_images: iris.Runs) -> str:
    """Share of the images from 5 s on in which the robot is tracked, drives in which it is never found among them."""
    every = {
        "as built": runs["as built"], "its form here": runs["its form here"], "ideal": runs["ideal"],
        "mirror tilted by 0.5°": tilted["as built"], "as built on images": images["as built"],
        "its form here on images": images["its form here"], "tilted on images": tilted_images["as built"],
    }  # fmt: skip
    shares = {name: percent([driven.tracked_ratio(5.0) for driven in drives]) for name, drives in every.items()}
    return ", ".join(f"{name} {share}" for name, share in shares.items())


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
        theirs = [f"{value:g}" for value in PAPER[system][k]] if with_paper else [NONE] * 3
        cells = [text for axis in range(3) for text in (theirs[axis], *(_figure(f, axis, key) for f in (paper, ours)))]
        best = [_figure(ideal, axis, key, among=spread) for axis in range(3)]
        first = (name, str(len(ours)), title, *cells, jitter) if k == 0 else ("", "", title, *cells, "")
        rows.append((*first, *best))
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
