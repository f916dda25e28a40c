"""Arrays in an archive (.npz): of a bounded size, numbers and text alone."""

import io
import math
import zipfile
from typing import Any

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError

_MAX_ITEM_BYTES = 400  # a text of 100 letters


def stored_array(
    stored: zipfile.ZipFile, name: str, shape: tuple[int | None, ...], most_bytes: int
) -> npt.NDArray[Any]:
    """One array of an archive; its size and shape are looked at before memory is taken for it.

    shape: None for a side of any length. Raises InputError for another size or shape; what zipfile and NumPy raise of
    an archive that is none, is damaged, encrypted or packed in another way, may be any exception.
    """
    member = stored.getinfo(f"{name}.npy")
    if member.file_size > most_bytes:
        raise InputError(f"'{name}' has {member.file_size} bytes, more than {most_bytes}")
    with stored.open(member) as file:
        array = io.BytesIO(file.read(most_bytes))
    if np.lib.format.read_magic(array) != (1, 0):
        raise InputError(f"'{name}' is an array of another version")
    found, _, kind = np.lib.format.read_array_header_1_0(array)
    fits = len(found) == len(shape) and all(want in (None, side) for want, side in zip(shape, found, strict=True))
    if not fits or kind.itemsize > _MAX_ITEM_BYTES:
        wanted = str(tuple("any" if side is None else side for side in shape)).replace("'", "")
        raise InputError(f"'{name}' has shape {found}, expected {wanted}")
    claimed = math.prod(found) * kind.itemsize
    if claimed > most_bytes:
        raise InputError(f"'{name}' claims {claimed} bytes, more than {most_bytes}")
    array.seek(0)
    return np.lib.format.read_array(array, allow_pickle=False)
