"""Global localization by a grid of samples, and when its pose is believed (Xiong et al., section 4.1)."""

from __future__ import annotations

from touchline.localization.fusion.failure import MAX_HEADING_ERROR_RAD
from touchline.localization.fusion.global_localizer import Localization, Prediction
from touchline.localization.fusion.match_input import MatchInput, refine_with_tilt
from touchline.localization.matching.global_search import GlobalFix, GlobalSearch, Region
from touchline.localization.matching.matcher import Match
from touchline.motion import Motion
from touchline.types import Hypothesis

EQUAL_FACTOR = 1.25  # a pose is as good as another up to this factor, plus EQUAL_MARGIN, above its mean error
EQUAL_MARGIN = 0.02  # what noise alone changes in the mean error
_SAME_POSE_M = 0.5  # nearer than that two refined samples are one hypothesis


class GridLocalizer:
    """Takes the best of the search, or stays with the tracked pose unless another is better.

    A pose that is not accepted is followed as the best there is, and confirmed once it has held against the search for
    some frames in a row.
    """

    def __init__(self, search: GlobalSearch) -> None:
        self.search = search
        self.reset()

    def reset(self) -> None:
        """Forget how often a pose has held against the search."""
        self._confirmations = 0

    def predict(self, motion: Motion) -> None:
        """Nothing is carried on: every frame is searched anew."""

    def localize(self, view: MatchInput, prediction: Prediction, region: Region | None = None) -> Localization | None:
        """Search the whole field, or a region of it."""
        s, tracked = self.search.settings, prediction.match if self.search.settings.paper.confirmed else None
        if tracked is not None and not view.heading_is_plausible(tracked.pose.heading, MAX_HEADING_ERROR_RAD):
            tracked = None
        fix = self.search.locate_any_heading(view.positions_m, view.weights, view.heading_rad, region)
        if tracked is not None and (fix is None or tracked.error <= _equal_error(fix.match.error)):
            match, accepted, kept = tracked, tracked.error < s.accepts_below, True
            self._confirmations += 1
        elif fix is not None:
            match = refine_with_tilt(self.search.matcher, view, fix.match.pose.as_array(), fix.match.error)
            accepted, kept = fix.accepted, False
            self._confirmations = 0
        else:
            return None
        confirmed = accepted or self._confirmations >= s.confirmations or not s.paper.confirmed
        if confirmed:
            self._confirmations = 0
        others = () if fix is None else self._hypotheses(view, fix, match)
        return Localization(match.pose, match.covariance, match, confirmed, True, kept, others)

    def _hypotheses(self, view: MatchInput, fix: GlobalFix, chosen: Match) -> tuple[Hypothesis, ...]:
        """Refined samples elsewhere that explain the points nearly as well as the chosen pose."""
        matcher, positions_m = self.search.matcher, view.positions_m
        found: list[Hypothesis] = []
        for candidate in sorted(fix.rounds[-1].candidates, key=lambda c: c.error):
            known = (chosen.pose, *(other.pose for other in found))
            elsewhere = all(candidate.pose.distance_to(pose) > _SAME_POSE_M for pose in known)
            if elsewhere and candidate.error <= _equal_error(chosen.error):
                match = matcher.assess(positions_m, view.weights, candidate.pose.as_array(), candidate.error)
                found.append(Hypothesis(candidate.pose, match.mean_distance_m, covariance=match.covariance))
        return tuple(found)


def _equal_error(error: float) -> float:
    """Mean error up to which another pose explains the points as well as one of this mean error."""
    return EQUAL_FACTOR * error + EQUAL_MARGIN
