"""A whole entry for a suite: the start and the odometry from there on. Standard library alone.

python odometry.py INPUTS RESULTS
"""

import csv
import math
import sys
from bisect import bisect_right
from pathlib import Path


def localize(drive: Path) -> list[tuple[str, float, float, float]]:
    """Stamp, x, y, heading of each image of a drive; none where no start is told."""
    if not (drive / "start.tum").exists():
        return []
    _, x, y, _, _, _, qz, qw = map(float, (drive / "start.tum").read_text().split())
    heading = 2.0 * math.atan2(qz, qw)
    with (drive / "odometry.csv").open() as file:
        odometry = [tuple(float(row[key]) for key in ("t", "x", "y", "theta")) for row in csv.DictReader(file)]
    with (drive / "observations.csv").open() as file:
        stamps = list(dict.fromkeys(row["t"] for row in csv.DictReader(file)))  # what an image shows shares its stamp
    times = [row[0] for row in odometry]
    at_images = [odometry[max(bisect_right(times, float(stamp)) - 1, 0)] for stamp in stamps]
    poses = [(stamps[0], x, y, heading)]
    for stamp, before, now in zip(stamps[1:], at_images[:-1], at_images[1:], strict=True):
        turned = heading - before[3]  # from the frame of the odometry to that of the field
        ahead, left = now[1] - before[1], now[2] - before[2]
        x += math.cos(turned) * ahead - math.sin(turned) * left
        y += math.sin(turned) * ahead + math.cos(turned) * left
        heading += now[3] - before[3]
        poses.append((stamp, x, y, heading))
    return poses


if __name__ == "__main__":
    inputs, results = Path(sys.argv[1]), Path(sys.argv[2])
    results.mkdir(exist_ok=True)
    for drive in sorted(path for path in inputs.iterdir() if path.is_dir()):
        lines = ["t,x,y,theta", *(f"{t},{x:.4f},{y:.4f},{heading:.5f}" for t, x, y, heading in localize(drive))]
        (results / f"{drive.name}.csv").write_text("\n".join(lines) + "\n")
