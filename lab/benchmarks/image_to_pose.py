"""How long a system takes from an image in memory to its pose, and how many images of a recording a second.

    python lab/benchmarks/image_to_pose.py RECORDING [--system NAME]... [--images N] [--rounds N] [--against CHECKOUT]

Each system follows the recording's first images anew in every round; each image counts with its fastest round, by the
time of the thread, so that what else the machine does hardly matters. The first 20 images, which teach the colours, are
left out. The systems take turns. `images/s` is one over the means of reading (decoding included) and of the step.
With `--against`, another checkout's sources take turns with these, round by round, and the ratio of the medians stands
beside it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from itertools import islice
from pathlib import Path

import numpy as np

from touchline.camera import OmniCamera, PerspectiveCamera
from touchline.evaluation.runner import robot_setup
from touchline.geometry import FloatArray
from touchline.sources import open_source
from touchline.systems import SYSTEMS, RobotSetup, open_system
from touchline.types import Frame

LEARNING = 20  # first images, left out
HERE = Path(__file__).resolve().parents[1]


def step_times_ms(system: str, setup: RobotSetup, frames: list[Frame]) -> FloatArray:
    """Milliseconds of the thread (N,) that a system takes for each frame, from nothing."""
    localizer = open_system(system, setup)
    times = []
    for frame in frames:
        begun_ns = time.thread_time_ns()
        localizer.step(frame)
        times.append(1e-6 * (time.thread_time_ns() - begun_ns))
    return np.array(times)


def measure(recording: Path, systems: list[str] | None, images: int, rounds: int) -> dict[str, list[float]]:
    """The fastest times (ms) of each image by system; those of reading an image as `reading`."""
    source = open_source(recording)
    setup = robot_setup(source)
    begun_s = time.thread_time()
    frames = list(islice(source, images))
    reading_ms = 1e3 * (time.thread_time() - begun_s) / len(frames)
    kind = PerspectiveCamera if isinstance(setup.camera, PerspectiveCamera) else OmniCamera
    systems = systems or [name for name, info in SYSTEMS.items() if kind in info.cameras]
    fastest = {name: np.full(len(frames), np.inf) for name in systems}
    for _ in range(rounds):
        for name in systems:
            fastest[name] = np.minimum(fastest[name], step_times_ms(name, setup, frames))
    return {"reading": [reading_ms]} | {name: times.tolist() for name, times in fastest.items()}


def measured_by(checkout: Path, arguments: list[str]) -> dict[str, list[float]]:
    """The same in a process of its own, with a checkout's sources."""
    command = [sys.executable, __file__, *arguments, "--json"]
    environment = os.environ | {"PYTHONPATH": str(checkout / "src")}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    result: dict[str, list[float]] = json.loads(done.stdout)
    return result


def in_turns(checkouts: list[Path], arguments: list[str], rounds: int) -> list[dict[str, list[float]]]:
    """Each checkout's fastest times, round by round; every process has a round of its own to warm up."""
    best: list[dict[str, list[float]]] = [{} for _ in checkouts]
    for _ in range(rounds):
        for fastest, checkout in zip(best, checkouts, strict=True):
            for name, times in measured_by(checkout, arguments).items():
                fastest[name] = np.minimum(times, fastest.get(name, times)).tolist()
    return best


def main() -> None:
    """Print a row for each system."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--system", action="append", choices=sorted(SYSTEMS))
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--against", type=Path, help="another checkout, whose sources take turns with these")
    parser.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.json:
        print(json.dumps(measure(given.recording, given.system, given.images, given.rounds)))
        return
    if given.against is None:
        results = [measure(given.recording, given.system, given.images, given.rounds)]
    else:
        names = given.system or [name for name in SYSTEMS if name == "touchline"]
        options = [f"--images={given.images}", "--rounds=2", *(f"--system={name}" for name in names)]
        results = in_turns([HERE, given.against], [str(given.recording), *options], given.rounds)
    from touchline.evaluation.latency import cpu_name  # another checkout, which measures only, may have none

    reading_ms = results[0].pop("reading")[0]
    print(f"{given.recording.name}: {reading_ms:.2f} ms to read an image; one core of {cpu_name()}")
    print(f"{'system':<18}{'median':>8}{'90 %':>8}{'99 %':>8}  ms{'images/s':>11}")
    for name, times in results[0].items():
        counted = np.array(times[LEARNING:])
        quantiles = "".join(f"{value:8.2f}" for value in np.quantile(counted, (0.5, 0.9, 0.99)))
        beside = ""
        for other in results[1:]:
            median, slowest = np.quantile(other[name][LEARNING:], (0.5, 0.99))
            beside = f"   × {np.median(counted) / median:.2f} of the other's ({median:.2f}, 99 % {slowest:.2f} ms)"
        print(f"{name:<18}{quantiles}    {1e3 / (reading_ms + counted.mean()):11.0f}{beside}")


if __name__ == "__main__":
    main()
