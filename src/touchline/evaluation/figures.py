"""The report's histogram of times as inline SVG, in the colours of the page's stylesheet.

Drawn here: Matplotlib would take half a second and 40 MB for it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from touchline.evaluation.latency import milliseconds
from touchline.geometry import FloatArray

# as large in the page as its notes' text on a telephone
_WIDTH, _HEIGHT = 403.0, 202.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 8.0, 22.0, 38.0  # around the axes
_LABEL = 90.0  # the longest label is not wider
_BINS = 45
_MAX_TICKS = 7


def latency_figure(spent_ms: FloatArray, latency_ms: dict[str, Any]) -> str:
    """Histogram of the times (N,) spent per frame (ms, logarithmic).

    latency_ms: as `FrameTimes.summary` has it; the first frames, which it leaves out, have a colour of their own.
    """
    low, high = max(1e-3, 0.8 * float(spent_ms.min())), 1.25 * float(spent_ms.max()) + 1e-3
    shown_ms, left_out = np.maximum(spent_ms, 1e-3), latency_ms["first_left_out"]
    edges = np.geomspace(low, high, _BINS + 1)
    later, first = (np.histogram(some, edges)[0] for some in (shown_ms[left_out:], shown_ms[:left_out]))
    most = 1.05 * max(int((later + first).max()), 1)
    drawn = [_count_axis(most), _time_axis(low, high)]
    drawn += [_bars(later, np.zeros_like(later), most, "bar"), _bars(first, later, most, "soft")]
    median, p99 = (_across(latency_ms["total"][name], low, high) for name in ("median", "p99"))
    after = min(p99 + 4.0, _WIDTH - _LABEL)  # each label has its room
    before = max(min(median - 4.0, after - 8.0), _LABEL)
    for name, x, at, anchor in (("median", median, before, "end"), ("p99", p99, after, "start")):
        drawn.append(f"<path d='M{x:.1f},{_TOP:g}V{_HEIGHT - _BOTTOM:g}' stroke='var(--ink)'/>")
        words = f"{name} {milliseconds(latency_ms['total'][name])} ms"
        drawn.append(_text(at, _TOP - 6.0, words, f"text-anchor='{anchor}' fill='var(--ink)'"))
    return (
        f"<svg role='img' aria-label='Histogram of the time per frame' viewBox='0 0 {_WIDTH:g} {_HEIGHT:g}' "
        f"font-size='10' fill='var(--soft)'>{''.join(drawn)}</svg>"
    )


def _across(time_ms: float, low: float, high: float) -> float:
    """Where a time stands along the logarithmic axis."""
    share = math.log(max(time_ms, 1e-3) / low) / math.log(high / low)
    return _LEFT + min(max(share, 0.0), 1.0) * (_WIDTH - _LEFT - _RIGHT)


def _up(count: float, most: float) -> float:
    return _HEIGHT - _BOTTOM - count / most * (_HEIGHT - _BOTTOM - _TOP)


def _bars(counts: Sequence[int] | FloatArray, below: Sequence[int] | FloatArray, most: float, color: str) -> str:
    """A bar of each bin, on those below."""
    wide = (_WIDTH - _LEFT - _RIGHT) / _BINS
    boxes = "".join(
        f"M{_LEFT + k * wide:.1f},{_up(base, most):.1f}h{wide:.1f}V{_up(base + count, most):.1f}h{-wide:.1f}z"
        for k, (count, base) in enumerate(zip(counts, below, strict=True))
        if count
    )
    return f"<path d='{boxes}' fill='var(--{color})'/>"


def _time_axis(low: float, high: float) -> str:
    """Milliseconds below, with the lines of the grid."""
    drawn = []
    for tick in _time_ticks(low, high):
        x = _across(tick, low, high)
        drawn.append(f"<path d='M{x:.1f},{_TOP:g}V{_HEIGHT - _BOTTOM:g}' stroke='var(--grid)' stroke-width='0.6'/>")
        drawn.append(_text(x, _HEIGHT - _BOTTOM + 14.0, f"{tick:g}", "text-anchor='middle'"))
    middle = 0.5 * (_LEFT + _WIDTH - _RIGHT)
    return "".join(drawn) + _text(middle, _HEIGHT - 6.0, "time per frame (ms)", "text-anchor='middle'")


def _time_ticks(low: float, high: float) -> list[float]:
    """Round times of an axis, whole decades where it is long."""
    if high > 8.0 * low:
        steps = (1, 2, 5) if high <= 300.0 * low else (1,)
        return [n * 10.0**k for k in range(-3, 6) for n in steps if low <= n * 10.0**k <= high]
    step = _round_step((high - low) / _MAX_TICKS)
    return [round(k * step, 9) for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _count_axis(most: float) -> str:
    """Frames to the left, with the lines of the grid."""
    drawn, step = [], max(_round_step(most / _MAX_TICKS), 1.0)
    for k in range(math.floor(most / step) + 1):
        y = _up(k * step, most)
        drawn.append(f"<path d='M{_LEFT:g},{y:.1f}H{_WIDTH - _RIGHT:g}' stroke='var(--grid)' stroke-width='0.6'/>")
        drawn.append(_text(_LEFT - 5.0, y + 3.5, f"{k * step:g}", "text-anchor='end'"))
    middle = 0.5 * (_TOP + _HEIGHT - _BOTTOM)
    return "".join(drawn) + _text(-middle, 11.0, "frames", "text-anchor='middle' transform='rotate(-90)'")


def _round_step(least: float) -> float:
    """The next of 1, 2, 5, 10, 20 and so on."""
    decade = 10.0 ** math.floor(math.log10(least))
    return next(n * decade for n in (1.0, 2.0, 5.0, 10.0) if n * decade >= 0.999 * least)


def _text(x: float, y: float, words: str, how: str) -> str:
    return f"<text x='{x:.1f}' y='{y:.1f}' {how}>{words}</text>"
