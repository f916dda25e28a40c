"""One pass over a recording that keeps a few numbers per image: all that the checks look at."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.geometry import BoolArray, ByteArray, FloatArray, wrap_angle, wrap_angles
from touchline.perception.covered import is_covered
from touchline.sources.folder import Recording
from touchline.types import Frame, ImageArray, Observation, Samples

if TYPE_CHECKING:
    from touchline.camera import OmniCamera
    from touchline.field import FieldModel

_SATURATED = 250
_MIN_EDGE = 8.0  # a 98th percentile of the half-size Laplacian below this is no texture to judge sharpness by
_RAYS = 180
_TRIPLES = 300
_RIM_TOLERANCE_PX = 1.5
_BEARINGS = 360
_RINGS = 12

Mask = ByteArray
GrayArray = npt.NDArray[Any]  # what OpenCV's type hints return for uint8


class Rim(NamedTuple):
    """A circle fitted to the edge of the mirror's disc. support: fraction of the rays that agree within 1.5 px."""

    u: float
    v: float
    radius_px: float
    support: float


def ring_mask(width: int, height: int, center: tuple[float, float], inner_px: float, outer_px: float) -> Mask:
    """uint8 (H, W), 255 between the two radii."""
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    radius = np.hypot(u - center[0], v - center[1])
    return np.where((radius > inner_px) & (radius < outer_px), 255, 0).astype(np.uint8)


def measure_exposure(image: ImageArray, mask: Mask) -> tuple[float, float]:
    """Of the green channel of an image, uint8 (H, W, 3), where the mask is set: mean (0..255), fraction saturated."""
    counts = cv2.calcHist([image], [1], mask, [256], [0, 256]).ravel()
    total = max(float(counts.sum()), 1.0)
    return float(counts @ np.arange(256)) / total, float(counts[_SATURATED:].sum()) / total


def measure_sharpness(image: ImageArray, mask: Mask) -> float:
    """Strength of the strongest edges against the same edges at half the size; NaN without texture.

    The scene cancels out: about 0.6 to 1 for an image in focus, 0.4 for a blur of 1 px (sigma), 0.33 from 2 px on.
    """
    green = np.ascontiguousarray(image[:, :, 1])
    half = cv2.pyrDown(green)
    inside = cv2.erode(mask, np.ones((5, 5), np.uint8))
    half_inside = cv2.resize(inside, (half.shape[1], half.shape[0]), interpolation=cv2.INTER_NEAREST)
    fine, coarse = _strong_edge(green, inside), _strong_edge(half, half_inside)
    return fine / coarse if coarse >= _MIN_EDGE else float("nan")


def fit_rim(image: ImageArray, center: tuple[float, float], outer_px: float) -> Rim | None:
    """The edge of the mirror's disc near an expected circle; None if no three rays agree.

    On each ray the steepest fall of brightness outwards between 0.8 and 1.25 of the expected radius is taken; a circle
    is drawn through many triples of them, and the one that most rays agree with is refined by least squares (Kasa).
    """
    edges = _falls_along_rays(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), center, outer_px)
    if len(edges) < 3:
        return None
    draw = np.random.default_rng(0)
    triples = edges[draw.integers(0, len(edges), size=(_TRIPLES, 3))]
    centers = _circumcenters(triples)
    radii = np.hypot(*(triples[:, 0] - centers).T)
    distances = np.hypot(edges[None, :, 0] - centers[:, None, 0], edges[None, :, 1] - centers[:, None, 1])
    agree = np.abs(distances - radii[:, None]) < _RIM_TOLERANCE_PX  # NaN (three on a line) agrees with nothing
    members = agree[int(agree.sum(axis=1).argmax())]
    if members.sum() < 3:
        return None
    u, v, radius = _fit_circle(edges[members])
    return Rim(u, v, radius, float(members.sum()) / _RAYS)


class TurnGauge:
    """Tells which way the image of an omnidirectional camera turns when the robot does."""

    def __init__(self, center: tuple[float, float], outer_px: float) -> None:
        angle = np.arange(_BEARINGS) * (2.0 * np.pi / _BEARINGS)
        radius = np.linspace(0.75, 0.99, _RINGS) * outer_px
        self._u = (center[0] + np.outer(radius, np.cos(angle))).astype(np.float32)
        self._v = (center[1] + np.outer(radius, np.sin(angle))).astype(np.float32)
        self._before: FloatArray | None = None

    def preference(self, image: ImageArray | None, image_turn_rad: float) -> float:
        """How much better the image before fits this one when turned by `image_turn_rad` (u to v) than by its negative.

        In -1..1, the difference of two correlations; NaN for the first image and after a missing one.
        """
        if image is None:
            self._before = None
            return float("nan")
        rings = cv2.remap(image[:, :, 1], self._u, self._v, cv2.INTER_LINEAR).astype(np.float64)
        rings -= rings.mean(axis=1, keepdims=True)
        before, self._before = self._before, rings
        norm = 0.0 if before is None else float(np.linalg.norm(before) * np.linalg.norm(rings))
        if before is None or norm == 0.0:
            return float("nan")
        step = round(image_turn_rad * _BEARINGS / (2.0 * np.pi))
        along, against = np.roll(before, step, axis=1), np.roll(before, -step, axis=1)
        return float(np.sum((along - against) * rings)) / norm


def _strong_edge(channel: GrayArray, mask: GrayArray) -> float:
    """98th percentile of the absolute Laplacian inside the mask."""
    strength = cv2.convertScaleAbs(cv2.Laplacian(channel, cv2.CV_16S))
    counts = np.cumsum(cv2.calcHist([strength], [0], mask, [256], [0, 256]).ravel())
    return float(np.searchsorted(counts, 0.98 * counts[-1])) if counts[-1] > 0 else 0.0


def _falls_along_rays(gray: GrayArray, center: tuple[float, float], outer_px: float) -> FloatArray:
    """(N, 2) pixels where the brightness falls most, one for each ray that has the whole window inside the image."""
    window = 8  # samples of half a pixel on each side of an edge
    angle = np.arange(_RAYS) * (2.0 * np.pi / _RAYS)
    radius = np.arange(0.8 * outer_px, 1.25 * outer_px, 0.5)
    if len(radius) < 2 * window:
        return np.zeros((0, 2))
    u = center[0] + np.outer(np.cos(angle), radius)
    v = center[1] + np.outer(np.sin(angle), radius)
    height, width = gray.shape
    outside = (u < 0) | (u > width - 1) | (v < 0) | (v > height - 1)
    values = cv2.remap(gray, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR).astype(np.float64)
    values[outside] = np.nan
    sums = np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=1)
    means = (sums[:, window:] - sums[:, :-window]) / window
    fall = np.nan_to_num(means[:, :-window] - means[:, window:], nan=-np.inf)
    best = fall.argmax(axis=1)
    rows = np.flatnonzero(fall[np.arange(_RAYS), best] > 0.0)
    edge = radius[best[rows] + window] - 0.25
    return np.column_stack((center[0] + np.cos(angle[rows]) * edge, center[1] + np.sin(angle[rows]) * edge))


def _circumcenters(triples: FloatArray) -> FloatArray:
    """Centres (N, 2) of the circles through triples (N, 3, 2); NaN where the three lie on a line."""
    a, b = triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0]
    cross = 2.0 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    cross[np.abs(cross) < 1e-6] = np.nan
    aa, bb = np.sum(a * a, axis=1), np.sum(b * b, axis=1)
    offset = np.column_stack((b[:, 1] * aa - a[:, 1] * bb, a[:, 0] * bb - b[:, 0] * aa)) / cross[:, None]
    return triples[:, 0] + offset


def _fit_circle(points: FloatArray) -> tuple[float, float, float]:
    """u, v, radius of the algebraic least-squares circle."""
    system = np.column_stack((2.0 * points, np.ones(len(points))))
    u, v, rest = np.linalg.lstsq(system, np.sum(points**2, axis=1), rcond=None)[0]
    return float(u), float(v), float(np.sqrt(rest + u * u + v * v))


RIM_IMAGES = 24  # images whose rim is fitted, spread over the recording
MOTION_COLUMNS = ("x", "y", "theta", "a", "b", "roll", "pitch", "yaw", "gx", "gy", "gz")
_MIN_TURN_RAD, _MAX_TURN_RAD = np.radians(4.0), np.radians(40.0)


@dataclass(frozen=True, eq=False)
class Survey:
    """Numbers per image (N,), NaN where there is none.

    brightness (0..255), saturated (0..1), sharpness: as measured below. black: shows nothing, as under a covered lens.
    frozen: equal to the image before.
    motion: (N, 11), the last sample of each of MOTION_COLUMNS. changed: bool (N, 11), whether it changed since the
    image before. turn_rad: the gyro's yaw rate summed up since the image before (NaN across a gap).
    turn_score: `TurnGauge.preference` for the camera's handedness. rims: (frame, rim). seen: things by kind that the
    robot's own detector found, and `nothing` for images in which it found none. progress: for a check to call after
    each of many images.
    """

    recording: Recording
    brightness: FloatArray
    saturated: FloatArray
    sharpness: FloatArray
    black: BoolArray
    frozen: BoolArray
    motion: FloatArray
    changed: BoolArray
    turn_rad: FloatArray
    turn_score: FloatArray
    rims: list[tuple[int, Rim]] = field(default_factory=list)
    seen: Counter[str] = field(default_factory=Counter)
    progress: Callable[[], None] = lambda: None

    @cached_property
    def omni(self) -> OmniCamera | None:
        """The omnidirectional camera; None if there is none or its file is broken (the check of it says so)."""
        if self.recording.camera_kind != "omni" or self.recording.camera_file is None:
            return None
        from touchline.camera import require_omni

        try:
            return require_omni(self.recording.camera, "this check needs")
        except InputError:
            return None

    @cached_property
    def field(self) -> FieldModel | None:
        """The field; None if its file is broken (the check of it says so)."""
        try:
            return self.recording.field
        except InputError:
            return None

    @property
    def stamps_s(self) -> FloatArray:
        """Image times (N,) in s."""
        return self.recording.image_stamps / 1e9

    def column(self, name: str) -> FloatArray:
        """One of MOTION_COLUMNS (N,)."""
        return self.motion[:, MOTION_COLUMNS.index(name)]

    def turns(self, name: str) -> FloatArray:
        """(N - 1,) by how much an angle of MOTION_COLUMNS turns from image to image (rad)."""
        return wrap_angles(np.diff(self.column(name)))


def take_survey(recording: Recording, progress: Callable[[], None] = lambda: None) -> Survey:
    """Read the whole recording once; `progress` is called after every image."""
    count = len(recording)
    survey = Survey(
        recording=recording,
        brightness=np.full(count, np.nan),
        saturated=np.full(count, np.nan),
        sharpness=np.full(count, np.nan),
        black=np.zeros(count, dtype=np.bool_),
        frozen=np.zeros(count, dtype=np.bool_),
        motion=np.full((count, len(MOTION_COLUMNS)), np.nan),
        changed=np.zeros((count, len(MOTION_COLUMNS)), dtype=np.bool_),
        turn_rad=np.full(count, np.nan),
        turn_score=np.full(count, np.nan),
        progress=progress,
    )
    motion, eye = _MotionTaker(survey), _ImageTaker(survey)
    for index, frame in enumerate(recording):
        motion.take(index, frame)
        eye.take(index, frame.image)
        if frame.observation is not None:
            survey.seen.update(_counts(frame.observation) or {"nothing": 1})
        progress()
    return survey


def _counts(observation: Observation) -> Counter[str]:
    """Things by kind."""
    kinds = (*observation.crossings.kinds.tolist(), *observation.landmarks.kinds.tolist())
    lengths = Counter(point=len(observation.points), line=len(observation.lines), boundary=len(observation.boundary))
    return +(lengths + Counter(kinds))


class _MotionTaker:
    """Fills the motion columns of a survey."""

    def __init__(self, survey: Survey) -> None:
        self._survey = survey
        self._gyro: tuple[int, float] | None = None

    def take(self, index: int, frame: Frame) -> None:
        start = 0
        sensors = frame.odometry, frame.wheels, frame.tilt, frame.compass, frame.gyro
        for samples, width in zip(sensors, (3, 2, 2, 1, 3), strict=True):
            if samples is not None:
                columns = slice(start, start + width)
                before = self._survey.motion[index - 1, columns] if index else samples.values[0]
                self._survey.motion[index, columns] = samples.values[-1]
                self._survey.changed[index, columns] = (samples.values != before).any(axis=0)
            start += width
        if frame.gyro is not None:
            self._survey.turn_rad[index] = self._turn(frame.gyro)

    def _turn(self, gyro: Samples) -> float:
        """The yaw rate integrated from the last sample taken to the last one here (trapezoids); NaN over a gap."""
        stamps, rates = gyro.stamp_ns, gyro.values[:, 2]
        if self._gyro is not None:
            stamps, rates = np.append(self._gyro[0], stamps), np.append(self._gyro[1], rates)
        self._gyro = int(stamps[-1]), float(rates[-1])
        steps = np.diff(stamps) / 1e9
        if len(steps) == 0 or steps.max() > 0.25:
            return float("nan")
        return float(np.sum(0.5 * (rates[1:] + rates[:-1]) * steps))


class _ImageTaker:
    """Fills the image columns of a survey."""

    def __init__(self, survey: Survey) -> None:
        self._survey = survey
        self._rim_step = max(len(survey.recording) // RIM_IMAGES, 1)
        self._before: ByteArray | None = None
        self._mask: Mask | None = None
        self._gauge: TurnGauge | None = None
        self._circle: tuple[tuple[float, float], float] | None = None
        self._handedness = 0
        camera = survey.omni
        if camera is not None and camera.outer_radius_px <= max(camera.width, camera.height):
            self._circle, self._handedness = (camera.center, camera.outer_radius_px), camera.handedness
            radii = camera.inner_radius_px, camera.outer_radius_px
            self._mask = ring_mask(camera.width, camera.height, camera.center, *radii)
            self._gauge = TurnGauge(*self._circle)

    def take(self, index: int, image: ImageArray | None) -> None:
        survey = self._survey
        if image is not None:
            if self._mask is None or self._mask.shape != image.shape[:2]:
                self._mask = np.full(image.shape[:2], 255, dtype=np.uint8)
            survey.brightness[index], survey.saturated[index] = measure_exposure(image, self._mask)
            sample = image[::5, ::5, 1].copy()
            survey.frozen[index] = self._before is not None and np.array_equal(sample, self._before)
            self._before = sample
            survey.black[index] = is_covered(image)
            if survey.black[index]:
                image = None
        if image is not None:
            assert self._mask is not None
            survey.sharpness[index] = measure_sharpness(image, self._mask)
            if self._circle is not None and index % self._rim_step == 0 and (rim := fit_rim(image, *self._circle)):
                survey.rims.append((index, rim))
        if self._gauge is not None:
            # The world stands still: seen from the robot it turns back, in the image by handedness more.
            turn = wrap_angle(-self._handedness * float(np.nan_to_num(survey.turn_rad[index])))
            score = self._gauge.preference(image, turn)
            if _MIN_TURN_RAD < abs(turn) < _MAX_TURN_RAD:
                survey.turn_score[index] = score
