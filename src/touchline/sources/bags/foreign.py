"""A bag of somebody else's robot as the tables of a recording: its topics, its frames, its clock."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from touchline.camera import Camera, camera_from_mapping, open_camera
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3, tilt_rotation
from touchline.messages import listed
from touchline.sources.bags import roles
from touchline.sources.bags.camera_file import camera_mapping
from touchline.sources.bags.camera_track import CameraTrack
from touchline.sources.bags.extraction import ImagePlaces, NewFiles
from touchline.sources.bags.gathering import Gathering
from touchline.sources.bags.layout import EPOCH_KEY
from touchline.sources.bags.messages import Bag, Message, Topic
from touchline.sources.bags.readings import (
    attitude_of,
    cloud_points,
    place_and_turn,
    planar_pose,
    rates_of,
)
from touchline.sources.bags.roles import BagOptions, choose_topics
from touchline.sources.bags.table_rows import decimal_seconds
from touchline.sources.bags.team_features import FeatureRow
from touchline.sources.bags.transforms import (
    GROUND_FRAME,
    FrameTree,
    TransformOdometry,
    camera_body,
    header_stamp_ns,
    lifted,
)
from touchline.sources.bags.with_rosbags import BadMessageError, Codec
from touchline.sources.description import CAMERA
from touchline.sources.new_description import copy_camera, named_field, write_field, write_yaml
from touchline.sources.observations import HEADER
from touchline.sources.problems import ProblemKind, ProblemLog

_SECOND_NS = 1_000_000_000
_SAME_CLOCK_NS = 10 * _SECOND_NS
_TABLES = {
    roles.IMAGE: "images.csv",
    roles.ODOMETRY: "odometry.csv",
    **dict.fromkeys((roles.IMU, roles.COMPASS), "imu.csv"),
    roles.TRUTH: "ground_truth.tum",
    **dict.fromkeys((roles.POINTS, *roles.FEATURES), "observations.csv"),
    roles.HEAD: "camera_pose.csv",
}


class Foreign:
    """A bag on its way into a folder. Raises InputError where it cannot become a recording."""

    def __init__(self, bag: Bag, codec: Codec, options: BagOptions, path: Path, problems: ProblemLog) -> None:
        self._bag, self._codec, self._options, self._path, self._problems = bag, codec, options, path, problems
        self._topics = choose_topics(bag.topics, options.topics, problems)
        self._roles: dict[str, list[str]] = {}
        for role, topic in self._topics.items():
            self._roles.setdefault(topic.name, []).append(role)
        self._transforms = {each.name: each for each in bag.topics.values() if each.type in roles.TRANSFORM_TYPES}
        problems.topics = {CAMERA: path.name, **_table_topics(self._topics)}
        if not roles.has_features(self._topics) and not {roles.IMAGE, roles.POINTS} & set(self._topics):
            kinds = sorted({topic.type for topic in bag.topics.values()})
            raise InputError(
                f"{path}: holds neither images nor what a detector found, only {listed(kinds)[:300]}; "
                f"--topic image=/NAME or --topic points=/NAME tells where they are"
            )
        self._pixels = roles.in_pixels(self._topics)
        self._field = named_field(path, options.field)
        self._tree = FrameTree()
        self._info: Any = None
        self._frame = ""  # of the image, or of the features in its pixels
        self._epoch_ns: int | None = None
        self._bare_ns = 0  # from the clock that messages were received by to that of their stamps
        self._stamps, self._places, self._names = array("q"), array("q"), array("b")

    def extract(self, folder: Path) -> ImagePlaces:
        """Write the tables, in constant memory but for 40 bytes an image."""
        self._look_around()
        track = CameraTrack(self._tree, self._options.base, self._seeing())
        track.watch(self._frame)
        epoch_ns = self._epoch_ns or 0
        with ForeignTables(folder, self._tree, track, self._options.base, self._problems, epoch_ns) as tables:
            tables.odometry_by_transforms = roles.ODOMETRY not in self._topics
            tables.expect(role for role in roles.FEATURES if role in self._topics)
            wanted = {*self._roles, *self._transforms} - {self._name(roles.CAMERA_INFO)}
            for message in self._bag.messages(wanted):
                self._take(message, tables)
        order = np.argsort(np.array(self._stamps, dtype=np.int64), kind="stable")
        self._write_images(folder, order)
        self._write_description(folder, tables.seen_ns)
        places = np.array(self._places, dtype=np.int64).reshape(-1, 2)[order]
        return ImagePlaces(self._name(roles.IMAGE), places)

    def _seeing(self) -> Camera | None:
        """The camera, where features in pixels or a head whose own pose a topic tells need it before the first row.

        Raises InputError where features in pixels have none.
        """
        if self._options.camera is not None and (self._pixels or roles.IMAGE in self._topics):
            return open_camera(self._options.camera)
        if not self._pixels:
            return None
        mapping = self._camera_mapping()
        if isinstance(mapping, str):
            what = f"{self._pixels[0]} tells of pixels, and the camera is not known: {mapping}"
            raise InputError(f"{self._path}: {what}; --camera FILE gives one")
        return camera_from_mapping(mapping, self._path)

    def _name(self, role: str) -> str:
        return self._topics[role].name if role in self._topics else ""

    def _look_around(self) -> None:
        """What has to be known before the first row: clock, camera and frames, as far as the bag tells of them."""
        names: Collection[str] = {*self._roles, *self._transforms}
        for count, message in enumerate(self._bag.messages(names)):
            if (decoded := self._decoded(message)) is None:
                continue
            if message.topic in self._transforms:
                self._tree.update(decoded.transforms)
                continue
            if message.topic == self._name(roles.ODOMETRY):
                self._tree.moved(decoded)
            if self._epoch_ns is None and hasattr(decoded, "header"):
                stamp_ns = header_stamp_ns(decoded.header)
                self._compare_clocks(message.log_ns, stamp_ns)
                second = (stamp_ns or message.log_ns) // _SECOND_NS
                self._epoch_ns = second * _SECOND_NS * self._options.from_zero
            if message.topic == self._name(roles.CAMERA_INFO) and self._info is None:
                self._info = decoded
            if message.topic in (self._name(roles.IMAGE), *self._pixels):
                self._frame = self._frame or decoded.header.frame_id
            if self._knows_enough() and (count >= _MAX_LOOKED or self._knows_height()):
                return

    def _compare_clocks(self, log_ns: int, stamp_ns: int) -> None:
        """What comes without a stamp is as old as its receipt; of another clock than the stamps', it is moved there."""
        if stamp_ns and abs(log_ns - stamp_ns) > _SAME_CLOCK_NS:
            self._bare_ns = stamp_ns - log_ns
            if any(topic.type in roles.UNSTAMPED for topic in self._topics.values()):
                what = f"was recorded by a clock that differs from its stamps' by {abs(self._bare_ns) / 1e9:.0f} s; "
                what += "messages without a stamp are moved by as much"
                self._problems.add(ProblemKind.TOPIC, self._path.name, what)

    def _knows_enough(self) -> bool:
        if self._epoch_ns is None:
            return False
        if roles.CAMERA_INFO in self._topics and self._info is None:
            return False
        if (roles.IMAGE in self._topics or self._pixels) and not self._frame:
            return False
        return not self._transforms or self._mount() is not None

    def _knows_height(self) -> bool:
        """Whether the base stands on the ground, or it is known how high over it."""
        base, wanted = self._tree.base(self._options.base), self._options.base
        return base in (None, GROUND_FRAME) or wanted is not None or self._tree.base_height_m(wanted) > 0.0

    def _mount(self) -> Pose3 | None:
        """`base_from_camera` as far as it is known."""
        base = self._tree.base(self._options.base)
        pose = None if base is None or not self._frame else self._tree.pose(base, self._frame.lstrip("/"))
        if pose is None:
            return None
        return lifted(camera_body(pose, self._frame), self._tree.base_height_m(self._options.base))

    def _decoded(self, message: Message) -> Any:
        try:
            return self._codec.decode(self._bag.topics[message.topic], message.data)
        except BadMessageError as error:
            self._problems.add(ProblemKind.BAG, message.topic, f"a message cannot be read ({error}); it is left out")
            return None

    def _take(self, message: Message, tables: ForeignTables) -> None:
        if (decoded := self._decoded(message)) is None:
            return
        if message.topic in self._transforms:
            tables.place(decoded.transforms)
            return
        bare = not hasattr(decoded, "header")
        received_ns = message.log_ns + bare * (self._bare_ns - round(1e6 * self._options.late_ms))
        stamp_ns = ((not bare and header_stamp_ns(decoded.header)) or received_ns) - (self._epoch_ns or 0)
        taken = self._roles[message.topic]
        if roles.IMAGE in taken:
            self._stamps.append(stamp_ns)
            self._places.extend(message.place)
            text = getattr(decoded, "format", "png")  # images that are pixels become PNG files
            self._names.append("png" in text or "compressed bayer" in text)
            return
        for role in taken:
            tables.add(role, stamp_ns, decoded, together=roles.IMU in taken and roles.COMPASS in taken)

    def _write_images(self, folder: Path, order: Any) -> None:
        if roles.IMAGE not in self._topics:
            return
        with (folder / "images.csv").open("x", encoding="utf-8") as file:
            file.write("t,file\n")
            for number, index in enumerate(order.tolist()):
                ending = "png" if self._names[index] else "jpg"
                file.write(f"{decimal_seconds(self._stamps[index])},images/{number:06d}.{ending}\n")

    def _write_description(self, folder: Path, seen: array[int]) -> None:
        about: dict[str, Any] = {
            "format": 1,
            "name": self._path.stem,
            "field": write_field(self._field, self._options.field, folder),
        }
        about["camera"] = self._camera(folder)
        steps = np.diff(np.sort(np.array(self._stamps or seen, dtype=np.int64)))
        if len(steps) and np.median(steps) > 0:
            about["rate_hz"] = round(1e9 / float(np.median(steps)), 3)
        about["topics"] = {role: topic.name for role, topic in self._topics.items()}
        about[EPOCH_KEY] = self._epoch_ns or 0
        write_yaml(folder / "sequence.yaml", about)

    def _camera(self, folder: Path) -> str:
        """Its kind; camera.yaml is written where the camera is known."""
        if roles.IMAGE not in self._topics:
            return "none"
        if self._options.camera is not None:
            return copy_camera(self._options.camera, folder)
        mapping = self._camera_mapping()
        if isinstance(mapping, str):
            self._problems.add(ProblemKind.TOPIC, CAMERA, f"{mapping}; --camera FILE gives one")
        else:
            write_yaml(folder / "camera.yaml", mapping)
            return str(mapping["model"])
        return "pinhole"

    def _camera_mapping(self) -> dict[str, Any] | str:
        """The keys of a camera.yaml, or why there are none."""
        beside = self._name(roles.IMAGE) or self._pixels[0]
        return f"no CameraInfo beside {beside}" if self._info is None else camera_mapping(self._info, self._mount())


def _table_topics(chosen: Mapping[str, Topic]) -> dict[str, str]:
    """The topics that each table is written from."""
    tables: dict[str, list[str]] = {}
    for role, topic in chosen.items():
        if role in _TABLES:
            tables.setdefault(_TABLES[role], []).append(topic.name)
    found = {"odometry.csv": ["/tf"], "camera_pose.csv": ["/tf"], **tables}
    return {name: ", ".join(dict.fromkeys(topics)) for name, topics in found.items()}


# --- rows of a bag's tables -------------------------------------------------------------------------------------------


_HEADERS = {
    "odometry.csv": "t,x,y,theta",
    "imu.csv": "t,roll,pitch,yaw,gx,gy,gz",
    "camera_pose.csv": "t,x,y,z,roll,pitch,yaw",
    "observations.csv": HEADER,
}
_COLUMNS = HEADER.split(",")[1:]
_MAX_LOOKED = 200  # messages, after which nothing is expected to tell how high the base is
_WAIT_NS = 500_000_000  # for the slower of two topics that tell of one image


class ForeignTables(NewFiles):
    """New tables in a folder, written row by row. base: the robot's frame on the ground, if the user has named it.
    epoch_ns: what the bag's clock showed at t = 0.
    """

    def __init__(
        self,
        folder: Path,
        tree: FrameTree,
        track: CameraTrack,
        base: str | None,
        problems: ProblemLog,
        epoch_ns: int,
    ) -> None:
        super().__init__(folder, _HEADERS)
        self._tree, self._track, self._wanted, self._problems = tree, track, base, problems
        self._leans = base is None and tree.base(base) != GROUND_FRAME
        self._lean: FloatArray | None = None
        self._epoch_ns, self._last_pose_ns = epoch_ns, -epoch_ns
        self._seen: Gathering[str] = Gathering(_WAIT_NS)
        self._now_ns = -(2**63)
        self._odometry = TransformOdometry(tree, base)
        self.odometry_by_transforms = False
        self.seen_ns = array("q")  # when a detector of the robot's own looked

    def __exit__(self, *error: object) -> None:
        self._write_seen(self._seen.rest())
        super().__exit__(*error)
        if self._seen.late:
            what = f"{self._seen.late} messages came after those of later images; they are left out"
            self._problems.add(ProblemKind.BAG, "features", what)

    def place(self, transforms: Iterable[Any]) -> None:
        """Take in what a message of /tf or /tf_static says."""
        placed = self._tree.update(transforms)
        for stamp_ns, *planar in self._odometry.moved(placed) if self.odometry_by_transforms else ():
            self._row("odometry.csv", stamp_ns - self._epoch_ns, [*planar])
        moved = self._track.moved([(frame, stamp_ns - self._epoch_ns) for frame, stamp_ns in placed])
        if moved is None or moved[0] <= self._last_pose_ns:
            return
        self._last_pose_ns, body = moved
        if self._leans and self._lean is not None:
            body = Pose3(self._lean, np.zeros(3)).compose(body)
        body = lifted(body, self._tree.base_height_m(self._wanted))
        self._camera_pose(self._last_pose_ns, body)

    def expect(self, parts: Iterable[str]) -> None:
        """Roles that tell of the same images."""
        for part in parts:
            self._seen.expect(part)

    def add(self, role: str, stamp_ns: int, message: Any, together: bool = False) -> None:
        """Write a message's row. together: the IMU is the compass, too."""
        if role == roles.ODOMETRY:
            self._tree.moved(message)
            self._row("odometry.csv", stamp_ns, list(planar_pose(message)))
        elif role == roles.TRUTH:
            self._truth(stamp_ns, message)
        elif role == roles.IMU:
            self._imu(stamp_ns, message, with_yaw=together)
        elif role == roles.COMPASS and not together:
            yaw = (self._attitude(message) or (None, None, None))[2]
            self._row("imu.csv", stamp_ns, [None, None, yaw, None, None, None])
        elif role == roles.HEAD:
            if (body := self._track.head(stamp_ns, message)) is not None:
                self._camera_pose(stamp_ns, body)
        elif role == roles.POINTS:
            self._points(stamp_ns, message)
        elif role in roles.FEATURES:
            rows = self._features(role, stamp_ns, message)
            self._found(role, stamp_ns, [",".join(row.get(name, "") for name in _COLUMNS) for row in rows])

    def _features(self, role: str, stamp_ns: int, message: Any) -> list[FeatureRow]:
        try:
            return self._track.features(role, stamp_ns, message)
        except InputError as error:
            self._problems.add(ProblemKind.BAG, role, f"{error}; what was seen is left out")
            return []

    def _truth(self, stamp_ns: int, message: Any) -> None:
        place, turn = place_and_turn(message)
        numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
        cells = [decimal_seconds(stamp_ns), *(repr(float(number)) for number in numbers)]
        self.write("ground_truth.tum", " ".join(cells) + "\n")

    def _imu(self, stamp_ns: int, message: Any, with_yaw: bool) -> None:
        attitude, rates = self._attitude(message), rates_of(message, self._tree.base_from(message, self._wanted))
        roll, pitch, yaw = attitude or (None, None, None)
        if roll is not None and pitch is not None:
            self._lean = tilt_rotation(roll, pitch)
            self._track.leaned(stamp_ns, roll, pitch)
        self._row("imu.csv", stamp_ns, [roll, pitch, yaw if with_yaw else None, *(rates or (None, None, None))])

    def _attitude(self, message: Any) -> tuple[float, float, float] | None:
        return attitude_of(message, self._tree.base_from(message, self._wanted))

    def _points(self, stamp_ns: int, message: Any) -> None:
        points = cloud_points(message)
        if isinstance(points, str):
            self._problems.add(ProblemKind.BAG, "points", f"a message {points}; it is left out")
            return
        base = self._tree.base_from(message, self._wanted).transform(points)
        self._found(roles.POINTS, stamp_ns, [f"point,{x!r},{y!r}{',' * 11}" for x, y in base[:, :2].tolist()])

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

    def _camera_pose(self, stamp_ns: int, body: Pose3) -> None:
        self._row("camera_pose.csv", stamp_ns, [*body.translation_m.tolist(), *body.roll_pitch_yaw()])

    def _row(self, name: str, stamp_ns: int, values: list[float | None]) -> None:
        cells = ["" if value is None or not math.isfinite(value) else repr(float(value)) for value in values]
        self.write(name, ",".join([decimal_seconds(stamp_ns), *cells]) + "\n")
