"""Faults of odometry and measuring wheels, laid into the frames of a run: gone, dropped, spinning, stuck, too long."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from touchline.experiments.faults import Change, Drive
from touchline.geometry import FloatArray
from touchline.types import Frame, Samples


class Slip(NamedTuple):
    """Wheels that tell another motion than the robot's from start_s until before end_s; odometry as well as wheels.

    Every step is `factor` times the true one, and `spin_m_s` of travel ahead come on top. The gyro is right.
    """

    name: str
    start_s: float
    end_s: float
    factor: float = 1.0
    spin_m_s: float = 0.0

    def laid_into(self, drive: Drive, rng: np.random.Generator) -> Drive:
        """The drive with the fault in it."""
        odometry = _split(drive, [f.odometry for f in drive.frames], self._odometry)
        wheels = _split(drive, [f.wheels for f in drive.frames], self._wheels)
        told = zip(drive.frames, odometry, wheels, strict=True)
        return drive._replace(frames=[replace(frame, odometry=o, wheels=w) for frame, o, w in told])

    def _steps(self, times_s: FloatArray, steps: FloatArray, spun: FloatArray) -> FloatArray:
        """(N, K) steps up to each of N samples as they are told; spun: (K,) in which of them spinning shows."""
        wrong = ((times_s >= self.start_s) & (times_s < self.end_s))[:, None]
        passed_s = np.diff(times_s, prepend=times_s[:1])[:, None]
        told: FloatArray = np.where(wrong, self.factor * steps + self.spin_m_s * passed_s * spun, steps)
        return told

    def _wheels(self, times_s: FloatArray, sums: FloatArray) -> FloatArray:
        steps = np.diff(sums, axis=0, prepend=sums[:1])
        told: FloatArray = sums[0] + np.cumsum(self._steps(times_s, steps, np.ones(2)), axis=0)
        return told

    def _odometry(self, times_s: FloatArray, poses: FloatArray) -> FloatArray:
        poses = poses.copy()
        poses[:, 2] = np.unwrap(poses[:, 2])
        steps = np.diff(poses, axis=0, prepend=poses[:1])
        steps[1:, :2] = _turned(steps[1:, :2], -poses[:-1, 2])
        told = self._steps(times_s, steps, np.array([1.0, 0.0, 0.0]))
        told[:, 2] = poses[0, 2] + np.cumsum(told[:, 2])
        told[1:, :2] = _turned(told[1:, :2], told[:-1, 2])
        told[:, :2] = poses[0, :2] + np.cumsum(told[:, :2], axis=0)
        return told


def _split(
    drive: Drive, samples: Sequence[Samples | None], told: Callable[[FloatArray, FloatArray], FloatArray]
) -> list[Samples | None]:
    """The samples of every frame, changed as one log of times (N,) in s and values (N, K)."""
    known = [each for each in samples if each is not None]
    if not known:
        return list(samples)
    stamps_ns = np.concatenate([each.stamp_ns for each in known])
    values = told(1e-9 * stamps_ns, np.concatenate([each.values for each in known]))
    ends = np.cumsum([0 if each is None else len(each.stamp_ns) for each in samples])
    return [
        None if each is None else Samples(each.stamp_ns, values[end - len(each.stamp_ns) : end])
        for each, end in zip(samples, ends.tolist(), strict=True)
    ]


def _turned(vectors: FloatArray, angles_rad: FloatArray) -> FloatArray:
    """Vectors (N, 2), each turned by its angle (N,)."""
    cosine, sine = np.cos(angles_rad), np.sin(angles_rad)
    x, y = vectors.T
    return np.column_stack((cosine * x - sine * y, sine * x + cosine * y))


def no_wheels(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
    """Neither odometry nor wheels."""
    return replace(drive.frames[index], odometry=None, wheels=None)


def some_wheels(share: float) -> Change:
    """A share of odometry's and wheels' samples is dropped on the way."""

    def change(drive: Drive, index: int, rng: np.random.Generator) -> Frame:
        def kept(samples: Samples | None) -> Samples | None:
            if samples is None:
                return None
            rows = rng.random(len(samples.stamp_ns)) >= share
            return Samples(samples.stamp_ns[rows], samples.values[rows]) if rows.any() else None

        frame = drive.frames[index]
        return replace(frame, odometry=kept(frame.odometry), wheels=kept(frame.wheels))

    return change
