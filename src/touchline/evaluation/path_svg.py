"""The field with the true and the estimated paths as SVG, in metres, in the colours of the page's stylesheet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from touchline.evaluation.run_data import RunData, carried_rows
from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.types import Mode, Status

MODE_COLORS = {Mode.OMNIVISION: "omnivision", Mode.BOTH: "both", Mode.ODOMETRY: "odometry"}
_MAX_DOTS = 4_000
_TICK_M = 2.0


def path_svg(data: RunData) -> str:
    """One run: its dots coloured by status, or by mode where the system has modes, over the true path."""
    drawn = [truth_path(data)]
    positions = _thinned(data.table.trajectory.values[data.first_located :])
    drawn += [_dots(positions[here], color) for _, color, here in _groups(data) if here.any()]
    if data.first_located < len(data.table):
        x, y = data.table.trajectory.values[data.first_located, :2]
        drawn.append(f"<circle cx='{x:.3f}' cy='{y:.3f}' r='0.16' class='first'/>")
    return field_frame(data.field, drawn, ["tracking"], data.truth is not None)


def path_key(data: RunData) -> list[tuple[str, str]]:
    """What the picture of the field shows, in words, each with the stylesheet's name of its colour."""
    key = [("truth", "truth")] if data.truth is not None else []
    key += [(label, color) for label, color, here in _groups(data) if here.any()]
    return key + ([("first located", "first-located")] if data.first_located < len(data.table) else [])


def field_frame(field: FieldModel, drawn: Sequence[str], markers: Sequence[str], with_truth: bool) -> str:
    """The field with what is drawn in metres, and a marker for each run's place, by the name of its colour."""
    length, width = field.length + 2.0 * field.border, field.width + 2.0 * field.border
    left, low = -0.5 * length, -0.5 * width
    text_m = length / 42.0
    paint = " ".join("M" + " ".join(f"{x:.3f},{y:.3f}" for x, y in line) for line in field.polylines(0.1))
    discs = "".join(f"<circle cx='{x:g}' cy='{y:g}' r='{d / 2:g}' fill='var(--paint)'/>" for x, y, d in field.discs)
    named = [*markers, *(["truth-place"] if with_truth else [])]
    size = length / 60.0
    places = "".join(
        f"<g id='at-{k}' class='marker {name}' style='display:none'><circle r='{size:.3f}'/>"
        f"<line x2='{2.2 * size:.3f}'/></g>"
        for k, name in enumerate(named)
    )
    return (
        f"<svg id='path' role='img' aria-label='Field with the estimated and the true path' "
        f"viewBox='{left:.3f} {low:.3f} {length:.3f} {width + 1.6 * text_m:.3f}'>"
        f"<g id='metres' transform='scale(1,-1)'>"
        f"<rect x='{left:.3f}' y='{low:.3f}' width='{length:.3f}' height='{width:.3f}' fill='var(--carpet)'/>"
        f"<path d='{paint}' fill='none' stroke='var(--paint)' stroke-width='{max(field.line_width, length / 300):.3f}' "
        f"stroke-linecap='square'/>{discs}{''.join(drawn)}{places}</g>{_ticks(left, low, text_m)}</svg>"
    )


def truth_path(data: RunData) -> str:
    """The true path as a broad line that ends where the robot was carried."""
    if data.truth is None or not len(data.truth):
        return ""
    poses = data.truth.values
    parts = np.split(poses, carried_rows(poses))
    step = max(1, -(-len(poses) // _MAX_DOTS))
    text = " ".join("M" + " ".join(f"{x:.2f},{y:.2f}" for x, y in part[::step, :2]) for part in parts)
    return f"<path d='{text}' class='truth' stroke='var(--truth)'/>"


def run_path(data: RunData, color: str) -> str:
    """The places of a run since it was first located, as dots of one colour."""
    return _dots(_thinned(data.table.trajectory.values[data.first_located :]), color)


def _dots(positions: FloatArray, color: str) -> str:
    text = "".join(f"M{x:.2f},{y:.2f}h0" for x, y in positions if abs(x) < 1e4 and abs(y) < 1e4)
    return f"<path d='{text}' class='dots' stroke='var(--{color})'/>"


def _ticks(left: float, low: float, text_m: float) -> str:
    """Metres along the lower edge, and up the left one."""
    xs = np.arange(np.ceil(left / _TICK_M) * _TICK_M, -left + 1e-6, _TICK_M)
    ys = np.arange(np.ceil(low / _TICK_M) * _TICK_M, -low + 1e-6, _TICK_M)
    font = f"font-size='{text_m:.3f}' fill='var(--soft)'"
    xs = xs[(xs > left + 1.5 * text_m) & (xs < -left - 6.0 * text_m)]  # the rest of the edge is the title's
    along = "".join(f"<text x='{x:.2f}' y='{-low + 1.2 * text_m:.3f}' text-anchor='middle'>{x:g}</text>" for x in xs)
    shade = "fill='var(--ink)' opacity='0.65'"
    up = "".join(f"<text x='{left + 0.2 * text_m:.3f}' y='{-y + 0.35 * text_m:.3f}' {shade}>{y:g}</text>" for y in ys)
    end = f"<text x='{-left:.3f}' y='{-low + 1.2 * text_m:.3f}' text-anchor='end'>x, y (m)</text>"
    return f"<g {font}>{along}{up}{end}</g>"


def _groups(data: RunData) -> list[tuple[str, str, npt.NDArray[np.bool_]]]:
    """Name, colour and rows, among the thinned ones since the robot was first located, of every mode and status."""
    begun = slice(data.first_located, None)
    status = _thinned(data.table.status[begun, np.newaxis])[:, 0]
    mode = _thinned(data.table.mode[begun, np.newaxis])[:, 0]
    tracking = status == tuple(Status).index(Status.TRACKING)
    groups = [(name.value, color, tracking & (mode == tuple(Mode).index(name))) for name, color in MODE_COLORS.items()]
    return groups + [
        (name.value, name.value, (status == tuple(Status).index(name)) & ~(tracking & (mode >= 0))) for name in Status
    ]


def _thinned(rows: npt.NDArray[np.generic]) -> FloatArray:
    step = max(1, -(-len(rows) // _MAX_DOTS))
    return np.asarray(rows[::step, :2], dtype=np.float64)
