"""Touchline tells a soccer robot where it stands, from the white lines of the field.

>>> import touchline
>>> run = touchline.run("recording")
>>> print(run.errors)

Everything here is imported when it is first used, so that `import touchline` costs nothing.
"""

from __future__ import annotations

TYPE_CHECKING = False  # the one of `typing`, whose import would be all that the command does before it takes a Ctrl-C
if TYPE_CHECKING:
    from typing import Any

    from touchline.api import run
    from touchline.camera import open_camera
    from touchline.evaluation import evaluate
    from touchline.field import open_field
    from touchline.geometry import Pose
    from touchline.localization.one_shot.locate import locate
    from touchline.localizer import Localizer
    from touchline.sources import open_source
    from touchline.systems import RobotSetup, open_system
    from touchline.types import (
        Crossings,
        Estimate,
        Evidence,
        Frame,
        Landmarks,
        LinePoints,
        Lines,
        Observation,
        Prior,
        Samples,
        Status,
    )

__all__ = [
    "Crossings",
    "Estimate",
    "Evidence",
    "Frame",
    "Landmarks",
    "LinePoints",
    "Lines",
    "Localizer",
    "Observation",
    "Pose",
    "Prior",
    "RobotSetup",
    "Samples",
    "Status",
    "evaluate",
    "locate",
    "open_camera",
    "open_field",
    "open_source",
    "open_system",
    "run",
]

_MODULES = {
    "run": "api",
    "evaluate": "evaluation",
    "Localizer": "localizer",
    "locate": "localization.one_shot.locate",
    "open_camera": "camera",
    "open_field": "field",
    "open_source": "sources",
    "open_system": "systems",
    "RobotSetup": "systems",
    "Pose": "geometry",
}  # all others: types


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("touchline")
    from importlib import import_module

    if name not in __all__:
        raise AttributeError(f"module 'touchline' has no attribute {name!r}")
    module = _MODULES.get(name, "types")
    if module != "geometry":  # which needs no Numba
        import_module("touchline.packed_loops").take_packed_loops()
    value = getattr(import_module(f"touchline.{module}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__, "__version__"])
