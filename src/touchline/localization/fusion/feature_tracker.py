"""The pose that the particles of Schulz and Behnke 2012 have come to, and whether it is believed.

A pose is followed by least squares on the features (ours) or by the mean of the particles' main mode (the paper's). It
is believed while it explains most of what is seen; a mode elsewhere that explains more for some time takes its place.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray, Pose, mirrored_covariance, wrap_angle
from touchline.localization.fusion.feature_filter import Explained, FeatureFilter
from touchline.localization.matching.covariance import UncertaintySettings
from touchline.localization.particles.feature_model import FeatureView
from touchline.localization.particles.nimbro_particles import MODE_M, MODE_RAD, Mode
from touchline.motion.odometry import Motion
from touchline.types import Hypothesis, Prior, Status

CONFIRMING_FEATURES = 20.0  # that a new pose must be judged by until it is believed: two or three images
MEMORY_FEATURES = 40.0  # over which it is averaged how much a pose explains: some five images
REFUTING_FEATURES = 15.0  # that another place has to explain as well as the pose: two images
SURE_WEIGHT = 0.8  # share of the particles' weight in one mode from which there is a pose at all
SURE_M = 0.5  # standard deviation of a position above which no pose is believed: right is within 0.5 m
SURE_RAD = 0.3  # the same of the heading

_NOTHING = Explained(0.0, 0.0, math.nan)


class BeliefSettings(Settings):
    """When a pose is believed."""

    start_position_m: float = Field(
        0.3, gt=0, description="standard deviation of x and y of a pose told by a person (m)"
    )
    start_heading_rad: float = Field(
        0.15, gt=0, description="standard deviation of the heading of a pose told by a person (rad)"
    )
    confirmed_ratio: float = Field(
        0.7, gt=0, le=1, description="ratio of the features that a new pose must explain to be believed"
    )
    lost_ratio: float = Field(
        0.4, ge=0, le=1, description="ratio of the features below which a pose is believed no longer"
    )


class FeatureTracker:
    """`pose`, `covariance` (3, 3) and `status`; `side_known`: at which end of a symmetric field the robot is."""

    def __init__(
        self,
        feature_filter: FeatureFilter,
        symmetric: bool,
        settings: BeliefSettings | None = None,
        refine: bool = True,
    ) -> None:
        """symmetric: nothing tells both ends of the field apart. refine: by least squares; else the mode's mean."""
        self.filter, self.symmetric, self.refine = feature_filter, symmetric, refine
        self.settings = settings or BeliefSettings()
        self.unknown = UncertaintySettings().unknown
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        prior, s = prior or Prior(), self.settings
        told = prior.pose is not None
        deviations = np.array([s.start_position_m, s.start_position_m, s.start_heading_rad])
        covariance = np.diag(deviations**2) if prior.covariance is None else prior.covariance
        self.filter.forget_lean()
        self.filter.start(prior.pose or Pose(0.0, 0.0, 0.0), covariance)
        self.status = Status.TRACKING if told else Status.SEARCHING
        self.has_pose = told
        self.side_known = told or prior.own_half or not self.symmetric
        self.residual_m = math.nan
        self._start_counting(CONFIRMING_FEATURES if told else 0.0)

    @property
    def pose(self) -> Pose:
        """The best guess."""
        return self.filter.pose

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of the pose. One that is not believed is the best guess, but the robot may be anywhere."""
        return self.filter.covariance + (0.0 if self.status is Status.TRACKING else self.unknown)

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The twin at the other end, where nothing tells at which end the robot is."""
        if self.side_known:
            return ()
        covariance = mirrored_covariance(self.covariance)
        return (Hypothesis(self.pose.mirrored(), self.residual_m, covariance=covariance),)

    def predict(self, motion: Motion, deviations: FloatArray) -> None:
        """The odometry carries the pose on; deviations (3,) of the motion, robot frame."""
        self.filter.predict(motion, deviations)

    def update(self, view: FeatureView, mode: Mode) -> None:
        """Follow the pose with what is seen, or take that of the particles, and judge it."""
        if not self.has_pose:
            self._take(mode)
        elif not self.refine:
            explained = self.filter.explained(view, mode.pose)
            self.filter.start(mode.pose, mode.covariance)
            self._count(explained, None)
        else:
            elsewhere = self._is_elsewhere(mode)
            rival = self.filter.explained(view, mode.pose) if elsewhere else None
            near = None if elsewhere or mode.weight < SURE_WEIGHT else mode.pose
            self._count(self.filter.update(view, near), rival)
            if self._is_refuted():
                self._take(mode)
        self._judge()

    @property
    def is_lost(self) -> bool:
        """Whether the particles should start anew: the pose explains too little, and so do they."""
        return self._seen >= 0.5 * MEMORY_FEATURES and self._own < self.settings.lost_ratio * self._seen

    def lose(self) -> None:
        """There is no pose any more."""
        self.has_pose, self.status = False, Status.LOST
        self.side_known = not self.symmetric
        self._start_counting(0.0)

    def _take(self, mode: Mode) -> None:
        """The particles' mode is the pose from now on, to be confirmed."""
        self.filter.start(mode.pose, mode.covariance)
        if self.status is Status.TRACKING:
            self.status = Status.SEARCHING
        if mode.weight >= SURE_WEIGHT and self._is_narrow(mode.covariance):
            self.has_pose = True
            self._start_counting(0.0)

    def _is_refuted(self) -> bool:
        """Whether the particles, all of them elsewhere, explain for some time no less than the pose does."""
        rival = self._rival
        return rival.of >= REFUTING_FEATURES and rival.features >= min(self._own_beside, 0.9 * rival.of)

    def _is_elsewhere(self, mode: Mode) -> bool:
        """Whether the particles' main mode is another place."""
        turned = abs(wrap_angle(mode.pose.heading - self.pose.heading))
        return mode.weight >= SURE_WEIGHT and (mode.pose.distance_to(self.pose) > MODE_M or turned > MODE_RAD)

    def _judge(self) -> None:
        s = self.settings
        narrow = self._is_narrow(self.filter.covariance)
        if self.status is Status.TRACKING:
            if not narrow or self._own < s.lost_ratio * self._seen:
                self.status = Status.SEARCHING
        elif self.has_pose and narrow and self._seen >= CONFIRMING_FEATURES and self._is_confirmed():
            self.status = Status.TRACKING

    def _is_confirmed(self) -> bool:
        return self._own >= self.settings.confirmed_ratio * self._seen

    def _is_narrow(self, covariance: FloatArray) -> bool:
        position = math.sqrt(covariance[0, 0] + covariance[1, 1])
        return position < SURE_M and math.sqrt(covariance[2, 2]) < SURE_RAD

    def _start_counting(self, features: float) -> None:
        """So many features have been seen and explained."""
        self._seen = self._own = features
        self._rival, self._own_beside = _NOTHING, 0.0

    def _count(self, own: Explained, rival: Explained | None) -> None:
        """Averages over the last features."""
        keep = max(1.0 - own.of / MEMORY_FEATURES, 0.0)
        self._seen = keep * self._seen + own.of
        self._own = keep * self._own + own.features
        if rival is None:
            self._rival, self._own_beside = _NOTHING, 0.0
        else:
            self._rival = Explained(self._rival.features + rival.features, self._rival.of + rival.of, math.nan)
            self._own_beside += own.features
        self.residual_m = own.residual_m
