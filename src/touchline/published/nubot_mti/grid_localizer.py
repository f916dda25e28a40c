"""Global localization by a grid of samples, and when its pose is believed (Xiong et al., section 4.1)."""

from touchline.field.region import Region
from touchline.published.nubot.doubt import stands_alone
from touchline.published.nubot.failure import MAX_HEADING_ERROR_RAD
from touchline.published.nubot.global_localizer import Localization, Prediction
from touchline.published.nubot.global_search import GlobalFix, GlobalSearch, equal_error
from touchline.published.nubot.match_input import MatchInput, refine_with_tilt
from touchline.published.nubot.matcher import Match
from touchline.published.nubot.pose_filter import fused_covariance
from touchline.types import Hypothesis

MAX_HYPOTHESES = 5  # that are named beside the pose: those refined in one round
# frames that a rival counts after it was last seen: of a lone line the search comes to other places now and then only
RIVAL_FRAMES = 5


class GridLocalizer:
    """Takes the best of the search, or stays with the tracked pose unless another is better.

    A pose that is not accepted is followed as the best there is, and confirmed once it has held against the search for
    some frames in a row.
    """

    def __init__(self, search: GlobalSearch, doubt: bool = True) -> None:
        """doubt: a pose is confirmed only if no other fits as well; the papers take the best."""
        self.search = search
        self.doubt = doubt
        self.reset()

    def reset(self) -> None:
        """Forget how often a pose has held against the search, and its rivals."""
        self._confirmations = self._rivalled = 0

    def localize(self, view: MatchInput, prediction: Prediction, region: Region | None = None) -> Localization | None:
        """Search the whole field, or a region of it."""
        s, tracked = self.search.settings, prediction.match if self.search.settings.paper.confirmed else None
        if tracked is not None and not view.heading_is_plausible(tracked.pose.heading, MAX_HEADING_ERROR_RAD):
            tracked = None
        fix = self.search.locate_any_heading(view.positions_m, view.weights, view.heading_rad, region)
        if tracked is not None and (fix is None or tracked.error <= equal_error(fix.match.error)):
            match, accepted, kept = tracked, tracked.error < s.accepts_below, True
            self._confirmations += 1
        elif fix is not None:
            match = refine_with_tilt(self.search.matcher, view, fix.match.pose.as_array(), fix.match.error)
            accepted, kept = fix.accepted, False
            self._confirmations = 0
            if tracked is not None:
                self._rivalled = 0  # rivals of a place that fits far worse say nothing against this one
        else:
            return None
        confirmed = accepted or self._confirmations >= s.confirmations or not s.paper.confirmed
        if confirmed:
            self._confirmations = 0
        if self.doubt and confirmed:
            covariance = fused_covariance(prediction.covariance, match.covariance) if kept else match.covariance
            confirmed = stands_alone(self.search, fix, match, covariance) and self._rivalled == 0
        others = () if fix is None else self._hypotheses(view, fix, match)
        self._rivalled = RIVAL_FRAMES if others else max(self._rivalled - 1, 0)
        return Localization(match.pose, match.covariance, match, confirmed, True, kept, others)

    def _hypotheses(self, view: MatchInput, fix: GlobalFix, chosen: Match) -> tuple[Hypothesis, ...]:
        """Refined samples elsewhere that explain the points nearly as well as the chosen pose."""
        matcher, positions_m = self.search.matcher, view.positions_m
        found: list[Hypothesis] = []
        for candidate in fix.rivals(chosen.pose, chosen.error)[:MAX_HYPOTHESES]:
            match = matcher.assess(positions_m, view.weights, candidate.pose.as_array(), candidate.error)
            found.append(Hypothesis(candidate.pose, match.mean_distance_m, covariance=match.covariance))
        return tuple(found)
