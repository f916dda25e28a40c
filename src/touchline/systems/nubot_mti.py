"""nubot-mti: omnidirectional vision and compass.

D. Xiong, H. Lu, Z. Zheng: A self-localization method based on omnidirectional vision and MTi for soccer robots.

    image ─▶ line points ─┬─▶ global localization (4.1) ─▶ pose
                          │      compass ─┘                 │
                          └─▶ matching from the prediction ◀┴─ odometry
                                 │
                                 ├─▶ Kalman fusion ─▶ estimate
                                 ├─▶ compass correction
                                 └─▶ failure detection ─▶ global localization again (4.2)
"""

from __future__ import annotations

import numpy as np

from touchline.geometry import FloatArray
from touchline.localization.fusion.pose_filter import PoseFilter
from touchline.localization.matching.global_search import GlobalFix, GlobalSearchSettings
from touchline.localization.matching.matcher import Match
from touchline.systems.matching_tracker import MatchingTracker, TrackerSettings
from touchline.systems.setup import RobotSetup
from touchline.types import Hypothesis, LinePoints, Prior, Status


class NubotMtiSettings(TrackerSettings):
    """Everything that the paper fixes, and everything that it leaves open."""

    global_search: GlobalSearchSettings = GlobalSearchSettings()


class NubotMti(MatchingTracker):
    """The system as sources and sinks know it: `reset` and `step`."""

    def __init__(self, setup: RobotSetup, settings: NubotMtiSettings, rng: np.random.Generator) -> None:
        """rng is not needed: nothing here is left to chance."""
        super().__init__(setup, settings, settings.global_search)
        self.settings = settings
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        super().reset(prior)
        self.confirmations = 0

    def _localize(
        self, points: LinePoints, weights: FloatArray, compass_rad: float | None, held: Match | None
    ) -> Match | None:
        """Section 4.1: global localization. held: the match from the prediction, which stays unless another is better.

        A pose that isn't accepted is followed as the best there is, and believed once it has held against the search
        for some frames in a row.
        """
        s = self.settings.global_search
        if held is not None and not self._may_face(held.pose.heading, compass_rad):
            held = None
        fix = self._search(points, weights, compass_rad)
        if fix is None and held is None:
            return None
        if held is not None and (fix is None or held.error <= s.rival_factor * fix.match.error + s.rival_margin):
            match, accepted = held, held.error < s.accepted_error
            self._fuse(points, weights, held, compass_rad)
            self.confirmations += 1
        else:
            assert fix is not None
            match = self._upright(points, weights, fix.match.pose.as_array(), fix.match.error)
            accepted = fix.accepted
            self.filter = PoseFilter(match.pose, match.covariance, self.settings.fusion)
            self.side_known = self._knows_the_side(compass_rad)
            self.placed, self.confirmations = True, 0
        self.hypotheses = () if fix is None else self._hypotheses(fix, match, points, weights)
        if accepted or self.confirmations >= s.confirmations:
            self.confirmations = 0
            self._believe()
        else:
            self.status = Status.SEARCHING
        return match

    def _hypotheses(
        self, fix: GlobalFix, chosen: Match, points: LinePoints, weights: FloatArray
    ) -> tuple[Hypothesis, ...]:
        """Refined samples elsewhere that explain the points nearly as well as the chosen pose."""
        s = self.settings.global_search
        positions_m = self.tilt.corrected(points.positions_m)
        others: list[Hypothesis] = []
        for candidate in sorted(fix.rounds[-1].candidates, key=lambda c: c.error):
            known = (chosen.pose, *(other.pose for other in others))
            elsewhere = all(candidate.pose.distance_to(pose) > 0.5 for pose in known)
            if elsewhere and candidate.error <= s.rival_factor * chosen.error + s.rival_margin:
                match = self.matcher.assess(positions_m, weights, candidate.pose.as_array(), candidate.error)
                others.append(Hypothesis(candidate.pose, match.mean_distance_m, covariance=match.covariance))
        return tuple(others)
