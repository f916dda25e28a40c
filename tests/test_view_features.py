"""Features over images, and the field with belief and particles."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import touchline
from touchline.camera import GroundView, PinholeCamera
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.perception.feature_pictures import CROSSING_PAINT, LINE_PAINT, Canvas, draw_features
from touchline.types import (
    Crossings,
    Estimate,
    Hypothesis,
    Landmarks,
    Lines,
    Observation,
    Status,
)
from touchline.view.belief import GUESS_COLOR, belief_picture
from touchline.view.look import look_at_recording
from touchline.view.overlay import LINE_COLOR

ENDS = np.array([[[2.0, -1.2], [2.0, 1.2]]])


@pytest.fixture
def view() -> GroundView:
    mount = Pose3.from_roll_pitch_yaw(0.0, 0.6, 0.0, np.array([0.0, 0.0, 1.0]))
    distortion = np.array([-0.25, 0.06, 0.0, 0.0, 0.0])
    return GroundView(PinholeCamera(640, 480, 420.0, 420.0, 320.0, 240.0, distortion, mount, use_attitude=False))


def drawn(view: GroundView, seen: Observation) -> Canvas:
    canvas = Canvas(np.full((960, 1280, 3), (40, 140, 40), dtype=np.uint8), view, 2)
    draw_features(canvas, seen)
    return canvas


def shows(canvas: Canvas, ground: FloatArray, paint: tuple[int, int, int]) -> list[bool]:
    """Whether ground points (N, 2) have a paint in the picture."""
    places = np.round(2.0 * canvas.view.image_from_ground(ground) + 0.5).astype(int)
    return [bool((canvas.picture[v, u] == paint).all()) for u, v in places]


def lines(ends: FloatArray) -> Lines:
    n = len(ends)
    return Lines(ends, np.zeros((n, 2, 2, 2)), np.ones(n), np.full((n, 2, 2), np.nan))


def crossings(kind: str, orientation: float) -> Crossings:
    return Crossings(
        np.array([kind]), np.array([[2.0, 0.0]]), np.array([orientation]), np.eye(2)[np.newaxis], np.ones(1),
        np.full((1, 2), np.nan),
    )  # fmt: skip


def test_a_line_bends_as_the_lens_bends_it(view: GroundView) -> None:
    canvas = drawn(view, Observation(0, lines=lines(ENDS)))
    along = ENDS[0, 0] + np.linspace(0.0, 1.0, 20)[:, np.newaxis] * (ENDS[0, 1] - ENDS[0, 0])
    assert all(shows(canvas, along, LINE_PAINT))
    ends = view.image_from_ground(ENDS[0])
    middle = view.image_from_ground(np.array([[2.0, 0.0]]))[0]
    assert np.abs(ends[:, 1].mean() - middle[1]) > 3.0, "the chord is elsewhere"


@pytest.mark.parametrize(
    ("kind", "arms"), [("L", (45.0, 135.0)), ("T", (0.0, 90.0, 180.0)), ("X", (0.0, 90.0, 180.0, 270.0))]
)
def test_crossings_have_their_arms(view: GroundView, kind: str, arms: tuple[float, ...]) -> None:
    canvas = drawn(view, Observation(0, crossings=crossings(kind, 0.5 * math.pi)))
    for degrees in np.arange(0.0, 360.0, 45.0):
        way = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
        at = np.array([2.0, 0.0]) + 0.2 * way
        assert shows(canvas, at[np.newaxis], CROSSING_PAINT) == [degrees in arms], degrees


def test_what_lies_outside_the_image_is_left_out(view: GroundView) -> None:
    far = np.array([[[-5.0, 0.0], [-2.0, 9.0]], [[400.0, -3.0], [400.0, 3.0]]])
    marks = Landmarks(
        np.array(["post", "circle", "goal"]), np.array([[-3.0, 0.0], [-1.0, 0.0], [900.0, 0.0]]),
        np.broadcast_to(np.eye(2), (3, 2, 2)).copy(), np.ones(3), (("blue",), (), ()), np.full((3, 2), np.nan),
    )  # fmt: skip
    canvas = drawn(view, Observation(0, lines=lines(far), landmarks=marks))
    assert (canvas.picture == (40, 140, 40)).all()


def test_nothing_seen_has_no_legend(view: GroundView) -> None:
    canvas = Canvas(np.zeros((960, 1280, 3), dtype=np.uint8), view, 2)
    assert draw_features(canvas, Observation(0, lines=Lines.none(), landmarks=Landmarks.none())) == []


def test_a_humanoids_stages_end_with_the_belief(small_data: Path) -> None:
    recording = touchline.open_source(small_data / "humanoid_9x6_walk")
    assert recording.truth is not None
    look = look_at_recording(small_data / "humanoid_9x6_walk", 2, "nimbro-lines")
    assert "line point" in look.words()
    assert " lines" in look.words()
    pictures = look.stages()
    assert next(iter(pictures)) == "original"
    assert list(pictures)[-3:] == ["bird's-eye view", "belief and particles", "overlay"]
    assert look.belief is not None
    assert look.particles is not None
    assert look.particles.shape[1] == 4
    assert look.particles[:, 3].sum() == pytest.approx(1.0)
    truth = recording.truth[2]
    near = np.hypot(look.belief.poses[:, 0] - truth.x, look.belief.poses[:, 1] - truth.y) < 0.5
    assert look.belief.likelihoods[near].max() > 0.5, "what is seen speaks for the true place"
    assert look.belief.likelihoods.max() == pytest.approx(1.0)
    assert len(look.belief.poses) > 1000


def test_a_guess_and_its_twin_are_drawn_pale_and_the_robot_is_not() -> None:
    field, pose = open_field("humanoid-kid-9x6"), Pose(3.9, 1.0, 0.5)
    twin = Hypothesis(pose.mirrored(), math.nan)

    def colours(status: Status, hypotheses: tuple[Hypothesis, ...]) -> list[bool]:
        estimate = Estimate(0, pose, np.eye(3), status, math.nan, 0, hypotheses)
        picture = belief_picture(field, None, None, estimate)
        ends = (picture[:800, : picture.shape[1] // 2], picture[:800, picture.shape[1] // 2 :])
        return [bool((end == paint).all(axis=2).any()) for paint in (LINE_COLOR, GUESS_COLOR) for end in ends]

    assert colours(Status.TRACKING, ()) == [False, True, False, False]
    assert colours(Status.TRACKING, (twin,)) == [False, True, True, False]
    assert colours(Status.SEARCHING, (twin,)) == [False, False, True, True]
