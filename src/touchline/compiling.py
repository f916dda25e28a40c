"""Numba as the commands and their workers set it; importing Touchline does none of this (but see `packed_loops`)."""

from functools import cache
from typing import Any

_BITCODE = "_touchline_bitcode"


def leave_out_c_wrappers() -> None:
    """From now on loops are compiled without what C would call them by, which takes 7 % of the time: nobody does."""
    from numba.core.compiler import Flags

    option = Flags.options.get("no_cfunc_wrapper")
    if option is not None:
        option._default = True


@cache
def load_loops_lean() -> None:
    """From now on a loop that comes from the cache keeps its bitcode packed.

    Numba parses the bitcode of each and keeps what comes of it, in case that a loop compiled later calls it: 30 to 40
    of a worker's 295 to 325 MB, and where everything is compiled nothing uses it. Here it is dropped once it is parsed,
    and parsed again when it is asked for. A Numba with other methods, or another state of a loop, is left alone.
    """
    from llvmlite import binding
    from numba.core import codegen

    library_class: Any = getattr(codegen, "CPUCodeLibrary", None)
    loaded, linked = (getattr(library_class, name, None) for name in ("_unserialize", "_get_module_for_linking"))
    if loaded is None or linked is None:
        return

    def _unserialize(cls: type[Any], codegen: Any, state: Any) -> Any:
        library = loaded(codegen, state)
        match state:
            case (_, "object", (_, bytes(bitcode))) if getattr(library, "_shared_module", None) is not None:
                library._shared_module = None
                setattr(library, _BITCODE, bitcode)
        return library

    def _get_module_for_linking(self: Any) -> Any:
        if hasattr(self, _BITCODE) and self._shared_module is None:
            self._shared_module = binding.parse_bitcode(getattr(self, _BITCODE))
        return linked(self)

    library_class._unserialize = classmethod(_unserialize)
    library_class._get_module_for_linking = _get_module_for_linking
