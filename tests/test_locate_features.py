"""One observation of lines, crossings and landmarks: they settle the pose, and what contradicts it is said."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

import touchline
from touchline.camera import Camera, GroundView
from touchline.cli import main
from touchline.errors import NoFitError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.one_shot.locate import locate
from touchline.localization.one_shot.location import Location
from touchline.localization.registration.covariance import widest_m
from touchline.types import LinePoints, Lines, Observation, points_at
from touchline_lab.simulation.cameras.perspective import humanoid_camera
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

WALK_S, STEP = 20.0, 8


@cache
def walk() -> tuple[FieldModel, Camera, tuple[tuple[Observation, Pose], ...]]:
    """Field and camera of a walking robot, and what it observes every now and then, with its true pose."""
    run = Simulation(open_scenario("humanoid-walk", 3, WALK_S, ["field=spl-9x6"]), "points")
    seen = tuple((run.features(index), run.truth[index]) for index in range(0, len(run), STEP))
    return run.field, run.camera, seen


def off(location: Location, truth: Pose) -> tuple[float, float]:
    """How far (m, rad) from the truth or its twin, which looks the same."""
    true = min((truth, truth.mirrored()), key=location.pose.distance_to)
    return location.pose.distance_to(true), abs(wrap_angle(location.pose.heading - true.heading))


def seen_well() -> list[tuple[Observation, Pose]]:
    return [(seen, truth) for seen, truth in walk()[2] if len(seen.crossings) + len(seen.landmarks) >= 3]


def test_what_a_walking_robot_sees_in_one_image_is_enough() -> None:
    field, camera, _ = walk()
    errors = []
    for seen, truth in seen_well():
        try:
            location = locate(seen, field, camera=camera)
        except NoFitError:
            continue
        if not location.doubts:
            errors.append(off(location, truth))
    assert len(errors) >= 0.6 * len(seen_well())
    assert np.median([error for error, _ in errors]) < 0.06
    assert max(error for error, _ in errors) < 0.3
    assert max(turn for _, turn in errors) < math.radians(5.0)


def test_a_camera_that_leans_two_degrees_more_does_not_move_the_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    """Roll and pitch are fitted with the pose: two degrees move what is 4 m away by 30 cm."""
    field, camera, _ = walk()
    seen, truth = max(seen_well(), key=lambda one: len(one[0].lines) + len(one[0].crossings))
    height_m = float(camera.base_from_camera.translation_m[2])

    def leaned(places: np.ndarray) -> np.ndarray:
        x, y = places[..., 0], places[..., 1]
        turned = math.radians(2.0) * np.stack(((height_m**2 + x * x) / height_m, x * y / height_m), axis=-1)
        return np.ascontiguousarray(places + turned)

    moved = replace(
        seen,
        points=replace(seen.points, positions_m=leaned(seen.points.positions_m)),
        lines=replace(seen.lines, ends_m=leaned(seen.lines.ends_m)),
        crossings=replace(seen.crossings, positions_m=leaned(seen.crossings.positions_m)),
        landmarks=replace(seen.landmarks, positions_m=leaned(seen.landmarks.positions_m)),
    )
    distance_m, turned_rad = off(locate(moved, field, camera=camera), truth)
    assert distance_m < 0.1
    assert turned_rad < math.radians(3.0)


def test_a_landmark_where_the_field_has_none_is_named() -> None:
    field, camera, _ = walk()
    seen, truth = next((seen, truth) for seen, truth in seen_well() if len(seen.landmarks) and len(seen.lines) > 3)
    positions_m = seen.landmarks.positions_m.copy()
    positions_m[0] += (0.9, 0.7)
    moved = replace(seen, landmarks=replace(seen.landmarks, positions_m=positions_m))
    location = locate(moved, field, camera=camera)
    assert off(location, truth)[0] < 0.15
    kind = str(seen.landmarks.kinds[0]).replace("_", " ")
    assert any(f"the {kind} seen" in doubt and "none of the field's" in doubt for doubt in location.doubts)


def test_lines_and_crossings_alone_are_located_as_a_network_gives_them() -> None:
    field, camera, _ = walk()
    seen, truth = max(seen_well(), key=lambda one: len(one[0].lines) + len(one[0].crossings))
    bare = replace(seen, points=points_at(np.zeros((0, 2))))
    assert off(touchline.locate(bare, field, camera=camera), truth)[0] < 0.2


def test_a_heading_leaves_one_end() -> None:
    field, camera, _ = walk()
    seen, truth = max(seen_well(), key=lambda one: len(one[0].lines) + len(one[0].crossings))
    for true in (truth, truth.mirrored()):
        location = locate(seen, field, heading=wrap_angle(true.heading + 0.1), camera=camera)
        assert location.pose.distance_to(true) < 0.15
        assert all(one.pose.distance_to(true.mirrored()) > 0.5 for one in location.hypotheses)
    with pytest.raises(NoFitError):
        locate(seen, field, heading=wrap_angle(truth.heading + 0.5 * math.pi), camera=camera)


def test_line_points_alone_are_located_as_before() -> None:
    points = walk()[2][0][0].points
    alone = Observation(0, points=points)
    field = walk()[0]
    one, other = (answer_of(given, field) for given in (points, alone))
    assert one == other


def answer_of(given: LinePoints | Observation, field: FieldModel) -> object:
    try:
        return locate(given, field).pose
    except NoFitError as error:
        return str(error)


def test_lines_in_another_arrangement_are_refused_or_doubted() -> None:
    """Each line turned about the robot by a chance angle, with its crossings: no field has such lines."""
    field, camera, _ = walk()
    rng, sure = np.random.default_rng(0), 0
    for seen, _ in seen_well()[:8]:
        turns = rng.uniform(-0.7, 0.7, len(seen.lines))
        rotations = np.array([[[math.cos(t), -math.sin(t)], [math.sin(t), math.cos(t)]] for t in turns])
        ends_m = np.ascontiguousarray(np.einsum("lij,lkj->lki", rotations, seen.lines.ends_m))
        shuffled = Observation(0, lines=replace(seen.lines, ends_m=ends_m), crossings=seen.crossings)
        try:
            sure += not locate(shuffled, field, camera=camera).doubts
        except NoFitError:
            continue
    assert sure <= 1


def test_the_command_takes_a_photograph_with_features(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rendered image of a walking robot that stands still: the pose is the true one or its twin, and not doubted."""
    monkeypatch.chdir(tmp_path)
    run = Simulation(open_scenario("humanoid-walk", 5, 0.5, ["field=spl-9x6", "ideal=true"]))
    frame = next(iter(run))
    assert frame.image is not None
    cv2.imwrite("seen.png", frame.image)
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump({**run.camera_yaml, "use_attitude": False}))
    assert main(["locate", "seen.png", "--camera", "camera.yaml", "--field", "spl-9x6", "--json"]) == 0
    pose = json.loads(capsys.readouterr().out)["pose"]
    found, truth = Pose(pose["x_m"], pose["y_m"], pose["heading_rad"]), run.truth[0]
    assert min(found.distance_to(truth), found.distance_to(truth.mirrored())) < 0.15
    (tmp_path / "heeds.yaml").write_text(yaml.safe_dump(run.camera_yaml))
    heeding = ["locate", "seen.png", "--camera", "heeds.yaml", "--field", "spl-9x6", "--json"]
    assert main(heeding) == 2
    assert "--attitude ROLL,PITCH" in capsys.readouterr().err
    assert main([*heeding, "--attitude", "0,0"]) == 0
    assert json.loads(capsys.readouterr().out)["pose"] == pose
    for given, reason in (("5", "got '5'"), ("1,2", "in radians"), ("nan,0", "in radians"), ("a,b", "got 'a,b'")):
        assert main([*heeding, "--attitude", given]) == 2
        assert reason in capsys.readouterr().err


ANGLES_RAD = np.linspace(0.05, 0.5, 10)


def seen_by_a_leaning_camera(places: list[FloatArray], pose: Pose, lean_deg: tuple[float, float]) -> Observation:
    """Pieces of lines (N, 2), field frame, as a robot has them whose camera leans so, unknown to its camera.yaml."""
    known = humanoid_camera()
    true = known.corrected(np.radians([*lean_deg, 0.0, 0.0]), ANGLES_RAD)
    pieces, pixels = [], []
    for piece in places:
        at = GroundView(true, true.base_from_camera).image_from_ground(pose.inverse().transform(piece))
        at = at[(at > 0.0).all(axis=1) & (at < (known.width, known.height)).all(axis=1)]
        if len(at) < 5:
            continue
        pieces.append(GroundView(known, known.base_from_camera).ground_from_image(at))
        pixels.append(at)
    points, spread = np.concatenate(pieces), np.square(0.01 + 0.001 * np.hypot(*np.concatenate(pieces).T) ** 2)
    covariances = spread[:, np.newaxis, np.newaxis] * np.eye(2)
    ends = np.array([[piece[0], piece[-1]] for piece in pieces])
    lines = Lines(
        ends,
        np.tile(0.01 * np.eye(2), (len(ends), 2, 1, 1)),
        np.ones(len(ends)),
        np.array([[at[0], at[-1]] for at in pixels]),
    )
    return Observation(0, LinePoints(points, covariances, np.ones(len(points)), np.concatenate(pixels)), lines)


def test_few_lines_leave_open_what_the_roll_and_pitch_of_a_camera_leave_open() -> None:
    """A line and an arc fit along a bent ridge of attitudes: the pose was 0.7 m off, and sure to 0.1 m."""
    field, pose = open_field("indoor-9x6"), Pose(-3.6, 2.35, -0.75)
    line = np.column_stack((np.zeros(40), np.linspace(-2.6, 0.5, 40)))
    turns = np.linspace(1.6, 3.2, 12)
    arc = float(field.circles[0, 2]) * np.column_stack((np.cos(turns), np.sin(turns)))
    seen = seen_by_a_leaning_camera([line, arc], pose, (3.3, 1.2))
    location = locate(seen, field, heading=pose.heading, camera=humanoid_camera())
    assert off(location, pose)[0] < 2.0 * widest_m(location.covariance)
    assert widest_m(location.covariance) > 0.25
    assert any("roll and pitch" in doubt for doubt in location.doubts)


def test_many_lines_tell_the_roll_and_pitch_of_a_camera() -> None:
    field, pose = open_field("indoor-9x6"), Pose(1.5, 0.4, 0.3)
    seen = seen_by_a_leaning_camera(field.polylines(0.1)[: len(field.segments)], pose, (3.3, 1.2))
    location = locate(seen, field, camera=humanoid_camera())
    assert off(location, pose)[0] < 0.05
    assert widest_m(location.covariance) < 0.1
    assert not any("roll and pitch" in doubt for doubt in location.doubts)
