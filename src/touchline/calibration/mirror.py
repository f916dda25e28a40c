"""Model-free calibration of the mirror from the strip seen in known directions (section 3.2 of Lu et al., 2013).

Of the recording's camera.yaml only the image size and the rough centre are read. The centre is where the axes of all
strips meet; handedness and mounting angle follow from the bearings at which the strip is seen where.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from touchline.calibration.strip import Strip, View, find_strip, read_strip
from touchline.calibration.strip_edges import axis_points, common_center, edge_name, measure_edges
from touchline.calibration.strip_recording import ground_start, read_bearings, rough_center, sensor_gamma
from touchline.camera import OmniCamera
from touchline.camera.model_free import calibrated_camera
from touchline.errors import InputError
from touchline.geometry import FloatArray, circular_mean, wrap_angles
from touchline.sources import Recording

LEAST_DIRECTIONS = 8  # a tilted mirror is a first harmonic: cubic interpolation follows it to 0.1 % at 45°
WIDEST_GAP_RAD = np.radians(60.0)
SAME_DIRECTION_RAD = np.radians(1.0)  # revolutions that come by again are averaged
WRONG_BEARING_RAD = np.radians(3.0)
_FAR_PX = 2.0
_ADVICE = "mend its row in images.csv, or leave out such images with --skip-unusable"
_ROUNDS = 3  # of centre and axes: each shrinks what is left of the centre's error about tenfold


@dataclass(frozen=True, eq=False, slots=True)
class Sighting:
    """The strip in one image. angle_rad: its direction in the image, atan2(v, u); bearing_rad: the one given.

    radii_px: (E,) of its edges about the calibrated centre. pixels: (E, 2) u, v of them.
    """

    name: str
    index: int
    bearing_rad: float
    angle_rad: float
    radii_px: FloatArray
    pixels: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class MirrorCalibration:
    """What came out. unusable: messages about images that were left out.

    bearing_error_rad: root mean square of (given bearing - that of the camera model).
    """

    camera: OmniCamera
    strip: Strip
    sightings: tuple[Sighting, ...]
    rough_center: FloatArray
    bearing_error_rad: float
    unusable: tuple[str, ...] = ()


def calibrate_mirror(recording: Recording, skip_unusable: bool = False) -> MirrorCalibration:
    """Calibrate from a recording with `bearing_rad` in images.csv and the strip's edges in sequence.yaml.

    skip_unusable: leave out images that do not show the strip instead of refusing. Raises InputError naming the image
    for a strip that isn't found, edges out of order, a wrong bearing; and for too few directions.
    """
    strip = read_strip(recording.sequence, recording.folder / "sequence.yaml")
    bearings = read_bearings(recording)
    start = rough_center(recording)
    views, unusable = _find_all(recording, bearings, start, strip, skip_unusable)
    _check_directions([view.bearing_rad for view in views], recording)
    center = _refine(views, start, strip)
    if np.hypot(*(center - start)) > _FAR_PX:  # rays from a wrong centre cross the strip askew: look once more
        views, unusable = _find_all(recording, bearings, center, strip, skip_unusable)
        center = _refine(views, center, strip)
    sightings, bad = _measure_all(recording, views, center, strip, skip_unusable)
    unusable += bad
    handedness, mount_yaw = _orientation(sightings, recording)
    errors = wrap_angles([s.bearing_rad - mount_yaw - handedness * s.angle_rad for s in sightings])
    _check_consistency(sightings, errors, strip, recording)
    seen_at, radii = _directions(sightings, handedness, mount_yaw)
    _check_directions(seen_at.tolist(), recording)
    inner = ground_start(recording, [s.index for s in sightings], center, np.median(radii, axis=0))
    size = (views[0].view.light.shape[1], views[0].view.light.shape[0])
    camera = calibrated_camera(
        size, (float(center[0]), float(center[1])), handedness, mount_yaw, seen_at, radii, strip.edges_m, inner
    )
    rms = float(np.sqrt(np.mean(np.square(errors))))
    return MirrorCalibration(camera, strip, tuple(sightings), start, rms, tuple(unusable))


@dataclass(eq=False, slots=True)
class _Found:
    name: str
    index: int
    bearing_rad: float
    view: View
    angle_rad: float
    radii_px: FloatArray


def _find_all(
    recording: Recording, bearings: Sequence[tuple[str, float]], center: FloatArray, strip: Strip, skip_unusable: bool
) -> tuple[list[_Found], list[str]]:
    gamma = sensor_gamma(recording)
    found, unusable = [], []
    for index, (name, bearing) in enumerate(bearings):
        image = recording.image(index)
        if image is None:
            unusable.append(f"{recording.folder / name}: cannot be read as an image of {recording.name}")
            continue
        view = View.of(image, gamma)
        try:
            angle, radii = find_strip(view, center, strip)
        except InputError as error:
            unusable.append(f"{recording.folder / name}: {error}")
            continue
        found.append(_Found(name, index, bearing, view, angle, radii))
    if not found:
        raise InputError(unusable[0] + (f" (nor in the other {len(unusable) - 1} images)" if unusable[1:] else ""))
    if unusable and not skip_unusable:
        more = f" (and {len(unusable) - 1} more images)" if unusable[1:] else ""
        raise InputError(f"{unusable[0]}{more}; {_ADVICE}")
    return found, unusable


def _measure_all(
    recording: Recording, found: Sequence[_Found], center: FloatArray, strip: Strip, skip_unusable: bool
) -> tuple[list[Sighting], list[str]]:
    sightings, unusable = [], []
    for view in found:
        try:
            radii = measure_edges(view.view, center, view.angle_rad, view.radii_px, strip)
        except InputError as error:
            message = f"{recording.folder / view.name}: {error}"
            if not skip_unusable:
                raise InputError(f"{message}; {_ADVICE}") from None
            unusable.append(message)
            continue
        direction = np.array([np.cos(view.angle_rad), np.sin(view.angle_rad)])
        pixels = center + radii[:, np.newaxis] * direction
        sightings.append(Sighting(view.name, view.index, view.bearing_rad, view.angle_rad, radii, pixels))
    return sightings, unusable


def _refine(found: list[_Found], center: FloatArray, strip: Strip) -> FloatArray:
    """The centre (2,) where the strips' axes meet; angles and radii of what was found are moved to it."""
    for _ in range(_ROUNDS):
        axes = [axis_points(f.view, center, f.angle_rad, f.radii_px, strip) for f in found]
        usable = [points for points in axes if len(points) >= 4]
        if len(usable) < 3:
            raise InputError(
                f"{found[0].name}: the strip's long sides are not seen there nor in most other images: "
                "is 'patch_half_width_m' right?"
            )
        moved = common_center(usable)
        for f, points in zip(found, axes, strict=True):
            edges = center + f.radii_px[:, np.newaxis] * (np.cos(f.angle_rad), np.sin(f.angle_rad)) - moved
            f.radii_px = np.hypot(*edges.T)
            along = edges if len(points) < 4 else points - moved
            f.angle_rad = circular_mean(np.arctan2(along[:, 1], along[:, 0]))
        center = moved
    return center


def _orientation(sightings: Sequence[Sighting], recording: Recording) -> tuple[int, float]:
    """Handedness and mounting angle: bearing = mount_yaw + handedness * angle, whichever sign agrees."""
    fits = []
    for handedness in (-1, 1):
        yaws = np.array([s.bearing_rad - handedness * s.angle_rad for s in sightings])
        off = np.abs(wrap_angles(yaws[:, np.newaxis] - yaws))
        middle = int(np.argmin(np.median(off, axis=0)))  # the image that agrees with most others
        yaw = circular_mean(yaws[off[:, middle] <= WRONG_BEARING_RAD])
        fits.append((float(np.median(off[:, middle])), handedness, yaw))
    fits.sort()
    if fits[0][0] > WRONG_BEARING_RAD:
        raise InputError(
            f"{recording.folder / 'images.csv'}: the bearings don't agree with where the strip is seen, neither in a "
            "mirrored image nor in a straight one"
        )
    return fits[0][1], fits[0][2]


def _check_consistency(sightings: Sequence[Sighting], errors: FloatArray, strip: Strip, recording: Recording) -> None:
    """Every image against all others: a bearing that is wrong, an edge at another edge's place."""
    for sighting, error in zip(sightings, errors, strict=True):
        if abs(error) > WRONG_BEARING_RAD:
            raise InputError(
                f"{recording.folder / sighting.name}: the strip is seen {np.degrees(abs(error)):.1f}° away from "
                f"bearing_rad {sighting.bearing_rad:g} of images.csv, by what the other images say"
            )
    angles = np.array([s.angle_rad for s in sightings])
    radii = np.array([s.radii_px for s in sightings])
    waves = np.column_stack((np.ones(len(angles)), np.cos(angles), np.sin(angles)))
    gaps = np.diff(np.median(radii, axis=0))
    for k in range(radii.shape[1]):
        keep = np.ones(len(angles), dtype=np.bool_)
        for _ in range(3):  # a tilted or displaced mirror is a first harmonic; what is far from it is a mistake
            fit = waves @ np.linalg.lstsq(waves[keep], radii[keep, k], rcond=None)[0]
            off = np.abs(radii[:, k] - fit)
            keep = off <= max(3.0 * 1.4826 * float(np.median(off)), 0.3)
        worst = int(np.argmax(off))
        if off[worst] > 0.35 * min(gaps[max(k - 1, 0)], gaps[min(k, len(gaps) - 1)]):
            raise InputError(
                f"{recording.folder / sightings[worst].name}: edges out of order: {edge_name(strip, k)} is seen "
                f"{radii[worst, k]:.1f} px from the centre, where the other images have it at {fit[worst]:.1f} px"
            )


def _directions(sightings: Sequence[Sighting], handedness: int, mount_yaw: float) -> tuple[FloatArray, FloatArray]:
    """Bearings (B,) in the base frame as the camera model has them, ascending, and the radii (B, E) seen there;
    images of one direction are averaged.
    """
    bearings = np.mod([mount_yaw + handedness * s.angle_rad for s in sightings], 2.0 * np.pi)
    order = np.argsort(bearings)
    groups: list[list[int]] = []
    for index in order:
        if groups and bearings[index] - bearings[groups[-1][0]] < SAME_DIRECTION_RAD:
            groups[-1].append(int(index))
        else:
            groups.append([int(index)])
    seam = bearings[groups[0][0]] + 2.0 * np.pi - bearings[groups[-1][0]]
    if len(groups) > 1 and seam < SAME_DIRECTION_RAD:
        groups[0] += groups.pop()
    means = [float(np.mod(circular_mean(bearings[group]), 2.0 * np.pi)) for group in groups]
    radii = np.array([np.mean([sightings[k].radii_px for k in group], axis=0) for group in groups])
    ascending = np.argsort(means)
    return np.array(means)[ascending], radii[ascending]


def _check_directions(bearings: Sequence[float], recording: Recording) -> None:
    sorted_rad = np.sort(np.mod(bearings, 2.0 * np.pi))
    gaps = np.diff(sorted_rad, append=sorted_rad[0] + 2.0 * np.pi)
    distinct = int(np.sum(gaps >= SAME_DIRECTION_RAD))
    if distinct < LEAST_DIRECTIONS:
        raise InputError(
            f"{recording.folder}: too few directions: the strip is seen in {distinct}, at least {LEAST_DIRECTIONS} "
            "all around are needed (24 are usual)"
        )
    if gaps.max() > WIDEST_GAP_RAD:
        k = int(np.argmax(gaps))
        raise InputError(
            f"{recording.folder}: too few directions: none between bearings {np.degrees(sorted_rad[k]):.0f}° and "
            f"{np.degrees(sorted_rad[(k + 1) % len(gaps)]):.0f}°; the gap must not exceed "
            f"{np.degrees(WIDEST_GAP_RAD):.0f}°"
        )
