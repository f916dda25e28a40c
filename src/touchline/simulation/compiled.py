"""How the innermost loops are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

_Loop = TypeVar("_Loop", bound=Callable[..., Any])


def uncounted(loop: _Loop) -> _Loop:
    """Compile a loop over rays that makes no arrays but hands some on to functions, ray by ray.

    Numba would count the references to each of them before and after, atomically, which takes as long as a contact
    shadow and 2 to 5 % of a frame.
    """
    options: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}
    compiled: _Loop = njit(**options)(loop)
    return compiled
