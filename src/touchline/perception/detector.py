"""What every detector does, and the one place where it is decided whether a detector is asked at all."""

import math
from dataclasses import replace
from typing import Protocol

import numpy as np

from touchline.camera import Camera, pose_in_base
from touchline.errors import InputError
from touchline.perception.covered import is_covered
from touchline.types import Frame, ImageArray, LinePoints, Observation

_WANTED, _BYTE = "not an array (height, width, 3) of uint8", np.dtype(np.uint8)


class Detector(Protocol):
    """Image -> observation, frame after frame of one camera."""

    @property
    def learns_colours(self) -> bool:
        """Whether the first images teach it its colours."""

    def observe(self, frame: Frame) -> Observation:
        """What the image of a frame shows; `problem` says why nothing could be seen, if so.

        Raises InputError for an image of another size than the camera's, and for a frame without one.
        """

    def stages(self, image: ImageArray) -> dict[str, ImageArray]:
        """Title -> picture (H, W, 3), B, G, R, of each step by which `observe` would take an image (H, W, 3) now.

        Raises TouchlineError where nothing can be seen.
        """

    def reset(self) -> None:
        """Forget what earlier images have taught."""


def observe(frame: Frame, detector: Detector | None, max_range_m: float = math.inf) -> Observation:
    """What a frame shows: the observation that it brings, or else what the detector finds in its image.

    Points, lines, crossings and landmarks that are no measurements, and those farther away than max_range_m, are left
    out. detector: None without a camera. An image that can't be used is this frame's problem: nothing is seen, and no
    other frame is concerned.
    """
    if frame.observation is not None and not isinstance(frame.observation, Observation):
        return Observation(frame.stamp_ns, problem=f"the observation is {_kind(frame.observation)}, not an Observation")
    if frame.observation is not None:
        # whatever clock the robot's own detector has, the observation belongs to this frame
        seen, stamp_ns = frame.observation, frame.stamp_ns
        return (seen if seen.stamp_ns == stamp_ns else replace(seen, stamp_ns=stamp_ns)).usable(max_range_m)
    if detector is None:
        return Observation(frame.stamp_ns)
    if frame.image is None:
        return Observation(frame.stamp_ns, problem=frame.problem or "there is no image")
    if not is_image(frame.image):
        return Observation(frame.stamp_ns, problem=f"the image is {_kind(frame.image)}, {_WANTED}")
    if is_covered(frame.image):
        return Observation(frame.stamp_ns, problem="the image is black, or shows nothing at all")
    try:
        return detector.observe(frame).usable(max_range_m)
    except InputError as error:
        return Observation(frame.stamp_ns, problem=str(error))


def is_image(image: object) -> bool:
    """Whether this is an image that can be looked at: uint8 (H, W, 3), not empty."""
    if not isinstance(image, np.ndarray) or image.dtype != _BYTE:
        return False
    return image.ndim == 3 and image.shape[2] == 3 and image.size > 0


def _kind(image: object) -> str:
    return f"{image.shape} of {image.dtype}" if isinstance(image, np.ndarray) else f"a {type(image).__name__}"


def with_lean(points: LinePoints, frame: Frame, camera: Camera, noise_px: float, noise_m: float) -> LinePoints:
    """The points as a camera with `use_attitude` sees them on a body that leans; others as they are.

    noise_px, noise_m: standard deviations of a point in the image and on the ground. The newest roll and pitch of the
    frame are taken.
    """
    if not camera.use_attitude:
        return points
    pose = pose_in_base(camera, frame.base_from_camera, *lean_of(frame))
    if pose is None:
        return points
    covariances = camera.ground_covariances(points.pixels, noise_px, noise_m, pose)
    return replace(points, positions_m=camera.ground_from_image(points.pixels, pose), covariances_m2=covariances)


def lean_of(frame: Frame) -> tuple[float | None, float | None]:
    """The newest roll and pitch (rad) of a frame; None, None where nothing tells."""
    if frame.tilt is None or not len(frame.tilt):
        return None, None
    roll, pitch = frame.tilt.values[-1].tolist()
    return roll, pitch


def image_of(frame: Frame, camera: Camera) -> ImageArray:
    """A frame's image. Raises InputError for one of another size than the camera's, and for a frame without one."""
    if frame.image is None:
        raise InputError(f"the frame at {frame.stamp_ns} ns has no image")
    check_size(frame.image, camera)
    return frame.image


def check_size(image: ImageArray, camera: Camera) -> None:
    """Raises InputError unless the image is (H, W, 3) of uint8 as the camera takes them."""
    wanted = (camera.height, camera.width, 3)
    if not is_image(image) or image.shape != wanted:
        raise InputError(f"the image is {_kind(image)}; the camera file says {wanted} (height, width, 3), uint8")
