"""One observation and nothing else: the pose, and every other pose that explains the points as well."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.errors import InputError, NoFitError
from touchline.field import FieldModel, open_field
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.localization.chance import Chance, ChanceSettings, chance_test
from touchline.localization.matching import Match, Matcher, MatchingSettings
from touchline.localization.points_file import read_points
from touchline.localization.weights import WeightSettings, normalized, range_weights
from touchline.localization.whole_field import PoseGrid, thinned_to
from touchline.types import Hypothesis


class LocateSettings(Settings):
    """The search of `locate_points`."""

    least_points: int = Field(8, ge=4, description="different points needed: a pose has three unknowns, and clutter")
    spacing_m: float = Field(
        0.5,
        gt=0,
        description="distance of the sample positions (m): half the paper's, for no compass narrows the search",
    )
    beyond_m: float = Field(
        1.0, ge=0, description="how far beyond the field the samples reach (m): as far as the paper's"
    )
    spacing_rad: float = Field(
        0.0873, gt=0, description="distance of the sample headings (rad): 5°, half a metre at 6 m as spacing_m"
    )
    sample_c_m: float = Field(
        0.5, gt=0, description="width c of the error function for ranking the samples (m): as spacing_m"
    )
    sample_points: int = Field(
        150,
        ge=10,
        description="points, evenly over the ground, that rank and refine the samples: more only take longer",
    )
    candidates: int = Field(
        80, ge=1, description="samples that are refined, of some 86 000: without a heading many look alike"
    )
    finalists: int = Field(
        20, ge=1, description="refined poses that are matched again with all points; rivals are among them"
    )
    heading_tolerance_rad: float = Field(
        0.6, gt=0, description="how far the heading may be from a given one (rad): twice the usual worst compass error"
    )
    same_m: float = Field(
        0.15,
        gt=0,
        description="poses nearer to each other than this (m) and same_rad are one: less than two lines are apart",
    )
    same_rad: float = Field(
        0.1, gt=0, description="poses with headings nearer than this (rad) and same_m are one: as same_m"
    )
    rival_factor: float = Field(
        1.25, ge=1, description="a rival's mean error is at most this factor, plus rival_margin, above the best"
    )
    rival_margin: float = Field(0.02, ge=0, description="see rival_factor; what noise alone changes in the mean error")
    chance: ChanceSettings = ChanceSettings()
    matching: MatchingSettings = MatchingSettings()
    # The mirror of an unknown robot is off by more than its range noise: near points must not decide alone.
    weights: WeightSettings = WeightSettings(floor_m=0.1)


@dataclass(frozen=True, eq=False, slots=True)
class Location:
    """Where one observation was made.

    pose, covariance (3, 3) in (m, m, rad): field frame. error: weighted mean of the error function.
    mean_distance_m, median_distance_m: of the points to the nearest line centre, all points alike, exact distances.
    rivals: other poses of similar error, the better first; residual_m is their mean_distance_m.
    points: different points used. chance: the error against that of the same points rearranged.
    """

    pose: Pose
    covariance: FloatArray
    error: float
    mean_distance_m: float
    median_distance_m: float
    rivals: tuple[Hypothesis, ...]
    points: int
    chance: Chance


class ScatterError(NoFitError):
    """Points that fit no pose better than chance: the best pose nevertheless, and the test that it failed."""

    def __init__(self, message: str, best: Hypothesis, chance: Chance) -> None:
        super().__init__(message)
        self.best = best
        self.chance = chance


def locate(points: str | Path | FloatArray, field: str | Path | FieldModel, heading: float | None = None) -> Location:
    """The pose of a robot from one set of line points.

    points: a CSV file (header x_m,y_m) or an array (N, 2) in m, robot frame. field: a preset's name, a field.yaml or
    a FieldModel. heading: from a compass (rad, field frame), or None to search the whole circle.
    Raises InputError for a file or field that can't be read, NoFitError for points that fit no pose.
    """
    model = field if isinstance(field, FieldModel) else open_field(field)
    if isinstance(points, np.ndarray):
        return locate_points(points, model, heading)
    positions_m, weights = read_points(Path(points))
    return locate_points(positions_m, model, heading, weights)


def locate_points(
    points: FloatArray,
    field: FieldModel,
    heading: float | None = None,
    weights: FloatArray | None = None,
    settings: LocateSettings | None = None,
    seed: int = 0,
) -> Location:
    """Best pose of line points (N, 2) in m, robot frame, with all its rivals.

    heading: from a compass (rad, field frame); None searches the whole circle. weights (N,): relative; None weighs by
    the generic range noise. seed: of the test against chance.
    Raises NoFitError for too few points, ScatterError (a NoFitError) for points that fit no pose better than chance,
    InputError for points that are no numbers.
    """
    s = settings or LocateSettings()
    if heading is not None and not math.isfinite(heading):
        raise InputError(f"the heading {heading} is not an angle in radians")
    points, weights = _different_points(points, weights, s)
    matcher = Matcher(field.distance_map(), s.matching)
    grid = PoseGrid(field.length, field.width, s.spacing_m, s.beyond_m, s.spacing_rad, heading, s.heading_tolerance_rad)
    matches = _matches(matcher, grid, points, weights, heading, s)
    if not matches:
        raise NoFitError(
            f"no pose within {s.heading_tolerance_rad:.2f} rad of the heading {heading:.2f} fits the points"
        )
    best = matches[0]
    chance = chance_test(matcher, grid, points, s.sample_c_m, s.chance, seed)
    distances = field.line_distances(best.pose.transform(points))
    if chance.significance < s.chance.least_significance:
        nearest = Hypothesis(best.pose, float(np.mean(distances)))
        raise ScatterError(_scatter_message(len(points), nearest, chance, s), nearest, chance)
    limit = best.error * s.rival_factor + s.rival_margin
    rivals = tuple(
        Hypothesis(match.pose, float(np.mean(field.line_distances(match.pose.transform(points)))))
        for match in matches[1:]
        if match.error <= limit
    )
    return Location(
        best.pose,
        best.covariance,
        best.error,
        float(np.mean(distances)),
        float(np.median(distances)),
        rivals,
        len(points),
        chance,
    )


def _different_points(
    points: FloatArray, weights: FloatArray | None, s: LocateSettings
) -> tuple[FloatArray, FloatArray]:
    """Points without repetitions, and weights that sum to 1."""
    table = np.asarray(points, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != 2:
        raise InputError(f"line points need two columns, x and y in metres; got an array of shape {table.shape}")
    if not np.all(np.isfinite(table)):
        raise InputError(f"line point {int(np.argmin(np.isfinite(table).all(axis=1)))} is not a pair of finite numbers")
    _, first = np.unique(table, axis=0, return_index=True)
    first = np.sort(first)
    if len(first) < s.least_points:
        raise NoFitError(
            f"{len(first)} different points are too few to tell a pose: at least {s.least_points} are needed"
        )
    different = np.ascontiguousarray(table[first])
    if weights is None:
        return different, range_weights(different, s.weights)
    given = np.asarray(weights, dtype=np.float64)
    if given.shape != (len(table),) or not np.all(np.isfinite(given)) or np.any(given < 0):
        raise InputError(f"weights need one number of at least 0 per point, got an array of shape {given.shape}")
    return different, np.ascontiguousarray(normalized(given[first]))


def _matches(
    matcher: Matcher, grid: PoseGrid, points: FloatArray, weights: FloatArray, heading: float | None, s: LocateSettings
) -> list[Match]:
    """Matches of all points at different poses, the better first."""
    few = thinned_to(points, s.sample_points)
    alike = normalized(np.ones(len(few)))
    starts = grid.best(matcher.distance_map, few, s.sample_c_m, s.candidates)
    refined = [matcher.descend(few, alike, start) for start in starts]
    poses = [Pose(*map(float, pose)) for pose, _, _ in sorted(refined, key=lambda found: found[1])]
    finalists = _different_poses(poses, s)[: s.finalists]
    # The twin on a symmetric field is always a candidate, even if the grid happened to miss it.
    finalists += [pose.mirrored() for pose in finalists]
    matches = sorted((matcher.match(points, weights, pose) for pose in finalists), key=lambda match: match.error)
    allowed = [
        match
        for match in matches
        if heading is None or abs(wrap_angle(match.pose.heading - heading)) <= s.heading_tolerance_rad
    ]
    kept = _different_poses([match.pose for match in allowed], s)
    return [match for match in allowed if any(match.pose is pose for pose in kept)]


def _different_poses(poses: list[Pose], s: LocateSettings) -> list[Pose]:
    """Poses without those that come to the same as an earlier one."""
    kept: list[Pose] = []
    for pose in poses:
        same = (
            pose.distance_to(other) < s.same_m and abs(wrap_angle(pose.heading - other.heading)) < s.same_rad
            for other in kept
        )
        if not any(same):
            kept.append(pose)
    return kept


def _scatter_message(points: int, best: Hypothesis, chance: Chance, s: LocateSettings) -> str:
    x, y, heading = best.pose
    return (
        f"the {points} points fit no pose better than scatter would: the best one ({x:.2f} m, {y:.2f} m, {heading:.3f} "
        f"rad) leaves them {best.residual_m:.2f} m from the lines on average, and rearranged pieces of the same points "
        f"fit as well (error {chance.error:.2f} against {chance.mean:.2f}: {chance.significance:.1f} deviations, "
        f"{s.chance.least_significance:.0f} are needed). Check the field, the unit (metres) and the axes (x forward, "
        "y left)"
    )
