"""Pixel <-> ground: what a pixel of the camera sees on the field's floor."""

from __future__ import annotations

from pathlib import Path

from touchline.camera.omni import OmniCamera, omni_from_mapping
from touchline.config import read_yaml_mapping
from touchline.errors import InputError
from touchline.messages import did_you_mean

MODELS = ("omni", "pinhole")


def open_camera(path: str | Path) -> OmniCamera:
    """The camera that a camera.yaml describes. Raises InputError for an unknown model or a broken file."""
    path = Path(path)
    tree = read_yaml_mapping(path)
    model = tree.get("model")
    if model is None:
        raise InputError(f"{path}: 'model' is missing; one of {', '.join(MODELS)}")
    if model == "omni":
        return omni_from_mapping(tree, path)
    if model == "pinhole":
        raise InputError(f"{path}: no system uses a pinhole camera yet; 'model: omni' is needed")
    raise InputError(f"{path}: unknown camera model {model!r}; {did_you_mean(str(model), MODELS)}")


__all__ = ["OmniCamera", "open_camera"]
