"""ros/touchline_ros under a real rclpy: a publisher and a listener that use rclpy alone. `make ros`.

It needs the wheels of the extra ros-test (x86-64, Python 3.11), and fails where they are missing. They lack tf2_msgs,
nav2_msgs and launch: the transform, the particle cloud and the launch file are not run here.
"""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="pip install 'touchline[ros-test]'")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped, PoseWithCovarianceStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from nav_msgs.msg import OccupancyGrid, Odometry
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.srv import DescribeParameters, ListParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage
from std_srvs.srv import Empty, SetBool, Trigger
from visualization_msgs.msg import MarkerArray

ROOT = Path(__file__).parents[1]
EXAMPLE, PACKAGE = ROOT / "examples" / "omni_msl_track_short", ROOT / "ros" / "touchline_ros"
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PARAMETERS = (f"camera:={EXAMPLE / 'camera.yaml'}", "field:=msl-18x12", "start_pose:=[0.0, 0.0, 0.0]")


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "97")
    monkeypatch.setenv("PYTHONPATH", str(PACKAGE))
    monkeypatch.setenv("PYTHONUNBUFFERED", "1")


class Robot:
    """Publishes the example as a robot would, and keeps what it receives; of rclpy alone."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("robot")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.images = self.node.create_publisher(CompressedImage, "/front/image/compressed", qos_profile_sensor_data)
        self.odometry = self.node.create_publisher(Odometry, "/odom", 10)
        self.received: dict[str, list[Any]] = defaultdict(list)
        with (EXAMPLE / "odometry.csv").open() as file:
            self.samples = [{name: float(cell) for name, cell in row.items()} for row in csv.DictReader(file)]
        with (EXAMPLE / "images.csv").open() as file:
            self.pictures = [(float(row["t"]), EXAMPLE / row["file"]) for row in csv.DictReader(file)]
        rows = (EXAMPLE / "ground_truth.tum").read_text().splitlines()
        self.truth = [row.split() for row in rows if not row.startswith("#")]

    def listen(self, kind: Any, topic: str, qos: Any = 10) -> None:
        self.node.create_subscription(kind, topic, self.received[topic].append, qos)

    def call(self, kind: Any, service: str, request: Any = None) -> Any:
        client = self.node.create_client(kind, service)
        assert client.wait_for_service(60.0), service
        answer = client.call_async(request or kind.Request())
        assert self.spin_until(answer.done, 120.0), service
        return answer.result()

    def spin_until(self, done: Callable[[], bool], most_s: float) -> bool:
        ends_s = time.monotonic() + most_s
        while not done() and time.monotonic() < ends_s:
            self.executor.spin_once(timeout_sec=0.05)
        return done()

    def play(self, speed: float = 1.0) -> None:
        """Images and samples in the order of time."""
        events = [(row["t"], row) for row in self.samples] + [(t, path) for t, path in self.pictures]
        begun_s = time.monotonic()
        for t, event in sorted(events, key=lambda each: each[0]):
            while time.monotonic() < begun_s + t / speed:
                self.executor.spin_once(timeout_sec=0.001)
            message = Odometry() if isinstance(event, dict) else CompressedImage(format="jpeg")
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(1e9 * t) + 10**18, 10**9)
            if isinstance(event, dict):
                message.pose.pose.position.x, message.pose.pose.position.y = event["x"], event["y"]
                message.pose.pose.orientation.z = math.sin(0.5 * event["theta"])
                message.pose.pose.orientation.w = math.cos(0.5 * event["theta"])
                self.odometry.publish(message)
            else:
                message.data = event.read_bytes()
                self.images.publish(message)

    def start_at_the_truth(self) -> None:
        """Say on /initialpose where it stands, as RViz does."""
        publisher = self.node.create_publisher(PoseWithCovarianceStamped, "/initialpose", 10)
        assert self.spin_until(lambda: publisher.get_subscription_count() > 0, 30)
        place, message = self.truth[0], PoseWithCovarianceStamped()
        message.header.frame_id = "map"
        message.pose.pose.position.x, message.pose.pose.position.y = float(place[1]), float(place[2])
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = float(place[6]), float(place[7])
        message.pose.covariance[0] = message.pose.covariance[7] = message.pose.covariance[35] = 0.01
        publisher.publish(message)
        self.spin_until(lambda: False, 1.0)

    def state(self) -> str:
        """Of the node."""
        return str(self.call(GetState, "/touchline/get_state").current_state.label)

    def change(self, transition: int) -> bool:
        """Whether the node could do it."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.call(ChangeState, "/touchline/change_state", request).success)

    def tracked(self) -> bool:
        """Whether the newest diagnostics say so."""
        newest = self.received["/diagnostics"][-1:]
        return bool(newest) and newest[0].status[0].message.startswith("tracking")


@pytest.fixture
def robot(domain: None) -> Iterator[Robot]:
    made = Robot()
    yield made
    made.node.destroy_node()
    rclpy.shutdown()


@contextmanager
def running(*command: str, log: Path) -> Iterator[Any]:
    with log.open("w") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, env=dict(os.environ))
        try:
            yield process
        finally:
            process.terminate()
            process.wait(timeout=30)


def node_command(*parameters: str) -> list[str]:
    given = [part for each in parameters for part in ("-p", each)]
    return [sys.executable, "-m", "touchline_ros.node", "--ros-args", *given]


def test_the_node_localises_and_publishes_what_ros_s_programs_show(robot: Robot, tmp_path: Path) -> None:
    shown = {
        "/touchline/path": PathMessage,
        "/touchline/hypotheses": PoseArray,
        "/touchline/lines_seen": MarkerArray,
        "/touchline/look": PoseStamped,
        "/touchline/overlay/compressed": CompressedImage,
        "/diagnostics": DiagnosticArray,
    }
    with running(*node_command(*PARAMETERS), log=tmp_path / "log"):
        for topic, kind in shown.items():
            robot.listen(kind, topic)
        assert robot.spin_until(lambda: robot.state() == "active", 60)
        robot.spin_until(lambda: robot.images.get_subscription_count() > 0, 30)
        robot.start_at_the_truth()
        robot.play(0.5)
        robot.spin_until(robot.tracked, 30)
        for topic, kind in {
            "/touchline/field_lines": MarkerArray,
            "/touchline/map": OccupancyGrid,
            "/touchline/pose": PoseWithCovarianceStamped,
        }.items():  # they come though they were published before
            robot.listen(kind, topic, LATCHED)
        assert robot.spin_until(lambda: all(robot.received.values()), 20), {
            topic: len(found) for topic, found in robot.received.items()
        }
        assert robot.tracked(), (tmp_path / "log").read_text()
        assert robot.call(Trigger, "/touchline/start_pose").success
        assert robot.call(Trigger, "/touchline/own_half").success
        robot.call(Empty, "/reinitialize_global_localization")
        assert robot.call(SetBool, "/touchline/penalised", SetBool.Request(data=True)).message is not None
    grid = robot.received["/touchline/map"][0]
    assert (grid.info.width * grid.info.resolution, set(grid.data)) == (pytest.approx(21.0, abs=0.1), {0, 30, 100})
    pose = robot.received["/touchline/pose"][0]
    assert pose.header.frame_id == "map"
    assert pose.pose.covariance[0] > 0.0
    stamp_s, place = pose.header.stamp.sec - 10**9 + 1e-9 * pose.header.stamp.nanosec, pose.pose.pose.position
    x, y = (float(cell) for cell in min(robot.truth, key=lambda row: abs(float(row[0]) - stamp_s))[1:3])
    assert math.hypot(place.x - x, place.y - y) < 0.3  # at the end that was told


def test_parameters_are_described_and_a_lifecycle_manager_leads_the_node(robot: Robot, tmp_path: Path) -> None:
    sys.path.insert(0, str(PACKAGE))
    from touchline_ros.parameters import PARAMETERS as declared

    with running(*node_command("autostart:=false", "field:=none-of-these"), log=tmp_path / "log"):
        names = [each.name for each in declared]
        listed = robot.call(ListParameters, "/touchline/list_parameters").result.names
        assert set(names) <= set(listed)
        asked = DescribeParameters.Request(names=names)
        described = robot.call(DescribeParameters, "/touchline/describe_parameters", asked).descriptors
        assert [each.description for each in described] == [each.description for each in declared]
        assert [bool(each.floating_point_range or each.integer_range) for each in described] == [
            each.range is not None for each in declared
        ]
        assert not robot.change(Transition.TRANSITION_CONFIGURE)  # the field is none
        assert robot.state() == "unconfigured"
    assert "none-of-these" in (tmp_path / "log").read_text()
    with running(*node_command("autostart:=false", *PARAMETERS), log=tmp_path / "log"):
        for step, label in (
            (Transition.TRANSITION_CONFIGURE, "inactive"),
            (Transition.TRANSITION_ACTIVATE, "active"),
            (Transition.TRANSITION_DEACTIVATE, "inactive"),
            (Transition.TRANSITION_ACTIVATE, "active"),
            (Transition.TRANSITION_DEACTIVATE, "inactive"),
            (Transition.TRANSITION_CLEANUP, "unconfigured"),
            (Transition.TRANSITION_CONFIGURE, "inactive"),
        ):
            assert robot.change(step), label
            assert robot.state() == label


LIVE = [sys.executable, "-m", "touchline", "live", "ros", "--field", "msl-18x12"]
CAMERA = ["--camera", str(EXAMPLE / "camera.yaml")]


def test_the_command_localises(robot: Robot, tmp_path: Path) -> None:
    with running(*LIVE, *CAMERA, log=tmp_path / "live"):
        robot.listen(DiagnosticArray, "/diagnostics")
        assert robot.spin_until(lambda: robot.images.get_subscription_count() > 0, 60)
        robot.play(0.5)
        assert robot.spin_until(robot.tracked, 30), (tmp_path / "live").read_text()
        robot.listen(PoseWithCovarianceStamped, "/touchline/pose", LATCHED)
        assert robot.spin_until(lambda: len(robot.received["/touchline/pose"]) > 0, 20)


def test_the_command_localises_what_another_plays(robot: Robot, tmp_path: Path) -> None:
    play = [sys.executable, "-m", "touchline", "play", "ros", str(EXAMPLE), "--speed", "0.5", "--loop"]
    with running(*LIVE, *CAMERA, log=tmp_path / "live"), running(*play, log=tmp_path / "play"):
        robot.listen(DiagnosticArray, "/diagnostics")
        assert robot.spin_until(robot.tracked, 90), (tmp_path / "live").read_text()
