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
from touchline.experiments.result import ExperimentResult, Headline, spread
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

    Each of the paper's figures: x (cm), y (cm), heading (rad). settings: of the system, none for the defaults.
    """

    name: str
    sectors: Sectors
    paper: tuple[PaperRow, PaperRow, PaperRow] | None
    system: str = "nubot-mcl"
    settings: Settings | None = None


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
RECORDING = "omni_msl_track"
COLUMNS = ("hidden", "figure", "x paper", "x (cm)", "y paper", "y (cm)", "θ paper", "θ (rad)", "position (cm)")


@dataclass(frozen=True, eq=False, slots=True)
class Drive:
    """One run: its errors, where the robot was believed (N, 3) and truly was (N, 3), and the field."""

    errors: ErrorTable
    path: FloatArray
    truth: FloatArray
    field: FieldModel


_SIMULATED = (
    "The scenario straight-tracks at the observation level, 60 s at 10 Hz per seed; errors from the first tracked "
    "frame on. One black sector of 45 degrees, two opposite, four alternating; a half in one piece."
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
    drives: dict[str, list[Drive]] = {c.name: [] for c in CONDITIONS}
    for c, seed in follow([(c, seed) for c in CONDITIONS for seed in range(seeds)], "drives"):
        drives[c.name].append(_drive(c, seed))
    as_printed = [[_drive(c, seed).errors for seed in range(seeds)] for c in PAPER_FORM]
    rows = [row for c in CONDITIONS for row in _rows(c, [d.errors for d in drives[c.name]])]
    recorded = _recorded(seeds)
    rows += [row for c, errors in recorded for row in _rows(c, errors)]
    notes = [_SIMULATED, _ALONE, _paper_form(as_printed), _RECORDED if recorded else _NOT_FOUND]
    means = [float(np.mean([d.errors.position.mean for d in drives[c.name]])) for c in CONDITIONS[:4]]
    turns = [float(np.mean([d.errors.heading.mean for d in drives[c.name]])) for c in CONDITIONS[:4]]
    return ExperimentResult(
        "lu2013-occlusion",
        "Table 1 of Lu et al. 2013: errors with 0 to 50 % of the view hidden",
        seeds,
        COLUMNS,
        tuple(rows),
        Headline("mean errors with 0 to 50 % hidden", "5.7-7.8 cm in x and y, 0.044-0.064 rad",
                 f"{100 * min(means):.2f}-{100 * max(means):.2f} cm away, {min(turns):.4f}-{max(turns):.4f} rad"),
        tuple(notes),
        (("tracks", _tracks_figure([drives[c.name][0] for c in CONDITIONS[:4]], [c.name for c in CONDITIONS[:4]])),),
    )  # fmt: skip


def xiong_tracking(seeds: int) -> ExperimentResult:
    """Table 1: nubot-mti on five straight tracks."""
    paper = ((5.907, 5.967, 0.044), (7.334, 7.117, 0.0516), (30.724, 35.595, 0.286))
    condition = Condition("free", (), paper, "nubot-mti")
    drives = [_drive(condition, seed) for seed in follow(range(seeds), "drives")]
    position = [100 * d.errors.position.mean for d in drives]
    heading = [d.errors.heading.mean for d in drives]
    return ExperimentResult(
        "xiong-tracking",
        "Table 1 of Xiong et al.: errors along straight lines",
        seeds,
        COLUMNS,
        tuple(_rows(condition, [d.errors for d in drives])),
        Headline("mean errors along straight lines", "5.9 cm in x, 6.0 cm in y, 0.044 rad",
                 f"{spread(position)} cm in position, {spread(heading, 4)} rad"),
        ("The scenario straight-tracks at the observation level, 60 s at 10 Hz per seed.",),
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


def _drive(condition: Condition, seed: int) -> Drive:
    scenario = open_scenario("straight-tracks", seed, changes=["ideal=true"])
    camera = scenario.camera.model_copy(update={"black_sectors_deg": condition.sectors})
    simulation = Simulation(scenario.model_copy(update={"camera": camera}), level="points")
    setup = RobotSetup(simulation.field, wheel_directions_rad=simulation.wheel_directions_rad)
    system = open_system(condition.system, setup, condition.settings, np.random.default_rng(seed))
    estimates = [system.step(frame) for frame in simulation]
    path = np.array([estimate.pose for estimate in estimates])
    truth = simulation.truth
    located = np.array([estimate.status is Status.TRACKING for estimate in estimates])
    errors = error_table(
        Samples(simulation.image_stamps, path), Samples(truth.stamp_ns, np.asarray(truth.poses)), located=located
    )
    return Drive(errors, path[located], np.asarray(truth.poses), simulation.field)


def _recorded(seeds: int) -> list[tuple[Condition, list[ErrorTable]]]:
    """The same conditions over the images of a recording, those of MCL alone once; empty where it isn't found."""
    recording = public_recording(RECORDING)
    if recording is None:
        return []
    truth = recording.truth
    assert truth is not None, f"{RECORDING} holds its truth"
    chosen = [replace(c, name=f"recorded, {c.name}", paper=None) for c in CONDITIONS]
    found: list[tuple[Condition, list[ErrorTable]]] = [(c, []) for c in chosen]
    for (condition, errors), seed in follow([(f, seed) for f in found for seed in range(seeds)], "recorded drives"):
        rng, setup = np.random.default_rng(seed), RobotSetup(recording.field, recording.camera)
        system = open_system(condition.system, setup, condition.settings, rng)
        hidden = black_pixels(recording.camera, condition.sectors)
        estimates = [system.step(replace(frame, image=_blackened(frame.image, hidden))) for frame in recording]
        located = np.array([estimate.status is Status.TRACKING for estimate in estimates])
        path = Samples(recording.image_stamps, np.array([estimate.pose for estimate in estimates]))
        errors.append(error_table(path, Samples(truth.stamp_ns, np.asarray(truth.poses)), located=located))
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


def _rows(condition: Condition, errors: Sequence[ErrorTable]) -> list[tuple[str, ...]]:
    """Mean, standard deviation and maximum, as the paper has them."""
    rows: list[tuple[str, ...]] = []
    for k, (title, key) in enumerate((("mean", "mean"), ("std", "std_signed"), ("max", "max"))):
        paper = ("–", "–", "–") if condition.paper is None else tuple(f"{value:g}" for value in condition.paper[k])
        ours = [
            spread([scale * getattr(getattr(e, name), key) for e in errors], decimals)
            for name, scale, decimals in (("x", 100, 2), ("y", 100, 2), ("heading", 1, 4), ("position", 100, 2))
        ]
        hidden = condition.name if k == 0 else ""
        rows.append((hidden, title, paper[0], ours[0], paper[1], ours[1], paper[2], ours[2], ours[3]))
    return rows


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
