"""Fields of real robots: their sizes recovered from the model points that a robot logged in its own frame.

`python tests/model_scans.py` writes the files of tests/data/fields anew.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from touchline.field import FieldModel
from touchline.field.letters import field_from_letters
from touchline.field.model import field_to_text
from touchline.geometry import FloatArray, Pose, wrap_angle

FIELDS = Path(__file__).parent / "data" / "fields"
SCANS = (
    "foxy_2018-04-05", "hairy_2018-04-26", "mops_2017-03-31", "myo_2017-11-17", "nase_2017-11-18", "savvy_2017-11-18",
)  # fmt: skip
LINE_WIDTH_M = 0.125  # the model has centre lines only; the rule's width


def load_points(path: Path) -> FloatArray:
    return np.loadtxt(path, delimiter=",", skiprows=1)


def recovered(model: FloatArray) -> tuple[dict[str, float], Pose]:
    """Rulebook letters, measured to the middle of the lines, and field_from_robot, from model points (N, 2)."""
    angle = _direction(model)
    turned = Pose(0.0, 0.0, -angle).transform(model)
    if np.ptp(turned[:, 0]) < np.ptp(turned[:, 1]):
        angle += np.pi / 2
        turned = Pose(0.0, 0.0, -angle).transform(model)
    centre = (turned.max(axis=0) + turned.min(axis=0)) / 2
    points = turned - centre
    x_lines, y_lines = _lines(np.abs(points[:, 0])), _lines(np.abs(points[:, 1]))
    half_length, half_width = x_lines[-1], y_lines[-1]
    penalty_x, goal_x = x_lines[-3:-1]
    goal_y, penalty_y = y_lines[-3:-1]
    ranges = np.hypot(*points.T)
    on_circle = (np.abs(points[:, 0]) > 0.1) & (ranges < min(0.7 * half_width, penalty_x - 0.3))
    letters = {
        "A": 2 * half_length, "B": 2 * half_width, "C": 2 * penalty_y, "D": 2 * goal_y, "E": half_length - penalty_x,
        "F": half_length - goal_x, "G": 0.0, "H": 2 * float(np.median(ranges[on_circle])), "I": 0.0, "J": 0.0,
    }  # fmt: skip
    field_from_robot = Pose(float(-centre[0]), float(-centre[1]), wrap_angle(-angle))
    return {letter: round(size, 2) for letter, size in letters.items()}, field_from_robot


def _direction(model: FloatArray) -> float:
    """Angle of the lines: where the coordinates crowd most."""
    best = (0.0, 0.0)
    centre, reach = 0.0, np.pi / 2
    for step in (0.002, 0.0002, 0.00002):
        for angle in np.arange(centre - reach / 2, centre + reach / 2, step):
            turned = Pose(0.0, 0.0, -angle).transform(model)
            crowds = sum(np.sum(np.histogram(c, np.arange(-30, 30, 0.03))[0] ** 2.0) for c in turned.T)
            best = max(best, (float(crowds), float(angle)))
        centre, reach = best[1], 4 * step
    return best[1]


def _lines(coordinates: FloatArray) -> list[float]:
    """Where at least 80 points share a coordinate to 2 cm, in ascending order."""
    found: list[float] = []
    for value in np.sort(coordinates):
        near = coordinates[np.abs(coordinates - value) < 0.02]
        if len(near) >= 80 and (not found or value - found[-1] > 0.1):
            found.append(float(np.median(coordinates[np.abs(coordinates - np.median(near)) < 0.02])))
    return found


def fields(small_data: Path) -> dict[str, FieldModel]:
    """Every field of the real point files that is no preset: lines with the outer sizes as centre lines, and scans'."""
    rules = {
        "A": 18,
        "B": 12,
        "C": 6.5,
        "D": 3.5,
        "E": 2.25,
        "F": 0.75,
        "G": 0.75,
        "H": 4,
        "I": 0,
        "J": 0,
        "K": LINE_WIDTH_M,
    }
    laboratory = {**rules, "B": 8, "C": 4.34, "D": 2.34, "G": 0, "H": 3}
    made = {
        "msl-18x12-outer": field_from_letters("msl-18x12-outer", rules, measured_to="middle"),
        "nubot-lab-18x8-outer": field_from_letters("nubot-lab-18x8-outer", laboratory, measured_to="middle"),
        "nubot-lab-18x8": field_from_letters("nubot-lab-18x8", laboratory),
    }
    for scan in SCANS:
        letters, _ = recovered(load_points(small_data / "real" / "msl_scans" / f"{scan}.model.csv"))
        made[scan] = field_from_letters(scan, {**letters, "K": LINE_WIDTH_M}, measured_to="middle")
    return made


if __name__ == "__main__":
    for name, field in fields(FIELDS.parent).items():
        (FIELDS / f"{name}.yaml").write_text(field_to_text(field), encoding="utf-8")
        print(name, dict(field.letters))
