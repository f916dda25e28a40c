"""Which of a pose and its twin, half a turn about the centre mark, the colours of posts and poles speak for.

An addition of ours to Schulz and Behnke 2012. Lines and crossings fit both; so whatever follows them alone can follow
the twin for as long as it likes. The two are compared in every frame, and the evidence is added up.
"""

from __future__ import annotations

import math

import numpy as np

from touchline.geometry import Pose
from touchline.localization.registration.feature_model import FeatureModel, FeatureView

MAX_GAIN = 4.0  # of one frame: what is taken for a post may be somebody in its colour
SURE = 3.0  # odds of 20 to 1, from which one of the two is believed
MAX = 12.0  # so that a belief of minutes is left within four frames that speak against it


class TwinOdds:
    """`log_odds`: logarithm of how much likelier the pose is than its twin."""

    def __init__(self, model: FeatureModel) -> None:
        self.model = model
        self.reset()

    def reset(self, told: bool = False) -> None:
        """Nothing is known, or the pose was told by a person."""
        self.log_odds = MAX if told else 0.0

    def update(self, view: FeatureView, pose: Pose) -> None:
        """Compare a pose and its twin by what a frame shows."""
        if view.size == 0:
            return
        here, there = self.model.log_likelihoods(view, np.array([pose, pose.mirrored()]))
        gain = min(max(float(here - there), -MAX_GAIN), MAX_GAIN)
        self.log_odds = min(max(self.log_odds + gain, -MAX), MAX)

    def turn(self) -> None:
        """The twin is the pose from now on."""
        self.log_odds = -self.log_odds

    @property
    def is_sure(self) -> bool:
        """Whether the twin is refuted."""
        return self.log_odds >= SURE

    @property
    def is_refuted(self) -> bool:
        """Whether the pose is, so that its twin should take its place."""
        return self.log_odds <= -SURE

    @property
    def probability(self) -> float:
        """Of the pose, against its twin."""
        return 1.0 / (1.0 + math.exp(-self.log_odds))
