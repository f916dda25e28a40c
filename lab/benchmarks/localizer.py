"""How long the live loop takes to answer: `Localizer.localize` of points and `Localizer.pose`, at ease and flooded.

    python lab/benchmarks/localizer.py [--rate HZ] [--flood HZ] [--seconds S] [--against CHECKOUT]

A robot drives in a circle on the MSL field and sees the points of all lines within 5 m, the same in every run. Images
come at a rate, odometry at 100 Hz, or, flooded, from a second thread at 100 kHz. Times are those of the wall: what else
the machine does counts. With `--against`, another checkout's sources are measured, too, and ratios stand beside.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localizer import Localizer

SPEED_M_S, RADIUS_M, NOISE_M = 1.0, 2.0, 0.02
WARM = 20  # first images, left out
HERE = Path(__file__).resolve().parents[1]


def pose_at(seconds: float) -> Pose:
    """Where the robot is."""
    turned = SPEED_M_S * seconds / RADIUS_M
    return Pose(RADIUS_M * math.sin(turned) + 1.0, 0.5 - RADIUS_M * math.cos(turned), turned)


def views(count: int, rate_hz: float) -> list[FloatArray]:
    """Points (N, 2), robot frame, of each image."""
    lines, rng = np.vstack(list(open_field("msl-18x12").polylines(0.2))), np.random.default_rng(1)
    seen = [pose_at(k / rate_hz).inverse().transform(lines) for k in range(count)]
    near = [points[np.hypot(*points.T) < 5.0] for points in seen]
    return [points + rng.normal(0.0, NOISE_M, points.shape) for points in near]


def feed(robot: Localizer, begun_s: float, stop: threading.Event, flood_hz: float) -> None:
    """Odometry at a rate until told to stop, in packets of a millisecond."""
    step_s, sent = 1.0 / flood_hz, 0
    while not stop.is_set():
        due = int((time.perf_counter() - begun_s) * flood_hz)
        for k in range(
            max(sent, due - int(0.01 * flood_hz)), due
        ):  # a process that has waited does not make up for all
            robot.add_odometry(round(1e9 * k * step_s), *pose_at(k * step_s))
        sent = max(due, sent)
        time.sleep(1e-3)


def measure(rate_hz: float, flood_hz: float, seconds: float) -> dict[str, list[float]]:
    """Milliseconds of every call, by call."""
    result: dict[str, list[float]] = {}
    for name, odometry_hz in (("at ease", 100.0), ("flooded", flood_hz)):
        robot, seen = Localizer("msl-18x12"), views(int(seconds * rate_hz), rate_hz)
        stop, begun_s = threading.Event(), time.perf_counter()
        feeder = threading.Thread(target=feed, args=(robot, begun_s, stop, odometry_hz))
        feeder.start()
        spent_ms: dict[str, list[float]] = {"localize": [], "pose": []}
        for k, points in enumerate(seen):
            time.sleep(max(begun_s + (k + 1) / rate_hz - time.perf_counter(), 0.0))
            stamp_ns = round(1e9 * k / rate_hz)
            at_s = time.perf_counter()
            robot.localize(stamp_ns, points=points)
            spent_ms["localize"].append(1e3 * (time.perf_counter() - at_s))
            at_s = time.perf_counter()
            robot.pose(stamp_ns + 10_000_000)
            spent_ms["pose"].append(1e3 * (time.perf_counter() - at_s))
        stop.set()
        feeder.join()
        result |= {f"{call}, {name}": times[WARM:] for call, times in spent_ms.items()}
    return result


def main() -> None:
    """Print a row for each call."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, default=30.0)
    parser.add_argument("--flood", type=float, default=100_000.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--against", type=Path, help="another checkout")
    parser.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    results = []
    for checkout in [None] if given.json else [HERE, *([] if given.against is None else [given.against])]:
        if checkout is None:
            print(json.dumps(measure(given.rate, given.flood, given.seconds)))
            return
        command = [sys.executable, __file__, "--json", f"--rate={given.rate}", f"--flood={given.flood}"]
        environment = os.environ | {"PYTHONPATH": str(checkout / "src")}
        done = subprocess.run(
            [*command, f"--seconds={given.seconds}"], env=environment, capture_output=True, text=True, check=True
        )
        results.append(json.loads(done.stdout))
    print(f"{'ms':<20}{'median':>9}{'99 %':>9}{'longest':>9}")
    for name, times in results[0].items():
        row = f"{name:<20}" + "".join(f"{value:9.2f}" for value in (*np.quantile(times, (0.5, 0.99)), max(times)))
        for other in results[1:]:
            median, late = np.quantile(other[name], (0.5, 0.99))
            row += f"   × {np.median(times) / median:.2f} of {median:.2f}"
            row += f" (99 % {late:.2f}, longest {max(other[name]):.0f})"
        print(row)


if __name__ == "__main__":
    main()
