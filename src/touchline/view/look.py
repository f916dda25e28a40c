"""One image looked at closely: its points, where they put the robot, and the pictures of every stage."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from touchline.camera import OmniCamera, open_camera
from touchline.errors import InputError, NoFitError
from touchline.evaluation.tum import pose_text
from touchline.field import FieldModel, open_field
from touchline.geometry import Pose
from touchline.localization import WeightSettings, locate_points, precision_weights
from touchline.messages import counted
from touchline.perception import HsvLineDetector, LinePointDetector
from touchline.perception.covered import is_covered
from touchline.sources import Recording, open_source
from touchline.systems import DEFAULT_SYSTEM, RobotSetup, open_system, system_info
from touchline.types import Estimate, ImageArray, LinePoints, Status, System
from touchline.view.overlay import overlay_image
from touchline.view.stages import stage_pictures

_COLOUR_IMAGES = 5
_SEARCHED_IMAGES = 100  # a robot that is not found in as many is not found because of something else


@dataclass(frozen=True, eq=False, slots=True)
class Look:
    """An image (H, W, 3) BGR with what was detected in it, and the pose, if one was found; `found` says how."""

    name: str
    image: ImageArray
    camera: OmniCamera
    detector: LinePointDetector | HsvLineDetector
    points: LinePoints
    field: FieldModel | None
    field_from_robot: Pose | None
    found: str

    def overlay(self) -> ImageArray:
        """Points and field lines over the image."""
        return overlay_image(self.image, self.camera, self.field, self.field_from_robot, self.points)

    def stages(self) -> dict[str, ImageArray]:
        """Title -> picture of every stage."""
        pose = self.field_from_robot
        return stage_pictures(self.image, self.camera, self.detector, self.field, pose, self.points)

    def words(self) -> str:
        """What was found, in one line."""
        points = counted(len(self.points), "line point")
        if self.field_from_robot is None:
            return f"{self.name}: {points}; {self.found}"
        return f"{self.name}: {points}; {pose_text(self.field_from_robot)} ({self.found})"


def look_at_recording(path: Path, index: int | None = None, system: str = DEFAULT_SYSTEM) -> Look:
    """Image `index` (from 0) of a recording, with the points and the pose that a system has when it comes to it.

    Without an index it is the first one that shows where the robot is, or else the first of all. An image that does
    not show it has no pose.
    Raises InputError if there is no such image or it cannot be read, and for an unknown system.
    """
    info = system_info(system)
    source = open_source(path)
    if not len(source):
        raise InputError(f"{path}: has no images")
    if index is not None and not 0 <= index < len(source):
        raise InputError(f"{path}: has no image {index}; its images are 0 to {len(source) - 1}")
    if index is not None:
        _readable(source, index)  # before the system goes a long way for nothing
    running = open_system(system, RobotSetup(source.field, source.camera, source.wheel_directions_rad))
    running.reset()
    index, estimate = _first_located(source, running) if index is None else _step_to(source, running, index)
    image = _readable(source, index)
    detector = _ready(info.line_detector(source.camera, line_width_m=source.field.line_width), [image, *_some(source)])
    points = detector.detect(image)
    name = f"{source.name}-{index}"
    pose: Pose | None = estimate.pose
    found = f"{estimate.status.value}, as {system} has it after {counted(index + 1, 'image')}"
    if estimate.status is not Status.TRACKING:
        pose, found = None, f"no field lines are drawn: the robot is not located ({found})"
    return Look(name, image, source.camera, detector, points, source.field, pose, found)


def _readable(source: Recording, index: int) -> ImageArray:
    image = source.image(index)
    if image is None:
        raise InputError(f"{source.folder}: image {index} cannot be read; touchline check tells why")
    return image


def _step_to(source: Recording, system: System, index: int) -> tuple[int, Estimate]:
    """The index, and the estimate after the images up to it."""
    estimates = [system.step(frame) for frame in islice(source, index + 1)]
    return index, estimates[-1]


def _first_located(source: Recording, system: System) -> tuple[int, Estimate]:
    """The first of the images in which the system is sure of the pose, or else the very first."""
    first = None
    for index, frame in enumerate(islice(source, _SEARCHED_IMAGES)):
        estimate = system.step(frame)
        first = first or estimate
        if estimate.status is Status.TRACKING and frame.image is not None and not is_covered(frame.image):
            return index, estimate
    assert first is not None  # a source without images is refused before
    return 0, first


def look_at_image(path: Path, camera_file: Path, field_name: str | None = None, system: str = DEFAULT_SYSTEM) -> Look:
    """One image taken through a camera, its points found as a system finds them.

    With a field (a preset's name or a file) its pose is looked for, too. Without a compass a symmetric field has two
    poses that fit equally well: the first of them is drawn.
    Raises InputError if a file cannot be read, and for an unknown system.
    """
    make = system_info(system).line_detector
    camera = open_camera(camera_file)
    field = None if field_name is None else open_field(field_name)
    image = read_image(path)
    detector = _ready(make(camera) if field is None else make(camera, line_width_m=field.line_width), [image])
    points = detector.detect(image)
    pose, found = None, "no pose: give the field with --field NAME"
    if field is not None:
        try:
            weights = precision_weights(points, WeightSettings())
            pose = locate_points(points.positions_m, field, weights=weights).pose
            found = "or its mirror image, without a compass"
        except NoFitError as error:
            found = f"no pose: {error}"
    return Look(path.stem, image, camera, detector, points, field, pose, found)


def read_image(path: Path) -> ImageArray:
    """An image file as (H, W, 3) BGR. Raises InputError if it is none."""
    try:
        code = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    image = cv2.imdecode(code, cv2.IMREAD_COLOR) if len(code) else None
    if image is None:
        raise InputError(f"{path}: is not an image that can be decoded")
    return np.asarray(image, dtype=np.uint8)


def _ready(
    detector: LinePointDetector | HsvLineDetector, images: list[ImageArray]
) -> LinePointDetector | HsvLineDetector:
    """The detector, its colours learned from images if it needs that."""
    if isinstance(detector, LinePointDetector):
        detector.learn(images)
    return detector


def _some(source: Recording) -> list[ImageArray]:
    """A few images spread over the recording that show something, to learn the colours from."""
    indices = np.unique(np.linspace(0, len(source) - 1, _COLOUR_IMAGES).astype(int))
    images = [source.image(int(index)) for index in indices]
    return [image for image in images if image is not None and not is_covered(image)]
