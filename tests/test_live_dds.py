"""ROS 2's topics without ROS: what is on the wire, and a recording played from one node to another."""

from __future__ import annotations

import math
import os
import random
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="no wheel of Cyclone DDS for this machine")

from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from foreign_bags import Types, foreign_messages, raw
from small_recordings import borrow
from team_writing import BOOSTER_TYPES, TeamMessages

from touchline.cli import live, main
from touchline.errors import InputError
from touchline.geometry import Pose, Pose3
from touchline.live import ros_link
from touchline.live.dds import Dds, DdsNode
from touchline.live.dds_types import Cdr, dds_name, ros_name, sample, sample_type
from touchline.live.heard import Described, Heard, Picture, Published, Reading, Sight, Start
from touchline.live.ros import RosReader
from touchline.live.ros_link import UNUSABLE, RosLink, RosOptions, RosRobot
from touchline.live.ros_topics import FIXED_TOPICS
from touchline.live.ros_writer import RosWriter
from touchline.localizer import Localizer
from touchline.sources import open_source
from touchline.sources.bags.camera_file import ros_camera
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.result_messages import Outgoing
from touchline.sources.bags.roles import ROLES
from touchline.sources.bags.with_rosbags import BadMessageError, Codec
from touchline.types import (
    Crossings,
    Estimate,
    Evidence,
    Landmarks,
    Observation,
    Problem,
    ProblemCode,
    Status,
    generic_covariances,
    points_at,
)

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
BGR8 = raw("bgr8", lambda pixels: pixels)
BEST_EFFORT = Qos(Policy.Reliability.BestEffort, Policy.DataRepresentation(use_cdrv0_representation=True))
RELIABLE = Qos(Policy.Reliability.Reliable(10**8), Policy.DataRepresentation(use_cdrv0_representation=True))


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch, worker_id: str) -> None:
    """A domain for each process of the tests, and no long waits."""
    monkeypatch.setenv(
        "ROS_DOMAIN_ID", str(100 + int(worker_id.removeprefix("gw") or 0) if worker_id != "master" else 99)
    )
    monkeypatch.setattr(ros_link, "SETTLE_S", 0.3)


def dds_link(**options: Any) -> RosLink:
    asked = RosOptions(**options)
    return RosLink(Dds(asked.namespace), asked)


def send(node: DdsNode, out: Outgoing) -> None:
    node.write(out.topic, out.kind, node.codec.encode(out.kind, out.message))


def waited(look: Callable[[], Any]) -> Any:
    """What it returns once that is something."""
    ends_s = time.monotonic() + 10.0
    while not (found := look()) and time.monotonic() < ends_s:
        time.sleep(0.005)
    return found


def test_types_are_named_as_ros_2_names_them() -> None:
    assert dds_name("nav_msgs/msg/Odometry") == "nav_msgs::msg::dds_::Odometry_"
    assert ros_name("nav_msgs::msg::dds_::Odometry_") == "nav_msgs/msg/Odometry"
    assert ros_name("nav_msgs::srv::dds_::Get_Request_") is None
    assert ros_name("Odometry") is None


def test_a_sample_is_the_message_s_bytes_there_and_back() -> None:
    codec = Codec()
    message = RosWriter(codec)._make.odometry(5_000_000_001, 1.0, -2.0, 0.5)
    cdr = codec.encode("nav_msgs/msg/Odometry", message)
    assert sample("nav_msgs/msg/Odometry", cdr).serialize(use_version_2=False) == cdr
    back = sample_type("nav_msgs/msg/Odometry").deserialize(cdr)
    assert isinstance(back, Cdr)
    again = codec.decode(Topic("/odom", "nav_msgs/msg/Odometry", "cdr", None, 1), back)
    assert (again.pose.pose.position.x, again.header.stamp.nanosec) == (1.0, 1)


def test_a_recording_played_by_one_node_is_heard_by_another_as_it_was_recorded() -> None:
    link, robot = dds_link(topics={"compass": "/imu/data"}), RosRobot(Dds())
    sent: list[Reading | Picture] = []
    data = (EXAMPLE / "images" / "000003.jpg").read_bytes()
    for k in range(20):
        stamp = 10_000_000 * (k + 1)
        sent += [
            Reading("odometry", stamp, (0.1 * k, 0.2, 0.3)),
            Reading("gyro", stamp, (0.1, 0.2, 0.01 * k)),
            Reading("compass", stamp, (1.5,)),
        ]
    sent.append(Picture(200_000_000, data, None, Pose3.from_roll_pitch_yaw(0.0, 0.3, 0.1, (0.1, 0.0, 1.0))))
    heard: list[Heard] = []
    waited(lambda: heard.extend(link.hear(0.01)) or len(link.topics) == 6)
    for event in sent:
        robot.send(event)
    waited(lambda: heard.extend(link.hear(0.05)) or any(isinstance(each, Sight) for each in heard))
    readings = [each for each in heard if isinstance(each, Reading)]
    odometry = [each for each in readings if each.sensor == "odometry"]
    assert [each.stamp_ns for each in odometry] == [10_000_000 * (k + 1) for k in range(20)]
    np.testing.assert_allclose(odometry[7].values, (0.7, 0.2, 0.3), atol=1e-12)
    compass = [each for each in readings if each.sensor == "compass"]
    assert len(compass) == 20
    assert compass[0].values[0] == pytest.approx(1.5)
    (sight,) = (each for each in heard if isinstance(each, Sight))
    assert sight.image == data
    assert sight.base_from_camera is not None
    np.testing.assert_allclose(sight.base_from_camera.translation_m, (0.1, 0.0, 1.0), atol=1e-12)
    assert link.refused == {}
    robot.close()
    link.close()


def test_an_estimate_goes_out_as_pose_transform_and_diagnostics() -> None:
    link, other = dds_link(namespace="/robot1"), DdsNode("listener")
    kinds = {
        "/robot1/touchline/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    }
    readers = {name: other.reader(name, kind, RELIABLE) for name, kind in kinds.items()}
    estimate = Estimate(7_000_000_000, Pose(2.0, 1.0, 0.5), np.diag([0.01, 0.02, 0.03]), Status.TRACKING, points=88)
    slips = (Problem(ProblemCode.ODOMETRY_SCALE, "slips"),)
    estimate = replace(estimate, protection_m=0.06, statistics={"motion": 0.25}, reason="a twin", problems=slips)
    found: dict[str, Any] = {}

    def told() -> bool:
        link.publish(Published(estimate, Pose(1.0, 1.0, 0.0), image=True))
        for name, reader in readers.items():
            for each in reader.take(10):
                found[name] = other.codec.decode(Topic(name, kinds[name], "cdr", None, 1), each)
        return len(found) == 3

    assert waited(told)
    pose = found["/robot1/touchline/pose"]
    assert pose.header.frame_id == "map"
    assert (pose.pose.pose.position.x, pose.pose.covariance[7], pose.pose.covariance[35]) == (2.0, 0.02, 0.03)
    moved = found["/tf"].transforms[0]
    assert (moved.header.frame_id, moved.child_frame_id) == ("map", "odom")
    assert (moved.transform.translation.x, moved.transform.translation.y) == (1.0, 1.0)
    (status,) = found["/diagnostics"].status
    values = {pair.key: pair.value for pair in status.values}
    assert (status.level, status.message) == (0, "tracking: a twin; slips")
    named = ("points", "protection_m", "motion", "odometry-scale")
    assert [values[key] for key in named] == ["88", "0.06", "0.25", "slips"]
    assert "protection_rad" not in values
    link.close()
    other.close()


def test_a_node_is_seen_by_ros() -> None:
    link, other = dds_link(namespace="/robot1"), DdsNode("other")
    kept = Qos(
        Policy.Reliability.Reliable(10**8),
        Policy.Durability.TransientLocal,
        Policy.History.KeepAll,
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
    kind = "rmw_dds_common/msg/ParticipantEntitiesInfo"
    reader = DataReader(other.participant, other._topic("ros_discovery_info", kind), qos=kept)
    nodes: set[tuple[str, str]] = set()

    def found() -> bool:
        for each in reader.take(10):
            message = other.codec.decode(Topic("", kind, "cdr", None, 1), each)
            nodes.update((node.node_namespace, node.node_name) for node in message.node_entities_info_seq)
        return ("/robot1", "touchline") in nodes

    assert waited(found)
    link.close()
    other.close()


def test_what_ros_has_no_message_for_and_the_last_imu_come_too() -> None:
    link, robot = dds_link(), RosRobot(Dds())
    places = np.array([[1.0, 2.0], [2.5, -1.0]])
    sure = generic_covariances(places)
    crossings = Crossings(np.array(["L", "T"]), places, np.array([0.5, np.nan]), sure, np.array([0.5, 1.0]), places)
    landmarks = Landmarks(np.array(["goal"]), places[:1], sure[:1], np.ones(1), (("blue",),), places[:1])
    heard: list[Heard] = []
    robot._transport.announce("/touchline/evidence", "std_msgs/msg/String")
    waited(lambda: heard.extend(link.hear(0.01)) or {"image", "odometry", "imu", "said"} <= set(link.topics))
    time.sleep(0.3)  # until both ends know each other
    robot.send(Reading("wheels", 5, (0.25, 0.5)))
    robot.send(Picture(9, None, Observation(9, crossings=crossings, landmarks=landmarks), None))
    said, kind = '{"kind": "evidence", "source": "mate", "probability": 0.8, "own_half": true}', "std_msgs/msg/String"
    robot._publish([Outgoing("/touchline/evidence", kind, robot._codec.make(kind, data=said))])
    robot.send(Reading("gyro", 20, (0.1, 0.2, 0.3)))
    waited(lambda: heard.extend(link.hear(0.05)) or len(heard) >= 3)
    for out in robot._writer.rest():  # as when it ends
        robot._publish([out])
    waited(lambda: heard.extend(link.hear(0.05)) or len(heard) >= 4)
    assert Reading("wheels", 5, (0.25, 0.5)) in heard
    assert Reading("gyro", 20, (0.1, 0.2, 0.3)) in heard
    assert Evidence("mate", 0.8, own_half=True) in heard
    (seen,) = (each.observation for each in heard if isinstance(each, Sight))
    assert seen is not None
    assert seen.crossings.kinds.tolist() == ["L", "T"]
    assert seen.crossings.orientations_rad[0] == pytest.approx(0.5)
    assert seen.landmarks.colors == (("blue",),)
    assert link.refused == {}
    robot.close()
    link.close()


def test_a_booster_robot_is_heard_on_its_topics_and_told_its_pose() -> None:
    link, robot = dds_link(), DdsNode("booster")
    make = TeamMessages(robot.codec)
    for name, kind in BOOSTER_TYPES.items():
        robot.announce(f"{name}/robot1" if "soccer" in name else name, kind)
    heard: list[Heard] = []
    waited(lambda: heard.extend(link.hear(0.01)) or len(link.topics) == 4)
    reader = robot.reader("/booster_soccer/robot_pose/robot1", "geometry_msgs/msg/Pose2D", RELIABLE)
    time.sleep(0.3)  # until both ends know each other
    places = np.array([[1.0, 2.0]])
    crossings = Crossings(np.array(["L"]), places, np.array([np.nan]), generic_covariances(places), np.ones(1), places)
    before_ns = time.time_ns()
    for each in (make.odometer(1.0, 2.0, 0.5), make.low_state((0.01, 0.02, 3.0), (0.1, 0.2, 0.3))):
        send(robot, Outgoing(*each))
    for each in make.booster(before_ns, Observation(before_ns, crossings=crossings)):
        send(robot, Outgoing(f"{each.topic}/robot1", each.kind, each.message))
    waited(lambda: heard.extend(link.hear(0.05)) or any(isinstance(each, Sight) for each in heard))
    readings = {each.sensor: each for each in heard if isinstance(each, Reading)}
    assert set(readings) == {"odometry", "gyro", "attitude"}
    np.testing.assert_allclose(readings["odometry"].values, (1.0, 2.0, 0.5), atol=1e-6)
    assert before_ns <= readings["odometry"].stamp_ns <= time.time_ns()
    (sight,) = (each for each in heard if isinstance(each, Sight))
    assert sight.stamp_ns == before_ns
    assert sight.observation is not None
    assert sight.observation.crossings.positions_m.tolist() == [[1.0, 2.0]]
    estimate = Estimate(before_ns, Pose(1.0, -2.0, 0.5), np.eye(3), Status.TRACKING)
    taken = waited(
        lambda: link.publish(Published(estimate)) or [each for each in reader.take(1) if isinstance(each, Cdr)]
    )
    pose = robot.codec.decode(Topic("/pose", "geometry_msgs/msg/Pose2D", "cdr", None, 1), taken[0])
    assert (pose.x, pose.y, pose.theta) == (1.0, -2.0, 0.5)
    link.close()
    robot.close()


def test_mutated_messages_do_no_harm() -> None:
    """Bytes as the network brings them, through decoder and reader; `make test-all` takes ten thousand."""
    count = int(os.environ.get("TOUCHLINE_MUTATED", "600"))
    chance, reader, codec = random.Random(1), RosReader(), Codec()
    good = list(sent_messages(codec))
    used = 0
    for k in range(count):
        role, topic, data = good[k % len(good)]
        changed = bytearray(data)
        for _ in range(chance.randint(1, 4)):
            changed[chance.randrange(4, len(changed))] = chance.choice((0, 1, 127, 128, 255, chance.randrange(256)))
        whole = bytes(changed if chance.random() < 0.8 else changed[: chance.randrange(len(changed))])
        try:
            message = codec.decode(topic, whole)
            used += sum(isinstance(each, Reading | Sight | Start | Evidence) for each in reader.read(role, message))
        except UNUSABLE:
            continue
    assert used > count / 10


def sent_messages(codec: Codec) -> Iterator[tuple[str, Topic, bytes]]:
    """One of each kind that is read: its role, its topic, and how it goes over the wire."""
    writer, make = RosWriter(codec), TeamMessages(codec)
    places = np.array([[1.0, 2.0], [2.0, 1.0]])
    crossings = Crossings(np.array(["L", "X"]), places, np.zeros(2), generic_covariances(places), np.ones(2), places)
    seen = Observation(10**9, points=points_at(places), crossings=crossings)
    data = (EXAMPLE / "images" / "000003.jpg").read_bytes()[:500]
    played = [
        Reading("odometry", 10**9, (1.0, 2.0, 0.3)),
        Reading("wheels", 10**9, (1.0, 2.0)),
        Reading("gyro", 10**9, (0.1, 0.2, 0.3)),
        Picture(10**9, data, None, Pose3.identity()),
        Picture(10**9, None, seen, None),
    ]
    outs = [out for each in played for out in writer.played(each)]
    outs += [Outgoing(*each) for each in (*make.booster(10**9, seen), *make.soccer_vision(10**9, seen))]
    outs += [Outgoing(*make.odometer(1.0, 2.0, 0.3)), Outgoing(*make.low_state((0.0, 0.0, 0.0), (0.1, 0.2, 0.3)))]
    start = writer._make.pose(1, 1.0, 2.0, -3.0, covariance=np.zeros(36))
    outs.append(Outgoing("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", start))
    by_kind = {kind: role for role, kinds in ROLES.items() for kind in kinds if role not in ("truth", "compass")}
    for out in outs:
        role = FIXED_TOPICS.get(out.topic) or by_kind[out.kind]
        yield role, Topic(out.topic, out.kind, "cdr", None, 1), codec.encode(out.kind, out.message)


def test_of_several_that_could_be_it_the_named_one_is_read_and_a_wrong_type_is_told() -> None:
    link = dds_link(topics={"odometry": "/wheel/odom", "imu": "/odom"})
    robot = DdsNode("robot")
    for name in ("/odom", "/wheel/odom"):
        robot.announce(name, "nav_msgs/msg/Odometry")
    waited(lambda: link.hear(0.01) or link.refused)
    assert "odometry" not in link.topics
    assert any("/odom: is a nav_msgs/msg/Odometry" in what for what in link.refused)
    link.close()
    robot.close()


def test_a_message_that_cannot_be_used_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    link, robot = dds_link(), DdsNode("robot")
    robot.announce("/odom", "nav_msgs/msg/Odometry")
    waited(lambda: link.hear(0.01) or "odometry" in link.topics)

    def broken(*_: object) -> None:
        raise BadMessageError("too short")

    monkeypatch.setattr(link._codec, "decode", broken)
    (out,) = RosWriter(robot.codec).played(Reading("odometry", 1, (1.0, 2.0, 3.0)))
    waited(lambda: send(robot, out) or link.hear(0.02) or link.refused)
    assert any("/odom that can't be used (too short)" in what for what in link.refused)
    link.close()
    robot.close()


def test_initialpose_is_a_start_with_the_covariance_of_the_plane() -> None:
    make = RosWriter(Codec())._make
    full = np.zeros((6, 6))
    full[0, 0], full[1, 1], full[5, 5] = 0.25, 0.25, 0.07
    message = make.pose(1, 1.0, 2.0, -3.0, covariance=full.ravel())
    (start,) = RosReader().read("initialpose", message)
    assert isinstance(start, Start)
    assert start.pose is not None
    np.testing.assert_allclose(start.pose, (1.0, 2.0, -3.0))
    assert start.covariance is not None
    assert np.diag(start.covariance).tolist() == [0.25, 0.25, 0.07]


def test_an_imu_without_orientation_is_no_compass() -> None:
    message = RosWriter(Codec())._make.imu(1, (math.nan,) * 3, (0.1, 0.2, 0.3))
    assert list(RosReader().read("imu", message, with_compass=True)) == [Reading("gyro", 1, (0.1, 0.2, 0.3))]


@pytest.mark.parametrize("text", ["x", "-1", "233"])
def test_a_domain_that_is_none_is_told(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(InputError, match="ROS_DOMAIN_ID"):
        DdsNode("x")


@pytest.mark.parametrize(
    ("name", "value"), [("ROS_LOCALHOST_ONLY", "1"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost")]
)
def test_what_ros_says_of_how_far_it_reaches_counts(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(name, value)
    with pytest.raises(InputError, match=name):
        DdsNode("x", network=True)


def test_the_example_s_images_are_played_as_they_are() -> None:
    writer = RosWriter(Codec())
    data = open_source(EXAMPLE).image_bytes(0)
    (out,) = writer.played(Picture(1, data, None, None))
    assert bytes(out.message.data) == data
    assert out.message.format == "jpeg"


def test_a_played_recording_tells_its_camera_and_how_it_leans(small_data: Path) -> None:
    source = open_source(small_data / "humanoid_9x6_walk")
    link, robot = dds_link(), RosRobot(Dds(), ros_camera(source))
    heard: list[Heard] = []
    waited(lambda: heard.extend(link.hear(0.01)) or {"camera_info", "image", "imu"} <= set(link.topics))
    robot.send(Reading("attitude", 100_000_000, (0.05, -0.02)))
    robot.send(Picture(100_000_000, source.image_bytes(0), None, None))
    waited(lambda: heard.extend(link.hear(0.05)) or any(isinstance(each, Sight) for each in heard))
    (described,) = (each for each in heard if isinstance(each, Described))
    (sight,) = (each for each in heard if isinstance(each, Sight))
    assert described.camera.fx == pytest.approx(source.camera.fx)
    leaned = Pose3.from_roll_pitch_yaw(0.05, -0.02, 0.0).compose(source.camera.base_from_camera)
    assert sight.base_from_camera is not None
    np.testing.assert_allclose(sight.base_from_camera.translation_m, leaned.translation_m, atol=1e-9)
    np.testing.assert_allclose(sight.base_from_camera.rotation, leaned.rotation, atol=1e-9)
    robot.close()
    link.close()


def test_a_late_image_is_played_with_the_lean_of_its_own_time(small_data: Path) -> None:
    camera = ros_camera(open_source(small_data / "humanoid_9x6_walk"))
    assert camera is not None
    codec, reader, heard = Codec(), RosReader(), []
    writer = RosWriter(codec, camera=camera)
    image = (EXAMPLE / "images" / "000003.jpg").read_bytes()
    leans = [Reading("attitude", 100_000_000 * k, (0.02 * k, 0.0)) for k in range(1, 6)]
    roles = {"/tf": "tf", "/camera_info": "camera_info", "/image/compressed": "image", "/imu/data": "imu"}
    first, late = (Picture(stamp_ns, image, None, None) for stamp_ns in (200_000_000, 300_000_000))
    for event in (*leans[:2], first, *leans[2:], late):
        for out in writer.played(event):
            data = codec.encode(out.kind, out.message)
            heard += reader.read(roles[out.topic], codec.decode(Topic(out.topic, out.kind, "cdr", None, 1), data))
    found = [each.base_from_camera for each in heard if isinstance(each, Sight)][1]
    assert found is not None
    leaned = Pose3.from_roll_pitch_yaw(0.06, 0.0, 0.0).compose(camera.base_from_camera)
    np.testing.assert_allclose(found.rotation, leaned.rotation, atol=1e-6)


def test_a_mirror_is_no_camera_that_ros_knows() -> None:
    assert ros_camera(open_source(EXAMPLE)) is None


def test_camera_info_and_transforms_are_the_camera_and_the_odometry(small_data: Path, tmp_path: Path) -> None:
    """A robot that speaks by rosbags' own codec: TF at every step, CameraInfo, no odometry topic."""
    source = open_source(borrow(small_data / "humanoid_hsl_pan", tmp_path / "robot", frames=3))
    types, reader = Types(), RosReader()
    reader.odometry_by_transforms = True
    heard: list[Heard] = []
    kinds = {"/tf": "tf", "/tf_static": "tf", "/front/camera_info": "camera_info", "/front/image_raw": "image"}
    for time_ns, topic, kind, message in foreign_messages(source, types, BGR8, "/front/image_raw"):
        if topic == "/robot/odom":
            place, turn = message.pose.pose.position, message.pose.pose.orientation
            pose = Pose3.from_roll_pitch_yaw(0.0, 0.0, 2.0 * math.atan2(turn.z, turn.w), (place.x, place.y, 0.0))
            moved = types.transforms(types.transform(time_ns, "odom", "base_footprint", pose))
            topic, kind, message = "/tf", "tf2_msgs/msg/TFMessage", moved
        if topic in kinds:
            data = bytes(types.store.serialize_cdr(message, kind))
            heard += reader.read(kinds[topic], Codec().decode(Topic(topic, kind, "cdr", None, 1), data))
    (described,) = (each for each in heard if isinstance(each, Described))
    assert described.camera.fx == pytest.approx(source.camera.fx)
    first = heard.index(described)
    assert not any(isinstance(each, Sight) for each in heard[:first])
    assert sum(isinstance(each, Reading) and each.sensor == "odometry" for each in heard) > 10
    localizer = Localizer(source.field)
    localizer.reset(own_half=True)
    localizer.use_camera(described.camera)
    sight = next(each for each in heard if isinstance(each, Sight))
    assert isinstance(sight.image, np.ndarray)
    found = localizer.localize(sight.stamp_ns, image=sight.image, base_from_camera=sight.base_from_camera)
    assert found.points > 0
    assert found.pose.x < 0.0
    assert localizer.problems == {}


def test_a_link_that_hears_nothing_says_where_it_listens_and_fails(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "_SILENT_S", 0.2)
    assert main(["live", "--dds", "--field", "msl-18x12", "--seconds", "1"]) == 1
    said = capsys.readouterr().err
    assert "no topic was found; domain 99" in said or "no topic was found; domain 1" in said
    assert "--network goes beyond it" in said
