"""Crossings and posts in the joint fit, with a mirror's errors: each feature has the derivatives of its own place."""

from __future__ import annotations

import math

import numpy as np

from touchline.field import open_field
from touchline.field.association import FieldAssociations
from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors.mirror import MirrorErrors
from touchline.localization.camera_errors.mirror_response import MirrorResponse, mirror_response
from touchline.localization.registration.features import Features
from touchline.localization.registration.joint import StateFit, StatePrior
from touchline.localization.registration.registration import SETTLED, Registration
from touchline.localization.registration.seen import seen_of
from touchline.types import Crossings, LinePoints, Observation

FIELD = open_field("msl-18x12")
TRUTH = Pose(2.0, -1.0, 0.4)
EXACT = np.diag([1.0, 1.0, 1.0, 1e4, 1e4, 1.0, 1.0, 1e4])  # information of a prior


def fitted(response: MirrorResponse, points: FloatArray) -> StateFit:
    """What line points (N, 2) and the crossings of the penalty areas, robot frame, make of the state."""
    places = FieldAssociations(FIELD)
    corners = np.array([(x, y) for x in (-9.0, 9.0) for y in (-6.0, 6.0)])
    seen = TRUTH.inverse().transform(corners)
    count = len(seen)
    crossings = Crossings(
        np.full(count, "L"),
        seen,
        np.full(count, math.nan),
        np.tile(np.diag([1e-3, 1e-3]), (count, 1, 1)),
        np.ones(count),
        np.full((count, 2), math.nan),
    )
    spreads = np.tile(np.diag([1e-3, 1e-3]), (len(points), 1, 1))
    found = LinePoints(points, spreads, np.ones(len(points)), np.full(points.shape, math.nan))
    features = Features(places, None, MirrorErrors.of(None).height_m, 0.01)
    taken = seen_of(Observation(0, found, crossings=crossings), features, 1.0)
    registration = Registration(FIELD.distance_map(), places.tables)
    start = np.array([*TRUTH, 0.0, 0.0, 0.0, 0.0, 0.0])
    return registration.fit_state(taken, start, StatePrior(start, EXACT), SETTLED, response)


def line_points() -> FloatArray:
    """Of the halfway line and a touch line, robot frame."""
    across = [(0.0, y) for y in np.linspace(-5.0, 5.0, 21)]
    along = [(x, -6.0) for x in np.linspace(-6.0, 6.0, 25)]
    return TRUTH.inverse().transform(np.array(across + along))


def test_a_mirror_whose_displacement_does_nothing_has_no_information_of_it_by_features() -> None:
    fit = fitted(mirror_response(None), line_points())
    assert np.abs(fit.information[5:7]).max() == 0.0
    assert fit.gradient[5:7].tolist() == [0.0, 0.0]
