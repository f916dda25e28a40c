"""How the viewer is arranged when it opens, and how the curves of a run look."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple

from touchline.palette import BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILLION, rgb
from touchline.types import Status

TIMELINE = "time"
CAMERA, FIELD, STATUS, ABOUT, LOG = "camera", "above/field", "status", "about", "log"
STATUS_COLORS = {Status.TRACKING: BLUE, Status.SEARCHING: ORANGE, Status.LOST: VERMILLION}


class Plot(NamedTuple):
    """A plot of curves over time: its path, title and, for each curve, path, name and colour.

    banded: two curves more, ± 2σ about zero, are drawn thinner.
    """

    path: str
    title: str
    curves: tuple[tuple[str, str, str], ...]
    banded: bool = False


ERRORS = (
    Plot("plots/x", "x (cm), ± 2σ", (("error", "error of x", BLUE),), banded=True),
    Plot("plots/y", "y (cm), ± 2σ", (("error", "error of y", VERMILLION),), banded=True),
    Plot("plots/heading", "heading (°), ± 2σ", (("error", "error of heading", GREEN),), banded=True),
)
MEASURED = (
    Plot("plots/residual", "Residual (cm)", (("residual", "residual", PURPLE),)),
    Plot("plots/compass", "Compass (°)", (("compass", "compass less heading", SKY),)),
    Plot("plots/exposure", "Exposure (ms), gain", (("exposure", "exposure (ms)", ORANGE), ("gain", "gain", GREEN))),
    Plot(
        "plots/latency",
        "Time (ms)",  # of the first ones, in which code is loaded, nothing is drawn
        (("perception", "perception", BLUE), ("localization", "localization", VERMILLION)),
    ),
)
_BAND, _CARPET = "#999999", "#a9cfa4"  # light enough for every colour upon it


def layout(field_m: tuple[float, float], errors: bool) -> Any:
    """The blueprint: image and field from above on the left, status and curves on the right; errors and what was
    measured lie behind each other, so that a narrow window has room for their titles and axes.

    field_m: length and width, border included. errors: whether the truth is known.
    """
    blueprint = importlib.import_module("rerun.blueprint")
    half_x, half_y = 0.5 * field_m[0], 0.5 * field_m[1]
    bounds = blueprint.VisualBounds2D(x_range=[-half_x, half_x], y_range=[-half_y, half_y])
    everything = blueprint.VisibleTimeRange(
        TIMELINE, start=blueprint.TimeRangeBoundary.infinite(), end=blueprint.TimeRangeBoundary.cursor_relative()
    )
    above = blueprint.Spatial2DView(
        origin="above",
        name="Field",
        visual_bounds=bounds,
        background=rgb(_CARPET),
        overrides={f"{FIELD}/{path}": blueprint.VisibleTimeRanges(everything) for path in ("path", "truth")},
    )
    texts = (blueprint.TextDocumentView(origin=ABOUT, name="About"), blueprint.TextLogView(origin=LOG, name="Problems"))
    left = blueprint.Vertical(
        blueprint.Spatial2DView(origin=CAMERA, name="Camera"), blueprint.Tabs(above, *texts), row_shares=[1, 1]
    )
    groups = (("Errors", ERRORS if errors else ()), ("Measured", MEASURED))
    curves = [
        blueprint.Vertical(*(_plot_view(blueprint, plot) for plot in plots), name=name)
        for name, plots in groups
        if plots
    ]
    status = blueprint.StateTimelineView(origin=STATUS, name="Status")
    right = blueprint.Vertical(status, blueprint.Tabs(*curves, active_tab=0), row_shares=[1, 6])
    return blueprint.Blueprint(
        blueprint.Horizontal(left, right, column_shares=[1.2, 1.0]),
        blueprint.TimePanel(state="collapsed", timeline=TIMELINE),
        blueprint.SelectionPanel(state="hidden"),
        blueprint.BlueprintPanel(state="hidden"),
    )


def send_styles(stream: Any, errors: bool) -> None:
    """Names, colours and widths of all curves, once."""
    rerun = importlib.import_module("rerun")
    states = list(STATUS_COLORS)
    stream.log(
        STATUS,
        rerun.StateConfiguration(values=list(map(str, states)), colors=list(map(rgb, STATUS_COLORS.values()))),
        static=True,
    )
    for plot in (*(ERRORS if errors else ()), *MEASURED):
        for path, name, color in plot.curves:
            style = rerun.SeriesLines(colors=rgb(color), names=name, widths=1.5)
            stream.log(f"{plot.path}/{path}", style, static=True)
        if plot.banded:
            band = rerun.SeriesLines(colors=2 * [rgb(_BAND)], names=["+2σ", "-2σ"], widths=[1.0, 1.0])
            stream.log(f"{plot.path}/band", band, static=True)


def _plot_view(blueprint: Any, plot: Plot) -> Any:
    legend = blueprint.PlotLegend(visible=len(plot.curves) > 1)
    return blueprint.TimeSeriesView(origin=plot.path, name=plot.title, plot_legend=legend)
