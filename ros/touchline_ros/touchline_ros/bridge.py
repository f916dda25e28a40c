"""Topics of ROS 2 to `touchline live --bridge` and back, as the bytes that they are.

For robots whose ROS has a Python that Touchline does not take (Humble: 3.10), and for ARM64. Needs rclpy, nothing of
Touchline, and keeps to Python 3.10. Frames: their length (4 bytes), what they are (1), the lengths of topic and type (2
each), both names, and data; little-endian. To Touchline G (somebody publishes), M (a message), W (somebody reads);
from there R (read a topic), A (announce one; data 1: latched), M (publish).
"""

import argparse
import contextlib
import importlib
import queue
import socket
import struct
import sys
import threading

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import remove_ros_args

HEAD, MAX_BYTES, LOOK_S, SEND_S = struct.Struct("<IcHH"), 100_000_000, 0.5, 2.0


class Bridge(Node):
    """Connects to Touchline, and again where it was lost; reads and publishes what it asks for."""

    def __init__(self, there):
        super().__init__("touchline_bridge")
        self.there, self.link = there, None
        self.asked = queue.Queue()
        self.asking = self.create_guard_condition(self.answer)
        self.readers, self.writers, self.offered, self.wanted = {}, {}, set(), set()
        self.create_timer(LOOK_S, self.look)

    def look(self):
        """Twice a second: what is published, and what of ours is read."""
        if self.link is None and not self.connect():
            return
        for name, kinds in self.get_topic_names_and_types():
            others = self.count_publishers(name) - (name in self.writers)
            if len(kinds) == 1 and others > 0 and name not in self.offered:
                self.offered.add(name)
                self.send(b"G", name, kinds[0])
        for name, writer in self.writers.items():
            read = writer.get_subscription_count() > 0
            if read != (name in self.wanted):
                self.wanted ^= {name}
                self.send(b"W", name, data=b"\1" if read else b"\0")

    def connect(self):
        """Whether Touchline is there."""
        try:
            self.link = socket.create_connection(self.there, SEND_S)
        except OSError:
            self.get_logger().info(f"waits for touchline live --bridge {self.there[1]}", throttle_duration_sec=10.0)
            return False
        self.offered.clear()
        self.wanted.clear()
        threading.Thread(target=self.receive, args=(self.link,), daemon=True).start()
        self.get_logger().info("connected")
        return True

    def receive(self, link):
        """A thread: what Touchline asks for, until it is gone."""
        try:
            link.settimeout(None)
            with link.makefile("rb") as stream:
                while len(head := stream.read(HEAD.size)) == HEAD.size:
                    length, what, topic, kind = HEAD.unpack(head)
                    if not HEAD.size + topic + kind <= length <= MAX_BYTES:
                        break
                    rest = stream.read(length - HEAD.size)
                    name, of = rest[:topic].decode(), rest[topic : topic + kind].decode()
                    self.asked.put((what, name, of, rest[topic + kind :]))
                    self.asking.trigger()
        except (OSError, UnicodeDecodeError, ValueError):
            pass
        self.asked.put((b"X", "", "", link))
        self.asking.trigger()

    def answer(self):
        """What was asked for, by the thread that spins."""
        while not self.asked.empty():
            what, name, kind, data = self.asked.get()
            if what == b"X":
                self.leave(data)
            elif what == b"R":
                self.read(name, kind)
            elif what == b"A":
                self.announce(name, kind, data == b"\1")
            elif what == b"M" and name in self.writers:
                self.writers[name].publish(data)

    def read(self, name, kind):
        """Forward a topic from now on, read as its publishers offer it."""
        message = self.message_class(kind)
        if message is None or name in self.readers:
            return
        offers = [end.qos_profile.reliability for end in self.get_publishers_info_by_topic(name)]
        reliable = all(offer == ReliabilityPolicy.RELIABLE for offer in offers)
        profile = self.profile(100, reliable, name.endswith("/tf_static"))

        def came(data):
            self.send(b"M", name, kind, bytes(data))

        self.readers[name] = self.create_subscription(message, name, came, profile, raw=True)

    def announce(self, name, kind, latched):
        """Publish a topic from now on."""
        message = self.message_class(kind)
        if message is not None and name not in self.writers:
            self.writers[name] = self.create_publisher(message, name, self.profile(1 if latched else 10, True, latched))

    def profile(self, depth, reliable, latched):
        return QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )

    def message_class(self, kind):
        """rclpy needs a message's own class, though its bytes go on as they are."""
        try:
            package, _, name = kind.split("/")
            return getattr(importlib.import_module(f"{package}.msg"), name)
        except (ImportError, AttributeError, ValueError):
            if not kind.startswith("nav2_msgs/"):
                self.get_logger().warning(f"{kind}: its definition is not installed")
            return None

    def send(self, what, name, kind="", data=b""):
        """A frame; where nobody takes it, the connection is let go of."""
        if self.link is None:
            return
        topic, of = name.encode(), kind.encode()
        head = HEAD.pack(HEAD.size + len(topic) + len(of) + len(data), what, len(topic), len(of))
        try:
            self.link.sendall(head + topic + of + data)
        except OSError:
            self.leave(self.link)

    def leave(self, link):
        """Let go of a connection, and of what it has asked for."""
        if link is not self.link:
            return
        self.link.close()
        self.link = None
        for each in self.readers.values():
            self.destroy_subscription(each)
        self.readers.clear()
        self.get_logger().info("touchline is gone")


def main():
    """Run the bridge until ROS ends."""
    parser = argparse.ArgumentParser(description="Topics of ROS 2 to `touchline live --bridge` and back.")
    parser.add_argument("--to", default="127.0.0.1:28402", metavar="HOST:PORT", help="where it waits (%(default)s)")
    host, _, port = parser.parse_args(remove_ros_args(sys.argv)[1:]).to.rpartition(":")
    rclpy.init()
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Bridge((host or "127.0.0.1", int(port))))


if __name__ == "__main__":
    main()
