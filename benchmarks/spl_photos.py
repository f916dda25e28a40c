"""Lines of the line graph in photographs of a real field, against the lines that people labelled in them.

    python benchmarks/spl_photos.py FOLDER

FOLDER holds photographs, and beside each a JSON with the camera's intrinsics, its pose on the ground and the ends of
three lines (field border, goal box, what connects them). Printed: for how many labelled lines a detected one passes
within 8 px of both ends; the angle and the distance on the ground between border and goal box as detected; in how
many photographs the white goal's frame became a field line, by the outlines in tests/data/spl_goal_frames.csv; and how
far `locate` is from the pose that the labelled lines give with roll and pitch free, where they fit to 5 cm.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from touchline.camera import GroundView, PinholeCamera
from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.localization.one_shot.locate import locate
from touchline.perception.line_graph import LineGraphDetector, LineGraphSettings
from touchline.types import Observation

LABELS = ("border_line", "goal_box_line", "connecting_line")
GOAL_FRAMES = Path(__file__).parents[1] / "tests" / "data" / "spl_goal_frames.csv"
_NEAR_PX = 8.0
_ON_FRAME = 0.5  # of a line's length that lies on the goal's frame


@dataclass
class PhotoScores:
    """Sums over photographs. found: of the labelled lines. angles_deg, gaps_m: between border and goal box.

    sure_m, doubted_m: how far `locate` is from the pose that the labels give, without and with a doubt.
    """

    labelled: int = 0
    found: int = 0
    angles_deg: list[float] = field(default_factory=list)
    gaps_m: list[float] = field(default_factory=list)
    goal_frames: list[str] = field(default_factory=list)
    sure_m: list[float] = field(default_factory=list)
    doubted_m: list[float] = field(default_factory=list)
    refused: int = 0


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
        _add_pose(scores, seen, camera, spl, np.concatenate([_ends(known, name) for name in LABELS]))
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


def _add_pose(
    scores: PhotoScores, seen: Observation, camera: PinholeCamera, spl: FieldModel, labels: FloatArray
) -> None:
    """How far the located pose is from that of the labels; nothing where these don't fit."""
    labelled = pose_of_labels(camera, spl, labels)
    if labelled is None:
        return
    try:
        found = locate(seen, spl, camera=camera)
    except NoFitError:
        scores.refused += 1
        return
    off_m = min(found.pose.distance_to(pose) for pose in (labelled, labelled.mirrored()))
    (scores.doubted_m if found.doubts else scores.sure_m).append(off_m)


def pose_of_labels(camera: PinholeCamera, spl: FieldModel, labels: FloatArray) -> Pose | None:
    """The pose at which the ends (6, 2) of border, goal box and what connects them, in pixels, lie on the field's
    lines, the camera's roll and pitch fitted, too; None if they miss them by 5 cm.
    """
    goal_x = float(np.abs(spl.segments[:, 0]).max())
    boxes = [s for s in np.abs(spl.segments) if abs(s[1] - s[3]) < 1e-6 and max(s[0], s[2]) > goal_x - 0.05]
    front_x, side_y = max((min(s[0], s[2]), s[1]) for s in boxes if 1.0 < min(s[0], s[2]) < goal_x - 1e-3)

    def on_field(state: FloatArray) -> FloatArray:
        leaning = Pose3.from_roll_pitch_yaw(float(state[3]), float(state[4]), 0.0)
        leant = replace(camera, base_from_camera=leaning.compose(camera.base_from_camera))
        return Pose(*state[:3].tolist()).transform(GroundView(leant).ground_from_image(labels))

    found = []
    for side in (1.0, -1.0):
        lines = np.array([goal_x, goal_x, front_x, front_x, side * side_y, side * side_y])

        def off(state: FloatArray, lines: FloatArray = lines) -> FloatArray:
            placed = on_field(state)
            across = np.concatenate((placed[:4, 0], placed[4:, 1])) - lines
            return np.nan_to_num(np.concatenate((across / 0.02, state[3:] / math.radians(3.0))), nan=1e3)

        for turned in (0.5 * math.pi, -0.5 * math.pi):
            ground = GroundView(camera).ground_from_image(labels)
            along = ground[1] - ground[0]
            heading = turned - math.atan2(along[1], along[0])
            seen = Pose(0.0, 0.0, heading).transform(ground)
            start = np.array([goal_x - seen[:2, 0].mean(), lines[4] - seen[4:, 1].mean(), heading, 0.0, 0.0])
            fit = least_squares(off, start)
            placed = on_field(fit.x)
            inside = side * placed[2:4, 1].mean() < side_y  # the front lies between both sides
            if start[0] < goal_x and inside and np.abs(fit.fun[:6]).max() * 0.02 < 0.05:
                found.append((fit.cost, fit.x))
    if not found:
        return None
    return Pose(*min(found, key=lambda one: one[0])[1][:3].tolist())


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
    both = np.array([*scores.sure_m, *scores.doubted_m])
    far = sum(off > 0.25 for off in scores.sure_m)
    print(f"located within 15 cm: {np.count_nonzero(both < 0.15)} of {len(both) + scores.refused}")
    print(f"refused {scores.refused}, doubted {len(scores.doubted_m)}, beyond 25 cm without a doubt {far}")
    print(f"goal frame taken for a line: {len(scores.goal_frames)} {' '.join(scores.goal_frames)}")


if __name__ == "__main__":
    main()
