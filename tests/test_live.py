"""A running robot: what datagrams say, which images are looked at, and a recording played from one end to the other."""

from __future__ import annotations

import json
import os
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from touchline.cli import main
from touchline.cli.live import address
from touchline.errors import InputError, TouchlineError
from touchline.geometry import Pose, Pose3
from touchline.live.camera_device import WithCamera
from touchline.live.datagrams import (
    PART_BYTES,
    Datagrams,
    image_datagrams,
    published_datagram,
    reading_datagram,
    seen_datagram,
)
from touchline.live.heard import Heard, Picture, Published, Reading, Sight, Start
from touchline.live.loop import LiveLoop
from touchline.live.playing import play
from touchline.live.udp import UdpLink, UdpRobot
from touchline.localizer import Localizer
from touchline.sources import open_source
from touchline.types import Estimate, Evidence, Observation, Problem, ProblemCode, Status

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"


def only(datagrams: Datagrams, datagram: bytes) -> Any:
    heard = datagrams.read(datagram)
    assert heard is not None, datagrams.refused
    return heard


# --- datagrams --------------------------------------------------------------------------------------------------------


def test_a_sample_of_a_sensor_comes_as_it_was_sent() -> None:
    sent = Reading("odometry", 123_456_789_012, (1.5, -0.25, 3.0))
    assert only(Datagrams(), reading_datagram(sent)) == sent


@pytest.mark.parametrize("size", [0, 10, PART_BYTES, PART_BYTES + 1, 5 * PART_BYTES - 7])
def test_an_image_comes_whole_whatever_the_order_of_its_parts(size: int) -> None:
    data = np.random.default_rng(size).bytes(size)
    camera = Pose3.from_roll_pitch_yaw(0.1, 0.2, 0.3, (0.05, 0.0, 1.1))
    parts = list(image_datagrams(7, data, camera))
    assert all(len(part) < 65_507 for part in parts)
    random.Random(size).shuffle(parts)
    datagrams = Datagrams()
    found = [heard for part in parts if (heard := datagrams.read(part)) is not None]
    assert len(found) == 1
    sight = found[0]
    assert isinstance(sight, Sight)
    assert (sight.stamp_ns, sight.image) == (7, data)
    assert sight.base_from_camera is not None
    np.testing.assert_allclose(sight.base_from_camera.rotation, camera.rotation, atol=1e-12)


def test_images_of_which_parts_are_lost_are_forgotten_and_counted() -> None:
    datagrams = Datagrams()
    for stamp in range(10):
        assert datagrams.read(next(image_datagrams(stamp, bytes(2 * PART_BYTES)))) is None
    assert datagrams.refused["an image of which parts are missing"] == 6


def test_a_start_comes_with_its_covariance() -> None:
    found = only(Datagrams(), b'{"kind": "start", "pose": [1, 2, 0.5], "covariance": [1,0,0,0,1,0,0,0,1]}')
    assert found.pose == Pose(1.0, 2.0, 0.5)
    assert found.covariance.tolist() == np.eye(3).tolist()
    assert only(Datagrams(), b'{"kind": "start", "own_half": true}').own_half


@pytest.mark.parametrize(
    "datagram",
    [
        b"",
        b"{",
        b"[]",
        b'{"kind": "odometry"}',
        b'{"kind": "odometry", "stamp_ns": 1.5, "values": [1, 2, 3]}',
        b'{"kind": "odometry", "stamp_ns": 1, "values": [1, 2]}',
        b'{"kind": "odometry", "stamp_ns": 1, "values": [1, 2, NaN]}',
        b'{"kind": "points", "stamp_ns": 1, "points": [[1, 2, 3]]}',
        b'{"kind": "points", "stamp_ns": 1, "points": "no"}',
        b'{"kind": "seen", "stamp_ns": 1, "rows": [{"kind": "Q"}]}',
        b'{"kind": "seen", "stamp_ns": 1, "rows": [5]}',
        b'{"kind": "image", "stamp_ns": 1, "part": 3, "parts": 2}\n',
        b'{"kind": "image", "stamp_ns": 1, "parts": 1e9}\n',
        b'{"kind": "start", "pose": [1, 2, 3, 4]}',
        b'{"kind": "start", "pos": [1, 2, 3]}',
        b'{"kind": "start", "own_half": "true"}',
        b'{"kind": "points", "stamp_ns": 1, "points": [[1, 2, 0], [3, 4, 0]]}',
        b'{"kind": "odometry", "stamp_ns": 1, "values": "123"}',
        b'{"kind": "unheard of", "stamp_ns": 1}',
        b'{"kind": ["odometry"], "stamp_ns": 1}',
        b"[" * 100_000,
    ],
)
def test_what_is_no_message_is_counted(datagram: bytes) -> None:
    datagrams = Datagrams()
    assert datagrams.read(datagram) is None
    assert sum(datagrams.refused.values()) == 1


def test_mutated_messages_do_no_harm() -> None:
    chance = random.Random(0)
    good = [
        reading_datagram(Reading("odometry", 1, (1.0, 2.0, 3.0))),
        seen_datagram(Observation(5, points=np.array([[1.0, 2.0], [3.0, -1.0]]))),
        b'{"kind": "start", "pose": [1, 2, 0.5], "covariance": [1,0,0,0,1,0,0,0,1]}',
        b'{"kind": "evidence", "source": "mate", "probability": 0.8, "place_m": [1, 2], "spread_m": 0.3}',
        *image_datagrams(9, bytes(200)),
    ]
    datagrams = Datagrams()
    count = int(os.environ.get("TOUCHLINE_MUTATED", "1000"))
    for _ in range(count):
        message = bytearray(chance.choice(good))
        for _ in range(chance.randint(1, 6)):
            message[chance.randrange(len(message))] = chance.choice(b'0123456789{}[]",:eE-. \n\x00\xff')
        datagrams.read(bytes(message[: chance.randint(0, len(message))]))
    assert sum(datagrams.refused.values()) > count / 5


def test_evidence_comes_as_it_was_said_and_what_is_none_is_counted() -> None:
    said = b'{"kind": "evidence", "source": "mate", "probability": 0.8, "place_m": [1, 2], "spread_m": 0.3}'
    assert only(Datagrams(), said) == Evidence("mate", 0.8, place_m=(1.0, 2.0), spread_m=0.3)
    assert only(Datagrams(), b'{"kind": "evidence", "source": "ball", "own_half": false}').own_half is False
    none = (b'"own_half": 1.5', b'"probability": 2, "own_half": true', b'"place_m": [1]', b'"half": true', b'"x": 1')
    for wrong in none:
        datagrams = Datagrams()
        assert datagrams.read(b'{"kind": "evidence", "source": "mate", ' + wrong + b"}") is None
        assert sum(datagrams.refused.values()) == 1


def test_an_estimate_is_told_with_where_the_odometry_began() -> None:
    estimate = Estimate(9, Pose(2.0, 1.0, np.pi / 2), np.eye(3), Status.TRACKING, residual_m=float("nan"))
    said = json.loads(published_datagram(Published(estimate, Pose(2.0, 0.0, np.pi / 2), image=True, dropped=2)))
    assert said["status"] == "tracking"
    np.testing.assert_allclose(said["map_from_odom"], [2.0, 0.0, np.pi / 2], atol=1e-12)
    assert said["covariance"] == np.eye(3).ravel().tolist()
    assert (said["residual_m"], said["dropped"], said["image"]) == (None, 2, True)
    assert (said["stamp_ns"], said["protection_m"], said["reason"], said["mode"]) == (9, None, "", "")
    sure = replace(estimate, protection_m=0.06, protection_rad=0.02, end_probability=1.0, statistics={"motion": 0.5})
    said = json.loads(published_datagram(Published(sure)))
    assert [said[name] for name in ("protection_m", "protection_rad", "end_probability")] == [0.06, 0.02, 1.0]
    assert said["statistics"] == {"motion": 0.5}
    slips = replace(sure, problems=(Problem(ProblemCode.ODOMETRY_SCALE, "slips"),))
    problems = json.loads(published_datagram(Published(slips)))["problems"]
    assert problems == [{"code": "odometry-scale", "sentence": "slips"}]
    assert json.loads(published_datagram(Published(sure.unconfirmed("too far"))))["reason"] == "too far"


# --- the loop ---------------------------------------------------------------------------------------------------------


class Script:
    """A link that says what it is told to, and keeps what it hears."""

    def __init__(self, events: list[list[Heard]]) -> None:
        self.events = events
        self.published: list[Published] = []
        self.refused: dict[str, int] = {}

    def hear(self, timeout_s: float) -> list[Heard]:
        found = self.events.pop(0) if self.events else []
        if not found:
            time.sleep(0.001)
        return found

    def publish(self, published: Published) -> None:
        self.published.append(published)

    def around(self) -> str:
        return "a script"

    def close(self) -> None: ...


class Slow:
    """Stands for a localizer whose every image takes as long as it is told."""

    def __init__(self, step_s: float) -> None:
        self.step_s, self.seen, self.resets = step_s, list[int](), list[Any]()

    def localize(self, stamp_ns: int, **_: object) -> Estimate:
        time.sleep(self.step_s)
        self.seen.append(stamp_ns)
        return Estimate(stamp_ns, Pose(0.0, 0.0, 0.0), np.eye(3), Status.TRACKING)

    def pose(self, stamp_ns: int) -> Estimate:
        return Estimate(stamp_ns, Pose(1.0, 0.0, 0.0), np.eye(3), Status.TRACKING)

    def reset(self, *given: object) -> None:
        self.resets.append(given)

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_: None


def looped(events: list[list[Heard]], localizer: Any, images: int) -> tuple[LiveLoop, Script]:
    """Runs until so many images have been answered or dropped."""
    script = Script(events)
    loop = LiveLoop(script, localizer)
    ends_s = time.monotonic() + 20.0
    loop.run(lambda: loop.counts["published"] + loop.counts["dropped"] >= images or time.monotonic() > ends_s)
    return loop, script


def sights(count: int, spacing_s: float) -> list[list[Heard]]:
    return [[Sight(k, k * spacing_s, observation=Observation(k))] for k in range(count)]


def test_a_backlog_is_worked_off_in_order_while_the_program_is_quicker_than_the_camera() -> None:
    localizer = Slow(0.002)
    loop, script = looped(sights(20, 0.1), localizer, 20)
    assert localizer.seen == list(range(20))
    assert loop.counts["dropped"] == 0
    assert [published.estimate.stamp_ns for published in script.published] == list(range(20))


def test_the_latest_image_wins_where_the_program_is_slower_and_the_others_are_counted() -> None:
    localizer = Slow(0.03)
    first = sights(6, 0.01)
    loop, script = looped([*first, *([[]] * 300), *sights(40, 0.01)[6:]], localizer, 40)
    assert loop.counts["published"] + loop.counts["dropped"] == 40
    assert loop.counts["dropped"] > 10
    assert localizer.seen[-1] == 39
    assert script.published[-1].dropped == loop.counts["dropped"]


def test_poses_go_out_at_every_sample_of_the_odometry_once_there_is_one() -> None:
    readings: list[list[Heard]] = [[Reading("odometry", 10 * k, (0.1 * k, 0.0, 0.0))] for k in range(5)]
    events = [*readings, *sights(1, 0.1), *([[]] * 100), *[[r] for r in [Reading("odometry", 60, (0.6, 0.0, 0.0))]]]
    _, script = looped([*events, *sights(1, 0.1)], Slow(0.0), 2)
    carried = [published for published in script.published if not published.image]
    assert [published.estimate.stamp_ns for published in carried] == [60]
    assert carried[0].map_from_odom is not None
    np.testing.assert_allclose(carried[0].map_from_odom, (0.4, 0.0, 0.0))


def test_the_odometry_at_an_image_lies_between_its_samples() -> None:
    readings: list[Heard] = [
        Reading("odometry", 0, (0.0, 0.0, 3.1)),
        Reading("odometry", 100, (1.0, 2.0, -3.1)),
    ]
    _, script = looped([readings, [Sight(25, 0.0, observation=Observation(25))]], Slow(0.0), 1)
    found = script.published[-1].map_from_odom
    assert found is not None
    heading = 3.1 + 0.25 * (2 * np.pi - 6.2)
    np.testing.assert_allclose(found, Pose(0.25, 0.5, heading).inverse(), atol=1e-12)


def test_a_start_is_handed_on_and_one_that_is_none_does_no_harm() -> None:
    real = Localizer("msl-18x12")
    bad = Start(Pose(float("nan"), 0.0, 0.0))
    loop, _ = looped([[bad], [Start(Pose(1.0, 2.0, 0.0))], *sights(1, 0.1)], real, 1)
    assert loop.counts["starts that are none"] == 1
    assert real.pose(0).pose == Pose(1.0, 2.0, 0.0)


class Grabbed:
    """Stands for a camera of three images."""

    def __init__(self) -> None:
        self.left, self.closed = 3, False

    def grab(self) -> Any:
        time.sleep(0.02)
        if self.left == 0:
            raise TouchlineError("gives no image any more")
        self.left -= 1
        return np.full((4, 4, 3), self.left, np.uint8)

    def close(self) -> None:
        self.closed = True


def test_a_camera_s_images_come_beside_what_the_link_brings() -> None:
    camera = Grabbed()
    reading = Reading("odometry", 1, (0.0, 0.0, 0.0))
    link = WithCamera(Script([[reading]]), camera)
    heard: list[Heard] = []
    ends_s = time.monotonic() + 10.0
    while len(heard) < 4 and time.monotonic() < ends_s:
        heard += link.hear(0.1)
    time.sleep(0.1)
    with pytest.raises(TouchlineError, match="no image"):
        link.hear(0.1)
    link.close()
    assert heard[0] == reading
    images = [each.image[0, 0, 0] for each in heard if isinstance(each, Sight) and not isinstance(each.image, bytes)]
    assert images == [2, 1, 0]
    assert camera.closed


# --- a recording played ----------------------------------------------------------------------------------------------


def test_a_recording_is_played_in_the_order_of_time_with_its_very_images() -> None:
    source = open_source(EXAMPLE)
    sent: list[Reading | Picture] = []
    assert play(source, sent.append, speed=1e6) == 60
    assert [event.stamp_ns for event in sent] == sorted(event.stamp_ns for event in sent)
    pictures = [event for event in sent if isinstance(event, Picture)]
    assert pictures[3].data == (EXAMPLE / "images" / "000003.jpg").read_bytes()
    assert {event.sensor for event in sent if isinstance(event, Reading)} >= {"odometry", "gyro", "compass"}


@pytest.fixture
def sockets() -> Iterator[tuple[UdpLink, UdpRobot, socket.socket]]:
    """A link, the robot's side of it, and where the poses go: at ports that are free."""
    answers = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    answers.bind(("127.0.0.1", 0))
    answers.settimeout(5.0)
    link = UdpLink(("127.0.0.1", 0), answers.getsockname())
    robot = UdpRobot(link.address)
    yield link, robot, answers
    for each in (link, robot, answers):
        each.close()


def test_a_recording_played_over_udp_is_localised_as_a_run_of_it_is(
    sockets: tuple[UdpLink, UdpRobot, socket.socket],
) -> None:
    told, counts = played(sockets, range(8))
    assert told["status"] == "tracking"
    assert off_m(told, 7) < 0.05
    assert counts["dropped"] == 0


def played(ends: tuple[UdpLink, UdpRobot, socket.socket], indices: range) -> tuple[dict[str, Any], dict[str, int]]:
    """Frames of the example sent to a new loop, each when the one before is answered: the last answer, and counts."""
    link, robot, answers = ends
    source = open_source(EXAMPLE)
    loop = LiveLoop(link, Localizer(source.field, source.camera))
    done = threading.Event()
    thread = threading.Thread(target=loop.run, args=(done.is_set,))
    thread.start()
    told: dict[str, Any] = {}
    try:
        robot.send(Reading("odometry", -1, (0.0, 0.0, 0.0)))
        for index, frame in enumerate(source.again(())):
            if index not in indices:
                continue
            for name, sensor in (("odometry", "odometry"), ("compass", "compass"), ("gyro", "gyro")):
                samples = getattr(frame, name)
                for stamp_ns, values in zip(samples.stamp_ns.tolist(), samples.values.tolist(), strict=True):
                    robot.send(Reading(sensor, stamp_ns, tuple(values)))
            robot.send(Picture(frame.stamp_ns, source.image_bytes(index), None, None))
            told = image_answer(answers)
            assert told["stamp_ns"] == frame.stamp_ns
            if index == indices[-1]:
                break
    finally:
        done.set()
        thread.join()
    return told, dict(loop.counts)


def off_m(told: dict[str, Any], index: int) -> float:
    """How far an answer is from the truth of a frame of the example."""
    truth = np.loadtxt(EXAMPLE / "ground_truth.tum")[index, 1:3]
    return float(np.hypot(told["x"] - truth[0], told["y"] - truth[1]))


def image_answer(answers: socket.socket) -> dict[str, Any]:
    """The next estimate of an image; an image's first may take a while."""
    answers.settimeout(60.0)
    while True:
        told: dict[str, Any] = json.loads(answers.recv(65_536))
        if told["image"]:
            return told


# --- the commands -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["", "x", "0", "65536", ":28400", "1.2.3.4:", "-1"])
def test_an_address_is_a_port_of_this_machine_or_with_its_host(text: str) -> None:
    assert address("5000", "--listen") == ("127.0.0.1", 5000)
    assert address("10.0.0.3:5000", "--listen") == ("10.0.0.3", 5000)
    with pytest.raises(InputError, match="--listen"):
        address(text, "--listen")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("--camera /dev/video0", "--device /dev/video0"),
        ("--to nosuchhost.invalid:5000", "nosuchhost.invalid"),
        ("--topic image=/front", "--topic: is an option of ros"),
        ("--start=1,2,90", "radians"),
        ("--start=100,2,0", "far off the field"),
        ("--wheels=45,135", "in rad"),
        ("--wheels=0.8,nan", "in rad"),
    ],
)
def test_options_that_cannot_be_meant_are_told(capsys: pytest.CaptureFixture[str], arguments: str, words: str) -> None:
    assert main(["live", "udp", "--field", "msl-18x12", "--listen", "28498", "--seconds", "0", *arguments.split()]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_a_port_that_is_taken_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        assert main(["live", "udp", "--field", "msl-18x12", "--listen", str(taken.getsockname()[1])]) != 0
    assert "in use" in capsys.readouterr().err


def test_live_ends_after_its_seconds_and_play_sends_to_nobody(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["live", "udp", "--field", "msl-18x12", "--listen", "28499", "--seconds", "0"]) == 0
    assert "0 of 0 images looked at" in capsys.readouterr().out
    assert main(["play", "udp", str(EXAMPLE), "--to", "28499", "--speed", "100"]) == 0
    assert "60 images sent" in capsys.readouterr().out


def test_evidence_of_others_counts_only_where_it_was_asked_for() -> None:
    said = Evidence("made up", 0.99, own_half=False)

    class Once:
        refused: ClassVar[dict[str, int]] = {}
        waiting: ClassVar[list[Evidence]] = [said]

        def hear(self, timeout_s: float) -> list[Heard]:
            return [self.waiting.pop()] if self.waiting else []

        def publish(self, published: Published) -> None: ...

        def around(self) -> str:
            return ""

        def close(self) -> None: ...

    localizer = Localizer("msl-18x12")
    link = Once()
    loop = LiveLoop(link, localizer, team_evidence=False)
    loop.run(lambda: not link.waiting)
    assert loop.counts["evidence"] == 1
    assert not localizer._said
