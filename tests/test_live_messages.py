"""Messages of ROS and what they say: read and made, without a link."""

from __future__ import annotations

import math
import os
import random
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from team_writing import TeamMessages

from touchline.geometry import Pose3
from touchline.live.heard import Picture, Reading, Sight, Start
from touchline.live.ros_link import UNUSABLE
from touchline.live.ros_reader import FIXED_TOPICS, RosReader
from touchline.live.ros_writer import RosWriter
from touchline.sources.bags.messages import Topic
from touchline.sources.bags.result_messages import Outgoing
from touchline.sources.bags.roles import ROLES
from touchline.sources.bags.with_rosbags import Codec
from touchline.types import Crossings, Evidence, Observation, generic_covariances, points_at

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"


def test_mutated_messages_do_no_harm() -> None:
    """Bytes as the network brings them, through decoder and reader; `make test-all` takes ten thousand."""
    count = int(os.environ.get("TOUCHLINE_MUTATED", "200"))
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
