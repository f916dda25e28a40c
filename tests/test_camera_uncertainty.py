"""What camera.yaml says of how sure it is: read, checked, written, and what it is good for."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from touchline.camera import OmniCamera, open_camera
from touchline.camera.model_free import MIN_UNCERTAINTY, Edges, edges_uncertainty
from touchline.camera.uncertainty import USUAL_RANGE_RATIO, USUAL_TILT_DEG, CameraUncertainty
from touchline.camera.writing import camera_yaml
from touchline.errors import InputError

RADII = np.arange(52.0, 201.0)
CAMERA = OmniCamera(
    480, 480, (239.5, 239.5), 52.0, 200.0, -1, -1.5708, RADII, np.zeros(1), 1.57 * np.tan(0.0071 * RADII)[np.newaxis]
)


def written(tmp_path: Path, camera: OmniCamera, **more: object) -> Path:
    file = tmp_path / "camera.yaml"
    file.write_text(yaml.safe_dump({**yaml.safe_load(camera_yaml(camera, "")), **more}), encoding="utf-8")
    return file


def test_an_unsaid_uncertainty_is_the_usual_one(tmp_path: Path) -> None:
    camera = open_camera(written(tmp_path, CAMERA))
    assert camera.stated_uncertainty is None
    assert camera.uncertainty == CameraUncertainty(USUAL_TILT_DEG, 1.5, USUAL_RANGE_RATIO)
    assert "uncertainty" not in yaml.safe_load(camera_yaml(camera, ""))


@pytest.mark.parametrize("sure", [CameraUncertainty(0.0, 0.0, 0.0), CameraUncertainty(0.1, 0.75, 0.0125)])
def test_what_is_stated_is_written_and_read_again(tmp_path: Path, sure: CameraUncertainty) -> None:
    camera = replace(CAMERA, stated_uncertainty=sure)
    assert open_camera(written(tmp_path, camera)).uncertainty == sure
    other = tmp_path / "calibrated.yaml"
    other.write_text(camera_yaml(camera, "a remark"), encoding="utf-8")
    assert open_camera(other).uncertainty == sure


def test_a_part_of_it_is_enough(tmp_path: Path) -> None:
    sure = open_camera(written(tmp_path, CAMERA, uncertainty={"center_px": 0.5})).uncertainty
    assert sure == CameraUncertainty(USUAL_TILT_DEG, 0.5, USUAL_RANGE_RATIO)


@pytest.mark.parametrize(
    ("value", "named"),
    [
        (0.3, "must be a mapping"),
        ({"tilt": 0.3}, "uncertainty.tilt.*tilt_deg"),
        ({"tilt_deg": -0.1}, "uncertainty.tilt_deg.*between 0 and 10"),
        ({"range_ratio": 3}, "uncertainty.range_ratio.*between 0 and 0.5"),
        ({"center_px": "one"}, "uncertainty.center_px"),
        ({"center_px": math.nan}, "uncertainty.center_px"),
    ],
)
def test_nonsense_is_named(tmp_path: Path, value: object, named: str) -> None:
    with pytest.raises(InputError, match=named):
        open_camera(written(tmp_path, CAMERA, uncertainty=value))


def test_edges_that_scatter_more_leave_a_calibration_less_sure() -> None:
    bearings, ranges = np.arange(24) * math.pi / 12.0, np.linspace(0.7, 8.0, 15)
    radii = np.arctan(ranges / 1.57) / 0.0071 + np.zeros((24, 1))
    noise = np.random.default_rng(2).standard_normal(radii.shape)
    fine, rough = (
        edges_uncertainty(Edges(bearings, np.zeros_like(radii), radii + px * noise, ranges)) for px in (0.0, 2.0)
    )
    assert fine == pytest.approx(MIN_UNCERTAINTY)
    assert rough.center_px > 2.0 * fine.center_px
    assert rough.tilt_deg > 1.5 * fine.tilt_deg
