"""What happens to a walking humanoid in `own-humanoids`: a camera that looks too low, drift, falls, being carried off.

All of it is laid into walks whose truth is known: what is unfelt is left out of, or added to, the odometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from touchline.calibration.self_perspective import levelled
from touchline.camera import PinholeCamera
from touchline.experiments.schulz_runs import Walk
from touchline.geometry import FloatArray, Pose3
from touchline.simulation.observation.features import turned
from touchline.systems.touchline_perspective import optical_axis
from touchline.types import Frame, Observation, Samples

FALL_S = 5.0  # on the ground and getting up: nothing is seen
FALLEN_M, FALLEN_RAD = 0.4, math.radians(40.0)  # by which it lies elsewhere, unfelt
_NS = 1e9


def looking_lower(walked: Walk, pitch_rad: float, height_m: float) -> Walk:
    """The camera of a walk looks lower by an angle than it is thought to."""
    frames = (replace(f, observation=_tipped(f.observation, pitch_rad, height_m)) for f in walked.frames)
    return replace(walked, frames=tuple(frames))


def misjudged(walked: Walk, longer: float, higher_m: float) -> Walk:
    """A walk whose camera, a perspective one, is told with a focal length by so much longer, and so much higher, than
    it has. Its lens bends nothing.
    """
    camera = walked.setup.camera
    assert isinstance(camera, PinholeCamera)
    mount, eye = camera.base_from_camera, camera.base_from_camera.translation_m
    shared = np.array([0.0, 0.0, higher_m / eye[2], 1.0 / (1.0 + longer) - 1.0])
    told = replace(
        camera,
        fx=(1.0 + longer) * camera.fx,
        fy=(1.0 + longer) * camera.fy,
        base_from_camera=Pose3(mount.rotation, eye + np.array([0.0, 0.0, higher_m])),
    )
    frames = []
    for frame in walked.frames:
        moved = partial(levelled, shared=shared, eye=eye, axis=optical_axis(camera, frame))
        frames.append(replace(frame, observation=_on_ground(frame.observation, moved)))
    return replace(walked, frames=tuple(frames), setup=replace(walked.setup, camera=told, height_m=None))


def turned_aside(walked: Walk, angle_rad: float) -> Walk:
    """The camera of a walk is turned aside by an angle, which nobody tells."""
    frames = (
        f if f.observation is None else replace(f, observation=turned(f.observation, angle_rad)) for f in walked.frames
    )
    return replace(walked, frames=tuple(frames))


def drifting(walked: Walk, rate_rad_s: float) -> Walk:
    """The odometry's heading drifts, as with a gyro's bias."""

    def turned(steps: FloatArray, stamps_s: FloatArray) -> FloatArray:
        return steps + np.outer(np.diff(stamps_s), (0.0, 0.0, rate_rad_s))

    return _with_steps(walked, turned)


def fallen(walked: Walk, times_s: tuple[float, ...], rng: np.random.Generator) -> Walk:
    """The robot falls at times, sees nothing until it stands again, and stands elsewhere then."""

    def moved(steps: FloatArray, stamps_s: FloatArray) -> FloatArray:
        steps = steps.copy()
        for time_s in times_s:
            direction, side = rng.uniform(-math.pi, math.pi), rng.choice((-1.0, 1.0))
            step = min(int(np.searchsorted(stamps_s, time_s + 0.5 * FALL_S)), len(steps) - 1)
            steps[step] += FALLEN_M * math.cos(direction), FALLEN_M * math.sin(direction), side * FALLEN_RAD
        return steps

    walked = _with_steps(walked, moved)
    down = [any(t <= frame.stamp_ns / _NS < t + FALL_S for t in times_s) for frame in walked.frames]
    frames = (
        replace(frame, observation=Observation(frame.stamp_ns)) if lies else frame
        for frame, lies in zip(walked.frames, down, strict=True)
    )
    return replace(walked, frames=tuple(frames))


def carried(walked: Walk, start: int, end: int) -> Walk:
    """The robot is put down at frame `end`, a second after it was at the one before `start`, and does not feel it."""
    gap_ns = walked.frames[end].stamp_ns - walked.frames[start - 1].stamp_ns - round(_NS)
    later = (_earlier(frame, gap_ns) for frame in walked.frames[end:])
    truth = np.concatenate((walked.truth[:start], walked.truth[end:]))
    joined = replace(walked, frames=(*walked.frames[:start], *later), truth=truth)

    def unfelt(steps: FloatArray, stamps_s: FloatArray) -> FloatArray:
        steps = steps.copy()
        steps[int(np.argmax(np.diff(stamps_s)))] = 0.0
        return steps

    return _with_steps(joined, unfelt)


def _earlier(frame: Frame, by_ns: int) -> Frame:
    odometry = frame.odometry
    if odometry is not None:
        odometry = Samples(odometry.stamp_ns - by_ns, odometry.values)
    return Frame(frame.stamp_ns - by_ns, observation=frame.observation, odometry=odometry)


def _with_steps(walked: Walk, changed: Callable[[FloatArray, FloatArray], FloatArray]) -> Walk:
    """A walk whose odometry goes by other steps (N, 3), robot frame, between its stamps (N + 1) in s."""
    told = [frame.odometry or Samples(np.zeros(0, np.int64), np.zeros((0, 3))) for frame in walked.frames]
    stamps, values = np.concatenate([t.stamp_ns for t in told]), np.concatenate([t.values for t in told])
    away, headings = np.diff(values, axis=0), values[:-1, 2]
    c, s = np.cos(headings), np.sin(headings)
    steps = np.column_stack((c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0], away[:, 2]))
    steps = changed(steps, stamps / _NS)
    headings = values[0, 2] + np.concatenate(([0.0], np.cumsum(steps[:, 2])))
    c, s = np.cos(headings[:-1]), np.sin(headings[:-1])
    ways = np.column_stack((c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]))
    places = values[0, :2] + np.concatenate((np.zeros((1, 2)), np.cumsum(ways, axis=0)))
    ends = np.cumsum([len(t) for t in told])
    frames = []
    for frame, first, end in zip(walked.frames, (0, *ends[:-1]), ends, strict=True):
        rows = np.column_stack((places[first:end], headings[first:end]))
        frames.append(replace(frame, odometry=Samples(stamps[first:end], rows) if end > first else None))
    return replace(walked, frames=tuple(frames))


def _tipped(seen: Observation | None, pitch_rad: float, height_m: float) -> Observation | None:
    """What a camera sees that looks lower than it is thought to; what seems to hang in the air is left out."""
    c, s = math.cos(pitch_rad), math.sin(pitch_rad)

    def farther(ground: FloatArray) -> FloatArray:
        x, y = ground[..., 0], ground[..., 1]
        depth = height_m * c - x * s
        depth = np.where(depth > 0.0, depth, math.nan)
        return np.stack(((x * c + height_m * s) * height_m / depth, y * height_m / depth), axis=-1)

    return _on_ground(seen, farther)


def _on_ground(seen: Observation | None, moved: Callable[[FloatArray], FloatArray]) -> Observation | None:
    """What is seen with its ground points (N, 2) moved; what is nowhere then is left out."""
    if seen is None:
        return None
    points, lines, crossings, landmarks = seen.points, seen.lines, seen.crossings, seen.landmarks
    return replace(
        seen,
        points=replace(points, positions_m=moved(points.positions_m)),
        lines=replace(lines, ends_m=moved(lines.ends_m.reshape(-1, 2)).reshape(-1, 2, 2)),
        crossings=replace(crossings, positions_m=moved(crossings.positions_m)),
        landmarks=replace(landmarks, positions_m=moved(landmarks.positions_m)),
    ).usable()
