"""Lines of the line graph in photographs of a real field, against the lines that people labelled in them.

    python benchmarks/spl_photos.py FOLDER

FOLDER holds photographs, and beside each a JSON with the camera's intrinsics, its pose on the ground and the ends of
three lines (field border, goal box, what connects them). Printed: for how many labelled lines a detected one passes
within 8 px of both ends; the angle and the distance on the ground between border and goal box as detected; and in how
many photographs the white goal's frame became a field line, by the outlines in tests/data/spl_goal_frames.csv.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from touchline.camera import GroundView, PinholeCamera
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose3
from touchline.perception.line_graph import LineGraphDetector, LineGraphSettings
from touchline.types import Observation

LABELS = ("border_line", "goal_box_line", "connecting_line")
GOAL_FRAMES = Path(__file__).parents[1] / "tests" / "data" / "spl_goal_frames.csv"
_NEAR_PX = 8.0
_ON_FRAME = 0.5  # of a line's length that lies on the goal's frame


@dataclass
class PhotoScores:
    """Sums over photographs. found: of the labelled lines. angles_deg, gaps_m: between border and goal box."""

    labelled: int = 0
    found: int = 0
    angles_deg: list[float] = field(default_factory=list)
    gaps_m: list[float] = field(default_factory=list)
    goal_frames: list[str] = field(default_factory=list)


def measure(photographs: list[Path]) -> PhotoScores:
    """What the detector finds in photographs, each seen for the first time."""
    scores, frames, spl = PhotoScores(), goal_frames(), open_field("spl-9x6")
    for path in photographs:
        known = json.loads(path.with_suffix(".json").read_text())
        camera = camera_of(known)
        image = cv2.imread(str(path))
        assert image is not None
        seen = LineGraphDetector(camera, LineGraphSettings(), spl).detect(image.astype(np.uint8), GroundView(camera))
        _add(scores, seen, {name: _ends(known, name) for name in LABELS})
        if any(_share_on(line, frames.get(path.stem, [])) > _ON_FRAME for line in seen.lines.pixels):
            scores.goal_frames.append(path.stem)
    return scores


def camera_of(known: dict[str, Any]) -> PinholeCamera:
    """The camera that a photograph's JSON describes."""
    x, y, z, w = known["camera_to_ground"]["rotation"]
    rotation = np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
    pose = Pose3(rotation, np.array(known["camera_to_ground"]["translation"]))
    return PinholeCamera(640, 480, *known["focal_length_px"], *known["optical_center_px"], np.zeros(5), pose)


def goal_frames() -> dict[str, list[FloatArray]]:
    """Photograph -> its goal's posts and bars (5,): u0, v0, u1, v1 and width (px), outlined by hand."""
    frames: dict[str, list[FloatArray]] = {}
    with GOAL_FRAMES.open() as file:
        for row in csv.reader(list(file)[1:]):
            frames.setdefault(row[0], []).append(np.array(row[1:], dtype=np.float64))
    return frames


def _ends(known: dict[str, Any], name: str) -> FloatArray:
    return np.array([known["labels_px"][f"{name}_{k}"] for k in (0, 1)])


def _aside(points: FloatArray, line: FloatArray) -> FloatArray:
    """Distances (N,) of points (N, 2) from the straight line through both ends (2, 2)."""
    along = (line[1] - line[0]) / np.hypot(*(line[1] - line[0]))
    offset = points - line[0]
    distances: FloatArray = np.abs(offset[:, 0] * along[1] - offset[:, 1] * along[0])
    return distances


def _add(scores: PhotoScores, seen: Observation, labels: dict[str, FloatArray]) -> None:
    on_ground = {}
    for name, ends in labels.items():
        scores.labelled += 1
        off = [float(_aside(ends, line).max()) for line in seen.lines.pixels]
        if off and min(off) <= _NEAR_PX:
            scores.found += 1
            on_ground[name] = seen.lines.ends_m[int(np.argmin(off))]
    if "border_line" in on_ground and "goal_box_line" in on_ground:
        border, box = on_ground["border_line"], on_ground["goal_box_line"]
        (ax, ay), (bx, by) = border[1] - border[0], box[1] - box[0]
        scores.angles_deg.append(math.degrees(math.atan2(abs(ax * by - ay * bx), abs(ax * bx + ay * by))))
        scores.gaps_m.append(float(_aside(box.mean(axis=0, keepdims=True), border)[0]))


def _share_on(line: FloatArray, frame: list[FloatArray]) -> float:
    """How much of a line (2, 2) in the image lies on a goal's posts and bars."""
    points = np.linspace(line[0], line[1], 51)
    on = np.zeros(len(points), dtype=np.bool_)
    for u0, v0, u1, v1, width in frame:
        along = np.array([u1 - u0, v1 - v0])
        share = np.clip((points - (u0, v0)) @ along / max(along @ along, 1.0), 0.0, 1.0)
        on |= np.hypot(*(points - (u0, v0) - share[:, np.newaxis] * along).T) <= 0.5 * width
    return float(on.mean())


def main() -> None:
    """Print the figures of a folder."""
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    photographs = sorted(Path(sys.argv[1]).glob("*.jpg"))
    scores = measure(photographs)
    print(f"{len(photographs)} photographs")
    print(f"labelled lines found: {scores.found} of {scores.labelled} ({100.0 * scores.found / scores.labelled:.1f} %)")
    print(f"border and goal box: {np.median(scores.angles_deg):.2f}°, {np.median(scores.gaps_m):.3f} m apart (medians)")
    print(f"goal frame taken for a line: {len(scores.goal_frames)} {' '.join(scores.goal_frames)}")


if __name__ == "__main__":
    main()
