"""How long things take: an image to its pose, commands; beside another checkout where asked.

    python lab/benchmarks/speed.py images RECORDING [--system NAME]... [--images 200] [--rounds 5] [--against CHECKOUT]
    python lab/benchmarks/speed.py commands RESULTS.json [--only NAME...] [--against CHECKOUT]

images: thread time of each step, the fastest of some rounds, in which systems and checkouts take turns; the first 20
images, which teach the colours, are left out; "images/s" is one over the means of reading and of the step. commands:
processor time of the first demo, `compile`, `locate`, into a file; `python docs/images/figures.py` draws
docs/benchmark/speed.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parents[2]
LEARNING = 20  # first images, left out
COMMAND = ["-c", "import sys; from touchline.cli import main; sys.exit(main())"]
AGAIN = """
import time, numpy as np, touchline
points = np.loadtxt("points.csv", delimiter=",", skiprows=1)
def once():
    begun = time.process_time()
    touchline.locate(points, field="msl-18x12")
    return time.process_time() - begun
once()
print(min(once() for _ in range(9)))
"""


def images(given: argparse.Namespace) -> None:
    """Print a row for each system."""
    if given.json:
        print(json.dumps(step_times(given)))
        return
    checkouts = [HERE, *([] if given.against is None else [given.against.resolve()])]
    best: list[dict[str, Any]] = [{} for _ in checkouts]
    for _ in range(given.rounds):  # a process has a round of its own to warm up
        for found, checkout in zip(best, checkouts, strict=True):
            output = run(checkout, [__file__, *sys.argv[1:], "--rounds=2", "--json"], Path.cwd())[1]
            for name, times in json.loads(output).items():
                found[name] = np.minimum(found.get(name, np.inf), times)
    reading_ms = float(best[0].pop("reading")[0])
    print(
        f"{reading_ms:.2f} ms to read an image\n{'system':<18}{'median':>8}{'90 %':>8}{'99 %':>8}  ms{'images/s':>11}"
    )
    for name, times in best[0].items():
        counted = times[LEARNING:]
        row = "".join(f"{value:8.2f}" for value in np.quantile(counted, (0.5, 0.9, 0.99)))
        row += f"    {1e3 / (reading_ms + counted.mean()):11.0f}"
        for other in best[1:]:
            median, slowest = np.quantile(other[name][LEARNING:], (0.5, 0.99))
            row += f"   × {np.median(counted) / median:.2f} of the other's ({median:.2f}, 99 % {slowest:.2f} ms)"
        print(f"{name:<18}{row}")


def step_times(given: argparse.Namespace) -> dict[str, list[float]]:
    """Fastest times (ms) of each image by system, and that of reading an image, decoded."""
    from touchline.evaluation.runner import robot_setup
    from touchline.sources import open_source
    from touchline.systems import open_system

    source = open_source(given.recording)
    setup, begun_s = robot_setup(source), time.thread_time()
    frames = list(islice(source, given.images))
    reading_ms = 1e3 * (time.thread_time() - begun_s) / len(frames)
    fastest = {name: np.full(len(frames), np.inf) for name in given.system or ["touchline"]}
    for _ in range(given.rounds):
        for name, best in fastest.items():
            system = open_system(name, setup)
            for k, frame in enumerate(frames):
                begun_ns = time.thread_time_ns()
                system.step(frame)
                best[k] = min(best[k], 1e-6 * (time.thread_time_ns() - begun_ns))
    return {"reading": [reading_ms], **{name: best.tolist() for name, best in fastest.items()}}


def run(checkout: Path, arguments: list[str], folder: Path, cache: Path | None = None) -> tuple[float, str]:
    """Processor time (s) of Python with arguments on a checkout's sources, and what it prints."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, (checkout / "src", checkout / "lab" / "src"))),
        "OPENBLAS_NUM_THREADS": "1",
    }
    environment |= {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
    before = os.times()
    done = subprocess.run([sys.executable, *arguments], env=environment, cwd=folder, capture_output=True, text=True)
    after = os.times()
    if done.returncode:
        sys.exit(done.stderr)
    return after[2] + after[3] - before[2] - before[3], done.stdout


def compiling(command: str) -> Callable[[Path, Path], float]:
    """Of a command in an empty cache."""
    return lambda checkout, folder: run(checkout, [*COMMAND, command], folder, folder / "cache")[0]


COMMANDS: dict[str, Callable[[Path, Path], float]] = {
    "demo": compiling("demo"),
    "compile": compiling("compile"),
    "locate": lambda checkout, folder: min(
        run(checkout, [*COMMAND, "locate", "points.csv", "--field", "msl-18x12"], folder)[0] for _ in range(6)
    ),
    "locate warm": lambda checkout, folder: float(run(checkout, ["-c", AGAIN], folder)[1].split()[-1]),
}


def commands(given: argparse.Namespace) -> None:
    """Measure commands, the fastest of some where they are short."""
    from touchline.field import open_field
    from touchline.geometry import Pose

    seen = Pose(2.0, 1.0, 0.3).inverse().transform(np.vstack(open_field("msl-18x12").polylines(0.3)))
    seen = seen[np.hypot(*seen.T) < 5.0]
    checkouts = {"now": HERE} | ({} if given.against is None else {"before": given.against.resolve()})
    for name in given.only or COMMANDS:
        taken = {}
        for when, checkout in checkouts.items():
            with TemporaryDirectory() as scratch:
                np.savetxt(Path(scratch) / "points.csv", seen, delimiter=",", header="x_m,y_m", comments="")
                taken[when] = COMMANDS[name](checkout, Path(scratch))
        keep(given.results, name, taken)


def keep(path: Path, name: str, found: dict[str, Any]) -> None:
    """Put results into the file; what is there already and was not measured stays."""
    from touchline.evaluation.latency import cpu_name

    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    known |= {name: {**known.get(name, {}), **found}, "machine": cpu_name(), "cores": os.cpu_count()}
    path.write_text(json.dumps(known | {"load": os.getloadavg()[0]}, indent=1) + "\n", encoding="utf-8")
    print(f"{name}: {found}", flush=True)


def main() -> None:
    """Print or write what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(required=True)
    of_images, of_commands = (kinds.add_parser(measure.__name__) for measure in (images, commands))
    of_images.add_argument("recording", type=Path)
    of_images.add_argument("--system", action="append")
    of_images.add_argument("--images", type=int, default=200)
    of_images.add_argument("--rounds", type=int, default=5)
    of_images.add_argument("--json", action="store_true", help=argparse.SUPPRESS)
    of_commands.add_argument("results", type=Path)
    of_commands.add_argument("--only", nargs="+", choices=COMMANDS)
    for each, measure in ((of_images, images), (of_commands, commands)):
        each.set_defaults(measure=measure)
        each.add_argument("--against", type=Path, metavar="CHECKOUT")
    given = parser.parse_args()
    given.measure(given)


if __name__ == "__main__":
    main()
