"""amcl: augmented Monte Carlo localization with a likelihood field and KLD sampling.

Thrun, Burgard, Fox: Probabilistic Robotics, tables 6.3 (likelihood field), 8.3 (augmented MCL), 8.4 (KLD sampling); the
motion model of a robot that drives any way, as in ROS' amcl. The compass, where there is one, is one more likelihood.

python lab/benchmarks/baselines/amcl.py INPUTS RESULTS/amcl
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from exchange import Answer, Drive, Seen, moved, run_all, wrapped
from scipy.ndimage import distance_transform_edt

CELL_M, MARGIN_M = 0.05, 2.0


@dataclass(frozen=True)
class Settings:
    """Chosen by random search on robots 0 and 1 of ten rows of the suite."""

    sigma_m: float = 0.2  # of a point's distance to the nearest line
    random_ratio: float = 0.09  # z_rand of table 6.3
    power: float = 0.25  # points of one line err alike: the product is taken to this power
    travel: float = 0.18  # noise of the motion per way
    turn: float = 0.08  # and per turn
    slow: float = 0.035
    fast: float = 0.3
    tracked_m: float = 0.45  # spread below which the pose is tracked
    max_points: int = 60
    min_particles: int = 300
    max_particles: int = 3000
    kld_error: float = 0.02
    compass_rad: float = 0.15


class LikelihoodField:
    """Distances to the nearest line on a grid."""

    def __init__(self, field: dict[str, Any]) -> None:
        self.reach = np.array([0.5 * field["length"] + MARGIN_M, 0.5 * field["width"] + MARGIN_M])
        shape = np.ceil(2.0 * self.reach / CELL_M).astype(int)
        free = np.ones(shape, bool)
        for places in _lines(field):
            i, j = ((places + self.reach) / CELL_M).astype(int).T
            free[i.clip(0, shape[0] - 1), j.clip(0, shape[1] - 1)] = False
        self.distances_m = distance_transform_edt(free).astype(np.float32) * CELL_M
        self.limits = shape - 1

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        i = ((x + self.reach[0]) / CELL_M).astype(np.int64).clip(0, self.limits[0])
        j = ((y + self.reach[1]) / CELL_M).astype(np.int64).clip(0, self.limits[1])
        return self.distances_m[i, j]


def _lines(field: dict[str, Any]) -> Iterator[np.ndarray]:
    for x1, y1, x2, y2 in field.get("segments") or []:
        share = np.linspace(0.0, 1.0, int(math.hypot(x2 - x1, y2 - y1) / (0.5 * CELL_M)) + 2)[:, np.newaxis]
        yield np.array([x1, y1]) * (1.0 - share) + np.array([x2, y2]) * share
    arcs = [(*circle, 0.0, 2.0 * math.pi) for circle in field.get("circles") or []] + list(field.get("arcs") or [])
    for cx, cy, radius, start, end in arcs:
        angle = np.linspace(start, end, int(abs(end - start) * radius / (0.5 * CELL_M)) + 2)
        yield np.column_stack((cx + radius * np.cos(angle), cy + radius * np.sin(angle)))


class Amcl:
    """Particles (N, 3) and the two averages of their likelihood."""

    def __init__(self, drive: Drive, s: Settings) -> None:
        self.s, self.drive = s, drive
        self.rng = np.random.default_rng(crc32(drive.name.encode()))
        self.map = LikelihoodField(drive.field)
        self.half = np.array([0.5 * drive.field["length"], 0.5 * drive.field["width"]]) + 0.5
        self.slow = self.fast = 0.0
        if drive.start is None:
            self.poses = self.anywhere(s.max_particles)
        else:
            self.poses = drive.start + self.rng.standard_normal((1000, 3)) * [0.2, 0.2, 0.12]

    def anywhere(self, count: int) -> np.ndarray:
        place = self.rng.uniform(-self.half, self.half, (count, 2))
        return np.column_stack((place, self.rng.uniform(-np.pi, np.pi, count)))

    def follow(self) -> Iterator[Answer]:
        before = self.drive.images[0].odometry
        for seen in self.drive.images:
            self.move(moved(before, seen.odometry))
            before = seen.odometry
            weights = self.weights(seen) if len(seen.points) >= 5 else None
            mean, covariance = self.estimate(weights)
            spread_m = math.sqrt(covariance[0, 0] + covariance[1, 1])
            yield mean, covariance, spread_m < self.s.tracked_m and covariance[2, 2] < 0.03
            if weights is not None:
                self.resample(weights)

    def move(self, motion: np.ndarray) -> None:
        """Every particle by the odometry, with noise per way and turn."""
        way, turn = math.hypot(*motion[:2]), abs(motion[2])
        along = self.s.travel * way + 0.1 * self.s.turn * turn + 0.002
        spread = np.array([along, along, self.s.turn * turn + 0.3 * self.s.travel * way + 0.002])
        noisy = motion + spread * self.rng.standard_normal(self.poses.shape)
        c, s = np.cos(self.poses[:, 2]), np.sin(self.poses[:, 2])
        self.poses[:, 0] += c * noisy[:, 0] - s * noisy[:, 1]
        self.poses[:, 1] += s * noisy[:, 0] + c * noisy[:, 1]
        self.poses[:, 2] += noisy[:, 2]

    def weights(self, seen: Seen) -> np.ndarray:
        """Table 6.3; the averages of table 8.3 are of the mean likelihood of one point."""
        points = seen.points
        if len(points) > self.s.max_points:
            points = points[self.rng.choice(len(points), self.s.max_points, replace=False)]
        c, s = np.cos(self.poses[:, 2:]), np.sin(self.poses[:, 2:])
        x = self.poses[:, :1] + c * points[:, 0] - s * points[:, 1]
        y = self.poses[:, 1:2] + s * points[:, 0] + c * points[:, 1]
        hit = np.exp(-0.5 * np.square(self.map.at(x, y) / self.s.sigma_m))
        logs = np.log((1.0 - self.s.random_ratio) * hit + self.s.random_ratio).sum(axis=1)
        if math.isfinite(seen.compass_rad):
            off = wrapped(self.poses[:, 2] - seen.compass_rad) / self.s.compass_rad
            logs += np.log(0.95 * np.exp(-0.5 * off * off) + 0.05) / self.s.power
        likelihood = float(np.mean(np.exp(logs / len(points))))
        self.slow += self.s.slow * (likelihood - self.slow) if self.slow else likelihood
        self.fast += self.s.fast * (likelihood - self.fast) if self.fast else likelihood
        logs *= self.s.power
        weights = np.exp(logs - logs.max())
        return weights / weights.sum()

    def estimate(self, weights: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        w = np.full(len(self.poses), 1.0 / len(self.poses)) if weights is None else weights
        heading = math.atan2(w @ np.sin(self.poses[:, 2]), w @ np.cos(self.poses[:, 2]))
        mean = np.array([*(w @ self.poses[:, :2]), heading])
        off = self.poses - mean
        off[:, 2] = wrapped(off[:, 2])
        return mean, (off * w[:, np.newaxis]).T @ off + 1e-6 * np.eye(3)

    def resample(self, weights: np.ndarray) -> None:
        """Low variance, as many as table 8.4 asks for; some anywhere, as table 8.3 asks for."""
        count = self.wanted(weights)
        teeth = (np.arange(count) + self.rng.random()) / count
        self.poses = self.poses[np.searchsorted(np.cumsum(weights), teeth).clip(max=len(weights) - 1)]
        fresh = int(max(0.0, 1.0 - self.fast / self.slow) * count)
        if fresh:
            self.poses[self.rng.choice(count, fresh, replace=False)] = self.anywhere(fresh)

    def wanted(self, weights: np.ndarray) -> int:
        drawn = self.poses[weights > 1e-3 / len(weights)]
        bins = len(np.unique(np.floor(drawn / [0.5, 0.5, 0.1745]).astype(int), axis=0))
        a = 2.0 / (9.0 * max(bins - 1, 1))
        kld = (bins - 1) / (2.0 * self.s.kld_error) * (1.0 - a + math.sqrt(a) * 2.326) ** 3
        return int(min(max(kld, self.s.min_particles), self.s.max_particles))


def follow(drive: Drive, settings: Settings | None = None) -> Iterator[Answer]:
    """Poses of a drive."""
    return Amcl(drive, settings or Settings()).follow()


if __name__ == "__main__":
    run_all(Path(sys.argv[1]), Path(sys.argv[2]), follow)
