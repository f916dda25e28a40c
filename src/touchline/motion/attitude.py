"""Where a camera was at each image of a recording, from the head's joints or from the body's lean."""

from collections.abc import Iterable, Iterator

from touchline.camera import Camera, GroundView, ground_view, pose_in_base
from touchline.errors import InputError
from touchline.geometry import Pose3
from touchline.motion.history import MotionHistory
from touchline.types import Frame


def with_camera_poses(frames: Iterable[Frame], camera: Camera) -> Iterator[tuple[Frame, Pose3 | None]]:
    """Each frame with `base_from_camera` at its stamp; None where only camera.yaml tells.

    A frame waits for the next one, for an IMU tells late how the body leant.
    """
    history = MotionHistory()
    waiting: Frame | None = None
    for frame in frames:
        history.add(frame)
        if waiting is not None:
            yield waiting, _pose(camera, waiting, history)
        waiting = frame
    if waiting is not None:
        yield waiting, _pose(camera, waiting, history)


def view_at(camera: Camera, frame: Frame, lean: tuple[float, float] | None) -> GroundView:
    """The camera at a frame whose body leans by roll and pitch (rad); as camera.yaml says if nothing tells."""
    try:
        return ground_view(camera, frame.base_from_camera, *(lean or (None, None)))
    except InputError:  # nothing tells the lean, or the robot has fallen
        return GroundView(camera, frame.base_from_camera)


def _pose(camera: Camera, frame: Frame, history: MotionHistory) -> Pose3 | None:
    lean = history.at(frame.stamp_ns)
    return pose_in_base(camera, frame.base_from_camera, lean.roll_rad, lean.pitch_rad)
