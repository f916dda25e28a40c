"""A learned colour table in a file (.npz), to be learned once and used in every match."""

import io
import zipfile
from pathlib import Path

import numpy as np

from touchline.errors import InputError
from touchline.files.arrays import stored_array
from touchline.files.new import write_new_file
from touchline.files.opened import read_bytes
from touchline.geometry import FloatArray
from touchline.perception.colour import WHITE, ColourModel
from touchline.perception.colour_ellipses import COLOURED, Ellipse, Ellipses

_FORMAT = "touchline colours 2"
_SHAPES: dict[str, tuple[int, ...]] = {
    "table": (64, 64, 64),
    "green": (3,),
    "white": (3,),
    "noise": (),
    "signal": (3,),
    "ellipses": (len(COLOURED), len(Ellipse._fields)),
    "black": (),
}
_MAX_VARIANCE, _MIN_VARIANCE = (
    512.0**2,
    1.0,
)  # of an ellipse: all its numbers, and its shape's smaller eigenvalue, in U, V squared
_MAX_BYTES = 4_000_000  # the table as float64, and room to spare


def save_colours(model: ColourModel, path: Path) -> None:
    """Write a colour model into a new file. Raises InputError if it exists or can't be written."""
    arrays = {name: np.asarray(getattr(model, name)) for name in _SHAPES}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, format=np.array(_FORMAT), **arrays)  # type: ignore[arg-type]
    write_new_file(path, buffer.getvalue())


def load_colours(path: str | Path) -> ColourModel:
    """The colour model of a file that `touchline calibrate colour` wrote. Raises InputError for any other file."""
    path = Path(path)
    data = read_bytes(path, _MAX_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as stored:
            written = str(stored_array(stored, "format", (), _MAX_BYTES))
            shapes = _SHAPES if written == _FORMAT else {}
            arrays = {name: stored_array(stored, name, shape, _MAX_BYTES) for name, shape in shapes.items()}
    except InputError as error:
        raise InputError(f"{path}: is damaged: {error}") from None
    except Exception:  # whatever zipfile and NumPy raise of what is no such archive
        raise InputError(f"{path}: is not a colour table; make one with touchline calibrate colour") from None
    if written != _FORMAT:
        raise InputError(f"{path}: is a colour table of another format ({written:.40}); make it anew")
    for name in _SHAPES:
        if arrays[name].dtype.kind not in "uf" or not np.all(np.isfinite(arrays[name])):
            raise InputError(f"{path}: is damaged: '{name}' holds something else than numbers")
    if arrays["table"].dtype != np.uint8 or int(arrays["table"].max()) > WHITE:
        raise InputError(f"{path}: is damaged: 'table' holds classes that are not known")
    if not 0.0 <= float(arrays["black"]) <= 1.0:
        raise InputError(f"{path}: is damaged: 'black' is no ratio of the carpet's luminance")
    ellipses = _ellipses(arrays["ellipses"].astype(np.float64), path)
    return ColourModel(
        np.ascontiguousarray(arrays["table"]),
        arrays["green"].astype(np.float64),
        arrays["white"].astype(np.float64),
        float(arrays["noise"]),
        arrays["signal"].astype(np.float64),
        ellipses,
        float(arrays["black"]),
    )


def _ellipses(rows: FloatArray, path: Path) -> Ellipses:
    """Of rows (5, 7). Raises InputError for one that is no ellipse within U, V."""
    ellipses = tuple(Ellipse(*map(float, row)) for row in rows)
    for name, ellipse in zip(COLOURED, ellipses, strict=True):
        if np.abs(ellipse).max() > _MAX_VARIANCE or np.linalg.eigvalsh(ellipse.shape)[0] < _MIN_VARIANCE:
            raise InputError(f"{path}: is damaged: the ellipse of {name} in 'ellipses' is none")
    return ellipses
