"""Point sets of single observations, for `own`: how near to the bound a pose is found, and which poses are kept.

The sets are drawn as the public one is: poses all over the 18 x 12 m field, points of lines within 6 m, their ranges
and bearings with the noise of a usual camera, some of them clutter.
"""

import math
import time
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline import palette
from touchline.field import FieldModel, open_field
from touchline.geometry import BoolArray, FloatArray, Pose, wrap_angle
from touchline.localization.registration.registration import Registration
from touchline.localization.search.pose_search import Mode, PoseSearch
from touchline.types import LinePoints
from touchline_lab.experiments.harness import NONE, Row, follow, interval, rate, seed_range, tell
from touchline_lab.experiments.scenes import FIELD, INK, new_figure, random_place
from touchline_lab.points.bench import RIGHT_M, RIGHT_RAD, PointBench, bench_points
from touchline_lab.points.localizers import point_localizer
from touchline_lab.points.point_set import USUAL_NOISE, PointSet, polar_covariances

FRAMES = 300  # of a set
OWN = "touchline"
OTHERS = ("nubot-mti", "nubot-mcl", "iris-fusion")
SYSTEMS = (OWN, *OTHERS)
BENCHED = SYSTEMS[:2]
MIN_M, MAX_M = 0.5, 6.0
MAX_POINTS, MIN_POINTS = 100, 20  # of lines, in a frame
SPACING_M = 0.02  # of the places on the lines that points are drawn from
START_M, START_RAD = 0.15, math.radians(5.0)  # standard deviations of the pose that a search begins at
COMPASS_RAD = math.radians(5.0)
FAR_M, FAR_RAD = 1.0, math.radians(45.0)  # a start that is far off
FIXED_M = 0.1  # standard deviation of the Cramér-Rao bound up to which points fix a place: half of what is called near


class View(NamedTuple):
    """What is seen in the frames of a set: which share is clutter, and the angle of the view.

    first, among: asked of the likeliest mode, and of all that are kept.
    """

    name: str
    clutter: float = 0.05
    angle_rad: float = 2.0 * math.pi
    first: str = "–"
    among: str = "≥ 98"


FULL = View("full view", first="≥ 99.9")
VIEWS = (
    FULL,
    View("30 % clutter", clutter=0.3, first="≥ 99.5"),
    View("50 % clutter", clutter=0.5, first="≥ 95"),
    View("half of the view", angle_rad=math.pi),
    View("a sector of 120°", angle_rad=math.radians(120.0)),
)
WAYS = {"init": "from a pose near by", "compass": "from a compass alone", "none": "from nothing"}
SURE = (0.85, 0.95)  # probability of the modes that are looked at


class Kept(NamedTuple):
    """Of a search from nothing in every frame: share of the likeliest modes that are right, or right at the other end,
    and of the frames with a right one among all modes, and with one that is near; near_fixed: of those whose points fix
    the place; probabilities (M,) of each place that modes stand for, and is_right (M,) whether it was; median time
    (ms).
    """

    first: float
    among: float
    near: float
    near_fixed: float
    probabilities: FloatArray
    is_right: BoolArray
    median_ms: float


class PointRuns(NamedTuple):
    """benches: of each system and seed. far: share found and median time (ms) of each seed. kept: of each view."""

    benches: dict[str, list[PointBench]]
    far: list[tuple[float, float]]
    kept: dict[str, list[Kept]]


def point_runs(seeds: int) -> PointRuns:
    """Errors beside the bound, capture from afar, and the modes of the search."""
    sets = [drawn_set(FULL, FRAMES, np.random.default_rng([seed, 15])) for seed in seed_range(seeds)]
    benches = {}
    for system in follow(BENCHED, "point sets"):
        benches[system] = [bench_points(points, point_localizer(system, points.field)) for points in sets]
    tell("searches from afar")
    far = [from_far(points, np.random.default_rng([seed, 16])) for seed, points in enumerate(sets)]
    kept = {}
    for view in follow(VIEWS, "searches of the field"):
        drawn = (drawn_set(view, FRAMES, np.random.default_rng([seed, 17])) for seed in seed_range(seeds))
        kept[view.name] = [kept_modes(points) for points in drawn]
    return PointRuns(benches, far, kept)


def point_rows(runs: PointRuns) -> list[Row]:
    """The rows of all of that."""
    rows = [each for way in WAYS for each in _way_rows(way, runs.benches)]
    found, times_ms = zip(*runs.far, strict=True)
    rows.append(row("points, from 1 m and 45° off", "found (%)", "≥ 99.9", {OWN: interval(100.0 * np.array(found))}))
    rows.append(row("", "time (ms)", "≤ 1", {OWN: interval(times_ms)}))
    return [*rows, *(each for view in VIEWS for each in _search_rows(view, runs.kept[view.name]))]


def row(what: str, figure: str, asked: str, cells: Mapping[str, str], less: str = NONE) -> Row:
    """A row of `own`. said: by system. less: ours less the best other's, paired."""
    return (what, figure, asked, *(cells.get(system, NONE) for system in SYSTEMS), less)


def _way_rows(way: str, benches: Mapping[str, Sequence[PointBench]]) -> list[Row]:
    found = {system: [getattr(bench, way) for bench in each] for system, each in benches.items()}
    bound, time_us = ("≤ 1.13", "≤ 60") if way == "init" else (NONE, "≤ 3000")
    times = {system: interval([one.times_bound for one in each], 3) for system, each in found.items()}
    shares = {system: interval([100.0 * one.success for one in each]) for system, each in found.items()}
    spent = {system: interval([one.us_per_update for one in each], 0) for system, each in found.items()}
    return [
        row(f"points, {WAYS[way]}", "error over the bound", bound, times),
        row("", "found (%)", "≥ 99.9", shares),
        row("", "time (µs)", time_us, spent),
    ]


def _search_rows(view: View, kept: Sequence[Kept]) -> list[Row]:
    sure, right = _of_those_given(*SURE, kept)
    first, among, near, fixed = (
        interval([100.0 * share for share in each]) for each in zip(*(one[:4] for one in kept), strict=True)
    )
    low, high = (f"{100 * share:.0f}" for share in SURE)
    figures = (
        ("likeliest right (%)", view.first, first),
        ("right among the modes (%)", view.among, among),
        ("near among the modes (%)", NONE, near),
        ("the same where points fix the place (%)", view.among, fixed),
        (f"right of the modes given {low} to {high} %", f"{low}-{high} %", rate(right, sure)),
        ("time (ms)", "≤ 3", interval([one.median_ms for one in kept])),
    )
    names = [f"points, {view.name}, from nothing", *[""] * (len(figures) - 1)]
    return [row(name, what, asked, {OWN: cell}) for name, (what, asked, cell) in zip(names, figures, strict=True)]


def _of_those_given(low: float, high: float, kept: Sequence[Kept]) -> tuple[int, int]:
    """How many modes were given a probability from low to below high, and how many of them were right."""
    rights = [one.is_right[(one.probabilities >= low) & (one.probabilities < high)] for one in kept]
    return sum(len(right) for right in rights), sum(int(right.sum()) for right in rights)


def picture(runs: PointRuns) -> Figure:
    """Errors over the bound by where a search begins, and how often modes are right by what they are given."""
    figure, (left, right) = new_figure(1, 2, (10.0, 4.2))
    for n, (system, tint) in enumerate(zip(BENCHED, (INK, palette.BLUE), strict=True)):
        for k, way in enumerate(WAYS):
            values = [getattr(bench, way).times_bound for bench in runs.benches[system]]
            at = k + 0.2 * (n - 0.5)
            left.plot([at] * len(values), values, "o", color=tint, markersize=4, label=None if k else system)
    left.axhline(1.0, color=palette.VERMILLION, linewidth=1.0, label="Cramér-Rao bound")
    left.set_ylim(0.95, None)
    left.set_xticks(range(len(WAYS)), list(WAYS.values()))
    left.set_ylabel("error over the bound")
    left.legend(frameon=False, fontsize=8, loc="upper left")
    edges = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.97, 1.01])
    for view, tint in zip(VIEWS, palette.SERIES, strict=False):
        kept = runs.kept[view.name]
        given = np.concatenate([one.probabilities for one in kept])
        bins = [(low, high, _of_those_given(low, high, kept)) for low, high in pairwise(edges)]
        points = [(given[(given >= low) & (given < high)].mean(), ok / n) for low, high, (n, ok) in bins if n >= 20]
        right.plot(*np.array(points).reshape(-1, 2).T, "o-", color=tint, linewidth=1.0, markersize=4, label=view.name)
    right.plot([0, 1], [0, 1], color=INK, linewidth=0.8, linestyle="--")
    right.set(xlabel="probability that modes are given", ylabel="share of them that is right")
    right.legend(frameon=False, fontsize=8)
    return figure


def drawn_set(view: View, frames: int, rng: np.random.Generator) -> PointSet:
    """A set of so many frames."""
    field = open_field(FIELD)
    places = _along_lines(field)
    truth: list[FloatArray] = []
    points: list[LinePoints] = []
    clutter: list[BoolArray] = []
    while len(truth) < frames:
        pose = random_place(field, rng, margin_m=0.5)
        seen = _seen(pose, places, view, rng)
        if seen is not None:
            truth.append(pose.as_array())
            points.append(seen[0])
            clutter.append(seen[1])
    poses = np.array(truth)
    init = poses + rng.standard_normal((frames, 3)) * np.array([START_M, START_M, START_RAD])
    compass = poses[:, 2] + COMPASS_RAD * rng.standard_normal(frames)
    return PointSet(view.name, field, tuple(points), poses, init, compass, tuple(clutter))


def from_far(points: PointSet, rng: np.random.Generator) -> tuple[float, float]:
    """Our own search near a start that is FAR_M and FAR_RAD off: share of the frames found, median time (ms)."""
    search, found, times_s = _search(points.field), [], []
    for k, frame in enumerate(points.points):
        aside = rng.uniform(-math.pi, math.pi)
        off = np.array([FAR_M * math.cos(aside), FAR_M * math.sin(aside), FAR_RAD * rng.choice((-1.0, 1.0))])
        begun_s = time.perf_counter()
        modes = search.near(frame.positions_m, frame.covariances_m2, points.truth[k] + off, 1.2 * FAR_M, 1.2 * FAR_RAD)
        times_s.append(time.perf_counter() - begun_s)
        found.append(bool(modes) and _is_near(modes[0].pose, Pose(*points.truth[k].tolist()), twins=False))
    return float(np.mean(found)), 1e3 * float(np.median(times_s))


def kept_modes(points: PointSet) -> Kept:
    """Our own search from nothing: are the right poses kept, and are the modes as probable as they say?"""
    search, right, near, fixed, judged, times_s = _search(points.field), [], [], [], [], []
    for k, frame in enumerate(points.points):
        truth = Pose(*points.truth[k].tolist())
        begun_s = time.perf_counter()
        modes = search.everywhere(frame.positions_m, frame.covariances_m2)
        times_s.append(time.perf_counter() - begun_s)
        right.append([_stands_for(mode, truth) for mode in modes])
        near.append(any(_is_near(mode.pose, truth) for mode in modes))
        fixed.append(_is_fixed(points, k))
        judged += [(share, _stands_for(mode, truth)) for mode, share in _places(modes)]
    given = np.array(judged)
    return Kept(
        float(np.mean([bool(each) and each[0] for each in right])),
        float(np.mean([any(each) for each in right])),
        float(np.mean(near)),
        float(np.mean(np.array(near)[fixed])),
        given[:, 0],
        given[:, 1] > 0.0,
        1e3 * float(np.median(times_s)),
    )


def _is_fixed(points: PointSet, k: int) -> bool:
    """Whether the points of a frame fix its place: a lone line leaves open where along it the robot stands."""
    try:
        bound = points.bound_of(k)
    except (ValueError, np.linalg.LinAlgError):
        return False
    return float(np.linalg.eigvalsh(bound[:2, :2])[1]) < FIXED_M**2


def _places(modes: Sequence[Mode]) -> list[tuple[Mode, float]]:
    """The places that modes stand for: the likeliest of each, with the probabilities of all that it stands for."""
    left, found = list(modes), []
    while left:
        one = left[0]
        same = [_stands_for(one, other.pose) for other in left]
        found.append((one, sum(other.probability for other, is_same in zip(left, same, strict=True) if is_same)))
        left = [other for other, is_same in zip(left, same, strict=True) if not is_same]
    return found


def _search(field: FieldModel) -> PoseSearch:
    return PoseSearch(field, Registration(field.distance_map()))


def _stands_for(mode: Mode, pose: Pose) -> bool:
    """Whether a mode is near a pose or its twin, or has it within what it says it does not know: 99 % of its normal
    distribution. A lone line tells no place along it, and one mode stands for all.
    """
    from scipy.stats import chi2

    for end in (pose, pose.mirrored()):
        residual = end.as_array() - mode.pose.as_array()
        residual[2] = wrap_angle(float(residual[2]))
        if chi2.cdf(residual @ np.linalg.solve(mode.covariance, residual), 3) < 0.99:
            return True
    return _is_near(mode.pose, pose)


def _is_near(pose: Pose, place: Pose, twins: bool = True) -> bool:
    ends = (pose, pose.mirrored()) if twins else (pose,)
    return any(
        end.distance_to(place) < RIGHT_M and abs(wrap_angle(end.heading - place.heading)) < RIGHT_RAD for end in ends
    )


def _along_lines(field: FieldModel) -> FloatArray:
    """(N, 2) places on all lines, SPACING_M apart, field frame."""
    found = []
    for line in field.polylines():
        lengths = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))))
        at = np.arange(0.0, lengths[-1], SPACING_M)
        found.append(np.column_stack([np.interp(at, lengths, line[:, axis]) for axis in (0, 1)]))
    return np.concatenate(found)


def _seen(pose: Pose, places: FloatArray, view: View, rng: np.random.Generator) -> tuple[LinePoints, BoolArray] | None:
    """Points of one frame, and which of them are clutter; None where too little is in view."""
    offsets = places - pose.as_array()[:2]
    ranges = np.hypot(offsets[:, 0], offsets[:, 1])
    bearings = np.remainder(np.arctan2(offsets[:, 1], offsets[:, 0]) - pose.heading + np.pi, 2.0 * np.pi) - np.pi
    near = (ranges > MIN_M) & (ranges < MAX_M) & (np.abs(bearings) <= 0.5 * view.angle_rad)
    picked = np.flatnonzero(near & (rng.random(len(places)) < MIN_M / np.maximum(ranges, MIN_M)))
    if len(picked) < MIN_POINTS:
        return None
    picked = rng.permutation(picked)[:MAX_POINTS]
    share, fixed_m, turn = USUAL_NOISE
    noisy = ranges[picked] + (share * ranges[picked] + fixed_m) * rng.standard_normal(len(picked))
    turned = bearings[picked] + turn * rng.standard_normal(len(picked))
    false = rng.random(len(picked)) < view.clutter
    noisy[false] = rng.uniform(MIN_M, MAX_M, np.count_nonzero(false))
    turned[false] = 0.5 * view.angle_rad * rng.uniform(-1.0, 1.0, np.count_nonzero(false))
    at = np.ascontiguousarray(np.column_stack((noisy * np.cos(turned), noisy * np.sin(turned))))
    n = len(at)
    return LinePoints(at, polar_covariances(at, USUAL_NOISE), np.ones(n), np.full((n, 2), np.nan)), false
