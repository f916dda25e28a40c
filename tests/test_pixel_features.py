"""Features in pixels (soccer_vision_2d_msgs) and images of a head that moves: read from bags, and by live links."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from touchline.camera import PinholeCamera
from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose3
from touchline.live.heard import Sight
from touchline.live.ros_reader import TRANSFORMS, RosReader
from touchline.sources import open_source
from touchline.sources.bags import roles
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.roles import BagOptions, choose_topics
from touchline.sources.bags.standard import BASE, OPTICAL, StandardMessages, quaternion_of
from touchline.sources.bags.transforms import BODY_FROM_OPTICAL
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.bags.writing import McapWriter
from touchline.sources.new_description import write_yaml
from touchline.sources.problems import ProblemLog
from touchline.types import Observation

FIELD, SECOND_NS = BagOptions(field="hsl-s-9x6"), 1_000_000_000
MARKINGS, POSTS = ("soccer_vision_2d_msgs/msg/MarkingArray", "soccer_vision_2d_msgs/msg/GoalpostArray")
MOUNT = Pose3.from_roll_pitch_yaw(0.0, 0.4, 0.0, (0.05, 0.0, 0.5))
CAMERA = PinholeCamera(640, 480, 420.0, 425.0, 322.0, 238.0, np.array([-0.05, 0.01, 0.0, 0.0, 0.0]), MOUNT)
CROSSINGS = [("L", (2.0, 0.5), 0.7), ("T", (2.5, -0.6), -2.0), ("X", (3.0, 0.2), 0.1)]
ARMS = {"L": (-0.25, 0.25), "T": (0.0, 0.5, -0.5), "X": (0.0, 0.5, 1.0, -0.5)}
MARK, CIRCLE, POST, LINE = (1.8, -0.3), (3.5, 0.4), (4.0, -1.0), ((1.6, 0.9), (3.2, 1.2))
CODEC = Codec()
MAKE = StandardMessages(CODEC)


def head_at(stamp_ns: int) -> Pose3:
    """`base_from_camera` of a head that pans at 1 rad/s."""
    return Pose3.from_roll_pitch_yaw(0.0, 0.4, stamp_ns / SECOND_NS - 10.0, (0.05, 0.0, 0.5))


def pixel(place: Any, view: Pose3) -> FloatArray:
    """Of a place on the ground."""
    found: FloatArray = CAMERA.image_from_ground(np.array([place]), view)[0]
    return found


def markings(stamp_ns: int, types: Any = None) -> Any:
    """What a detector finds, by the definitions of today, or others."""
    view, kinds = head_at(stamp_ns), (types or CODEC.standard).types
    earlier = types is not None
    point = "geometry_msgs/msg/Point" if earlier else "vision_msgs/msg/Point2D"
    sure = kinds["soccer_vision_attribute_msgs/msg/Confidence"](confidence=0.5)

    def at(u: float, v: float) -> Any:
        return kinds[point](x=float(u), y=float(v), **({"z": 0.0} if earlier else {}))

    def box(uv: FloatArray, size: tuple[float, float]) -> Any:
        center = kinds["vision_msgs/msg/Pose2D"](position=kinds["vision_msgs/msg/Point2D"](x=uv[0], y=uv[1]), theta=0.0)
        return kinds["vision_msgs/msg/BoundingBox2D"](center=center, size_x=size[0], size_y=size[1])

    def ellipse(place: tuple[float, float], diameter: float) -> Any:
        center, side = pixel(place, view), pixel((place[0], place[1] + 0.5 * diameter), view)
        size = 2.0 * abs(float(side[0] - center[0])), 10.0
        kind = kinds["soccer_vision_2d_msgs/msg/MarkingEllipse"]
        return kind(bb=box(center, size), center=at(*center), confidence=sure)

    def crossing(kind: str, place: tuple[float, float], turn: float) -> Any:
        center, headings = pixel(place, view), []
        for arm in ARMS[kind]:
            angle = turn + arm * math.pi
            way = pixel((place[0] + 1e-3 * math.cos(angle), place[1] + 1e-3 * math.sin(angle)), view) - center
            headings.append(math.atan2(way[1], way[0]) % (2.0 * math.pi))
        made = kinds["soccer_vision_2d_msgs/msg/MarkingIntersection"]
        rays = np.sort(np.array(headings))
        return made(center=at(*center), num_rays=len(rays), heading_rays=rays, confidence=sure)

    ends = [at(*pixel(end, view)) for end in LINE]
    above = [at(320, 3), at(330, 4)]  # the horizon
    segment = kinds["soccer_vision_2d_msgs/msg/MarkingSegment"]
    return kinds[MARKINGS](
        header=MAKE.header(stamp_ns, OPTICAL),
        ellipses=[ellipse(MARK, 0.1), ellipse(CIRCLE, 1.5)],
        intersections=[crossing(*each) for each in CROSSINGS],
        segments=[segment(start=a, end=b, confidence=sure) for a, b in (ends, above)],
    )


def goalposts(stamp_ns: int) -> Any:
    """One whose foot is seen, and one that goes on below the image."""
    make, foot = CODEC.make, pixel(POST, head_at(stamp_ns))

    def post(u: float, v: float, height: float) -> Any:
        position = make("vision_msgs/msg/Point2D", x=float(u), y=float(v))
        center = make("vision_msgs/msg/Pose2D", position=position, theta=0.0)
        return make(
            "soccer_vision_2d_msgs/msg/Goalpost",
            bb=make("vision_msgs/msg/BoundingBox2D", center=center, size_x=9.0, size_y=height),
            attributes=make("soccer_vision_attribute_msgs/msg/Goalpost", side=0, team=0),
            confidence=make("soccer_vision_attribute_msgs/msg/Confidence", confidence=-1.0),
        )

    posts = [post(foot[0], foot[1] - 40.0, 80.0), post(300.0, 419.5, 119.0)]
    return make(POSTS, header=MAKE.header(stamp_ns, OPTICAL), posts=posts)


def transforms(stamp_ns: int) -> Any:
    return MAKE.transform(stamp_ns, BASE, OPTICAL, head_at(stamp_ns).compose(BODY_FROM_OPTICAL))


def sent() -> Iterator[tuple[int, str, str, Any]]:
    """Transforms at 50 Hz, of which none is at an image's time; features 60 ms late."""
    for k in range(20):
        at_ns = 10 * SECOND_NS + k * 20_000_000
        yield at_ns, "/tf", "tf2_msgs/msg/TFMessage", transforms(at_ns)
        if k == 0:
            info = MAKE.camera_info(at_ns, CAMERA)
            yield at_ns, "/camera/camera_info", "sensor_msgs/msg/CameraInfo", info
        if k % 5 == 4:
            image_ns = at_ns - 53_000_000
            yield at_ns, "/markings_in_image", MARKINGS, markings(image_ns)
            yield at_ns, "/goal_posts_in_image", POSTS, goalposts(image_ns)


def write(path: Path, without: str = "") -> Path:
    writer = McapWriter(path, CODEC)
    for at_ns, topic, kind, message in sent():
        if kind != without:
            writer.write(topic, kind, at_ns, CODEC.encode(kind, message))
    writer.close()
    return path


def check(seen: Observation | None) -> None:
    """It is what was there."""
    assert seen is not None
    for kind, place, turn in CROSSINGS:
        (k,) = np.flatnonzero(seen.crossings.kinds == kind)
        assert seen.crossings.positions_m[k] == pytest.approx(place, abs=1e-4)
        off = seen.crossings.orientations_rad[k] - turn
        assert math.remainder(off, 0.5 * math.pi if kind == "X" else 2.0 * math.pi) == pytest.approx(0.0, abs=0.02)
        assert seen.crossings.confidences[k] == 0.5
    found = dict(zip(seen.landmarks.kinds.tolist(), seen.landmarks.positions_m, strict=True))
    assert len(seen.landmarks) == 3
    for name, place in (("penalty_mark", MARK), ("circle", CIRCLE), ("post", POST)):
        assert found[name] == pytest.approx(place, abs=1e-4)
    assert seen.lines.ends_m == pytest.approx(np.array([LINE]), abs=1e-4)


def test_a_bag_of_pixels_is_what_was_on_the_ground(tmp_path: Path) -> None:
    recording = open_source(write(tmp_path / "walk.mcap"), options=FIELD)
    assert recording.sequence["topics"]["markings"] == "/markings_in_image"
    frames = list(recording)
    assert len(frames) == 4
    for frame in frames:
        check(frame.observation)


def test_without_a_camera_it_is_asked_for(tmp_path: Path) -> None:
    path = write(tmp_path / "walk.mcap", without="sensor_msgs/msg/CameraInfo")
    with pytest.raises(
        InputError, match="/markings_in_image tells of pixels, and the camera is not known: no CameraInfo"
    ):
        open_source(path, options=FIELD)
    write_yaml(tmp_path / "camera.yaml", CAMERA.mapping())
    given = open_source(path, options=BagOptions(field="hsl-s-9x6", camera=tmp_path / "camera.yaml"))
    check(next(iter(given)).observation)


def test_pixels_that_come_live_are_what_is_on_the_ground(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchline.live.ros_reader.time.monotonic_ns", lambda: 0)  # a busy machine loses no part
    reader, sights = RosReader(camera=CAMERA), []
    for role in (roles.MARKINGS, roles.GOALPOSTS):
        reader.expect(role)
    for _, _, kind, message in sent():
        role = {MARKINGS: roles.MARKINGS, POSTS: roles.GOALPOSTS}.get(kind, TRANSFORMS)
        if kind != "sensor_msgs/msg/CameraInfo":
            sights += [each for each in reader.read(role, message) if isinstance(each, Sight)]
    assert len(sights) == 4
    for sight in sights[1:]:  # the track of transforms begins with the first image
        check(sight.observation)
    with pytest.raises(InputError, match="need a CameraInfo beside an image, or --camera"):
        list(RosReader().read(roles.MARKINGS, markings(10 * SECOND_NS)))


def test_places_in_metres_come_before_pixels() -> None:
    kinds = {"/a": MARKINGS, "/b": "soccer_vision_3d_msgs/msg/MarkingArray", "/c": "sensor_msgs/msg/CameraInfo"}
    there = {name: Topic(name, kind, "cdr", None, 5) for name, kind in kinds.items()}
    chosen = choose_topics(there, {}, ProblemLog())
    assert {role: topic.name for role, topic in chosen.items()} == {"markings": "/b"}
    named = choose_topics(there, {"markings": "/a"}, ProblemLog())
    assert {role: topic.name for role, topic in named.items()} == {"markings": "/a", "camera_info": "/c"}


def head_message(stamp_ns: int) -> Any:
    """geometry_msgs/Pose of the head, in which the camera sits as camera.yaml says."""
    head = head_at(stamp_ns).compose(CAMERA.base_from_camera.inverse())
    x, y, z, w = quaternion_of(head.rotation)
    place = CODEC.make("geometry_msgs/msg/Point", **dict(zip("xyz", head.translation_m.tolist(), strict=True)))
    turn = CODEC.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
    return CODEC.make("geometry_msgs/msg/Pose", position=place, orientation=turn)


def panned() -> Iterator[tuple[int, str, str, Any]]:
    """Images 60 ms late beside the poses of the head, which have no stamp."""
    pixels = np.frombuffer(cv2.imencode(".png", np.zeros((480, 640, 3), np.uint8))[1].tobytes(), dtype=np.uint8)
    for k in range(20):
        at_ns = 10 * SECOND_NS + k * 20_000_000
        yield at_ns, "/head_pose", "geometry_msgs/msg/Pose", head_message(at_ns)
        if k % 5 == 4:
            image = {"header": MAKE.header(at_ns - 53_000_000, "camera"), "format": "png", "data": pixels}
            yield at_ns, "/image/compressed", roles.COMPRESSED_IMAGE, CODEC.make(roles.COMPRESSED_IMAGE, **image)


def test_the_head_places_the_camera_in_a_bag(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "pan.mcap", CODEC)
    for at_ns, topic, kind, message in panned():
        writer.write(topic, kind, at_ns, CODEC.encode(kind, message))
    writer.close()
    write_yaml(tmp_path / "camera.yaml", CAMERA.mapping())
    options = BagOptions(field="hsl-s-9x6", camera=tmp_path / "camera.yaml")
    recording = open_source(tmp_path / "pan.mcap", options=options)
    assert recording.sequence["topics"]["head"] == "/head_pose"
    frames = list(recording)
    assert len(frames) == 4
    epoch_ns = recording.sequence["clock_starts_at_ns"]
    for frame in frames:
        assert frame.image is not None
        assert_same(frame.base_from_camera, head_at(frame.stamp_ns + epoch_ns))


def test_the_head_places_the_camera_live(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stamped when they are received, by the clock of this machine."""
    reader, sights = RosReader(camera=CAMERA), []
    for at_ns, _, kind, message in panned():
        monkeypatch.setattr(time, "time_ns", lambda now_ns=at_ns: now_ns)
        role = roles.IMAGE if kind == roles.COMPRESSED_IMAGE else roles.HEAD
        sights += [each for each in reader.read(role, message) if isinstance(each, Sight)]
    assert len(sights) == 4
    for sight in sights:
        assert isinstance(sight.image, bytes)
        assert_same(sight.base_from_camera, head_at(sight.stamp_ns))


def assert_same(pose: Pose3 | None, expected: Pose3) -> None:
    assert pose is not None
    np.testing.assert_allclose(pose.rotation, expected.rotation, atol=1e-6)
    np.testing.assert_allclose(pose.translation_m, expected.translation_m, atol=1e-6)
