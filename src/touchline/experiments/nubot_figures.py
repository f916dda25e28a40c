"""The figures of both NuBot papers without a table: calibration, the map of distances, images with their line points.

Figures 2, 4, 5 (a) and 7 of Lu et al. 2013, figure 6 of Xiong et al.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from touchline.calibration.mirror import MirrorCalibration, calibrate_mirror
from touchline.experiments.scenes import CARPET, FIELD, RED, dots, image_figure, new_figure
from touchline.field import open_field
from touchline.perception import LinePointDetector
from touchline.perception.colour import GREEN, WHITE
from touchline.simulation.recording import write_recording
from touchline.simulation.run import Simulation
from touchline.simulation.scenario import open_scenario
from touchline.sources import open_source
from touchline.types import ImageArray
from touchline.view.calibration import mirror_picture

INK, PAINT, OTHER = (32, 42, 48), (245, 245, 245), (120, 120, 120)
SIDE_IN = 4.0


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


def calibration_figure(calibration: MirrorCalibration, image: ImageArray) -> Figure:
    """Figure 2: the edges found in one image, the distance map, and the image laid out in metres."""
    picture = mirror_picture(calibration, image, calibration.sightings[0])
    return image_figure([picture], (3 * SIDE_IN, SIDE_IN + 0.2))[0]


def distances_figure() -> Figure:
    """Figure 5 (a): the brighter, the nearer to a line."""
    found = open_field(FIELD).distance_map()
    distances = found.values[..., 0]
    low = np.array(found.origin_m)
    high = low + found.resolution_m * (np.array(distances.shape[::-1]) - 1)
    figure, (axes,) = new_figure(size_in=(8.0, 5.2), labels=("x (m)", "y (m)"))
    extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    shown = axes.imshow(distances, cmap="gray_r", vmin=0.0, vmax=2.5, origin="lower", extent=extent)
    figure.colorbar(shown, ax=axes, shrink=0.8, label="distance to the nearest line (m)")
    axes.grid(visible=False)
    return figure


def rendered_image(seed: int = 0) -> tuple[Simulation, ImageArray]:
    """What a robot as built sees a second after its start."""
    simulation = Simulation(open_scenario("straight-tracks", seed, 1.5))
    return simulation, simulation.image(10)


def detection_figure(
    simulation: Simulation, image: ImageArray, hidden: Sequence[tuple[str, npt.NDArray[np.bool_] | None]]
) -> Figure:
    """Figures 4 and 7 of Lu, 4 and 6 of Xiong: the image, then its colour classes with the points found.

    hidden: titles, each with the black pixels (H, W), none where nothing is hidden.
    """
    detector = LinePointDetector(simulation.camera, line_width_m=simulation.field.line_width)
    detector.learn([image])
    assert detector.colours is not None
    size_in = (SIDE_IN * (1 + len(hidden)), SIDE_IN + 0.4)
    figure, axes = image_figure([image] * (1 + len(hidden)), size_in)
    axes[0].set_title("panoramic image", fontsize=10)
    for each, (title, black) in zip(axes[1:], hidden, strict=True):
        seen = image if black is None else np.where(black[..., np.newaxis], np.uint8(0), image)
        classes, points = detector.colours.classify(seen), detector.detect(seen)
        picture = np.full((*classes.shape, 3), OTHER, dtype=np.uint8)
        picture[classes == GREEN] = tuple(int(CARPET[k : k + 2], 16) for k in (1, 3, 5))
        picture[classes == WHITE] = PAINT
        if black is not None:
            picture[black] = INK
        each.images[0].set_data(picture)
        dots(each, points.pixels, RED, 4, marker=".")
        each.set_title(f"{title}: {len(points)} points".lstrip(": "), fontsize=10)
    return figure
