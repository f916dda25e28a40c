"""Pairs of pixel radius and ground range, marked by hand (marks.csv) or found on the calibration strip."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from touchline.calibration.marks import MARKS, read_marks
from touchline.calibration.mirror import calibrate_mirror
from touchline.errors import InputError
from touchline.geometry import FloatArray, circular_mean, wrap_angles
from touchline.sources import Recording
from touchline.sources.description import finite_number
from touchline.yaml_files import read_yaml_mapping

_NEAREST_M, _FARTHEST_M = 1e-3, 1e3  # of what may be marked
_WRONG_BEARING_RAD = math.radians(8.0)  # of most marks: handedness or mounting angle is another


@dataclass(frozen=True, slots=True)
class Optics:
    """What camera.yaml says beside the ranges: image size, centre (px), orientation, and where the robot ends."""

    width: int
    height: int
    center: tuple[float, float]
    handedness: int
    mount_yaw_rad: float
    inner_px: float


@dataclass(frozen=True, eq=False, slots=True)
class RangePairs:
    """radius_px, range_m, angle_rad: (N,) about the optics' centre, angle in the image (atan2(v, u)).

    places: what each pair is called in messages. origin: where they come from, in words.
    """

    radius_px: FloatArray
    range_m: FloatArray
    angle_rad: FloatArray
    places: tuple[str, ...]
    origin: str
    optics: Optics


def recording_pairs(recording: Recording, skip_unusable: bool = False) -> RangePairs:
    """From a recording's marks.csv; without one from the edges of its calibration strip.

    Raises InputError if it has neither, and for whatever is wrong with them.
    """
    if (recording.folder / MARKS).exists():
        return marked_pairs(recording.file(MARKS), recording.camera_file or recording.file("camera.yaml"))
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
    seen = np.isfinite(offsets[:, 0])  # a first or last edge may be hidden
    return RangePairs(
        np.hypot(*offsets[seen].T),
        np.tile(edges, len(found.sightings))[seen],
        np.arctan2(offsets[seen, 1], offsets[seen, 0]),
        tuple(place for place, there in zip(places, seen, strict=True) if there),
        f"{len(edges)} edges in {len(found.sightings)} images of {recording.name}",
        optics,
    )


def marked_pairs(file: Path, camera_file: Path) -> RangePairs:
    """From marks.csv: `file,name,u,v,x_m,y_m`. Marks of unknown place (empty x_m, y_m) are left out.

    camera_file: of the camera that saw them; its range table isn't read and may be missing. Raises InputError with
    file and line for a row that can't be read, for marks outside of the image or at no distance, and if their
    bearings contradict it.
    """
    marks = read_marks(file)
    known = np.flatnonzero(np.isfinite(marks.places_m).all(axis=1)).tolist()
    places = [marks.place_in_file(i) for i in known]
    if not known:
        raise InputError(f"{file}: none of its marks has a known place (x_m, y_m): nothing to fit a range to")
    (u, v), (x_m, y_m) = marks.pixels[known].T, marks.places_m[known].T
    tree = read_yaml_mapping(camera_file)
    width, height, center = _size(tree, camera_file)
    for place, inside in zip(places, (u >= 0) & (u < width) & (v >= 0) & (v < height), strict=True):
        if not inside:
            raise InputError(f"{place}: lies outside of the image of {width} x {height} pixels")
    angles = np.arctan2(v - center[1], u - center[0])
    handedness, yaw = _orientation(tree, angles, np.arctan2(y_m, x_m), file, camera_file)
    inner = finite_number(tree.get("inner_radius_px")) or 0.0
    optics = Optics(width, height, center, handedness, yaw, inner)
    radius, range_m = np.hypot(u - center[0], v - center[1]), np.hypot(x_m, y_m)
    for place, far_m in zip(places, range_m, strict=True):
        if not _NEAREST_M < far_m < _FARTHEST_M:
            raise InputError(f"{place}: {far_m:g} m from the robot's centre is no distance of a mark")
    return RangePairs(radius, range_m, angles, tuple(places), f"{len(known)} marks of {file.name}", optics)


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


def _orientation(
    tree: Mapping[str, Any], angles: FloatArray, bearings: FloatArray, file: Path, camera_file: Path
) -> tuple[int, float]:
    """Handedness and mounting angle: those of camera.yaml, or else as the marks say."""
    fits = []
    for handedness in (-1, 1):
        yaws = bearings - handedness * angles
        yaw = circular_mean(yaws)
        fits.append((float(np.median(np.abs(wrap_angles(yaws - yaw)))), handedness, yaw))
    spread, handedness, yaw = min(fits)
    given_yaw = finite_number(tree.get("mount_yaw"))
    if tree.get("handedness") in (1, -1) and given_yaw is not None:
        handedness, yaw = int(tree["handedness"]), given_yaw
        spread = float(np.median(np.abs(wrap_angles(bearings - yaw - handedness * angles))))
    if spread > _WRONG_BEARING_RAD:
        raise InputError(
            f"{file}: most marks are seen more than {math.degrees(_WRONG_BEARING_RAD):.0f}° away from where x_m, y_m "
            f"put them: are 'center', 'handedness' and 'mount_yaw' of {camera_file} right?"
        )
    return handedness, yaw
