"""Poses as notebooks show them: a table, and a picture from above."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, Pose
from touchline.palette import BLUE, ORANGE, VERMILLION

_STATUS_COLORS = {"tracking": BLUE, "searching": ORANGE, "lost": VERMILLION}
_OTHER = "#777777"
_ROBOT = "-0.2,-0.2 0.35,0 -0.2,0.2 -0.1,0"  # an arrowhead (m), its tip ahead
_SIGMAS = 2.0
_MAX_POINTS = 500


class ShownPose(NamedTuple):
    """A pose as a row of a table and a mark in a picture. name: a status, or what else heads its row.

    covariance: (3, 3) in (m, m, rad); None where unknown, as probability.
    """

    name: str
    pose: Pose
    covariance: FloatArray | None
    residual_m: float
    probability: float | None


def poses_html(title: str, poses: Sequence[ShownPose], said: Sequence[str], picture: str) -> str:
    """The poses in a table, sentences about them, and a picture below."""
    head = "".join(f"<th>{name}</th>" for name in ("", "x (m)", "y (m)", "heading (°)", "residual (cm)", "probability"))
    body = "".join(
        f"<tr><th>{of.name}</th>{_pose_cells(of.pose, of.covariance)}<td>{_number(100.0 * of.residual_m, '.1f')}</td>"
        f"<td>{'' if of.probability is None else f'{of.probability:.3g}'}</td></tr>"
        for of in poses
    )
    sentences = "".join(f"<p>{html.escape(each)}</p>" for each in said)
    return (
        f"<p>{html.escape(title)}</p><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        f"{sentences}{picture}"
    )


def pose_marks(poses: Sequence[ShownPose], seen: FloatArray) -> str:
    """SVG in metres of the field frame, y up: poses with ellipses of 2 sigma, the first one coloured by its status.

    seen: line points (N, 2) in the field frame, of which some are drawn where there are many.
    """
    first, *others = poses
    marks = "".join(_mark(other.pose, other.covariance, _OTHER) for other in others)
    dots = " ".join(f"M{x:.2f},{y:.2f}h0" for x, y in seen[:: max(1, -(-len(seen) // _MAX_POINTS))])
    return (
        f'<path d="{dots}" stroke="#222" stroke-width="0.08" stroke-linecap="round" fill="none"/>'
        f"{marks}{_mark(first.pose, first.covariance, _STATUS_COLORS[first.name])}"
    )


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


def _pose_cells(pose: Pose, covariance: FloatArray | None) -> str:
    units = np.array([1.0, 1.0, math.degrees(1.0)])
    values = [f"{value:.3f}" for value in units * pose]
    if covariance is not None:
        spreads = units * np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        values = [f"{value} ± {spread:.3f}" for value, spread in zip(values, spreads, strict=True)]
    return "".join(f"<td>{value}</td>" for value in values)


def _number(value: float, how: str) -> str:
    return f"{value:{how}}" if math.isfinite(value) else ""
