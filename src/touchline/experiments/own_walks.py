"""What happens to a walking humanoid in `own-humanoids`: a camera that looks too low, drift, falls, being carried off.

All of it is laid into walks whose truth is known: what is unfelt is left out of, or added to, the odometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from touchline.experiments.schulz_runs import Walk
from touchline.geometry import FloatArray
from touchline.simulation.observation.features import turned
from touchline.types import Frame, Observation, Samples

FALL_S = 5.0  # on the ground and getting up: nothing is seen
FALLEN_M, FALLEN_RAD = 0.4, math.radians(40.0)  # by which it lies elsewhere, unfelt
_NS = 1e9


def looking_lower(walked: Walk, pitch_rad: float, height_m: float) -> Walk:
    """The camera of a walk looks lower by an angle than it is thought to."""
    frames = (replace(f, observation=_tipped(f.observation, pitch_rad, height_m)) for f in walked.frames)
    return replace(walked, frames=tuple(frames))


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
    if seen is None:
        return None
    c, s = math.cos(pitch_rad), math.sin(pitch_rad)

    def farther(ground: FloatArray) -> FloatArray:
        x, y = ground[..., 0], ground[..., 1]
        depth = height_m * c - x * s
        depth = np.where(depth > 0.0, depth, math.nan)
        return np.stack(((x * c + height_m * s) * height_m / depth, y * height_m / depth), axis=-1)

    moved = replace(
        seen,
        points=replace(seen.points, positions_m=farther(seen.points.positions_m)),
        lines=replace(seen.lines, ends_m=farther(seen.lines.ends_m)),
        crossings=replace(seen.crossings, positions_m=farther(seen.crossings.positions_m)),
        landmarks=replace(seen.landmarks, positions_m=farther(seen.landmarks.positions_m)),
    )
    return moved.usable()
