"""`touchline live` in a process of its own, played to in real time: what is localised, how late, and after a kill.

    python lab/benchmarks/live_link.py [--seconds 120] [--rate 30] [--system nubot-mti] [--start]
                                   [--kill-at 60 [--state]] [--late-ms 150]

The example's robot drives to and fro along its track: images, odometry and compass over UDP, poses back. Told are how
many images were localised, the time from sending an image to its pose, and what of that is neither decoding nor
localization; with --kill-at, how long after the kill, and after the first image that it answered, a new process was
tracking, and how far off it was. With --start it is told where it begins, and has no compass. With --late-ms
images come so late, of which their stamps tell.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from touchline.files.images import decode
from touchline.live.heard import Picture, Reading
from touchline.live.udp import UdpRobot
from touchline.sources import Recording, open_source

EXAMPLE = Path(__file__).parents[2] / "examples" / "omni_msl_track_short"
_FIRST_NS = 1_000_000_000  # behind the images that were sent until one was answered
STARTS_S = 60.0  # a process may take to begin, with nothing compiled


class Moment(NamedTuple):
    """What the robot sees and measures at one place of the track. truth: where it stands (m); heading: there (rad)."""

    image: bytes
    odometry: tuple[float, float, float]
    compass: float
    truth: tuple[float, float]
    heading: float


class Trouble(NamedTuple):
    """kill_at_s: of the process, which is started again. late_s: images come so late. start: its place is told, and no
    compass. state: it is kept.
    """

    kill_at_s: float = math.inf
    late_s: float = 0.0
    start: bool = False
    state: bool = False


NO_TROUBLE = Trouble()


class Played(NamedTuple):
    """What came back. sent_s, answers: by stamp (ns); killed_s: when the first process was."""

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
            x, y, heading = np.asarray(source.truth.poses)[index].tolist()
            found.append(Moment(data, odometry, compass, (x, y), heading))
    return found


class Live:
    """The command in a process of its own, heard by `answers`."""

    def __init__(self, system: str, port: int, answers: int, more: Sequence[str] = ()) -> None:
        arguments = ["--field", "msl-18x12", "--camera", str(EXAMPLE / "camera.yaml"), "--system", system, *more]
        ends = ["--listen", str(port), "--to", str(answers)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "touchline", "live", "udp", *arguments, *ends], stdout=subprocess.DEVNULL
        )

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


def play(seconds: float, rate_hz: float, system: str, trouble: Trouble = NO_TROUBLE) -> Played:
    """Drive for so long; the first image is sent until it is answered."""
    moments = track(open_source(EXAMPLE))
    there_and_back = moments + moments[-2:0:-1]
    answers = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    answers.bind(("127.0.0.1", 0))
    port, ended, played = _free_port(), threading.Event(), Played({}, {}, {}, None)
    listener = threading.Thread(target=_listen, args=(answers, played.answers, ended))
    listener.start()
    with tempfile.TemporaryDirectory() as folder:
        kept = ["--state", f"{folder}/robot.json"] if trouble.state else []
        x, y = moments[0].truth
        told = ["--start", f"{x},{y},{moments[0].heading}", *kept] if trouble.start else kept
        robot, live = UdpRobot(("127.0.0.1", port)), Live(system, port, answers.getsockname()[1], told)
        try:
            begun_s = _wait_for_first(robot, there_and_back[0], played, not trouble.start)
            late = round(trouble.late_s * rate_hz)
            for k in range(1, int(seconds * rate_hz)):
                time.sleep(max(begun_s + k / rate_hz - time.monotonic(), 0.0))
                if played.killed_s is None and k / rate_hz >= trouble.kill_at_s:
                    live.kill()
                    played = played._replace(killed_s=time.monotonic())
                    live = Live(system, port, answers.getsockname()[1], kept)
                stamps = [_FIRST_NS + each * round(1e9 / rate_hz) for each in (k, k - late)]
                _send_samples(robot, there_and_back[k % len(there_and_back)], stamps[0], not trouble.start)
                if k > late:
                    _send_image(robot, there_and_back[(k - late) % len(there_and_back)], stamps[1], played)
            time.sleep(1.0)
        finally:
            ended.set()
            live.kill()
            robot.close()
            listener.join()
            answers.close()
    asked = {stamp: told for stamp, told in played.answers.items() if stamp in played.sent_s}
    return played._replace(answers=asked)


def _wait_for_first(robot: UdpRobot, moment: Moment, played: Played, compass: bool) -> float:
    """Send the first image until it is answered; returns when the second is due to be counted from."""
    ends_s, stamp_ns = time.monotonic() + STARTS_S, 0
    while not played.answers:
        if time.monotonic() > ends_s:
            raise SystemExit("touchline live gave no answer")
        stamp_ns += 1_000_000
        _send_samples(robot, moment, stamp_ns, compass)
        _send_image(robot, moment, stamp_ns, played)
        time.sleep(0.2)
    for each in (played.sent_s, played.answers, played.truth):
        each.clear()
    return time.monotonic()


def _send_samples(robot: UdpRobot, moment: Moment, stamp_ns: int, compass: bool) -> None:
    robot.send(Reading("odometry", stamp_ns, moment.odometry))
    if compass:
        robot.send(Reading("compass", stamp_ns, (moment.compass,)))


def _send_image(robot: UdpRobot, moment: Moment, stamp_ns: int, played: Played) -> None:
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


def tracking_again(played: Played, since_s: float | None) -> tuple[float, float, float] | None:
    """How long after a kill, and after the first image that was answered since, the first image was sent
    that was tracked, and how far off its pose was.
    """
    assert since_s is not None
    after = [stamp for stamp, sent_s in played.sent_s.items() if sent_s > since_s and stamp in played.answers]
    for stamp in after:
        if played.answers[stamp]["status"] == "tracking":
            sent_s = played.sent_s[stamp]
            return sent_s - since_s, sent_s - played.sent_s[after[0]], off_m(played, stamp)
    return None


def main() -> None:
    """Print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--system", default="nubot-mti")
    parser.add_argument("--kill-at", type=float, default=math.inf)
    parser.add_argument("--late-ms", type=float, default=0.0)
    for name in ("start", "state"):
        parser.add_argument(f"--{name}", action="store_true")
    given = parser.parse_args()
    trouble = Trouble(given.kill_at, 1e-3 * given.late_ms, given.start, given.state)
    played = play(given.seconds, given.rate, given.system, trouble)
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
    tracked = [stamp for stamp, told in played.answers.items() if told["status"] == "tracking"]
    worst = max((off_m(played, stamp) for stamp in tracked), default=math.nan)
    print(f"tracking {len(tracked)} of them, at worst {worst:.3f} m off")
    again = None if played.killed_s is None else tracking_again(played, played.killed_s)
    if again is not None:
        print("tracking {:.2f} s after the kill, {:.2f} s after the first image since, {:.3f} m off".format(*again))
    elif played.killed_s is not None:
        print("never tracking again after the kill")


if __name__ == "__main__":
    main()
