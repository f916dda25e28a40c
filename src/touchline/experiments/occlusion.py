"""lu2013-occlusion (Table 1, figure 8) and xiong-tracking (Table 1): straight tracks, with parts of the view hidden."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from touchline.camera import Camera, require_omni
from touchline.evaluation.metrics import ErrorTable, NothingToCompareError, error_table
from touchline.experiments.nubot_figures import (
    calibrated_head,
    calibration_figure,
    detection_figure,
    distances_figure,
    rendered_image,
)
from touchline.experiments.progress import computed, follow
from touchline.experiments.result import ExperimentResult, Headline, interval, percent, spread
from touchline.experiments.scenes import RED, field_axes, new_figure, public_recording
from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.simulation.run import Eyes, Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import RobotSetup, open_system, paper_settings
from touchline.types import Frame, ImageArray, Samples, Status

Sectors = tuple[tuple[float, float], ...]
PaperRow = tuple[float, float, float]

ALONE = "nubot-mcl-alone"


@dataclass(frozen=True, slots=True)
class Condition:
    """A row of Table 1: its name, the black sectors (degrees, base frame), the paper's mean, deviation, maximum.

    Each of the paper's figures: x (cm), y (cm), heading (rad). changes: of the scenario, for what is otherwise than on
    a robot as built. odometry: whether the system is told of it. calibrated: whether camera.yaml comes from rendered
    images of the strip (figure 2), not from simulated edges.
    """

    name: str
    sectors: Sectors
    paper: tuple[PaperRow, PaperRow, PaperRow] | None
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
    Condition("50 % in one half", _HALF, None),
    Condition("free, MCL alone", (), None, ALONE),
    Condition("50 %, MCL alone", _FOUR, None, ALONE),
)
_RANGE_SPREAD = "camera.mirror.range_spread=0.01"
STRIP = Condition("free, of calibrate mirror on images", (), None, calibrated=True)
OTHER_ROBOTS = (
    Condition("free, of the design, ranges 1 %", (), None, changes=("camera.known_from=design", _RANGE_SPREAD)),
    Condition(
        "free, of calibrate range, ranges 1 %", (), None, changes=("camera.known_from=calibrate-range", _RANGE_SPREAD)
    ),
    Condition("free, vibration of 0.3°", (), None, changes=("camera.mirror.vibration_deg=0.3",)),
    Condition("free, no delay", (), None, changes=("camera.delay_s=0",)),
    Condition("free, 100 ms late", (), None, changes=("camera.delay_s=0.1",)),
    Condition(
        "free, 100 ms late, stamped on arrival", (), None, changes=("camera.delay_s=0.1", "camera.stamped=arrived")
    ),
)  # fmt: skip
PLAY = (
    Condition("match", (), None, "nubot-mti", scenario="match"),
    Condition("match, without odometry", (), None, "nubot-mti", scenario="match", odometry=False),
)
RECORDING = "omni_msl_track"
RECORDED_SEEDS = 2  # of the particles, whose chance changes little there
COLUMNS = (
    "hidden", "figure",
    "x paper", "x its form here", "x (cm)", "y paper", "y its form here", "y (cm)",
    "θ paper", "θ its form here", "θ (rad)", "position its form here (cm)", "position (cm)",
    "ideal: position (cm)", "ideal: θ (rad)",
)  # fmt: skip
FROM_S = 5.0  # errors count from here on
AFTER_SHOVE_S = 1.15  # what lies within a second after a shove, which takes 0.15 s


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """One run: its errors, where the robot was believed (N, 3) and truly was (N, 3), and the field.

    errors: None where nothing was tracked. quiet_m: position errors (M,) of the tracked frames but those within a
    second after a shove. tracked: share of the frames that count.
    """

    errors: ErrorTable | None
    quiet_m: FloatArray
    tracked: float
    path: FloatArray
    truth: FloatArray
    field: FieldModel


_SIMULATED = (
    "The scenario straight-tracks at the observation level, 60 s at 10 Hz, each robot as built and drawn anew "
    "from its seed, camera.yaml from calibrate mirror where nothing else is said; beside it the same seeds' ideal "
    f"robots. Errors from {FROM_S:g} s on; 99 %: of tracked frames outside the first second after a shove. Brackets: "
    "where the mean over robots lies with 95 %, by bootstrap. Its form here: the same robots as built with the "
    "system's preset `paper`, exactly what the paper says. "
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
    f"{RECORDED_SEEDS} seeds, those of the particles."
)
_NOT_FOUND = f"The recording {RECORDING} was not found; TOUCHLINE_DATA names the folder of the recordings."
Drives = dict[str, list[Drive]]


def lu2013_occlusion(seeds: int) -> ExperimentResult:
    """Table 1: nubot-mcl on five straight tracks with black sectors fixed in the view."""
    every = (*CONDITIONS, STRIP, *OTHER_ROBOTS)
    ours, paper, ideal = _all_drives(every, CONDITIONS, seeds)
    rows = [row for c in every for row in _rows(c, ours[c.name], paper[c.name], ideal[c.name])]
    recorded = _recorded(min(seeds, RECORDED_SEEDS))
    rows += [row for c, errors in recorded for row in _rows(c, errors, [], [])]
    return ExperimentResult(
        "lu2013-occlusion",
        "Table 1 of Lu et al. 2013: errors with 0 to 50 % of the view hidden",
        seeds,
        COLUMNS,
        tuple(rows),
        Headline("mean errors with 0 to 50 % hidden", "5.7-7.8 cm in x and y, 0.044-0.064 rad",
                 f"{_range_of(ours)}; its form {_range_of(paper)}; ideal {_range_of(ideal)}"),
        (_SIMULATED, _STRIP, _ALONE, _RECORDED if recorded else _NOT_FOUND),
        (
            ("figure2", calibration_figure(*calibrated_head(_driven(CONDITIONS[0], 0, False)[0]))),
            ("figures-4-7", _pictures_figure()),
            ("figure5", distances_figure()),
            ("tracks", _tracks_figure([ours[c.name][0] for c in CONDITIONS[:4]], [c.name for c in CONDITIONS[:4]])),
        ),
    )  # fmt: skip


def _pictures_figure() -> Figure:
    """Figures 4 and 7: an image and the points found in it, free and with its black sectors."""
    simulation, image = rendered_image()
    shown = [("free", None), *((c.name, black_pixels(simulation.camera, c.sectors)) for c in CONDITIONS[1:4])]
    return detection_figure(simulation, image, shown)


def _all_drives(every: Sequence[Condition], shown: Sequence[Condition], seeds: int) -> tuple[Drives, Drives, Drives]:
    """By condition the seeds' drives: ours, and of those shown beside them the paper's form and ideal robots."""
    ours: Drives = {c.name: [] for c in every}
    paper: Drives = {c.name: [] for c in every}
    ideal: Drives = {c.name: [] for c in every}
    tasks = [(c, seed, c in shown) for c in every for seed in range(seeds)]
    for (c, *_), (first, *others) in zip(tasks, computed(_drives_of, tasks, "drives"), strict=True):
        ours[c.name].append(first)
        for beside, one in zip((paper, ideal), others, strict=False):
            beside[c.name].append(one)
    return ours, paper, ideal


def _drives_of(task: tuple[Condition, int, bool]) -> list[Drive]:
    """Ours, and where it is shown beside it the paper's form and the ideal robot."""
    condition, seed, shown = task
    beside = [drive(condition, seed, paper=True), drive(condition, seed, ideal=True)] if shown else []
    return [drive(condition, seed), *beside]


def _range_of(drives: Drives) -> str:
    """Least and largest mean errors of the paper's four conditions."""
    means = [float(np.mean(_figures(drives[c.name], "position", "mean"))) for c in CONDITIONS[:4]]
    turns = [float(np.mean(_figures(drives[c.name], "heading", "mean"))) for c in CONDITIONS[:4]]
    return f"{min(means):.2f}-{max(means):.2f} cm away, {min(turns):.4f}-{max(turns):.4f} rad"


def xiong_tracking(seeds: int) -> ExperimentResult:
    """Table 1: nubot-mti on five straight tracks; other robots; in a match, with and without odometry."""
    free = Condition("free", (), _FREE_PAPER, "nubot-mti")
    others = [replace(c, system="nubot-mti") for c in OTHER_ROBOTS]
    every, shown = (free, *others, *PLAY), (free, *PLAY)
    ours, paper, ideal = _all_drives(every, shown, seeds)
    position, printed, at_best = (_figures(each["free"], "position", "mean") for each in (ours, paper, ideal))
    heading = _figures(ours["free"], "heading", "mean")
    return ExperimentResult(
        "xiong-tracking",
        "Table 1 of Xiong et al.: errors along straight lines",
        seeds,
        COLUMNS,
        tuple(row for c in every for row in _rows(c, ours[c.name], paper[c.name], ideal[c.name])),
        Headline("mean errors along straight lines", "5.9 cm in x, 6.0 cm in y, 0.044 rad",
                 f"{interval(position)} cm in position, {interval(heading, 4)} rad; its form {interval(printed)} cm; "
                 f"ideal {interval(at_best)} cm"),
        (
            _SIMULATED.partition(" One black sector")[0],
            "Match: the scenario match, 3 m/s among eight robots that shove; the same frames once with odometry and "
            "once without.",
        ),
        (
            ("figure6", detection_figure(*rendered_image(1), [("", None)])),
            ("tracks", _tracks_figure(ours["free"][:1], ["nubot-mti"])),
        ),
    )  # fmt: skip


@lru_cache(maxsize=2)
def _driven(c: Condition, seed: int, ideal: bool) -> tuple[Simulation, Camera, tuple[Frame, ...]]:
    """A run, the camera that its camera.yaml tells and its frames, kept for the next system that takes them."""
    scenario = open_scenario(c.scenario, seed, changes=["ideal=true"] if ideal else c.changes)
    hidden = scenario.camera.model_copy(update={"black_sectors_deg": c.sectors})
    chosen = scenario.model_copy(update={"camera": hidden})
    simulation = Simulation(chosen, level="points")
    camera: Camera = simulation.camera
    if c.calibrated:
        camera = calibrated_head(simulation)[0].camera
        simulation = Simulation(chosen, level="points", eyes=Eyes(known=camera))
    return simulation, camera, tuple(simulation)


def drive(condition: Condition, seed: int, ideal: bool = False, paper: bool = False) -> Drive:
    """A robot of this seed, as built or ideal, along the tracks under a condition; paper: by the paper's own form."""
    simulation, camera, frames = _driven(condition, seed, ideal)
    setup = RobotSetup(simulation.field, camera, simulation.wheel_directions_rad)
    settings = paper_settings(condition.system) if paper else None
    system = open_system(condition.system, setup, settings, np.random.default_rng(seed))
    told = frames if condition.odometry else [replace(frame, odometry=None) for frame in frames]
    estimates = [system.step(frame) for frame in told]
    path = np.array([estimate.pose for estimate in estimates])
    truth = simulation.truth
    poses, times_s = np.asarray(truth.poses), 1e-9 * simulation.image_stamps
    located = np.array([estimate.status is Status.TRACKING for estimate in estimates])
    counted = located & (times_s >= FROM_S)
    try:
        errors = error_table(Samples(simulation.image_stamps, path), Samples(truth.stamp_ns, poses), located=counted)
    except NothingToCompareError:
        errors = None
    shoves = np.array([event["t"] for event in simulation.track.events if event["kind"] == "slip"])
    since = times_s[:, np.newaxis] - shoves
    quiet = counted & ~((since >= 0.0) & (since < AFTER_SHOVE_S)).any(axis=1)
    quiet_m = np.hypot(*(path[quiet, :2] - poses[quiet, :2]).T)
    tracked = float(np.mean(located[times_s >= FROM_S]))
    return Drive(errors, quiet_m, tracked, path[located], poses, simulation.field)


def _recorded(seeds: int) -> list[tuple[Condition, list[Drive]]]:
    """The same conditions over the images of a recording, those of MCL alone once; empty where it isn't found."""
    recording = public_recording(RECORDING)
    if recording is None:
        return []
    truth = recording.truth
    assert truth is not None, f"{RECORDING} holds its truth"
    chosen = [replace(c, name=f"recorded, {c.name}", paper=None) for c in CONDITIONS]
    found: list[tuple[Condition, list[Drive]]] = [(c, []) for c in chosen]
    for (condition, drives), seed in follow([(f, seed) for f in found for seed in range(seeds)], "recorded drives"):
        rng, setup = np.random.default_rng(seed), RobotSetup(recording.field, recording.camera)
        system = open_system(condition.system, setup, rng=rng)
        hidden = black_pixels(recording.camera, condition.sectors)
        estimates = [system.step(replace(frame, image=_blackened(frame.image, hidden))) for frame in recording]
        located = np.array([estimate.status is Status.TRACKING for estimate in estimates])
        path, poses = np.array([estimate.pose for estimate in estimates]), np.asarray(truth.poses)
        errors = error_table(Samples(recording.image_stamps, path), Samples(truth.stamp_ns, poses), located=located)
        drives.append(Drive(errors, np.zeros(0), float(np.mean(located)), path[located], poses, recording.field))
    return found


def black_pixels(camera: Camera, sectors: Sectors) -> npt.NDArray[np.bool_]:
    """(H, W): the pixels of sectors given in degrees about the image's centre."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    u0, v0 = require_omni(camera, "sectors about the middle are blackened in images of").center
    angle = np.degrees(np.arctan2(v - v0, u - u0)) % 360.0
    hidden = np.zeros(angle.shape, dtype=np.bool_)
    for low, high in sectors:
        hidden |= (angle >= low) & (angle < high)
    return hidden


def _blackened(image: ImageArray | None, hidden: npt.NDArray[np.bool_]) -> ImageArray | None:
    return None if image is None else np.where(hidden[..., np.newaxis], np.uint8(0), image)


def _rows(
    condition: Condition, drives: Sequence[Drive], paper: Sequence[Drive], ideal: Sequence[Drive]
) -> list[tuple[str, ...]]:
    """Mean, deviation and maximum, as the paper has them, what 99 % of quiet frames stay below, share tracked."""
    rows: list[tuple[str, ...]] = []
    for k, (title, key) in enumerate((("mean", "mean"), ("std", "std_signed"), ("max", "max"))):
        cells = []
        told = ("–", "–", "–") if condition.paper is None else tuple(f"{value:g}" for value in condition.paper[k])
        for name, paper_says in zip(("x", "y", "heading", "position"), (*told, None), strict=True):
            said = interval if key == "mean" else spread
            here = [said(_figures(some, name, key), 4 if name == "heading" else 2) for some in (paper, drives)]
            cells += here if paper_says is None else [paper_says, *here]
        beside = spread(_figures(ideal, "position", key)), spread(_figures(ideal, "heading", key), 4)
        rows.append((condition.name if k == 0 else "", title, *cells, *beside))
    dashes = ["–"] * 9
    if all(len(each.quiet_m) for each in drives):
        quiet = [[100.0 * float(np.quantile(d.quiet_m, 0.99)) for d in some if len(d.quiet_m)]
                 for some in (paper, drives, ideal)]  # fmt: skip
        rows.append(("", "99 %", *dashes, *map(spread, quiet), "–"))
    shares = [percent([d.tracked for d in some]) for some in (paper, drives, ideal)]
    rows.append(("", "tracked", *dashes, *shares, "–"))
    return rows


def _figures(drives: Sequence[Drive], name: str, key: str) -> list[float]:
    """One figure of the error tables, in cm or rad, of each drive."""
    scale = 1.0 if name == "heading" else 100.0
    tables = [each.errors for each in drives if each.errors is not None]
    return [scale * float(getattr(getattr(errors, name), key)) for errors in tables]


def _tracks_figure(drives: Sequence[Drive], names: Sequence[str]) -> Figure:
    """As figure 8: black the way, red the traces of the localization."""
    grid = (2, 2) if len(drives) > 1 else (1, 1)
    figure, axes = new_figure(*grid, width_in=9.0, height_in=6.6 if len(drives) > 1 else 6.0)
    for each, drive, name in zip(axes, drives, names, strict=False):
        field_axes(each, drive.field)
        each.plot(drive.truth[:, 0], drive.truth[:, 1], color="black", linewidth=1.8, zorder=2)
        each.plot(drive.path[:, 0], drive.path[:, 1], color=RED, linewidth=0.8, zorder=3)
        each.set_title(name, fontsize=10)
    return figure
