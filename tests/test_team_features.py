"""What teams' own detectors say on their own topics: Booster's robots, soccer_vision_3d_msgs; read from bags."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import Drive, open_drive
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from team_writing import BOOSTER_TYPES, EPOCH_NS, SOCCER_VISION_TYPES, TeamMessages, write_bag

from touchline.geometry import Pose3
from touchline.sources import Recording, open_source
from touchline.sources.bags import roles
from touchline.sources.bags.gathering import Gathering
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.roles import BagOptions, choose_topics
from touchline.sources.bags.team_features import feature_rows
from touchline.sources.bags.with_rosbags import Codec
from touchline.sources.observations import observation_of
from touchline.sources.problems import ProblemLog
from touchline.types import Crossings, Landmarks, Lines, Observation, generic_covariances

FIELD = "hsl-s-9x6"
SECOND_NS = 1_000_000_000


@cache
def walked() -> Drive:
    return open_drive("walk-hsl")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("booster") / "walk.mcap"
    write_bag(walked(), path, 3)
    return path


def read(path: Path, **options: Any) -> Recording:
    recording = open_source(path, options=BagOptions(field=FIELD, **options))
    assert isinstance(recording, Recording)
    return recording


def seen() -> Observation:
    """Two crossings, of one the orientation is unknown, a mark, a circle, a post and a line."""
    crossings, marks = np.array([[1.0, 2.0], [2.5, -1.0], [3.0, 0.5]]), np.array([[2.0, 0.0], [3.0, 1.0], [4.0, -1.5]])
    ends = np.array([[[1.0, 1.0], [3.0, 1.5]]])
    return Observation(
        SECOND_NS,
        lines=Lines(ends, generic_covariances(ends.reshape(-1, 2)).reshape(-1, 2, 2, 2), np.array([0.9]), ends * 0.0),
        crossings=Crossings(
            np.array(["L", "T", "X"]), crossings, np.array([0.7, -2.0, np.nan]), generic_covariances(crossings),
            np.array([0.5, 0.75, 1.0]), crossings * np.nan,
        ),
        landmarks=Landmarks(
            np.array(["penalty_mark", "circle", "post"]), marks, generic_covariances(marks), np.ones(3), ((), (), ()),
            marks * np.nan,
        ),
    )  # fmt: skip


def through(message: Any, kind: str, base_from_sensor: Pose3 | None = None) -> list[dict[str, str]]:
    """Rows of a message that went over the wire."""
    codec = Codec()
    role = next(role for role in roles.FEATURES if kind in roles.ROLES[role])
    back = codec.decode(Topic("/seen", kind, "cdr", None, 1), codec.encode(kind, message))
    return feature_rows(role, back, base_from_sensor or Pose3.identity())


def test_a_bag_of_a_booster_robot_is_its_walk(bag: Path) -> None:
    recording = read(bag)
    assert recording.sequence["topics"] == {
        "detections": "/booster_soccer/detection",
        "lines": "/booster_soccer/line_segments",
        "odometry": "/odometer_state",
        "imu": "/low_state",
    }
    told = walked()
    assert len(recording) == len(told.frames)
    for frame, known in zip(recording, told.frames, strict=True):
        found, sent = frame.observation, known.observation
        assert found is not None
        assert sent is not None
        assert abs(frame.stamp_ns - EPOCH_NS - known.stamp_ns) < 250
        assert found.crossings.kinds.tolist() == sorted(sent.crossings.kinds, key="LTX".index)
        assert sorted(found.crossings.positions_m.ravel()) == pytest.approx(
            sorted(sent.crossings.positions_m.ravel()), abs=1e-5
        )
        known_m = sent.lines.ends_m[np.isfinite(sent.lines.ends_m).all(axis=(1, 2))]
        assert found.lines.ends_m == pytest.approx(known_m, abs=1e-5)
        assert set(found.landmarks.kinds) == set(sent.landmarks.kinds) & {"post", "penalty_mark"}
    odometry = np.concatenate([f.odometry.values for f in recording if f.odometry is not None])
    sent_odometry = np.concatenate([f.odometry.values for f in told.frames if f.odometry is not None])
    assert odometry[:100] == pytest.approx(sent_odometry[:100], abs=1e-5)


def test_samples_without_stamps_are_moved_as_told(bag: Path) -> None:
    plain, late = (next(frame for frame in read(bag, late_ms=ms) if frame.odometry is not None) for ms in (0.0, 40.0))
    assert plain.odometry is not None
    assert late.odometry is not None
    assert plain.odometry.stamp_ns[0] - late.odometry.stamp_ns[0] == pytest.approx(40_000_000, abs=500)
    given = BagOptions(field=FIELD, late_ms=40.0)
    assert BagOptions.from_dict(given.to_dict()) == given


def test_soccer_vision_messages_hold_kinds_places_orientations_and_confidences() -> None:
    markings, posts = TeamMessages(Codec()).soccer_vision(SECOND_NS, seen())
    back = observation_of(SECOND_NS, [*through(markings.message, markings.kind), *through(posts.message, posts.kind)])
    for kind in ("crossings", "landmarks"):
        ours, sent = getattr(back, kind), getattr(seen(), kind)
        assert sorted(ours.kinds) == sorted(sent.kinds)
        assert ours.positions_m[np.argsort(ours.kinds)] == pytest.approx(sent.positions_m[np.argsort(sent.kinds)])
    assert back.crossings.orientations_rad[:2] == pytest.approx([0.7, -2.0])
    assert math.isnan(back.crossings.orientations_rad[2])
    assert back.crossings.confidences == pytest.approx([0.5, 0.75, 1.0])
    assert back.lines.ends_m == pytest.approx(seen().lines.ends_m)


def test_places_come_into_the_base_frame() -> None:
    markings, _ = TeamMessages(Codec()).soccer_vision(SECOND_NS, seen())
    for each in markings.message.intersections:
        each.confidence.confidence = -1.0
    turned = Pose3.from_roll_pitch_yaw(0.0, 0.0, 0.5 * math.pi, (0.5, 0.0, 0.0))
    back = observation_of(SECOND_NS, through(markings.message, markings.kind, turned)).crossings
    assert (back.confidences == 1.0).all()
    assert back.positions_m[0] == pytest.approx([-1.5, 1.0])
    assert back.orientations_rad[0] == pytest.approx(0.7 + 0.5 * math.pi)


def test_what_has_no_place_on_the_ground_is_left_out() -> None:
    codec = Codec()
    detection, segments = TeamMessages(codec).booster(SECOND_NS, seen())
    detection.message.detected_objects[0].position_projection = np.array([np.nan, 1.0], dtype=np.float32)
    detection.message.detected_objects[1].position_projection = np.zeros(0, dtype=np.float32)
    detection.message.detected_objects[2].label = "Ball"
    segments.message.coordinates = np.array([1.0, 2.0, 3.0], dtype=np.float32)
    assert len(through(detection.message, detection.kind)) == len(detection.message.detected_objects) - 3
    assert through(segments.message, segments.kind) == []


def test_features_are_taken_before_images_unless_these_are_named() -> None:
    def topics(*kinds: str) -> dict[str, Topic]:
        return {f"/{number}": Topic(f"/{number}", kind, "cdr", None, 5) for number, kind in enumerate(kinds)}

    there = topics("sensor_msgs/msg/Image", SOCCER_VISION_TYPES["/soccer_vision/markings"], "sensor_msgs/msg/Imu")
    assert set(choose_topics(there, {}, ProblemLog())) == {"markings", "imu"}
    assert set(choose_topics(there, {"image": "/0"}, ProblemLog())) == {"image", "markings", "imu"}


def test_a_clock_unlike_the_stamps_is_set_right(tmp_path: Path) -> None:
    codec, kind = Codec(), "booster_interface/msg/Odometer"
    make = TeamMessages(codec)
    with Ros2Writer(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        opened = {
            name: writer.add_connection(name, each, typestore=codec.standard) for name, each in BOOSTER_TYPES.items()
        }
        for k in range(10):
            log_ns = 1_763_780_000 * SECOND_NS + k * SECOND_NS // 10
            for each in make.booster(20 * SECOND_NS + k * SECOND_NS // 10, seen()):
                writer.write(opened[each.topic], log_ns, codec.encode(each.kind, each.message))
            writer.write(
                opened["/odometer_state"], log_ns, codec.encode(kind, make.odometer(0.1 * k, 0.0, 0.0).message)
            )
    recording = read(tmp_path / "bag")
    frames = list(recording)
    assert any("moved by as much" in each.message for each in recording.problems)
    assert frames[-1].odometry is not None
    assert abs(int(frames[-1].odometry.stamp_ns[-1]) - frames[-1].stamp_ns) < SECOND_NS // 5


def test_parts_of_an_image_are_gathered_in_time() -> None:
    both: Gathering[str] = Gathering(100)
    both.expect("lines")
    both.add("crossings", 10, ["a"], 20)
    assert list(both.ready(25)) == []
    both.add("lines", 10, ["b"], 30)
    both.add("crossings", 20, ["c"], 30)
    assert list(both.ready(30)) == [(10, ["a", "b"])]
    both.add("lines", 30, [], 40)  # the lines of the second image will not come any more
    assert list(both.ready(40)) == [(20, ["c"])]
    assert list(both.ready(139)) == []
    assert list(both.ready(140)) == [(30, [])]
    both.add("crossings", 20, ["late"], 150)
    both.add("crossings", 40, ["d"], 150)
    assert (list(both.rest()), both.late) == ([(40, ["d"])], 1)
