"""sequence.yaml and camera.yaml: what has to be right before a recording can be opened at all."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from touchline.errors import InputError
from touchline.files.opened import OwnFolder
from touchline.files.yaml_text import read_yaml_mapping
from touchline.messages import did_you_mean, shown
from touchline.sources.problems import ProblemKind, ProblemLog

FORMAT = 1
NO_CAMERA = "none"
SEQUENCE, CAMERA, FIELD = "sequence.yaml", "camera.yaml", "field.yaml"
_MAX_NAME = 200


@dataclass(frozen=True, slots=True)
class Description:
    """The checked part of sequence.yaml. image_size: width, height of camera.yaml, where it has them.

    camera_model: what camera.yaml holds, of which whoever needs the camera learns what is wrong.
    rate_hz: None if the file names none. field_source: a field.yaml or the name of a preset.
    """

    name: str
    sequence: Mapping[str, Any]
    camera_kind: str
    camera_file: Path | None
    camera_model: dict[str, Any] | None
    image_size: tuple[int, int] | None
    field_source: str | Path
    rate_hz: float | None
    events: tuple[Mapping[str, Any], ...]
    linear: bool


def read_description(folder: OwnFolder, log: ProblemLog) -> Description:
    """Read and check; InputError for what no reader could do without, the log for the rest."""
    path = folder.file(SEQUENCE)
    if not path.exists():
        what = f"is missing, so {folder.path} is not a recording; it has to name format, field and camera"
        raise InputError(f"{path}: {what}")
    sequence = read_yaml_mapping(path)
    _check_format(path, sequence.get("format"))
    camera_file = folder.file(CAMERA)
    there = camera_file.exists() and sequence.get("camera") != NO_CAMERA
    model = read_yaml_mapping(camera_file) if there else None
    kind = _camera_kind(path, sequence.get("camera"), camera_file, model)
    sensor, name = sequence.get("sensor"), str(sequence.get("name", folder.path.resolve().name))
    return Description(
        name="".join(each if each.isprintable() else " " for each in name[:_MAX_NAME]),  # what a terminal would obey
        sequence=sequence,
        camera_kind=kind,
        camera_file=None if model is None else camera_file,
        camera_model=model,
        image_size=None if model is None else _image_size(model),
        field_source=_field_source(folder, path, sequence.get("field")),
        rate_hz=_rate(sequence.get("rate_hz"), log),
        events=_events(sequence.get("events"), log),
        linear=isinstance(sensor, dict) and sensor.get("linear_png") is True,
    )


def _check_format(path: Path, number: object) -> None:
    if number is None:
        raise InputError(f"{path}: key 'format' is missing; write 'format: {FORMAT}'")
    if number != FORMAT or isinstance(number, bool):
        raise InputError(f"{path}: format {shown(number)} is not known, this version reads format {FORMAT}")


def _camera_kind(path: Path, kind: object, camera_file: Path, model: Mapping[str, Any] | None) -> str:
    from touchline.camera import CAMERAS

    known = (*CAMERAS, NO_CAMERA)
    if kind is None:
        raise InputError(f"{path}: key 'camera' is missing; one of {', '.join(known)}")
    if kind not in known:
        raise InputError(f"{path}: camera '{kind!s:.60}' is not known; {did_you_mean(str(kind), known)}")
    found = None if model is None else model.get("model")
    if found in known and found != kind:  # the rest is reported where the camera is needed
        raise InputError(f"{camera_file}: describes a camera of model '{found}', but {path} says camera '{kind}'")
    return str(kind)


def _image_size(model: Mapping[str, Any]) -> tuple[int, int] | None:
    """Width and height; None where the file has no sensible ones, of which whoever needs the camera is told."""
    size = (model.get("width"), model.get("height"))
    width, height = (s if isinstance(s, int) and not isinstance(s, bool) and s > 0 else None for s in size)
    return None if width is None or height is None else (width, height)


def _field_source(folder: OwnFolder, path: Path, name: object) -> str | Path:
    if folder.file(FIELD).exists():
        return folder.file(FIELD)
    from touchline.field import preset_names

    known = list(preset_names())
    if name is None:
        raise InputError(f"{path}: key 'field' is missing and there is no {FIELD}; one of {', '.join(known)}")
    if name not in known:
        raise InputError(
            f"{path}: field '{name!s:.60}' is not known and there is no {FIELD} that describes it; "
            f"{did_you_mean(str(name), known)}"
        )
    return str(name)


def finite_number(value: object) -> float | None:
    """A finite number of a YAML file as float; None for anything else."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def wheel_directions_rad(sequence: Mapping[str, Any]) -> tuple[float, float] | None:
    """Rolling directions of the measuring wheels a and b in the robot frame; None where sequence.yaml names none."""
    wheels = sequence.get("wheels")
    if not isinstance(wheels, dict):
        return None
    a_rad, b_rad = finite_number(wheels.get("a_dir_rad")), finite_number(wheels.get("b_dir_rad"))
    return None if a_rad is None or b_rad is None else (a_rad, b_rad)


def _rate(rate: object, log: ProblemLog) -> float | None:
    number = finite_number(rate)
    if number is not None and number > 0.0:
        return number
    what = "key 'rate_hz' is missing" if rate is None else f"rate_hz {shown(rate)} is not a positive number"
    log.add(ProblemKind.SEQUENCE, SEQUENCE, f"{what}; the rate is taken from the image times")
    return None


def _events(events: object, log: ProblemLog) -> tuple[Mapping[str, Any], ...]:
    if events is None:
        return ()
    if not isinstance(events, list):
        log.add(ProblemKind.SEQUENCE, SEQUENCE, f"events: expected a list, found {shown(events)}; they are left out")
        return ()
    good = []
    for number, event in enumerate(events, start=1):
        time_s = event.get("t") if isinstance(event, dict) else None
        if finite_number(time_s) is not None and "kind" in event:
            good.append(event)
        else:
            what = f"events: number {number} needs t (s) and kind, found {shown(event)}; it is left out"
            log.add(ProblemKind.SEQUENCE, SEQUENCE, what)
    return tuple(good)
