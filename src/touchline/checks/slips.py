"""Slips that spoil everything: times, angles and lengths in other units, images without colour.

Told from the first minute of each table and a few images, so that a run can say so before it starts.
"""

import math
from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np

from touchline.camera import is_perspective
from touchline.checks.findings import Finding, Severity
from touchline.errors import InputError
from touchline.files.yaml_text import read_yaml_mapping
from touchline.geometry import FloatArray
from touchline.messages import length_unit
from touchline.perception.covered import is_covered
from touchline.sources.camera_poses import CAMERA_POSES
from touchline.sources.description import CAMERA
from touchline.sources.folder import IMAGE_LIST, SENSOR_COLUMNS, Recording
from touchline.sources.observations import OBSERVATIONS
from touchline.sources.units import TIME_UNITS, first_rows, time_unit
from touchline.systems import RobotSetup
from touchline.types import ProblemCode

_SENSOR_STEP_S = (2.0e-3, 2.0)  # shortest and longest distance of two samples
_IMAGE_STEP_S = (1.0e-2, 10.0)  # of two images; slower ones are rather a time lapse than milliseconds
_ANGLES = {"gz": "imu.csv", "theta": "odometry.csv", "yaw": "imu.csv"}
_MAX_RAD = 6.4  # of an angle that is counted within one turn
_MAX_DEG = 361.0
_FASTEST_RAD_S = 35.0  # a spin that no robot survives, and a slow turn in °/s
_HARDLY_RAD = 0.02
_TURNED_RAD = 0.3  # least turn that tells units of angles apart, 57 to 1
_ALIKE = 3.0  # how much further one sensor may say that the robot turns: slip, noise
_DEGREES = (20.0, 160.0)
_FASTEST_M_S = 15.0
_TRAVELLED_M = 0.3
_MAX_FOOT_M = 5.0  # where a mirror sees the ground beside the robot: 0.3 to 1 m
_MAX_M = 5.0  # of a camera on a robot
_CAMERA_ANGLES = ("roll", "pitch", "yaw")
_LOOKED_AT = 5
_GREY_LEVELS = 1.0  # mean difference of the channels; carpet in the dimmest light has 4
_ONE_WINDOW_S = 1.0


class _Head(NamedTuple):
    """The beginning of a table: times (N,) in s, values by column (N,), and the unit that its times are in."""

    times_s: FloatArray
    values: dict[str, FloatArray]
    unit: str | None


def find_slips(recording: Recording) -> list[Finding]:
    """What is in another unit than the format says, and images without colour."""
    heads = {name: head for name in SENSOR_COLUMNS if (head := _head(recording, name)) is not None}
    of_tables = (_times(recording, heads), _angles(heads), _leans(heads), _lengths(heads))
    return [*chain(*of_tables, *(find(recording) for find in (_points, _ranges, _mounts, _colours)))]


def _slip(code: str, where: str, what: str, advice: str) -> Finding:
    return Finding("units", Severity.ERROR, where, what, advice, code)


def _head(recording: Recording, name: str) -> _Head | None:
    table = recording.table(name)
    if table is None:
        return None
    rows = first_rows(table, ("t", *SENSOR_COLUMNS[name]))
    rows = rows[np.isfinite(rows[:, 0])]
    unit = time_unit(rows[:, 0], *_SENSOR_STEP_S)
    columns = dict(zip(SENSOR_COLUMNS[name], rows[:, 1:].T, strict=True))
    return _Head(rows[:, 0] / TIME_UNITS.get(unit or "", 1.0), columns, unit)


def _times(recording: Recording, heads: dict[str, _Head]) -> Iterator[Finding]:
    units = {name: head.unit for name, head in heads.items()}
    frames = recording.table(recording.frame_list)
    if frames is not None:
        times = np.unique(first_rows(frames, ("t",))[:, 0])
        limits = _IMAGE_STEP_S
        if recording.stated_rate_hz is not None:
            limits = (0.2 / recording.stated_rate_hz, 5.0 / recording.stated_rate_hz)
        units = {recording.frame_list: time_unit(times, *limits), **units}
    for unit in TIME_UNITS:
        if files := [name for name, own in units.items() if own == unit]:
            yield _slip(
                ProblemCode.TIME_UNIT, ", ".join(files), f"the times look like {unit}", "Column t is in seconds."
            )


def _angles(heads: dict[str, _Head]) -> Iterator[Finding]:
    """Angles that turn 57 times as far as those of other sensors, or reach beyond a turn but not beyond 360."""
    turned: dict[str, float] = {}
    sensors = [(name, file) for name, file in _ANGLES.items() if file in heads]
    for name, file in sensors:
        turned[name] = _turned(heads[file].times_s, heads[file].values[name], name == "gz")
    for name, file in sensors:
        largest = float(np.nanmax(np.abs(heads[file].values[name]), initial=0.0))
        if _in_degrees(name, turned, largest):
            turned[name] = math.radians(turned[name])  # as a witness for the others
            unit = "degrees per second; rates are in rad/s" if name == "gz" else "degrees; angles are in radians"
            what = f"column '{name}' reaches {largest:.3g}"
            yield _slip(ProblemCode.ANGLE_UNIT, file, what, f"It looks like {unit}.")


def _leans(heads: dict[str, _Head]) -> Iterator[Finding]:
    if "imu.csv" not in heads:
        return
    for name in ("roll", "pitch"):
        lean = np.abs(heads["imu.csv"].values[name])
        lean = lean[np.isfinite(lean)]
        if len(lean) and float(np.quantile(lean, 0.95)) > math.pi:
            what = f"column '{name}' reaches {lean.max():.3g}"
            yield _slip(ProblemCode.ANGLE_UNIT, "imu.csv", what, "It looks like degrees; angles are in radians.")


def _in_degrees(name: str, turned: dict[str, float], largest: float) -> bool:
    """turned: how far each sensor turns, in its own unit. largest: the sensor's own largest number."""

    def as_degrees_of(turn: float) -> bool:
        return _DEGREES[0] < turned[name] / turn < _DEGREES[1]

    others = [turn for key, turn in turned.items() if key != name and turn > _HARDLY_RAD]
    if turned[name] > _TURNED_RAD and others:
        if min(others) > _TURNED_RAD and as_degrees_of(min(others)):
            return True
        # hardly a turn at all, but two of three agree on it; a robot that is carried turns the compass alone
        if name == "gz" and len(others) > 1 and as_degrees_of(max(others)):
            return True
    if name == "gz":
        return largest > _FASTEST_RAD_S
    counts_turns = any(turned[name] / _ALIKE < turn < turned[name] * _ALIKE for turn in others)
    return _MAX_RAD < largest < _MAX_DEG and not counts_turns


def _turned(times_s: FloatArray, values: FloatArray, is_rate: bool) -> float:
    """How far an angle turns, or a rate does, from second to second, there and back."""
    known = np.isfinite(values)
    times_s, values = times_s[known], values[known]
    if len(values) < 2:
        return 0.0
    if is_rate:
        values = np.concatenate(([0.0], np.cumsum(values[1:] * np.diff(times_s))))
    else:
        values = np.unwrap(values, period=360.0 if np.abs(values).max() > _MAX_RAD else 2.0 * math.pi)
    return float(np.abs(np.diff(_each_second(times_s, values))).sum())


def _each_second(times_s: FloatArray, values: FloatArray) -> FloatArray:
    """Values (N,) at whole windows, the last one included."""
    wanted = np.append(np.arange(times_s[0], times_s[-1], _ONE_WINDOW_S), times_s[-1])
    return np.asarray(np.interp(wanted, times_s, values))


def _lengths(heads: dict[str, _Head]) -> Iterator[Finding]:
    """Ways that no robot drives, or a hundred or a thousand times as long as those of another sensor."""
    ways: dict[str, tuple[float, float]] = {}
    for file, (first, second) in (("odometry.csv", ("x", "y")), ("wheels.csv", ("a", "b"))):
        if file in heads:
            head = heads[file]
            known = np.isfinite(head.values[first]) & np.isfinite(head.values[second])
            times_s = head.times_s[known]
            if len(times_s) > 1 and times_s[-1] > times_s[0]:
                places = [_each_second(times_s, head.values[name][known]) for name in (first, second)]
                steps = np.hypot(*np.diff(places, axis=1))
                ways[file] = float(steps.sum()), float(steps.sum()) / float(times_s[-1] - times_s[0])
    for file, (way, speed) in ways.items():
        shorter = [other for key, (other, _) in ways.items() if key != file and other > _TRAVELLED_M]
        ratio = way / min(shorter) if shorter else 0.0
        unit = "millimetres" if 400.0 < ratio < 2500.0 else "centimetres" if 40.0 < ratio < 250.0 else ""
        if not unit and speed > _FASTEST_M_S:
            unit = "millimetres or centimetres"
        if unit:
            what = f"a way of {way:.3g} at {speed:.3g} a second"
            yield _slip(ProblemCode.LENGTH_UNIT, file, what, f"It looks like {unit}; metres are wanted.")


def _points(recording: Recording) -> Iterator[Finding]:
    table = recording.table(OBSERVATIONS)
    if table is None:
        return
    try:
        max_range_m = RobotSetup(recording.field).max_range_m
    except InputError:
        return  # the check of the field says so
    x, y = first_rows(table, ("x_m", "y_m")).T
    distances = np.hypot(x, y)
    distances = distances[np.isfinite(distances)]
    if len(distances) and (middle := float(np.median(distances))) > max_range_m:
        what = f"what was found lies {middle:.4g} m away (median), on a field on which nothing can be farther than "
        what += f"{max_range_m:.0f} m"
        unit = length_unit(float(np.quantile(distances, 0.9)), max_range_m)
        advice = f"It looks like {unit}; x_m and y_m are in metres."
        yield _slip(ProblemCode.LENGTH_UNIT, OBSERVATIONS, what, advice)


def _ranges(recording: Recording) -> Iterator[Finding]:
    if recording.camera_kind != "omni" or recording.camera_file is None:
        return
    from touchline.camera import OmniCamera

    try:
        camera = recording.camera
    except InputError:
        return  # the check of the camera says so
    if isinstance(camera, OmniCamera):
        at_foot = float(np.interp(camera.inner_radius_px, camera.radius_px, camera.range_m.mean(axis=0)))
        if at_foot > _MAX_FOOT_M:
            what = f"range_table has {at_foot:.4g} m at the robot's foot (inner_radius_px)"
            unit = length_unit(at_foot, 0.3 * _MAX_FOOT_M)
            yield _slip(ProblemCode.LENGTH_UNIT, CAMERA, what, f"It looks like {unit}; range_m is in metres.")


def _mounts(recording: Recording) -> Iterator[Finding]:
    """Where a perspective camera is: `mount` of camera.yaml, and camera_pose.csv."""
    if not is_perspective(recording.camera_kind):
        return
    places: list[tuple[str, str, float, float]] = []
    if recording.camera_file is not None:
        try:
            tree = read_yaml_mapping(recording.camera_file)
            mount = {key: float(value) for key, value in tree["mount"].items()}
            places.append((CAMERA, "mount", abs(mount["z"]), max(abs(mount[angle]) for angle in _CAMERA_ANGLES)))
        except (InputError, KeyError, TypeError, ValueError, AttributeError):
            pass  # the check of the camera says so
    table = recording.table(CAMERA_POSES)
    if table is not None:
        rows = first_rows(table, ("z", *_CAMERA_ANGLES))
        if len(rows := np.abs(rows[np.isfinite(rows).all(axis=1)])):
            places.append((CAMERA_POSES, "table", float(np.median(rows[:, 0])), float(rows[:, 1:].max())))
    for file, name, height_m, largest_rad in places:
        if height_m > _MAX_M:
            unit = length_unit(height_m, _MAX_M)
            what = f"the {name} has the camera {height_m:.4g} m high"
            yield _slip(ProblemCode.LENGTH_UNIT, file, what, f"It looks like {unit}; z is in metres.")
        if largest_rad > _MAX_RAD:
            what = f"the {name}'s roll, pitch or yaw reaches {largest_rad:.3g}"
            yield _slip(ProblemCode.ANGLE_UNIT, file, what, "It looks like degrees; angles are in radians.")


def _colours(recording: Recording) -> Iterator[Finding]:
    """Images in shades of grey: carpet and lines are told apart by colour."""
    if not recording.has_images or recording.has_observations:
        return
    indices = np.unique(np.linspace(0, len(recording) - 1, _LOOKED_AT).astype(int)).tolist()
    images = [image for index in indices if (image := recording.image(index)) is not None and not is_covered(image)]
    if images and all(float(np.ptp(image[::4, ::4], axis=2).mean()) < _GREY_LEVELS for image in images):
        advice = "The carpet is recognised by its green: record in colour."
        yield _slip(ProblemCode.IMAGES_GREY, IMAGE_LIST, "the images are grey, their three channels are equal", advice)
