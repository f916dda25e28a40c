"""xiong-samples (figure 7) and xiong-convergence (figure 9): a robot near (0, -2) finds itself among 315 samples."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from touchline.experiments.progress import follow
from touchline.experiments.result import ExperimentResult, Headline, percent, spread
from touchline.experiments.scenes import FIELD, MAGENTA, RED, field_axes, new_figure, the_views
from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.matching.global_search import Candidate, GlobalSearch, SearchRound
from touchline.localization.matching.matcher import Matcher, MatchingSettings
from touchline.localization.matching.weights import WeightSettings, precision_weights

PLACE = (0.05, -1.92)  # where the paper's robot found itself; its samples lie at whole metres
NEAR_M = 0.5
SETTLED_M = 0.02
PAPER_C_M = 2.55  # the paper's C = 255, taken for centimetres


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """One search: the true pose, the round that found it, the line points seen (N, 2), the pose that was taken."""

    truth: Pose
    round: SearchRound
    points: FloatArray
    taken: Pose


def searches(seeds: int, c_m: float = MatchingSettings().c_m) -> list[Search]:
    """A robot at the paper's place, facing anywhere, with a compass that errs by a few degrees.

    c_m: width of the error function (m).
    """
    field = open_field(FIELD)
    search = GlobalSearch(Matcher(field.distance_map(), MatchingSettings(c_m=c_m)), field.length, field.width)
    found = []
    for seed in follow(range(seeds), "searches"):
        rng = np.random.default_rng([seed, 7])
        truth = Pose(*PLACE, float(rng.uniform(-math.pi, math.pi)))
        points = the_views().observe(truth, rng)
        compass = truth.heading + math.radians(3.0) * float(rng.standard_normal())
        weights = precision_weights(points, WeightSettings())
        fix = search.locate(points.positions_m, weights, compass, record=True)
        assert fix is not None, "the robot's own place is always among the samples"
        found.append(Search(truth, fix.rounds[0], points.positions_m, fix.match.pose))
    return found


def xiong_samples(seeds: int) -> ExperimentResult:
    """Figure 7: the mean error of every sample, the five best of them."""
    found = searches(seeds)
    rows = []
    for seed, search in enumerate(found):
        order = np.argsort(search.round.errors)
        away = np.hypot(*(search.round.samples_m[order[:5]] - PLACE).T)
        rows.append(
            (
                str(seed), str(len(order)), f"{away[0]:.2f} m", f"{search.round.errors[order[0]]:.4f}",
                f"{np.count_nonzero(away < 1.0)} of 5", f"{100 * search.taken.distance_to(search.truth):.2f} cm",
            )
        )  # fmt: skip
    right = [search.taken.distance_to(search.truth) < NEAR_M for search in found]
    return ExperimentResult(
        "xiong-samples",
        "Figure 7 of Xiong et al.: the mean error of each of the 315 samples of a robot near (0, -2) m",
        seeds,
        ("seed", "samples", "best sample is off by", "its error", "of the five best within 1 m", "pose is off by"),
        tuple(rows),
        Headline("robot near (0, -2) m found among 315 samples", "found, 8 cm off",
                 f"{percent(right)} found, {spread([100 * s.taken.distance_to(s.truth) for s in found])} cm off"),
        (
            "The paper's picture is of one place; the error is small there and near the penalty areas, as in ours. "
            "Red: the sample with the least error; magenta: the next four; the darker, the smaller the error.",
        ),
        (("map", _map_figure(found[0])),),
    )  # fmt: skip


def _map_figure(search: Search) -> Figure:
    field = open_field(FIELD)
    figure, (axes,) = new_figure(width_in=8.0, height_in=5.8)
    field_axes(axes, field)
    errors, places = search.round.errors, search.round.samples_m
    order = np.argsort(errors)
    shades = axes.scatter(places[:, 0], places[:, 1], c=errors, cmap="gray", s=42, zorder=2, linewidths=0)
    for chosen, colour in ((order[1:5], MAGENTA), (order[:1], RED)):
        axes.scatter(places[chosen, 0], places[chosen, 1], color=colour, s=46, zorder=3)
    axes.plot(search.truth.x, search.truth.y, "x", color="black", markersize=8, zorder=4)
    figure.colorbar(shades, ax=axes, shrink=0.8, label="mean error, equation (2)")
    return figure


def xiong_convergence(seeds: int) -> ExperimentResult:
    """Figure 9: RPROP from the five best samples, with c of our own and with the paper's."""
    found = searches(seeds)
    rows, said = [], []
    for c_m, each in ((MatchingSettings().c_m, found), (PAPER_C_M, searches(seeds, PAPER_C_M))):
        ends = [(seed, search, candidate) for seed, search in enumerate(each) for candidate in _by_error(search)]
        rows += [_convergence_row(c_m, seed, search, candidate) for seed, search, candidate in ends]
        right = [_is_near(search, candidate) for _, search, candidate in ends]
        steps = [float(_steps_until_settled(c.iterations)) for (_, _, c), near in zip(ends, right, strict=True) if near]
        errors = [c.error for (_, _, c), near in zip(ends, right, strict=True) if near]
        wrong = [c.error for (_, _, c), near in zip(ends, right, strict=True) if not near]
        least = f"{min(wrong):.4f}" if wrong else "none"
        said.append(f"c = {c_m:g} m: {spread(steps, 1)}; {spread(errors, 5 if c_m > 1.0 else 4)}, {least}")
    return ExperimentResult(
        "xiong-convergence",
        "Figure 9 of Xiong et al.: RPROP from the five best samples of a robot near (0, -2) m",
        seeds,
        ("c (m)", "seed", "start (m)", "end (m)", "off by", "error before", "after", "steps to 2 cm"),
        tuple(rows),
        Headline("steps until settled; error when right, least when wrong", "about 10; 0.006, above 0.018",
                 " · ".join(said)),
        (
            "Settled: from then on within 2 cm of where the descent ends. Errors are of the error function with the c "
            "named; the paper has C = 255 without a unit: taken for centimetres it is 2.55 m, like with like.",
        ),
        (("errors", _convergence_figure(found[0])),),
    )  # fmt: skip


def _by_error(search: Search) -> list[Candidate]:
    return sorted(search.round.candidates, key=lambda candidate: candidate.error)


def _is_near(search: Search, candidate: Candidate) -> bool:
    return candidate.pose.distance_to(search.truth) < NEAR_M


def _convergence_row(c_m: float, seed: int, search: Search, candidate: Candidate) -> tuple[str, ...]:
    off_m, start = candidate.pose.distance_to(search.truth), candidate.iterations[0]
    return (
        f"{c_m:g}", str(seed), f"({start[0]:.1f}, {start[1]:.1f})",
        f"({candidate.pose.x:.2f}, {candidate.pose.y:.2f})",
        f"{100 * off_m:.1f} cm" if _is_near(search, candidate) else "elsewhere", f"{start[3]:.4f}",
        f"{candidate.error:.4f}", str(_steps_until_settled(candidate.iterations)),
    )  # fmt: skip


def _steps_until_settled(trace: FloatArray) -> int:
    """The step from which all poses stay within 2 cm of the best one; trace (K, 4): x, y, heading, error."""
    best = trace[int(np.argmin(trace[:, 3]))]
    away = np.hypot(trace[:, 0] - best[0], trace[:, 1] - best[1]) > SETTLED_M
    return int(np.nonzero(away)[0][-1]) + 1 if away.any() else 0


def _convergence_figure(search: Search) -> Figure:
    figure, (axes,) = new_figure()
    for letter, candidate in zip("ABCDE", sorted(search.round.candidates, key=lambda c: c.error), strict=False):
        off_m = candidate.pose.distance_to(search.truth)
        label = f"{letter}: ends at ({candidate.pose.x:.2f}, {candidate.pose.y:.2f})"
        axes.plot(candidate.iterations[:, 3], "-" if off_m < NEAR_M else "--", label=label)
    axes.set_xlabel("RPROP step")
    axes.set_ylabel("mean error, equation (2)")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False)
    return figure
