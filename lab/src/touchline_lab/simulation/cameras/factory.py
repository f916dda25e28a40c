"""The simulated camera that a scenario asks for."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from touchline.camera import OmniCamera, PerspectiveCamera, open_camera
from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline_lab.simulation.cameras import mirror
from touchline_lab.simulation.cameras.base import Motion
from touchline_lab.simulation.cameras.image_sensor import ImageSensor
from touchline_lab.simulation.cameras.mirror_rays import MirrorMount
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.cameras.perspective import SimulatedPerspectiveCamera, humanoid_camera, kid_size_camera
from touchline_lab.simulation.scenario import CameraSettings

SimulatedCamera = SimulatedOmniCamera | SimulatedPerspectiveCamera


def open_simulated_camera(settings: CameraSettings, mount: MirrorMount | None = None) -> SimulatedCamera:
    """The camera of a scenario, its mirror sitting as `mount` says (none: as designed).

    Raises InputError for a file that describes none and a mirror that can't be solved.
    """
    options: dict[str, Any] = {
        "readout_s": 1e-3 * settings.rolling_shutter_ms,
        "sensor": ImageSensor(vignetting=settings.vignetting, bloom=settings.bloom),
    }
    if settings.file is not None:
        design = open_camera(settings.file)
        if design.model != settings.kind:
            raise InputError(
                f"{settings.file}: is a camera of the model '{design.model}', but camera.kind is '{settings.kind}'"
            )
        if isinstance(design, OmniCamera):
            return SimulatedOmniCamera(design, **options)
        assert isinstance(design, PerspectiveCamera)
        return SimulatedPerspectiveCamera(design, **options)
    if settings.kind != "omni":
        humanoid = humanoid_camera() if settings.kind == "pinhole" else kid_size_camera()
        return SimulatedPerspectiveCamera(humanoid, **options)
    wanted = settings.mirror
    profile = _solved(wanted.profile, wanted.metres_per_px, wanted.horizon_px)
    return SimulatedOmniCamera.from_mirror(profile, mount, **options)


def base_motion(velocity: FloatArray, heading: float, leaning: tuple[float, float] = (0.0, 0.0)) -> Motion:
    """A velocity (3,) vx, vy, turning rate in the field frame as a motion in the base frame; leaning: rates (rad/s)."""
    c, s = float(np.cos(heading)), float(np.sin(heading))
    vx, vy, turn = (float(value) for value in velocity)
    return Motion(c * vx + s * vy, -s * vx + c * vy, turn, *leaning)


@lru_cache(maxsize=16)
def _solved(profile: str, metres_per_px: float, horizon_px: float) -> mirror.MirrorProfile:
    """The solved mirror of a profile's name. Raises InputError where no mirror shows the wanted range."""
    if profile == "hyperbolic":
        return mirror.solve_mirror(*mirror.hyperbolic(horizon_px=horizon_px))
    targets: dict[str, Callable[[], mirror.Target]] = {
        "combined": mirror.combined,
        "horizontally-isometric": lambda: mirror.horizontally_isometric(metres_per_px),
        "vertically-isometric": mirror.vertically_isometric,
        "recorded": mirror.tangent_range,
    }
    return mirror.solve_mirror(targets[profile]())
