"""The rendering is honest: beside the physically rendered recordings of the same field, camera and pose."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from line_profiles import line_offsets, projected_lines

from touchline.camera import OmniCamera, open_camera
from touchline.geometry import FloatArray, Pose
from touchline.perception import LinePointDetector
from touchline.sources import Recording, open_source
from touchline.types import ImageArray
from touchline_lab.simulation.cameras.image_sensor import LinearImageCamera
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.recording import encoded
from touchline_lab.simulation.world.hall import default_world
from touchline_lab.simulation.world.world import WorldState

pytestmark = pytest.mark.slow  # rendering

LAMPS = (12.0, 1.7)  # exposure (ms) and gain that suit the hall's lamps
OMNI = {  # images; those that a recording cut short lacks are left out
    "omni_msl_track": (0, 40, 60),
    "omni_msl_match": (24, 48, 96),
    "omni_msl_kidnap": (5, 45),
    "omni_msl_sun": (0, 16, 32),
    "omni_9x6_points": (2, 12, 48),
    "omni_exposure": (1, 5),
    "omni_calibration": (3, 15),
}


def as_file(image: ImageArray) -> ImageArray:
    """An image as a recording's JPEG shows it: chroma at half the resolution."""
    decoded = cv2.imdecode(np.frombuffer(encoded(image), np.uint8), cv2.IMREAD_COLOR)
    return np.asarray(decoded, dtype=np.uint8)


def recorded_image(recording: Recording, frame: int) -> ImageArray:
    """A recorded image; of a linear one, the picture at an exposure that suits its light."""
    if not recording.linear:
        image = recording.image(frame)
        assert image is not None
        return image
    camera = LinearImageCamera.open(recording, frame)
    camera.set(*(LAMPS if frame % 3 == 1 else (8.0, 1.0)))
    return as_file(camera.grab())


def true_pose(recording: Recording, frame: int) -> Pose:
    assert recording.truth is not None
    return recording.truth[frame]


@pytest.mark.slow
class TestOmnidirectional:
    @pytest.mark.parametrize("name", OMNI)
    def test_lines_and_line_points_lie_where_they_lie_in_the_recording(self, shared_data: Path, name: str) -> None:
        recording = open_source(shared_data / name)
        told = open_camera(shared_data / name / "camera.yaml")
        assert isinstance(told, OmniCamera)
        camera = SimulatedOmniCamera(told)
        world = default_world(recording.field, 3)
        images: dict[str, list[ImageArray]] = {"recorded": [], "rendered": []}
        offsets: dict[str, list[FloatArray]] = {"recorded": [], "rendered": []}
        for frame in (each for each in OMNI[name] if each < len(recording)):
            pose = true_pose(recording, frame)
            picture = camera.render(world, WorldState(), pose, (0.0, 0.0), *LAMPS, np.random.default_rng(frame))
            images["recorded"].append(recorded_image(recording, frame))
            images["rendered"].append(as_file(picture))
            places, normals, half, _ = projected_lines(camera.project, recording.field, pose, (480, 480))
            ring = np.abs(np.hypot(*(places - camera.design.center).T) - 122.0) < 52.0
            for kind, pictures in images.items():
                offsets[kind].append(line_offsets(pictures[-1], places[ring], normals[ring], half[ring], 4.0))
        agree(np.concatenate(offsets["recorded"]), np.concatenate(offsets["rendered"]), least=250)
        points = {kind: self.line_points(shared_data / name, pictures) for kind, pictures in images.items()}
        for recorded, rendered in zip(points["recorded"], points["rendered"], strict=True):
            gaps = np.linalg.norm(recorded[:, np.newaxis] - rendered[np.newaxis], axis=2)
            assert np.median(gaps.min(axis=1)) < 0.25, "asked: half a pixel"
            assert np.median(gaps.min(axis=0)) < 0.25
            assert 0.65 < len(recorded) / len(rendered) < 1.1, "robots hide some of the recorded ones"

    @staticmethod
    def line_points(folder: Path, images: list[ImageArray]) -> list[FloatArray]:
        model = open_camera(folder / "camera.yaml")
        assert isinstance(model, OmniCamera)
        detector = LinePointDetector(model)
        detector.learn(images)
        return [detector.detect(image).pixels for image in images]


def agree(recorded: FloatArray, rendered: FloatArray, least: int) -> None:
    """Both lie on the projection and on each other, to half a pixel nearly everywhere and a fifth of one mostly."""
    clear = np.isfinite(recorded) & np.isfinite(rendered)
    assert np.count_nonzero(clear) >= least
    for offset in (recorded[clear], rendered[clear], (recorded - rendered)[clear]):
        assert np.median(np.abs(offset)) < 0.15
        assert np.percentile(np.abs(offset), 95) < 0.5
        assert abs(np.mean(offset)) < 0.1, "a JPEG's chroma of half the resolution moves red by 0.05 px"
