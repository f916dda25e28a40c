"""One observation of lines, crossings and landmarks: they settle the pose, and what contradicts it is said."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import pytest
import yaml
from drives import open_drive

from touchline.camera import Camera
from touchline.cli import main
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import Pose, wrap_angle
from touchline.localization.one_shot.locate import locate
from touchline.localization.one_shot.location import Location
from touchline.sources import open_source
from touchline.types import Observation

WALK = Path(__file__).parent / "data" / "humanoid_9x6_walk"


@cache
def walk() -> tuple[FieldModel, Camera, tuple[tuple[Observation, Pose], ...]]:
    """Field and camera of a walking robot, and what it observes every now and then, with its true pose."""
    drive, every = open_drive("lens"), slice(0, None, 6)
    seen = [frame.observation or Observation(0) for frame in drive.frames[every]]
    assert drive.setup.camera is not None
    return (
        drive.setup.field,
        drive.setup.camera,
        tuple(zip(seen, (Pose(*row) for row in drive.truth[every]), strict=True)),
    )


def off(location: Location, truth: Pose) -> tuple[float, float]:
    """How far (m, rad) from the truth or its twin, which looks the same."""
    true = min((truth, truth.mirrored()), key=location.pose.distance_to)
    return location.pose.distance_to(true), abs(wrap_angle(location.pose.heading - true.heading))


def seen_well() -> list[tuple[Observation, Pose]]:
    return [(seen, truth) for seen, truth in walk()[2] if len(seen.crossings) + len(seen.landmarks) >= 3]


def test_a_landmark_where_the_field_has_none_is_named() -> None:
    field, camera, _ = walk()
    seen, truth = next((seen, truth) for seen, truth in seen_well() if len(seen.landmarks) and len(seen.crossings) > 1)
    positions_m = seen.landmarks.positions_m.copy()
    positions_m[0] += (0.9, 0.7)
    moved = replace(seen, landmarks=replace(seen.landmarks, positions_m=positions_m))
    location = locate(moved, field, camera=camera)
    assert off(location, truth)[0] < 0.15
    kind = str(seen.landmarks.kinds[0]).replace("_", " ")
    assert any(f"the {kind} seen" in doubt and "none of the field's" in doubt for doubt in location.doubts)


def test_a_heading_leaves_one_end() -> None:
    field, camera, _ = walk()
    seen, truth = max(seen_well(), key=lambda one: len(one[0].lines) + len(one[0].crossings))
    for true in (truth, truth.mirrored()):
        location = locate(seen, field, heading=wrap_angle(true.heading + 0.1), camera=camera)
        assert location.pose.distance_to(true) < 0.15
        assert all(one.pose.distance_to(true.mirrored()) > 0.5 for one in location.hypotheses)
    with pytest.raises(NoFitError):
        locate(seen, field, heading=wrap_angle(truth.heading + 0.5 * math.pi), camera=camera)


def test_the_command_takes_a_photograph_with_features(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    source = open_source(WALK)
    frame, camera = next(iter(source)), yaml.safe_load((WALK / "camera.yaml").read_text())
    assert frame.image is not None
    assert source.truth is not None
    cv2.imwrite("seen.png", frame.image)
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump({**camera, "use_attitude": False}))
    more = ["--field", source.field.name, "--json"]
    assert main(["locate", "seen.png", "--camera", "camera.yaml", *more]) == 0
    pose = json.loads(capsys.readouterr().out)["pose"]
    found, truth = Pose(pose["x_m"], pose["y_m"], pose["heading_rad"]), source.truth[0]
    assert min(found.distance_to(truth), found.distance_to(truth.mirrored())) < 0.15
    (tmp_path / "heeds.yaml").write_text(yaml.safe_dump({**camera, "use_attitude": True}))
    heeding = ["locate", "seen.png", "--camera", "heeds.yaml", *more]
    assert main(heeding) == 2
    assert "--attitude ROLL,PITCH" in capsys.readouterr().err
    assert main([*heeding, "--attitude", "0,0"]) == 0
    assert json.loads(capsys.readouterr().out)["pose"] == pose
    for given, reason in (
        ("5", "--attitude 5: expected roll and pitch"),
        ("1,2", "in radians"),
        ("nan,0", "in radians"),
        ("a,b", "--attitude a,b: expected roll and pitch"),
    ):
        assert main([*heeding, "--attitude", given]) == 2
        assert reason in capsys.readouterr().err
