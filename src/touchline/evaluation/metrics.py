"""Error statistics of a trajectory against the truth, as the papers print them.

Mean and median are of |error|; the standard deviation is given of the signed error and of |error|, because the papers
differ: compare like with like. Black images and frames before the first estimate are left out and counted. While the
robot is lost or searched for later on, the pose is a prediction that no image has confirmed: such frames count, and the
position without them has a row of its own.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from typing_extensions import Self

from touchline.errors import InputError
from touchline.evaluation.protection import ALERT_LIMIT_M, ALERT_LIMIT_RAD, ProtectionStatistics, protection_text
from touchline.geometry import BoolArray, FloatArray, IntArray, wrap_angles
from touchline.types import Samples


class NothingToCompareError(InputError):
    """Estimates and truth are there, but no frame counts."""


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Of N errors in one unit (m or rad): mean, median, maximum of |error|, and both standard deviations (of N)."""

    mean: float
    median: float
    std_signed: float
    std_abs: float
    max: float

    @classmethod
    def of(cls, errors: FloatArray) -> Self:
        """From signed errors (N,), N >= 1."""
        size = np.abs(errors)
        return cls(
            float(size.mean()), float(np.median(size)), float(errors.std()), float(size.std()), float(size.max())
        )


@dataclass(frozen=True, slots=True)
class ErrorTable:
    """Errors of x, y, position (m, field frame) and heading (rad), and what was counted and what was left out.

    `frames` were counted. Left out: `skipped` first frames as asked, `black` images, frames `before_first` estimate,
    frames `without_truth` nearer than half a frame. In `lost` of the counted frames the robot was lost or searched for;
    `tracked_x` to `tracked_heading` are of the others (None where these are all or none). `protection_position`,
    `protection_heading`: how the protection levels of the others hold, None where there is none; in `end_open` of these
    the end of the field is open, and the error that counts is the nearer twin's.
    """

    x: ErrorStatistics
    y: ErrorStatistics
    position: ErrorStatistics
    heading: ErrorStatistics
    frames: int
    skipped: int = 0
    black: int = 0
    before_first: int = 0
    without_truth: int = 0
    lost: int = 0
    tracked_x: ErrorStatistics | None = None
    tracked_y: ErrorStatistics | None = None
    tracked_position: ErrorStatistics | None = None
    tracked_heading: ErrorStatistics | None = None
    protection_position: ProtectionStatistics | None = None
    protection_heading: ProtectionStatistics | None = None
    end_open: int = 0

    def as_dict(self) -> dict[str, Any]:
        """For JSON: metres and radians, as the keys say."""
        counts = asdict(self)
        tables = {f"{name}_{unit}": counts.pop(name) for name, unit in (*_UNITS, *_TRACKED)}
        return {**tables, **counts}

    def rows(self) -> list[tuple[str, list[str]]]:
        """Printable rows, cm and degrees: name, then mean, median, std of error, std of |error|, maximum.

        Rows of the tracked images alone come first.
        """
        table = []
        for name, unit in (*_TRACKED, *_UNITS) if self.tracked_position else _UNITS:
            statistics: ErrorStatistics = getattr(self, name)
            scale, decimals = (100.0, 2) if unit == "m" else (float(np.degrees(1.0)), 3)
            numbers = [f"{scale * value:.{decimals}f}" for value in asdict(statistics).values()]
            title = name if (name, unit) in _UNITS else f"{name.removeprefix('tracked_')}, tracked"
            table.append((f"{title} ({'cm' if unit == 'm' else '°'})", numbers))
        return table

    def notes(self) -> list[str]:
        """Sentences: what was counted and left out, and how protection levels hold, where there are any."""
        position, heading = self.protection_position, self.protection_heading
        bounds = [] if position is None or heading is None else [protection_text(position, heading, self.end_open)]
        return [self._left_out(), *bounds]

    def _left_out(self) -> str:
        parts = [
            (self.skipped, "first frames, as asked"),
            (self.before_first, "before the first estimate"),
            (self.black, "black images"),
            (self.without_truth, "without truth"),
        ]
        listed = ", ".join(f"{count} {what}" for count, what in parts if count)
        lost = f" (in {self.lost} the robot was lost or searched for)" if self.lost else ""
        return f"{self.frames} frame{'s' * (self.frames != 1)} counted{lost}; left out: {listed or 'none'}"

    def _repr_html_(self) -> str:
        """The table, as a notebook shows it."""
        head = "".join(f"<th>{title}</th>" for title in ("error", *COLUMNS))
        rows = ((name, "".join(f"<td>{value}</td>" for value in values)) for name, values in self.rows())
        body = "".join(f"<tr><th>{name}</th>{cells}</tr>" for name, cells in rows)
        notes = "".join(f"<p>{note}</p>" for note in self.notes())
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{notes}"

    def __str__(self) -> str:
        rows = self.rows()
        width = max(len(name) for name, _ in rows) + 2
        head = " " * width + "".join(f"{title:>12}" for title in COLUMNS)
        body = [f"{name:<{width}}" + "".join(f"{value:>12}" for value in values) for name, values in rows]
        return "\n".join([head, *body, *self.notes()])


COLUMNS = ("mean |e|", "median |e|", "std e", "std |e|", "max |e|")
_UNITS = (("x", "m"), ("y", "m"), ("position", "m"), ("heading", "rad"))
_TRACKED = tuple((f"tracked_{name}", unit) for name, unit in _UNITS)


@dataclass(frozen=True, eq=False, slots=True)
class Errors:
    """Signed errors, estimate minus truth, of the frames that have a truth.

    rows: (M,) index of each in the trajectory. stamp_ns: (M,). values: (M, 3) x, y (m, field frame), heading (rad,
    wrapped).
    """

    rows: IntArray
    stamp_ns: IntArray
    values: FloatArray

    def position_m(self) -> FloatArray:
        """Distance from the truth (M,)."""
        return np.hypot(self.values[:, 0], self.values[:, 1])


def associate(stamp_ns: IntArray, truth_stamp_ns: IntArray) -> IntArray:
    """Index (N,) of the truth nearest in time to each stamp; -1 if none lies within half a frame.

    A frame is the median step of `stamp_ns`; a lone stamp takes the step of the truth.
    Both arrays increase strictly.
    """
    if len(truth_stamp_ns) == 0 or len(stamp_ns) == 0:
        return np.full(len(stamp_ns), -1, dtype=np.int64)
    steps = np.diff(stamp_ns if len(stamp_ns) > 1 else truth_stamp_ns)
    half_frame_ns = 0.5 * float(np.median(steps)) if len(steps) else 0.0
    after = np.clip(np.searchsorted(truth_stamp_ns, stamp_ns), 1, max(1, len(truth_stamp_ns) - 1))
    after = np.minimum(after, len(truth_stamp_ns) - 1)
    before = np.maximum(after - 1, 0)
    nearer_before = stamp_ns - truth_stamp_ns[before] <= truth_stamp_ns[after] - stamp_ns
    nearest = np.where(nearer_before, before, after)
    near = np.abs(truth_stamp_ns[nearest] - stamp_ns) <= half_frame_ns
    return np.where(near, nearest, -1).astype(np.int64)


def signed_errors(trajectory: Samples, truth: Samples) -> Errors:
    """Estimate minus truth where both exist; trajectory and truth have values (N, 3): x, y, heading (m, m, rad)."""
    match = associate(trajectory.stamp_ns, truth.stamp_ns)
    rows = np.flatnonzero(match >= 0)
    values = trajectory.values[rows, :3] - truth.values[match[rows], :3]
    values[:, 2] = wrap_angles(values[:, 2])
    return Errors(rows, trajectory.stamp_ns[rows], values)


def errors_given_end(trajectory: Samples, truth: Samples, end_open: BoolArray) -> Errors:
    """The same, of the nearer twin where the end of the field is open (N,): protection levels hold given the end."""
    errors = signed_errors(trajectory, truth)
    twins = Samples(trajectory.stamp_ns, trajectory.values[:, :3] * (-1.0, -1.0, 1.0) + (0.0, 0.0, np.pi))
    turned = signed_errors(twins, truth)
    nearer = end_open[errors.rows] & (turned.position_m() < errors.position_m())
    return replace(errors, values=np.where(nearer[:, np.newaxis], turned.values, errors.values))


def error_table(
    trajectory: Samples,
    truth: Samples,
    *,
    located: BoolArray | None = None,
    black_ns: Sequence[tuple[int, int]] = (),
    skip: int = 0,
    protection: FloatArray | None = None,
    end_open: BoolArray | None = None,
) -> ErrorTable:
    """Statistics of a trajectory (N, 3) against the truth (M, 3), both x, y, heading (m, m, rad).

    located: (N,) whether the system was tracking; frames before the first of them are left out. None: all were.
    black_ns: first and last stamp of every stretch of black images. skip: leave out this many frames at the start.
    protection: (N, 2) protection levels of position (m) and heading (rad), NaN where none was given.
    end_open: (N,) whether the twin at the other end is named as possible; levels hold given the end. None: nowhere.

    Raises NothingToCompareError if nothing is left to compare.
    """
    keep = np.arange(len(trajectory)) >= skip
    located = np.ones(len(trajectory), dtype=np.bool_) if located is None else located
    begun = np.maximum.accumulate(located)
    black = within(trajectory.stamp_ns, black_ns)
    errors = signed_errors(trajectory, truth)
    known = np.zeros(len(trajectory), dtype=np.bool_)
    known[errors.rows] = True
    counted = (keep & begun & ~black & known)[errors.rows]
    tracked = counted & located[errors.rows]
    if not counted.any():
        raise NothingToCompareError(_why_nothing_is_left(keep, begun, known))
    some = _statistics(errors.values[tracked]) if 0 < tracked.sum() < counted.sum() else {}
    levels = np.full((len(trajectory), 2), np.nan) if protection is None else protection
    levels = levels[errors.rows[tracked]]
    bounded = bool(np.isfinite(levels).any())
    end_open = np.zeros(len(trajectory), dtype=np.bool_) if end_open is None else end_open
    given_end = errors_given_end(trajectory, truth, end_open)
    of_position = ProtectionStatistics.of(given_end.position_m()[tracked], levels[:, 0], ALERT_LIMIT_M)
    of_heading = ProtectionStatistics.of(given_end.values[tracked, 2], levels[:, 1], ALERT_LIMIT_RAD)
    return ErrorTable(
        **_statistics(errors.values[counted]),
        **{f"tracked_{name}": statistics for name, statistics in some.items()},
        frames=int(np.sum(counted)),
        skipped=int(np.sum(~keep)),
        before_first=int(np.sum(keep & ~begun)),
        black=int(np.sum(keep & begun & black)),
        without_truth=int(np.sum(keep & begun & ~black & ~known)),
        lost=int(np.sum(counted & ~tracked)),
        protection_position=of_position if bounded else None,
        protection_heading=of_heading if bounded else None,
        end_open=int(np.sum(end_open[errors.rows[tracked]])),
    )


def _statistics(values: FloatArray) -> dict[str, Any]:
    """Of errors (N, 3) of x, y (m) and heading (rad)."""
    x, y, heading = values.T
    named = {"x": x, "y": y, "position": np.hypot(x, y), "heading": heading}
    return {name: ErrorStatistics.of(errors) for name, errors in named.items()}


def within(stamp_ns: IntArray, stretches_ns: Sequence[tuple[int, int]]) -> BoolArray:
    """Whether each stamp (N,) lies in one of the stretches (first, last), ends included."""
    inside = np.zeros(len(stamp_ns), dtype=np.bool_)
    for first, last in stretches_ns:
        inside[np.searchsorted(stamp_ns, first, "left") : np.searchsorted(stamp_ns, last, "right")] = True
    return inside


def _why_nothing_is_left(keep: BoolArray, begun: BoolArray, known: BoolArray) -> str:
    if not begun.any():
        return "no frame is left to compare: the robot was never located"
    if not known.any():
        return "no estimate has a truth within half a frame: do both come from the same recording and clock?"
    if not (keep & begun).any():
        return "no frame is left to compare: all frames were left out"
    return "no frame is left to compare: all images with a truth are black or come before the first estimate"
