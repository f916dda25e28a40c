"""How many images a second a season is localized at, and whether memory stays flat (Linux).

    python benchmarks/season.py RECORDING... [--recordings N] [--workers N]

Links to the recordings, in turns, stand for a season of so many. Images a second are those of the wall, and those of a
second of processor time, which what else the machine does hardly changes; start, reading and decoding are included,
reports are not. Memory is a worker's largest resident set within each quarter of the run, in brackets without mapped
files, which workers share (95 MB of LLVM's library).
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from touchline.evaluation.latency import cpu_name

_PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 1e6


def largest_mb(parent: int) -> tuple[float, float]:
    """The largest resident set (MB) of a process and its children, all and without mapped files."""
    sizes = [(0.0, 0.0)]
    for folder in Path("/proc").iterdir():
        try:
            if folder.name.isdigit():
                own = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
                if parent in (own, int(folder.name)):
                    resident, mapped = map(int, (folder / "statm").read_text().split()[1:3])
                    sizes.append((_PAGE_MB * resident, _PAGE_MB * (resident - mapped)))
        except OSError:  # has ended
            continue
    return max(sizes)


class Season(NamedTuple):
    """What was measured. memory_mb: within each quarter of the run, all and without mapped files."""

    workers: int
    images: int
    wall_s: float
    processor_s: float
    memory_mb: list[tuple[float, float]]


def measure(recordings: list[Path], count: int, workers: int, folder: Path) -> Season:
    """Localize `count` recordings, these in turn; what it took."""
    season = folder / "season.txt"
    links = [folder / f"{k:04d}-{recordings[k % len(recordings)].name}" for k in range(count)]
    for k, link in enumerate(links):
        link.symlink_to(recordings[k % len(recordings)].resolve())
    season.write_text("\n".join(map(str, links)))
    command = [sys.executable, "-m", "touchline", "season", str(season), "--output", str(folder / "runs")]
    before, begun_s, sizes = os.times(), time.perf_counter(), []
    with (folder / "said.txt").open("w") as said:
        command += ["--workers", str(workers), "--report", "none"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=said)
        while process.poll() is None:
            sizes.append(largest_mb(process.pid))
            time.sleep(0.5)
    if process.returncode:
        sys.exit((folder / "said.txt").read_text())
    wall_s, spent = time.perf_counter() - begun_s, os.times()
    with (folder / "runs" / "runs.csv").open() as file:
        images = sum(int(row["images"] or 0) for row in csv.DictReader(file))
    quarter = -(-len(sizes) // 4)
    peaks = [max(sizes[at : at + quarter]) for at in range(0, len(sizes), quarter)]
    processor_s = spent[2] + spent[3] - before[2] - before[3]  # of children
    return Season(workers, images, wall_s, processor_s, peaks)


def main() -> None:
    """Print one row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, nargs="+", metavar="RECORDING")
    parser.add_argument("--recordings", type=int, default=200, dest="count", metavar="N")
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    print(f"{given.count} recordings; {cpu_name()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"{'workers':>7}{'images':>9}{'wall s':>8}{'img/s/w':>10}{'img/cpu s':>12}   memory by quarters of the run")
    with TemporaryDirectory() as folder:
        found = measure(given.recordings, given.count, given.workers, Path(folder))
    rates = f"{found.images / found.wall_s / found.workers:>10.0f}{found.images / found.processor_s:>12.0f}"
    memory = ", ".join(f"{whole:.0f} ({own:.0f})" for whole, own in found.memory_mb)
    print(f"{found.workers:>7}{found.images:>9}{found.wall_s:>8.0f}{rates}   {memory} MB")


if __name__ == "__main__":
    main()
