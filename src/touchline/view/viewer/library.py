"""The Rerun library, which is an extra: it is large, and only whoever looks at runs needs it."""

import importlib
from typing import Any

from touchline.errors import InputError


def rerun_library() -> Any:
    """The module `rerun`. Raises InputError where it is not installed."""
    try:
        return importlib.import_module("rerun")
    except ImportError:
        raise InputError("the viewer needs Rerun, which is not installed: pip install 'touchline[view]'") from None
