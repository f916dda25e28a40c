"""`touchline live` in a process of its own, played to in real time: what is localised, how late, and after a kill.

    python benchmarks/live_link.py [--seconds 120] [--rate 30] [--system nubot-mti] [--kill-at 60]

The example's robot drives to and fro along its track: images, odometry and compass over UDP, poses back. Told are how
many images were localised, the time from sending an image to its pose, and what of that is neither decoding nor
localization; with --kill-at, how long after the kill a new process was tracking, and how far off it was.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from touchline.files.images import decode
from touchline.live.heard import Picture, Reading
from touchline.live.udp import UdpRobot
from touchline.sources import Recording, open_source

EXAMPLE = Path(__file__).parents[1] / "examples" / "omni_msl_track_short"
_FIRST_NS = 1_000_000_000  # behind the images that were sent until one was answered
STARTS_S = 60.0  # a process may take to begin, with nothing compiled


class Moment(NamedTuple):
    """What the robot sees and measures at one place of the track. pose: its odometry, truth: where it stands."""

    image: bytes
    odometry: tuple[float, float, float]
    compass: float
    truth: tuple[float, float]


class Played(NamedTuple):
    """What came back. sent_s, answers: by stamp (ns); killed_s, began_s: of the second process, if there was one."""

    sent_s: dict[int, float]
    answers: dict[int, dict[str, Any]]
    truth: dict[int, tuple[float, float]]
    killed_s: float | None


def track(source: Recording) -> list[Moment]:
    """Every image with the last samples before it."""
    assert source.truth is not None
    found, odometry, compass = [], None, None
    for index, frame in enumerate(source):
        odometry = odometry if frame.odometry is None else tuple(frame.odometry.values[-1].tolist())
        compass = compass if frame.compass is None else float(frame.compass.values[-1, 0])
        data = source.image_bytes(index)
        if odometry is not None and compass is not None and data is not None:
            x, y, _ = np.asarray(source.truth.poses)[index]
            found.append(Moment(data, odometry, compass, (float(x), float(y))))
    return found


class Live:
    """The command in a process of its own, heard by `answers`."""

    def __init__(self, system: str, port: int, answers: int) -> None:
        arguments = ["--field", "msl-18x12", "--camera", str(EXAMPLE / "camera.yaml"), "--system", system]
        ends = ["--udp", str(port), "--to", str(answers)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "touchline", "live", *arguments, *ends], stdout=subprocess.DEVNULL
        )

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


def play(seconds: float, rate_hz: float, system: str, kill_at_s: float | None = None) -> Played:
    """Drive for so long; the first image is sent until it is answered."""
    moments = track(open_source(EXAMPLE))
    there_and_back = moments + moments[-2:0:-1]
    answers = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    answers.bind(("127.0.0.1", 0))
    port = _free_port()
    played = Played({}, {}, {}, None)
    ended = threading.Event()
    listener = threading.Thread(target=_listen, args=(answers, played.answers, ended))
    listener.start()
    robot, live = UdpRobot(("127.0.0.1", port)), Live(system, port, answers.getsockname()[1])
    try:
        begun_s = _wait_for_first(robot, there_and_back[0], played)
        killed_s = None
        for k in range(1, int(seconds * rate_hz)):
            time.sleep(max(begun_s + k / rate_hz - time.monotonic(), 0.0))
            if kill_at_s is not None and killed_s is None and k / rate_hz >= kill_at_s:
                live.kill()
                killed_s, live = time.monotonic(), Live(system, port, answers.getsockname()[1])
            _send(robot, there_and_back[k % len(there_and_back)], _FIRST_NS + k * round(1e9 / rate_hz), played)
        time.sleep(1.0)
    finally:
        ended.set()
        live.kill()
        robot.close()
        listener.join()
        answers.close()
    asked = {stamp: told for stamp, told in played.answers.items() if stamp in played.sent_s}
    return played._replace(answers=asked, killed_s=killed_s)


def _wait_for_first(robot: UdpRobot, moment: Moment, played: Played) -> float:
    """Send the first image until it is answered; returns when the second is due to be counted from."""
    ends_s, stamp_ns = time.monotonic() + STARTS_S, 0
    while not played.answers:
        if time.monotonic() > ends_s:
            raise SystemExit("touchline live gave no answer")
        stamp_ns += 1_000_000
        _send(robot, moment, stamp_ns, played)
        time.sleep(0.2)
    for each in (played.sent_s, played.answers, played.truth):
        each.clear()
    return time.monotonic()


def _send(robot: UdpRobot, moment: Moment, stamp_ns: int, played: Played) -> None:
    robot.send(Reading("odometry", stamp_ns, moment.odometry))
    robot.send(Reading("compass", stamp_ns, (moment.compass,)))
    played.truth[stamp_ns] = moment.truth
    played.sent_s[stamp_ns] = time.monotonic()
    robot.send(Picture(stamp_ns, moment.image, None, None))


def _listen(answers: socket.socket, found: dict[int, dict[str, Any]], ended: threading.Event) -> None:
    answers.settimeout(0.1)
    while not ended.is_set():
        try:
            told = json.loads(answers.recv(65_536))
        except TimeoutError:
            continue
        if told["image"]:
            found.setdefault(told["stamp_ns"], {**told, "came_s": time.monotonic()})


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        some.bind(("127.0.0.1", 0))
        return int(some.getsockname()[1])


def off_m(played: Played, stamp_ns: int) -> float:
    """How far an answer is from the truth."""
    told, (x, y) = played.answers[stamp_ns], played.truth[stamp_ns]
    return math.hypot(told["x"] - x, told["y"] - y)


def tracking_again(played: Played) -> tuple[float, float] | None:
    """How long after the kill the first image was sent that a new process tracked, and how far off its pose was."""
    assert played.killed_s is not None
    after = [stamp for stamp, sent_s in played.sent_s.items() if sent_s > played.killed_s and stamp in played.answers]
    for stamp in after:
        if played.answers[stamp]["status"] == "tracking":
            return played.sent_s[stamp] - played.killed_s, off_m(played, stamp)
    return None


def main() -> None:
    """Print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--system", default="nubot-mti")
    parser.add_argument("--kill-at", type=float)
    given = parser.parse_args()
    played = play(given.seconds, given.rate, given.system, given.kill_at)
    decoding = []
    for moment in track(open_source(EXAMPLE)):
        begun_s = time.monotonic()
        decode(moment.image, cv2.IMREAD_COLOR)
        decoding.append(1e3 * (time.monotonic() - begun_s))
    whole = [1e3 * (told["came_s"] - played.sent_s[stamp]) for stamp, told in played.answers.items()]
    work = [told["perception_ms"] + told["localization_ms"] for told in played.answers.values()]
    rest = np.array(whole) - np.array(work) - float(np.median(decoding))
    errors = [off_m(played, stamp) for stamp in played.answers]
    print(f"{len(played.answers)} of {len(played.sent_s)} images localised; median {np.median(errors):.3f} m off")
    print(f"from sending to the pose: median {np.median(whole):.1f} ms, 99 % {np.quantile(whole, 0.99):.1f} ms")
    print(f"of it decoding {np.median(decoding):.1f} ms, localization {np.median(work):.1f} ms (medians)")
    print(f"beyond both: median {np.median(rest):.1f} ms, 99 % {np.quantile(rest, 0.99):.1f} ms")
    if given.kill_at is not None:
        again = tracking_again(played)
        print(
            "never tracking again"
            if again is None
            else f"tracking {again[0]:.1f} s after the kill, {again[1]:.3f} m off"
        )


if __name__ == "__main__":
    main()
