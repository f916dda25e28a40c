"""One observation and nothing else: the pose, and every other pose that explains the points as well."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from touchline.camera import Camera
from touchline.config import Settings
from touchline.errors import InputError, NoFitError
from touchline.field import FieldModel, open_field, preset_names
from touchline.geometry import FloatArray, Pose, mirrored_covariance, wrap_angle
from touchline.given import given_numbers
from touchline.localization.one_shot.certainty import CameraDoubt, Spread, points_covariance, with_camera
from touchline.localization.one_shot.doubts import FAR_M, MAX_OUTSIDE_RATIO, judge
from touchline.localization.one_shot.joint_search import JointSearch
from touchline.localization.one_shot.location import Location, NotSignificantError, PoorFitError
from touchline.localization.one_shot.permutation_test import CANDIDATES, PermutationTest, permutation_test
from touchline.localization.one_shot.point_search import PointSearch
from touchline.localization.one_shot.points_file import points_and_weights
from touchline.localization.one_shot.thinning import different, sampled, thinned_to
from touchline.localization.registration.weights import WeightSettings, normalized, range_weights
from touchline.localization.search.feature_search import distinct
from touchline.localization.search.field_search import BEYOND_M
from touchline.localization.search.pose_search import Known
from touchline.types import Hypothesis, LinePoints, Observation, check_point_count

SAMPLE_POINTS = 150  # points, evenly over the ground, that rank and refine the samples: more only take longer
MAX_POINTS = 10_000  # points that are matched: more only take longer, their noise has long averaged out
SAME_M = 0.15  # poses nearer to each other than this and SAME_RAD are one: less than two lines are apart
SAME_RAD = 0.1  # poses with headings nearer than this and SAME_M are one: as SAME_M
# log-odds against the likeliest pose from which another is none, where crossings or landmarks count: a perspective
# camera's image is worth no more, as of `SECTOR`
MAX_LOG_ODDS = 4.0
MAX_BEYOND_RATIO = 0.1  # of the points beyond the outer lines, that are left out there
OPENED = 2  # poses, of which the second is often the twin, whose covariance holds what a lean leaves open
MIN_EXPLAINED = 0.6  # share of what is seen that a pose must explain: with the camera's lean free, some pose fits half


class LocateSettings(Settings):
    """The search of `locate_points`."""

    min_points: int = Field(
        8, ge=4, le=10_000_000, description="different points needed: a pose has three unknowns, and clutter"
    )
    candidates: int = Field(
        80, ge=1, le=100_000, description="poses of the grid that are refined: without a heading many look alike"
    )
    finalists: int = Field(
        20,
        ge=1,
        le=100_000,
        description="refined poses that are matched again with all points; other hypotheses are among them",
    )
    heading_tolerance_rad: float = Field(
        0.6, gt=0, description="how far the heading may be from a given one (rad): twice the usual worst compass error"
    )
    hypothesis_factor: float = Field(
        1.25,
        ge=1,
        description="another hypothesis's mean error is at most this factor, plus hypothesis_margin, above the best",
    )
    hypothesis_margin: float = Field(
        0.02, ge=0, description="see hypothesis_factor; what noise alone changes in the mean error"
    )
    hypothesis_margin_m: float = Field(
        0.02,
        ge=0,
        description="its mean distance (m) is within hypothesis_factor and this margin of the best, too",
    )
    max_median_m: float = Field(
        0.25,
        gt=0,
        description="largest median distance of the points to the lines (m): half of them must lie within the reach "
        "c of the error function, 0.25 m; beyond it they no longer pull at the pose",
    )
    min_significance: float = Field(
        3.0,
        gt=0,
        description="deviations by which the error must lie below that of 20 rearranged copies of the points: chance "
        "alone reaches this 4 times in a thousand",
    )
    # The mirror of an unknown robot is off by more than its range noise: near points must not decide alone.
    weights: WeightSettings = WeightSettings(floor_m=0.1)


def locate(
    points: str | Path | FloatArray | Sequence[Sequence[float]] | LinePoints | Observation,
    field: str | Path | FieldModel,
    heading: float | None = None,
    settings: LocateSettings | None = None,
    seed: int = 0,
    camera: Camera | None = None,
) -> Location:
    """The pose of a robot from one set of line points, or from all that one observation shows.

    points: the path of a CSV file (header x_m,y_m, perhaps weight), an array or a sequence of pairs (N, 2) in m, robot
    frame, LinePoints, which are weighed by their precision, or an Observation, whose lines, crossings and landmarks
    count, too. field: a preset's name, the path of a field.yaml or a FieldModel. heading: from a compass (rad, field
    frame), or None to search the whole circle. settings, seed, camera: as of `locate_points`.
    Raises InputError for points or a field that can't be read, NoFitError for points that fit no pose.
    """
    model = field if isinstance(field, FieldModel) else _opened(field)
    heading = None if heading is None else given_numbers("heading", "an angle (rad) or None", [heading], 1)[0]
    if isinstance(points, Observation) and (points.lines or points.crossings or points.landmarks):
        return _locate_observation(points, model, heading, settings or LocateSettings(), seed, camera)
    positions_m, weights = points_and_weights(points)
    return locate_points(positions_m, model, heading, weights, settings, seed, camera)


def _opened(field: str | Path) -> FieldModel:
    return _preset(field) if isinstance(field, str) and field in preset_names() else open_field(field)


@functools.cache
def _preset(name: str) -> FieldModel:
    """A preset with the distance map that earlier calls made: 40 ms of each further one."""
    return open_field(name)


def locate_points(
    points: FloatArray,
    field: FieldModel,
    heading: float | None = None,
    weights: FloatArray | None = None,
    settings: LocateSettings | None = None,
    seed: int = 0,
    camera: Camera | None = None,
) -> Location:
    """Best pose of line points (N, 2) in m, robot frame, with all others that explain the points as well.

    heading: from a compass (rad, field frame); None searches the whole circle. weights (N,): relative; None weighs by
    the generic range noise. seed: of the test against chance, and of the sample: of more than MAX_POINTS points so many
    are drawn in proportion to their weights, and pose, error, covariance and test are theirs. The pose then differs by
    less than its own standard deviation; distances are those of all points. camera: that saw them; the covariance holds
    what it states to be wrong by, and what cameras usually are without one or where the lines contradict it.
    Raises NoFitError for too few points, PoorFitError (a NoFitError) if the lines miss most points at the best pose,
    NotSignificantError (a PoorFitError) for points that fit no pose better than chance, InputError for points that are
    no numbers and for a heading beyond a whole turn.
    """
    s = settings or LocateSettings()
    _check_heading(heading)
    points, weights = _different_points(points, weights, s)
    search = PointSearch(field, heading, s.heading_tolerance_rad)
    sample, shares = sampled(points, weights, MAX_POINTS, seed)
    matches = _matches(search, sample, shares, heading, s)
    if not matches:
        raise NoFitError(_no_heading_message(heading, s))
    every = sample
    inside = _on_field(matches[0][0].transform(points), field)
    if not inside.all():
        points, weights = np.ascontiguousarray(points[inside]), normalized(weights[inside])
        sample, shares = sampled(points, weights, MAX_POINTS, seed)
        matches = _matches(search, sample, shares, heading, s) or matches
    max_error = matches[0][1] * s.hypothesis_factor + s.hypothesis_margin
    similar = [_at(pose, points, field) for pose, error in matches if error <= max_error]
    # distances as well, because the error saturates: once far points are lost, it hardly tells how far
    max_m = similar[0].residual_m * s.hypothesis_factor + s.hypothesis_margin_m
    similar = [similar[0], *(one for one in similar[1:] if one.residual_m <= max_m)]
    spread = Spread.stated_by(camera)

    def unsure(place: Pose) -> tuple[FloatArray, CameraDoubt]:
        return with_camera(field, points, place, points_covariance(search, sample, shares, place), spread)

    found = _Found(points, sample, shares, similar, unsure, every, _beyond(inside))
    return _judged(found, search, field, heading, s, seed)


def _on_field(placed: FloatArray, field: FieldModel) -> NDArray[np.bool_]:
    """(N,) which points (N, 2), field frame, are not beyond the outer lines, where furniture is; all of them where
    that would be many: then the pose is wrong.
    """
    inside: NDArray[np.bool_] = np.all(np.abs(placed) < 0.5 * np.array([field.length, field.width]) + FAR_M, axis=1)
    return inside if np.sum(~inside) <= MAX_BEYOND_RATIO * len(inside) else np.ones_like(inside)


def _beyond(inside: NDArray[np.bool_]) -> tuple[str, ...]:
    """That points were left out, where they are more than a few."""
    beyond = float(np.sum(~inside)) / max(len(inside), 1)
    if beyond <= MAX_OUTSIDE_RATIO:
        return ()
    return (f"{100.0 * beyond:.0f} % of the points lie beyond the outer lines and were left out",)


def _locate_observation(
    observation: Observation,
    field: FieldModel,
    heading: float | None,
    s: LocateSettings,
    seed: int,
    camera: Camera | None,
) -> Location:
    """As `locate_points`, by all that is seen; the points are those of a camera without the errors that are fitted."""
    _check_heading(heading)
    max_range_m = math.hypot(field.length, field.width) + BEYOND_M
    observation = observation.usable(max_range_m)
    joint = JointSearch(field, observation, camera)
    positions_m, weights = _different_points(joint.seen.positions_m, None, s)
    search = PointSearch(field, heading, s.heading_tolerance_rad)
    matches = _matches(search, positions_m, weights, heading, s)
    known = None if heading is None else Known(np.array([0.0, 0.0, heading]), np.diag([0.0, 0.0, 1.0]))
    fits = [one for one in joint.fits([pose for pose, _ in matches], known) if _allowed(one.pose, heading, s)]
    if not fits:
        raise NoFitError(_no_heading_message(heading, s))
    every, _ = sampled(*_different_points(joint.corrected(fits[0]), None, s), MAX_POINTS, seed)
    inside = _on_field(fits[0].pose.transform(joint.placed(observation.points.positions_m, fits[0])), field)
    if not inside.all():
        joint = JointSearch(field, replace(observation, points=observation.points.rows(inside)), camera)
        fits = joint.refits(fits)
    likely = [one for one in fits if one.log_likelihood > fits[0].log_likelihood - MAX_LOG_ODDS]
    likely = [likely[k] for k in _different([one.pose for one in likely])]
    likely[:OPENED] = [joint.opened(one, lambda pose: _allowed(pose, heading, s)) for one in likely[:OPENED]]
    covariances = {one.pose: one.covariance for one in likely}
    similar = [_at(one.pose, joint.corrected(one), field) for one in likely]
    points, weights = _different_points(joint.corrected(fits[0]), None, s)
    sample, weights = sampled(points, weights, MAX_POINTS, seed)

    def unsure(place: Pose) -> tuple[FloatArray, None]:
        return covariances[place], None

    found = _Found(
        points, sample, weights, similar, unsure, every, (*joint.doubts(likely[0]), *_beyond(inside)), fits[0].explained
    )
    return replace(_judged(found, search, field, heading, s, seed), camera_errors=fits[0].errors)


class _Found(NamedTuple):
    """Poses that explain the points (N, 2) about equally well, the best first, and by how much each may be off.
    (Mean distances are of the points as each pose's camera errors correct them.)

    sample, weights (M,): points of which the pose's error is taken; every (M, 2): with those beyond the field, for the
    test against chance. doubts: what else speaks against the best pose.
    explained: share of all that is seen that lies where it should.
    """

    points: FloatArray
    sample: FloatArray
    weights: FloatArray
    similar: Sequence[Hypothesis]
    unsure: Callable[[Pose], tuple[FloatArray, CameraDoubt | None]]
    every: FloatArray
    doubts: tuple[str, ...] = ()
    explained: float = 1.0


def _judged(
    found: _Found, search: PointSearch, field: FieldModel, heading: float | None, s: LocateSettings, seed: int
) -> Location:
    """The best pose, if it is better than chance, with all that speaks against it."""
    points, pose = found.points, found.similar[0].pose
    candidates = CANDIDATES if field.is_symmetric or heading is not None else 2 * CANDIDATES
    chance = permutation_test(search, found.every, seed, candidates)
    distances = field.line_distances(pose.transform(points))
    mean_m, median_m = float(np.mean(distances)), float(np.median(distances))
    nearest = Hypothesis(pose, mean_m)
    if chance.significance < s.min_significance:
        raise NotSignificantError(_scatter_message(len(points), nearest, chance, heading, s), nearest, chance)
    if found.explained < MIN_EXPLAINED:
        raise PoorFitError(_unexplained_message(found.explained, nearest, heading), nearest, chance)
    if median_m > s.max_median_m:
        raise PoorFitError(_poor_message(len(points), nearest, median_m, heading, s), nearest, chance)
    judged = judge(field, pose.transform(points), distances, *found.unsure(pose))
    nearest = Hypothesis(pose, mean_m, covariance=judged.covariance)
    others = tuple(
        replace(one, covariance=found.unsure(one.pose)[0]) if one.covariance is None else one
        for one in _hypotheses(found.similar[1:], field, nearest, heading, s)
    )
    error = search.error(found.sample, found.weights, pose)
    doubts = (*_rivals(pose, others), *found.doubts, *judged.doubts)
    return Location(pose, judged.covariance, error, mean_m, median_m, others, len(points), chance, doubts)


def _check_heading(heading: float | None) -> None:
    if heading is None:
        return
    if not math.isfinite(heading):
        raise InputError(f"the heading {heading} is not an angle in radians")
    if abs(heading) > 2 * math.pi:
        raise InputError(
            f"the heading {heading:g} is more than a whole turn: is it in radians? "
            f"{heading:g} degrees are {math.radians(heading):.4f} rad"
        )


def _at(pose: Pose, points: FloatArray, field: FieldModel) -> Hypothesis:
    """A pose with the mean distance of the points (N, 2) from the lines there."""
    return Hypothesis(pose, float(np.mean(field.line_distances(pose.transform(points)))))


def _hypotheses(
    similar: Sequence[Hypothesis], field: FieldModel, nearest: Hypothesis, heading: float | None, s: LocateSettings
) -> tuple[Hypothesis, ...]:
    """The poses that explain the points as well as the nearest, with its twin, which alone has a covariance."""
    assert nearest.covariance is not None
    others = list(similar)
    mirrored = nearest.pose.mirrored()
    if field.is_symmetric and _allowed(mirrored, heading, s) and not _is_among(mirrored, [one.pose for one in others]):
        # it explains the points equally well by the field's symmetry
        others.insert(0, Hypothesis(mirrored, nearest.residual_m, covariance=mirrored_covariance(nearest.covariance)))
    return tuple(others)


def _rivals(pose: Pose, others: Sequence[Hypothesis]) -> list[str]:
    """In words, that other places than the pose's twin explain the points as well."""
    places = [one for one in others if not _is_among(one.pose, [pose.mirrored()])]
    if not places:
        return []
    noun = "place explains" if len(places) == 1 else "places explain"
    return [f"the points do not tell the place: {len(places)} other {noun} them about as well"]


def _different_points(
    points: FloatArray, weights: FloatArray | None, s: LocateSettings
) -> tuple[FloatArray, FloatArray]:
    """Points without repetitions, and weights that sum to 1."""
    table = np.asarray(points, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != 2:
        raise InputError(f"line points need two columns, x and y in metres; got an array of shape {table.shape}")
    check_point_count(len(table))
    if not np.all(np.isfinite(table)):
        raise InputError(f"line point {int(np.argmin(np.isfinite(table).all(axis=1)))} is not a pair of finite numbers")
    first = different(table)
    if len(first) < s.min_points:
        noun = "point is" if len(first) == 1 else "points are"
        raise NoFitError(f"{len(first)} different {noun} too few to tell a pose: at least {s.min_points} are needed")
    kept = np.ascontiguousarray(table[first])
    if weights is None:
        return kept, range_weights(kept, s.weights)
    given = np.asarray(weights, dtype=np.float64)
    if given.shape != (len(table),) or not np.all(np.isfinite(given)) or np.any(given < 0):
        raise InputError(f"weights need one number of at least 0 per point, got an array of shape {given.shape}")
    return kept, np.ascontiguousarray(normalized(given[first]))


def _matches(
    search: PointSearch, points: FloatArray, weights: FloatArray, heading: float | None, s: LocateSettings
) -> list[tuple[Pose, float]]:
    """Different poses refined with all points, and the mean error of each, the better first."""
    refined = search.refined(thinned_to(points, SAMPLE_POINTS), s.candidates)
    finalists = [refined[k][0] for k in _different([pose for pose, _ in refined], s.finalists)]
    # The mirrored pose on a symmetric field is always a candidate, even if the grid happened to miss it.
    finalists += [pose.mirrored() for pose in finalists]
    matches = search.at(points, weights, np.array([pose.as_array() for pose in finalists]))
    allowed = [match for match in matches if _allowed(match[0], heading, s)]
    return [allowed[k] for k in _different([pose for pose, _ in allowed])]


def _allowed(pose: Pose, heading: float | None, s: LocateSettings) -> bool:
    return heading is None or abs(wrap_angle(pose.heading - heading)) <= s.heading_tolerance_rad


def _different(poses: list[Pose], count: int = MAX_POINTS) -> list[int]:
    """Which poses, up to a count, don't come to the same as an earlier one."""
    return distinct(np.array(poses).reshape(-1, 3), count, SAME_M, SAME_RAD).tolist()


def _is_among(pose: Pose, others: list[Pose]) -> bool:
    return any(pose.is_near(other, SAME_M, SAME_RAD) for other in others)


def _no_heading_message(heading: float | None, s: LocateSettings) -> str:
    return f"no pose within {s.heading_tolerance_rad:.2f} rad of the heading {heading:.2f} fits the points"


def _scatter_message(
    points: int, best: Hypothesis, chance: PermutationTest, heading: float | None, s: LocateSettings
) -> str:
    return (
        f"the {points} points fit no pose better than scatter would: the best one ({_words(best.pose)}) leaves them "
        f"{best.residual_m:.2f} m from the lines on average, and rearranged pieces of the same points fit as well "
        f"(error {chance.error:.2f} against {chance.mean:.2f}: {chance.significance:.1f} deviations, "
        f"{s.min_significance:.0f} are needed). {_what_to_check(heading)}"
    )


def _poor_message(points: int, best: Hypothesis, median_m: float, heading: float | None, s: LocateSettings) -> str:
    return (
        f"the {points} points fit no pose well: the best one ({_words(best.pose)}) leaves half of them more than "
        f"{median_m:.2f} m from the lines ({best.residual_m:.2f} m on average); at most {s.max_median_m:.2f} m are "
        f"allowed. {_what_to_check(heading)}"
    )


def _unexplained_message(explained: float, best: Hypothesis, heading: float | None) -> str:
    left = f"{100.0 * (1.0 - explained):.0f} % of it beside the field's lines and marks"
    return f"no pose explains what is seen: the best one ({_words(best.pose)}) leaves {left}. {_what_to_check(heading)}"


def _words(pose: Pose) -> str:
    return f"{pose.x:.2f} m, {pose.y:.2f} m, {pose.heading:.3f} rad"


def _what_to_check(heading: float | None) -> str:
    first = "" if heading is None else f"the heading ({heading:.3f} rad, in the field frame), "
    return f"Check {first}the field, the unit (metres) and the axes (x forward, y left)"
