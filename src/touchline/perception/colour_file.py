"""A learned colour table in a file (.npz), to be learned once and used in every match."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np

from touchline.errors import InputError
from touchline.new_files import write_new_file
from touchline.perception.colour import WHITE, ColourModel

_FORMAT = "touchline colours 1"
_SHAPES = {"table": (64, 64, 64), "green": (3,), "white": (3,), "noise": (), "signal": (3,)}


def save_colours(model: ColourModel, path: Path) -> None:
    """Write a colour model into a new file. Raises InputError if it exists or can't be written."""
    arrays = {name: np.asarray(getattr(model, name)) for name in _SHAPES}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, format=np.array(_FORMAT), **arrays)  # type: ignore[arg-type]
    write_new_file(path, buffer.getvalue())


def load_colours(path: str | Path) -> ColourModel:
    """The colour model of a file that `touchline calibrate colour` wrote. Raises InputError for any other file."""
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in ("format", *_SHAPES)}
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or 'not a file of colours'})") from None
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile):
        raise InputError(f"{path}: is not a colour table; make one with touchline calibrate colour") from None
    if str(arrays["format"]) != _FORMAT:
        raise InputError(f"{path}: is a colour table of another format ({arrays['format']}); make it anew")
    for name, shape in _SHAPES.items():
        array = arrays[name]
        if array.shape != shape or array.dtype.kind not in "uf" or not np.all(np.isfinite(array)):
            raise InputError(f"{path}: is damaged: '{name}' has shape {array.shape}, expected {shape}")
    if arrays["table"].dtype != np.uint8 or int(arrays["table"].max()) > WHITE:
        raise InputError(f"{path}: is damaged: 'table' holds classes that are not known")
    return ColourModel(
        np.ascontiguousarray(arrays["table"]),
        arrays["green"].astype(np.float64),
        arrays["white"].astype(np.float64),
        float(arrays["noise"]),
        arrays["signal"].astype(np.float64),
    )
