"""Loops from Numba's cache, held in less memory."""

from functools import cache
from typing import Any

_BITCODE = "_touchline_bitcode"


@cache
def load_loops_lean() -> None:
    """From now on a loop that comes from the cache keeps its bitcode packed.

    Numba parses the bitcode of each, in case that a loop compiled later calls it. That takes 35 of a worker's 285 MB,
    and where everything is compiled nothing uses it: here it is parsed when it is asked for. A Numba without these
    methods is left alone.
    """
    from llvmlite import binding
    from numba.core.codegen import CPUCodeLibrary

    library_class: Any = CPUCodeLibrary
    loaded, linked = (getattr(library_class, name, None) for name in ("_unserialize", "_get_module_for_linking"))
    if loaded is None or linked is None:
        return

    def _unserialize(cls: type[Any], codegen: Any, state: Any) -> Any:
        library = loaded(codegen, state)
        if state[1] == "object":
            library._shared_module = None
            setattr(library, _BITCODE, state[2][1])
        return library

    def _get_module_for_linking(self: Any) -> Any:
        if self._shared_module is None and hasattr(self, _BITCODE):
            self._shared_module = binding.parse_bitcode(getattr(self, _BITCODE))
        return linked(self)

    library_class._unserialize = classmethod(_unserialize)
    library_class._get_module_for_linking = _get_module_for_linking
