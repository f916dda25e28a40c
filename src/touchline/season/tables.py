"""Tables of many runs: a row for each recording, and every estimate; units stand in the columns' names.

As Parquet where pyarrow is installed (extra `season`), the runs as CSV always.
"""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from touchline.config import leaves, settings_tree
from touchline.evaluation import Run
from touchline.evaluation.estimates import EstimateTable
from touchline.files.new import replace_file
from touchline.systems import system_info
from touchline.types import Status

RUNS_CSV, RUNS_PARQUET, ESTIMATES_PARQUET = "runs.csv", "runs.parquet", "estimates.parquet"
Row = dict[str, Any]
_BEGUN = ("run", "recording", "field", "system", "settings", "seed", "version", "started")
_SAID = ("notices", "problems", "said", "ended", "failure")
_COUNTS = ("images", "tracking", "searching", "lost", "missing_images", "black_images", "end_open_images")
_FIGURES = (
    *("duration_s", "rate_images_s", "time_median_ms", "time_p99_ms"),
    *("position_mean_m", "position_median_m", "position_max_m", "heading_mean_rad", "heading_max_rad"),
    *("tracked_position_mean_m", "tracked_position_max_m"),
)
COLUMNS = (*_BEGUN, *_COUNTS, *_FIGURES, *_SAID)


def row_of(finished: Run) -> Row:
    """A finished run's row: counts, times, errors where the recording holds truth, what was said."""
    summary = finished.summary
    own = leaves(settings_tree(system_info(summary["system"]).settings()))
    changed = [f"{key}={value}" for key, value in leaves(summary["settings"]).items() if own.get(key) != value]
    errors = summary["errors"] or {}
    figures = {
        f"{name}_{statistic}_{unit}": errors[f"{name}_{unit}"][statistic]
        for name, unit in (("position", "m"), ("tracked_position", "m"), ("heading", "rad"))
        if errors.get(f"{name}_{unit}")
        for statistic in ("mean", "median", "max")
    }
    counts = summary["status"]
    return {
        "field": summary["recording"]["field"],
        "system": summary["system"],
        "settings": "; ".join(changed),
        "seed": summary["seed"],
        "version": summary["versions"]["touchline"],
        "started": summary["started"],
        "images": summary["frames"],
        **{status.value: counts[status] for status in Status},
        "missing_images": summary["missing_images"],
        "black_images": summary["black_images"]["count"],
        "end_open_images": summary["either_side"]["count"],
        "duration_s": summary["duration_s"],
        "rate_images_s": summary["rate_fps"],
        "time_median_ms": summary["latency_ms"]["total"]["median"],
        "time_p99_ms": summary["latency_ms"]["total"]["p99"],
        **{name: value for name, value in figures.items() if name in _FIGURES},
        "notices": " ".join(summary["notices"]),
        "problems": "; ".join(f"{count} × {kind}" for kind, count in summary["problems"]["counts"].items()),
        "said": "; ".join(each["what"] for each in summary["said"]),
        "ended": summary["ended"],
    }


def write_runs(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """runs.csv, and runs.parquet where pyarrow is installed; they replace older ones."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    replace_file(folder / RUNS_CSV, text.getvalue().encode())
    pyarrow = _pyarrow()
    if pyarrow is None:
        return
    kinds = {
        **dict.fromkeys((*_BEGUN, *_SAID), pyarrow.string()),
        **dict.fromkeys(("seed", *_COUNTS), pyarrow.int64()),
        **dict.fromkeys(_FIGURES, pyarrow.float64()),
    }
    columns = {name: pyarrow.array([row.get(name) for row in rows], kinds[name]) for name in COLUMNS}
    _write_parquet(folder / RUNS_PARQUET, columns)


def write_estimates(folder: Path, table: EstimateTable) -> None:
    """estimates.parquet beside a run's estimates.csv, where pyarrow is installed: one dataset over all the runs."""
    pyarrow = _pyarrow()
    if pyarrow is None:
        return
    names = np.array([status.value for status in Status])
    poses = table.trajectory.values
    columns = {
        "stamp_ns": table.trajectory.stamp_ns, "x_m": poses[:, 0], "y_m": poses[:, 1], "heading_rad": poses[:, 2],
        "status": pyarrow.array(names[table.status].tolist(), pyarrow.string()),
        "protection_m": table.protection_m, "protection_rad": table.protection_rad,
        "end_probability": table.end_probability, "residual_m": table.residual_m, "points": table.points,
        "perception_ms": table.perception_ms, "localization_ms": table.localization_ms,
        "reason": pyarrow.array([table.reasons[k] for k in table.reason], pyarrow.string()),
        **{f"cov_{name}": table.covariance[:, k] for k, name in enumerate(("xx", "xy", "xt", "yy", "yt", "tt"))},
    }  # fmt: skip
    _write_parquet(folder / ESTIMATES_PARQUET, columns)


def _write_parquet(path: Path, columns: Mapping[str, Any]) -> None:
    import pyarrow
    import pyarrow.parquet

    buffer = pyarrow.BufferOutputStream()
    pyarrow.parquet.write_table(pyarrow.table(dict(columns)), buffer)
    replace_file(path, buffer.getvalue().to_pybytes())


def _pyarrow() -> Any:
    try:
        import pyarrow
    except ImportError:
        return None
    return pyarrow
