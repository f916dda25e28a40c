"""At which end of a field whose lines look the same from both a robot without a compass is.

A person has told it, or the colours of goals and poles tell it: lines and crossings fit a pose and its twin, half a
turn about the centre mark, alike, so that whatever follows them alone can follow the twin for as long as it likes. The
two are compared in every frame, and the evidence is added up; where nothing tells them apart, both are named. An
addition of ours to Schulz and Behnke 2012.
"""

import math

import numpy as np

from touchline.geometry import Pose, mirrored_covariance
from touchline.localization.registration.feature_model import FeatureModel, FeatureView
from touchline.published.nimbro_lines.particles import ParticleMode

MAX_GAIN = 4.0  # of one frame: what is taken for a post may be somebody in its colour
SURE = 3.0  # odds of 20 to 1, from which one of the two is believed
MAX = 12.0  # so that a belief of minutes is left within four frames that speak against it


class FieldEnds:
    """`known`: at which end of a symmetric field the robot is; true of any other field.

    `symmetric`: nothing tells both ends apart. `alike`: something else than the particles tells which of a pose and its
    twin is right. `log_odds`: logarithm of how much likelier the pose is than its twin, by colours.
    """

    def __init__(self, symmetric: bool, alike: bool, colours: FeatureModel | None = None) -> None:
        """colours: the model of the features, where their colours alone tell the ends apart."""
        self.symmetric, self._colours = symmetric, colours
        self.alike = alike and (symmetric or colours is not None)
        self.reset()

    def reset(self, start_known: bool = False, own_half: bool = False) -> None:
        """Start anew. start_known: a person has told the pose."""
        self.known = start_known or own_half or not self.symmetric
        self.forget_twin(start_known)

    def lose(self) -> None:
        """There is no pose any more."""
        self.known = not self.symmetric
        self.forget_twin()

    def jump(self) -> None:
        """Another pose is followed that is no slip away: where nothing tells the ends apart, that leaves both."""
        self.known &= not self.symmetric

    def forget_twin(self, start_known: bool = False) -> None:
        """Nothing speaks for the pose against its twin, unless it was told by a person."""
        self.log_odds = MAX if start_known else 0.0

    def compare(self, view: FeatureView, pose: Pose) -> bool:
        """Compare a pose and its twin; whether the twin is the pose from now on."""
        if self._colours is None or view.size == 0:
            return False
        here, there = self._colours.log_likelihoods(view, np.array([pose, pose.mirrored()]))
        gain = min(max(float(here - there), -MAX_GAIN), MAX_GAIN)
        self.log_odds = min(max(self.log_odds + gain, -MAX), MAX)
        refuted = self.log_odds <= -SURE
        if refuted:
            self.log_odds = -self.log_odds
        return refuted

    @property
    def in_doubt(self) -> bool:
        """Whether colours could tell the ends apart, and have not yet."""
        return self._colours is not None and self.log_odds < SURE

    def nearer(self, mode: ParticleMode, to: Pose) -> ParticleMode:
        """A mode of the particles, or its twin, if that faces the way of a pose: they need not choose between both."""
        if not self.alike:
            return mode
        turned = mode.pose.mirrored()
        both = mode._replace(weight=mode.weight + mode.twin_weight)
        if math.cos(turned.heading - to.heading) < math.cos(mode.pose.heading - to.heading):
            return both
        return both._replace(pose=turned, covariance=mirrored_covariance(mode.covariance))
