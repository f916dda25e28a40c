"""The fields that come with Touchline, and how a name or a path becomes a field."""

from pathlib import Path

from touchline.errors import InputError
from touchline.field.model import FieldModel
from touchline.field.reading import load_field
from touchline.given import given_path
from touchline.messages import did_you_mean

_PRESETS = Path(__file__).parent / "presets"


def preset_names() -> tuple[str, ...]:
    """Names of the bundled fields, sorted."""
    return tuple(sorted(file.stem for file in _PRESETS.glob("*.yaml")))


def open_field(name_or_path: str | Path | FieldModel) -> FieldModel:
    """A field by preset name, by the path of a field.yaml, or of a folder (a recording) that holds one.

    A FieldModel is returned as it is. Raises InputError for an unknown name and for a file that is no field.
    """
    if isinstance(name_or_path, FieldModel):
        return name_or_path
    path = given_path("field", "a preset's name, the path of a field.yaml or a FieldModel", name_or_path)
    if str(name_or_path) in preset_names():
        return load_field(_PRESETS / f"{name_or_path}.yaml")
    if path.is_dir():
        path = path / "field.yaml"
    if path.exists():
        return _load_file(name_or_path, path)
    if path.suffix in (".yaml", ".yml"):
        raise InputError(f"{path}: no such field file; presets: {', '.join(preset_names())}")
    raise InputError(f"{name_or_path}: no such field; {did_you_mean(str(name_or_path), preset_names())}")


def _load_file(given: str | Path, path: Path) -> FieldModel:
    """A file's field. A name without an ending may have been meant as a preset's: then the error tells both."""
    try:
        return load_field(path)
    except InputError as error:
        if Path(given).suffix in (".yaml", ".yml") or Path(given) != path:
            raise
        raise InputError(
            f"{given}: no such preset ({did_you_mean(str(given), preset_names())}), and the file of this name is no "
            f"field file: {error}"
        ) from None
