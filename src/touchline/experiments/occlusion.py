"""lu2013-occlusion (Table 1, figure 8) and xiong-tracking (Table 1): straight tracks, with parts of the view hidden."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from touchline.camera import Camera, require_omni
from touchline.config import Settings
from touchline.evaluation.metrics import ErrorTable, error_table
from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, interval, spread
from touchline.experiments.scenes import RED, field_axes, new_figure, public_recording
from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.localization.particles.nubot_particles import PAPER_FORM as PAPER_PARTICLES
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.systems import RobotSetup, open_system
from touchline.systems.nubot_mcl_alone import NubotMclAloneSettings
from touchline.types import ImageArray, Samples, Status

Sectors = tuple[tuple[float, float], ...]
PaperRow = tuple[float, float, float]

ALONE = "nubot-mcl-alone"


@dataclass(frozen=True, slots=True)
class Condition:
    """A row of Table 1: its name, the black sectors (degrees, base frame), the paper's mean, deviation, maximum.

    Each of the paper's figures: x (cm), y (cm), heading (rad). settings: of the system, none for the defaults. changes:
    of the scenario, for what is otherwise than on a robot as built.
    """

    name: str
    sectors: Sectors
    paper: tuple[PaperRow, PaperRow, PaperRow] | None
    system: str = "nubot-mcl"
    settings: Settings | None = None
    changes: tuple[str, ...] = ()


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
# Equations (1) to (3) of the paper with nothing added: told in a note.
PAPER_FORM = tuple(replace(c, settings=NubotMclAloneSettings(particles=PAPER_PARTICLES)) for c in CONDITIONS[5:])
_RANGE_SPREAD = "camera.mirror.range_spread=0.01"
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
RECORDING = "omni_msl_track"
COLUMNS = (
    "hidden", "figure", "x paper", "x (cm)", "y paper", "y (cm)", "θ paper", "θ (rad)", "position (cm)",
    "ideal: position (cm)", "ideal: θ (rad)",
)  # fmt: skip
FROM_S = 5.0  # errors count from here on
AFTER_SHOVE_S = 1.15  # what lies within a second after a shove, which takes 0.15 s


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """One run: its errors, where the robot was believed (N, 3) and truly was (N, 3), and the field.

    quiet_m: position errors (M,) of the tracked frames but those within a second after a shove.
    """

    errors: ErrorTable
    quiet_m: FloatArray
    path: FloatArray
    truth: FloatArray
    field: FieldModel


_SIMULATED = (
    "The scenario straight-tracks at the observation level, 60 s at 10 Hz, each robot as built and drawn anew "
    "from its seed, camera.yaml from calibrate mirror where nothing else is said; beside it the same seeds' ideal "
    f"robots. Errors from {FROM_S:g} s on; 99 %: of tracked frames outside the first second after a shove. Brackets: "
    "where the mean over robots lies with 95 %, by bootstrap. "
    "One black sector of 45 degrees, two opposite, four alternating; a half in one piece."
)
_ALONE = (
    "MCL alone: the mean of the particles is the pose in every image (nubot-mcl-alone, all else as nubot-mcl has it). "
    "The likelihood has an end, at 3.3 σ, and σ falls from 0.3 to 0.1 m once the particles have converged."
)
_RECORDED = (
    f"Recorded: the {RECORDING} images with black sectors laid over them, at the same angles in the image; its seeds "
    "are those of the particles."
)
_NOT_FOUND = f"The recording {RECORDING} was not found; TOUCHLINE_DATA names the folder of the recordings."


def lu2013_occlusion(seeds: int) -> ExperimentResult:
    """Table 1: nubot-mcl on five straight tracks with black sectors fixed in the view."""
    every = (*CONDITIONS, *OTHER_ROBOTS)
    drives: dict[str, list[Drive]] = {c.name: [] for c in every}
    ideal: dict[str, list[Drive]] = {c.name: [] for c in CONDITIONS}
    for c, seed in follow([(c, seed) for c in every for seed in range(seeds)], "drives"):
        drives[c.name].append(drive(c, seed))
        if c.name in ideal:
            ideal[c.name].append(drive(c, seed, ideal=True))
    as_printed = [[drive(c, seed).errors for seed in range(seeds)] for c in PAPER_FORM]
    rows = [row for c in every for row in _rows(c, drives[c.name], ideal.get(c.name, []))]
    recorded = _recorded(seeds)
    rows += [row for c, errors in recorded for row in _rows(c, errors, [])]
    notes = [_SIMULATED, _ALONE, _paper_form(as_printed), _RECORDED if recorded else _NOT_FOUND]
    return ExperimentResult(
        "lu2013-occlusion",
        "Table 1 of Lu et al. 2013: errors with 0 to 50 % of the view hidden",
        seeds,
        COLUMNS,
        tuple(rows),
        Headline("mean errors with 0 to 50 % hidden", "5.7-7.8 cm in x and y, 0.044-0.064 rad",
                 f"{_range_of(drives)}; ideal {_range_of(ideal)}"),
        tuple(notes),
        (("tracks", _tracks_figure([drives[c.name][0] for c in CONDITIONS[:4]], [c.name for c in CONDITIONS[:4]])),),
    )  # fmt: skip


def _range_of(drives: dict[str, list[Drive]]) -> str:
    """Least and largest mean errors of the paper's four conditions."""
    means = [100.0 * float(np.mean([d.errors.position.mean for d in drives[c.name]])) for c in CONDITIONS[:4]]
    turns = [float(np.mean([d.errors.heading.mean for d in drives[c.name]])) for c in CONDITIONS[:4]]
    return f"{min(means):.2f}-{max(means):.2f} cm away, {min(turns):.4f}-{max(turns):.4f} rad"


def xiong_tracking(seeds: int) -> ExperimentResult:
    """Table 1: nubot-mti on five straight tracks."""
    condition = Condition("free", (), _FREE_PAPER, "nubot-mti")
    design = replace(OTHER_ROBOTS[0], system="nubot-mti")
    drives, ideal, designed = [], [], []
    for seed in follow(range(seeds), "drives"):
        drives.append(drive(condition, seed))
        ideal.append(drive(condition, seed, ideal=True))
        designed.append(drive(design, seed))
    position, at_best = ([100 * d.errors.position.mean for d in each] for each in (drives, ideal))
    heading = [d.errors.heading.mean for d in drives]
    return ExperimentResult(
        "xiong-tracking",
        "Table 1 of Xiong et al.: errors along straight lines",
        seeds,
        COLUMNS,
        (*_rows(condition, drives, ideal), *_rows(design, designed, [])),
        Headline("mean errors along straight lines", "5.9 cm in x, 6.0 cm in y, 0.044 rad",
                 f"{interval(position)} cm in position, {interval(heading, 4)} rad; ideal {interval(at_best)} cm"),
        (_SIMULATED.partition(" One black sector")[0],),
        (("tracks", _tracks_figure(drives[:1], ["nubot-mti"])),),
    )  # fmt: skip


def _paper_form(errors: Sequence[Sequence[ErrorTable]]) -> str:
    """What equations (1) to (3) bring as they stand: of each condition the seeds' errors."""
    means = [spread([100.0 * e.position.mean for e in each]) for each in errors]
    return (
        "Equations (1) to (3) as they stand, with one σ and no refined particles, are off by "
        + ", ".join(f"{mean} cm ({c.name})" for mean, c in zip(means, PAPER_FORM, strict=True))
        + ": with the square of every distance, the points on a goal's posts and net outweigh the lines."
    )


def drive(condition: Condition, seed: int, ideal: bool = False) -> Drive:
    """A robot of this seed, as built or ideal, along the tracks under a condition."""
    scenario = open_scenario("straight-tracks", seed, changes=["ideal=true"] if ideal else condition.changes)
    camera = scenario.camera.model_copy(update={"black_sectors_deg": condition.sectors})
    simulation = Simulation(scenario.model_copy(update={"camera": camera}), level="points")
    setup = RobotSetup(simulation.field, wheel_directions_rad=simulation.wheel_directions_rad)
    system = open_system(condition.system, setup, condition.settings, np.random.default_rng(seed))
    estimates = [system.step(frame) for frame in simulation]
    path = np.array([estimate.pose for estimate in estimates])
    truth = simulation.truth
    poses, times_s = np.asarray(truth.poses), 1e-9 * simulation.image_stamps
    located = np.array([estimate.status is Status.TRACKING for estimate in estimates])
    counted = located & (times_s >= FROM_S)
    errors = error_table(
        Samples(simulation.image_stamps, path), Samples(truth.stamp_ns, poses), located=counted
    )  # fmt: skip
    shoves = np.array([event["t"] for event in simulation.track.events if event["kind"] == "slip"])
    since = times_s[:, np.newaxis] - shoves
    quiet = counted & ~((since >= 0.0) & (since < AFTER_SHOVE_S)).any(axis=1)
    quiet_m = np.hypot(*(path[quiet, :2] - poses[quiet, :2]).T)
    return Drive(errors, quiet_m, path[located], poses, simulation.field)


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
        system = open_system(condition.system, setup, condition.settings, rng)
        hidden = black_pixels(recording.camera, condition.sectors)
        estimates = [system.step(replace(frame, image=_blackened(frame.image, hidden))) for frame in recording]
        located = np.array([estimate.status is Status.TRACKING for estimate in estimates])
        path, poses = np.array([estimate.pose for estimate in estimates]), np.asarray(truth.poses)
        errors = error_table(Samples(recording.image_stamps, path), Samples(truth.stamp_ns, poses), located=located)
        drives.append(Drive(errors, np.zeros(0), path[located], poses, recording.field))
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


def _rows(condition: Condition, drives: Sequence[Drive], ideal: Sequence[Drive]) -> list[tuple[str, ...]]:
    """Mean, standard deviation and maximum, as the paper has them, and what 99 % of the quiet frames stay below."""
    rows: list[tuple[str, ...]] = []
    for k, (title, key) in enumerate((("mean", "mean"), ("std", "std_signed"), ("max", "max"))):
        paper = ("–", "–", "–") if condition.paper is None else tuple(f"{value:g}" for value in condition.paper[k])
        x, y, heading, position = (
            (interval if key == "mean" else spread)(_figures(drives, name, key), 4 if name == "heading" else 2)
            for name in ("x", "y", "heading", "position")
        )
        beside = spread(_figures(ideal, "position", key)), spread(_figures(ideal, "heading", key), 4)
        hidden = condition.name if k == 0 else ""
        rows.append((hidden, title, paper[0], x, paper[1], y, paper[2], heading, position, *beside))
    if all(len(each.quiet_m) for each in drives):
        late, best = (spread([100.0 * float(np.quantile(d.quiet_m, 0.99)) for d in some]) for some in (drives, ideal))
        rows.append(("", "99 %", *["–"] * 6, late, best, "–"))
    return rows


def _figures(drives: Sequence[Drive], name: str, key: str) -> list[float]:
    """One figure of the error tables, in cm or rad, of each drive."""
    scale = 1.0 if name == "heading" else 100.0
    return [scale * float(getattr(getattr(each.errors, name), key)) for each in drives]


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
