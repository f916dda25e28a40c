"""estimates.csv of a run: one row per image, everything an estimate says but its other hypotheses.

Systems that fuse sensors by modes have one more column, `mode`. At the end stand the probability of the pose and that
of its twin at the other end of the field, empty where the system estimates none.
"""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.evaluation.tum import fixed, seconds_text, stamp_from_text
from touchline.files.opened import text_lines
from touchline.geometry import FloatArray
from touchline.types import Estimate, Mode, Samples, Status

HEADER = "t,x,y,theta,cov_xx,cov_xy,cov_xt,cov_yy,cov_yt,cov_tt,status,residual_m,points,perception_ms,localization_ms"
COLUMNS = tuple(HEADER.split(","))
PROBABILITIES = ("probability", "twin_probability")  # which runs of older versions don't have
_STATUSES, _MODES = tuple(Status), tuple(Mode)
_NO_MODE = -1


@dataclass(frozen=True, eq=False, slots=True)
class EstimateTable:
    """The estimates of one run as compact columns of N rows.

    trajectory: stamps (N,) and x, y, heading (N, 3) in (m, m, rad). std: (N, 3) standard deviations (m, m, rad).
    status: (N,) index in `tuple(Status)`. residual_m: (N,), NaN without points. points: (N,).
    perception_ms, localization_ms: (N,). mode: (N,) index in `tuple(Mode)`, -1 of systems without modes.
    probability, twin_probability: (N,) of the pose and of its twin, NaN where unknown.
    """

    trajectory: Samples
    std: npt.NDArray[np.float32]
    status: npt.NDArray[np.int8]
    residual_m: npt.NDArray[np.float32]
    points: npt.NDArray[np.int32]
    perception_ms: npt.NDArray[np.float32]
    localization_ms: npt.NDArray[np.float32]
    mode: npt.NDArray[np.int8]
    probability: npt.NDArray[np.float32]
    twin_probability: npt.NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.trajectory)

    def has_status(self, status: Status) -> npt.NDArray[np.bool_]:
        """Which rows (N,) have this status."""
        has: npt.NDArray[np.bool_] = self.status == _STATUSES.index(status)
        return has

    @property
    def has_modes(self) -> bool:
        """Whether the system fuses sensors by modes."""
        return bool(np.any(self.mode != _NO_MODE))


def header(estimate: Estimate | None) -> str:
    """The header line for a run whose first estimate this is; None: of a run without any."""
    mode = ("mode",) if estimate is not None and estimate.mode is not None else ()
    return ",".join((*COLUMNS, *mode, *PROBABILITIES)) + "\n"


def csv_row(estimate: Estimate) -> str:
    """One line of estimates.csv; a residual without points stays empty."""
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
    fields += ["" if one is None else fixed(one, 4) for one in (estimate.probability, estimate.twin_probability)]
    return ",".join(fields) + "\n"


def read_estimates(path: Path, cut: bool = False) -> EstimateTable:
    """Read a whole estimates.csv (about 70 bytes of memory per row).

    cut: the run may have been cut off within a row, so a last line without its end is left out.
    Raises InputError that names file and line.
    """
    stamps, numbers, statuses, modes = array("q"), array("d"), array("b"), array("b")
    details, points = array("f"), array("i")
    for number, row, columns in _rows(path, cut):
        try:
            stamps.append(stamp_from_text(row[0]))
            numbers.extend(float(text) for text in row[1:4])
            statuses.append(_STATUSES.index(Status(row[10])))
            details.extend(float(row[column]) ** 0.5 for column in (4, 7, 9))
            told = row[-2:] if columns[-2:] == PROBABILITIES else ("", "")
            details.extend(float(text or "nan") for text in (row[11], row[13], row[14], *told))
            points.append(int(row[12]))
            modes.append(_MODES.index(Mode(row[15])) if "mode" in columns else _NO_MODE)
        except (ValueError, TypeError) as error:
            raise InputError(f"{path}, line {number}: {error}") from None
        except OverflowError:
            raise InputError(f"{path}, line {number}: a number of points this large cannot be") from None
        if len(stamps) > 1 and stamps[-1] <= stamps[-2]:
            raise InputError(f"{path}, line {number}: the time does not increase")
    more = _as_numpy(details).reshape(-1, 8)
    poses = _as_numpy(numbers).reshape(-1, 3)
    return EstimateTable(
        trajectory=Samples(_as_numpy(stamps), poses),
        std=more[:, :3],
        status=_as_numpy(statuses),
        residual_m=more[:, 3],
        points=_as_numpy(points),
        perception_ms=more[:, 4],
        localization_ms=more[:, 5],
        mode=_as_numpy(modes),
        probability=more[:, 6],
        twin_probability=more[:, 7],
    )


def _as_numpy(values: array[Any]) -> npt.NDArray[Any]:
    """The same memory as a NumPy array: a long run is held once only."""
    return np.frombuffer(values, dtype=values.typecode) if len(values) else np.zeros(0, dtype=values.typecode)


def _rows(path: Path, cut: bool) -> Iterator[tuple[int, list[str], tuple[str, ...]]]:
    """Line, values and columns of each row."""
    lines = text_lines(path, newline="")
    reader = csv.reader((line for line in lines if line.endswith("\n")) if cut else lines)
    try:
        columns = tuple(next(reader, COLUMNS if cut else ()))
        more = columns[len(COLUMNS) :]
        if columns[: len(COLUMNS)] != COLUMNS or more not in ((), ("mode",), PROBABILITIES, ("mode", *PROBABILITIES)):
            raise InputError(f"{path}, line 1: expected the header {HEADER},{','.join(PROBABILITIES)}")
        for row in reader:
            if len(row) != len(columns):
                raise InputError(f"{path}, line {reader.line_num}: expected {len(columns)} values, found {len(row)}")
            yield reader.line_num, row, columns
    except csv.Error:
        raise InputError(f"{path}: is not a CSV file") from None
