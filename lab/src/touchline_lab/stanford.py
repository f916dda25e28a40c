"""The Stanford diagram: error against protection level (see `touchline.evaluation.protection`)."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from touchline import palette
from touchline.evaluation.protection import ALERT_LIMIT_M, ProtectionStatistics
from touchline.geometry import FloatArray

_CELLS = 60
_FIRST, _LAST = 1e-3, 30.0  # of both axes


def stanford_diagram(
    errors: FloatArray, levels: FloatArray, alert_limit: float = ALERT_LIMIT_M, *, unit: str = "m", title: str = ""
) -> tuple[Figure, ProtectionStatistics]:
    """The Stanford diagram of errors (N,) and protection levels (N,) in one unit, and its counts."""
    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    counts = draw_stanford(figure.subplots(), errors, levels, alert_limit, unit=unit)
    figure.axes[0].set_title(title)
    return figure, counts


def draw_stanford(
    axes: Axes, errors: FloatArray, levels: FloatArray, alert_limit: float, *, unit: str = "m"
) -> ProtectionStatistics:
    """Draw the diagram in given axes, for figures with several; returns its counts.

    How many images a cell holds is its shade; misleading images are dots, so that no single one is overlooked.
    """
    counts = ProtectionStatistics.of(errors, levels, alert_limit)
    known = np.isfinite(levels)
    size, level = (np.clip(values[known], _FIRST, _LAST) for values in (np.abs(errors), levels))
    edges = np.geomspace(_FIRST, _LAST, _CELLS + 1)
    _draw_regions(axes, alert_limit)
    cells = np.histogram2d(level, size, (edges, edges))[0]
    axes.pcolormesh(edges, edges, np.ma.masked_equal(cells, 0.0), cmap="Blues", norm="log", vmin=0.3, zorder=2)
    wrong = np.abs(errors[known]) > levels[known]
    axes.plot(size[wrong], level[wrong], "o", color=palette.BLACK, markersize=2.5, zorder=3)
    axes.plot([_FIRST, _LAST], [_FIRST, _LAST], color=palette.BLACK, linewidth=1.0, zorder=3)
    axes.set(xscale="log", yscale="log", xlim=(_FIRST, _LAST), ylim=(_FIRST, _LAST), aspect="equal")
    axes.set(xlabel=f"error ({unit})", ylabel=f"protection level ({unit})")
    as_promised = int(np.sum(~wrong & (levels[known] <= alert_limit)))
    for words, x, y, across in (
        (f"as promised: {as_promised} of {counts.images}", 1.3 * _FIRST, 0.9 * alert_limit, "left"),
        (f"bound beyond {alert_limit:.2g} {unit}: {counts.unavailable}", 1.3 * _FIRST, 0.8 * _LAST, "left"),
        (f"misleading\n{counts.misleading - counts.hazardous}", 0.9 * alert_limit, 3.0 * _FIRST, "right"),
        (f"hazardously misleading\n{counts.hazardous}", 0.8 * _LAST, 3.0 * _FIRST, "right"),
    ):
        axes.text(x, y, words, ha=across, va="top", fontsize="small", zorder=4)
    return counts


def _draw_regions(axes: Axes, alert_limit: float) -> None:
    """Shades of the regions: unavailable grey, misleading yellow, hazardously misleading red."""
    for corners, color in (
        (((_FIRST, alert_limit), (_FIRST, _LAST), (_LAST, _LAST), (alert_limit, alert_limit)), "#e4e4e4"),
        (((_FIRST, _FIRST), (alert_limit, alert_limit), (alert_limit, _FIRST)), "#f7e3a1"),
        (((alert_limit, alert_limit), (_LAST, _LAST), (_LAST, alert_limit)), "#f7e3a1"),
        (((alert_limit, _FIRST), (alert_limit, alert_limit), (_LAST, alert_limit), (_LAST, _FIRST)), "#f0b08c"),
    ):
        axes.fill(*np.transpose(corners), color=color, linewidth=0.0, zorder=1)
