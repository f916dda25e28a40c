"""What was no recording before, a foreign bag, a video, loose images: its folder, sequence, field and camera file."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from touchline.errors import InputError
from touchline.files.yaml_text import read_yaml_mapping

if TYPE_CHECKING:
    from touchline.field import FieldModel


class TemporaryFolder:
    """A new folder, removed with all it holds when nobody holds this any more, at the latest when Python ends."""

    def __init__(self) -> None:
        self.path = Path(tempfile.mkdtemp(prefix="touchline-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


def named_field(path: Path, given: str | None) -> FieldModel:
    """The field that the user names. path: of what is read, for the message. Raises InputError without one."""
    from touchline.field import open_field, preset_names

    if given is None:
        known = ", ".join(sorted(preset_names()))
        raise InputError(f"{path}: does not say which field it is from: --field NAME|FILE ({known})")
    return open_field(given)


def write_field(field: FieldModel, given: str | None, folder: Path) -> str:
    """The field's name for sequence.yaml; field.yaml beside it where it is no preset."""
    from touchline.field import preset_names

    if given is None or given not in preset_names():
        field.to_yaml(folder / "field.yaml")
        return field.name
    return given


def copy_camera(file: Path, folder: Path) -> str:
    """The camera's kind; camera.yaml is written as it is. Raises InputError for one that cannot be read."""
    from touchline.camera import open_camera

    open_camera(file)
    tree = read_yaml_mapping(file)
    write_yaml(folder / "camera.yaml", tree)
    return str(tree.get("model"))


def write_yaml(path: Path, tree: dict[str, Any]) -> None:
    """A new YAML file."""
    with path.open("x", encoding="utf-8") as file:
        yaml.safe_dump(tree, file, sort_keys=False, allow_unicode=True)
