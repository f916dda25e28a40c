"""Where the strip begins and ends. Beside its own black and white these two edges have what happens to lie there.

A field line that begins two pixels behind the strip shines into its blurred edge: the place where the light is half way
between strip and carpet moves by up to a pixel. So every profile across the edge is described in three ways, strip to
carpet, strip to whatever is ahead, and strip to carpet to something else, and the best one tells where the strip ends.
"""

from __future__ import annotations

import numpy as np

from touchline.geometry import FloatArray

SPREAD_PX = np.arange(-4.0, 4.0 + 1e-9, 0.25)
_WINDOW_PX = (-3.5, 2.25)  # of the edge, that is described: further out there may be more than one other thing
_BEFORE_PX = (2.25, 4.5)  # from the edge: the strip's own level there
_AHEAD_PX = (2.25, 3.75)
_FIRST_PX = np.arange(-1.75, 1.75 + 1e-9, 0.025)  # about the rough place
_SECOND_PX = np.arange(0.75, 8.0, 0.25)  # how far beyond an end edge another one is looked for
_BETTER = 0.5  # what another edge must leave of the squared residual to be believed


def edge_spread(r: FloatArray, light: FloatArray, edges: FloatArray, levels: FloatArray, chosen: slice) -> FloatArray:
    """How an edge is blurred, from 1 to 0 at SPREAD_PX: the mean of the chosen ones of the inner edges.

    light (N,) at radii r (N,); edges (E,); levels (E + 1,) before, between and behind them.
    """
    spreads = []
    for k in range(1, len(edges) - 1)[chosen]:
        share = (light - levels[k + 1]) / (levels[k] - levels[k + 1])
        room = 0.5 * min(edges[k] - edges[k - 1], edges[k + 1] - edges[k])
        spread = np.interp(edges[k] + SPREAD_PX, r, share)
        spreads.append(np.where(-room > SPREAD_PX, 1.0, np.where(room < SPREAD_PX, 0.0, spread)))
    mean: FloatArray = np.mean(spreads, axis=0)
    return mean


def end_edge(r: FloatArray, light: FloatArray, rough_px: float, carpet: float, spread: FloatArray) -> float:
    """Where the strip ends on one profile: light (N,) at radii r (N,), the strip before, other things behind it.

    carpet: its level. spread: of an edge, from 1 to 0 at SPREAD_PX.
    """
    window = (r - rough_px > _WINDOW_PX[0]) & (r - rough_px < _WINDOW_PX[1])
    x, y = r[window] - rough_px, light[window]
    step = np.interp(x - _FIRST_PX[:, np.newaxis], SPREAD_PX, spread)  # (A, N)
    best, least = 0.0, np.inf
    strip = float(np.median(light[(r > rough_px - _BEFORE_PX[1]) & (r < rough_px - _BEFORE_PX[0])]))
    ahead = float(np.median(light[(r > rough_px + _AHEAD_PX[0]) & (r < rough_px + _AHEAD_PX[1])]))
    for level in (carpet, ahead):
        if abs(strip - level) < 0.3 * abs(strip - carpet):  # white behind white is no edge
            continue
        off = np.sum((y - level - (strip - level) * step) ** 2, axis=1)
        if off.min() < least:
            best, least = float(_FIRST_PX[np.argmin(off)]), float(off.min())
    rest = y - carpet - (strip - carpet) * step
    second = 1.0 - np.interp(x - (_FIRST_PX[:, np.newaxis] + _SECOND_PX)[..., np.newaxis], SPREAD_PX, spread)
    height = np.einsum("agn,an->ag", second, rest) / np.maximum(np.sum(second**2, axis=2), 1e-9)
    height = np.clip(height, -1.5 * abs(strip - carpet), 1.5 * abs(strip - carpet))
    together = np.sum((rest[:, np.newaxis] - height[..., np.newaxis] * second) ** 2, axis=2).min(axis=1)
    if together.min() < _BETTER * least:
        best = float(_FIRST_PX[np.argmin(together)])
    return rough_px + best
