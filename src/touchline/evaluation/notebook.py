"""A run as notebooks show it: a table of its errors and its path on the field; and its estimates as a pandas table."""

from __future__ import annotations

import base64
import html
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from touchline.errors import InputError
from touchline.evaluation.estimates import PROBABILITIES, PROTECTION
from touchline.evaluation.metrics import signed_errors
from touchline.evaluation.run_data import carried_rows
from touchline.field import FieldModel
from touchline.field.drawing import Color, draw_field, field_view
from touchline.palette import BLUE, ORANGE, VERMILLION, bgr
from touchline.types import ImageArray, Mode, Samples, Status

if TYPE_CHECKING:
    from touchline.evaluation.run import Run

_SCALE = 40.0  # pixels per metre
_STATUS_COLORS: dict[Status, Color] = {
    Status.TRACKING: bgr(BLUE),
    Status.SEARCHING: bgr(ORANGE),
    Status.LOST: bgr(VERMILLION),
}
_TRUTH: Color = (60, 60, 60)
_RIM: Color = (255, 255, 255)
_LEGEND = "Blue: tracking; orange: searching; vermillion: lost; dark line: truth."


def run_html(run: Run) -> str:
    """What a notebook shows of a run: its errors and its path. What can't be read any more is said instead."""
    head = f"<p><b>{html.escape(repr(run))}</b></p>"
    try:
        errors = run.errors
        table = f"<p>{html.escape(run.why_no_errors)}</p>" if errors is None else errors._repr_html_()
        picture = path_picture(run.recording().field, run.estimates.trajectory, run.estimates.status, run.truth)
    except InputError as error:
        return f"{head}<p>{html.escape(str(error))}</p>"
    done, code = cv2.imencode(".png", picture)
    source = base64.b64encode(code.tobytes()).decode("ascii") if done else ""
    drawn = f'<img alt="the path" style="max-width:100%" src="data:image/png;base64,{source}">'
    return f"{head}{table}{drawn}<p>{_LEGEND}</p>"


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


def run_frame(run: Run) -> Any:
    """The estimates as a pandas.DataFrame, one row per image, indexed by stamp_ns; with errors where truth is known.

    Raises InputError where pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise InputError("Run.frame: is a pandas table, and pandas is not installed: pip install pandas") from None
    table = run.estimates
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
        truth = run.truth
    if truth is not None:
        errors = signed_errors(table.trajectory, truth)
        for column, name in enumerate(("error_x_m", "error_y_m", "error_heading_rad")):
            columns[name] = np.full(len(table), np.nan)
            columns[name][errors.rows] = errors.values[:, column]
    return pandas.DataFrame(columns, index=pandas.Index(table.trajectory.stamp_ns, name="stamp_ns"))
