"""The localization systems by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from touchline.camera import OmniCamera
from touchline.config import Settings
from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.messages import did_you_mean
from touchline.perception import HsvLineDetector, LinePointDetector
from touchline.systems.iris_fusion import IrisFusion, IrisFusionSettings
from touchline.systems.nubot_mcl import NubotMcl, NubotMclSettings
from touchline.systems.nubot_mti import NubotMti, NubotMtiSettings
from touchline.types import System


@dataclass(frozen=True, slots=True)
class SystemInfo:
    """One system: its name, one line about it, its settings and how it is made from field, camera, settings and rng.

    measuring_wheels: whether it is made from the wheels' rolling directions, too (a, b or None; robot frame, rad).
    line_detector: how it finds line points, for a closer look at an image.
    """

    name: str
    description: str
    settings: type[Settings]
    factory: Callable[..., System]
    measuring_wheels: bool = False
    line_detector: type[LinePointDetector | HsvLineDetector] = LinePointDetector


DEFAULT_SYSTEM = "nubot-mti"
SYSTEMS = {
    info.name: info
    for info in (
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
            "iris-fusion",
            "measuring wheels and gyro, 600 particles on an error map, fused in three modes (Ismail et al. 2021)",
            IrisFusionSettings,
            IrisFusion,
            measuring_wheels=True,
            line_detector=HsvLineDetector,
        ),
    )
}


def system_info(name: str) -> SystemInfo:
    """The named system. Raises InputError with the nearest known name."""
    if name not in SYSTEMS:
        raise InputError(f"unknown system '{name}': {did_you_mean(name, list(SYSTEMS))}")
    return SYSTEMS[name]


def open_system(
    name: str,
    field: FieldModel,
    camera: OmniCamera | None,
    settings: Settings | None = None,
    rng: np.random.Generator | None = None,
    wheel_directions_rad: tuple[float, float] | None = None,
) -> System:
    """A system that is ready for its first frame.

    camera: None if the frames bring their line points. wheel_directions_rad: rolling directions of the measuring
    wheels a and b in the robot frame, for systems that use them; None if nobody knows. Raises InputError for an
    unknown name, and for settings of another system.
    """
    info = system_info(name)
    chosen = info.settings() if settings is None else settings
    if not isinstance(chosen, info.settings):
        raise InputError(f"system '{name}' takes {info.settings.__name__}, not {type(chosen).__name__}")
    parts = (field, camera, chosen, np.random.default_rng(0) if rng is None else rng)
    return info.factory(*parts, wheel_directions_rad) if info.measuring_wheels else info.factory(*parts)


__all__ = ["DEFAULT_SYSTEM", "SYSTEMS", "SystemInfo", "open_system", "system_info"]
