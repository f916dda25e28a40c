"""Pairs of pixel radius and ground range, marked by hand (marks.csv) or found on the calibration strip."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from touchline.calibration.marks import MARKS, read_marks
from touchline.errors import InputError
from touchline.files.yaml_text import read_yaml_mapping
from touchline.geometry import FloatArray, wrap_angles
from touchline.published.strip.directions import most_common
from touchline.published.strip.mirror import calibrate_mirror
from touchline.sources import Recording
from touchline.sources.description import finite_number

_MIN_M, _MAX_M = 1e-3, 1e3  # of what may be marked
_WRONG_BEARING_RAD = math.radians(8.0)  # of most marks: handedness or mounting angle is another
# what a handedness must explain worse than the other one (mean deviation of the bearings), to be the wrong one: marks
# in one direction, or in two opposite ones, are explained by both
_TOLD_RAD, _TOLD_FACTOR = math.radians(4.0), 3.0


@dataclass(frozen=True, slots=True)
class Optics:
    """What camera.yaml says beside the ranges: image size, centre (px), orientation, and where robot and mirror end."""

    width: int
    height: int
    center: tuple[float, float]
    handedness: int
    mount_yaw_rad: float
    inner_px: float
    outer_px: float = math.inf


@dataclass(frozen=True, eq=False, slots=True)
class RangePairs:
    """radius_px, range_m, angle_rad: (N,) about the optics' centre, angle in the image (atan2(v, u)).

    places: what each pair is called in messages. origin: where they come from, in words. files: the image of each,
    in the folder; none where there are no images.
    """

    radius_px: FloatArray
    range_m: FloatArray
    angle_rad: FloatArray
    places: tuple[str, ...]
    origin: str
    optics: Optics
    folder: Path = Path()
    files: tuple[str, ...] = ()


def recording_pairs(recording: Recording, skip_unusable: bool = False, handedness: int | None = None) -> RangePairs:
    """From a recording's marks.csv; without one from the edges of its calibration strip.

    handedness: of the marks' camera, as of `marked_pairs`. Raises InputError if it has neither, and for whatever is
    wrong with them.
    """
    if (recording.folder / MARKS).exists():
        camera_file = recording.camera_file or recording.file("camera.yaml")
        return marked_pairs(recording.file(MARKS), camera_file, handedness)
    if "patch_edges_m" in recording.sequence:
        return strip_pairs(recording, skip_unusable)
    raise InputError(
        f"{recording.folder}: holds no pairs of pixel and distance: neither {MARKS} (file,name,u,v,x_m,y_m) nor, in "
        "sequence.yaml, the 'patch_edges_m' of a calibration strip"
    )


def strip_pairs(recording: Recording, skip_unusable: bool = False) -> RangePairs:
    """From the edges of the strip in every image; centre and orientation come from the images, too."""
    found = calibrate_mirror(recording, skip_unusable)
    camera, edges = found.camera, found.strip.edges_m
    optics = Optics(
        camera.width, camera.height, camera.center, camera.handedness, camera.mount_yaw_rad, camera.inner_radius_px
    )
    offsets = np.concatenate([sighting.pixels for sighting in found.sightings]) - camera.center
    places = [f"{recording.folder / s.name}, edge at {edge:g} m" for s in found.sightings for edge in edges]
    files = [s.name for s in found.sightings for _ in edges]
    seen = np.isfinite(offsets[:, 0])  # a first or last edge may be hidden
    return RangePairs(
        np.hypot(*offsets[seen].T),
        np.tile(edges, len(found.sightings))[seen],
        np.arctan2(offsets[seen, 1], offsets[seen, 0]),
        tuple(place for place, there in zip(places, seen, strict=True) if there),
        f"{len(edges)} edges in {len(found.sightings)} images of {recording.name}",
        optics,
        recording.folder,
        tuple(file for file, there in zip(files, seen, strict=True) if there),
    )


def marked_pairs(file: Path, camera_file: Path, handedness: int | None = None) -> RangePairs:
    """From marks.csv: `file,name,u,v,x_m,y_m`. Marks of unknown place (empty x_m, y_m) are left out.

    camera_file: of the camera that saw them; its range table isn't read and may be missing. handedness: 1, -1, or None
    for that of camera.yaml or, if it has none, of the marks. Raises InputError with file and line for a row that can't
    be read, for marks outside of the image or at no distance, if their bearings contradict it, and if nothing tells
    the handedness.
    """
    marks = read_marks(file)
    known = np.flatnonzero(np.isfinite(marks.places_m).all(axis=1)).tolist()
    places = [f"{marks.path}, line {marks.lines[i]} ({marks.names[i]})" for i in known]
    if not known:
        raise InputError(f"{file}: none of its marks has a known place (x_m, y_m): nothing to fit a range to")
    (u, v), (x_m, y_m) = marks.pixels[known].T, marks.places_m[known].T
    tree = read_yaml_mapping(camera_file)
    width, height, center = _size(tree, camera_file)
    for place, inside in zip(places, (u >= 0) & (u < width) & (v >= 0) & (v < height), strict=True):
        if not inside:
            raise InputError(f"{place}: lies outside of the image of {width} x {height} pixels")
    angles = np.arctan2(v - center[1], u - center[0])
    bearings = np.arctan2(y_m, x_m)
    if handedness is None and tree.get("handedness") in (1, -1):
        handedness = int(tree["handedness"])
    if handedness is None:
        handedness = _handedness(angles, bearings, file, camera_file)
    yaw = _mount_yaw(tree, handedness, angles, bearings, file, camera_file)
    inner = finite_number(tree.get("inner_radius_px")) or 0.0
    outer = finite_number(tree.get("outer_radius_px")) or math.inf
    optics = Optics(width, height, center, handedness, yaw, inner, outer)
    radius, range_m = np.hypot(u - center[0], v - center[1]), np.hypot(x_m, y_m)
    for place, far_m in zip(places, range_m, strict=True):
        if not _MIN_M < far_m < _MAX_M:
            raise InputError(f"{place}: {far_m:g} m from the robot's centre is no distance of a mark")
    origin, files = f"{len(known)} marks of {file.name}", tuple(marks.files[i] for i in known)
    return RangePairs(radius, range_m, angles, tuple(places), origin, optics, file.parent, files)


def _size(tree: Mapping[str, Any], path: Path) -> tuple[int, int, tuple[float, float]]:
    if tree.get("model") != "omni":
        raise InputError(f"{path}: has 'model: {tree.get('model')}'; ranges belong to a mirror, 'model: omni'")
    size = [finite_number(tree.get(key)) for key in ("width", "height")]
    center = tree.get("center")
    numbers = [finite_number(value) for value in center] if isinstance(center, list) else []
    if None in size or len(numbers) != 2 or numbers[0] is None or numbers[1] is None:
        raise InputError(f"{path}: needs 'width', 'height' and 'center: [u, v]' in pixels")
    assert size[0] is not None
    assert size[1] is not None
    return int(size[0]), int(size[1]), (numbers[0], numbers[1])


def _handedness(angles: FloatArray, bearings: FloatArray, file: Path, camera_file: Path) -> int:
    """The handedness that the marks tell. Raises InputError where they can't."""
    fits = []
    for handedness in (-1, 1):
        yaws = bearings - handedness * angles
        off = np.abs(wrap_angles(yaws - most_common(yaws, _WRONG_BEARING_RAD)[0]))
        fits.append((float(np.mean(np.minimum(off, math.radians(45.0)))), handedness))
    (least, handedness), (other, _) = sorted(fits)
    if other < max(_TOLD_RAD, _TOLD_FACTOR * least):
        raise InputError(
            f"{file}: the marks can't tell the handedness: they lie in one direction, or in two opposite ones. Write "
            f"'handedness: 1' into {camera_file} if the image shows the field as a map does, -1 if mirrored (or give "
            "--handedness), or mark further directions"
        )
    return handedness


def _mount_yaw(
    tree: Mapping[str, Any], handedness: int, angles: FloatArray, bearings: FloatArray, file: Path, camera_file: Path
) -> float:
    """Mounting angle: that of camera.yaml, or else as the marks say. Raises InputError if they contradict it."""
    yaws = bearings - handedness * angles
    given = finite_number(tree.get("mount_yaw"))
    yaw = given if given is not None else most_common(yaws, _WRONG_BEARING_RAD)[0]
    if float(np.median(np.abs(wrap_angles(yaws - yaw)))) > _WRONG_BEARING_RAD:
        raise InputError(
            f"{file}: most marks are seen more than {math.degrees(_WRONG_BEARING_RAD):.0f}° away from where x_m, y_m "
            f"put them: are 'center', 'handedness' and 'mount_yaw' of {camera_file} right?"
        )
    return yaw
