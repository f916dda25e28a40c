"""Trajectories in the TUM format: one line per pose, `t x y z qx qy qz qw`, separated by spaces."""

import math
from array import array
from pathlib import Path

import numpy as np

from touchline.errors import InputError
from touchline.files.new import replace_file
from touchline.files.opened import text_lines
from touchline.geometry import Pose
from touchline.messages import counted
from touchline.sources.tables import MAX_TIME_S
from touchline.sources.truth import heading_of
from touchline.types import Samples

NS_PER_S = 1_000_000_000
_MAX_DIGITS = 30  # of whole seconds, leading zeros among them


def tum_line(stamp_ns: int, field_from_robot: Pose) -> str:
    """One line of a TUM file: the stamp exact to the nanosecond, metres to the micrometre, z = 0."""
    half_rad = 0.5 * field_from_robot.heading
    x, y = fixed(field_from_robot.x, 6), fixed(field_from_robot.y, 6)
    return f"{seconds_text(stamp_ns)} {x} {y} 0 0 0 {fixed(math.sin(half_rad), 9)} {fixed(math.cos(half_rad), 9)}\n"


def seconds_text(stamp_ns: int) -> str:
    """A stamp in seconds with all its nine decimals."""
    sign = "-" if stamp_ns < 0 else ""
    seconds, nanoseconds = divmod(abs(stamp_ns), NS_PER_S)
    return f"{sign}{seconds}.{nanoseconds:09d}"


def fixed(value: float, decimals: int) -> str:
    """A number with fixed decimals, never a negative zero: the same pose always gives the same bytes."""
    text = f"{value:.{decimals}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def pose_text(field_from_robot: Pose) -> str:
    """A pose in words, with units."""
    x, y, heading = field_from_robot
    return f"x {fixed(x, 2)} m, y {fixed(y, 2)} m, heading {fixed(math.degrees(heading), 1)}°"


def stamp_from_text(text: str) -> int:
    """Nanoseconds from seconds in decimal notation, without the rounding of a float where it can be avoided.

    Raises ValueError for what is not a number of seconds that fits into 64 bits of nanoseconds.
    """
    whole, _, decimals = text.strip().partition(".")
    digits = whole.lstrip("+-")
    plain = digits.isdecimal() and (decimals == "" or decimals.isdecimal())
    if plain and len(digits) <= _MAX_DIGITS and int(digits) < MAX_TIME_S:
        stamp_ns = int(digits) * NS_PER_S + int(f"{decimals[:9]:0<9}")
        return -stamp_ns if whole.startswith("-") else stamp_ns
    value = float(text)
    if not abs(value) < MAX_TIME_S:
        raise ValueError(f"{text[:30]} s is not a time")
    return round(value * NS_PER_S)


def write_tum(path: Path, trajectory: Samples) -> None:
    """Write stamps (N,) and poses (N, 3) of x, y, heading (m, m, rad). Raises TouchlineError if that cannot be done."""
    rows = zip(trajectory.stamp_ns.tolist(), trajectory.values.tolist(), strict=True)
    replace_file(path, "".join(tum_line(stamp_ns, Pose(*pose)) for stamp_ns, pose in rows).encode())


def read_tum(path: Path) -> Samples:
    """Stamps (N,) and poses (N, 3): x, y, heading (m, m, rad); lines with # are comments.

    Raises InputError that names file and line: not eight finite numbers, or times that do not increase.
    """
    stamps, poses = array("q"), array("d")
    for number, line in enumerate(text_lines(path), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        stamp_ns, pose = _parse(line, f"{path}, line {number}")
        if stamps and stamp_ns <= stamps[-1]:
            raise InputError(f"{path}, line {number}: the time does not increase; sort the file by time")
        stamps.append(stamp_ns)
        poses.extend(pose)
    if not stamps:
        raise InputError(f"{path}: holds no pose; expected lines of 't x y z qx qy qz qw'")
    return Samples(np.array(stamps, dtype=np.int64), np.array(poses, dtype=np.float64).reshape(-1, 3))


def _parse(line: str, where: str) -> tuple[int, Pose]:
    fields = line.split()
    if len(fields) != 8:
        raise InputError(f"{where}: expected 't x y z qx qy qz qw', found {counted(len(fields), 'value')}")
    try:
        stamp_ns = stamp_from_text(fields[0])
        x, y, _, qx, qy, qz, qw = (float(text) for text in fields[1:])
    except ValueError:
        raise InputError(f"{where}: a value is not a number") from None
    if not all(map(math.isfinite, (x, y, qx, qy, qz, qw))) or not any((qx, qy, qz, qw)):
        raise InputError(f"{where}: a value is NaN, infinite or the quaternion is zero")
    return stamp_ns, Pose(x, y, heading_of(qx, qy, qz, qw))
