"""What a team waits for: the compiler, `locate`, a season; beside another checkout, into a file of results.

    python lab/benchmarks/speed.py FOLDER RESULTS.json [--against CHECKOUT] [--recordings N] [--only NAME...]

FOLDER holds the public recordings. Times are processor times of commands, the fastest of some where they are short;
what is in the file already and not measured stays. `python docs/images/figures.py` draws docs/benchmark/speed.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from season import measure

from touchline.evaluation.latency import cpu_name

HERE = Path(__file__).parents[1]
_SEASONS = {"mirror": ("omni_msl_track", "omni_msl_match"), "perspective": ("humanoid_9x6_walk", "humanoid_hsl_pan")}
_COMMAND = ["-c", "import sys; from touchline.cli import main; sys.exit(main())"]
_WARM = """
import time, numpy as np, touchline
points = np.loadtxt({file!r}, delimiter=",", skiprows=1)
def once():
    begun = time.process_time()
    touchline.locate(points, field="msl-18x12")
    return time.process_time() - begun
once()
print(min(once() for _ in range(9)))
"""


def run(checkout: Path, arguments: list[str], folder: Path, cache: Path | None = None) -> tuple[float, str]:
    """Processor time (s) of Python with arguments on a checkout's sources, and what it prints."""
    environment = {**os.environ, "PYTHONPATH": str(checkout / "src"), "OPENBLAS_NUM_THREADS": "1"}
    environment |= {} if cache is None else {"NUMBA_CACHE_DIR": str(cache)}
    before = os.times()
    done = subprocess.run([sys.executable, *arguments], env=environment, cwd=folder, capture_output=True, text=True)
    after = os.times()
    if done.returncode:
        sys.exit(done.stderr)
    return after[2] + after[3] - before[2] - before[3], done.stdout


def compiling(command: str) -> Callable[[Path, Path], float]:
    """Of a command in an empty cache."""

    def measured(checkout: Path, folder: Path) -> float:
        with TemporaryDirectory() as cache:
            return run(checkout, [*_COMMAND, command], folder, Path(cache))[0]

    return measured


def _points(folder: Path) -> Path:
    """A file of points of lines, as a robot at (2, 1) m sees them."""
    import numpy as np

    from touchline.field import open_field
    from touchline.geometry import Pose

    seen = Pose(2.0, 1.0, 0.3).inverse().transform(np.vstack(open_field("msl-18x12").polylines(0.3)))
    seen = seen[np.hypot(*seen.T) < 5.0]
    np.savetxt(folder / "points.csv", seen, delimiter=",", header="x_m,y_m", comments="")
    return folder / "points.csv"


def located(checkout: Path, folder: Path) -> float:
    """`locate POINTS.csv`, its code cached."""
    command = [*_COMMAND, "locate", str(_points(folder)), "--field", "msl-18x12"]
    return min(run(checkout, command, folder)[0] for _ in range(6))


def located_warm(checkout: Path, folder: Path) -> float:
    """`touchline.locate` once more."""
    return float(run(checkout, ["-c", _WARM.format(file=str(_points(folder)))], folder)[1].split()[-1])


COMMANDS: dict[str, Callable[[Path, Path], float]] = {
    "demo": compiling("demo"),
    "compile": compiling("compile"),
    "locate": located,
    "locate warm": located_warm,
}


def main() -> None:
    """Measure, and put it into the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("results", type=Path)
    parser.add_argument("--against", type=Path, help="another checkout")
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--only", nargs="+", default=[*COMMANDS, *_SEASONS])
    given = parser.parse_args()
    found: dict[str, Any] = json.loads(given.results.read_text()) if given.results.exists() else {}
    checkouts = {"now": HERE} | ({} if given.against is None else {"before": given.against.resolve()})
    for name in given.only:
        with TemporaryDirectory() as scratch:
            folder = Path(scratch)
            if name in COMMANDS:
                taken = {when: COMMANDS[name](checkout, folder) for when, checkout in checkouts.items()}
                found[name] = {**found.get(name, {}), **taken}
            else:
                recordings = [given.folder / each for each in _SEASONS[name]]
                found[name] = measure(recordings, given.recordings, 2, folder)._asdict()
        found |= {"machine": cpu_name(), "cores": os.cpu_count(), "load": os.getloadavg()[0]}
        given.results.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
