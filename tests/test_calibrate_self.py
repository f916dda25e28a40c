"""calibrate self: a mirror askew is found from the lines of a drive; what tells too little is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from drives import Drive, open_drive
from typer.testing import CliRunner

from touchline.calibration.self_calibration import View, calibrate_self, spread_views
from touchline.camera import OmniCamera
from touchline.cli.commands import app
from touchline.errors import NoFitError
from touchline.geometry import Pose
from touchline.localization.camera_errors.base import placed_points
from touchline.localization.camera_errors.mirror import mirror_errors
from touchline.types import Estimate, LinePoints, Status

ASKEW = np.array([0.02, -0.012, 0.0, 0.0, 0.0])  # a lean (1/m)


@cache
def drive() -> tuple[Drive, OmniCamera]:
    """With a table that nobody has touched."""
    found = open_drive("match")
    assert isinstance(found.setup.camera, OmniCamera)
    return found, replace(found.setup.camera, stated_uncertainty=None)


@cache
def views() -> list[View]:
    """Of a mirror that leans, at poses that a system has found to 2 cm."""
    found, camera = drive()
    off, mirror = np.random.default_rng(1).normal(0.0, (0.02, 0.02, 0.005), found.truth.shape), mirror_errors(camera)
    seen = []
    for frame, pose in zip(found.frames[::8], (found.truth + off)[::8], strict=True):
        assert frame.observation is not None
        points = frame.observation.points
        moved = np.array(placed_points(points.positions_m, -ASKEW, mirror.response()))
        seen.append(View(replace(points, positions_m=moved, pixels=camera.image_from_ground(moved)), pose))
    return [View(usable(one.points), one.pose) for one in seen]


def usable(points: LinePoints) -> LinePoints:
    kept = np.isfinite(points.pixels).all(axis=1)
    return LinePoints(
        points.positions_m[kept], points.covariances_m2[kept], points.confidences[kept], points.pixels[kept]
    )


def test_a_mirrors_lean_is_found_and_how_sure_it_is() -> None:
    found_drive, camera = drive()
    found = calibrate_self(views(), camera, found_drive.setup.field)
    assert found.shared[:2] == pytest.approx(ASKEW[:2], abs=0.004)
    assert found.after[0] > found.before[0] + 0.05
    assert found.after[1] < 0.8 * found.before[1]
    sure = found.camera.uncertainty
    assert 0.005 < sure.tilt_deg < 0.1
    assert 0.02 < sure.center_px < 0.8


def test_too_few_places_and_another_field_are_refused() -> None:
    found, camera = drive()
    with pytest.raises(NoFitError, match="too few, 3 are needed"):
        calibrate_self(views()[:1], camera, found.setup.field)
    away = [one._replace(pose=one.pose + np.array([1.0, 1.0, 0.3])) for one in views()]
    with pytest.raises(NoFitError, match="% of the line points lie on lines"):
        calibrate_self(away, camera, found.setup.field)


def test_views_lie_apart() -> None:
    found, _ = drive()
    estimates = [
        Estimate(frame.stamp_ns, Pose(*pose.tolist()), np.eye(3), Status.TRACKING, observation=frame.observation)
        for frame, pose in zip(found.frames, found.truth, strict=True)
    ]
    poses = np.array([one.pose for one in spread_views(estimates, 10)])
    places = np.column_stack((poses[:, :2], 1.5 * np.cos(poses[:, 2]), 1.5 * np.sin(poses[:, 2])))
    gaps = np.linalg.norm(places[:, np.newaxis] - places, axis=2)[~np.eye(len(poses), dtype=bool)]
    assert len(poses) == 10
    assert gaps.min() > 0.3


def test_a_recording_that_tells_too_little_writes_nothing(small_data: Path, tmp_path: Path) -> None:
    target = tmp_path / "camera.yaml"
    result = CliRunner().invoke(app, ["calibrate", "self", str(small_data / "omni_9x6_points"), "-o", str(target)])
    assert isinstance(result.exception, NoFitError)
    assert not target.exists()
