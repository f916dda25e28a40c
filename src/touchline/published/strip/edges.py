"""The strip's edges, measured below the pixel: at which radii of its axis they are seen.

Beside the first and the last one is whatever happens to lie there. A field line that begins two pixels behind the strip
shines into its blurred edge: the place where the light is half way between strip and carpet moves by up to a pixel. So
profiles across these edges are described in three ways, strip to carpet, strip to whatever is ahead, and strip to
carpet to something else, and the best one tells where the strip ends.
"""

import itertools

import numpy as np

from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.published.strip.axis import FINE_PX, StripAxis, crossings
from touchline.published.strip.strip import Strip, View

_BESIDE_PX = np.arange(-3.0, 4.0)[:, np.newaxis]  # parallel profiles that are averaged: all on the strip, at 6.5 m too
_NEIGHBOURS = 4  # inner edges that show how the first or last one is blurred
_USED_WIDTH = 0.7  # of the strip, where its ends are measured
_END_REACH_PX = 12.0  # how far beyond an end its surroundings are looked at
SPREAD_PX = np.arange(-4.0, 4.0 + 1e-9, 0.25)
_WINDOW_PX = (-3.5, 2.25)  # of the edge, that is described: further out there may be more than one other thing
_BEFORE_PX = (2.25, 4.5)  # from the edge: the strip's own level there
_AHEAD_PX = (2.25, 3.75)
_FIRST_PX = np.arange(-1.75, 1.75 + 1e-9, 0.025)  # about the rough place
_SECOND_PX = np.arange(0.75, 8.0, 0.25)  # how far beyond an end edge another one is looked for
_BETTER = 0.5  # what another edge must leave of the squared residual to be believed


def measure_edges(view: View, axis: StripAxis, rough_px: FloatArray, strip: Strip) -> FloatArray:
    """Radii (E,) px of the edges along the axis, where the light is half way between the two sides' levels.

    rough_px: (E,) where to look. NaN for a first or last edge that isn't there: lines and walls lie close. Raises
    InputError, without the image's name, if an inner edge is not where it should be.
    """
    r, light = _profile(view, axis, rough_px)
    edges, levels = _half_way(view, axis, r, light, rough_px, strip)
    for k, chosen in ((0, slice(_NEIGHBOURS)), (len(edges) - 1, slice(-_NEIGHBOURS, None))):
        if np.isnan(edges[k]):
            continue
        spread = edge_spread(r, light, edges, levels, chosen)
        outwards = 1.0 - spread[::-1] if k == 0 else spread
        edges[k] = _measure_end(view, axis, edges, float(levels[0 if k == 0 else -1]), strip, k, outwards)
    return edges


def _profile(view: View, axis: StripAxis, rough_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Radii (N,) and light (N,) along the axis, from before the first edge to behind the last one."""
    r = np.arange(rough_px[0] - _ends_px(rough_px)[0], rough_px[-1] + _ends_px(rough_px)[1], FINE_PX)
    return r, view.sample(*axis.pixels(r, _BESIDE_PX)).mean(axis=0)


def _ends_px(rough_px: FloatArray) -> tuple[float, float]:
    gaps = np.diff(rough_px)
    return min(gaps[0], 10.0), min(gaps[-1], 10.0)


def _half_way(
    view: View, axis: StripAxis, r: FloatArray, light: FloatArray, rough_px: FloatArray, strip: Strip
) -> tuple[FloatArray, FloatArray]:
    """Edges (E,) half way between the levels (E + 1,) of the light before, between and behind them."""
    before, behind = _ends_px(rough_px)
    bounds = np.concatenate(([rough_px[0] - before], rough_px, [rough_px[-1] + behind]))
    lengths = np.diff(bounds)
    levels = []
    for a, b in itertools.pairwise(bounds):
        levels.append(float(np.median(light[(r > a + 0.3 * (b - a)) & (r < b - 0.3 * (b - a))])))
    levels[0] = _carpet_beside(view, axis, rough_px, strip, 0, levels[0])
    levels[-1] = _carpet_beside(view, axis, rough_px, strip, len(rough_px) - 2, levels[-1])
    edges = np.full(len(rough_px), np.nan)
    for k, rough in enumerate(rough_px):
        is_end = k in (0, len(rough_px) - 1)
        if np.sign(levels[k + 1] - levels[k]) != strip.signs[k]:
            if is_end:
                continue
            tone = "brighter" if strip.signs[k] > 0 else "darker"
            raise InputError(f"{edge_name(strip, k)} is out of order: it should get {tone} outwards there")
        crossed = crossings(r, light, 0.5 * (levels[k] + levels[k + 1]))
        near = crossed[np.abs(crossed - rough) < 0.5 * min(lengths[k], lengths[k + 1])]
        if len(near):
            edges[k] = near[np.argmin(np.abs(near - rough))]
        elif not is_end:
            raise InputError(f"{edge_name(strip, k)} is not found near {rough:.0f} px from the centre")
    return edges, np.array(levels)


def _measure_end(
    view: View, axis: StripAxis, edges: FloatArray, carpet: float, strip: Strip, k: int, spread: FloatArray
) -> float:
    """Radius of the first or last edge k: the mean of the middle half of what profiles all across the strip say.

    The edge is straight on the ground: to each side of the axis it lies further out.
    """
    outwards = 1 if k else -1
    neighbour = k - outwards
    px_per_m = (edges[k] - edges[neighbour]) / (strip.edges_m[k] - strip.edges_m[neighbour])
    half_px = _USED_WIDTH * edges[k] * np.arctan2(strip.half_width_m, strip.edges_m[k])
    inner_px = min(abs(edges[k] - edges[neighbour]) - 1.0, 8.0)
    x = np.arange(-inner_px, _END_REACH_PX, FINE_PX)
    found = []
    for beside in np.arange(-np.floor(half_px), half_px + 1e-9):
        turn = beside / edges[k]
        shift = px_per_m * strip.edges_m[k] * (1.0 / np.cos(turn) - 1.0) - edges[k] * (1.0 / np.cos(turn) - 1.0)
        r = edges[k] + shift + outwards * x
        light = view.sample(*axis.pixels(r, np.full((1, 1), beside)))[0]
        found.append(outwards * end_edge(x, light, 0.0, carpet, spread))
    middle = np.sort(found)[len(found) // 4 : len(found) - len(found) // 4]
    return float(edges[k] + middle.mean())


def _carpet_beside(view: View, axis: StripAxis, edges_px: FloatArray, strip: Strip, k: int, ahead: float) -> float:
    """Brightness of the ground around the strip's first or last rectangle k: the middle one of what lies on its left,
    on its right and ahead (given). A line or wall right behind the strip leaves too little of the ground to be seen.
    """
    radius = 0.5 * (edges_px[k] + edges_px[k + 1])
    half = np.arctan2(strip.half_width_m, 0.5 * (strip.edges_m[k] + strip.edges_m[k + 1]))
    offsets = np.linspace(1.4, 2.0, 9) * half + 1.5 / radius
    angle = float(axis.angles(np.array([radius]))[0])
    candidates = [ahead]
    for side in (-1.0, 1.0):
        at = angle + side * offsets
        u, v = axis.center[0] + radius * np.cos(at), axis.center[1] + radius * np.sin(at)
        candidates.append(float(np.median(view.sample(u[np.newaxis], v[np.newaxis]))))
    return float(np.median(candidates))


def edge_name(strip: Strip, k: int) -> str:
    """An edge as messages name it."""
    return f"edge {k + 1} of {len(strip.edges_m)} ({strip.edges_m[k]:g} m)"


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
    return np.mean(spreads, axis=0)


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
