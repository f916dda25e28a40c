"""The values that flow: what is public can be pickled, and wrong shapes are refused by name."""

from __future__ import annotations

import pickle
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

import touchline
from touchline.types import LandmarkKind, Landmarks, Lines, generic_covariances, points_at

PLACES = np.array([[1.0, 0.0], [2.0, 1.0]])
POINTS = points_at(PLACES)
CROSSINGS = touchline.Crossings(
    np.array(["L", "T"]), PLACES, np.zeros(2), POINTS.covariances_m2, np.ones(2), POINTS.pixels
)
LINES = Lines(PLACES[np.newaxis], POINTS.covariances_m2[np.newaxis], np.ones(1), POINTS.pixels[np.newaxis])
LANDMARKS = Landmarks(
    np.array(["post", "pole"]), PLACES, POINTS.covariances_m2, np.ones(2), (("white",), ()), POINTS.pixels
)
SEEN = touchline.Observation(7, POINTS, LINES, CROSSINGS, LANDMARKS)


@pytest.mark.parametrize(
    "value",
    [
        SEEN,
        touchline.Frame(7, observation=SEEN, evidence=(touchline.Evidence("a friend", own_half=True),)),
        touchline.Estimate(7, touchline.Pose(1.0, 2.0, 3.0), np.eye(3), touchline.Status.LOST, observation=SEEN),
        touchline.Prior(touchline.Pose(1.0, 2.0, 3.0)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_flows_can_be_pickled(value: Any) -> None:
    back = pickle.loads(pickle.dumps(value))
    assert repr(back) == repr(value)
    assert getattr(touchline.types, type(value).__name__) is getattr(touchline, type(value).__name__) is type(value)


@pytest.mark.parametrize("seen", [POINTS, LINES, CROSSINGS, LANDMARKS], ids=lambda seen: type(seen).__name__)
def test_things_seen_of_wrong_shapes_are_refused(seen: Any) -> None:
    given = {each.name: getattr(seen, each.name) for each in fields(seen)}
    for name in type(seen).SHAPES:
        with pytest.raises(ValueError, match=f"{type(seen).NAME} need .*{name} \\("):
            type(seen)(**{**given, name: np.zeros((len(seen), 9))})
    assert type(seen)(**given).usable(100.0) is not None


def test_what_is_no_measurement_is_left_out_in_every_column() -> None:
    far = SEEN.usable(1.5)
    assert [len(part) for part in (far.points, far.lines, far.crossings, far.landmarks)] == [1, 0, 1, 1]
    assert (far.crossings.kinds.tolist(), far.landmarks.colors) == (["L"], (("white",),))
    assert SEEN.usable(100.0).landmarks is LANDMARKS


def test_kinds_and_colours_are_checked() -> None:
    two = (PLACES, generic_covariances(PLACES), np.ones(2))
    with pytest.raises(ValueError, match=f"landmarks are of the kinds {', '.join(LandmarkKind)}, not tree"):
        Landmarks(np.array(["post", "tree"]), *two, ((), ()), POINTS.pixels)
    with pytest.raises(ValueError, match="2 landmarks need as many tuples of colours, got 1"):
        Landmarks(np.array(["post", "pole"]), *two, ((),), POINTS.pixels)
