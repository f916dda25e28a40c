"""How the innermost loops are compiled."""

from __future__ import annotations

from numba import njit

# Loops that make no arrays, but hand arrays to functions for each ray: Numba would count the references to each of them
# before and after, atomically, which costs as much as a contact shadow or a look at the windows (an eighth of a frame).
uncounted = njit(cache=True, error_model="numpy", _nrt=False)
