"""xiong-samples (figure 7) and xiong-convergence (figure 9): a robot near (0, -2) finds itself among 315 samples."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from touchline.field import open_field
from touchline.geometry import FloatArray, Pose
from touchline.localization.registration.weights import precision_weights
from touchline.published.nubot.global_search import GlobalSearch, SearchRound
from touchline.published.nubot.matcher import Matcher
from touchline.published.nubot_mti.system import NubotMtiSettings
from touchline.systems import paper_settings
from touchline_lab.experiments import harness
from touchline_lab.experiments.scenes import FIELD, MAGENTA, RED, new_figure, points_from

PLACE = (0.05, -1.92)  # where the paper's robot found itself; its samples lie at whole metres
NEAR_M = 0.5
SETTLED_M = 0.02
PAPER_C_M = 2.55  # the paper's C = 255, taken for centimetres


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """One search: the true pose, the round that found it, the pose that was taken."""

    truth: Pose
    round: SearchRound
    taken: Pose


def searches(seeds: int, c_m: float | None = None, ideal: bool = False, paper: bool = False) -> list[Search]:
    """A robot at the paper's place, facing anywhere, with a compass that errs by a few degrees.

    c_m: width of the error function (m), by default that of the settings. ideal: robots as designed instead of as
    built. paper: the settings of the system's preset.
    """
    field = open_field(FIELD)
    settings = paper_settings("nubot-mti") if paper else NubotMtiSettings()
    assert isinstance(settings, NubotMtiSettings)
    matching = settings.matching if c_m is None else settings.matching.model_copy(update={"c_m": c_m})
    search = GlobalSearch(Matcher(field.distance_map(), matching), field.length, field.width, settings.global_search)
    found = []
    for seed in harness.follow(harness.seed_range(seeds), "searches"):
        rng = np.random.default_rng([seed, 7])
        truth = Pose(*PLACE, float(rng.uniform(-math.pi, math.pi)))
        points = points_from(truth, seed, ideal)
        compass = truth.heading + math.radians(3.0) * float(rng.standard_normal())
        weights = precision_weights(points, settings.weights)
        fix = search.locate(points.positions_m, weights, compass, record=True)
        assert fix is not None, "the robot's own place is always among the samples"
        found.append(Search(truth, fix.rounds[0], fix.match.pose))
    return found


def xiong_samples(seeds: int) -> harness.ExperimentResult:
    """Figure 7: the mean error of every sample, the five best of them."""
    found, paper, ideal = searches(seeds), searches(seeds, paper=True), searches(seeds, ideal=True)
    right = [search.taken.distance_to(search.truth) < NEAR_M for search in found]
    return harness.ExperimentResult(
        "Figure 7 of Xiong et al.: the mean error of each of the 315 samples of a robot near (0, -2) m",
        (
            "robot", "samples", "best sample is off by", "its error", "of the five best within 1 m",
            "pose is off by: paper", "its form here", "ours", "ideal robot",
        ),
        [(str(seed), *_cells(*forms)) for seed, forms in enumerate(zip(found, paper, ideal, strict=True))],
        harness.Headline("robot near (0, -2) m found among 315 samples", "found, 9 cm from (0, -2) m",
                 f"{harness.rate(sum(right), len(right))} found, {_off_by(found)} cm off; its form {_off_by(paper)} "
                 f"cm; ideal {_off_by(ideal)} cm"),
        (
            "Robots as built, one per seed, who stand there among eight others, at the observation level. The paper's "
            "picture is of one place; the error is small there and near the penalty areas, as in ours. "
            "Red: the sample with the least error; magenta: the next four; the darker, the smaller the error. Its form "
            "here: the same with the system's preset `paper`.",
        ),
        (("map", _map_figure(found[0])),),
    )  # fmt: skip


def _cells(search: Search, paper: Search, ideal: Search) -> harness.Row:
    order = np.argsort(search.round.errors)
    gaps_m = np.hypot(*(search.round.samples_m[order[:5]] - PLACE).T)
    off = [f"{100 * each.taken.distance_to(each.truth):.2f} cm" for each in (paper, search, ideal)]
    error = f"{search.round.errors[order[0]]:.4f}"
    return str(len(order)), f"{gaps_m[0]:.2f} m", error, f"{np.count_nonzero(gaps_m < 1.0)} of 5", "9 cm", *off


def _off_by(found: list[Search]) -> str:
    """How far the pose taken is off (cm), over the robots."""
    return harness.interval([100 * search.taken.distance_to(search.truth) for search in found])


def _map_figure(search: Search) -> Figure:
    figure, (axes,) = new_figure(size_in=(8.0, 5.8), field=open_field(FIELD))
    errors, places = search.round.errors, search.round.samples_m
    order = np.argsort(errors)
    shades = axes.scatter(places[:, 0], places[:, 1], c=errors, cmap="gray", s=42, zorder=2, linewidths=0)
    for chosen, colour in ((order[1:5], MAGENTA), (order[:1], RED)):
        axes.scatter(places[chosen, 0], places[chosen, 1], color=colour, s=46, zorder=3)
    axes.plot(search.truth.x, search.truth.y, "x", color="black", markersize=8, zorder=4)
    figure.colorbar(shades, ax=axes, shrink=0.8, label="mean error, equation (2)")
    return figure


class Descent(NamedTuple):
    """One descent of RPROP: from where to where (m), how far off that is (m), the error at its end, steps.

    rises: whether the first step leads beyond the pose, so that the error grows.
    """

    start_m: tuple[float, float]
    end_m: tuple[float, float]
    off_m: float
    after: float
    steps: int
    rises: bool

    @property
    def right(self) -> bool:
        """Whether it ends where the robot is."""
        return self.off_m < NEAR_M


def descents(search: Search) -> list[Descent]:
    """The descents from the five best samples, by the error that they end with."""
    found = []
    for candidate in sorted(search.round.candidates, key=lambda candidate: candidate.error):
        (x, y, *_), end = candidate.iterations[0].tolist(), candidate.pose
        off_m, steps = end.distance_to(search.truth), _steps_until_settled(candidate.iterations)
        rises = bool(candidate.iterations[1, 3] > candidate.iterations[0, 3])
        found.append(Descent((x, y), (end.x, end.y), off_m, candidate.error, steps, rises))
    return found


def xiong_convergence(seeds: int) -> harness.ExperimentResult:
    """Figure 9: RPROP from the five best samples, with c of our own and with the paper's."""
    found = {
        "ours": searches(seeds),
        "ours, c = 2.55 m": searches(seeds, PAPER_C_M),
        "its form here, c = 2.55 m": searches(seeds, PAPER_C_M, paper=True),
        "its form here": searches(seeds, paper=True),
        "ours, ideal robot": searches(seeds, ideal=True),
    }
    ends = {name: [d for search in each for d in descents(search)] for name, each in found.items()}
    paper = ("the paper", "5", "2 of 5", "about 10", "1 of 2", "0.006", "above 0.018", harness.NONE, "8.2, 8.8, 9.3 m")
    rows = {name: _summary(each) for name, each in ends.items()}
    narrow, wide = (", ".join((row[2], *row[4:6])) for row in (rows["ours"], rows["ours, c = 2.55 m"]))
    return harness.ExperimentResult(
        "Figure 9 of Xiong et al.: RPROP from the five best samples of a robot near (0, -2) m",
        ("form", "descents", "right", "steps until settled", "error rises first", "error when right",
         "least error when wrong", "off by when right", "off by when wrong"),
        (paper, *((name, *row) for name, row in rows.items()), *_first_robot(found["ours"][0])),
        harness.Headline("steps until settled; error when right, least when wrong", "about 10; 0.006, above 0.018",
                 f"c = 0.25 m: {narrow}; c = 2.55 m: {wide}"),
        (
            "Robots as built, one per seed. Settled: from then on within 2 cm of where the descent ends. Errors are of "
            "the error function with c = 0.25 m where nothing else is said; the paper has C = 255 without a unit: in "
            "centimetres it is 2.55 m, like with like. Its form here: with the system's preset `paper`. Error rises "
            "first: of the descents that end right, those whose first step leads beyond the pose; the paper's A, with "
            "a rather large first step.",
        ),
        (("errors", _convergence_figure({name: found[name][0] for name in ("ours", "its form here, c = 2.55 m")})),),
    )  # fmt: skip


def _summary(every: list[Descent]) -> harness.Row:
    right, wrong = [d for d in every if d.right], [d for d in every if not d.right]
    decimals = 4 if not right or np.mean([d.after for d in right]) > 1e-3 else 5
    return (
        str(len(every)), f"{len(right)} of {len(every)}", harness.spread([float(d.steps) for d in right], 1),
        f"{sum(d.rises for d in right)} of {len(right)}",
        harness.spread([d.after for d in right], decimals),
        f"{min(d.after for d in wrong):.4f}" if wrong else harness.NONE,
        f"{harness.spread([100.0 * d.off_m for d in right])} cm", f"{harness.spread([d.off_m for d in wrong], 1)} m",
    )  # fmt: skip


def _first_robot(search: Search) -> list[harness.Row]:
    """A row for each of its descents."""
    return [
        (f"first robot from ({d.start_m[0]:.1f}, {d.start_m[1]:.1f}) to ({d.end_m[0]:.2f}, {d.end_m[1]:.2f}) m", "1",
         "yes" if d.right else "no", str(d.steps), "yes" if d.rises else "no",
         *((f"{d.after:.4f}", harness.NONE) if d.right else (harness.NONE, f"{d.after:.4f}")),
         *((f"{100 * d.off_m:.1f} cm", harness.NONE) if d.right else (harness.NONE, f"{d.off_m:.1f} m")))
        for d in descents(search)
    ]  # fmt: skip


def _steps_until_settled(trace: FloatArray) -> int:
    """The step from which all poses stay within 2 cm of the best one; trace (K, 4): x, y, heading, error."""
    best = trace[int(np.argmin(trace[:, 3]))]
    outside = np.hypot(trace[:, 0] - best[0], trace[:, 1] - best[1]) > SETTLED_M
    return int(np.nonzero(outside)[0][-1]) + 1 if outside.any() else 0


def _convergence_figure(found: Mapping[str, Search]) -> Figure:
    titles, labels = [f"first robot, {name}" for name in found], ("RPROP step", "mean error, equation (2)")
    figure, every = new_figure(1, len(found), (11.0, 4.2), titles, labels)
    for axes, search in zip(every, found.values(), strict=True):
        for letter, candidate in zip("ABCDE", sorted(search.round.candidates, key=lambda c: c.error), strict=False):
            off_m = candidate.pose.distance_to(search.truth)
            label = f"{letter}: ends at ({candidate.pose.x:.2f}, {candidate.pose.y:.2f})"
            axes.plot(candidate.iterations[:, 3], "-" if off_m < NEAR_M else "--", label=label)
        axes.set_ylim(bottom=0.0)
        axes.legend(frameon=False)
    return figure
