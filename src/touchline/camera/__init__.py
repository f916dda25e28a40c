"""Pixel <-> ground: what a pixel of the camera sees on the field's floor."""

from pathlib import Path
from typing import Any

from touchline.camera.base import Camera, field_of_view, leaning, pose_in_base
from touchline.camera.fisheye import FisheyeCamera
from touchline.camera.ground_view import GroundView, ground_view
from touchline.camera.mounted import PerspectiveCamera
from touchline.camera.omni import OmniCamera, require_omni
from touchline.camera.pinhole import PinholeCamera
from touchline.errors import InputError
from touchline.files.yaml_text import read_yaml_mapping
from touchline.given import given_path
from touchline.messages import did_you_mean, shown

# by the model that camera.yaml names; another camera is entered here
CAMERAS: dict[str, type[OmniCamera] | type[PerspectiveCamera]] = {
    kind.model: kind for kind in (OmniCamera, PinholeCamera, FisheyeCamera)
}


def open_camera(path: str | Path | Camera) -> Camera:
    """The camera that a camera.yaml describes; a camera is returned as it is.

    Raises InputError for an unknown model or a broken file.
    """
    if isinstance(path, OmniCamera | PerspectiveCamera):
        return path
    path = given_path("camera", "the path of a camera.yaml or a camera", path)
    return camera_from_mapping(read_yaml_mapping(path), path)


def camera_from_mapping(tree: dict[str, Any], path: Path) -> Camera:
    """The camera of a camera.yaml's content; `path` is named in errors."""
    model = tree.get("model")
    if model is None:
        raise InputError(f"{path}: 'model' is missing; one of {', '.join(CAMERAS)}")
    kind = CAMERAS.get(str(model))
    if kind is None:
        raise InputError(f"{path}: unknown camera model {shown(model)}; {did_you_mean(str(model), list(CAMERAS))}")
    return kind.from_mapping(tree, path)


def is_perspective(model: str) -> bool:
    """Whether a model that camera.yaml may name has a lens: not a mirror, and not `none`."""
    return model in CAMERAS and issubclass(CAMERAS[model], PerspectiveCamera)


__all__ = [
    "CAMERAS",
    "Camera",
    "FisheyeCamera",
    "GroundView",
    "OmniCamera",
    "PerspectiveCamera",
    "PinholeCamera",
    "camera_from_mapping",
    "field_of_view",
    "ground_view",
    "is_perspective",
    "leaning",
    "open_camera",
    "pose_in_base",
    "require_omni",
]
