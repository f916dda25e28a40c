"""How well protection levels hold: counts of misleading images, and the Stanford diagram (error against level).

A protection level bounds an error that nobody knows while the robot plays; the alert limit is the error from which a
pose does harm. Where the truth is known each image falls in one region of Tossaint et al., "The Stanford-ESA Integrity
Diagram" (Navigation 54(2), 2007): error <= level <= limit is as promised; level > limit says itself that the pose is of
no use; error > level is misleading, and hazardously so where the limit lies between level and error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchline import palette
from touchline.geometry import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ALERT_LIMIT_M, ALERT_LIMIT_RAD = 0.5, float(np.radians(15.0))
_CELLS = 60
_FIRST, _LAST = 1e-3, 30.0  # of both axes


@dataclass(frozen=True, slots=True)
class ProtectionStatistics:
    """Of N tracked images: `bounded` have a protection level, whose median is `median` (NaN without any).

    In `misleading` of them the error is larger than the level; in `hazardous` of these it is beyond the alert limit
    while the level is not. `unavailable` have a level beyond the alert limit.
    """

    images: int
    bounded: int
    misleading: int
    hazardous: int
    unavailable: int
    median: float
    alert_limit: float

    @classmethod
    def of(cls, errors: FloatArray, levels: FloatArray, alert_limit: float) -> ProtectionStatistics:
        """From errors (N,) of either sign and levels (N,) in one unit (m or rad); NaN where no level was given."""
        size, bounded = np.abs(errors), np.isfinite(levels)
        misleading = bounded & (size > levels)
        hazardous = misleading & (size > alert_limit) & (levels <= alert_limit)
        median = float(np.median(levels[bounded])) if bounded.any() else float("nan")
        return cls(
            images=len(size),
            bounded=int(bounded.sum()),
            misleading=int(misleading.sum()),
            hazardous=int(hazardous.sum()),
            unavailable=int(np.sum(bounded & (levels > alert_limit))),
            median=median,
            alert_limit=alert_limit,
        )

    def misleading_rate_bound(self, confidence: float = 0.95) -> float:
        """Of the bounded images, no larger ratio is misleading with this confidence (Clopper and Pearson 1934)."""
        from scipy.stats import beta

        if self.misleading >= self.bounded:
            return 1.0
        return float(beta.ppf(confidence, self.misleading + 1, self.bounded - self.misleading))


def protection_text(position: ProtectionStatistics, heading: ProtectionStatistics, end_open: int = 0) -> str:
    """How often the levels were exceeded, and how large they are, in a sentence. end_open: images in which the end of
    the field is.
    """
    none = position.images - position.bounded
    level = f"{100.0 * position.median:.1f} cm, {np.degrees(heading.median):.2f}°"
    return (
        f"misleading: {position.misleading} of {position.bounded} images in position, {heading.misleading} in heading; "
        f"median protection level {level}"
        + (f"; none given in {none}" if none else "")
        + (f"; given the end of the field, which is open in {end_open}" if end_open else "")
    )


def stanford_diagram(
    errors: FloatArray, levels: FloatArray, alert_limit: float = ALERT_LIMIT_M, *, unit: str = "m", title: str = ""
) -> tuple[Figure, ProtectionStatistics]:
    """The Stanford diagram of errors (N,) and protection levels (N,) in one unit, and its counts."""
    from matplotlib.figure import Figure

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
