"""One image looked at closely: its points, where they put the robot, and the pictures of every stage."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from touchline.camera import Camera, GroundView, is_perspective, open_camera
from touchline.errors import InputError, NoFitError, TouchlineError
from touchline.evaluation.runner import robot_setup
from touchline.evaluation.tum import pose_text
from touchline.field import FieldModel, open_field
from touchline.files.images import read_image
from touchline.files.opened import open_bytes
from touchline.geometry import FloatArray, Pose
from touchline.localization.one_shot.locate import locate
from touchline.messages import counted
from touchline.motion import LeanFilter
from touchline.motion.attitude import view_at
from touchline.perception import Detector
from touchline.sources import BagOptions, Recording, open_source
from touchline.systems import DEFAULT_SYSTEM, LocalizationSystem, RobotSetup, open_system, system_info
from touchline.types import Estimate, Frame, ImageArray, Observation, Status
from touchline.view.belief import Belief, belief_of, belief_picture, particles_of
from touchline.view.birds_eye import birds_eye_image
from touchline.view.learned_view import as_learned
from touchline.view.overlay import overlay_image

_ASSUMED_FIELD = "msl-18x12"  # of a lone image of which only the points are wanted: its lines' width
_SEARCHED_IMAGES = 100  # a robot that is not found in as many is not found because of something else


@dataclass(frozen=True, eq=False, slots=True)
class Look:
    """An image (H, W, 3) BGR with what was observed in it, and the pose, if one was found; `found` says how.

    view: the camera at this image. detector: made the observation and has seen nothing since; None if the observation
    came with the image. belief: what the features of this image alone say of the pose; particles (N, 4): after it;
    None of a system without them. estimate: the system's.
    """

    name: str
    image: ImageArray
    view: GroundView
    detector: Detector | None
    observation: Observation
    field: FieldModel | None
    field_from_robot: Pose | None
    found: str
    belief: Belief | None = None
    particles: FloatArray | None = None
    estimate: Estimate | None = None

    def overlay(self) -> ImageArray:
        """What was seen and field lines over the image."""
        return overlay_image(self.image, self.view, self.field, self.field_from_robot, self.observation)

    def stages(self) -> dict[str, ImageArray]:
        """Title -> picture (H, W, 3) BGR of every stage, in their order; none of the detector's where it saw nothing.

        Without field or pose the last picture shows what was seen alone.
        """
        blind = self.observation.problem is not None
        steps = {} if self.detector is None or blind else self.detector.stages(self.image)
        pictures = {
            "original": self.image,
            **steps,
            "bird's-eye view": birds_eye_image(self.image, self.view, self.observation.points),
        }
        if self.field is not None and (self.belief is not None or self.particles is not None):
            pictures["belief and particles"] = belief_picture(self.field, self.belief, self.particles, self.estimate)
        return {**pictures, "overlay": self.overlay()}

    def words(self) -> str:
        """What was found, in one line."""
        points = self.observation.problem or _counts(self.observation)
        if self.field_from_robot is None:
            return f"{self.name}: {points}; {self.found}"
        return f"{self.name}: {points}; {pose_text(self.field_from_robot)} ({self.found})"


def _counts(seen: Observation) -> str:
    features = ((len(seen.lines), "line"), (len(seen.crossings), "crossing"), (len(seen.landmarks), "landmark"))
    parts = [counted(len(seen.points), "line point"), *(counted(count, what) for count, what in features if count)]
    return ", ".join(parts)


def look_at_recording(
    path: Path,
    index: int | None = None,
    system: str | None = None,
    follow_links: bool = False,
    options: BagOptions | None = None,
) -> Look:
    """Image `index` (from 0) of a recording, with what a system sees and the pose that it has when it comes to it.

    Without an index it is the first one that shows where the robot is, or else the first of all. An image that does
    not show it has no pose. system: by default the first that sees through the recording's camera, or the default one
    where a detector of the robot's own sees. Where it cannot see through a perspective camera, the true pose is taken,
    if it is known.
    follow_links, options: as of `open_source`.
    Raises InputError if there is no such image or it cannot be read, for an unknown system and for one that cannot see
    through a mirror's camera.
    """
    if system is not None:
        system_info(system)  # an unknown name is told before the recording is read
    source = open_source(path, follow_links, options)
    if not len(source):
        raise InputError(f"{path}: has no images")
    if not source.has_images:
        raise InputError(
            f"{path}: has no images to draw on, only what a detector of its own found ({source.frame_list}); "
            "`touchline run` draws the robot's path, `touchline check` says how well the lines fit"
        )
    if index is not None and not 0 <= index < len(source):
        raise InputError(f"{path}: has no image {index}; its images are 0 to {len(source) - 1}")
    if index is not None:
        _readable(source, index)  # before the system goes a long way for nothing
    setup = robot_setup(source)
    system = system or DEFAULT_SYSTEM
    unseen = setup.camera is not None and not isinstance(setup.camera, system_info(system).cameras)
    if unseen and is_perspective(source.camera_kind):
        return _look_with_truth(source, index or 0, system)
    running = open_system(system, setup)
    stepped = _first_located(source, running) if index is None else next(islice(_steps(source, running), index, None))
    image = _readable(source, stepped.number)
    frame, estimate = stepped.frame, stepped.estimate
    detector = running.detector if frame.observation is None else None
    view, seen = as_learned(source.camera, frame, stepped.lean, estimate)
    assert seen is not None
    pose: Pose | None = estimate.pose
    found = f"{estimate.status_text()}, as {system} has it after {counted(stepped.number + 1, 'image')}"
    if not estimate.explains_image:
        pose, found = None, f"no field lines are drawn: the robot is not located ({found})"
    return Look(
        f"{source.name}-{stepped.number}",
        image,
        view,
        detector,
        seen,
        source.field,
        pose,
        found,
        belief_of(running, source.field, seen),
        particles_of(running),
        estimate,
    )


def _look_with_truth(source: Recording, index: int, system: str) -> Look:
    """An image with nothing detected in it, and the true pose, if it is known."""
    image, stamp_ns = _readable(source, index), int(source.image_stamps[index])
    pose = None if source.truth is None else source.truth.nearest(stamp_ns)
    found = "the recording knows no true pose" if pose is None else "the true pose"
    found += f"; {system} sees nothing through a camera of the model {source.camera.model}"
    leaning = LeanFilter()
    for frame in islice(source, index + 1):
        leaning.add(frame)
    view = view_at(source.camera, frame, leaning.lean(frame.stamp_ns))
    return Look(f"{source.name}-{index}", image, view, None, Observation(stamp_ns), source.field, pose, found)


def _readable(source: Recording, index: int) -> ImageArray:
    image = source.image(index)
    if image is None:
        raise InputError(f"{source.path}: image {index} cannot be read; touchline check tells why")
    return image


class _Stepped(NamedTuple):
    """How far a system was taken: the last image's index, its frame, the estimate, roll and pitch (rad) of the body."""

    number: int
    frame: Frame
    estimate: Estimate
    lean: tuple[float, float] | None


def _steps(source: Recording, system: LocalizationSystem) -> Iterator[_Stepped]:
    """Image by image."""
    leaning = LeanFilter()
    for index, frame in enumerate(source):
        leaning.add(frame)
        yield _Stepped(index, frame, system.step(frame), leaning.lean(frame.stamp_ns))


def _first_located(source: Recording, system: LocalizationSystem) -> _Stepped:
    """The first of the images in which the system is sure of the pose, or else the very first."""
    for stepped in islice(_steps(source, system), _SEARCHED_IMAGES):
        estimate = stepped.estimate
        seen = estimate.observation is not None and estimate.observation.problem is None
        if estimate.status is Status.TRACKING and seen and stepped.frame.image is not None:
            return stepped
    system.reset()
    return next(_steps(source, system))


def look_at_image(path: Path, camera_file: Path, field_name: str | None = None, system: str | None = None) -> Look:
    """One image taken through a camera, its points found as a system finds them: by default the first that sees
    through that camera.

    With a field (a preset's name or a file) its pose is looked for, too. Without a compass a symmetric field has two
    poses that fit equally well: the first of them is drawn.
    Raises InputError if a file cannot be read, and for an unknown system.
    """
    field = open_field(field_name or _ASSUMED_FIELD)
    camera = open_camera(camera_file)
    look = observe_image(path, camera, field, system)
    if field_name is None:
        return replace(look, field=None, found="no pose: give the field with --field NAME")
    try:
        location = locate(look.observation, field, camera=camera)
    except NoFitError as error:
        return replace(look, found=f"no pose: {error}")
    return replace(look, field_from_robot=location.pose, found="or its mirror image, without a compass")


def observe_image(path: Path, camera: Camera, field: FieldModel, system: str | None = None) -> Look:
    """What a system sees in the image of a file, by default the first that sees through the camera, without a pose.

    Raises InputError if it can't be read or is of another size than the camera's, TouchlineError where nothing can be
    seen; all name the file.
    """
    image: ImageArray = read_image(path)
    height, width, _ = image.shape
    if (width, height) != (camera.width, camera.height):
        raise InputError(
            f"{path}: is of {width} x {height} pixels; the camera file says {camera.width} x {camera.height}"
        )
    detector = open_system(system or DEFAULT_SYSTEM, RobotSetup(field, camera)).detector
    try:
        assert detector is not None, "there is a camera"
        observation = detector.observe(Frame(0, image))
        if observation.problem is not None:
            raise TouchlineError(observation.problem)
    except TouchlineError as error:
        deep = " (read as an image of 16 bits per channel; 8 are expected)" if _has_16_bits(path) else ""
        raise type(error)(f"{path}: {error}{deep}") from None
    return Look(path.stem, image, GroundView(camera), detector, observation, field, None, "no pose")


def _has_16_bits(path: Path) -> bool:
    """Whether a file is a PNG of 16 bits per channel: often 10 or 12 bits of a camera, and then almost black."""
    with open_bytes(path) as file:
        head = file.read(25)
    return head[:4] == b"\x89PNG" and head[24:] == b"\x10"
