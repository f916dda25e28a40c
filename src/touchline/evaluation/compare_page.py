"""Runs side by side as a page: their figures, what differs, their paths and curves at one time."""

from __future__ import annotations

import html
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from touchline.evaluation.compare import COLUMNS, UNITS, Compared, Comparison
from touchline.evaluation.timeline import Chart, Curve, page_data, run_tree, shown_rows, truth_tree
from touchline.evaluation.web_page import html_page, time_panel
from touchline.geometry import FloatArray
from touchline.types import Status

_DEGREES = float(np.degrees(1.0))


def comparison_page(compared: Comparison) -> str:
    """The whole page as text."""
    first = compared.first
    rows = shown_rows(first)
    trees = [_tree(one, rows, f"run-{k}") for k, one in enumerate(compared.runs)]
    truth = truth_tree(first, rows)
    data = page_data(first, _charts(compared, rows), [*trees, *([] if truth is None else [truth])], rows)
    key = [(one.name, f"run-{k}") for k, one in enumerate(compared.runs)]
    names = " · ".join(html.escape(one.name) for one in compared.runs)
    recording = html.escape(compared.recording)
    sections = [
        f"<header><p class='brand'>Touchline</p><h1>{names}</h1><p class='facts'>runs of {recording}</p></header>",
        _table("Figures", ("run", *(f"{n} ({u})" for n, u in zip(COLUMNS, UNITS, strict=True))), compared.figures()),
        _table("What differs", ("", *(one.name for one in compared.runs)), compared.differing_settings()),
        _parting(compared),
        time_panel(key, False, "Errors: distance from the truth, and of the heading. "),
    ]
    return html_page(f"{compared.runs[0].name} and others · Touchline", sections, data)


def parting_lines(compared: Comparison) -> list[str]:
    """Where each run and the first one part, a sentence each."""
    lines, first = [], compared.runs[0].name
    for index, one in enumerate(compared.runs[1:], start=1):
        if compared.is_same(index):
            lines.append(f"{one.name} and {first}: the same poses in all {len(one.data.table)} images")
            continue
        apart = int(compared.apart(index).sum())
        usual = 100.0 * float(np.nanmedian(compared.distances_m(index)))
        head = f"{one.name} and {first}: {usual:.2f} cm apart (median)"
        if not apart:
            lines.append(f"{head}, nowhere more than 30 cm or 10°, and tracking alike")
            continue
        parted = compared.stretches(index)
        where = ", ".join(f"{s.begin_s:.2f}–{s.end_s:.2f} s (up to {s.largest_m:.2f} m)" for s in parted)
        lines.append(f"{head}; more than 30 cm or 10° apart, or one alone tracking, in {apart} images: {where}")
    return lines


def _tree(one: Compared, rows: npt.NDArray[np.int64], color: str) -> dict[str, object]:
    """A run's places at the first run's rows; nothing where it has no image."""
    tree = run_tree(one.name, one.data, np.maximum(one.row[rows], 0), color)
    missing = np.flatnonzero(one.row[rows] < 0)
    for key in ("status", "dots", "x", "y", "h"):
        for index in missing:
            tree[key][index] = None
    return tree


def _charts(compared: Comparison, rows: npt.NDArray[np.int64]) -> list[Chart]:
    """Errors of position and heading where the truth is known; the distance from the first run."""
    charts: list[Chart] = []
    tracked = np.array(
        [(one.data.table.has_status(Status.TRACKING)[one.row] & (one.row >= 0)) for one in compared.runs]
    )
    calm = tracked[:, rows]
    if compared.first.errors is not None:
        for title, unit, heading in (("Position error", "cm", False), ("Heading error", "°", True)):
            curves = [Curve(one.name, f"run-{k}", _error(one, heading)[rows]) for k, one in enumerate(compared.runs)]
            charts.append(Chart(title, unit, 2, curves, calm, signed=heading))
    curves = [
        Curve(one.name, f"run-{k}", 100.0 * compared.distances_m(k)[rows])
        for k, one in enumerate(compared.runs)
        if k > 0
    ]
    return [
        *charts,
        Chart(f"Distance from {compared.runs[0].name}", "cm", 2, curves, calm[:1] & calm[1:], signed=False),
    ]


def _error(one: Compared, heading: bool) -> FloatArray:
    """Distance from the truth (cm), or the error of the heading (°), at the first run's rows (N,); NaN for none."""
    own = np.full(len(one.data.table), np.nan)
    errors = one.data.errors_since_located()
    if errors is not None:
        own[errors.rows] = _DEGREES * errors.values[:, 2] if heading else 100.0 * errors.position_m()
    return np.where(one.row >= 0, own[one.row], np.nan)


def _parting(compared: Comparison) -> str:
    lines = "".join(f"<li>{html.escape(line)}</li>" for line in parting_lines(compared))
    why = f"<p class='note'>{html.escape(compared.why_no_truth)}</p>" if compared.why_no_truth else ""
    return f"<section><h2>Where they part</h2><ul>{lines}</ul>{why}</section>"


def _table(title: str, head: Sequence[str], rows: Sequence[tuple[str, list[str]]]) -> str:
    if not rows:
        return f"<section><h2>{title}</h2><p>Nothing.</p></section>"
    top = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    body = "".join(
        f"<tr><th>{html.escape(name)}</th>{''.join(f'<td>{html.escape(value)}</td>' for value in values)}</tr>"
        for name, values in rows
    )
    return (
        f"<section><h2>{title}</h2><div class='scroll'><table class='errors'><thead><tr>{top}</tr></thead>"
        f"<tbody>{body}</tbody></table></div></section>"
    )
