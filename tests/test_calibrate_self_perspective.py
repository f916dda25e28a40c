"""calibrate self: a perspective camera askew, too high and with a wrong focal length is found from a walk."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from drives import open_drive
from typer.testing import CliRunner

from touchline.calibration import self_perspective
from touchline.calibration.self_perspective import (
    PerspectiveView,
    calibrate_self_perspective,
    evenly,
    perspective_view,
)
from touchline.camera import PinholeCamera, open_camera
from touchline.cli import calibrate_self
from touchline.cli.commands import app
from touchline.errors import NoFitError
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.camera_errors.perspective import PerspectiveResponse
from touchline.systems import RobotSetup, open_system
from touchline.systems.touchline import Touchline
from touchline.types import Frame, Prior

ASKEW = np.array([0.01, -0.02, 0.025, 0.03])
MOUNT = Pose3.from_roll_pitch_yaw(0.0, 0.42, 0.0, (0.0, 0.0, 1.1))
LOOK = PerspectiveResponse(MOUNT.translation_m, np.ascontiguousarray(MOUNT.rotation[:, 0]), False)
CAMERA = PinholeCamera(752, 480, 493.0, 493.0, 376.0, 240.0, np.array([-0.25, 0.06, 0.0, 0.0, 0.0]), MOUNT, False)


def askew(frame: Frame) -> Frame:
    """What a camera sees that errs by the negative of ASKEW."""
    seen = frame.observation
    assert seen is not None

    def moved(ground: FloatArray) -> FloatArray:
        return np.asarray(placed_points(ground.reshape(-1, 2), -ASKEW, LOOK)).reshape(ground.shape)

    return replace(
        frame,
        observation=replace(
            seen,
            lines=replace(seen.lines, ends_m=moved(seen.lines.ends_m)),
            crossings=replace(seen.crossings, positions_m=moved(seen.crossings.positions_m)),
            landmarks=replace(seen.landmarks, positions_m=moved(seen.landmarks.positions_m)),
        ).usable(),
    )


@cache
def seen() -> tuple[Touchline, tuple[PerspectiveView, ...]]:
    walked = open_drive("walk-indoor")
    system = open_system("touchline", RobotSetup(walked.setup.field, CAMERA))
    assert isinstance(system, Touchline)
    system.reset(Prior(Pose(*walked.truth[0].tolist())))
    return system, evenly(
        [one for frame in map(askew, walked.frames) if (one := perspective_view(system, frame, system.step(frame)))]
    )


def test_roll_pitch_height_and_focal_length_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(self_perspective, "MAX_DEVIATIONS", 3.0 * self_perspective.MAX_DEVIATIONS)  # of a coarse walk
    system, views = seen()
    found = calibrate_self_perspective(views, CAMERA, system.registration)
    assert np.abs((found.shared - ASKEW) / found.deviations).max() < 3.0
    assert found.deviations.max() < 0.03
    assert found.after[0] > 0.95
    assert found.after[1] < 0.85 * found.before[1]
    assert 0.3 < math.degrees(found.lean_rad) < 0.6


def test_what_tells_too_little_is_refused() -> None:
    system, views = seen()
    with pytest.raises(NoFitError, match="2 images with a known pose that lie apart are too few"):
        calibrate_self_perspective(views[:2], CAMERA, system.registration)
    with pytest.raises(NoFitError, match=r"leaves the camera's .* uncertain by"):
        calibrate_self_perspective(views[:1] * 12, CAMERA, system.registration)
    away = [one._replace(pose=one.pose + np.array([2.0, 0.5, -1.2])) for one in views]
    with pytest.raises(NoFitError, match="of what was seen lies on the field"):
        calibrate_self_perspective(away, CAMERA, system.registration)


def test_the_corrected_camera_sees_the_ground_as_the_errors_say() -> None:
    pixels = np.array([(200.0, 200.0), (376.0, 300.0), (600.0, 400.0)])
    for told in (replace(CAMERA, distortion=np.zeros(5)), CAMERA):
        ground = told.ground_from_image(pixels)
        corrected = told.corrected(ASKEW, np.arccos(told.camera_rays(pixels)[:, 0])).ground_from_image(pixels)
        right = placed_points(ground, ASKEW, LOOK)
        assert corrected == pytest.approx(right, rel=1e-9 if told is not CAMERA else 0.02)


def test_the_command_writes_a_camera_and_a_picture(
    small_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "camera.yaml"
    monkeypatch.setattr(self_perspective, "MAX_DEVIATIONS", 3.0 * self_perspective.MAX_DEVIATIONS)  # of 1.6 s
    result = CliRunner().invoke(app, ["calibrate", "self", str(small_data / "humanoid_9x6_walk"), "-o", str(target)])
    assert result.exit_code == 0, result.output
    assert re.search(r"focal length 49\d\.\d px", result.output.replace("\n", " "))
    assert isinstance(open_camera(target), PinholeCamera)
    assert (tmp_path / "camera.png").exists()


def test_a_robot_of_which_nothing_comes_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    silent = SimpleNamespace(hear=lambda timeout_s: [], around=lambda: "no topics", close=lambda: None)
    monkeypatch.setattr(calibrate_self, "open_link", lambda choice, localizer: silent)
    monkeypatch.setattr(calibrate_self, "time", SimpleNamespace(monotonic=count(0.0, 15.0).__next__))
    command = ["calibrate", "self", "ros", "--field", "indoor-9x6", "-o", str(tmp_path / "camera.yaml")]
    result = CliRunner().invoke(app, command)
    assert "nothing came that could be looked at: no topics" in str(result.exception)
