"""Following the robot by particles alone, without matching: the comparison of Lu et al. 2013, section 5."""

from __future__ import annotations

from dataclasses import replace

from touchline.field.region import Region
from touchline.geometry import Pose, as_pose
from touchline.localization.published.nubot.global_localizer import Localization, Prediction
from touchline.localization.published.nubot.match_input import MatchInput
from touchline.localization.published.nubot.matcher import Match
from touchline.localization.published.nubot.particle_localizer import SAME_M, ParticleSearch
from touchline.motion import Motion


class ParticleFollower:
    """Particles that find the robot and go on to follow it, a cycle per frame."""

    def __init__(self, search: ParticleSearch) -> None:
        self.search = search

    def reset(self) -> None:
        """Forget everything."""
        self.search.reset()

    def predict(self, motion: Motion) -> None:
        """The odometry carries the particles on."""
        self.search.predict(motion)

    def localize(self, view: MatchInput, prediction: Prediction, region: Region | None = None) -> Localization:
        """One cycle of a search; what the particles have converged to is judged at the match nearby."""
        self.search.start_if_due(view, prediction, region)
        found = self.search.cycle(view)
        if not self.search.converged:
            return found
        confirmed = self.search.confirms(self.match_nearby(view, found.pose))
        return replace(found, confirmed=confirmed, has_pose=confirmed)

    def follow(self, view: MatchInput, prediction: Prediction, region: Region | None = None) -> Localization:
        """One more cycle; particles that rest start about the prediction."""
        if not self.search.cycles:
            self.search.start_around(view, prediction, region)
        return replace(self.search.cycle(view), has_pose=True)

    def match_nearby(self, view: MatchInput, mean: Pose) -> Match:
        """The match that a mean leads to, or the mean itself if that is far away: it says nothing of the mean then."""
        matcher, positions_m = self.search.particles.matcher, view.positions_m
        pose, error, _ = matcher.descend(positions_m, view.weights, mean.as_array())
        if mean.distance_to(as_pose(pose)) > SAME_M:
            pose, error = mean.as_array(), matcher.error(positions_m, view.weights, mean.as_array())
        return matcher.assess(positions_m, view.weights, pose, error)
