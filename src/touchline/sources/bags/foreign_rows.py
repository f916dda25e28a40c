"""Messages of ROS as rows of a recording's tables."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from touchline.geometry import FloatArray, Pose3, tilt_rotation
from touchline.sources.bags import roles
from touchline.sources.bags.point_cloud import cloud_points
from touchline.sources.bags.readings import attitude_of, place_and_turn, rates_of
from touchline.sources.bags.table_rows import decimal_seconds
from touchline.sources.bags.transforms import FrameTree, camera_body, plain
from touchline.sources.observations import HEADER
from touchline.sources.problems import ProblemKind, ProblemLog
from touchline.sources.truth import heading_of

_HEADERS = {
    "odometry.csv": "t,x,y,theta",
    "imu.csv": "t,roll,pitch,yaw,gx,gy,gz",
    "camera_pose.csv": "t,x,y,z,roll,pitch,yaw",
    "observations.csv": HEADER,
}
_GROUND_FRAME = "base_footprint"


class ForeignTables:
    """New tables in a folder, written row by row. base: the robot's frame on the ground, if the user has named it."""

    def __init__(self, folder: Path, tree: FrameTree, base: str | None, problems: ProblemLog) -> None:
        self._folder, self._tree, self._problems = folder, tree, problems
        self._base = tree.base(base)
        self._leans = base is None and self._base != _GROUND_FRAME
        self._lean: FloatArray | None = None
        self._camera = ""
        self._last_pose_ns: int | None = None
        self._base_from: dict[str, Pose3] = {}
        self._open: dict[str, TextIO] = {}
        self._stack = ExitStack()

    def __enter__(self) -> ForeignTables:
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def watch_camera(self, frame: str) -> None:
        """Write where the camera is whenever it moves against the base."""
        self._camera = frame

    def place(self, transforms: Iterable[Any], epoch_ns: int) -> None:
        """Take in what a message of /tf or /tf_static says."""
        placed = self._tree.update(transforms)
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

    def add(self, role: str, stamp_ns: int, message: Any, together: bool = False) -> None:
        """Write a message's row. together: the IMU is the compass, too."""
        if role == roles.ODOMETRY:
            place, turn = place_and_turn(message)
            self._row("odometry.csv", stamp_ns, [place.x, place.y, heading_of(turn.x, turn.y, turn.z, turn.w)])
        elif role == roles.TRUTH:
            self._truth(stamp_ns, message)
        elif role == roles.IMU:
            self._imu(stamp_ns, message, with_yaw=together)
        elif role == roles.COMPASS and not together:
            yaw = (self._attitude(message) or (None, None, None))[2]
            self._row("imu.csv", stamp_ns, [None, None, yaw, None, None, None])
        elif role == roles.POINTS:
            self._points(stamp_ns, message)

    def _truth(self, stamp_ns: int, message: Any) -> None:
        place, turn = place_and_turn(message)
        numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
        file = self._file("ground_truth.tum")
        file.write(" ".join([decimal_seconds(stamp_ns), *(repr(float(number)) for number in numbers)]) + "\n")

    def _imu(self, stamp_ns: int, message: Any, with_yaw: bool) -> None:
        attitude, rates = self._attitude(message), rates_of(message, self._pose_of_frame(message))
        roll, pitch, yaw = attitude or (None, None, None)
        if roll is not None and pitch is not None:
            self._lean = tilt_rotation(roll, pitch)
        self._row("imu.csv", stamp_ns, [roll, pitch, yaw if with_yaw else None, *(rates or (None, None, None))])

    def _attitude(self, message: Any) -> tuple[float, float, float] | None:
        return attitude_of(message, self._pose_of_frame(message))

    def _points(self, stamp_ns: int, message: Any) -> None:
        points = cloud_points(message)
        if isinstance(points, str):
            self._problems.add(ProblemKind.BAG, "points", f"a message {points}; it is left out")
            return
        base = self._pose_of_frame(message).transform(points)
        time, file = decimal_seconds(stamp_ns), self._file("observations.csv")
        rows = [f"{time},point,{x!r},{y!r}{',' * 11}" for x, y in base[:, :2].tolist()]
        file.write("\n".join(rows or [f"{time},none{',' * 13}"]) + "\n")

    def _pose_of_frame(self, message: Any) -> Pose3:
        """`base_from_sensor`; a sensor that no transform places is in the base."""
        frame = plain(message.header.frame_id)
        if frame not in self._base_from:
            pose = None if self._base is None else self._tree.pose(self._base, frame)
            self._base_from[frame] = pose or Pose3.identity()
        return self._base_from[frame]

    def _row(self, name: str, stamp_ns: int, values: list[float | None]) -> None:
        cells = ["" if value is None or not math.isfinite(value) else repr(float(value)) for value in values]
        self._file(name).write(",".join([decimal_seconds(stamp_ns), *cells]) + "\n")

    def _file(self, name: str) -> TextIO:
        if name not in self._open:
            file = self._stack.enter_context((self._folder / name).open("x", encoding="utf-8"))
            if name in _HEADERS:
                file.write(_HEADERS[name] + "\n")
            self._open[name] = file
        return self._open[name]
