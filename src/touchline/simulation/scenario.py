"""A scenario: everything that makes a run, as a YAML file. Whatever is random in it comes from its seed."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from touchline.config import Settings, load_settings
from touchline.errors import InputError
from touchline.simulation.sensors import SensorSettings

SCENARIO_FOLDER = Path(__file__).parent / "scenarios"
Place = tuple[float, float, float]


class MirrorSettings(Settings):
    """The mirror of an omnidirectional camera and how well it is built. Tilt about, shift along x and y (base)."""

    profile: Literal["combined", "hyperbolic", "horizontally-isometric", "vertically-isometric", "recorded"] = Field(
        "combined",
        description="shape: combined is the papers' of three parts; recorded is that of the public recordings",
    )
    metres_per_px: float = Field(0.045, gt=0, description="ground per pixel of a horizontally isometric mirror (m)")
    horizon_px: float = Field(210.0, gt=0, description="pixel radius of the horizon of a hyperbolic mirror")
    tilt_deg: tuple[float, float] = Field((0.0, 0.0), description="lean of the mirror about its apex (degrees)")
    shift_mm: tuple[float, float] = Field((0.0, 0.0), description="displacement of the mirror (mm)")


class CameraSettings(Settings):
    """The camera, its exposure and what hides its view."""

    kind: Literal["omni", "pinhole"] = Field("omni", description="omni (mirror) or pinhole (a humanoid's head)")
    rate_hz: float = Field(10.0, gt=0, le=100, description="images per second")
    exposure_ms: float = Field(12.0, gt=0, le=200, description="exposure time of the first images (ms)")
    gain: float = Field(1.7, gt=0, le=100, description="linear gain of the first images")
    mirror: MirrorSettings = MirrorSettings()
    file: str | None = Field(
        None, description="a camera.yaml whose camera is simulated; none: the mirror or pinhole here"
    )
    motion_blur: bool = Field(False, description="whether the motion during the exposure blurs the image")
    rolling_shutter_ms: float = Field(0.0, ge=0, description="time from the first to the last row's exposure (ms)")
    black_sectors_deg: tuple[tuple[float, float], ...] = Field(
        (), description="directions [from, to] in the base frame, counter-clockwise, that are black in every image"
    )
    delay_s: float = Field(0.0, ge=0, le=1, description="mean time from an image's stamp to its arrival (s)")
    delay_spread_s: float = Field(0.0, ge=0, le=1, description="half width of the even distribution of that time (s)")


class LightSettings(Settings):
    """What lights the hall, as levels of `touchline.simulation.lights`; changes add rows {time_s, lamps, sun, ...}."""

    class Change(Settings):
        """From time_s on, within fade_s, these levels (none: as before)."""

        time_s: float = Field(0.0, ge=0)
        lamps: float | None = Field(None, ge=0)
        sun: float | None = Field(None, ge=0)
        ambient: float | None = Field(None, ge=0)
        fade_s: float = Field(0.0, ge=0)

    lamps: float = Field(1.0, ge=0, description="level of the ceiling's lamps")
    ambient: float = Field(0.35, ge=0, description="level of the daylight everywhere")
    sun: float = Field(0.0, ge=0, description="level of direct sun where it falls through a window")
    sun_elevation_deg: float = Field(35.0, gt=0, lt=90, description="height of the sun")
    sun_azimuth_deg: float = Field(70.0, description="direction towards the sun, field frame, from x to y")
    windows: int = Field(0, ge=0, le=12, description="windows in the northern wall, evenly spread")
    changes: tuple[Change, ...] = Field((), description="changes of the levels over time")


class MotionSettings(Settings):
    """How the robot moves. Which keys a kind uses stands in brackets; a key that it doesn't use is refused."""

    kind: Literal["stand", "waypoints", "tracks", "tour", "match", "walk", "walk-in-place", "turn"] = Field(
        "stand", description="stand, waypoints, tracks, tour, match, walk, walk-in-place or turn"
    )
    pose: Place | None = Field(
        None, description="[stand, turn, walk-in-place] x, y (m), heading (degrees); none: from the seed"
    )
    waypoints: tuple[Place, ...] = Field((), description="[waypoints, walk] x, y (m), heading (degrees), in order")
    tracks: int = Field(5, ge=1, le=40, description="[tracks] straight tracks along the field, evenly spread")
    margin_m: float = Field(
        0.8, description="[stand, turn, tracks, tour, match, walk-in-place] distance kept to the outer lines (m)"
    )
    points: int = Field(20, ge=1, le=1000, description="[tour, turn] places drawn from the seed; headings of a turn")
    dwell_s: float = Field(0.0, ge=0, description="[waypoints, tracks, tour, walk, turn] time to stand at each (s)")
    speed_m_s: float = Field(1.2, gt=0, le=8, description="[moving] top speed (m/s)")
    acceleration_m_s2: float = Field(2.0, gt=0, le=20, description="[moving] acceleration (m/s²)")
    turn_rad_s: float = Field(2.0, gt=0, le=20, description="[moving] top turning rate (rad/s)")
    sway_deg: float = Field(
        2.8, ge=0, le=20, description="[walk, walk-in-place] amplitude of the roll at full speed (degrees)"
    )
    gait_hz: float = Field(1.5, gt=0, le=5, description="[walk, walk-in-place] strides per second")

    @model_validator(mode="after")
    def _only_what_is_used(self) -> MotionSettings:
        for key in sorted(self.model_fields_set - {"kind"}):
            used = (type(self).model_fields[key].description or "").split("]")[0].strip("[").split(", ")
            if self.kind not in used and not (used == ["moving"] and self.kind not in ("stand", "walk-in-place")):
                raise ValueError(f"a motion of kind '{self.kind}' does not use '{key}' (used by: {', '.join(used)})")
        return self


class MishapSettings(Settings):
    """What happens to the robot from outside."""

    kidnap_every_s: float = Field(0.0, ge=0, description="the robot is carried elsewhere this often (s); 0: never")
    covered_images: int = Field(3, ge=0, le=50, description="black images before the first one at the new place")
    kidnap_to: tuple[Place, ...] = Field((), description="places x, y (m), heading (degrees); none: from the seed")
    shove_every_s: float = Field(
        0.0, ge=0, description="mean time between collisions that shove the robot (s); 0: never"
    )
    shove_m: tuple[float, float] = Field((0.1, 0.3), description="range of the length of a shove (m)")
    shove_deg: float = Field(10.0, ge=0, le=180, description="standard deviation of the rotation of a shove (degrees)")


class OthersSettings(Settings):
    """Other robots and balls."""

    robots: int = Field(0, ge=0, le=30, description="number of other robots")
    moving: bool = Field(False, description="whether they drive about")
    speed_m_s: float = Field(2.0, gt=0, le=8, description="their top speed (m/s)")
    near_m: float = Field(
        0.0, ge=0, description="half of them play about the robot, on average this far from it; 0: none"
    )
    balls: int = Field(0, ge=0, le=5, description="number of balls")


class CalibrationSettings(Settings):
    """A calibration recording: what lies on the ground beside the robot and which inputs are written."""

    kind: Literal["none", "strip", "fixed-marks", "chessboard", "marked-points"] = Field(
        "none", description="none, strip, fixed-marks (four marks), chessboard or marked-points"
    )
    regions: bool = Field(False, description="whether regions.yaml with marked colours is written")


class Scenario(Settings):
    """One run: field, world, robot, camera, and the seed of everything random in it."""

    name: str = Field("", description="name of the run; of a file without one, the file's")
    description: str = Field("", description="one sentence for sequence.yaml")
    seed: int = Field(1, ge=0, description="of everything random")
    seconds: float = Field(20.0, gt=0, le=86400, description="length of the run (s)")
    field: str = Field("msl-18x12", description="a preset of `touchline fields` or a field.yaml")
    clutter: bool = Field(True, description="whether things stand around the field")
    camera: CameraSettings = CameraSettings()
    light: LightSettings = LightSettings()
    motion: MotionSettings = MotionSettings()
    mishaps: MishapSettings = MishapSettings()
    others: OthersSettings = OthersSettings()
    sensors: SensorSettings = SensorSettings()
    calibration: CalibrationSettings = CalibrationSettings()

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        if self.motion.kind == "walk" and len(self.motion.waypoints) == 1:
            raise ValueError("a walk needs two target areas or more in motion.waypoints")
        if self.motion.kind == "waypoints" and not self.motion.waypoints:
            raise ValueError("motion.waypoints is empty; list x, y (m) and heading (degrees) of each")
        if self.mishaps.kidnap_every_s > 0.0:
            hidden_s = (self.mishaps.covered_images + 2) / self.camera.rate_hz
            if self.mishaps.kidnap_every_s <= hidden_s:
                raise ValueError(f"mishaps.kidnap_every_s is no longer than the {hidden_s:g} s that each kidnap takes")
        return self

    def streams(self) -> dict[str, np.random.Generator]:
        """Independent random generators by purpose, all from the seed."""
        names = ("world", "motion", "others", "sensors", "camera", "observation", "delays")
        children = np.random.SeedSequence(self.seed).spawn(len(names))
        return {name: np.random.default_rng(child) for name, child in zip(names, children, strict=True)}


def scenario_names() -> list[str]:
    """The scenarios that come with Touchline."""
    return sorted(path.stem for path in SCENARIO_FOLDER.glob("*.yaml"))


def open_scenario(name_or_path: str | Path, seed: int | None = None, seconds: float | None = None) -> Scenario:
    """A scenario by name or from a file; `seed` and `seconds` replace the file's.

    Raises InputError in one message for an unknown name and for anything wrong in the file.
    """
    path = _scenario_file(str(name_or_path))
    changes = [f"{key}={value}" for key, value in (("seed", seed), ("seconds", seconds)) if value is not None]
    scenario = load_settings(Scenario, path, changes)
    return scenario if scenario.name else scenario.model_copy(update={"name": path.stem})


def _scenario_file(name: str) -> Path:
    if name in scenario_names():
        return SCENARIO_FOLDER / f"{name}.yaml"
    path = Path(name)
    if path.is_file():
        return path
    if path.suffix.lower() in (".yaml", ".yml") or path.parent != Path():
        raise InputError(f"{name}: there is no such scenario file")
    near = difflib.get_close_matches(name, scenario_names(), n=1, cutoff=0.5)
    hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(scenario_names())}"
    raise InputError(f"scenario '{name}' is unknown; {hint} A file of your own ends in .yaml")
