"""An estimate as notebooks show it: a table of its poses, and a picture of them from above."""

from __future__ import annotations

import html
import math
from typing import TYPE_CHECKING

import numpy as np

from touchline.geometry import FloatArray, Pose
from touchline.palette import BLUE, ORANGE, VERMILLION

if TYPE_CHECKING:
    from touchline.types.estimate import Estimate, Hypothesis

_STATUS_COLORS = {"tracking": BLUE, "searching": ORANGE, "lost": VERMILLION}
_OTHER = "#777777"
_ROBOT = "-0.2,-0.2 0.35,0 -0.2,0.2 -0.1,0"  # an arrowhead (m), its tip ahead
_SIGMAS = 2.0
_MAX_POINTS = 500


def estimate_html(estimate: Estimate, picture: str | None = None) -> str:
    """The pose and the other hypotheses in a table, and a picture below: by default the poses on a grid of metres."""
    rows: list[tuple[str, Estimate | Hypothesis]] = [(estimate.status.value, estimate)]
    rows += [("or", other) for other in estimate.hypotheses]
    head = "".join(f"<th>{name}</th>" for name in ("", "x (m)", "y (m)", "heading (°)", "residual (cm)", "probability"))
    body = "".join(
        f"<tr><th>{name}</th>{_pose_cells(of.pose, of.covariance)}<td>{_number(100.0 * of.residual_m, '.1f')}</td>"
        f"<td>{'' if of.probability is None else f'{of.probability:.3g}'}</td></tr>"
        for name, of in rows
    )
    said = [*filter(None, (_bound_text(estimate), estimate.reason, _statistics_text(estimate)))]
    problems = "".join(f"<p>{html.escape(str(each))}</p>" for each in (*said, *estimate.problems))
    return (
        f"<p>{estimate.stamp_ns / 1e9:.3f} s, {estimate.points} points</p><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table>{problems}{_on_a_grid(estimate) if picture is None else picture}"
    )


def estimate_marks(estimate: Estimate) -> str:
    """SVG in metres of the field frame, y up: line points as seen from the pose, poses with ellipses of 2 sigma."""
    others = "".join(_mark(other.pose, other.covariance, _OTHER) for other in estimate.hypotheses)
    dots = " ".join(f"M{x:.2f},{y:.2f}h0" for x, y in _seen_at(estimate))
    color = _STATUS_COLORS[estimate.status.value]
    return (
        f'<path d="{dots}" stroke="#222" stroke-width="0.08" stroke-linecap="round" fill="none"/>'
        f"{others}{_mark(estimate.pose, estimate.covariance, color)}"
    )


def _seen_at(estimate: Estimate) -> FloatArray:
    """(N, 2) the line points in the field frame, some of them where there are many."""
    seen = np.zeros((0, 2)) if estimate.observation is None else estimate.observation.points.usable().positions_m
    return estimate.pose.transform(seen[:: max(1, -(-len(seen) // _MAX_POINTS))])


def _mark(pose: Pose, covariance: FloatArray | None, color: str) -> str:
    """A pose as an arrowhead, its position's covariance as an ellipse."""
    place = f'transform="translate({pose.x:.3f},{pose.y:.3f}) rotate({math.degrees(pose.heading):.2f})"'
    robot = f'<polygon points="{_ROBOT}" {place} fill="{color}" stroke="white" stroke-width="0.04"/>'
    if covariance is None or not np.isfinite(covariance).all():
        return robot
    values, axes = np.linalg.eigh(covariance[:2, :2])
    along, across = _SIGMAS * np.sqrt(np.maximum(values[::-1], 0.0))
    turn = f"rotate({math.degrees(math.atan2(axes[1, 1], axes[0, 1])):.2f})"
    return (
        f'<ellipse transform="translate({pose.x:.3f},{pose.y:.3f}) {turn}" rx="{along:.3f}" ry="{across:.3f}" '
        f'fill="{color}" fill-opacity="0.15" stroke="{color}" stroke-width="0.03"/>{robot}'
    )


def _on_a_grid(estimate: Estimate, width_px: int = 480) -> str:
    """All poses, and what is seen, on a grid of metres."""
    places = [estimate.pose[:2], *(other.pose[:2] for other in estimate.hypotheses), *_seen_at(estimate)]
    left, low = np.floor(np.min(places, axis=0)) - 1.0
    right, high = np.ceil(np.max(places, axis=0)) + 1.0
    grid = " ".join(f"M{x:.0f},{low:.0f}V{high:.0f}" for x in np.arange(left, right + 0.5))
    grid += " ".join(f"M{left:.0f},{y:.0f}H{right:.0f}" for y in np.arange(low, high + 0.5))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_px}" style="max-width:100%" '
        f'viewBox="{left:.0f} {-high:.0f} {right - left:.0f} {high - low:.0f}"><g transform="scale(1,-1)">'
        f'<path d="{grid}" stroke="#bbb" stroke-width="0.02" fill="none"/>{estimate_marks(estimate)}</g></svg>'
    )


def _pose_cells(pose: Pose, covariance: FloatArray | None) -> str:
    units = np.array([1.0, 1.0, math.degrees(1.0)])
    values = [f"{value:.3f}" for value in units * pose]
    if covariance is not None:
        spreads = units * np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        values = [f"{value} ± {spread:.3f}" for value, spread in zip(values, spreads, strict=True)]
    return "".join(f"<td>{value}</td>" for value in values)


def _bound_text(estimate: Estimate) -> str:
    """The protection level and the end's probability; empty where neither is known."""
    parts = []
    if estimate.protection_m is not None:
        parts.append(f"within {100.0 * estimate.protection_m:.1f} cm")
    if estimate.protection_rad is not None:
        parts.append(f"within {math.degrees(estimate.protection_rad):.1f}°")
    if estimate.end_probability is not None:
        parts.append(f"this end of the field: {100.0 * estimate.end_probability:.4g} %")
    return ", ".join(parts)


def _statistics_text(estimate: Estimate) -> str:
    """The consistency statistics; empty where there are none."""
    values = ", ".join(f"{name} {value:.2f}" for name, value in estimate.statistics.items())
    return f"consistency, 1 is the alarm: {values}" if values else ""


def _number(value: float, how: str) -> str:
    return f"{value:{how}}" if math.isfinite(value) else ""
