"""The report's histogram of times as inline SVG whose colours follow the page, light or dark."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from touchline.evaluation.latency import milliseconds
from touchline.evaluation.run_data import RunData

# Matplotlib gets these placeholders; the page's stylesheet gives them their meaning.
INK, SOFT, GRID, BAR = "#010101", "#020202", "#030303", "#0a0a0a"
_VARIABLES = {INK: "ink", SOFT: "soft", GRID: "grid", BAR: "bar"}
_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "touchline",
    "font.size": 10,
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
_WIDTH_IN = 5.6  # on a telephone its text is as large as the page's notes
_SVG_DPI = 72  # Matplotlib's own for SVG


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
            steps = (1, 2, 5) if high <= 300.0 * low else (1,)
            ticks = [n * 10.0**k for k in range(-3, 6) for n in steps if low <= n * 10.0**k <= high]
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
