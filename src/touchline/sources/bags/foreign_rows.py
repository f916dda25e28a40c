"""Messages of ROS as rows of a recording's tables."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from touchline.camera import Camera, PerspectiveCamera
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3, tilt_rotation
from touchline.sources.bags import roles
from touchline.sources.bags.camera_track import CameraTrack
from touchline.sources.bags.extraction import NewFiles
from touchline.sources.bags.gathering import Gathering
from touchline.sources.bags.pixel_features import in_pixels, pixel_feature_rows
from touchline.sources.bags.readings import attitude_of, cloud_points, head_of, place_and_turn, planar_pose, rates_of
from touchline.sources.bags.table_rows import decimal_seconds
from touchline.sources.bags.team_features import FeatureRow, feature_rows
from touchline.sources.bags.transforms import FrameTree, TransformOdometry, camera_body, plain
from touchline.sources.observations import HEADER
from touchline.sources.problems import ProblemKind, ProblemLog

_HEADERS = {
    "odometry.csv": "t,x,y,theta",
    "imu.csv": "t,roll,pitch,yaw,gx,gy,gz",
    "camera_pose.csv": "t,x,y,z,roll,pitch,yaw",
    "observations.csv": HEADER,
}
_GROUND_FRAME = "base_footprint"
_COLUMNS = HEADER.split(",")[1:]
_WAIT_NS = 500_000_000  # for the slower of two topics that tell of one image


class ForeignTables(NewFiles):
    """New tables in a folder, written row by row. base: the robot's frame on the ground, if the user has named it.

    camera: that of features in pixels; where a topic tells the head's pose, camera.yaml places it in the head.
    """

    def __init__(
        self, folder: Path, tree: FrameTree, base: str | None, problems: ProblemLog, camera: Camera | None = None
    ) -> None:
        super().__init__(folder, _HEADERS)
        self._tree, self._problems = tree, problems
        self._base = tree.base(base)
        self._leans = base is None and self._base != _GROUND_FRAME
        self._lean: FloatArray | None = None
        self._camera = ""
        self._last_pose_ns: int | None = None
        self._base_from: dict[str, Pose3] = {}
        self._seen: Gathering[str] = Gathering(_WAIT_NS)
        self._now_ns = -(2**63)
        self._model = camera
        self._mount = camera.base_from_camera if isinstance(camera, PerspectiveCamera) else None
        self._track = CameraTrack(tree, base, self._mount)
        self._odometry = TransformOdometry(tree, base)
        self.odometry_by_transforms = False
        self.seen_ns = array("q")  # when a detector of the robot's own looked

    def __exit__(self, *error: object) -> None:
        self._write_seen(self._seen.rest())
        super().__exit__(*error)
        if self._seen.late:
            what = f"{self._seen.late} messages came after those of later images; they are left out"
            self._problems.add(ProblemKind.BAG, "features", what)

    def watch_camera(self, frame: str) -> None:
        """Write where the camera is whenever it moves against the base."""
        self._camera = frame
        self._track.watch(frame)

    def place(self, transforms: Iterable[Any], epoch_ns: int) -> None:
        """Take in what a message of /tf or /tf_static says."""
        placed = self._tree.update(transforms)
        self._track.moved([(frame, stamp_ns - epoch_ns) for frame, stamp_ns in placed])
        if self.odometry_by_transforms:
            for stamp_ns, *planar in self._odometry.moved(placed):
                self._row("odometry.csv", stamp_ns - epoch_ns, [*planar])
        if self._base is None or not self._camera:
            return
        between = self._tree.between(self._base, plain(self._camera))
        stamps = [stamp_ns for frame, stamp_ns in placed if between and frame in between and stamp_ns]
        pose = self._tree.pose(self._base, plain(self._camera)) if stamps else None
        if pose is None or (self._last_pose_ns is not None and max(stamps) <= self._last_pose_ns):
            return
        self._last_pose_ns = max(stamps)
        body = camera_body(pose, self._camera)
        if self._leans and self._lean is not None:
            body = Pose3(self._lean, np.zeros(3)).compose(body)
        self._row("camera_pose.csv", max(stamps) - epoch_ns, [*body.translation_m.tolist(), *body.roll_pitch_yaw()])

    def expect(self, parts: Iterable[str]) -> None:
        """Roles that tell of the same images."""
        for part in parts:
            self._seen.expect(part)

    def add(self, role: str, stamp_ns: int, message: Any, together: bool = False) -> None:
        """Write a message's row. together: the IMU is the compass, too."""
        if role == roles.ODOMETRY:
            self._row("odometry.csv", stamp_ns, list(planar_pose(message)))
        elif role == roles.TRUTH:
            self._truth(stamp_ns, message)
        elif role == roles.IMU:
            self._imu(stamp_ns, message, with_yaw=together)
        elif role == roles.COMPASS and not together:
            yaw = (self._attitude(message) or (None, None, None))[2]
            self._row("imu.csv", stamp_ns, [None, None, yaw, None, None, None])
        elif role == roles.HEAD:
            self._head(stamp_ns, message)
        elif role == roles.POINTS:
            self._points(stamp_ns, message)
        elif role in roles.FEATURES:
            rows = self._features(role, stamp_ns, message)
            self._found(role, stamp_ns, [",".join(row.get(name, "") for name in _COLUMNS) for row in rows])

    def _features(self, role: str, stamp_ns: int, message: Any) -> list[FeatureRow]:
        if not in_pixels(message):
            return feature_rows(role, message, self._pose_of_frame(message))
        assert self._model is not None  # features in pixels come with a camera
        try:
            view = self._track.view(self._model, message.header.frame_id, stamp_ns)
        except InputError as error:
            self._problems.add(ProblemKind.BAG, role, f"{error}; what was seen is left out")
            return []
        return pixel_feature_rows(role, message, view)

    def _truth(self, stamp_ns: int, message: Any) -> None:
        place, turn = place_and_turn(message)
        numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
        cells = [decimal_seconds(stamp_ns), *(repr(float(number)) for number in numbers)]
        self.write("ground_truth.tum", " ".join(cells) + "\n")

    def _imu(self, stamp_ns: int, message: Any, with_yaw: bool) -> None:
        attitude, rates = self._attitude(message), rates_of(message, self._pose_of_frame(message))
        roll, pitch, yaw = attitude or (None, None, None)
        if roll is not None and pitch is not None:
            self._lean = tilt_rotation(roll, pitch)
            self._track.leaned(stamp_ns, roll, pitch)
        self._row("imu.csv", stamp_ns, [roll, pitch, yaw if with_yaw else None, *(rates or (None, None, None))])

    def _attitude(self, message: Any) -> tuple[float, float, float] | None:
        return attitude_of(message, self._pose_of_frame(message))

    def _points(self, stamp_ns: int, message: Any) -> None:
        points = cloud_points(message)
        if isinstance(points, str):
            self._problems.add(ProblemKind.BAG, "points", f"a message {points}; it is left out")
            return
        base = self._pose_of_frame(message).transform(points)
        self._found(roles.POINTS, stamp_ns, [f"point,{x!r},{y!r}{',' * 11}" for x, y in base[:, :2].tolist()])

    def _head(self, stamp_ns: int, message: Any) -> None:
        head = None if self._mount is None else head_of(message)
        if head is not None and self._mount is not None:
            self._track.head(stamp_ns, message)
            body = head.compose(self._mount)
            self._row("camera_pose.csv", stamp_ns, [*body.translation_m.tolist(), *body.roll_pitch_yaw()])

    def _found(self, part: str, stamp_ns: int, rows: list[str]) -> None:
        """Rows without their time that a topic has of an image."""
        self._now_ns = max(self._now_ns, stamp_ns)
        self._seen.add(part, stamp_ns, rows, self._now_ns)
        self._write_seen(self._seen.ready(self._now_ns))

    def _write_seen(self, found: Iterable[tuple[int, list[str]]]) -> None:
        for stamp_ns, rows in found:
            self.seen_ns.append(stamp_ns)
            time = decimal_seconds(stamp_ns)
            lines = [f"{time},{row}" for row in rows or [f"none{',' * 13}"]]
            self.write("observations.csv", "\n".join(lines) + "\n")

    def _pose_of_frame(self, message: Any) -> Pose3:
        """`base_from_sensor`; a sensor that no transform places is in the base."""
        frame = plain(message.header.frame_id) if hasattr(message, "header") else ""
        if frame not in self._base_from:
            pose = None if self._base is None else self._tree.pose(self._base, frame)
            self._base_from[frame] = pose or Pose3.identity()
        return self._base_from[frame]

    def _row(self, name: str, stamp_ns: int, values: list[float | None]) -> None:
        cells = ["" if value is None or not math.isfinite(value) else repr(float(value)) for value in values]
        self.write(name, ",".join([decimal_seconds(stamp_ns), *cells]) + "\n")
