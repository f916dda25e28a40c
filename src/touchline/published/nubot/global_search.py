"""Global localization: a grid of samples over the field, the best of them refined (Xiong et al., section 4.1)."""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.field.distance_map import DistanceMap
from touchline.field.region import Region
from touchline.geometry import FloatArray, Pose, as_pose, wrap_angle
from touchline.localization.search.pose_grid import sample_positions
from touchline.published.nubot.kernels import grid_errors
from touchline.published.nubot.matcher import Match, Matcher, checked_points

BEYOND_M = 1.0  # how far beyond the field the samples reach; the paper's
SHIFT_M = 0.35  # shift of all samples in x and in y from round to round; the paper's
# width c of the error function that ranks the samples: the paper's C = 255 read in cm, its unit of length; the nearest
# sample is up to 0.7 m away, where the 0.25 m of matching can't tell near from far
SAMPLE_C_M = 2.55
# the same in the rounds after one that found nothing: at the edge of the field with a part of the view hidden, 2.55 m
# ranks most places amid more lines before the right one
LATER_SAMPLE_C_M = 0.5
EQUAL_FACTOR = 1.25  # a pose is as good as another up to this factor, plus EQUAL_MARGIN, above its mean error
EQUAL_MARGIN = 0.02  # what noise alone changes in the mean error
SAME_POSE_M = 0.5  # nearer than that two refined samples are one hypothesis
OFF_FIELD_M = 2.0  # how far beyond the field's lines no robot stands: the carpet ends before
PAPER_ERROR = 0.012  # mean error with this c between the paper's right poses (0.006) and wrong ones (above 0.018)


class GlobalSearchPaper(Settings):
    """Switches to the paper's exact form."""

    one_c: bool = added(
        False,
        paper=True,
        description="true as in the paper: one c for ranking the samples, for matching and for judging it, its C = 255 "
        "in cm, 2.55 m; a pose is accepted below an error of 0.012 then, between the paper's 0.006 when right and "
        "0.018 when wrong. false: matching.c_m for matching and accepted_error, and from the second round on a c of "
        "0.5 m ranks the samples",
    )
    near_compass: bool = added(
        True,
        paper=False,
        description="refined poses keep heading_tolerance_rad to the compass; false as in the paper: they turn freely",
    )
    confirmed: bool = added(
        True,
        paper=False,
        description="a pose that is not accepted must hold against the search for some frames (confirmations), and the "
        "pose that failed is kept unless another is better; false as in the paper: the best of three rounds is it",
    )


class GlobalSearchSettings(Settings):
    """The sampled search of section 4.1. On the 18 x 12 m field it has 315 samples."""

    spacing_m: float = Field(1.0, gt=0, description="distance of the samples (m); the paper's")
    candidates: int = Field(
        5, ge=1, le=100_000, description="samples with the least error that are refined; the paper's"
    )
    rounds: int = Field(3, ge=1, le=1_000, description="searches before the best of all is taken; the paper's")
    accepted_error: float = Field(
        0.1,
        gt=0,
        le=1,
        description="weighted mean error with matching's c below which a pose is accepted. Clutter of 5 % and 2 % "
        "range noise leave 0.06 (median); wrong poses of equal error are rare below 0.1, frequent above",
    )
    confirmations: int = Field(
        3,
        ge=1,
        le=10_000,
        description="frames in a row in which a pose that was not accepted must hold against the search before it is "
        "believed: real calibrations may leave more than accepted_error everywhere",
    )
    heading_tolerance_rad: float = Field(
        0.6,
        gt=0,
        description="largest difference of the refined heading from the compass (rad): twice the worst of usual "
        "compass errors, and far from the quarter turn at which lines can be mistaken",
    )
    paper: GlobalSearchPaper = GlobalSearchPaper()

    @property
    def accepts_below(self) -> float:
        """Mean error with the c of matching below which a pose is accepted."""
        return PAPER_ERROR if self.paper.one_c else self.accepted_error


# Without a compass the whole circle is searched; matching turns by half a step and more.
_ALL_HEADINGS_RAD = tuple(float(heading) for heading in np.arange(24) * np.pi / 12.0 - np.pi)


@dataclass(frozen=True, eq=False, slots=True)
class Candidate:
    """A refined sample: its pose, its mean error with matching's c, and the record (K, 4) of the descent."""

    pose: Pose
    error: float
    iterations: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class SearchRound:
    """One round, for plots. samples_m (K, 2): positions; errors (K,): mean error of each; then the refined best."""

    samples_m: FloatArray
    errors: FloatArray
    candidates: tuple[Candidate, ...]


@dataclass(frozen=True, eq=False, slots=True)
class GlobalFix:
    """Result of a global search: the best match, whether its error passed the threshold, and the rounds it took.

    symmetric: whether the pose at the other end of the field, which looks the same, is no other pose.
    """

    match: Match
    accepted: bool
    rounds: tuple[SearchRound, ...]
    symmetric: bool = True

    def rivals(self, pose: Pose, error: float, worst_error: float | None = None) -> tuple[Candidate, ...]:
        """Refined samples elsewhere that explain the points about as well as a pose of this mean error; best first.

        worst_error: mean error up to which they do; None: `equal_error`.
        """
        worst = equal_error(error) if worst_error is None else worst_error
        known = [pose, pose.mirrored()] if self.symmetric else [pose]
        found: list[Candidate] = []
        candidates = (candidate for each in self.rounds for candidate in each.candidates)
        for candidate in sorted(candidates, key=lambda c: c.error):
            if candidate.error > worst:
                break
            if all(candidate.pose.distance_to(other) > SAME_POSE_M for other in known):
                found.append(candidate)
                known.append(candidate.pose)
        return tuple(found)


class GlobalSearch:
    """Finds the pose on one field from line points and a compass heading."""

    def __init__(
        self,
        matcher: Matcher,
        length_m: float,
        width_m: float,
        settings: GlobalSearchSettings | None = None,
        symmetric: bool = True,
    ) -> None:
        """length_m, width_m: of the field, to its lines. symmetric: half a turn of it shows the same lines."""
        self.symmetric = symmetric
        self._reach_m = (0.5 * length_m + OFF_FIELD_M, 0.5 * width_m + OFF_FIELD_M)
        self.settings = settings or GlobalSearchSettings()
        self.matcher = matcher
        self.samples_m = sample_positions(length_m, width_m, self.settings.spacing_m, BEYOND_M)

    def locate(
        self,
        positions_m: FloatArray,
        weights: FloatArray,
        compass_rad: float,
        region: Region | None = None,
        record: bool = False,
    ) -> GlobalFix | None:
        """Search the field, or a region of it; None if no refined candidate keeps the compass heading and region.

        positions_m (N, 2) robot frame; weights (N,) that sum to 1; record: keep the refinements' iterations.
        """
        points, weights = checked_points(positions_m, weights)
        rounds: list[SearchRound] = []
        best: Candidate | None = None
        accepted = False
        while not accepted and len(rounds) < self.settings.rounds:
            samples = self._samples(len(rounds) * SHIFT_M, region)
            c_m = LATER_SAMPLE_C_M if rounds and not self.settings.paper.one_c else SAMPLE_C_M
            errors = sample_errors(self.matcher.distance_map, points, samples, compass_rad, c_m)
            rounds.append(self._refined(points, weights, SearchRound(samples, errors, ()), compass_rad, region, record))
            known = rounds[-1].candidates if best is None else (best, *rounds[-1].candidates)
            best = min(known, key=lambda candidate: candidate.error, default=None)
            accepted = best is not None and best.error < self.settings.accepts_below
        if best is None:
            return None
        match = self.matcher.assess(
            points, weights, best.pose.as_array(), best.error, best.iterations if record else None
        )
        return GlobalFix(match, accepted, tuple(rounds), self.symmetric)

    def locate_any_heading(
        self, positions_m: FloatArray, weights: FloatArray, compass_rad: float | None, region: Region | None = None
    ) -> GlobalFix | None:
        """As `locate`; without a compass the best of 24 headings all around."""
        headings = _ALL_HEADINGS_RAD if compass_rad is None else (compass_rad,)
        tried = (self.locate(positions_m, weights, heading, region) for heading in headings)
        fixes = [fix for fix in tried if fix is not None]
        if len(fixes) < 2:
            return fixes[0] if fixes else None
        best = min(fixes, key=lambda fix: fix.match.error)
        return replace(best, rounds=tuple(each for fix in fixes for each in fix.rounds))

    def covers(self, pose: Pose) -> bool:
        """Whether a robot may stand there: on the field, or not far beyond."""
        return abs(pose.x) <= self._reach_m[0] and abs(pose.y) <= self._reach_m[1]

    def _samples(self, shift_m: float, region: Region | None) -> FloatArray:
        samples = self.samples_m + shift_m
        if region is None:
            return samples
        x, y = samples[:, 0], samples[:, 1]
        reach_m = 0.5 * self.settings.spacing_m  # a sample just outside may be the nearest to a pose just inside
        inside = (x >= region.min_x - reach_m) & (x <= region.max_x + reach_m)
        inside &= (y >= region.min_y - reach_m) & (y <= region.max_y + reach_m)
        return np.asarray(samples[inside])

    def _refined(
        self,
        points: FloatArray,
        weights: FloatArray,
        ranked: SearchRound,
        compass_rad: float,
        region: Region | None,
        record: bool,
    ) -> SearchRound:
        """A round with the best of its samples refined."""
        candidates = []
        for k in np.argsort(ranked.errors)[: self.settings.candidates]:
            start = np.array([*ranked.samples_m[k], compass_rad])
            refined, error, trace = self.matcher.descend(points, weights, start, record)
            pose = as_pose(refined)
            heading_inconsistent = abs(wrap_angle(pose.heading - compass_rad)) > self.settings.heading_tolerance_rad
            free = not self.settings.paper.near_compass
            if (free or not heading_inconsistent) and (region is None or region.contains(pose)):
                candidates.append(Candidate(pose, error, trace))
        return replace(ranked, candidates=tuple(candidates))


def sample_errors(
    distance_map: DistanceMap, points: FloatArray, samples_m: FloatArray, heading_rad: float, c_m: float
) -> FloatArray:
    """Mean error (K,) of standing at each of the samples (K, 2) with one heading: equation (2).

    All points count alike, as in the paper: half a metre from the truth, their noise no longer matters.
    """
    found = grid_errors(points, distance_map.table, samples_m, np.array([heading_rad]), c_m)
    return np.asarray(found[0])


def equal_error(error: float) -> float:
    """Mean error up to which another pose explains the points as well as one of this mean error."""
    return EQUAL_FACTOR * error + EQUAL_MARGIN
