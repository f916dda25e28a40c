"""Hostile bags: what a bag is made of changed message by message, below its checksums and its compression."""

from __future__ import annotations

import io
import random
import sqlite3
import struct
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import foreign_bags
import numpy as np
from foreign_bags import EPOCH_NS, OPTICAL, Types
from fuzz_mutations import mutated
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

from touchline.geometry import Pose3
from touchline.sources import open_source
from touchline.sources.bags.with_rosbags import Codec, Rosbag2Writer
from touchline.sources.bags.writing import McapWriter as OwnWriter
from touchline.sources.bags.writing import write_recording

_SQL = (
    "DROP TABLE topics",
    "UPDATE topics SET type = NULL",
    "UPDATE topics SET name = 5",
    "UPDATE topics SET offered_qos_profiles = '[[[['",
    "UPDATE messages SET timestamp = 9223372036854775807",
    "UPDATE messages SET timestamp = 'x'",
    "UPDATE messages SET data = 12",
    "UPDATE messages SET topic_id = 99",
    "UPDATE schema SET schema_version = 'x'",
    "ALTER TABLE messages RENAME TO others; CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL "
    "SELECT id + 1 FROM n) SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n",
)


def robot_messages(types: Types) -> list[foreign_bags.Message]:
    """Three images, their camera, odometry, an IMU, line points and frames: every message that is read."""
    image = np.random.default_rng(1).integers(0, 255, (12, 16, 3), dtype=np.uint8)
    down = Pose3(np.eye(3), np.array([0.0, 0.0, 0.5]))
    tree = [("base_footprint", "base_link", down), ("base_link", "head_camera", down)]
    tree.append(("head_camera", OPTICAL, foreign_bags.optical()))
    made: list[foreign_bags.Message] = []
    for k in range(3):
        now = EPOCH_NS + k * 100_000_000
        header = types.header(now, OPTICAL)
        placed = types.transforms(*(types.transform(now, *each) for each in tree))
        made.append((now, "/tf" if k else "/tf_static", "tf2_msgs/msg/TFMessage", placed))
        made.append((now, "/robot/odom", *foreign_bags.odometry_message(types, now, 0.1 * k, 0.0, 0.2)))
        made.append((now, "/ground_truth/odom", *foreign_bags.odometry_message(types, now, 0.1 * k, 0.0, 0.2)))
        made.append((now, "/imu/data", *foreign_bags.imu_message(types, now, np.array([0.1, 0.2, 0.3]), 0.01, 0.02)))
        made.append((now, "/front/camera_info", *_camera_info(types, header)))
        made.append((now, "/front/image_raw", *foreign_bags.raw("rgb8", np.ascontiguousarray)(types, header, image)))
        jpeg = foreign_bags.compressed(
            "bayer_rggb8; jpeg compressed bayer_rggb8", ".jpg", lambda pixels: pixels[..., 0]
        )
        made.append((now, "/back/image/compressed", *jpeg(types, header, image)))
        made.append(foreign_bags.cloud(types, now, "base_link", [(1.0, 0.5, 0.0), (2.0, -0.5, 0.0)]))
    return made


def _camera_info(types: Types, header: Any) -> tuple[str, Any]:
    region = types.make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    matrix = np.array([14.0, 0.0, 7.5, 0.0, 14.0, 5.5, 0.0, 0.0, 1.0])
    fields = {"d": np.zeros(5), "k": matrix, "r": np.eye(3).ravel(), "p": np.zeros(12)}
    fields = {name.upper() if types.ros1 else name: value for name, value in fields.items()}
    size = {"height": 12, "width": 16, "binning_x": 0, "binning_y": 0}
    kind = "sensor_msgs/msg/CameraInfo"
    return kind, types.make(kind, header=header, distortion_model="plumb_bob", roi=region, **size, **fields)


def plain_mcap(messages: Sequence[foreign_bags.Message], types: Types) -> bytes:
    """Neither compressed nor with checksums: changed bytes reach whatever reads the messages."""
    written = io.BytesIO()
    writer, channels = McapWriter(written, compression=CompressionType.NONE, enable_crcs=False), {}
    writer.start(profile="ros2")
    for time_ns, topic, kind, message in messages:
        if topic not in channels:
            text = types.store.generate_msgdef(kind, ros_version=2)[0].encode()
            channels[topic] = writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", text))
        writer.add_message(channels[topic], time_ns, bytes(types.store.serialize_cdr(message, kind)), time_ns)
    writer.finish()
    return written.getvalue()


def changed_numbers(seeds: Sequence[bytes], rng: random.Random) -> bytes:
    """One or several numbers of 1 to 8 bytes set to what is large, small, negative or none."""
    data = bytearray(rng.choice(seeds))
    for _ in range(rng.choice((1, 1, 2, 4))):
        size, form = rng.choice(((1, "B"), (2, "H"), (4, "I"), (4, "I"), (8, "Q"), (8, "d"), (4, "f")))
        place = rng.randrange(max(len(data), 1))
        if form in "df":
            values = (float("nan"), float("inf"), -float("inf"), 1e300, 1e-300, -1.0, 0.0)
            value = rng.choice(values if form == "d" else values[:3])
            packed = struct.pack("<" + form, value)
        else:
            top = 1 << (8 * size)
            packed = struct.pack("<" + form, rng.choice((0, 1, top - 1, top // 2, top // 2 - 1, 1000, 255)) % top)
        data[place : place + size] = packed
    return bytes(data)


def mutated_sqlite(seeds: Sequence[bytes], rng: random.Random) -> bytes:
    """Bytes of a .db3 file, or its tables."""
    data = rng.choice(seeds)
    if rng.random() < 0.4:
        return _bytes_changed([data], rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.db3"
        path.write_bytes(data)
        bag = sqlite3.connect(path)
        try:
            if rng.random() < 0.3:
                bag.executescript(rng.choice(_SQL))
            else:
                rows = bag.execute("SELECT id, data FROM messages").fetchall()
                for number, message in rng.sample(rows, min(3, len(rows))):
                    changed = rng.choice((changed_numbers, mutated))([message], rng)
                    bag.execute("UPDATE messages SET data = ? WHERE id = ?", (changed[:1_000_000], number))
            bag.commit()
        except sqlite3.Error:
            pass
        finally:
            bag.close()
        return path.read_bytes()


def _bytes_changed(seeds: Sequence[bytes], rng: random.Random) -> bytes:
    return (changed_numbers if rng.random() < 0.5 else mutated)(seeds, rng)


Mutation = Callable[[Sequence[bytes], random.Random], bytes]


def bag_seeds(recording: Path) -> list[tuple[str, bytes, Mutation]]:
    """File name, content and mutation of every kind of bag in one file: of Touchline, and of a robot."""
    two, one = Types(), Types(ros1=True)
    in_two, in_one = robot_messages(two), robot_messages(one)
    with tempfile.TemporaryDirectory() as place:
        folder, codec = Path(place), Codec()
        write_recording(open_source(recording), OwnWriter(folder / "own.mcap", codec), codec)
        write_recording(open_source(recording), Rosbag2Writer(folder / "own", codec, False), codec)
        foreign_bags.write_foreign(folder / "robot.bag", iter(in_one), one)
        foreign_bags.write_foreign(folder / "robot", iter(in_two), two)
        return [
            ("own.mcap", (folder / "own.mcap").read_bytes(), _bytes_changed),
            ("own.db3", next((folder / "own").glob("*.db3")).read_bytes(), mutated_sqlite),
            ("robot.mcap", plain_mcap(in_two, two), _bytes_changed),
            ("robot.db3", next((folder / "robot").glob("*.db3")).read_bytes(), mutated_sqlite),
            ("robot.bag", (folder / "robot.bag").read_bytes(), _bytes_changed),
            ("metadata.yaml", (folder / "robot" / "metadata.yaml").read_bytes(), mutated),
        ]
