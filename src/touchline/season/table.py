"""The table of a season: a row for each recording that is done, as CSV. Units stand in the columns' names.

Each new row replaces the whole file, so that a table is never half written.
"""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from touchline.config import leaves, settings_tree
from touchline.errors import InputError
from touchline.evaluation.summary import RunSummary
from touchline.files.new import replace_file
from touchline.files.opened import read_bytes
from touchline.season.recordings import is_address, opened
from touchline.systems import system_info

CSV = "runs.csv"
Row = dict[str, Any]
_MAX_BYTES = 1_000_000_000
_TEXTS = (
    *("run", "recording", "field", "system", "settings", "version", "started"),
    *("notices", "problems", "said", "ended", "failure", "inputs", "command"),
)
# columns of numbers, each with its place in a run's summary
_COUNTS = {
    **{"seed": "seed", "images": "frames"},
    **{name: f"status.{name}" for name in ("tracking", "searching", "lost")},
    **{"missing_images": "missing_images", "black_images": "black_images.count"},
    "end_open_images": "either_side.count",
}
_FIGURES = {
    "duration_s": "duration_s",
    "rate_images_s": "rate_fps",
    "time_median_ms": "latency_ms.total.median",
    "time_p99_ms": "latency_ms.total.p99",
    "position_mean_m": "errors.position_m.mean",
    "position_median_m": "errors.position_m.median",
    "position_max_m": "errors.position_m.max",
    "heading_mean_rad": "errors.heading_rad.mean",
    "heading_max_rad": "errors.heading_rad.max",
    "tracked_position_mean_m": "errors.tracked_position_m.mean",
    "tracked_position_max_m": "errors.tracked_position_m.max",
}
COLUMNS = (*_TEXTS[:7], *_COUNTS, *_FIGURES, *_TEXTS[7:])


class Table:
    """runs.csv in a folder or below an address. rows: by the names of the runs.

    Raises InputError for a file that is no such table.
    """

    def __init__(self, place: str) -> None:
        self.path = f"{place}/{CSV}"
        data = self._read()
        self.exists = data is not None
        try:
            rows = (
                []
                if data is None
                else list(csv.DictReader(io.StringIO(data.decode(errors="surrogateescape"), newline="")))
            )
            self.rows: dict[str, Row] = {row["run"]: row for row in rows}
            self.commands = [json.loads(row["command"]) for row in rows if not row["failure"]]
        except (ValueError, KeyError, TypeError, csv.Error):
            raise InputError(f"{self.path}: is no table of touchline season; choose another folder") from None

    def write(self, last: Sequence[str] = ()) -> None:
        """Write all rows, those of the runs in `last` behind the others and in their order."""
        order = [*(name for name in self.rows if name not in last), *(name for name in last if name in self.rows)]
        rows = [self.rows[name] for name in order]
        data = _csv(rows)
        if is_address(self.path):
            with opened(self.path, "written") as (system, path):
                system.makedirs(path.rpartition("/")[0], exist_ok=True)
                system.pipe_file(path, data)
        else:
            replace_file(Path(self.path), data)

    def _read(self) -> bytes | None:
        """None where there is no such file."""
        if not is_address(self.path):
            return read_bytes(Path(self.path), _MAX_BYTES) if Path(self.path).exists() else None
        with opened(self.path, "read") as (system, path):
            return bytes(system.cat_file(path)) if system.exists(path) else None


def row_of(summary: RunSummary) -> Row:
    """What a row says of a finished run: counts, times, errors where the recording holds truth, what was said."""
    defaults = leaves(settings_tree(system_info(summary.system).settings()))
    changed = [f"{key}={value}" for key, value in leaves(summary.settings).items() if defaults.get(key) != value]
    problems = [f"{count} × {kind}" for kind, count in summary.problems.counts.items()]
    known = leaves(summary.model_dump())
    return {
        "field": summary.recording.field,
        "system": summary.system,
        "settings": "; ".join(changed),
        "version": summary.versions["touchline"],
        "started": summary.started,
        **{column: known.get(place) for column, place in (_COUNTS | _FIGURES).items()},
        "notices": " ".join(summary.notices),
        "problems": "; ".join(problems),
        "said": "; ".join(each.what for each in summary.said),
        "ended": summary.ended,
    }


def _csv(rows: Sequence[Row]) -> bytes:
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="", extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode(errors="surrogateescape")  # a path may be no UTF-8
