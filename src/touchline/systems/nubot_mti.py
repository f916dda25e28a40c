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

from touchline.camera import OmniCamera
from touchline.field import FieldModel
from touchline.geometry import FloatArray
from touchline.localization.global_search import GlobalFix, GlobalSearch, GlobalSearchSettings
from touchline.localization.matching import Match
from touchline.localization.tracking import PoseFilter
from touchline.systems.matching_tracker import MatchingTracker, TrackerSettings
from touchline.types import Hypothesis, LinePoints, Status

# Without a compass the whole circle is searched; matching turns by half a step and more.
_ALL_HEADINGS = tuple(float(heading) for heading in np.arange(24) * np.pi / 12.0 - np.pi)


class NubotMtiSettings(TrackerSettings):
    """Everything that the paper fixes, and everything that it leaves open."""

    global_search: GlobalSearchSettings = GlobalSearchSettings()


class NubotMti(MatchingTracker):
    """The system as sources and sinks know it: `reset` and `step`."""

    def __init__(
        self, field: FieldModel, camera: OmniCamera | None, settings: NubotMtiSettings, rng: np.random.Generator
    ) -> None:
        """camera: None if frames bring their points. rng is not needed: nothing here is left to chance."""
        super().__init__(field, camera, settings, settings.global_search.accepted_error)
        self.settings = settings
        self.search = GlobalSearch(self.matcher, field.length, field.width, settings.global_search)
        self.reset()

    def _localize(
        self, points: LinePoints, weights: FloatArray, compass_rad: float | None, tracked: Match | None
    ) -> Match | None:
        """Section 4.1: global localization; a pose that has just failed stays if no other fits the lines better."""
        positions_m = self.tilt.corrected(points.positions_m)
        headings = _ALL_HEADINGS if compass_rad is None else (self.correction.heading(compass_rad),)
        fixes = [self.search.locate(positions_m, weights, heading, self.region) for heading in headings]
        fix = min((f for f in fixes if f is not None), key=lambda f: f.match.error, default=None)
        if fix is None:
            return tracked
        accepted = fix.accepted
        match = self._upright(points, weights, fix.match.pose.as_array(), fix.match.error)
        if tracked is not None and not self._may_face(tracked.pose.heading, compass_rad):
            tracked = None
        if tracked is not None and tracked.error <= match.error:
            match, accepted = tracked, tracked.error < self.accepted_error
        self.filter = PoseFilter(match.pose, match.covariance, self.settings.fusion)
        self.rivals = _rivals(fix)
        self.status = Status.SEARCHING
        if accepted:
            self._found(compass_rad)
        return match


def _rivals(fix: GlobalFix) -> tuple[Hypothesis, ...]:
    """Refined samples elsewhere whose error comes near the best one's."""
    best = fix.match
    near: list[Hypothesis] = []
    for candidate in sorted(fix.rounds[-1].candidates, key=lambda c: c.error):
        elsewhere = all(candidate.pose.distance_to(p) > 0.5 for p in (best.pose, *(h.pose for h in near)))
        if elsewhere and candidate.error < 2.0 * best.error:
            near.append(Hypothesis(candidate.pose, candidate.error))
    return tuple(near)
