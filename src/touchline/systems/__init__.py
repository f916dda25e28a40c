"""The localization systems by name: our own, and those that packages bring as entry points `touchline.systems`."""

from collections import UserDict
from collections.abc import ItemsView, Mapping, ValuesView
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np

from touchline.camera import OmniCamera, PerspectiveCamera
from touchline.config import PAPER, Settings, load_settings, settings_from_mapping
from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.given import given_seed, refused
from touchline.messages import did_you_mean
from touchline.plugins import entry_points_of, load
from touchline.systems.info import LocalizationSystem, Needs, SystemInfo
from touchline.systems.setup import RobotSetup, as_setup
from touchline.systems.touchline import Touchline, TouchlineSettings

DEFAULT_SYSTEM = "touchline"
_OWN = SystemInfo(
    DEFAULT_SYSTEM,
    "our own: registration at the statistical bound, hypotheses with probabilities, no compass needed",
    TouchlineSettings,
    Touchline,
    cameras=(OmniCamera, PerspectiveCamera),
)


class _Systems(UserDict[str, SystemInfo]):
    """Systems by name; one of an entry point is imported when it is asked for, and left out if it cannot be."""

    def __init__(self) -> None:
        super().__init__()
        self._entries: dict[str, EntryPoint] = entry_points_of("touchline.systems", (DEFAULT_SYSTEM,))
        self.data = {DEFAULT_SYSTEM: _OWN, **dict.fromkeys(self._entries)}  # type: ignore[dict-item]

    def __getitem__(self, name: str) -> SystemInfo:
        entry = self._entries.get(name)
        if entry is not None:
            info = load(entry, SystemInfo)
            if info is None:
                self.data.pop(name, None)
            else:
                self.data[name] = info
            self._entries.pop(name, None)
        return self.data[name]

    def get(self, name: str, default: Any = None) -> Any:
        """The named system; the default for an unknown one, and for one that cannot be imported."""
        try:
            return self[name]
        except KeyError:
            return default

    def _load_all(self) -> None:
        for name in list(self._entries):
            self.get(name)

    def items(self) -> ItemsView[str, SystemInfo]:
        """Names and systems, all imported."""
        self._load_all()
        return super().items()

    def values(self) -> ValuesView[SystemInfo]:
        """The systems, all imported."""
        self._load_all()
        return super().values()


SYSTEMS = _Systems()


def system_info(name: str) -> SystemInfo:
    """The named system. Raises InputError with the nearest known name."""
    if not isinstance(name, str):
        raise refused("system", f"a name: {', '.join(SYSTEMS)}", name)
    info = SYSTEMS.get(name)
    if info is None:
        raise InputError(f"unknown system '{name}': {did_you_mean(name, list(SYSTEMS))}")
    return info


def paper_settings(name: str, *changes: str) -> Settings:
    """The settings with which a system is exactly its paper's, but for changes `KEY=VALUE`."""
    return load_settings(system_info(name).settings, None, changes, preset=PAPER)


def open_system(
    name: str,
    setup: RobotSetup | FieldModel | str | Mapping[str, Any],
    settings: Settings | Mapping[str, Any] | None = None,
    rng: np.random.Generator | int | None = None,
) -> LocalizationSystem:
    """A system that is ready for its first frame.

    setup: also a field alone, by its name or file, or a dict of a RobotSetup's arguments, as {"field": "msl-18x12",
    "camera": "camera.yaml"}. settings: its own, by default the system's, or only what differs, as
    {"matching.c_m": 0.3}. rng: where all its chance comes from, or a seed; by default of seed 0.
    Raises InputError for an unknown name, for settings of another system and for a camera that the system cannot use.
    """
    info = system_info(name)
    setup = as_setup(setup)
    chosen = settings_from_mapping(info.settings, settings or {}) if isinstance(settings, Mapping | None) else settings
    if not isinstance(chosen, info.settings):
        raise InputError(f"system '{name}' takes {info.settings.__name__}, not {type(chosen).__name__}")
    if setup.camera is not None and not isinstance(setup.camera, info.cameras):
        omni = OmniCamera in info.cameras
        seen = "line points in images of an omnidirectional" if omni else "lines in images of a perspective"
        model = "an omni" if setup.camera.model == "omni" else f"a {setup.camera.model}"
        raise InputError(
            f"{name} finds {seen} camera; this camera is {model}: take --system {DEFAULT_SYSTEM}. "
            "What a detector of the robot's own has found needs no camera model: observations.csv in a recording, "
            "points or an observation in Python"
        )
    if not isinstance(rng, np.random.Generator):
        rng = np.random.default_rng(0 if rng is None else given_seed(rng))
    return info.factory(setup, chosen, rng)


__all__ = [
    "DEFAULT_SYSTEM",
    "SYSTEMS",
    "LocalizationSystem",
    "Needs",
    "RobotSetup",
    "SystemInfo",
    "open_system",
    "paper_settings",
    "system_info",
]
