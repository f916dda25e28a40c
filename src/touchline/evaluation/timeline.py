"""The data of a page's curves, path and slider, as JSON: thinned to what a screen can show, no peak lost.

Curves end where the robot was carried, and at black images; their axes are cut so that a kidnap flattens nothing else.
"""

import base64
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from touchline.evaluation.latency import milliseconds
from touchline.evaluation.metrics import associate, within
from touchline.evaluation.run_data import RunData, carried_rows
from touchline.evaluation.runner import Thumbnail
from touchline.evaluation.summary import Latency
from touchline.field import FieldModel
from touchline.geometry import BoolArray, FloatArray, IntArray
from touchline.palette import SERIES
from touchline.types import Mode, Status

MAX_ROWS = 2_000
MODE_COLORS = {Mode.OMNIVISION: "omnivision", Mode.BOTH: "both", Mode.ODOMETRY: "odometry"}
_BINS = 45  # of the histogram of times
_CUT = 1.6  # of the usual error: how far an axis reaches if few frames are far worse
_USUAL_PERCENT = 98.0
_EVENT_WORDS = {"slip": "shove", "kidnap": "kidnap", "occluded": "covered", "light_change": "light"}
_MAX_LABEL = 40
_DEGREES = float(np.degrees(1.0))


class Curve(NamedTuple):
    """One quantity over time in a chart: values (N,), NaN where there is none, and 2σ about zero or None."""

    label: str
    color: str
    values: FloatArray
    two_sigma: FloatArray | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Chart:
    """One chart: what it shows, in which unit, and its curves. calm (curves, N): which values set the axis; None: all.

    signed: the axis lies about zero.
    """

    title: str
    unit: str
    digits: int
    curves: Sequence[Curve]
    calm: BoolArray | None = None
    signed: bool = True


def shown_rows(data: RunData) -> IntArray:
    """The rows of a run that a page shows: all, or of each stretch the first and that with the largest error."""
    count = len(data.table)
    if count <= MAX_ROWS:
        return np.arange(count)
    size = np.zeros(count)
    if data.errors is not None:
        size[data.errors.rows] = data.errors.position_m()
    edges = np.linspace(0, count, MAX_ROWS // 2 + 1).astype(np.int64)
    peaks = [first + int(np.argmax(size[first:last])) for first, last in pairwise(edges)]
    return np.unique(np.concatenate((edges[:-1], peaks)))


def page_data(
    data: RunData,
    charts: Sequence[Chart],
    runs: Sequence[dict[str, Any]],
    rows: IntArray,
    thumbnails: Sequence[Thumbnail] = (),
    histogram: dict[str, Any] | None = None,
) -> str:
    """The JSON text that web/page.js reads. The charts' values (N,) and the runs' rows are those of `rows`.

    histogram: of `latency_tree`, for a page with a place for it.
    """
    stamps = data.table.trajectory.stamp_ns[rows]
    begin = int(np.searchsorted(rows, data.first_located)) if data.first_located < len(data.table) else 0
    tree = {
        "t": _numbers(data.seconds(stamps), 3),
        "start": begin,
        "statuses": [status.value for status in Status],
        "runs": list(runs),
        "charts": [_chart_tree(chart, last=chart is charts[-1]) for chart in charts],
        "gaps": _gaps(data, stamps),
        "events": _event_trees(data),
        "histogram": histogram,
        "field": _field_tree(data.field),
        "pictures": [
            {"row": int(np.argmin(np.abs(stamps - stamp_ns))), "jpeg": base64.b64encode(jpeg).decode("ascii")}
            for stamp_ns, jpeg in thumbnails
            if len(stamps)
        ],
    }
    return json.dumps(tree, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")


def run_tree(name: str, data: RunData, rows: IntArray, color: str = "") -> dict[str, Any]:
    """A run's places and statuses at these rows, for the slider and the picture of the path.

    color: the stylesheet's name of that of its dots; by default each dot has that of `dot_colors`.
    """
    poses = data.table.trajectory.values[rows]
    status = [int(value) for value in data.table.status[rows]]
    dots = [each and (color or each) for each in dot_colors(data)[rows].tolist()]
    reasons = {"reasons": list(data.table.reasons), "reason": data.table.reason[rows].tolist()}
    return {"name": name, "marker": color or "tracking", "status": status, **reasons, "dots": dots, **_places(poses)}


def dot_colors(data: RunData) -> npt.NDArray[np.object_]:
    """(N,) the stylesheet's name of each row's colour: of its mode where the robot tracks in one, else of its status.

    None before the robot was first located.
    """
    by_status = np.array([status.value for status in Status], dtype=np.object_)[data.table.status]
    by_mode = np.array([MODE_COLORS[mode] for mode in Mode], dtype=np.object_)[data.table.mode]
    in_mode = data.table.has_status(Status.TRACKING) & (data.table.mode >= 0)
    colors = np.where(in_mode, by_mode, by_status)
    colors[: data.first_located] = None
    return colors


def truth_tree(data: RunData, rows: IntArray) -> dict[str, Any] | None:
    """The true places at these rows; None without truth."""
    if data.truth is None or not len(data.truth):
        return None
    match = associate(data.table.trajectory.stamp_ns, data.truth.stamp_ns)[rows]
    poses = np.where((match >= 0)[:, np.newaxis], data.truth.values[match, :3], np.nan)
    return {"name": "truth", "marker": "truth-place", "status": None, "dots": None, **_places(poses)}


def error_charts(data: RunData, rows: IntArray) -> list[Chart]:
    """Errors of x, y (cm) and heading (°) with ± 2σ since the robot was first located, and what was seen."""
    charts = []
    errors = data.errors_since_located()
    values = np.full((len(data.table), 3), np.nan)
    if errors is not None:
        values[errors.rows] = errors.values
        values[within(data.table.trajectory.stamp_ns, data.black_ns)] = np.nan
        tracked = data.table.has_status(Status.TRACKING)[rows]
        named = (("x", 100.0, "cm"), ("y", 100.0, "cm"), ("heading", _DEGREES, "°"))
        for column, (name, scale, unit) in enumerate(named):
            sigma = np.where(rows >= data.first_located, 2.0 * scale * data.table.std[rows, column], np.nan)
            curve = Curve("error", f"series-{name}", scale * values[rows, column], sigma)
            charts.append(Chart(f"Error of {name}", unit, 2, [curve], tracked[np.newaxis]))
    charts += [*_protection_charts(data, values[rows], rows), *_statistics_charts(data, rows)]
    residual = Curve("residual", "bar", 100.0 * data.table.residual_m[rows].astype(np.float64))
    points = Curve("points", "bar", data.table.points[rows].astype(np.float64))
    charts.append(Chart("Residual: mean distance from the field's lines", "cm", 2, [residual], signed=False))
    charts.append(Chart("Line points or features", "", 0, [points], signed=False))
    return charts


def _protection_charts(data: RunData, errors: FloatArray, rows: IntArray) -> Iterator[Chart]:
    """Protection levels at these rows, with the size of the errors (K, 3) where they are known."""
    sizes = np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])
    named = (("position", 100.0, "cm", data.table.protection_m), ("heading", _DEGREES, "°", data.table.protection_rad))
    for size, (name, scale, unit, level) in zip(sizes, named, strict=True):
        curves = [Curve("error", "run-1", scale * size)] if np.isfinite(size).any() else []
        if np.isfinite(level).any():
            curves += [Curve("protection level", "run-0", scale * level[rows].astype(np.float64))]
            yield Chart(f"Protection level of the {name}", unit, 2, curves, signed=False)


def _statistics_charts(data: RunData, rows: IntArray) -> Iterator[Chart]:
    """The consistency statistics in one chart; none of systems without a monitor."""
    statistics = [(name, values[rows].astype(np.float64)) for name, values in data.table.statistics.items()]
    curves = [Curve(name, f"run-{k % len(SERIES)}", values) for k, (name, values) in enumerate(statistics)]
    if curves:
        yield Chart("Consistency", "", 2, [Curve("alarm", "ink", np.ones(len(rows))), *curves], signed=False)


def latency_tree(spent_ms: FloatArray, latency_ms: Latency) -> dict[str, Any]:
    """How many frames took how long (ms, (N,)), in bins of even width in the logarithm.

    The first frames, which the latency leaves out, are counted by themselves.
    """
    low, high = max(1e-3, 0.8 * float(spent_ms.min())), 1.25 * float(spent_ms.max()) + 1e-3
    shown_ms, left_out = np.maximum(spent_ms, 1e-3), latency_ms.first_left_out
    edges = np.geomspace(low, high, _BINS + 1)
    later, first = (np.histogram(some, edges)[0].tolist() for some in (shown_ms[left_out:], shown_ms[:left_out]))
    marked = [("median", latency_ms.total.median or 0.0), ("p99", latency_ms.total.p99 or 0.0)]
    marks = [{"ms": time_ms, "label": f"{name} {milliseconds(time_ms)} ms"} for name, time_ms in marked]
    return {"low": low, "high": high, "later": later, "first": first, "marks": marks}


def axis_limit(chart: Chart) -> tuple[float, float | None]:
    """How far the axis of a chart reaches from zero, and the largest value if it is cut off there."""
    size = np.abs(np.concatenate([curve.values for curve in chart.curves]))
    known = np.isfinite(size)
    if not known.any():
        return 1.0, None
    calm = known if chart.calm is None else known & chart.calm.ravel()
    bands = [curve.two_sigma[np.isfinite(curve.two_sigma)] for curve in chart.curves if curve.two_sigma is not None]
    usual = float(np.percentile(size[calm if calm.any() else known], _USUAL_PERCENT))
    sure = max((float(np.percentile(band, 90.0)) for band in bands if len(band)), default=0.0)
    largest, reach = float(size[known].max()), _CUT * max(usual, min(sure, 6.0 * usual))
    if largest <= 2.0 * reach or reach == 0.0:
        return 1.05 * max(largest, reach) or 1.0, None
    return reach, largest


def _field_tree(field: FieldModel) -> dict[str, Any]:
    """The carpet and what is painted on it (m)."""
    length, width = field.length + 2.0 * field.border, field.width + 2.0 * field.border
    lines = [np.round(line, 3).tolist() for line in field.polylines(0.1)]
    line_width = max(field.line_width, length / 300)
    return {"size": [length, width], "line_width": line_width, "lines": lines, "discs": field.discs.tolist()}


def _chart_tree(chart: Chart, last: bool) -> dict[str, Any]:
    limit, largest = axis_limit(chart)
    cut = "" if largest is None else f" (axis cut; largest {largest:.3g} {chart.unit})"
    series = [
        {
            "label": curve.label,
            "color": curve.color,
            "values": _numbers(curve.values, chart.digits + 1),
            **({} if curve.two_sigma is None else {"band": _numbers(curve.two_sigma, chart.digits + 1)}),
        }
        for curve in chart.curves
    ]
    return {
        "title": chart.title + cut,
        "axis": chart.unit,
        "unit": chart.unit,
        "digits": chart.digits,
        "range": [-limit if chart.signed else 0.0, limit],
        "series": series,
        "last": last,
    }


def _places(poses: FloatArray) -> dict[str, Any]:
    return {"x": _numbers(poses[:, 0], 3), "y": _numbers(poses[:, 1], 3), "h": _numbers(_DEGREES * poses[:, 2], 1)}


def _gaps(data: RunData, stamps: IntArray) -> list[int]:
    """Rows before which the robot was carried, so that no curve goes on across."""
    times = data.seconds(stamps)
    carried = [int(np.searchsorted(times, kidnap_s)) for kidnap_s in data.kidnaps_s()]
    if data.truth is not None:
        seen = data.truth.stamp_ns[carried_rows(data.truth.values)]
        carried += [int(np.searchsorted(stamps, stamp_ns)) for stamp_ns in seen]
    return sorted({row for row in carried if 0 < row < len(stamps)})


def _event_trees(data: RunData) -> list[dict[str, Any]]:
    """What happened, what the system said and where images are black; what lasted has an end."""
    start_s = 1e-9 * float(data.table.trajectory.stamp_ns[0]) if len(data.table) else 0.0
    is_black = len(data.black_ns) > 0
    spans = [(1e-9 * first, 1e-9 * last, {"label": "black"}) for first, last in data.black_ns]
    for said in data.said:
        shown = {"label": _short(said.what), "color": "searching"}
        spans.append((said.t, said.until, shown))
    trees: list[dict[str, Any]] = [
        {"t": round(begin - start_s, 3), "until": round(end - start_s, 3), **shown} for begin, end, shown in spans
    ]
    trees += [
        {"t": round(event.t_s, 3), "label": _EVENT_WORDS.get(event.kind, event.kind)}
        for event in data.happened()
        if event.kind != "occluded" or not is_black
    ]
    return sorted(trees, key=itemgetter("t"))


def _short(phrase: str) -> str:
    """The beginning of a phrase, as there is room on a curve."""
    head = phrase.partition(":")[0]
    return head if len(head) <= _MAX_LABEL else f"{head[: _MAX_LABEL - 1]}…"


def _numbers(values: FloatArray, digits: int) -> list[float | None]:
    """Rounded for JSON: None for what is not finite, whole numbers without a point."""
    numbers = (round(float(value), digits) if math.isfinite(value) else None for value in values)
    return [int(n) if n is not None and n.is_integer() else n for n in numbers]
