"""Where the camera of a moving head was at an image's time, by /tf, by a topic of the head, by the IMU."""

from collections import deque
from operator import itemgetter
from typing import Any

import numpy as np

from touchline.camera import Camera, PerspectiveCamera, ground_view
from touchline.errors import InputError
from touchline.geometry import Pose3
from touchline.sources.bags.pixel_features import in_pixels, pixel_feature_rows
from touchline.sources.bags.team_features import FeatureRow, feature_rows
from touchline.sources.bags.transforms import GROUND_FRAME, FrameTree, camera_body, lifted, plain, pose3
from touchline.sources.camera_poses import between

_REMEMBERED = 300  # samples: an image is older than the newest


class CameraTrack:
    """Remembers the last seconds. base: the robot's frame on the ground; None: by its usual names.

    camera: that of features in pixels; camera.yaml places it in a head whose own pose a topic tells. Such a topic
    counts before transforms.
    """

    def __init__(self, tree: FrameTree, base: str | None = None, camera: Camera | None = None) -> None:
        self._tree, self._wanted, self.camera = tree, base, camera
        self._mount = camera.base_from_camera if isinstance(camera, PerspectiveCamera) else None
        self._head_tells = False
        self._frame = ""
        self._poses, self._leans = _History(), _History()

    def watch(self, frame: str) -> None:
        """Remember where this frame is: the first image is older than the newest transform, too."""
        self._frame, self._poses = plain(frame), _History()

    def moved(self, placed: list[tuple[str, int]]) -> tuple[int, Pose3] | None:
        """The tree has taken in these frames, with their stamps (ns): when and where the camera is now, if it moved."""
        base = self._tree.base(self._wanted)
        if base is None or not self._frame or self._head_tells:
            return None
        between = self._tree.between(base, self._frame) or ()
        stamps = [stamp_ns for frame, stamp_ns in placed if frame in between]
        pose = self._newest() if stamps else None
        if pose is None:
            return None
        self._poses.add(max(stamps), pose)
        return max(stamps), pose

    def head(self, stamp_ns: int, pose: Any) -> Pose3 | None:
        """Where the camera is by a geometry_msgs/Pose of the head."""
        head = pose3(pose.position, pose.orientation)
        if head is None or self._mount is None:
            return None
        if not self._head_tells:
            self._head_tells, self._poses = True, _History()
        camera = head.compose(self._mount)
        self._poses.add(stamp_ns, camera)
        return camera

    def leaned(self, stamp_ns: int, roll_rad: float, pitch_rad: float) -> None:
        """The body leans so."""
        self._leans.add(stamp_ns, Pose3.from_roll_pitch_yaw(roll_rad, pitch_rad))

    def at(self, frame: str, stamp_ns: int) -> Pose3 | None:
        """`base_from_camera` of an image in a frame, between the samples before and after; None where nothing tells.

        Where the base is none on the ground, it leans as the IMU says, and the ground below it counts.
        """
        if self._head_tells:
            return self._poses.at(stamp_ns)
        if plain(frame) != self._frame:
            self.watch(frame)
            if (newest := self._newest()) is not None:
                self._poses.add(stamp_ns, newest)
        pose = self._poses.at(stamp_ns)
        if pose is None or self._wanted is not None or self._tree.base(None) == GROUND_FRAME:
            return pose
        lean = self._leans.at(stamp_ns)
        return lifted(pose if lean is None else lean.compose(pose), self._tree.base_height_m(None))

    def features(self, role: str, stamp_ns: int, message: Any) -> list[FeatureRow]:
        """Rows of a message of one of `roles.FEATURES`. Raises InputError for features in pixels where the camera, or
        how it leaned, is not known.
        """
        if not in_pixels(message):
            return feature_rows(role, message, self._tree.base_from(message, self._wanted))
        if self.camera is None:
            raise InputError("features in pixels need a CameraInfo beside an image, or --camera")
        lean = self._leans.at(stamp_ns)
        roll, pitch = (None, None) if lean is None else lean.roll_pitch_yaw()[:2]
        at = self.at(message.header.frame_id, stamp_ns)
        return pixel_feature_rows(role, message, ground_view(self.camera, at, roll, pitch))

    def _newest(self) -> Pose3 | None:
        base = self._tree.base(self._wanted)
        found = None if base is None or not self._frame else self._tree.pose(base, self._frame)
        return None if found is None else camera_body(found, self._frame)


class _History:
    """Poses by their times, in whatever order they came."""

    def __init__(self) -> None:
        self._rows: deque[tuple[int, Pose3]] = deque(maxlen=_REMEMBERED)

    def add(self, stamp_ns: int, pose: Pose3) -> None:
        self._rows.append((stamp_ns, pose))

    def at(self, stamp_ns: int) -> Pose3 | None:
        """Between the last one before and the first one after; beyond both ends the last or the first."""
        before = max((row for row in self._rows if row[0] <= stamp_ns), key=itemgetter(0), default=None)
        after = min((row for row in self._rows if row[0] > stamp_ns), key=itemgetter(0), default=None)
        if before is None or after is None:
            return (before or after or (0, None))[1]
        ratio = (stamp_ns - before[0]) / (after[0] - before[0])
        first, second = (np.array([*pose.translation_m, *pose.roll_pitch_yaw()]) for pose in (before[1], after[1]))
        x, y, z, roll, pitch, yaw = between(first, second, ratio).tolist()
        return Pose3.from_roll_pitch_yaw(roll, pitch, yaw, (x, y, z))
