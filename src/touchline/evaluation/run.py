"""A finished run, read back from its folder, and its errors against the truth."""

import base64
import html
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from touchline.errors import InputError
from touchline.evaluation.estimates import PROBABILITIES, PROTECTION, EstimateTable, read_estimates
from touchline.evaluation.metrics import ErrorTable, NothingToCompareError, error_table, signed_errors
from touchline.evaluation.run_data import carried_rows
from touchline.evaluation.run_folder import ESTIMATES, REPORT, SUMMARY, read_summary
from touchline.evaluation.summary import UNFINISHED
from touchline.evaluation.tum import read_tum
from touchline.field import FieldModel
from touchline.field.drawing import Color, draw_field, field_view
from touchline.given import given_path
from touchline.messages import counted
from touchline.palette import BLUE, ORANGE, VERMILLION, bgr
from touchline.sources import BagOptions, Recording, open_source
from touchline.types import ImageArray, Mode, Samples, Status


class Run:
    """The folder of a run: `errors`, `estimates` and `summary` are read when first asked for.

    follow_links: as of `open_source`, for the recording's truth. Raises InputError if the folder is not that of a run.
    """

    def __init__(self, folder: Path | str, follow_links: bool = False) -> None:
        self.folder = Path(folder)
        self._follow_links = follow_links
        self.summary = read_summary(self.folder)

    @property
    def report(self) -> Path:
        """Where report.html is."""
        return self.folder / REPORT

    @cached_property
    def estimates(self) -> EstimateTable:
        """All estimates, N rows."""
        return read_estimates(self.folder / ESTIMATES, cut=self._is_cut)

    @property
    def incomplete(self) -> str:
        """Why the run does not hold every image of its recording; empty if it does."""
        done = f"{counted(len(self.estimates), 'image')} done"
        if self._is_cut:
            return f"the run has not come to its end: it was cut off, or still goes on; {done}"
        ended = self.summary.ended
        return "" if ended == "complete" else f"the run was {ended} before its end; {done}"

    @property
    def _is_cut(self) -> bool:
        return self.summary.ended == UNFINISHED

    def recording(self) -> Recording:
        """The recording that was run. Raises InputError if it is no longer where it was."""
        recording = self.summary.recording
        if recording.path is None:
            raise InputError(f"{self.folder / SUMMARY}: does not name its recording; give the truth with --truth FILE")
        return open_source(recording.path, self._follow_links, BagOptions.from_dict(recording.bag))

    @cached_property
    def truth(self) -> Samples | None:
        """The recording's true poses (M, 3): x, y, heading (m, m, rad); None if it holds none.

        Raises InputError if the recording is no longer where it was.
        """
        truth = self.recording().truth
        return None if truth is None else truth.samples()

    @property
    def errors(self) -> ErrorTable | None:
        """Errors against the recording's truth; None if there is none, or no frame to compare: `why_no_errors` says.

        Raises InputError if the recording is no longer where it was.
        """
        return self._compared[0]

    @property
    def why_no_errors(self) -> str:
        """Why `errors` is None; empty if it isn't. Raises InputError as `errors` does."""
        return self._compared[1]

    @cached_property
    def _compared(self) -> tuple[ErrorTable | None, str]:
        if self.truth is None:
            return None, "the recording holds no truth to compare with"
        try:
            return self.errors_against(self.truth), ""
        except NothingToCompareError as error:
            return None, str(error)

    def errors_against(self, truth: Samples, skip: int = 0) -> ErrorTable:
        """Errors against a truth (M, 3), the first `skip` frames left out. Raises InputError if no frame is left."""
        table = self.estimates
        return error_table(
            table.trajectory,
            truth,
            located=table.has_status(Status.TRACKING),
            black_ns=self.black_ns(),
            skip=skip,
            protection=table.protection,
            end_open=table.end_open,
        )

    def black_ns(self) -> list[tuple[int, int]]:
        """First and last stamp of every stretch of black images, as far as a run that was cut off has noted them."""
        return self.summary.black_images.stretches_ns

    @cached_property
    def frame(self) -> Any:
        """The estimates as a pandas.DataFrame, one row per image: x_m, y_m, heading_rad, their std, status, residual_m,
        points, times, and errors where the truth is known; the index is stamp_ns. Raises InputError without pandas.
        """
        try:
            import pandas
        except ImportError:
            raise InputError("Run.frame: is a pandas table, and pandas is not installed: pip install pandas") from None
        table = self.estimates
        values, std = table.trajectory.values, table.std
        columns: dict[str, Any] = {"x_m": values[:, 0], "y_m": values[:, 1], "heading_rad": values[:, 2]}
        columns |= {"std_x_m": std[:, 0], "std_y_m": std[:, 1], "std_heading_rad": std[:, 2]}
        columns["status"] = [tuple(Status)[number].value for number in table.status]
        if table.has_modes:
            columns["mode"] = [tuple(Mode)[number].value for number in table.mode]
        columns |= {name: getattr(table, name) for name in ("residual_m", "points", "perception_ms", "localization_ms")}
        estimated = {name: getattr(table, name) for name in (*PROBABILITIES, *PROTECTION)} | dict(table.statistics)
        columns |= {name: values for name, values in estimated.items() if not np.isnan(values).all()}
        if any(table.reasons):
            columns["reason"] = np.array(table.reasons)[table.reason]
        truth = None
        with suppress(InputError):  # the recording may no longer be where it was
            truth = self.truth
        if truth is not None:
            errors = signed_errors(table.trajectory, truth)
            for column, name in enumerate(("error_x_m", "error_y_m", "error_heading_rad")):
                columns[name] = np.full(len(table), np.nan)
                columns[name][errors.rows] = errors.values[:, column]
        return pandas.DataFrame(columns, index=pandas.Index(table.trajectory.stamp_ns, name="stamp_ns"))

    def _repr_html_(self) -> str:
        """The errors and the path, as a notebook shows them; what can't be read any more is said instead."""
        head = f"<p><b>{html.escape(repr(self))}</b></p>"
        try:
            errors = self.errors
            table = f"<p>{html.escape(self.why_no_errors)}</p>" if errors is None else errors._repr_html_()
            picture = path_picture(self.recording().field, self.estimates.trajectory, self.estimates.status, self.truth)
        except InputError as error:
            return f"{head}<p>{html.escape(str(error))}</p>"
        source = base64.b64encode(cv2.imencode(".png", picture)[1].tobytes()).decode("ascii")
        drawn = f'<img alt="the path" style="max-width:100%" src="data:image/png;base64,{source}">'
        return f"{head}{table}{drawn}<p>{_LEGEND}</p>"

    def __repr__(self) -> str:
        known = self.summary
        of = f": {known.system}, {counted(known.frames, 'image')}" if known.system else ""
        return f"Run({str(self.folder)!r}{of})"


def evaluate(
    run: str | Path | Run, truth: str | Path | None = None, skip: int = 0, follow_links: bool = False
) -> ErrorTable:
    """Errors of a run folder or of a trajectory in TUM format, as `touchline evaluate` prints them.

    truth: a TUM file; without it, a run folder's recording is asked. A trajectory file has no statuses and no black
    images, so all its frames count. follow_links: as of `open_source`.
    Raises InputError if there is nothing to compare with.
    """
    run = run.folder if isinstance(run, Run) else given_path("run", "the folder of a run or a trajectory.tum", run)
    truth = None if truth is None else given_path("truth", "the path of a TUM file", truth)
    if not run.exists():
        raise InputError(f"{run}: there is no such run; expected the folder of a run or a trajectory.tum")
    if not run.is_dir():
        if truth is None:
            raise InputError(f"{run}: a trajectory alone has no truth; give it with --truth FILE")
        return error_table(read_tum(run), read_tum(truth), skip=skip)
    finished = Run(run, follow_links)
    known = read_tum(truth) if truth is not None else finished.truth
    if known is None:
        raise InputError(f"{finished.summary.recording.path}: holds no truth; give it with --truth FILE")
    return finished.errors_against(known, skip)


# --- in a notebook ----------------------------------------------------------------------------------------------------


_SCALE = 40.0  # pixels per metre
_STATUS_COLORS: dict[Status, Color] = {
    Status.TRACKING: bgr(BLUE),
    Status.SEARCHING: bgr(ORANGE),
    Status.LOST: bgr(VERMILLION),
}
_TRUTH: Color = (60, 60, 60)
_RIM: Color = (255, 255, 255)
_LEGEND = "Blue: tracking; orange: searching; vermillion: lost; dark line: truth."


def path_picture(field: FieldModel, estimates: Samples, status: Any, truth: Samples | None) -> ImageArray:
    """The field with the true path (dark) and the estimates (N, 3), coloured by status (N,): BGR uint8 (H, W, 3)."""
    picture, view = draw_field(field, _SCALE), field_view(field, _SCALE)
    if truth is not None and len(truth):
        pixels = np.round(view.picture_from_field(truth.values[:, :2])).astype(np.int32)
        for part in np.split(pixels, carried_rows(truth.values)):
            cv2.polylines(picture, [part.reshape(-1, 1, 2)], False, _TRUTH, 1, cv2.LINE_AA)
    placed = np.clip(view.picture_from_field(estimates.values[:, :2]), -1e6, 1e6)
    colors = [_STATUS_COLORS[tuple(Status)[number]] for number in status]
    for radius, paints in ((4, [_RIM] * len(colors)), (3, colors)):  # rims below all: blue on green is hard to see
        for (u, v), paint in zip(placed, paints, strict=True):
            cv2.circle(picture, (round(u), round(v)), radius, paint, -1, cv2.LINE_AA)
    return picture
