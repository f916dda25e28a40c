"""What a calibration recording says beside its images: bearings, the rough centre, and where the ground begins."""

from collections.abc import Sequence

import numpy as np

from touchline.errors import InputError, TouchlineError
from touchline.files.yaml_text import read_yaml_mapping
from touchline.geometry import FloatArray
from touchline.perception.colour import GREEN, colour_model, learn_carpet, pixel_noise
from touchline.sources import ProblemLog, Recording
from touchline.sources.description import finite_number
from touchline.sources.tables import open_table, parse_row, read_lines, to_stamps

USUAL_GAMMA = 2.2
_GROUND_SHARE = 0.85  # of the directions: rods hide the rest
_CARPET_IMAGES = 6


def read_bearings(recording: Recording) -> list[tuple[str, float]]:
    """File and bearing (rad) of every image of the recording, in its order. InputError for a row without one."""
    path = recording.folder / "images.csv"
    table = open_table(path, ["t", "file", "bearing_rad"])
    log = ProblemLog()
    of_stamp: dict[int, tuple[str, float]] = {}
    for lines in read_lines(table):
        for line in lines:
            row = parse_row(table, line, ["t", "bearing_rad"], log)
            if row is None:
                raise InputError(
                    f"{path}, line {line.number}: needs the time and 'bearing_rad' of the strip as numbers"
                )
            name = line.text.split(",")[table.columns["file"]].strip().strip('"')
            of_stamp.setdefault(int(to_stamps(np.array(row[:1]))[0]), (name, row[1]))
    return [of_stamp[int(stamp)] for stamp in recording.image_stamps]


def rough_center(recording: Recording) -> FloatArray:
    """The centre (2,) u, v that camera.yaml names; the image's middle where it names none."""
    tree = {} if recording.camera_file is None else read_yaml_mapping(recording.camera_file)
    if recording.camera_kind != "omni":
        raise InputError(f"{recording.path}: has a {recording.camera_kind} camera; a mirror is calibrated here")
    center = tree.get("center")
    if center is not None:
        numbers = [finite_number(value) for value in center] if isinstance(center, list) else []
        if len(numbers) != 2 or None in numbers:
            raise InputError(f"{recording.camera_file}: 'center' needs two numbers, u and v")
        return np.array(numbers, dtype=np.float64)
    for index in range(len(recording)):
        if (image := recording.image(index)) is not None:
            return np.array([(image.shape[1] - 1) / 2.0, (image.shape[0] - 1) / 2.0])
    raise InputError(f"{recording.path}: none of its images can be read")


def sensor_gamma(recording: Recording) -> float:
    """The exponent between light and grey levels that sequence.yaml documents, else the usual 2.2."""
    sensor = recording.sequence.get("sensor")
    gamma = finite_number(sensor.get("gamma")) if isinstance(sensor, dict) else None
    return gamma if gamma is not None and 1.0 <= gamma <= 4.0 else USUAL_GAMMA


def ground_start(recording: Recording, indices: Sequence[int], center: FloatArray, edges_px: FloatArray) -> float:
    """Radius (px) outside of which green ground is seen in nearly all directions: there the robot's body ends.

    edges_px: (E,) usual radii of the strip's edges; the carpet's colour is learned between the first and the seventh.
    Without any green the first edge is the answer.
    """
    chosen = [indices[int(k)] for k in np.linspace(0, len(indices) - 1, _CARPET_IMAGES)]
    images = [image for index in chosen if (image := recording.image(index)) is not None]
    v, u = np.mgrid[0 : images[0].shape[0], 0 : images[0].shape[1]]
    radius = np.hypot(u - center[0], v - center[1])
    outer = edges_px[min(6, len(edges_px) - 1)]
    near = (radius > edges_px[0]) & (radius < outer)
    try:
        carpet = learn_carpet(images, near, near, pixel_noise(images, near))
    except TouchlineError:
        return float(edges_px[0])
    model = colour_model(carpet)
    green = np.max([model.classify(image) == GREEN for image in images], axis=0)
    start = int(edges_px[0])
    while start > 1 and np.mean(green[(radius >= start - 1) & (radius < start)]) >= _GROUND_SHARE:
        start -= 1
    return float(start)
