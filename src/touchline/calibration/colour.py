"""What `touchline calibrate colour` runs: a colour table from marked regions, or from the field itself without any."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from touchline.camera import Camera, GroundView, PerspectiveCamera
from touchline.errors import InputError, TouchlineError
from touchline.field import FieldModel, open_field
from touchline.files.opened import OwnFolder
from touchline.files.yaml_text import read_yaml
from touchline.messages import did_you_mean, shown
from touchline.motion import LeanFilter
from touchline.motion.attitude import view_at
from touchline.perception import LineGraphSettings, LinePointDetector, line_graph_detector
from touchline.perception.colour import ColourModel
from touchline.perception.covered import is_covered
from touchline.perception.marked_colours import CLASSES, Region, marked_colour_model
from touchline.sources import Recording
from touchline.sources.decoding import decode_image, usable_image
from touchline.types import ImageArray

REGIONS = "regions.yaml"
_ANY_FIELD = "humanoid-kid-9x6"  # of a lone image: its lines' width
_IMAGES = 8  # of a recording, spread over it: more teach nothing new


@dataclass(frozen=True, eq=False, slots=True)
class ColourCalibration:
    """The table, an image (H, W, 3) that it was learned from, and in words what from."""

    colours: ColourModel
    image: ImageArray
    learned_from: str


def calibrate_recording(recording: Recording, regions_file: Path | None = None) -> ColourCalibration:
    """From a recording: its marked regions if it has regions.yaml (or another file is given), else its field."""
    own = recording.folder / REGIONS
    file = regions_file or (recording.file(REGIONS) if own.exists() else None)
    if file is not None and recording.path != recording.folder:
        raise InputError(f"{recording.path}: marked regions are read in a folder: touchline convert makes one of it")
    if file is not None:
        return calibrate_marked(recording.folder, file, recording.follows_links)
    chosen = np.unique(np.linspace(0, len(recording) - 1, _IMAGES).astype(int))
    if isinstance(recording.camera, PerspectiveCamera):
        return _from_perspective(_seen(recording, set(chosen.tolist())), recording.field, recording.name)
    images = [image for k in chosen if (image := recording.image(int(k))) is not None and not is_covered(image)]
    if not images:
        raise InputError(f"{recording.path}: none of its images shows anything; touchline check tells why")
    width = recording.field.line_width
    return calibrate_unmarked(images, recording.camera, f"{len(images)} images of {recording.name}", width)


def calibrate_unmarked(
    images: Sequence[ImageArray], camera: Camera, name: str, line_width_m: float = 0.125
) -> ColourCalibration:
    """From the field itself: its green is the most frequent one around the robot, white what crosses it as lines do.

    A perspective camera is where camera.yaml says.
    """
    if isinstance(camera, PerspectiveCamera):
        return _from_perspective([(image, GroundView(camera)) for image in images], open_field(_ANY_FIELD), name)
    detector = LinePointDetector(camera, line_width_m=line_width_m)
    try:
        detector.learn(images)
    except InputError:
        raise
    except TouchlineError as error:
        raise type(error)(f"{name}: {error}") from None
    assert detector.colours is not None
    return ColourCalibration(detector.colours, images[0], f"{name}, without marks")


def _seen(recording: Recording, chosen: set[int]) -> list[tuple[ImageArray, GroundView]]:
    """Some images of a recording with the camera at each."""
    leaning, found = LeanFilter(), []
    for index, frame in enumerate(recording.again()):
        leaning.add(frame)
        if index in chosen and frame.image is not None and not is_covered(frame.image):
            found.append((frame.image, view_at(recording.camera, frame, leaning.lean(frame.stamp_ns))))
    if not found:
        raise InputError(f"{recording.path}: none of its images shows anything; touchline check tells why")
    return found


def _from_perspective(seen: Sequence[tuple[ImageArray, GroundView]], field: FieldModel, name: str) -> ColourCalibration:
    """What `nimbro-lines` would learn from these images."""
    detector = line_graph_detector(seen[0][1].camera, LineGraphSettings(learning_frames=len(seen)), field)
    for image, view in seen:
        problem = detector.detect(image, view).problem
        if problem is not None:
            raise InputError(f"{name}: {problem}")
    assert detector.classes is not None
    words = f"{len(seen)} images of {name}" if len(seen) > 1 else name
    return ColourCalibration(detector.classes.model, seen[0][0], f"{words}, without marks")


def calibrate_marked(folder: Path, regions_file: Path, follow_links: bool = False) -> ColourCalibration:
    """From marked regions of images in a folder, or anywhere with `follow_links`."""
    regions = read_regions(regions_file)
    own = OwnFolder(folder, follow_links)
    images = {name: read_picture(own.file(name)) for name in dict.fromkeys(region.file for region in regions)}
    for region in regions:
        height, width = images[region.file].shape[:2]
        if not region.mask((height, width)).any():
            raise InputError(f"{regions_file}: a {region.kind} region lies outside {region.file} ({width}×{height})")
    try:
        colours = marked_colour_model(images, regions)
    except InputError as error:
        raise InputError(f"{regions_file}: {error}") from None
    words = f"{len(regions)} marked regions in {len(images)} image{'s' * (len(images) > 1)}"
    return ColourCalibration(colours, images[regions[0].file], words)


def read_regions(path: Path) -> list[Region]:
    """regions.yaml: a list of {file, class, polygon: [[u, v], ...]} or {file, class, box: [u0, v0, u1, v1]}."""
    rows = read_yaml(path)
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: expected a list of regions, each with file, class and polygon (or box)")
    return [_region(row, f"{path}: region {number}") for number, row in enumerate(rows, start=1)]


def _region(row: Any, where: str) -> Region:
    if not isinstance(row, Mapping):
        raise InputError(f"{where}: expected file, class and polygon (or box), found {shown(row)}")
    file, kind = row.get("file"), row.get("class")
    if not isinstance(file, str) or not file:
        raise InputError(f"{where}: 'file' must name an image")
    if kind not in CLASSES:
        raise InputError(f"{where}: class {shown(kind)} is not known; {did_you_mean(str(kind), CLASSES)}")
    unknown = [key for key in row if key not in ("file", "class", "polygon", "box")]
    if unknown or ("polygon" in row) == ("box" in row):
        raise InputError(f"{where}: needs either 'polygon' or 'box', and nothing else than file and class")
    try:
        numbers = np.array(row.get("polygon", row.get("box")), dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if "box" in row and numbers.shape == (4,) and np.all(np.isfinite(numbers)):
        u0, v0, u1, v1 = numbers
        numbers = np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
    if numbers.ndim != 2 or numbers.shape[1] != 2 or len(numbers) < 3 or not np.all(np.abs(numbers) < 1e6):
        raise InputError(
            f"{where}: 'polygon' needs at least three corners [u, v] (px), 'box' four numbers u0, v0, u1, v1"
        )
    return Region(file, str(kind), numbers)


def read_picture(path: Path) -> ImageArray:
    """An 8-bit image (H, W, 3), B, G, R. Raises InputError naming the file."""
    image, outcome = usable_image(decode_image(path), None)
    if image is None:
        raise InputError(f"{path}: {outcome.what}")
    return image
