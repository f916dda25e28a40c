"""Pixel <-> ground: what a pixel of the camera sees on the field's floor."""

from pathlib import Path
from typing import Any

from touchline.camera.base import Camera, field_of_view, leaning, pose_in_base
from touchline.camera.fisheye import FisheyeCamera, fisheye_from_mapping
from touchline.camera.ground_view import GroundView, PerspectiveCamera, ground_view
from touchline.camera.mounted import lens_mapping
from touchline.camera.omni import OmniCamera, omni_from_mapping, require_omni
from touchline.camera.pinhole import PinholeCamera, pinhole_from_mapping, pinhole_mapping
from touchline.errors import InputError
from touchline.files.yaml_text import read_yaml_mapping
from touchline.given import given_path
from touchline.messages import did_you_mean, shown

MODELS = ("omni", "pinhole", "fisheye")
PERSPECTIVE_MODELS = ("pinhole", "fisheye")


def open_camera(path: str | Path | Camera) -> Camera:
    """The camera that a camera.yaml describes; a camera is returned as it is.

    Raises InputError for an unknown model or a broken file.
    """
    if not isinstance(path, str | Path) and hasattr(path, "ground_from_image"):
        return path
    path = given_path("camera", "the path of a camera.yaml or a camera", path)
    return camera_from_mapping(read_yaml_mapping(path), path)


def camera_from_mapping(tree: dict[str, Any], path: Path) -> Camera:
    """The camera of a camera.yaml's content; `path` is named in errors."""
    model = tree.get("model")
    if model is None:
        raise InputError(f"{path}: 'model' is missing; one of {', '.join(MODELS)}")
    if model == "omni":
        return omni_from_mapping(tree, path)
    if model == "pinhole":
        return pinhole_from_mapping(tree, path)
    if model == "fisheye":
        return fisheye_from_mapping(tree, path)
    raise InputError(f"{path}: unknown camera model {shown(model)}; {did_you_mean(str(model), MODELS)}")


def perspective_mapping(camera: PerspectiveCamera) -> dict[str, Any]:
    """The camera.yaml of a camera with a lens."""
    return pinhole_mapping(camera) if isinstance(camera, PinholeCamera) else lens_mapping(camera)


__all__ = [
    "PERSPECTIVE_MODELS",
    "Camera",
    "FisheyeCamera",
    "GroundView",
    "OmniCamera",
    "PerspectiveCamera",
    "PinholeCamera",
    "camera_from_mapping",
    "field_of_view",
    "ground_view",
    "leaning",
    "open_camera",
    "perspective_mapping",
    "pose_in_base",
    "require_omni",
]
