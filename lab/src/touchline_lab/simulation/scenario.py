"""A scenario: everything that makes a run, as a YAML file. Whatever is random in it comes from its seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from touchline.config import Settings, load_settings, merged
from touchline.errors import InputError
from touchline.files.yaml_text import read_yaml_mapping
from touchline.messages import did_you_mean
from touchline_lab.simulation.robot.sensors import Range, SensorSettings

SCENARIO_FOLDER = Path(__file__).parent / "scenarios"
AS_BUILT = Path(__file__).parent / "as_built.yaml"
Place = tuple[float, float, float]
Level = Annotated[float, Field(ge=0, le=100)]
_Tilt = Annotated[float, Field(ge=-10, le=10)]
_Shift = Annotated[float, Field(ge=-10, le=10)]


def _is_set(settings: Settings, key: str) -> bool:
    """Whether a key was given, and not just as the default value."""
    default = type(settings).model_fields[key].get_default(call_default_factory=True)
    return key in settings.model_fields_set and getattr(settings, key) != default


class MirrorSettings(Settings):
    """The mirror of an omnidirectional camera and how well it is built. Tilt about, shift along x and y (base)."""

    profile: Literal["combined", "hyperbolic", "horizontally-isometric", "vertically-isometric", "recorded"] = Field(
        "combined",
        description="shape: combined is the papers' of three parts; recorded is that of the public recordings",
    )
    metres_per_px: float = Field(0.045, ge=0.005, le=0.5, description="[horizontally-isometric] ground per pixel (m)")
    horizon_px: float = Field(210.0, gt=0, le=2000, description="[hyperbolic] pixel radius of the horizon")
    tilt_deg: tuple[_Tilt, _Tilt] = Field((0.0, 0.0), description="lean of the mirror about its apex (degrees)")
    shift_mm: tuple[_Shift, _Shift] = Field((0.0, 0.0), description="displacement of the mirror (mm)")
    tilt_spread_deg: float = Field(
        0.0, ge=0, le=3, description="standard deviation of a further lean about x and y, from the seed (degrees)"
    )
    shift_spread_mm: float = Field(
        0.0, ge=0, le=3, description="standard deviation of a further displacement along x and y, from the seed (mm)"
    )
    vibration_deg: float = Field(
        0.0, ge=0, le=2, description="standard deviation of its lean about x and y while the robot drives (degrees)"
    )
    vibration_s: float = Field(0.05, gt=0, le=10, description="time after which that lean is another (s)")
    range_spread: float = Field(
        0.0, ge=0, le=0.1, description="[design, calibrate-range] standard deviation of the ranges' relative error"
    )

    @model_validator(mode="after")
    def _only_what_is_used(self) -> MirrorSettings:
        for key, profile in (("metres_per_px", "horizontally-isometric"), ("horizon_px", "hyperbolic")):
            if self.profile != profile and _is_set(self, key):
                raise ValueError(f"a mirror of the profile '{self.profile}' does not use '{key}' (used by: {profile})")
        return self


class CameraSettings(Settings):
    """The camera, its exposure and what hides its view."""

    kind: Literal["omni", "pinhole", "fisheye"] = Field(
        "omni", description="omni (mirror), pinhole or fisheye (a humanoid's head)"
    )
    rate_hz: float = Field(10.0, gt=0, le=100, description="images per second")
    exposure_ms: float = Field(12.0, gt=0, le=200, description="exposure time of the first images (ms)")
    gain: float = Field(1.7, gt=0, le=100, description="linear gain of the first images")
    mirror: MirrorSettings = MirrorSettings()
    file: str | None = Field(None, description="a camera.yaml whose camera is simulated; none: the mirror or lens here")
    motion_blur: bool = Field(False, description="whether the motion during the exposure blurs the image")
    rolling_shutter_ms: float = Field(0.0, ge=0, le=200, description="from the first row's exposure to the last's (ms)")
    vignetting: float = Field(0.0, ge=0, le=1, description="by how much of its light the image's corners are darker")
    bloom: float = Field(0.0, ge=0, le=0.5, description="part of the light that the lens scatters around bright spots")
    known_from: Literal["design", "calibrate-mirror", "calibrate-range"] = Field(
        "design", description="what camera.yaml tells: the mirror as designed, or as a calibration has found it"
    )
    line_noise_px: float | None = Field(
        None, ge=0, le=5, description="[points] deviation of line points at right angles to the line; none: as rendered"
    )
    black_sectors_deg: tuple[tuple[float, float], ...] = Field(
        (), description="directions [from, to] in the base frame, counter-clockwise, that are black in every image"
    )
    delay_s: float = Field(0.0, ge=0, le=1, description="mean time from an image's stamp to its arrival (s)")
    delay_spread_s: float = Field(0.0, ge=0, le=1, description="half width of the even distribution of that time (s)")
    stamped: Literal["taken", "arrived"] = Field("taken", description="what an image's stamp tells: when it was ...")

    @model_validator(mode="after")
    def _fits_together(self) -> CameraSettings:
        for key in ("mirror", "known_from"):
            if _is_set(self, key) and (self.kind != "omni" or self.file is not None):
                reason = f"a {self.kind} camera has none" if self.kind != "omni" else "camera.file tells it already"
                raise ValueError(f"'{key}' is not used: {reason if key == 'mirror' else 'it is about a mirror'}")
        if self.delay_spread_s > self.delay_s:
            raise ValueError(f"delay_spread_s ({self.delay_spread_s:g}) is more than delay_s ({self.delay_s:g})")
        return self


class LightSettings(Settings):
    """What lights the hall, as levels of `world.lights`; changes add rows {time_s, lamps, sun, ...}."""

    class Change(Settings):
        """From time_s on, within fade_s, these levels (none: as before). row: this row of lamps alone."""

        time_s: float = Field(0.0, ge=0)
        lamps: Level | None = None
        row: int | None = Field(None, ge=0)
        sun: Level | None = None
        ambient: Level | None = None
        fade_s: float = Field(0.0, ge=0)

    lamps: Level = Field(1.0, description="level of the ceiling's lamps")
    ambient: Level = Field(0.35, description="level of the daylight everywhere")
    sun: Level = Field(0.0, description="level of direct sun where it falls through a window")
    sun_elevation_deg: float = Field(35.0, gt=0, lt=90, description="height of the sun")
    sun_azimuth_deg: float = Field(70.0, description="direction towards the sun, field frame, from x to y")
    windows: int = Field(0, ge=0, le=12, description="windows in the northern wall, evenly spread")
    tints: tuple[tuple[Level, Level, Level], ...] = Field(
        (), description="red, green, blue of the lamps' light, row of lamps by row in turn; none: white"
    )
    changes: tuple[Change, ...] = Field((), description="changes of the levels over time")

    @model_validator(mode="after")
    def _fits_together(self) -> LightSettings:
        brightest = max([self.sun, *(change.sun or 0.0 for change in self.changes)])
        if brightest > 0.0 and self.windows == 0:
            raise ValueError("the sun shines through windows, and there are none; set light.windows")
        for change in self.changes:
            if change.row is not None and change.lamps is None:
                raise ValueError(f"the change at {change.time_s:g} s names a row of lamps but not its level, lamps")
        return self


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
    sway_deg: float = Field(2.8, ge=0, le=20, description="[walk, walk-in-place] amplitude of the roll (degrees)")
    gait_hz: float = Field(1.5, gt=0, le=5, description="[walk, walk-in-place] strides per second")

    @model_validator(mode="after")
    def _only_what_is_used(self) -> MotionSettings:
        for key in sorted(self.model_fields_set - {"kind"}):
            if not _is_set(self, key):
                continue
            used = (type(self).model_fields[key].description or "").split("]")[0].strip("[").split(", ")
            if self.kind not in used and not (used == ["moving"] and self.kind not in ("stand", "walk-in-place")):
                raise ValueError(f"a motion of kind '{self.kind}' does not use '{key}' (used by: {', '.join(used)})")
        return self


class DisturbanceSettings(Settings):
    """What happens to the robot from outside."""

    kidnap_every_s: float = Field(0.0, ge=0, description="the robot is carried elsewhere this often (s); 0: never")
    covered_images: int = Field(3, ge=0, le=50, description="black images before the first one at the new place")
    kidnap_to: tuple[Place, ...] = Field((), description="places x, y (m), heading (degrees); none: from the seed")
    shove_every_s: float = Field(0.0, ge=0, description="mean time between shoves by collisions (s); 0: never")
    shove_m: Range = Field((0.1, 0.3), description="range of the length of a shove (m)")
    shove_deg: float = Field(10.0, ge=0, le=180, description="standard deviation of the rotation of a shove (degrees)")


class GameSettings(Settings):
    """A match with a referee: penalties, pick-ups, falls, half-time, in which the robot stays where it is put."""

    half_s: float = Field(0.0, ge=0, description="half-time comes after so long (s); 0: no match")
    every_s: float = Field(60.0, gt=0, description="mean time between what happens to the robot (s)")
    missed_ready: tuple[bool, bool] = Field((False, False), description="whether a half's READY is not received")


class OthersSettings(Settings):
    """Other robots and balls."""

    robots: int = Field(0, ge=0, le=30, description="number of other robots")
    moving: bool = Field(False, description="whether they drive about")
    speed_m_s: float = Field(2.0, gt=0, le=8, description="their top speed (m/s)")
    near_m: float = Field(
        0.0, ge=0, le=10, description="half of them play about the robot, on average this far from it; 0: none"
    )
    balls: int = Field(0, ge=0, le=5, description="number of balls")
    people: int = Field(0, ge=0, le=6, description="people who stay beside the robot: legs and shoes close to it")
    people_m: float = Field(0.9, ge=0.6, le=5, description="mean distance (m) that they keep")

    @model_validator(mode="after")
    def _fits_together(self) -> OthersSettings:
        if self.near_m > 0.0 and not self.moving:
            raise ValueError("near_m needs moving: true; robots that stand keep out of the way")
        return self


class HallSettings(Settings):
    """What real halls have: worn lines, cables, and a carpet that ends right behind the lines."""

    scuffed: float = Field(0.0, ge=0, le=1, description="how much of the lines' paint is rubbed off, in patches")
    dirt: float = Field(0.0, ge=0, le=1, description="how dark dirt makes the lines, in stretches of a metre")
    cables: int = Field(0, ge=0, le=20, description="cables that lie on the carpet, from its edge inwards")
    stands: bool = Field(False, description="whether white stands with people rise behind the field's far sides")
    beside: bool = Field(False, description="whether another field lies beside this one, with its white lines")
    carpet_border_m: float | None = Field(
        None, ge=0.05, le=5, description="the carpet ends so far outside the lines (m); none: as the field says"
    )
    gloss: float = Field(0.0, ge=0, le=1, description="share of the light that the carpet mirrors at grazing angles")
    dark_floor: bool = Field(False, description="whether the floor beside the carpet is dark instead of grey")


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
    ideal: bool = Field(
        False, description="whether the robot is as designed; else it is as built: `AS_BUILT` stands behind the file"
    )
    seconds: float = Field(20.0, gt=0, le=86400, description="length of the run (s)")
    field: str = Field("msl-18x12", description="a preset of `touchline fields` or a field.yaml")
    clutter: bool = Field(True, description="whether things stand around the field")
    camera: CameraSettings = CameraSettings()
    light: LightSettings = LightSettings()
    motion: MotionSettings = MotionSettings()
    disturbances: DisturbanceSettings = DisturbanceSettings()
    game: GameSettings = GameSettings()
    others: OthersSettings = OthersSettings()
    hall: HallSettings = HallSettings()
    sensors: SensorSettings = SensorSettings()
    calibration: CalibrationSettings = CalibrationSettings()

    @model_validator(mode="before")
    @classmethod
    def _fill_in_what_is_behind(cls, values: Any) -> Any:
        """Put in what isn't named: of a robot as built, or what the scenario says of an ideal one under `ideally`."""
        if not isinstance(values, dict):
            return values
        named = {key: value for key, value in values.items() if key != "ideally"}
        return merged(_group(values, "ideally") if named.get("ideal") is True else _as_built(named), named)

    @field_validator("name")
    @classmethod
    def _is_a_file_name(cls, name: str) -> str:
        if name != Path(name).name or name in ("..", "."):
            raise ValueError(f"{name!r} is no name of a folder; leave out slashes")
        return name

    @model_validator(mode="after")
    def _fits_together(self) -> Scenario:
        if self.motion.kind == "walk" and len(self.motion.waypoints) == 1:
            raise ValueError("a walk needs two target areas or more in motion.waypoints")
        if self.motion.kind == "waypoints" and not self.motion.waypoints:
            raise ValueError("motion.waypoints is empty; list x, y (m) and heading (degrees) of each")
        if self.disturbances.kidnap_every_s > 0.0:
            hidden_s = (self.disturbances.covered_images + 2) / self.camera.rate_hz
            if self.disturbances.kidnap_every_s <= hidden_s:
                what = f"no longer than the {hidden_s:g} s that each kidnap takes"
                raise ValueError(f"disturbances.kidnap_every_s is {what}")
        return self

    def streams(self) -> dict[str, np.random.Generator]:
        """Independent random generators by purpose, all from the seed."""
        names = ("world", "motion", "others", "sensors", "camera", "observation", "delays")
        children = np.random.SeedSequence(self.seed).spawn(len(names))
        return {name: np.random.default_rng(child) for name, child in zip(names, children, strict=True)}


@cache
def _as_built_file() -> Mapping[str, Any]:
    return read_yaml_mapping(AS_BUILT)


def _as_built(values: Mapping[str, Any]) -> dict[str, Any]:
    """What stands behind a scenario, a tree of what it names; nothing behind a humanoid's and behind a calibration."""
    camera, calibration, others = (_group(values, key) for key in ("camera", "calibration", "others"))
    if camera.get("kind", "omni") != "omni" or calibration.get("kind", "none") != "none":
        return {}
    behind = deepcopy(dict(_as_built_file()))
    unwanted = ["delay_spread_s"] * ("delay_s" in camera) + ["mirror", "known_from"] * ("file" in camera)
    for key in unwanted:
        del behind["camera"][key]
    if "robots" in others:  # who names them says, too, whether they move
        del behind["others"]
    if "light" in values:  # lamps and windows are those of a hall that is no larger than it has to be
        behind["hall"].update(stands=False, beside=False)
    return behind


def _group(values: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    group = values.get(key)
    return group if isinstance(group, dict) else {}


def scenario_names() -> list[str]:
    """The scenarios that come with Touchline."""
    return sorted(path.stem for path in SCENARIO_FOLDER.glob("*.yaml"))


def open_scenario(
    name_or_path: str | Path, seed: int | None = None, seconds: float | None = None, changes: Sequence[str] = ()
) -> Scenario:
    """A scenario by name, from a file, or from a simulated recording, whose sequence.yaml holds it.

    `seed` and `seconds` replace the file's, and so do changes, each as `others.robots=3`. Other files named in it are
    looked for beside it, then where we are.
    Raises InputError in one message for an unknown name and for anything wrong in the file.
    """
    path = _scenario_file(str(name_or_path))
    tree = read_yaml_mapping(path)
    if not tree:
        raise InputError(f"{path}: is empty; name at least the kind of motion, for example motion: {{kind: match}}")
    section = "simulation" if "format" in tree else None  # sequence.yaml
    if section is not None and not isinstance(tree.get(section), dict):
        raise InputError(f"{path}: tells no scenario; only recordings that were simulated hold theirs")
    given = [f"{key}={value}" for key, value in (("seed", seed), ("seconds", seconds)) if value is not None]
    if section is not None and "ideal" not in tree[section]:
        given.append("ideal=true")  # written before robots were as built
    scenario = _with_paths_from(path.parent, load_settings(Scenario, path, [*changes, *given], section))
    return scenario if scenario.name else scenario.model_copy(update={"name": path.stem})


def _with_paths_from(folder: Path, scenario: Scenario) -> Scenario:
    """A scenario whose field and camera files are found beside its own file, if they are there."""
    camera = scenario.camera
    if camera.file is not None and (folder / camera.file).is_file():
        camera = camera.model_copy(update={"file": str(folder / camera.file)})
    beside = Path(scenario.field).suffix in (".yaml", ".yml") and (folder / scenario.field).is_file()
    field = str(folder / scenario.field) if beside else scenario.field
    return scenario.model_copy(update={"camera": camera, "field": field})


def _scenario_file(name: str) -> Path:
    if name in scenario_names():
        return SCENARIO_FOLDER / f"{name}.yaml"
    path = Path(name)
    if path.is_file():
        return path
    if (path / "sequence.yaml").is_file():
        return path / "sequence.yaml"
    if path.suffix.lower() in (".yaml", ".yml") or path.parent != Path():
        raise InputError(f"{name}: there is no such scenario file")
    hint = did_you_mean(name, scenario_names())
    stop = "" if hint.endswith("?") else "."
    raise InputError(f"scenario '{name}' is unknown; {hint}{stop} A file of your own ends in .yaml")
