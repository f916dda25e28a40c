"""The localization systems by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from touchline.camera import OmniCamera, PerspectiveCamera
from touchline.config import PAPER, Settings, load_settings, settings_from_mapping
from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.given import given_name, given_seed
from touchline.messages import did_you_mean
from touchline.motion import MotionHistory
from touchline.perception import Detector
from touchline.systems.iris_fusion import IrisFusion, IrisFusionSettings
from touchline.systems.nimbro_lines import NimbroLines, NimbroLinesSettings
from touchline.systems.nubot_mcl import NubotMcl, NubotMclSettings
from touchline.systems.nubot_mcl_alone import NubotMclAlone, NubotMclAloneSettings
from touchline.systems.nubot_mti import NubotMti, NubotMtiSettings
from touchline.systems.setup import RobotSetup, as_setup
from touchline.systems.touchline import Touchline, TouchlineSettings
from touchline.types import System


class LocalizationSystem(System, Protocol):
    """A system of this package: what it sees with can be looked at, too."""

    @property
    def detector(self) -> Detector | None:
        """Image -> observation; None without a camera."""
        ...

    @property
    def history(self) -> MotionHistory:
        """What it remembers of the robot's motion."""
        ...


@dataclass(frozen=True, slots=True)
class Needs:
    """The sensors that a system measures with beside camera and compass, by their names in `Frame`.

    purpose: what they are for, as in "NAME measures its way". stand_in: the sensor that takes their place where one of
    them is missing; without: what happens if that is missing, too.
    """

    purpose: str
    sensors: tuple[str, ...]
    stand_in: str
    without: str


@dataclass(frozen=True, slots=True)
class SystemInfo:
    """One system: its name, one line about it, its settings, and how it is made from setup, settings and rng.

    needs: sensors whose absence is reported to the user. cameras: classes of those in whose images it can see.
    """

    name: str
    description: str
    settings: type[Settings]
    factory: Callable[..., LocalizationSystem]
    needs: Needs | None = None
    cameras: tuple[type, ...] = (OmniCamera,)


DEFAULT_SYSTEM = "touchline"
SYSTEMS = {
    info.name: info
    for info in (
        SystemInfo(
            "touchline",
            "our own: registration at the statistical bound, hypotheses with probabilities, no compass needed",
            TouchlineSettings,
            Touchline,
            cameras=(OmniCamera, PerspectiveCamera),
        ),
        SystemInfo(
            "nubot-mti",
            "compass heading, 315 grid samples, RPROP matching, Kalman fusion with odometry (Xiong et al.)",
            NubotMtiSettings,
            NubotMti,
        ),
        SystemInfo(
            "nubot-mcl",
            "600 particles find the robot; RPROP matching, Kalman fusion with odometry follow it (Lu et al. 2013)",
            NubotMclSettings,
            NubotMcl,
        ),
        SystemInfo(
            "nubot-mcl-alone",
            "600 particles find the robot and follow it without matching, to compare nubot-mcl with",
            NubotMclAloneSettings,
            NubotMclAlone,
        ),
        SystemInfo(
            "iris-fusion",
            "measuring wheels and gyro, 600 particles on an error map, fused in three modes (Ismail et al. 2021)",
            IrisFusionSettings,
            IrisFusion,
            Needs(
                "measures its way with two wheels and a gyro",
                ("wheels", "gyro"),
                "odometry",
                "no motion is measured, poses come from the images alone",
            ),
        ),
        SystemInfo(
            "nimbro-lines",
            "lines, crossings, posts of a walking robot's camera, augmented MCL (Schulz and Behnke 2012)",
            NimbroLinesSettings,
            NimbroLines,
            cameras=(PerspectiveCamera,),
        ),
    )
}


def system_info(name: str) -> SystemInfo:
    """The named system. Raises InputError with the nearest known name."""
    given_name("system", f"a name: {', '.join(SYSTEMS)}", name)
    if name not in SYSTEMS:
        raise InputError(f"unknown system '{name}': {did_you_mean(name, list(SYSTEMS))}")
    return SYSTEMS[name]


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
    "camera": "camera.yaml"}. settings: its own, by default the paper's values, or only what differs, as
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
