"""What an entry is worth: figures of each drive, and of all robots of a row with their 95 % intervals."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from touchline.geometry import BoolArray, FloatArray
from touchline_lab.experiments.drives import Track
from touchline_lab.statistics import Interval, over_robots, per_hour

COST_MAX_M, COST_WRONG_M = 1.0, 3.0  # of an image that is not tracked or farther off; of one that is wrong and tracked


@dataclass(frozen=True, slots=True)
class DriveScore:
    """Of one drive. Errors are of all images, those without a pose infinitely far off.

    wrong: images tracked and more than 0.5 m or 0.5 rad off; wrong_times: stretches of them. recover_s: of each moment
    from which the robot has to find itself, the time until it is tracked within 0.3 m and 10°, inf if it never is.
    nees: mean squared error in the measure of the stated covariance over 3; covered: share within its 95 %: of the
    tracked images, NaN where none is stated. cost_m: the one figure. ms, reference: median of an update, and its ratio
    to the reference loop; mb: memory of the process; None where they were not measured.
    """

    images: int
    seconds: float
    median_m: float
    p95_m: float
    heading_rad: float
    within_10cm: float
    within_30cm: float
    available: float
    wrong: int
    wrong_times: int
    recover_s: tuple[float, ...]
    nees: float
    covered: float
    cost_m: float
    ms: float | None = None
    reference: float | None = None
    mb: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """The figures by name."""
        return asdict(self)


def costs_m(track: Track) -> FloatArray:
    """(N,) of an image: its position error (m) plus its heading error (rad), at most 1 m; 1 m where it is not tracked;
    3 m where it is tracked and wrong.
    """
    error = np.minimum(np.nan_to_num(track.distances_m + track.turns_rad, nan=np.inf), COST_MAX_M)
    return np.where(track.wrong, COST_WRONG_M, np.where(track.tracking, error, COST_MAX_M))


def nearer_ends(track: Track, moments_s: Sequence[float]) -> Track:
    """From each moment to the next the end of the field that costs less: one that changes in between is wrong."""
    edges = [-math.inf, *moments_s, math.inf]
    turned, poses = track.turned, track.poses.copy()
    here, there = costs_m(track), costs_m(turned)
    for begin, end in pairwise(edges):
        part = (track.times_s >= begin) & (track.times_s < end)
        if there[part].sum() < here[part].sum():
            poses[part] = turned.poses[part]
    return Track(track.times_s, poses, track.truth, track.tracking, track.covariances)


def score_of(track: Track, moments_s: Sequence[float], either_end: bool = False) -> DriveScore:
    """The figures of a drive."""
    from scipy.stats import chi2

    if either_end:
        track = nearer_ends(track, moments_s)
    distances = np.nan_to_num(track.distances_m, nan=np.inf)
    heading = np.nan_to_num(track.turns_rad, nan=np.inf)
    stated = track.tracking & np.isfinite(track.covariances).all(axis=(1, 2)) if len(track.covariances) else None
    squares = _squares(track.part(stated)) if stated is not None and stated.any() else np.zeros(0)
    wrong = track.wrong
    times_s = track.times_s
    return DriveScore(
        images=len(times_s),
        seconds=float(times_s[-1] - times_s[0]),
        median_m=float(np.quantile(distances, 0.5, method="higher")),
        p95_m=float(np.quantile(distances, 0.95, method="higher")),
        heading_rad=float(np.quantile(heading, 0.5, method="higher")),
        within_10cm=float(np.mean(distances <= 0.1)),
        within_30cm=float(np.mean(distances <= 0.3)),
        available=float(track.tracking.mean()),
        wrong=int(wrong.sum()),
        wrong_times=int(np.count_nonzero(np.diff(wrong.astype(np.int8), prepend=0) == 1)),
        recover_s=tuple(_recovered(track.found, times_s, moment) for moment in moments_s),
        nees=float(squares.mean()) / 3.0 if len(squares) else math.nan,
        covered=float(np.mean(chi2.cdf(squares, 3) <= 0.95)) if len(squares) else math.nan,
        cost_m=float(costs_m(track).mean()),
    )


def _squares(track: Track) -> FloatArray:
    try:
        return track.squares
    except np.linalg.LinAlgError:  # a program may state a covariance of nothing
        return np.full(len(track.times_s), np.inf)


def _recovered(found: BoolArray, times_s: FloatArray, moment_s: float) -> float:
    later = found & (times_s >= moment_s)
    return float(times_s[int(np.argmax(later))] - moment_s) if later.any() else math.inf


def row_figures(scores: Sequence[DriveScore]) -> dict[str, Interval]:
    """The figures of a row over its robots."""
    wrong = per_hour(sum(one.wrong_times for one in scores), sum(one.seconds for one in scores))
    waits = [wait for one in scores for wait in one.recover_s]
    figures = {
        name: over_robots([getattr(one, name) for one in scores])
        for name in ("median_m", "p95_m", "within_10cm", "within_30cm", "available", "nees", "covered")
    }
    median_s = float(np.quantile(waits, 0.5, method="higher")) if waits else math.nan
    most_s = max(waits, default=math.nan)
    return figures | {
        "wrong_per_hour": wrong,
        "recover_s": Interval(median_s, min(waits, default=math.nan), most_s),
        "cost_m": over_robots([one.cost_m for one in scores], np.mean),
    }
