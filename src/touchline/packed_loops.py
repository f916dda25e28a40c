"""Loops that came compiled with the wheel `touchline-kernels` (kernels/ in the repository): taken where all fits.

Numba finds code that it kept by the processor's name and all its features. A wheel's code is for any processor of a
kind, so it is looked up here, ahead of Numba's own search, which stays as it is for whatever the wheel lacks.
"""

import hashlib
import importlib.util
import json
import sys
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

from touchline.files.opened import UnreadableError, read_bytes, read_text

PACKAGE = "touchline_kernels"
DESCRIPTION = "built.json"
_MAX_BYTES = 1_000_000  # of it, and of a file of the sources
_SOURCES = Path(__file__).parent
_taken: Counter[str] = Counter()


def packed_loops_taken() -> int:
    """How many loops of this process came from the wheel, each with its types."""
    return _taken.total()


@cache
def take_packed_loops() -> str:
    """From now on a loop that the installed wheel holds is not compiled. Says whether it is used, and if not, why.

    Empty where no such wheel is installed. Only its own folder is read: who may write there may change the code, too.
    """
    found = importlib.util.find_spec(PACKAGE)
    if found is None or found.origin is None:
        return ""
    folder = Path(found.origin).parent
    try:
        here = surroundings()
    except (UnreadableError, ImportError) as error:
        return f"touchline-kernels is not used: what it has to fit is not known ({error})"
    try:
        built = json.loads(read_text(folder / DESCRIPTION, _MAX_BYTES))
        kind = f"{built['processor']} ({built['target']})"
        unfit = _unfit(built, here)
    except (UnreadableError, ValueError, KeyError, TypeError):
        unfit = f"its {DESCRIPTION} cannot be read"
    if unfit:
        return f"touchline-kernels is not used: {unfit}"
    _take_from(folder, built)
    return f"touchline-kernels is used: its loops are for {kind}"


def surroundings() -> dict[str, str]:
    """What compiled code fits beside the processor: versions, the system's name, and a digest of all our sources.

    Of NumPy the first two numbers, which are what Numba looks at: the code itself calls Python, Numba and libm alone.
    """
    from importlib.metadata import version

    import llvmlite
    import numba
    import numpy as np
    from llvmlite import binding

    return {
        "touchline": version("touchline"),
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "numpy": ".".join(np.__version__.split(".")[:2]),
        "python": ".".join(map(str, sys.version_info[:2])),
        "target": binding.get_process_triple(),
        "sources": _digest_of_sources(),
    }


def _digest_of_sources() -> str:
    """Of all: Numba looks a loop up by its own file, and does not notice a change in another whose loop it calls."""
    digest = hashlib.sha256()
    for path in sorted(_SOURCES.rglob("*.py")):
        name = path.relative_to(_SOURCES).as_posix()
        if not name.startswith("examples/"):  # a wheel holds them here, a checkout elsewhere
            content = read_bytes(path, _MAX_BYTES)
            digest.update(f"{name} {len(content)}\n".encode() + content)
    return digest.hexdigest()


def _unfit(built: dict[str, Any], here: dict[str, str]) -> str:
    """Why the loops cannot be taken here; empty if they can."""
    from llvmlite import binding
    from numba.core import config

    chosen: Any = config
    for name, value in here.items():
        if built[name] != value:
            if name == "sources":
                return "touchline's sources are not those that it was compiled from"
            return f"it is for {name} {built[name]}, and here is {value}"
    if chosen.CPU_NAME is not None or chosen.CPU_FEATURES is not None:
        return "NUMBA_CPU_NAME or NUMBA_CPU_FEATURES is set"
    offered = binding.get_host_cpu_features() if built["features"] else {}
    lacking = [name for name in built["features"] if not offered.get(name)]
    return f"the processor lacks {', '.join(lacking)}" if lacking else ""


def _take_from(folder: Path, built: dict[str, Any]) -> None:
    """Private parts of Numba, but of the very version with which the wheel was made."""
    from numba.core import caching

    kept: Any = caching
    search = kept.FunctionCache._load_overload

    def _load_overload(self: Any, signature: Any, target: Any) -> Any:
        source = Path(self._py_func.__code__.co_filename)
        if self._enabled and source.is_relative_to(_SOURCES):
            try:
                found = packed(self, source, signature, target)
            except Exception:  # a spoilt file may raise anything when it is unpickled
                found = None
            if found is not None:
                _taken[self._py_func.__qualname__] += 1
                return found
        return search(self, signature, target)

    def packed(self: Any, source: Path, signature: Any, target: Any) -> Any:
        place = folder / source.parent.relative_to(_SOURCES)
        index = kept.IndexDataCacheFile(place, self._impl.filename_base, self._cache_file._source_stamp)
        hashes = self._index_key(signature, target.codegen())[-1]
        found = index.load((signature, (built["target"], built["processor"], ""), hashes))
        return None if found is None else self._impl.rebuild(target, found)

    kept.FunctionCache._load_overload = _load_overload
