"""Model-free calibration of the mirror from the strip seen in known directions (section 3.2 of Lu et al., 2013).

Of the recording's camera.yaml only the image size and the rough centre are read. The centre is where the axes of all
strips meet; handedness and mounting angle follow from the bearings at which the strip is seen where.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from touchline.camera import OmniCamera
from touchline.camera.model_free import SUPPORT, Edges, calibrated_camera
from touchline.errors import InputError
from touchline.geometry import BoolArray, FloatArray, circular_mean, wrap_angles
from touchline.published.strip.axis import StripAxis, axis_points, common_center, fit_axis, straight_axis
from touchline.published.strip.directions import (
    around,
    check_directions,
    groups_of_directions,
    healed,
    order_mistakes,
    orientation,
    smooth_bearings,
    white_excess,
)
from touchline.published.strip.edges import edge_name, measure_edges
from touchline.published.strip.recording import ground_start, read_bearings, rough_center, sensor_gamma
from touchline.published.strip.strip import Strip, View, find_strip, read_strip
from touchline.sources import Recording

_FAR_PX = 2.0
_WRONG_SHARE = 0.3  # of the way to the next edge
_MAX_MISSING = 1.0 / 3.0  # of the images may lack the strip's first or last edge
_SPOILT_PX = 0.2  # noise moves no edge so far
_ADVICE = "mend its row in images.csv, or leave out such images with --skip-unusable"
_MIDDLES = 4  # of rectangles: so many tell the axis better than the search did
_ROUNDS = 4  # of centre and axes: each shrinks what is left of the centre's error about tenfold


@dataclass(frozen=True, eq=False, slots=True)
class Sighting:
    """The strip in one image. bearing_rad: the one given. axis: the curve along which the strip is seen.

    radii_px: (E,) of its edges on the axis, about the calibrated centre; NaN for a first or last one that is hidden.
    """

    name: str
    index: int
    bearing_rad: float
    axis: StripAxis
    radii_px: FloatArray

    @property
    def pixels(self) -> FloatArray:
        """(E, 2) u, v of the edges."""
        return np.column_stack(self.axis.pixels(self.radii_px))


@dataclass(frozen=True, eq=False, slots=True)
class MirrorCalibration:
    """What came out. unusable: messages about images that were left out.

    bearing_error_rad: root mean square of (given bearing - calibrated one), mostly that of turning the robot. filled:
    edges that were hidden or contradicted the other directions, and were taken from those.
    """

    camera: OmniCamera
    strip: Strip
    sightings: tuple[Sighting, ...]
    rough_center: FloatArray
    bearing_error_rad: float
    filled: int
    unusable: tuple[str, ...] = ()


def calibrate_mirror(recording: Recording, skip_unusable: bool = False, support: int = SUPPORT) -> MirrorCalibration:
    """Calibrate from a recording with `bearing_rad` in images.csv and the strip's edges in sequence.yaml.

    skip_unusable: leave out images that do not show the strip instead of refusing. support: nearest edges that each
    Lagrange polynomial along a direction goes through, 0 for all of them (Lu et al. 2013, section 3.2).
    Raises InputError naming the image for a strip that isn't found, edges out of order, a wrong bearing; and for too
    few directions.
    """
    strip = read_strip(recording.sequence, recording.path / "sequence.yaml")
    bearings = read_bearings(recording)
    start = rough_center(recording)
    found, unusable = _find_all(recording, bearings, start, strip)
    center = _refine(found, start, strip)
    if unusable or np.hypot(*(center - start)) > _FAR_PX:  # rays from a wrong centre cross the strip askew: once more
        found, unusable = _find_all(recording, bearings, center, strip)
        center = _refine(found, center, strip)
    if unusable and not skip_unusable:
        more = f" (and {len(unusable) - 1} more images)" if unusable[1:] else ""
        raise InputError(f"{unusable[0]}{more}; {_ADVICE}")
    check_directions(np.array([f.bearing_rad for f in found]), recording.path)
    _settle(found)
    sightings, bad = _measure_all(recording, found, strip, skip_unusable)
    sightings, turned, radii, wrong = _agreeing(sightings, strip, recording, skip_unusable)
    camera, filled = _camera(sightings, turned, radii, center, strip, recording, support)
    error_rad = wrap_angles([s.bearing_rad for s in sightings] - turned.bearings_rad)
    return MirrorCalibration(
        camera, strip, tuple(sightings), start, float(np.sqrt(np.mean(np.square(error_rad)))), filled,
        tuple(unusable + bad + wrong),
    )  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True)
class _Turned:
    """How the image is turned: handedness, mounting angle, and the bearings (S,) of the sightings after that."""

    handedness: int
    mount_yaw_rad: float
    bearings_rad: FloatArray


def _agreeing(
    sightings: list[Sighting], strip: Strip, recording: Recording, skip_unusable: bool
) -> tuple[list[Sighting], _Turned, FloatArray, list[str]]:
    """The sightings that do not contradict the others, how they are turned, their radii (S, E) with NaN for ends that
    are not to be believed, and messages about those left out.
    """
    messages: list[str] = []
    while True:
        angles = np.array([s.axis.angle_rad for s in sightings])
        given = np.array([s.bearing_rad for s in sightings])
        check_directions(given, recording.path)
        handedness, mount_yaw = orientation(angles, given, recording.path / "images.csv")
        bearings, wrong = smooth_bearings(mount_yaw + handedness * angles, given)
        radii, mistakes = order_mistakes(angles, np.array([s.radii_px for s in sightings]), strip)
        wrong = mistakes | wrong
        if not wrong:
            check_directions(bearings, recording.path)
            return sightings, _Turned(handedness, mount_yaw, bearings), radii, messages
        refused = [f"{recording.path / sightings[k].name}: {wrong[k]}" for k in sorted(wrong)]
        if not skip_unusable:
            raise InputError(f"{refused[0]}; {_ADVICE}")
        messages += refused
        sightings = [s for k, s in enumerate(sightings) if k not in wrong]


def _camera(
    sightings: Sequence[Sighting], turned: _Turned, radii_px: FloatArray, center: FloatArray, strip: Strip,
    recording: Recording, support: int,
) -> tuple[OmniCamera, int]:  # fmt: skip
    """The camera, and how many edges were taken from the other directions."""
    bearings, angles = turned.bearings_rad, np.array([s.axis.angle_rad for s in sightings])
    _check_ends(np.isnan(radii_px), sightings, strip, recording)
    radii, spoilt = healed(angles, radii_px, np.full(radii_px.shape[1], _SPOILT_PX), of_its_own=True)
    radii = radii + strip.signs * white_excess(radii, strip.edges_m, strip.signs)
    directions = np.array([s.axis.angles(row) for s, row in zip(sightings, radii, strict=True)])
    offsets = wrap_angles(bearings[:, np.newaxis] - turned.mount_yaw_rad - turned.handedness * directions)
    offsets, _ = healed(angles, offsets, _SPOILT_PX / np.median(radii, axis=0), of_its_own=False)
    groups = groups_of_directions(bearings)
    first = recording.image(sightings[0].index)
    assert first is not None  # it was read a moment ago
    edges = Edges(
        np.array([circular_mean(bearings[group]) for group in groups]),
        np.array([offsets[group].mean(axis=0) for group in groups]),
        np.array([radii[group].mean(axis=0) for group in groups]),
        strip.edges_m,
    )
    camera = calibrated_camera(
        edges,
        size=(first.shape[1], first.shape[0]),
        center=(float(center[0]), float(center[1])),
        handedness=turned.handedness,
        mount_yaw_rad=turned.mount_yaw_rad,
        inner_radius_px=ground_start(recording, [s.index for s in sightings], center, np.median(radii, axis=0)),
        support=support,
    )
    return camera, int(spoilt.sum())


def _check_ends(missing: BoolArray, sightings: Sequence[Sighting], strip: Strip, recording: Recording) -> None:
    """Raises InputError, naming an image, where the first or last edge (missing: (S, E)) is not seen in most images."""
    for k in np.flatnonzero(missing.mean(axis=0) > _MAX_MISSING):
        image, others = sightings[int(np.argmax(missing[:, k]))].name, missing[:, k].sum() - 1
        raise InputError(
            f"{recording.path / image}: {edge_name(strip, int(k))} is not found, nor in {others} other images: "
            "what lies beside it looks like the strip, or 'patch_edges_m' names an edge too many"
        )


@dataclass(eq=False, slots=True)
class _Found:
    name: str
    index: int
    bearing_rad: float
    view: View
    axis: StripAxis
    radii_px: FloatArray


def _find_all(
    recording: Recording, bearings: Sequence[tuple[str, float]], center: FloatArray, strip: Strip
) -> tuple[list[_Found], list[str]]:
    """The strip where it is found, and messages about the other images. InputError if it is found in none."""
    gamma = sensor_gamma(recording)
    found, unusable = [], []
    for index, (name, bearing) in enumerate(bearings):
        image = recording.image(index)
        if image is None:
            unusable.append(f"{recording.path / name}: cannot be read as an image of {recording.name}")
            continue
        view = View.of(image, gamma)
        try:
            angle, radii = find_strip(view, center, strip)
        except InputError as error:
            unusable.append(f"{recording.path / name}: {error}")
            continue
        found.append(_Found(name, index, bearing, view, straight_axis(center, angle, radii), radii))
    if not found:
        raise InputError(unusable[0] + (f" (nor in the other {len(unusable) - 1} images)" if unusable[1:] else ""))
    return found, unusable


def _settle(found: Sequence[_Found]) -> None:
    """Where the search took a rod or a field line for an edge, look where the other directions have that edge."""
    angles, radii = np.array([f.axis.angle_rad for f in found]), np.array([f.radii_px for f in found])
    expected = np.column_stack([around(angles, column, _FAR_PX) for column in radii.T])
    for f, row in zip(found, expected, strict=True):
        gaps = np.diff(row)
        room = np.minimum(np.append(gaps, gaps[-1]), np.append(gaps[0], gaps))
        f.radii_px = np.where(np.abs(f.radii_px - row) > _WRONG_SHARE * room, row, f.radii_px)


def _measure_all(
    recording: Recording, found: Sequence[_Found], strip: Strip, skip_unusable: bool
) -> tuple[list[Sighting], list[str]]:
    sightings, unusable = [], []
    for f in found:
        try:
            radii = measure_edges(f.view, f.axis, f.radii_px, strip)
        except InputError as error:
            message = f"{recording.path / f.name}: {error}"
            if not skip_unusable:
                raise InputError(f"{message}; {_ADVICE}") from None
            unusable.append(message)
            continue
        sightings.append(Sighting(f.name, f.index, f.bearing_rad, f.axis, radii))
    return sightings, unusable


def _refine(found: list[_Found], center: FloatArray, strip: Strip) -> FloatArray:
    """The centre (2,) where the strips' axes meet; axes and radii of what was found are moved to it."""
    for _ in range(_ROUNDS):
        middles = [axis_points(f.view, f.axis, f.radii_px, strip) for f in found]
        usable = [points for points in middles if len(points) >= _MIDDLES]
        if len(usable) < 3:
            raise InputError(
                f"{found[0].name}: the strip's long sides are not seen there nor in most other images: "
                "is 'patch_half_width_m' right?"
            )
        center = common_center(usable)
        for f, points in zip(found, middles, strict=True):
            edges = np.column_stack(f.axis.pixels(f.radii_px))
            f.radii_px = np.hypot(*(edges - center).T)
            f.axis = fit_axis(edges if len(points) < _MIDDLES else points, center, f.radii_px)
    return center
