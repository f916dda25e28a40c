"""The link to ROS's topics against a stand-in for rclpy; tests/ros_node.py (`make ros`) takes the real one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import fake_rclpy
import numpy as np
import pytest
from fake_rclpy import Durability, Node, Reliability, Ros
from team_writing import BOOSTER_TYPES, TeamMessages

from touchline.cli import main
from touchline.field import open_field
from touchline.geometry import Pose, Pose3
from touchline.live import ros_link, ros_node
from touchline.live.heard import Heard, Picture, Published, Reading, Sight
from touchline.live.ros_link import RosLink, RosOptions, RosRobot
from touchline.live.ros_node import RosNode
from touchline.live.ros_writer import RosWriter
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.with_rosbags import Codec
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
)

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
STRING, ODOMETRY = "std_msgs/msg/String", "nav_msgs/msg/Odometry"


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Ros:
    """And no long waits."""
    monkeypatch.setattr(ros_link, "SETTLE_S", 0.02)
    monkeypatch.setattr(ros_node, "_LOOK_S", 0.01)
    return fake_rclpy.install(monkeypatch)


def opened(namespace: str = "", **options: Any) -> RosLink:
    return RosLink(RosNode(namespace=namespace), RosOptions(**options))


def robot_of(camera: Any = None) -> RosRobot:
    return RosRobot(RosNode("touchline_play"), camera)


def heard_by(link: RosLink, until: Callable[[list[Heard]], object]) -> list[Heard]:
    heard: list[Heard] = []
    ends_s = time.monotonic() + 5.0
    while not until(heard) and time.monotonic() < ends_s:
        heard += link.hear(0.01)
    return heard


def has_sight(heard: list[Heard]) -> bool:
    return any(isinstance(each, Sight) for each in heard)


def subscriptions(ros: Ros) -> dict[str, Any]:
    """Topics that the link reads, and how."""
    return {each.topic: each.qos for each in ros.node("touchline").subscriptions}


def decoded(codec: Codec, node: Node, received: dict[str, bytes]) -> dict[str, Any]:
    kinds = {name: kinds[0] for name, kinds in node.get_topic_names_and_types()}
    return {name: codec.decode(Topic(name, kinds[name], "cdr", None, 1), data) for name, data in received.items()}


def test_topics_are_read_as_their_publishers_offer_them(ros: Ros) -> None:
    link, robot, codec = opened(), ros.create_node("robot"), Codec()
    odometry = robot.offer("/odom", ODOMETRY)
    robot.offer("/image/compressed", "sensor_msgs/msg/CompressedImage", reliable=False)
    robot.offer("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
    robot.offer("/tf", "tf2_msgs/msg/TFMessage")
    robot.offer("/imu", "missing_msgs/msg/Imu")
    heard_by(link, lambda heard: len(subscriptions(ros)) == 4)
    assert {name: (qos.reliability, qos.durability) for name, qos in subscriptions(ros).items()} == {
        "/odom": (Reliability.RELIABLE, Durability.VOLATILE),
        "/image/compressed": (Reliability.BEST_EFFORT, Durability.VOLATILE),
        "/tf_static": (Reliability.RELIABLE, Durability.TRANSIENT_LOCAL),
        "/tf": (Reliability.RELIABLE, Durability.VOLATILE),
    }
    for out in RosWriter(codec).played(Reading("odometry", 7, (1.0, 2.0, 0.5))):
        odometry.publish(codec.encode(out.kind, out.message))
    odometry.publish(b"\0\1\0\0none")
    heard = heard_by(link, lambda heard: heard and link.refused)
    assert [each.stamp_ns for each in heard if isinstance(each, Reading)] == [7]
    assert any("/odom that can't be used" in what for what in link.refused)
    link.close()
    assert not ros.running
    assert [node.name for node in ros.nodes] == ["robot"]


def test_a_recording_played_by_one_node_is_heard_by_another_as_it_was_recorded(ros: Ros) -> None:
    link, robot = opened(topics={"compass": "/imu/data"}), robot_of()
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
    heard_by(link, lambda heard: {"image", "odometry", "imu", "compass", "tf"} <= set(link.topics))
    for event in sent:
        robot.send(event)
    heard = heard_by(link, has_sight)
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


def test_an_estimate_goes_out_as_pose_transform_and_diagnostics(ros: Ros) -> None:
    link, other, codec = opened("/robot1", field=open_field("msl-18x12")), ros.create_node("other"), Codec()
    estimate = Estimate(7_000_000_000, Pose(2.0, 1.0, 0.5), np.diag([0.01, 0.02, 0.03]), Status.TRACKING, points=88)
    slips = (Problem(ProblemCode.ODOMETRY_SCALE, "slips"),)
    estimate = replace(estimate, protection_m=0.06, statistics={"motion": 0.25}, reason="a twin", problems=slips)
    for topic, kind in {
        "/tf": "tf2_msgs/msg/TFMessage",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        "/robot1/touchline/hypotheses": "geometry_msgs/msg/PoseArray",
    }.items():
        other.listen(topic, kind)
    link.publish(Published(estimate, Pose(1.0, 1.0, 0.0), image=True))
    own = {each.topic: each for each in ros.node("touchline").publishers}
    # what nobody looks at is not made
    assert {name for name, publisher in own.items() if publisher.last is not None} == {
        *("/tf", "/diagnostics", "/robot1/touchline/pose", "/robot1/touchline/hypotheses"),
        *("/robot1/touchline/field_lines", "/robot1/touchline/map"),
    }
    latched = {name for name, each in own.items() if each.qos_profile.durability is Durability.TRANSIENT_LOCAL}
    assert latched == {"/robot1/touchline/pose", "/robot1/touchline/field_lines", "/robot1/touchline/map"}
    other.listen("/robot1/touchline/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", latched=True)
    found = decoded(codec, other, other.spin())
    pose = found["/robot1/touchline/pose"]
    assert pose.header.frame_id == "map"
    assert (pose.pose.pose.position.x, pose.pose.covariance[7], pose.pose.covariance[35]) == (2.0, 0.02, 0.03)
    moved = found["/tf"].transforms[0]
    assert (moved.header.frame_id, moved.child_frame_id) == ("map", "odom")
    assert (moved.transform.translation.x, moved.transform.translation.y) == (1.0, 1.0)
    (status,) = found["/diagnostics"].status
    values = {pair.key: pair.value for pair in status.values}
    assert (status.level, status.message) == (0, "tracking: a twin; slips")
    assert [values[key] for key in ("points", "protection_m", "motion")] == ["88", "0.06", "0.25"]
    assert "protection_rad" not in values
    assert len(found["/robot1/touchline/hypotheses"].poses) == 1
    link.close()


def test_what_ros_has_no_message_for_and_the_last_imu_come_too(ros: Ros) -> None:
    link, robot, mate, codec = opened(), robot_of(), ros.create_node("mate"), Codec()
    places = np.array([[1.0, 2.0], [2.5, -1.0]])
    sure = generic_covariances(places)
    crossings = Crossings(np.array(["L", "T"]), places, np.array([0.5, np.nan]), sure, np.array([0.5, 1.0]), places)
    landmarks = Landmarks(np.array(["goal"]), places[:1], sure[:1], np.ones(1), (("blue",),), places[:1])
    evidence = mate.offer("/touchline/evidence", STRING)
    heard_by(link, lambda heard: {"image", "odometry", "imu", "said"} <= set(link.topics))
    robot.send(Reading("wheels", 5, (0.25, 0.5)))
    robot.send(Picture(9, None, Observation(9, crossings=crossings, landmarks=landmarks), None))
    said = '{"kind": "evidence", "source": "mate", "probability": 0.8, "own_half": true}'
    evidence.publish(codec.encode(STRING, codec.make(STRING, data=said)))
    robot.send(Reading("gyro", 20, (0.1, 0.2, 0.3)))
    heard = heard_by(link, lambda heard: len(heard) >= 3)
    robot.close()
    heard += heard_by(link, lambda more: len(more) >= 1)
    assert Reading("wheels", 5, (0.25, 0.5)) in heard
    assert Reading("gyro", 20, (0.1, 0.2, 0.3)) in heard
    assert Evidence("mate", 0.8, own_half=True) in heard
    (seen,) = (each.observation for each in heard if isinstance(each, Sight))
    assert seen is not None
    assert seen.crossings.kinds.tolist() == ["L", "T"]
    assert seen.crossings.orientations_rad[0] == pytest.approx(0.5)
    assert seen.landmarks.colors == (("blue",),)
    assert link.refused == {}
    link.close()


def test_a_booster_robot_is_heard_on_its_topics_and_told_its_pose(ros: Ros) -> None:
    link, robot, codec = opened(), ros.create_node("booster"), Codec()
    make = TeamMessages(codec)
    offered = {
        name: robot.offer(f"{name}/robot1" if "soccer" in name else name, kind) for name, kind in BOOSTER_TYPES.items()
    }
    heard_by(link, lambda heard: len(link.topics) == 4)
    robot.listen("/booster_soccer/robot_pose/robot1", "geometry_msgs/msg/Pose2D")
    places = np.array([[1.0, 2.0]])
    crossings = Crossings(np.array(["L"]), places, np.array([np.nan]), generic_covariances(places), np.ones(1), places)
    before_ns = time.time_ns()
    sent = [make.odometer(1.0, 2.0, 0.5), make.low_state((0.01, 0.02, 3.0), (0.1, 0.2, 0.3))]
    for each in [*sent, *make.booster(before_ns, Observation(before_ns, crossings=crossings))]:
        offered[each.topic].publish(codec.encode(each.kind, each.message))
    heard = heard_by(link, has_sight)
    readings = {each.sensor: each for each in heard if isinstance(each, Reading)}
    assert set(readings) == {"odometry", "gyro", "attitude"}
    np.testing.assert_allclose(readings["odometry"].values, (1.0, 2.0, 0.5), atol=1e-6)
    assert before_ns <= readings["odometry"].stamp_ns <= time.time_ns()
    (sight,) = (each for each in heard if isinstance(each, Sight))
    assert sight.stamp_ns == before_ns
    assert sight.observation is not None
    assert sight.observation.crossings.positions_m.tolist() == [[1.0, 2.0]]
    link.publish(Published(Estimate(before_ns, Pose(1.0, -2.0, 0.5), np.eye(3), Status.TRACKING)))
    pose = decoded(codec, robot, robot.spin())["/booster_soccer/robot_pose/robot1"]
    assert (pose.x, pose.y, pose.theta) == (1.0, -2.0, 0.5)
    link.close()


def test_without_stamps_the_time_is_that_of_clock_where_there_is_one(ros: Ros) -> None:
    link, robot, codec = opened(), ros.create_node("robot"), Codec()
    clock = robot.offer("/clock", "rosgraph_msgs/msg/Clock", reliable=False)
    odometer = robot.offer("/odometer_state", "booster_interface/msg/Odometer")
    heard_by(link, lambda heard: len(subscriptions(ros)) == 2)
    time_type = codec.make("builtin_interfaces/msg/Time", sec=12, nanosec=5)
    odometer.publish(codec.encode(odometer.kind, codec.make(odometer.kind, x=1.0, y=0.0, theta=0.0)))
    clock.publish(codec.encode(clock.kind, codec.make(clock.kind, clock=time_type)))
    (reading,) = heard_by(link, bool)
    assert isinstance(reading, Reading)
    assert reading.stamp_ns == 12_000_000_005
    link.close()


# --- the commands -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--namespace", "robot 1"], "letters, digits"),
        (["--listen", "5000"], "--listen: is an option of udp"),
        (["--topic", "colour=/odom"], "--topic colour: is not known"),
        (["--topic", "odometry"], "expected ROLE=/NAME"),
    ],
)
def test_options_that_do_not_go_with_it_are_told(
    ros: Ros, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert main(["live", "ros", "--field", "msl-18x12", "--seconds", "0", *arguments]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_the_command_runs_as_a_node(ros: Ros, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", "ros", "--field", "msl-18x12", "--namespace", "robot1/", "--seconds", "0.1"]) == 0
    said = capsys.readouterr()
    assert "publishes /robot1/touchline/pose" in said.err
    assert "0 of 0 images looked at" in said.out
    assert ros.nodes == []
