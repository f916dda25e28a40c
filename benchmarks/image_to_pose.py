"""How long a system takes from an image in memory to its pose, and how many images of a recording a second.

    python benchmarks/image_to_pose.py RECORDING [--system NAME]... [--images N] [--rounds N]

Each system follows the recording's first images anew in every round; each image counts with its fastest round, by the
time of the thread, so that what else the machine does hardly matters. The first 20 images, which teach the colours, are
left out. The systems take turns. `images/s` is one over the means of reading (decoding included) and of the step.
"""

from __future__ import annotations

import argparse
import time
from itertools import islice
from pathlib import Path

import numpy as np

from touchline.api import cpu_name
from touchline.evaluation.runner import robot_setup
from touchline.geometry import FloatArray
from touchline.sources import open_source
from touchline.systems import SYSTEMS, RobotSetup, open_system
from touchline.types import Frame

LEARNING = 20  # first images, left out


def step_times_ms(system: str, setup: RobotSetup, frames: list[Frame]) -> FloatArray:
    """Milliseconds of the thread (N,) that a system takes for each frame, from nothing."""
    localizer = open_system(system, setup)
    times = []
    for frame in frames:
        begun_ns = time.thread_time_ns()
        localizer.step(frame)
        times.append(1e-6 * (time.thread_time_ns() - begun_ns))
    return np.array(times)


def main() -> None:
    """Print a row for each system."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--system", action="append", choices=sorted(SYSTEMS))
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    source = open_source(given.recording)
    setup = robot_setup(source)
    begun_s = time.thread_time()
    frames = list(islice(source, given.images))
    reading_ms = 1e3 * (time.thread_time() - begun_s) / len(frames)
    model = "omni" if setup.camera is None else setup.camera.model
    systems = given.system or [name for name, info in SYSTEMS.items() if model in info.cameras]
    fastest = {name: np.full(len(frames), np.inf) for name in systems}
    for _ in range(given.rounds):
        for name in systems:
            fastest[name] = np.minimum(fastest[name], step_times_ms(name, setup, frames))
    print(f"{source.name}: {len(frames)} images, {reading_ms:.2f} ms to read one; one core of {cpu_name()}")
    print(f"{'system':<18}{'median':>8}{'90 %':>8}{'99 %':>8}  ms{'images/s':>11}")
    for name, times in fastest.items():
        counted = times[LEARNING:]
        quantiles = "".join(f"{value:8.2f}" for value in np.quantile(counted, (0.5, 0.9, 0.99)))
        print(f"{name:<18}{quantiles}    {1e3 / (reading_ms + counted.mean()):11.0f}")


if __name__ == "__main__":
    main()
