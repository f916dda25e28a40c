"""estimates.csv of a run: one row per image, everything an estimate says but its other hypotheses.

Systems that fuse sensors by modes have one more column, `mode`. Behind it stand the probability of the pose and that of
its twin at the other end of the field; then the end's probability, the protection levels, the consistency statistics as
`name=value;name=value` and the reason of the status. Empty is what the system estimates none of; runs of older versions
lack columns.
"""

from __future__ import annotations

import csv
from array import array
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.evaluation.tum import fixed, seconds_text, stamp_from_text
from touchline.files.opened import text_lines
from touchline.geometry import BoolArray, Float32Array, FloatArray, Int32Array, Pose
from touchline.types import Estimate, Hypothesis, Mode, Samples, Status

HEADER = "t,x,y,theta,cov_xx,cov_xy,cov_xt,cov_yy,cov_yt,cov_tt,status,residual_m,points,perception_ms,localization_ms"
COLUMNS = tuple(HEADER.split(","))
PROBABILITIES = ("probability", "twin_probability", "end_probability")
PROTECTION = ("protection_m", "protection_rad")
END_DECIDED = 0.9  # probability of a pose's end of the field from which it is no longer open
_ESTIMATED = (*PROBABILITIES, *PROTECTION)  # numbers that a system need not give
_OPTIONAL = ("mode", *_ESTIMATED, "statistics", "reason")
_MEASURED = ("residual_m", "perception_ms", "localization_ms")
_STATUSES, _MODES = tuple(Status), tuple(Mode)
_NO_MODE = -1


@dataclass(frozen=True, eq=False, slots=True)
class EstimateTable:
    """The estimates of one run as compact columns of N rows.

    trajectory: stamps (N,) and x, y, heading (N, 3) in (m, m, rad). covariance: (N, 6) xx, xy, xt, yy, yt, tt of it.
    status: (N,) index in `tuple(Status)`. residual_m: (N,), NaN without points. points: (N,).
    perception_ms, localization_ms: (N,). mode: (N,) index in `tuple(Mode)`, -1 of systems without modes.
    probability, twin_probability, end_probability: (N,) of the pose, of its twin, of its end of the field;
    protection_m, protection_rad: (N,); statistics: (N,) each. NaN where there is none. reasons: those of the statuses,
    "" first; reason: (N,) index in them.
    """

    trajectory: Samples
    covariance: Float32Array
    status: npt.NDArray[np.int8]
    residual_m: Float32Array
    points: Int32Array
    perception_ms: Float32Array
    localization_ms: Float32Array
    mode: npt.NDArray[np.int8]
    probability: Float32Array
    twin_probability: Float32Array
    end_probability: Float32Array
    protection_m: Float32Array
    protection_rad: Float32Array
    statistics: Mapping[str, Float32Array]
    reason: Int32Array
    reasons: Sequence[str]

    def __len__(self) -> int:
        return len(self.trajectory)

    def has_status(self, status: Status) -> BoolArray:
        """Which rows (N,) have this status."""
        return self.status == _STATUSES.index(status)

    @property
    def std(self) -> Float32Array:
        """(N, 3) standard deviations (m, m, rad)."""
        return np.sqrt(self.covariance[:, [0, 3, 5]])

    @property
    def protection(self) -> FloatArray:
        """(N, 2) protection levels of position (m) and heading (rad); NaN where none was given."""
        return np.column_stack((self.protection_m, self.protection_rad)).astype(np.float64)

    @property
    def end_open(self) -> BoolArray:
        """(N,) whether the twin at the other end of the field is so likely that the end is open."""
        return self.end_probability < END_DECIDED

    def estimate(self, row: int) -> Estimate:
        """What was written of an image; of the other hypotheses only the twin, if it has a probability."""
        pose = Pose(*self.trajectory.values[row].tolist())
        covariance = np.zeros((3, 3))
        covariance[np.triu_indices(3)] = self.covariance[row]
        estimated: dict[str, Any] = {name: _known(getattr(self, name)[row]) for name in _ESTIMATED}
        measured: dict[str, Any] = {name: float(getattr(self, name)[row]) for name in _MEASURED}
        twin = estimated.pop("twin_probability")
        return Estimate(
            int(self.trajectory.stamp_ns[row]),
            pose,
            covariance + np.triu(covariance, 1).T,
            _STATUSES[self.status[row]],
            points=int(self.points[row]),
            hypotheses=() if twin is None else (Hypothesis(pose.mirrored(), float("nan"), twin),),
            mode=None if self.mode[row] == _NO_MODE else _MODES[self.mode[row]],
            reason=self.reasons[self.reason[row]],
            statistics={name: float(of[row]) for name, of in self.statistics.items() if not np.isnan(of[row])},
            **measured,
            **estimated,
        )

    @property
    def has_modes(self) -> bool:
        """Whether the system fuses sensors by modes."""
        return bool(np.any(self.mode != _NO_MODE))


def header(estimate: Estimate | None) -> str:
    """The header line for a run whose first estimate this is; None: of a run without any."""
    has_mode = estimate is not None and estimate.mode is not None
    return ",".join((*COLUMNS, *_OPTIONAL[0 if has_mode else 1 :])) + "\n"


def csv_row(estimate: Estimate) -> str:
    """One line of estimates.csv; what there is none of stays empty."""
    covariance: FloatArray = estimate.covariance
    upper = (covariance[i, j] for i in range(3) for j in range(i, 3))
    fields = [
        seconds_text(estimate.stamp_ns),
        *(fixed(value, 6) for value in estimate.pose),
        *(f"{value:.6e}" for value in upper),
        estimate.status.value,
        "" if np.isnan(estimate.residual_m) else fixed(estimate.residual_m, 6),
        str(estimate.points),
        fixed(estimate.perception_ms, 4),
        fixed(estimate.localization_ms, 4),
    ]
    if estimate.mode is not None:
        fields.append(estimate.mode.value)
    estimated = (getattr(estimate, name) for name in _ESTIMATED)
    fields += ["" if one is None else fixed(one, 4) for one in estimated]
    fields.append(";".join(f"{name}={value:.4g}" for name, value in estimate.statistics.items()))
    fields.append(_quoted(estimate.reason))
    return ",".join(fields) + "\n"


def _quoted(text: str) -> str:
    """A cell of words: in quotes where a comma or a quote stands in it."""
    return '"' + text.replace('"', '""') + '"' if {",", '"'} & set(text) else text


def read_estimates(path: Path, cut: bool = False) -> EstimateTable:
    """Read a whole estimates.csv (about 100 bytes of memory per row, and 4 for each statistic).

    cut: the run may have been cut off within a row, so a last line without its end is left out.
    Raises InputError that names file and line.
    """
    stamps, poses, points, reason = array("q"), array("d"), array("i"), array("i")
    statuses, modes, covariances = array("b"), array("b"), array("f")
    numbers = {name: array("f") for name in (*_MEASURED, *_ESTIMATED)}
    statistics: defaultdict[str, array[float]] = defaultdict(lambda: array("f", [np.nan]) * (len(stamps) - 1))
    reasons = {"": 0}
    for number, row, column in _rows(path, cut):
        try:
            stamps.append(stamp_from_text(row[0]))
            poses.extend(float(text) for text in row[1:4])
            covariances.extend(float(text) for text in row[4:10])
            if min(covariances[place] for place in (-6, -3, -1)) < 0.0:
                raise ValueError("a variance is negative")
            statuses.append(_STATUSES.index(Status(row[10])))
            points.append(int(row[12]))
            modes.append(_MODES.index(Mode(row[column["mode"]])) if "mode" in column else _NO_MODE)
            for name, values in numbers.items():
                values.append(float(row[column[name]] or "nan") if name in column else np.nan)
            for name, value in _statistics(row[column["statistics"]] if "statistics" in column else "").items():
                statistics[name].append(value)
            reason.append(reasons.setdefault(row[column["reason"]] if "reason" in column else "", len(reasons)))
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}, line {number}: {error}") from None
        except OverflowError:
            raise InputError(f"{path}, line {number}: a number of points this large cannot be") from None
        if len(stamps) > 1 and stamps[-1] <= stamps[-2]:
            raise InputError(f"{path}, line {number}: the time does not increase")
        for values in statistics.values():
            values.extend([np.nan] * (len(stamps) - len(values)))
    return EstimateTable(
        trajectory=Samples(_as_numpy(stamps), _as_numpy(poses).reshape(-1, 3)),
        covariance=_as_numpy(covariances).reshape(-1, 6),
        status=_as_numpy(statuses),
        points=_as_numpy(points),
        mode=_as_numpy(modes),
        statistics={name: _as_numpy(values) for name, values in statistics.items()},
        reason=_as_numpy(reason),
        reasons=tuple(reasons),
        **{name: _as_numpy(values) for name, values in numbers.items()},
    )


def _statistics(text: str) -> dict[str, float]:
    """The values of a cell of statistics by name."""
    return {name: float(value) for name, _, value in (each.partition("=") for each in text.split(";"))} if text else {}


def _known(value: float) -> float | None:
    """None for NaN."""
    return None if np.isnan(value) else float(value)


def _as_numpy(values: array[Any]) -> npt.NDArray[Any]:
    """The same memory as a NumPy array: a long run is held once only."""
    return np.frombuffer(values, dtype=values.typecode) if len(values) else np.zeros(0, dtype=values.typecode)


def _rows(path: Path, cut: bool) -> Iterator[tuple[int, list[str], dict[str, int]]]:
    """Line, values and place of each column."""
    lines = text_lines(path, newline="")
    reader = csv.reader((line for line in lines if line.endswith("\n")) if cut else lines)
    try:
        columns = next(reader, COLUMNS if cut else ())
        places = {name: place for place, name in enumerate(columns)}
        if tuple(columns) != (*COLUMNS, *(name for name in _OPTIONAL if name in places)):
            raise InputError(f"{path}, line 1: expected the header {HEADER},{','.join(_OPTIONAL[1:])}")
        for row in reader:
            if len(row) != len(columns):
                raise InputError(f"{path}, line {reader.line_num}: expected {len(columns)} values, found {len(row)}")
            yield reader.line_num, row, places
    except csv.Error:
        raise InputError(f"{path}: is not a CSV file") from None
