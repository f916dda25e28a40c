"""Registration through a perspective camera whose roll and pitch err in every image: pose and lean together.

Line points go to the nearest line, crossings and landmarks to the nearest one of their kind, each with a robust kernel
that begins wide and narrows (as in `localization.registration`). All points of an image share the error of the camera's
lean, so that it is found next to the pose, with what was known of both as a prior (an iterated extended Kalman filter:
Bell and Cathey 1993).
"""

from __future__ import annotations

import numpy as np

from touchline.field import FieldModel
from touchline.field.association import AssociationTables
from touchline.field.offset_map import offset_table
from touchline.geometry import FloatArray
from touchline.localization.particles.feature_model import PointFeatures
from touchline.localization.registration.perspective_kernels import (
    Ground,
    Known,
    LeanFit,
    LeanPlan,
    SeenPoints,
    register_leaning,
)
from touchline.localization.registration.registration import CLUTTER_PER_M, GATE2
from touchline.types import LinePoints, Lines, Observation

FLOOR_M = 0.01  # standard deviation that no point falls below: carpet, paint, lens
POINT_SHARE = 0.3  # so much counts a point: neighbours on a line err together
LINE_SHARE = 2.0  # so much count both ends of a line of which only these are known
FEATURE_SHARE = 1.0  # so much a crossing or a landmark
NO_AXIS = np.zeros(3)
SPACING_M = 0.25  # between points that are laid on such a line


def _plan(widths_m: list[float]) -> LeanPlan:
    return LeanPlan(np.array(widths_m), GATE2, FLOOR_M**2, CLUTTER_PER_M, FEATURE_SHARE)


TRACKING = _plan([*np.geomspace(0.4, 0.05, 5), 0.0, 0.0, 0.0])


class PerspectiveRegistration:
    """Registers what a perspective camera sees on one field.

    eye (3,): x, y and height of the camera in the robot frame (m).
    """

    def __init__(self, field: FieldModel, places: AssociationTables, eye: FloatArray) -> None:
        self.ground = Ground(offset_table(field.distance_map()), places, np.asarray(eye, dtype=np.float64))

    def register(self, seen: SeenPoints, start: FloatArray, known: Known, plan: LeanPlan = TRACKING) -> LeanFit:
        """The state that a plan's steps come to from a start (7,), beside what is known."""
        fit: LeanFit = register_leaning(seen, self.ground, start, known, plan)
        return fit


def seen_points(seen: Observation, features: PointFeatures, axis: FloatArray = NO_AXIS) -> SeenPoints:
    """What counts of an observation; features: its crossings and landmarks; axis (3,): the camera's, robot frame."""
    if len(seen.points):
        points = seen.points
        shares = POINT_SHARE * np.clip(points.confidences, 0.1, 1.0)
    else:
        points, shares = points_on(seen.lines)
    return SeenPoints(
        np.ascontiguousarray(points.positions_m),
        np.ascontiguousarray(points.covariances_m2),
        shares,
        features._replace(positions_m=features.positions_m.copy()),
        features.positions_m,
        np.ascontiguousarray(axis),
    )


def points_on(lines: Lines) -> tuple[LinePoints, FloatArray]:
    """Points evenly on lines of which the ends are known, and how much each counts (N,)."""
    positions, covariances, shares = [np.zeros((0, 2))], [np.zeros((0, 2, 2))], [np.zeros(0)]
    for ends, spreads, sure in zip(lines.ends_m, lines.covariances_m2, lines.confidences, strict=True):
        count = max(2, int(np.hypot(*(ends[1] - ends[0])) / SPACING_M) + 1)
        along = np.linspace(0.0, 1.0, count)[:, np.newaxis]
        positions.append(ends[0] + along * (ends[1] - ends[0]))
        along = along[..., np.newaxis]
        covariances.append((1.0 - along) * spreads[0] + along * spreads[1])
        shares.append(np.full(count, LINE_SHARE * float(np.clip(sure, 0.1, 1.0)) * 2.0 / count))
    places = np.concatenate(positions)
    unknown = np.full((len(places), 2), np.nan)
    sure_of = np.concatenate(shares)
    return LinePoints(places, np.concatenate(covariances), np.minimum(sure_of, 1.0), unknown), sure_of
