"""schulz-imu (figure 3): the learned correction of pixels by roll and pitch."""

import math
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from touchline.camera import GroundView, PinholeCamera, ground_view
from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.published.nimbro_lines.imu import ImuCalibration, calibrate_imu
from touchline.sources import open_source
from touchline.types import ImageArray
from touchline_lab.experiments.harness import ExperimentResult, Headline, follow, seed_range, spread
from touchline_lab.experiments.scenes import BLUE, RED, new_figure
from touchline_lab.simulation.recording import write_recording
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

SCENARIO, SECONDS = "walk-in-place", 20.0
LEANS_DEG = {"Pitch correction": (0.0, 3.0), "Roll correction": (3.0, 0.0), "Pitch+Roll correlated": (3.0, 3.0)}
_SPACING_PX = 40
_MAX_M = 4.0
_NOTES = (
    f"The scenario {SCENARIO}: {SECONDS:g} s of walking in place before four marks, read to 0.15 px, with the "
    "simulated IMU; per seed. Its form here: matrix C of equation (2), as by `touchline calibrate imu --paper`. Ours: "
    "with pitch and roll alone and the third row of the homography that a leaning camera sees the ground through. "
    "Sightings that fit far worse than most are left out of both figures of wandering, which are thus of fewer in its "
    "form than in ours.",
    "Against the geometry: root mean square over the image of what the correction leaves of the true shift (between a "
    f"level camera and one that leans 3°), ground up to {_MAX_M:g} m; in brackets the shift itself. Equation (2) "
    "alone is right about the rows of the marks and less so elsewhere.",
    "The picture is of the first seed: arrows from pixels to where the correction moves them, red for 3°, blue for "
    "-3°.",
)


class _Unlit(Simulation):
    """A run whose images are black: the marks are projected, nobody looks at the images."""

    def image(self, index: int, again: int = 0) -> ImageArray:
        return np.zeros((480, 752, 3), dtype=np.uint8)


class Learned(NamedTuple):
    """What a walk in place taught: all of it, and equation (2) alone; and the camera."""

    calibration: ImuCalibration
    equation_2: ImuCalibration
    camera: PinholeCamera


def schulz_imu(seeds: int) -> ExperimentResult:
    """One walk in place per seed."""
    found = [learned(seed) for seed in follow(seed_range(seeds), "walks in place")]
    forms = [[each.equation_2 for each in found], [each.calibration for each in found]]
    before, after = ([getattr(each, name) for each in forms[1]] for name in ("before_px", "after_px"))
    rows = [
        ("marks wander, uncorrected (px)", "–", *(spread([each.before_px for each in form], 2) for form in forms)),
        ("marks wander, corrected (px)", "–", *(spread([each.after_px for each in form], 2) for form in forms)),
        ("sightings left out of these (%)", "–",
         *(spread([100.0 * each.left_out / len(each.seen_px) for each in form], 1) for form in forms)),
    ]  # fmt: skip
    for name, lean_deg in LEANS_DEG.items():
        cells = []
        for form in forms:
            each = [against_geometry(one.camera, how, *lean_deg) for one, how in zip(found, form, strict=True)]
            left, shift = zip(*each, strict=True)
            cells.append(f"{spread(left, 1)} ({np.mean(shift):.0f})")
        rows.append((f"{name}, against the geometry (px)", "shown", *cells))
    return ExperimentResult(
        "Figure 3 of Schulz and Behnke 2012: the learned mapping from IMU readings to image offsets",
        ("figure", "paper", "its form here", "ours"),
        rows,
        Headline(
            "four marks before a robot that walks in place wander; with the learned correction",
            "shown",
            f"{spread(before, 1)} px; {spread(after, 1)} px",
        ),
        _NOTES,
        (("figure3", _figure(found[0])),),
    )


def learned(seed: int) -> Learned:
    """Walk in place and calibrate."""
    simulation = _Unlit(open_scenario(SCENARIO, seed, SECONDS))
    with tempfile.TemporaryDirectory() as folder:
        write_recording(simulation, Path(folder) / "walk")
        recording = open_source(Path(folder) / "walk")
        camera = recording.camera
        if not isinstance(camera, PinholeCamera):
            raise InputError(f"the scenario {SCENARIO} needs a pinhole camera")
        return Learned(calibrate_imu(recording, camera), calibrate_imu(recording, camera, paper=True), camera)


def _pixels(camera: PinholeCamera, spacing: int) -> FloatArray:
    """(N, 2) evenly spaced undistorted pixels that see ground nearby when the camera is level."""
    u, v = np.meshgrid(
        np.arange(spacing / 2, camera.width, spacing), np.arange(spacing / 2, camera.height, spacing), indexing="xy"
    )
    pixels = np.column_stack((u.ravel(), v.ravel()))
    ground = GroundView(camera).ground_from_image(pixels)
    ranges_m = np.hypot(*np.nan_to_num(ground, nan=np.inf).T)
    near = ranges_m <= _MAX_M
    return camera.undistorted(pixels[near])


def against_geometry(
    camera: PinholeCamera, found: ImuCalibration, roll_deg: float, pitch_deg: float
) -> tuple[float, float]:
    """Root mean squares (px) of what the correction leaves of the true shift, and of that."""
    correction = found.correction
    level = _pixels(camera, _SPACING_PX)
    roll, pitch = math.radians(roll_deg), math.radians(pitch_deg)
    ground = GroundView(camera).ground_from_image(camera.distorted(level))
    leaning = camera.undistorted(ground_view(camera, None, roll, pitch).image_from_ground(ground))
    upright_pitch, upright_roll = correction.reference_rad
    back = correction.level(leaning, roll + upright_roll, pitch + upright_pitch)
    inside = np.isfinite(leaning).all(axis=1)
    left, shift = (back - level)[inside], (leaning - level)[inside]
    return tuple(float(np.sqrt(np.mean(np.sum(d**2, axis=1)))) for d in (left, shift))  # type: ignore[return-value]


def _figure(each: Learned) -> Figure:
    figure, axes = new_figure(1, len(LEANS_DEG), (11.0, 3.0), list(LEANS_DEG))
    for axis, (roll, pitch) in zip(axes, LEANS_DEG.values(), strict=True):
        _draw(axis, each, math.radians(roll), math.radians(pitch))
    return figure


def _draw(axis: Axes, each: Learned, roll: float, pitch: float) -> None:
    camera, correction = each.camera, each.calibration.correction
    pixels = _pixels(camera, 2 * _SPACING_PX)
    upright_pitch, upright_roll = correction.reference_rad
    for sign, tint in ((1.0, RED), (-1.0, BLUE)):
        moved = correction.level(pixels, sign * roll + upright_roll, sign * pitch + upright_pitch) - pixels
        axis.quiver(*pixels.T, *moved.T, angles="xy", scale_units="xy", scale=1.0, color=tint, width=0.004)
    axis.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal")
