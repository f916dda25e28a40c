"""At which end of a field whose lines look the same from both a robot without a compass is.

A person has told it, or the colours of goals and poles tell it; else both the pose and its twin, half a turn about the
centre mark, are named. An addition of ours to Schulz and Behnke 2012.
"""

from __future__ import annotations

import math

from touchline.geometry import Pose, mirrored_covariance
from touchline.localization.published.nimbro.particles import Mode
from touchline.localization.published.nimbro.twin_odds import TwinOdds
from touchline.localization.registration.feature_model import FeatureView


class FieldEnds:
    """`known`: at which end of a symmetric field the robot is; true of any other field.

    `symmetric`: nothing tells both ends apart. `alike`: something else than the particles tells which of a pose and its
    twin is right.
    """

    def __init__(self, symmetric: bool, alike: bool, twin: TwinOdds | None = None) -> None:
        """twin: where colours alone tell the ends apart."""
        self.symmetric, self.twin = symmetric, twin
        self.alike = alike and (symmetric or twin is not None)
        self.reset()

    def reset(self, told: bool = False, own_half: bool = False) -> None:
        """Start anew. told: a person has told the pose."""
        self.known = told or own_half or not self.symmetric
        self.forget_twin(told)

    def lose(self) -> None:
        """There is no pose any more."""
        self.known = not self.symmetric
        self.forget_twin()

    def jump(self) -> None:
        """Another pose is followed that is no slip away: where nothing tells the ends apart, that leaves both."""
        self.known &= not self.symmetric

    def forget_twin(self, told: bool = False) -> None:
        """Nothing speaks for the pose against its twin, unless it was told by a person."""
        if self.twin is not None:
            self.twin.reset(told)

    def compare(self, view: FeatureView, pose: Pose) -> bool:
        """Compare a pose and its twin; whether the twin is the pose from now on."""
        if self.twin is None:
            return False
        self.twin.update(view, pose)
        refuted = self.twin.is_refuted
        if refuted:
            self.twin.turn()
        return refuted

    @property
    def in_doubt(self) -> bool:
        """Whether colours could tell the ends apart, and have not yet."""
        return self.twin is not None and not self.twin.is_sure

    def nearer(self, mode: Mode, to: Pose) -> Mode:
        """A mode of the particles, or its twin, if that faces the way of a pose: they need not choose between both."""
        if not self.alike:
            return mode
        turned = mode.pose.mirrored()
        both = mode._replace(weight=mode.weight + mode.twin_weight)
        if math.cos(turned.heading - to.heading) < math.cos(mode.pose.heading - to.heading):
            return both
        return both._replace(pose=turned, covariance=mirrored_covariance(mode.covariance))
