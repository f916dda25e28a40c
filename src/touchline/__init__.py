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
    from touchline.types import Estimate, Evidence, Frame, LinePoints, Observation, Prior, Samples, Status

__all__ = [
    "Estimate",
    "Evidence",
    "Frame",
    "LinePoints",
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

_PLACES = {
    "run": ("touchline.api", "run"),
    "evaluate": ("touchline.evaluation", "evaluate"),
    "Localizer": ("touchline.localizer", "Localizer"),
    "locate": ("touchline.localization.one_shot.locate", "locate"),
    "open_camera": ("touchline.camera", "open_camera"),
    "open_field": ("touchline.field", "open_field"),
    "open_source": ("touchline.sources", "open_source"),
    "open_system": ("touchline.systems", "open_system"),
    "RobotSetup": ("touchline.systems", "RobotSetup"),
    "Pose": ("touchline.geometry", "Pose"),
    "Estimate": ("touchline.types", "Estimate"),
    "Evidence": ("touchline.types", "Evidence"),
    "Frame": ("touchline.types", "Frame"),
    "Prior": ("touchline.types", "Prior"),
    "Samples": ("touchline.types", "Samples"),
    "LinePoints": ("touchline.types", "LinePoints"),
    "Observation": ("touchline.types", "Observation"),
    "Status": ("touchline.types", "Status"),
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("touchline")
    from importlib import import_module

    if name not in _PLACES:
        raise AttributeError(f"module 'touchline' has no attribute {name!r}")
    module, attribute = _PLACES[name]
    value = getattr(import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__, "__version__"])
