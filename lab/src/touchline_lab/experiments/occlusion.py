"""lu2013-occlusion (Table 1, figure 8) and xiong-tracking (Table 1): straight tracks, with parts of the view hidden.

And the figures of both papers without a table: calibration, the map of distances, images with their line points.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from touchline.camera import Camera, require_omni
from touchline.evaluation.metrics import ErrorTable
from touchline.field import FieldModel, open_field
from touchline.geometry import BoolArray, FloatArray
from touchline.perception import LinePointDetector
from touchline.perception.colour import GREEN, WHITE
from touchline.published.nubot_mcl.mirror_picture import mirror_picture
from touchline.published.strip.mirror import MirrorCalibration, calibrate_mirror
from touchline.sources import open_source
from touchline.systems import RobotSetup, open_system, paper_settings
from touchline.types import ImageArray
from touchline_lab.experiments import scenes
from touchline_lab.experiments.drives import Drive, Track, drive_of, error_figures, followed, track_of
from touchline_lab.experiments.harness import (
    NONE,
    ExperimentResult,
    Headline,
    Row,
    follow,
    gathered,
    interval,
    percent,
    seed_range,
    spread,
)
from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.run import Eyes, Simulation
from touchline_lab.simulation.scenario import open_scenario

Sectors = tuple[tuple[float, float], ...]
PaperRow = tuple[float, float, float]

ALONE = "nubot-mcl-alone"
FORMS = OURS, PAPER, IDEAL = "ours", "its form", "ideal"


@dataclass(frozen=True, slots=True)
class Condition:
    """A row of Table 1: its name, the black sectors (degrees, base frame), the paper's mean, deviation, maximum.

    Each of the paper's figures: x (cm), y (cm), heading (rad). changes: of the scenario, for what is otherwise than on
    a robot as built. odometry: whether the system is told of it. calibrated: whether camera.yaml comes from rendered
    images of the strip (figure 2), not from simulated edges.
    """

    name: str
    sectors: Sectors = ()
    paper: tuple[PaperRow, PaperRow, PaperRow] | None = None
    system: str = "nubot-mcl"
    changes: tuple[str, ...] = ()
    scenario: str = "straight-tracks"
    odometry: bool = True
    calibrated: bool = False


_ONE: Sectors = ((22.5, 67.5),)
_TWO: Sectors = ((22.5, 67.5), (202.5, 247.5))
_FOUR: Sectors = ((22.5, 67.5), (112.5, 157.5), (202.5, 247.5), (292.5, 337.5))
_HALF: Sectors = ((0.0, 180.0),)
_FREE_PAPER = ((5.907, 5.967, 0.044), (7.334, 7.117, 0.052), (30.724, 35.595, 0.286))
CONDITIONS = (
    Condition("free", (), _FREE_PAPER),
    Condition("12.5 %", _ONE, ((5.981, 7.143, 0.059), (7.595, 7.313, 0.075), (32.817, 35.036, 0.468))),
    Condition("25 %", _TWO, ((5.732, 7.417, 0.064), (7.016, 7.103, 0.080), (33.830, 30.449, 0.550))),
    Condition("50 %", _FOUR, ((7.830, 6.946, 0.063), (10.017, 6.780, 0.080), (47.035, 29.730, 0.530))),
    Condition("50 % in one half", _HALF),
    Condition("free, MCL alone", system=ALONE),
    Condition("50 %, MCL alone", _FOUR, system=ALONE),
)
_RANGE_SPREAD = "camera.mirror.range_spread=0.01"
STRIP = Condition("free, of calibrate mirror on images", calibrated=True)
OTHER_ROBOTS = (
    Condition("free, of the design, ranges 1 %", changes=("camera.known_from=design", _RANGE_SPREAD)),
    Condition("free, of calibrate range, ranges 1 %", changes=("camera.known_from=calibrate-range", _RANGE_SPREAD)),
    Condition("free, vibration of 0.3°", changes=("camera.mirror.vibration_deg=0.3",)),
    Condition("free, no delay", changes=("camera.delay_s=0",)),
    Condition("free, 100 ms late", changes=("camera.delay_s=0.1",)),
    Condition("free, 100 ms late, stamped on arrival", changes=("camera.delay_s=0.1", "camera.stamped=arrived")),
)  # fmt: skip
PLAY = (
    Condition("match", system="nubot-mti", scenario="match"),
    Condition("match, without odometry", system="nubot-mti", scenario="match", odometry=False),
)
RECORDING = "omni_msl_track"
RECORDED_SEEDS = 2  # of the particles, whose chance changes little there
COLUMNS = ("hidden", "figure", "paper", "its form here", "ours", "ideal")
PRINTED = tuple((name, key) for key in ("mean", "std_signed", "max") for name in ("x", "y", "heading"))  # in the papers
POSITION = tuple(("position", key) for key in ("mean", "median", "max"))
KEYS = {"std_signed": "standard deviation", "max": "maximum"}
FROM_S = 5.0  # errors count from here on
INK, WHITE_PAINT, OTHER = (32, 42, 48), (245, 245, 245), (120, 120, 120)  # of the classes in pictures
SIDE_IN = 4.0
AFTER_SHOVE_S = 1.15  # what lies within a second after a shove, which takes 0.15 s


_SIMULATED = (
    "The scenario straight-tracks at the observation level, 60 s at 10 Hz, each robot as built and drawn anew "
    "from its seed, camera.yaml from calibrate mirror where nothing else is said; beside it the same seeds' ideal "
    f"robots. Errors count from {FROM_S:g} s on, and once the start is over: the robot found, within 30 cm and 10°, "
    "by its images and the compass alone. Wrong at the start: how long a pose was believed before that which is more "
    "than 0.5 m or 0.5 rad off. 99 %: of tracked frames outside the first second after a shove. Brackets: "
    "where the mean over robots lies with 95 %, by bootstrap. Its form here: the same robots as built with the "
    "system's preset `paper`; what that leaves out of the paper stands on the system's page. "
    "One black sector of 45 degrees, two opposite, four alternating; a half in one piece."
)
_STRIP = (
    "Of calibrate mirror on images: `calibrate mirror` on 24 rendered images of the strip (figure 2), seen by each "
    "robot's very head; elsewhere its edges are simulated, with 0.1 px of error."
)
_ALONE = (
    "MCL alone: the mean of the particles is the pose in every image (nubot-mcl-alone, all else as nubot-mcl has it). "
    "The likelihood has an end, at 3.3 σ, and σ falls from 0.3 to 0.1 m once the particles have converged; in the "
    "paper's form the square of every distance counts, and the points on a goal's posts and net outweigh the lines."
)
_RECORDED = (
    f"Recorded: the {RECORDING} images with black sectors laid over them, at the same angles in the image; "
    f"{RECORDED_SEEDS} seeds, those of the particles. Its form finds its points there by the detector of the paper's "
    "reference 25."
)
_NOT_FOUND = f"The recording {RECORDING} was not found; TOUCHLINE_DATA names the folder of the recordings."


@dataclass(frozen=True, eq=False, slots=True)
class Run:
    """One run: its errors once the robot was found, None where nothing was tracked, and its track.

    quiet_m: position errors (M,) of the tracked frames but those within a second after a shove. tracked: share of the
    frames that count. found_s: when the robot was found first, infinite where never; wrong_s: how long a wrong pose was
    believed before.
    """

    errors: ErrorTable | None
    quiet_m: FloatArray
    tracked: float
    found_s: float
    wrong_s: float
    track: Track
    field: FieldModel


Runs = Mapping[tuple[str, str], Sequence[Run]]  # by condition and form


def lu2013_occlusion(seeds: int) -> ExperimentResult:
    """Table 1: nubot-mcl on five straight tracks with black sectors fixed in the view."""
    every = (*CONDITIONS, STRIP, *OTHER_ROBOTS)
    runs = _all_runs(every, CONDITIONS, seeds)
    recorded = _recorded(min(seeds, RECORDED_SEEDS))
    shown = CONDITIONS[:4]
    head = calibrated_head(_taken(CONDITIONS[0], 0, False)[1])
    strip = mirror_picture(*head, head[0].sightings[0])
    simulation, image = rendered_image()
    black = [(c.name, black_pixels(simulation.camera, c.sectors)) for c in shown[1:]]
    return ExperimentResult(
        "Table 1 of Lu et al. 2013: errors with 0 to 50 % of the view hidden",
        COLUMNS,
        [row for c in every for row in _rows(c, runs)] + [row for found in recorded for row in _rows(*found)],
        Headline("mean errors with 0 to 50 % hidden", "5.7-7.8 cm in x and y, 0.044-0.064 rad",
                 f"{_range_of(runs, OURS)}; its form {_range_of(runs, PAPER)}, but wrong at the start for "
                 f"{_median_longest([run.wrong_s for c in shown for run in runs[c.name, PAPER]])} s (median, longest); "
                 f"ideal {_range_of(runs, IDEAL)}"),
        (_SIMULATED, _STRIP, _ALONE, _RECORDED if recorded else _NOT_FOUND),
        (
            ("figure2", scenes.image_figure([strip], (3 * SIDE_IN, SIDE_IN + 0.2))[0]),
            ("figures-4-7", detection_figure(simulation, image, [("free", None), *black])),
            ("figure5", distances_figure()),
            ("tracks", _tracks_figure([runs[c.name, OURS][0] for c in shown], [c.name for c in shown])),
        ),
    )  # fmt: skip


def _all_runs(every: Sequence[Condition], shown: Sequence[Condition], seeds: int) -> Runs:
    """Ours of every condition; of those shown beside them the paper's form and ideal robots, too."""
    return gathered(_runs_of, [(c, seed, c in shown) for c in every for seed in seed_range(seeds)], "drives")


def _runs_of(task: tuple[Condition, int, bool]) -> dict[tuple[str, str], Run]:
    condition, seed, shown = task
    forms = zip(FORMS, ((False, False), (False, True), (True, False)), strict=True)
    return {(condition.name, form): drive(condition, seed, *how) for form, how in forms if shown or form == OURS}


def _range_of(runs: Runs, form: str) -> str:
    """Least and largest mean errors of the paper's four conditions."""
    of = [runs[c.name, form] for c in CONDITIONS[:4]]
    means, turns = ([np.mean(_figures(some, name, "mean")[0]) for some in of] for name in ("position", "heading"))
    return f"{min(means):.2f}-{max(means):.2f} cm away, {min(turns):.4f}-{max(turns):.4f} rad"


def xiong_tracking(seeds: int) -> ExperimentResult:
    """Table 1: nubot-mti on five straight tracks; other robots; in a match, with and without odometry."""
    free = Condition("free", (), _FREE_PAPER, "nubot-mti")
    every = (free, *(replace(c, system="nubot-mti") for c in OTHER_ROBOTS), *PLAY)
    runs = _all_runs(every, (free, *PLAY), seeds)
    position, printed, at_best = (interval(*_figures(runs["free", form], "position", "mean")) for form in FORMS)
    heading = interval(*_figures(runs["free", OURS], "heading", "mean"))
    wrong = _median_longest([run.wrong_s for run in runs["free", PAPER]])
    return ExperimentResult(
        "Table 1 of Xiong et al.: errors along straight lines",
        COLUMNS,
        [row for c in every for row in _rows(c, runs)],
        Headline("mean errors along straight lines", "5.9 cm in x, 6.0 cm in y, 0.044 rad",
                 f"{position} cm in position, {heading} rad; its form {printed} cm, but wrong at the "
                 f"start for {wrong} s; ideal {at_best} cm"),
        (
            _SIMULATED.partition(" One black sector")[0],
            "Match: the scenario match, 3 m/s among eight robots that shove; the same frames once with odometry and "
            "once without.",
        ),
        (
            ("figure6", detection_figure(*rendered_image(1), [("", None)])),
            ("tracks", _tracks_figure(runs["free", OURS][:1], ["nubot-mti"])),
        ),
    )  # fmt: skip


@lru_cache(maxsize=2)
def _taken(c: Condition, seed: int, ideal: bool) -> tuple[Drive, Simulation]:
    """A run with the camera that its camera.yaml tells, kept for the next system that takes it."""
    scenario = open_scenario(c.scenario, seed, changes=["ideal=true"] if ideal else c.changes)
    hidden = scenario.camera.model_copy(update={"black_sectors_deg": c.sectors})
    chosen = scenario.model_copy(update={"camera": hidden})
    simulation = Simulation(chosen, level="points")
    if not c.calibrated:
        return drive_of(simulation), simulation
    camera = calibrated_head(simulation)[0].camera
    setup = RobotSetup(simulation.field, camera, simulation.wheel_directions_rad)
    return drive_of(Simulation(chosen, level="points", eyes=Eyes(known=camera)), setup), simulation


def drive(condition: Condition, seed: int, ideal: bool = False, paper: bool = False) -> Run:
    """A robot of this seed, as built or ideal, along the tracks under a condition; paper: by the paper's own form."""
    taken, _ = _taken(condition, seed, ideal)
    if not condition.odometry:
        taken = replace(taken, frames=[replace(frame, odometry=None) for frame in taken.frames])
    track = followed(condition.system, taken, seed, paper_settings(condition.system) if paper else None)
    since = track.times_s[:, np.newaxis] - np.array(taken.times_of("slip"))
    return _run_of(track, ~((since >= 0.0) & (since < AFTER_SHOVE_S)).any(axis=1), taken.field, FROM_S)


def _run_of(track: Track, quiet: BoolArray, field: FieldModel, from_s: float = 0.0) -> Run:
    """A run's figures: of its start, and of what comes after. quiet (N,): frames that no shove has just moved."""
    started = np.logical_or.accumulate(track.found)
    counted = started & (track.times_s >= from_s)
    found_s = float(track.times_s[started][0] - track.times_s[0]) if started.any() else np.inf
    wrong_s = float(np.sum(track.wrong & ~started) * np.median(np.diff(track.times_s)))
    tracked = float(np.mean(track.tracking[track.times_s >= from_s]))
    quiet_m = track.distances_m[track.tracking & counted & quiet]
    return Run(track.table(track.tracking & counted), quiet_m, tracked, found_s, wrong_s, track, field)


def _recorded(seeds: int) -> list[tuple[Condition, Runs]]:
    """The same conditions over the images of a recording, those of MCL alone once; empty where it isn't found."""
    recording = scenes.public_recording(RECORDING)
    if recording is None:
        return []
    setup = RobotSetup(recording.field, recording.camera)
    blind = drive_of(recording, setup, [replace(frame, image=None) for frame in recording])
    drives = list(product(CONDITIONS, (OURS, PAPER), seed_range(seeds)))
    found: dict[tuple[str, str], list[Run]] = {}
    for c, form, seed in follow(drives, "recorded drives"):
        system = open_system(c.system, setup, paper_settings(c.system) if form == PAPER else None, rng=seed)
        hidden = black_pixels(recording.camera, c.sectors)
        frames = (replace(frame, image=_blackened(frame.image, hidden)) for frame in recording)
        track = track_of(blind, [system.step(frame) for frame in frames])
        run = _run_of(track, np.ones(len(track.times_s), dtype=np.bool_), recording.field)
        found.setdefault((f"recorded, {c.name}", form), []).append(run)
    return [(replace(c, name=f"recorded, {c.name}", paper=None), found) for c in CONDITIONS]


def black_pixels(camera: Camera, sectors: Sectors) -> BoolArray:
    """(H, W): the pixels of sectors given in degrees about the image's centre."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    u0, v0 = require_omni(camera, "sectors about the middle are blackened in images of").center
    angle = np.degrees(np.arctan2(v - v0, u - u0)) % 360.0
    hidden = np.zeros(angle.shape, dtype=np.bool_)
    for low, high in sectors:
        hidden |= (angle >= low) & (angle < high)
    return hidden


def _blackened(image: ImageArray | None, hidden: BoolArray) -> ImageArray | None:
    return None if image is None else np.where(hidden[..., np.newaxis], np.uint8(0), image)


def _rows(condition: Condition, every: Runs) -> list[Row]:
    """Errors, as the paper has them where it has any; what 99 % of quiet frames stay below; tracked; the start."""
    forms = [every.get((condition.name, form), ()) for form in (PAPER, OURS, IDEAL)]
    printed = [f"{value:g}" for row in condition.paper or () for value in row]
    figures = [*zip(PRINTED, printed, strict=True)] if printed else [(("heading", "mean"), NONE)]
    rows: list[Row] = []
    for (name, key), paper in [*figures, *((figure, NONE) for figure in POSITION)]:
        cells = [(interval if key == "mean" else spread)(*_figures(runs, name, key)) for runs in forms]
        unit = "rad" if name == "heading" else "cm"
        rows.append(("", f"{name}, {KEYS.get(key, key)} ({unit})", paper, *cells))
    quiet = [[100.0 * float(np.quantile(run.quiet_m, 0.99)) for run in runs if len(run.quiet_m)] for runs in forms]
    for title, cells in (
        ("position, 99 % (cm)", [spread(values) for values in quiet]),
        ("tracked", [percent([run.tracked for run in runs]) for runs in forms]),
        ("found after (s), median, longest", [_median_longest([run.found_s for run in runs]) for runs in forms]),
        ("wrong at the start (s), median, longest", [_median_longest([run.wrong_s for run in runs]) for runs in forms]),
    ):
        rows.append(("", title, NONE, *cells))
    return [(condition.name, *rows[0][1:]), *rows[1:]]


def _median_longest(times_s: Sequence[float]) -> str:
    return f"{np.median(times_s):.1f}, {max(times_s):.1f}" if times_s else NONE


def _figures(runs: Sequence[Run], name: str, key: str) -> tuple[list[float], int]:
    return error_figures([run.errors for run in runs], name, key)


def _tracks_figure(runs: Sequence[Run], names: Sequence[str]) -> Figure:
    """As figure 8: black the way, red the traces of the localization."""
    many = len(runs) > 1
    figure, axes = scenes.new_figure(1 + many, 1 + many, (9.0, 6.6 if many else 6.0), names, field=runs[0].field)
    for each, run in zip(axes, runs, strict=False):
        scenes.way(each, run.track.truth, "black", 1.8, zorder=2)
        scenes.way(each, run.track.poses[run.track.tracking], scenes.RED, 0.8, zorder=3)
    return figure


def calibrated_head(simulation: Simulation) -> tuple[MirrorCalibration, ImageArray]:
    """`calibrate mirror` on rendered images of the strip, seen by the very head of a simulation; the middle image."""
    mount = simulation.head.mount
    tilt, shift = np.degrees([mount.tilt_x, mount.tilt_y]), 1e3 * np.array([mount.shift_x, mount.shift_y])
    changes = [
        "camera.mirror.profile=combined",
        f"camera.mirror.tilt_deg={tilt.tolist()}",
        f"camera.mirror.shift_mm={shift.tolist()}",
    ]
    scenario = open_scenario("calibration-strip", simulation.scenario.seed, changes=changes)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "strip")
        write_recording(Simulation(scenario), path)
        recording = open_source(path)
        calibration = calibrate_mirror(recording, skip_unusable=True)
        image = recording.image(calibration.sightings[0].index)
    assert image is not None
    return calibration, image


def distances_figure() -> Figure:
    """Figure 5: (a) the brighter, the nearer to a line; (b) the lines that robots are localized by."""
    field = open_field(scenes.FIELD)
    found = field.distance_map()
    distances = found.values[..., 0]
    low = np.array(found.origin_m)
    high = low + found.resolution_m * (np.array(distances.shape[::-1]) - 1)
    figure, (axes, lines) = scenes.new_figure(1, 2, (13.0, 4.4), ("(a)", "(b)"), labels=("x (m)", "y (m)"))
    scenes.field_axes(lines, field)
    extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    shown = axes.imshow(distances, cmap="gray_r", vmin=0.0, vmax=2.5, origin="lower", extent=extent)
    figure.colorbar(shown, ax=axes, shrink=0.8, label="distance to the nearest line (m)")
    for each in (axes, lines):
        each.grid(visible=False)
    return figure


def rendered_image(seed: int = 0) -> tuple[Simulation, ImageArray]:
    """What a robot as built sees a second after its start."""
    simulation = Simulation(open_scenario("straight-tracks", seed, 1.5))
    return simulation, simulation.image(10)


def detection_figure(
    simulation: Simulation, image: ImageArray, hidden: Sequence[tuple[str, BoolArray | None]]
) -> Figure:
    """Figures 4 and 7 of Lu, 4 and 6 of Xiong: the image, then its colour classes with the points found.

    hidden: titles, each with the black pixels (H, W), none where nothing is hidden.
    """
    detector = LinePointDetector(simulation.camera, line_width_m=simulation.field.line_width)
    detector.learn([image])
    assert detector.colours is not None
    size_in = (SIDE_IN * (1 + len(hidden)), SIDE_IN + 0.4)
    figure, axes = scenes.image_figure([image] * (1 + len(hidden)), size_in)
    axes[0].set_title("panoramic image", fontsize=10)
    for each, (title, black) in zip(axes[1:], hidden, strict=True):
        seen = image if black is None else np.where(black[..., np.newaxis], np.uint8(0), image)
        classes, points = detector.colours.classify(seen), detector.detect(seen)
        picture = np.full((*classes.shape, 3), OTHER, dtype=np.uint8)
        picture[classes == GREEN] = tuple(int(scenes.CARPET[k : k + 2], 16) for k in (1, 3, 5))
        picture[classes == WHITE] = WHITE_PAINT
        if black is not None:
            picture[black] = INK
        each.images[0].set_data(picture)
        scenes.dots(each, points.pixels, scenes.RED, 4, marker=".")
        each.set_title(f"{title}: {len(points)} points".lstrip(": "), fontsize=10)
    return figure
