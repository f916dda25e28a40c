#!/usr/bin/env python3
"""Topics of ROS 2 to `touchline live --udp` and its poses back, where Touchline lives in an environment of its own.

Needs rclpy and nothing of Touchline: python3 ros_bridge.py [--ros-args -r image:=/front/image/compressed]
"""

import json
import math
import socket

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Imu

THERE, HERE, PART = ("127.0.0.1", 28400), ("127.0.0.1", 28401), 48_000
CELLS = (0, 1, 5, 6, 7, 11, 30, 31, 35)  # of a covariance (6, 6): x, y and yaw


class Bridge(Node):
    def __init__(self):
        super().__init__("touchline_bridge")
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.udp.bind(HERE)
        self.udp.setblocking(False)
        self.pose = self.create_publisher(PoseWithCovarianceStamped, "touchline/pose", 10)
        self.create_subscription(CompressedImage, "image", self.image, qos_profile_sensor_data)
        self.create_subscription(Odometry, "odom", self.odometry, qos_profile_sensor_data)
        self.create_subscription(Imu, "imu", self.imu, qos_profile_sensor_data)
        self.create_timer(0.002, self.answers)

    def say(self, message, kind, behind=b"", **more):
        stamp = message.header.stamp
        said = {"kind": kind, "stamp_ns": stamp.sec * 1_000_000_000 + stamp.nanosec, **more}
        self.udp.sendto(json.dumps(said).encode() + b"\n" + behind, THERE)

    def image(self, message):
        data = bytes(message.data)
        parts = max(1, -(-len(data) // PART))
        for part in range(parts):
            self.say(message, "image", data[part * PART : (part + 1) * PART], part=part, parts=parts)

    def odometry(self, message):
        at, q = message.pose.pose.position, message.pose.pose.orientation
        yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
        self.say(message, "odometry", values=[at.x, at.y, yaw])

    def imu(self, message):
        rate = message.angular_velocity
        self.say(message, "gyro", values=[rate.x, rate.y, rate.z])

    def answers(self):
        while True:
            try:
                said = json.loads(self.udp.recv(65536))
            except BlockingIOError:
                return
            out = PoseWithCovarianceStamped()
            out.header.frame_id = "map"
            out.header.stamp.sec, out.header.stamp.nanosec = divmod(said["stamp_ns"], 1_000_000_000)
            out.pose.pose.position.x, out.pose.pose.position.y = said["x"], said["y"]
            out.pose.pose.orientation.z = math.sin(said["theta"] / 2)
            out.pose.pose.orientation.w = math.cos(said["theta"] / 2)
            for cell, value in zip(CELLS, said["covariance"], strict=True):
                out.pose.covariance[cell] = value
            self.pose.publish(out)


def main():
    rclpy.init()
    rclpy.spin(Bridge())


if __name__ == "__main__":
    main()
