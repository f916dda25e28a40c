"""What a mirror askew does to ground points, from its range table alone, against rays traced through the mirror."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from touchline.localization.camera_errors.base import placed_points
from touchline.localization.camera_errors.mirror_response import mirror_response
from touchline_lab.simulation.cameras.factory import open_simulated_camera
from touchline_lab.simulation.cameras.mirror_rays import MirrorMount
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.scenario import CameraSettings

AROUND = np.linspace(0.1, 2.0 * np.pi, 12, endpoint=False)
EXACT = np.vstack([r * np.column_stack((np.cos(AROUND), np.sin(AROUND))) for r in (1.0, 1.5, 2.0, 3.0, 4.0)])
LEANING = MirrorMount(tilt_y=math.radians(0.5))
ASIDE = MirrorMount(shift_x=0.0005)


def left_m(profile: str, mount: MirrorMount) -> tuple[np.ndarray, np.ndarray]:
    """The errors (5,) that suit a mirror askew best, at a known pose, and what they leave of the points (N,)."""
    camera = open_simulated_camera(CameraSettings.model_validate({"mirror": {"profile": profile}}), mount)
    assert isinstance(camera, SimulatedOmniCamera)
    seen, response = camera.design.ground_from_image(camera.project(EXACT)), mirror_response(camera.design)
    errors = np.zeros(5)
    for _ in range(6):
        off = (placed_points(seen, errors, response) - EXACT).ravel()
        rows = [(placed_points(seen, errors + step, response) - EXACT).ravel() - off for step in 1e-6 * np.eye(5)]
        errors -= 1e-6 * np.linalg.lstsq(np.array(rows).T, off, rcond=None)[0]
    left = placed_points(seen, errors, response) - EXACT
    return errors, np.hypot(left[:, 0], left[:, 1])


@pytest.mark.parametrize("profile", ["combined", "recorded", "horizontally-isometric"])
def test_range_table_tells_what_a_lean_does(profile: str) -> None:
    errors, left = left_m(profile, LEANING)
    assert errors[0] == pytest.approx(-2.0 * LEANING.tilt_y / 0.79, rel=0.05)  # the simulated mirror is 0.79 m high
    assert abs(errors[2]) < 0.3
    assert np.sqrt(np.mean(left**2)) < 0.002


@pytest.mark.parametrize("profile", ["combined", "recorded", "hyperbolic"])
def test_range_table_tells_what_a_displacement_does(profile: str) -> None:
    errors, left = left_m(profile, ASIDE)
    assert errors[2] == pytest.approx(-3.1, rel=0.05)  # 620 px times half a millimetre in ten centimetres
    assert abs(errors[0]) < 0.002
    assert np.sqrt(np.mean(left**2)) < 0.001


def test_tables_that_tell_no_mirror_move_nothing() -> None:
    assert not mirror_response(None).parts.any()
    camera = open_simulated_camera(CameraSettings(), None)
    assert isinstance(camera, SimulatedOmniCamera)
    near = replace(camera.design, range_m=1e-3 * camera.design.range_m[:, :50], radius_px=camera.design.radius_px[:50])
    assert not mirror_response(near).parts.any()
    coarse = replace(camera.design, range_m=camera.design.range_m[:, ::20], radius_px=camera.design.radius_px[::20])
    assert np.isfinite(mirror_response(coarse).parts).all()
