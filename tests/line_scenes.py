"""Line points as a robot would see them, for tests of localization: simulated views, and the published point sets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from touchline.calibration.nearest_line import outward
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.types import Estimate, Frame, LinePoints, Observation, Samples

POLAR = (0.02, 0.01, 0.0087)  # of the range as a share of it and in m, of the bearing in rad


def polar_covariances(positions_m: FloatArray, noise: tuple[float, float, float] = POLAR) -> FloatArray:
    """Covariances (N, 2, 2) in m² of positions (N, 2) that a camera has seen."""
    ranges, bearings = np.hypot(*positions_m.T), np.arctan2(positions_m[:, 1], positions_m[:, 0])
    axes = np.array([[np.cos(bearings), -np.sin(bearings)], [np.sin(bearings), np.cos(bearings)]])
    variances = np.square([noise[0] * ranges + noise[1], noise[2] * ranges])
    return np.ascontiguousarray(np.einsum("ian,an,jan->nij", axes, variances, axes))


@dataclass(frozen=True, eq=False)
class PointSets:
    """The frames of points/msl_18x12.npz, 200 or 1000, and their own field."""

    field: FieldModel
    points: FloatArray
    offsets: FloatArray
    truth: FloatArray
    init: FloatArray
    compass: FloatArray

    def frame(self, index: int) -> FloatArray:
        return self.points[self.offsets[index] : self.offsets[index + 1]]


def load_point_sets(shared_data: Path) -> PointSets:
    data = np.load(shared_data / "points" / "msl_18x12.npz")
    arcs = data["arcs"].copy()
    arcs[:, 4] += arcs[:, 3]  # start and span there, start and end here
    field = FieldModel(
        name="point-sets", length=18.0, width=12.0, line_width=0.125,
        segments=data["segments"], circles=arcs[:1, :3], arcs=arcs[1:],
    )  # fmt: skip
    return PointSets(field, data["points"], data["offsets"], data["truth"], data["init"], data["compass"])


def lone_line(length: float = 18.0) -> FieldModel:
    """A field whose only line is its long middle axis."""
    return FieldModel(
        name="lone-line", length=length, width=12.0, line_width=0.125,
        segments=np.array([[-length / 2, 0.0, length / 2, 0.0]]),
    )  # fmt: skip


def along_edges(field: FieldModel) -> FieldModel:
    """The field as a file may have it that holds the outer edges of its lines, not their middles."""
    half, segments, circles = 0.5 * field.line_width, field.segments.copy(), field.circles.copy()
    along = segments[:, 2:] - segments[:, :2]
    normal = np.column_stack((-along[:, 1], along[:, 0])) / np.hypot(*along.T)[:, np.newaxis]
    segments += np.tile(half * outward(field.line_tables)[: len(segments), np.newaxis] * normal, 2)
    circles[:, 2] += half
    return replace(field, segments=segments, circles=circles)


def view(
    field: FieldModel, pose: Pose, rng: np.random.Generator, count: int = 100, reach_m: float = 6.0,
    noise: float = 0.02, clutter: float = 0.0, field_of_view_rad: float = 2 * np.pi,
) -> FloatArray:  # fmt: skip
    """Points (up to count, 2) in the robot frame on the lines within reach; range noise relative, clutter a share."""
    paint = np.vstack(list(field.polylines(0.02)))
    seen = pose.inverse().transform(paint)
    ranges, bearings = np.hypot(*seen.T), np.arctan2(seen[:, 1], seen[:, 0])
    seen = seen[(ranges > 0.3) & (ranges < reach_m) & (np.abs(bearings) <= field_of_view_rad / 2)]
    seen = seen[rng.permutation(len(seen))[:count]]
    seen = seen * (1.0 + noise * rng.standard_normal((len(seen), 1)))
    stray = rng.random(len(seen)) < clutter
    radius, angle = reach_m * np.sqrt(rng.random(stray.sum())), rng.uniform(-np.pi, np.pi, stray.sum())
    seen[stray] = np.column_stack((radius * np.cos(angle), radius * np.sin(angle)))
    return np.ascontiguousarray(seen)


def seen(pose: Pose, seed: int, reach_m: float = 5.0) -> LinePoints:
    """Noisy line points of an MSL field within reach of a pose, and a few that are none."""
    rng = np.random.default_rng(seed)
    exact = pose.inverse().transform(np.vstack(open_field("msl-18x12").polylines(0.25)))
    exact = exact[np.hypot(*exact.T) < reach_m]
    covariances = polar_covariances(exact)
    noisy = exact + np.einsum("nij,nj->ni", np.linalg.cholesky(covariances), rng.normal(size=exact.shape))
    points = np.vstack((noisy, rng.uniform(-4.0, 4.0, (len(noisy) // 15, 2))))
    n = len(points)
    return LinePoints(points, polar_covariances(points), np.ones(n), np.full((n, 2), np.nan))


def frame(k: int, points: LinePoints, compass_rad: float | None = None) -> Frame:
    """The k-th image of a robot that stands, ten a second."""
    stamp_ns = 100_000_000 * k
    stamps = np.array([stamp_ns - 20_000_000, stamp_ns])
    compass = None if compass_rad is None else Samples(stamps, np.full((2, 1), compass_rad))
    still = Samples(stamps, np.zeros((2, 3)))
    return Frame(stamp_ns, observation=Observation(stamp_ns, points), odometry=still, compass=compass)


def errors(estimate: Estimate, truth: Pose) -> tuple[float, float]:
    """Of an estimate, in m and rad."""
    return estimate.pose.distance_to(truth), abs(wrap_angle(estimate.pose.heading - truth.heading))
