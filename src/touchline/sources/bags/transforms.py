"""The tree of frames that /tf and /tf_static tell of, at the time of the newest message."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from touchline.geometry import FloatArray, Pose3

_DEEPEST = 100  # frames from a leaf to the root: more is a loop
GROUND_FRAME, ODOMETRY_FRAME = "base_footprint", "odom"
_BASES = (GROUND_FRAME, "base_link", "base")
# `body_from_optical`: z ahead, x right, y down of the optical frame in x ahead, y left, z up of the camera's body.
BODY_FROM_OPTICAL = Pose3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
_UPWARD = 0.7
_SOLES = ("l_sole", "r_sole")  # of humanoids (REP 120)
_MIN_HEIGHT_M, _MAX_HEIGHT_M = 0.1, 2.0  # of a body's frame; an odometry that says less began at that frame


class FrameTree:
    """Each frame's place in its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Pose3]] = {}
        self._heights_m: dict[str, float] = {}  # of frames, by topics of odometry

    def moved(self, odometry: Any) -> None:
        """Take in at which height a nav_msgs/Odometry puts its frame."""
        if hasattr(odometry, "child_frame_id"):
            self._heights_m[plain(odometry.child_frame_id)] = float(odometry.pose.pose.position.z)

    def base_height_m(self, wanted: str | None) -> float:
        """Of the base over the ground, where it is a frame of the body (REP 120: base_link is the hip) that odometry or
        soles tell; else 0, as of a frame on the ground.
        """
        base = self.base(wanted)
        if base is None or wanted is not None or base == GROUND_FRAME:
            return 0.0
        soles = [found for name in _SOLES if (found := self.pose(name, base)) is not None]
        below = [-float(found.inverse().translation_m[2]) for found in soles]
        placed = self.pose(ODOMETRY_FRAME, base)
        heights = [0.0 if placed is None else float(placed.translation_m[2]), self._heights_m.get(base, 0.0)]
        found_m = (each for each in (*heights, max(below, default=0.0)) if _MIN_HEIGHT_M < each < _MAX_HEIGHT_M)
        return next(found_m, 0.0)

    def update(self, transforms: Iterable[Any]) -> list[tuple[str, int]]:
        """Take in geometry_msgs/TransformStamped; the frames that were placed, with their stamps (ns)."""
        placed = []
        for each in transforms:
            child, parent = plain(each.child_frame_id), plain(each.header.frame_id)
            pose = pose3(each.transform.translation, each.transform.rotation)
            if pose is None or child == parent:
                continue
            self._parents[child] = (parent, pose)
            placed.append((child, header_stamp_ns(each.header)))
        return placed

    def base(self, wanted: str | None) -> str | None:
        """The frame of the robot on the ground: as wanted, else by its usual names."""
        if wanted is not None:
            return plain(wanted)
        frames = {*self._parents, *(parent for parent, _ in self._parents.values())}
        return next((name for name in _BASES if name in frames), None)

    def between(self, target: str, source: str) -> list[str] | None:
        """The frames whose places matter to `target_from_source`; None where nothing joins the two."""
        ways = self._ways(target, source)
        return None if ways is None else [*ways[0], *ways[1]]

    def pose(self, target: str, source: str) -> Pose3 | None:
        """`target_from_source`; None where nothing joins the two."""
        ways = self._ways(target, source)
        return None if ways is None else self._from(ways[0]).inverse().compose(self._from(ways[1]))

    def base_from(self, message: Any, wanted: str | None) -> Pose3:
        """`base_from_sensor` of a message's frame; a sensor that no transform places is in the base."""
        base = self.base(wanted) if hasattr(message, "header") else None
        found = None if base is None else self.pose(base, plain(message.header.frame_id))
        return found or Pose3.identity()

    def _ways(self, *frames: str) -> list[list[str]] | None:
        """From each of two frames up to where the ways meet, that frame left out; None where they don't."""
        first, second = (self._up(frame) for frame in frames)
        meeting = next((frame for frame in first if frame in second), None)
        return None if meeting is None else [up[: up.index(meeting)] for up in (first, second)]

    def _up(self, frame: str) -> list[str]:
        """A frame and those above it."""
        found = [frame]
        while found[-1] in self._parents and len(found) < _DEEPEST:
            found.append(self._parents[found[-1]][0])
        return found

    def _from(self, frames: list[str]) -> Pose3:
        """The pose of the first of some frames, each the parent of the one before, in the parent of the last."""
        pose = Pose3.identity()
        for frame in frames:
            pose = self._parents[frame][1].compose(pose)
        return pose


def header_stamp_ns(header: Any) -> int:
    """The stamp of a std_msgs/Header (ns); 0 where the sender gave none."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


class TransformOdometry:
    """Dead reckoning that only /tf tells: the base in the frame `odom`. base: as `FrameTree.base` has it."""

    def __init__(self, tree: FrameTree, base: str | None) -> None:
        self._tree, self._wanted = tree, base
        self._base: str | None = None
        self._waiting: tuple[int, float, float, float] | None = None

    def moved(self, placed: Iterable[tuple[str, int]]) -> list[tuple[int, float, float, float]]:
        """Stamp (ns), x, y, heading (m, rad) once the next ones are there: a static transform never moves."""
        base = self._tree.base(self._wanted)
        if base != self._base:
            self._base, self._waiting = base, None
        between = (base and self._tree.between(ODOMETRY_FRAME, base)) or ()
        stamp_ns = max((stamp_ns for frame, stamp_ns in placed if frame in between), default=0)
        pose = self._tree.pose(ODOMETRY_FRAME, base) if base and stamp_ns else None
        last = self._waiting
        if pose is None or (last is not None and stamp_ns <= last[0]):
            return []
        x, y, _ = pose.translation_m.tolist()
        self._waiting = stamp_ns, x, y, pose.roll_pitch_yaw()[2]
        return [] if last is None else [last]


def plain(frame: str) -> str:
    """The name of a frame; tf of ROS 1 began them with a slash."""
    return frame.lstrip("/")


def rotation(quaternion: Any) -> FloatArray | None:
    """(3, 3) of a geometry_msgs/Quaternion; None if it is none."""
    q = np.array([quaternion.x, quaternion.y, quaternion.z, quaternion.w], dtype=np.float64)
    if not np.isfinite(q).all() or np.linalg.norm(q) < 1e-3:
        return None
    return Rotation.from_quat(q).as_matrix()


def pose3(place: Any, quaternion: Any) -> Pose3 | None:
    """Of a vector and a quaternion of ROS; None if they are none."""
    turn = rotation(quaternion)
    origin = np.array([place.x, place.y, place.z], dtype=np.float64)
    return None if turn is None or not np.isfinite(origin).all() else Pose3(turn, origin)


def lifted(pose: Pose3, height_m: float) -> Pose3:
    """A pose in a base that stands so high over the ground, from the ground below it."""
    return Pose3(pose.rotation, pose.translation_m + np.array([0.0, 0.0, height_m])) if height_m else pose


def camera_body(base_from_frame: Pose3, frame: str) -> Pose3:
    """`base_from_camera` of the frame that an image names: by custom the optical one (REP 103).

    A frame whose name does not say so, and whose z axis points up, is that of the camera's body already.
    """
    if "optical" not in frame and base_from_frame.rotation[2, 2] > _UPWARD:
        return base_from_frame
    return base_from_frame.compose(BODY_FROM_OPTICAL.inverse())
