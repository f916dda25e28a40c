"""One pass over a recording that keeps a few numbers per image: all that the checks look at."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from touchline.checks.image_measures import (
    Mask,
    Rim,
    TurnGauge,
    fit_rim,
    measure_exposure,
    measure_sharpness,
    ring_mask,
)
from touchline.errors import InputError
from touchline.geometry import FloatArray, wrap_angle, wrap_angles
from touchline.perception.covered import is_covered
from touchline.sources.folder import Recording
from touchline.types import Frame, ImageArray, Observation, Samples

if TYPE_CHECKING:
    from touchline.camera import OmniCamera
    from touchline.field import FieldModel

RIM_IMAGES = 24  # images whose rim is fitted, spread over the recording
MOTION_COLUMNS = ("x", "y", "theta", "a", "b", "roll", "pitch", "yaw", "gx", "gy", "gz")
_MIN_TURN_RAD, _MAX_TURN_RAD = np.radians(4.0), np.radians(40.0)


@dataclass(frozen=True, eq=False)
class Survey:
    """Numbers per image (N,), NaN where there is none.

    brightness (0..255), saturated (0..1), sharpness: see image_measures. black: shows nothing, as under a covered lens.
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
    black: npt.NDArray[np.bool_]
    frozen: npt.NDArray[np.bool_]
    motion: FloatArray
    changed: npt.NDArray[np.bool_]
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

    def column_changed(self, name: str) -> npt.NDArray[np.bool_]:
        """Whether one of MOTION_COLUMNS changed since the image before (N,)."""
        return self.changed[:, MOTION_COLUMNS.index(name)]


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
        self._before: npt.NDArray[np.uint8] | None = None
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
