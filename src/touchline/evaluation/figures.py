"""The report's figures as inline SVG whose colours follow the page, light or dark."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from matplotlib.ticker import MaxNLocator, MultipleLocator

from touchline.evaluation.estimates import EstimateTable
from touchline.evaluation.latency import milliseconds
from touchline.evaluation.metrics import Errors, within
from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.types import Mode, Samples, Status

# Matplotlib gets these placeholders; the page's stylesheet gives them their meaning.
INK, SOFT, GRID = "#010101", "#020202", "#030303"
CARPET, PAINT, TRUTH = "#040404", "#050505", "#060606"
STATUS_COLORS = {Status.TRACKING: "#070707", Status.SEARCHING: "#080808", Status.LOST: "#090909"}
BAR = "#0a0a0a"
SERIES = ("#0b0b0b", "#0c0c0c", "#0d0d0d")
MODE_COLORS = {Mode.OMNIVISION: "#0e0e0e", Mode.BOTH: "#0f0f0f", Mode.ODOMETRY: "#100101"}
_VARIABLES = {
    INK: "ink",
    SOFT: "soft",
    GRID: "grid",
    CARPET: "carpet",
    PAINT: "paint",
    TRUTH: "truth",
    STATUS_COLORS[Status.TRACKING]: "tracking",
    STATUS_COLORS[Status.SEARCHING]: "searching",
    STATUS_COLORS[Status.LOST]: "lost",
    BAR: "bar",
    SERIES[0]: "series-x",
    SERIES[1]: "series-y",
    SERIES[2]: "series-heading",
    MODE_COLORS[Mode.OMNIVISION]: "omnivision",
    MODE_COLORS[Mode.BOTH]: "both",
    MODE_COLORS[Mode.ODOMETRY]: "odometry",
}
_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "touchline",
    "font.size": 9,
    "font.family": "sans-serif",
    "text.color": INK,
    "axes.labelcolor": SOFT,
    "axes.edgecolor": GRID,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
}
_MOST_BUCKETS = 600
_WIDTH_IN = 7.2
_SVG_DPI = 72  # Matplotlib's own for SVG


@dataclass(frozen=True, eq=False, slots=True)
class RunData:
    """What the figures draw: the estimates, the truth (values (M, 3), m and rad) and errors where known.

    black_ns: first and last stamp of every stretch of black images.
    """

    table: EstimateTable
    field: FieldModel
    truth: Samples | None = None
    errors: Errors | None = None
    black_ns: Sequence[tuple[int, int]] = ()

    @property
    def first_located(self) -> int:
        """The row of the first located estimate; the number of rows if there is none."""
        located = self.table.has_status(Status.TRACKING)
        return int(np.argmax(located)) if located.any() else len(self.table)

    def errors_since_located(self) -> Errors | None:
        """The errors from the first located estimate on; None if there are none."""
        if self.errors is None:
            return None
        begun = self.errors.rows >= self.first_located
        if not begun.any():
            return None
        return Errors(self.errors.rows[begun], self.errors.stamp_ns[begun], self.errors.values[begun])

    def seconds(self, stamp_ns: npt.NDArray[np.int64]) -> FloatArray:
        """Time since the first frame (s)."""
        start = self.table.trajectory.stamp_ns[0] if len(self.table) else 0
        return (stamp_ns - start) / 1e9


def thinned(times: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A long series (N,) for drawing: lowest and highest value of each of 600 stretches, so that no peak is lost.

    A NaN interrupts the line; of a stretch without any number one is kept.
    """
    if len(times) <= 2 * _MOST_BUCKETS:
        return times, values
    edges = np.linspace(0, len(times), _MOST_BUCKETS + 1).astype(np.int64)
    rows: list[int] = []
    for first, last in pairwise(edges):
        part = values[first:last]
        if np.isnan(part).all():
            rows.append(int(first))
            continue
        rows += sorted({int(first + np.nanargmin(part)), int(first + np.nanargmax(part))})
    return times[rows], values[rows]


def field_figure(data: RunData) -> str:
    """The field with the true and the estimated path, coloured by status, or by mode where the system has modes."""
    field = data.field
    width, height = field.length + 2 * field.border, field.width + 2 * field.border

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.add_patch(Rectangle((-width / 2, -height / 2), width, height, color=CARPET, linewidth=0))
        for line in field.polylines(0.1):
            axes.plot(*line.T, color=PAINT, linewidth=1.6, solid_capstyle="butt")
        for x, y, diameter in field.discs:
            axes.add_patch(Circle((x, y), diameter / 2, color=PAINT, linewidth=0))
        _draw_paths(axes, data)
        axes.set(aspect="equal", xlim=(-width / 2, width / 2), ylim=(-height / 2, height / 2))
        axes.xaxis.set_major_locator(MultipleLocator(2.0))
        axes.yaxis.set_major_locator(MultipleLocator(2.0))
        axes.grid(False)
        axes.spines[:].set_visible(False)
        axes.set_xlabel("x (m)")
        axes.set_ylabel("y (m)")

    return _svg(draw, _WIDTH_IN, _WIDTH_IN * height / width + 0.2, "Field with the estimated and the true path")


def path_key(data: RunData) -> list[tuple[str, str]]:
    """What the figure of the field shows, in words, each with the stylesheet's name of its colour."""
    key = [("truth", _VARIABLES[TRUTH])] if data.truth is not None else []
    key += [(label, _VARIABLES[color]) for label, color, here in _path_groups(data) if here.any()]
    return key + ([("first located", "first-located")] if data.first_located < len(data.table) else [])


def _draw_paths(axes: Axes, data: RunData) -> None:
    if data.truth is not None:
        path = _thinned_path(data.truth.values)
        axes.plot(*path.T, color=TRUTH, linewidth=6, alpha=0.5, solid_capstyle="round")
    positions = _thinned_path(data.table.trajectory.values[data.first_located :])
    for _, color, here in _path_groups(data):
        if here.any():
            axes.plot(*positions[here].T, ".", color=color, markersize=5, markeredgewidth=0)
    if data.first_located < len(data.table):
        first = data.table.trajectory.values[data.first_located, :2]
        axes.plot(*first, "o", color=INK, markersize=8, fillstyle="none", linestyle="none")


def _path_groups(data: RunData) -> list[tuple[str, str, npt.NDArray[np.bool_]]]:
    """Name, colour and rows, among the thinned ones since the robot was first located, of every mode and status."""
    begun = slice(data.first_located, None)
    status = _thinned_path(data.table.status[begun, np.newaxis])[:, 0]
    mode = _thinned_path(data.table.mode[begun, np.newaxis])[:, 0]
    tracking = status == tuple(Status).index(Status.TRACKING)
    groups = [(name.value, color, tracking & (mode == tuple(Mode).index(name))) for name, color in MODE_COLORS.items()]
    return groups + [
        (name.value, color, (status == tuple(Status).index(name)) & ~(tracking & (mode >= 0)))
        for name, color in STATUS_COLORS.items()
    ]


def _thinned_path(rows: npt.NDArray[np.generic]) -> FloatArray:
    step = max(1, -(-len(rows) // 4000))
    return np.asarray(rows[::step, :2], dtype=np.float64)


def error_figure(data: RunData) -> str:
    """Signed errors of x, y (cm) and heading (degrees) from the first located estimate on; black images are shaded."""
    errors = data.errors_since_located()
    if errors is None:
        raise ValueError("an error figure needs the truth and a located estimate")
    times = data.seconds(errors.stamp_ns)
    black = within(errors.stamp_ns, data.black_ns)
    values = np.where(black[:, np.newaxis], np.nan, errors.values)

    step = _step(times)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(3, 1, sharex=True)
        scales = ((100.0, "x (cm)"), (100.0, "y (cm)"), (float(np.degrees(1.0)), "heading (°)"))
        for column, (axes, (scale, label)) in enumerate(zip(panels, scales, strict=True)):
            axes.axhline(0.0, color=SOFT, linewidth=0.8)
            for first, last, is_black in _stretches(black.astype(np.int8)):
                if is_black:
                    axes.axvspan(times[first] - 0.5 * step, times[last] + 0.5 * step, color=GRID, linewidth=0)
            axes.plot(*thinned(times, scale * values[:, column]), color=SERIES[column], linewidth=1.3)
            if not black.all():
                _calm_limits(axes, scale * values[~black, column])
            axes.set_ylabel(label)
        panels[-1].set_xlabel("time (s)")
        figure.align_ylabels()

    return _svg(draw, _WIDTH_IN, 4.8, "Errors of x, y and heading over time")


def _calm_limits(axes: Axes, values: FloatArray) -> None:
    """Limits from the 98th percentile if a few frames (before the robot is found) would flatten all others."""
    size = np.abs(values)
    usual, largest = 1.6 * float(np.percentile(size, 98)), float(size.max())
    if 0.0 < 3.0 * usual < largest:
        axes.set_ylim(-usual, usual)
        axes.text(
            0.995,
            0.95,
            f"cut off; largest {largest:.3g}",
            transform=axes.transAxes,
            ha="right",
            va="top",
            fontsize=8,
            color=SOFT,
        )


def status_figure(data: RunData) -> str:
    """Status as a coloured band, with the residual (cm) and the number of points below it, over time."""
    times = data.seconds(data.table.trajectory.stamp_ns)
    residual_cm = 100.0 * data.table.residual_m.astype(np.float64)

    def draw(figure: Figure) -> None:
        band, residual, points = figure.subplots(3, 1, sharex=True, height_ratios=(0.35, 1, 1))
        for first, last, number in _stretches(data.table.status):
            begin = times[first]
            end = times[last + 1] if last + 1 < len(times) else times[last] + _step(times)
            band.axvspan(begin, end, color=STATUS_COLORS[tuple(Status)[number]], linewidth=0)
        band.set(ylim=(0, 1), yticks=[], ylabel="status")
        band.yaxis.label.set(rotation=0, ha="right", va="center")
        band.grid(False)
        band.spines[:].set_visible(False)
        known = np.isfinite(residual_cm)
        residual.plot(*thinned(times[known], residual_cm[known]), color=BAR, linewidth=1.2)
        residual.set(ylabel="residual (cm)", ylim=(0, None))
        points.plot(*thinned(times, data.table.points.astype(np.float64)), color=BAR, linewidth=1.2)
        points.set(ylabel="line points", ylim=(0, None), xlabel="time (s)")
        figure.align_ylabels([residual, points])

    return _svg(draw, _WIDTH_IN, 4.0, "Status, residual and number of line points over time")


def _step(times: FloatArray) -> float:
    return float(np.median(np.diff(times))) if len(times) > 1 else 1.0


def _stretches(status: npt.NDArray[np.int8]) -> list[tuple[int, int, int]]:
    """First row, last row and value of every stretch of equal values; thinned to what a screen can show."""
    step = max(1, len(status) // 20_000)
    starts = np.flatnonzero(np.diff(status[::step], prepend=np.int8(-1))) * step
    ends = np.append(starts[1:] - 1, len(status) - 1)
    return [(int(a), int(b), int(status[a])) for a, b in zip(starts, ends, strict=True)]


def latency_figure(data: RunData, latency_ms: dict[str, Any]) -> str:
    """Histogram of the time spent per frame, perception and localization together (ms, logarithmic).

    latency_ms: as `FrameTimes.summary` has it; the first frames, which it leaves out, have a colour of their own.
    """
    spent_ms = (data.table.perception_ms + data.table.localization_ms).astype(np.float64)
    shown_ms, left_out = np.maximum(spent_ms, 1e-3), latency_ms["first_left_out"]
    total = latency_ms["total"]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        low, high = max(1e-3, 0.8 * float(spent_ms.min())), 1.25 * float(spent_ms.max()) + 1e-3
        stacked = [shown_ms[left_out:], shown_ms[:left_out]]
        axes.hist(stacked, bins=list(np.geomspace(low, high, 46)), stacked=True, color=[BAR, SOFT], linewidth=0)
        axes.set_xscale("log")
        if high > 8.0 * low:
            ticks = [n * 10.0**k for k in range(-3, 6) for n in (1, 2, 5) if low <= n * 10.0**k <= high]
        else:
            ticks = [tick for tick in MaxNLocator(7).tick_values(low, high) if low <= tick <= high]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set(xlabel="time per frame (ms)", ylabel="frames", xlim=(low, high))
        top = axes.get_ylim()[1]
        for name, side in (("median", "right"), ("p99", "left")):
            value = total[name]
            axes.axvline(value, color=INK, linewidth=1.0)
            axes.text(value, 1.04 * top, f" {name} {milliseconds(value)} ms ", ha=side, va="bottom", fontsize=9)

    return _svg(draw, _WIDTH_IN, 2.8, "Histogram of the time per frame")


def _svg(draw: Callable[[Figure], None], width_in: float, height_in: float, title: str) -> str:
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), dpi=_SVG_DPI, layout="constrained")
        figure.patch.set_alpha(0.0)
        draw(figure)
        for axes in figure.axes:
            axes.patch.set_alpha(0.0)
        _lay_out(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return _inline(buffer.getvalue(), title)


def _lay_out(figure: Figure) -> None:
    """Place the axes once and for all; `savefig` would do so twice, and draw twice."""
    FigureCanvasSVG(figure)
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.execute(figure)
    figure.set_layout_engine(None)


def _inline(svg: str, title: str) -> str:
    """An SVG file's text as an element of the page: no prologue, ids of its own, colours from the stylesheet."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    prefix = re.sub(r"\W+", "-", title.lower())
    svg = re.sub(r'\bid="', f'id="{prefix}-', svg)
    svg = re.sub(r'href="#', f'href="#{prefix}-', svg).replace("url(#", f"url(#{prefix}-")
    svg = re.sub(r' xmlns(:xlink)?="[^"]*"', "", svg).replace("xlink:href", "href")
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r"<style.*?</style>", "", svg, flags=re.DOTALL)
    svg = re.sub(r"font: (\S+) [^;\"]*", r"font-size: \1", svg)
    svg = re.sub(r"font-family: [^;\"]*", "font-family: inherit", svg)
    for color, variable in _VARIABLES.items():
        svg = svg.replace(color, f"var(--{variable})")
    return svg.replace("<svg", f'<svg role="img" aria-label="{title}"', 1)
