"""The pose that the particles of Schulz and Behnke 2012 have come to, and whether it is believed.

A pose is followed by least squares on the features (ours) or by the mean of the particles' main mode (the paper's). It
is believed while it explains most of what is seen, and colours don't speak for its twin at the field's other end; a
mode elsewhere that explains more for some time takes its place, and so does a twin that colours speak for.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from touchline.config import Settings
from touchline.geometry import FloatArray, Pose, mirrored_covariance, wrap_angle
from touchline.localization.fusion.feature_filter import Explained, FeatureFilter
from touchline.localization.fusion.twin_odds import TwinOdds
from touchline.localization.matching.covariance import UncertaintySettings
from touchline.localization.particles.feature_model import FeatureView
from touchline.localization.particles.nimbro_particles import MODE_M, MODE_RAD, Mode
from touchline.motion.odometry import Motion
from touchline.types import Hypothesis, Prior, Status

CONFIRMING_FEATURES = 20.0  # that a new pose must be judged by until it is believed: two or three images
AGAIN_FEATURES = 6.0  # the same of one that was believed before the robot was blind: at the very place expected
MEMORY_FEATURES = 40.0  # over which it is averaged how much a pose explains: some five images
REFUTING_FEATURES = 15.0  # that another place has to explain as well as the pose: two images
RECENT_FEATURES = 12.0  # the same over a short time: two images that a pose explains nothing of are enough to doubt it
SURE_WEIGHT = 0.8  # share of the particles' weight in one mode from which there is a pose at all
SURE_M = 0.5  # standard deviation of a position above which no pose is believed: right is within 0.5 m
SURE_RAD = 0.3  # the same of the heading
# how far another place may be away for the robot to be still at the end that it was at: it slipped. Of all places that
# a robot may be carried to, the twins of less than one in a hundred are so near
SLIP_M, SLIP_RAD = 1.0, 0.5

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
    blind_s: float = Field(
        4.0,
        gt=0,
        description="time (s) without a feature that a pose explains, from which on it has to be confirmed anew: the "
        "robot may have fallen, and been carried to a side line",
    )


class Agreement:
    """How much of what was seen a pose explained, averaged over so many of the last features."""

    def __init__(self, memory: float) -> None:
        self.memory = memory
        self.start()

    def start(self, features: float = 0.0) -> None:
        """So many features have been seen and explained."""
        self.seen = self.own = features

    def add(self, explained: Explained) -> None:
        """Take the features of a frame."""
        keep = max(1.0 - explained.of / self.memory, 0.0)
        self.seen = keep * self.seen + explained.of
        self.own = keep * self.own + explained.features

    def is_below(self, ratio: float) -> bool:
        """Whether the pose explained less than a ratio of enough features to tell."""
        return self.seen >= 0.5 * self.memory and self.own < ratio * self.seen


class FeatureTracker:
    """`pose`, `covariance` (3, 3) and `status`; `side_known`: at which end of a symmetric field the robot is.

    `turned`: whether the last frame made the twin of the pose the pose.
    """

    def __init__(
        self,
        feature_filter: FeatureFilter,
        symmetric: bool,
        settings: BeliefSettings | None = None,
        refine: bool = True,
        twin: TwinOdds | None = None,
    ) -> None:
        """symmetric: nothing tells both ends of the field apart. refine: by least squares; else the mode's mean.

        twin: where colours alone tell the ends apart.
        """
        self.filter, self.symmetric, self.refine, self.twin = feature_filter, symmetric, refine, twin
        self.settings = settings or BeliefSettings()
        self.unknown = UncertaintySettings().unknown
        self._long, self._recent = Agreement(MEMORY_FEATURES), Agreement(RECENT_FEATURES)
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
        self.turned = False
        self._confirmed_ns: int | None = None
        self._start_counting(CONFIRMING_FEATURES if told else 0.0)
        self._forget_twin(told)

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
        """The twin at the other end, where nothing tells, or has told yet, at which end the robot is."""
        if self.side_known and (self.twin is None or self.twin.is_sure):
            return ()
        covariance = mirrored_covariance(self.covariance)
        return (Hypothesis(self.pose.mirrored(), self.residual_m, covariance=covariance),)

    def predict(self, motion: Motion, deviations: FloatArray) -> None:
        """The odometry carries the pose on; deviations (3,) of the motion, robot frame."""
        self.filter.predict(motion, deviations)

    def update(self, view: FeatureView, mode: Mode, stamp_ns: int) -> None:
        """Follow the pose with what is seen, or take that of the particles, and judge it."""
        self.turned = False
        if not self.has_pose:
            self._take(mode)
            self._confirmed_ns = stamp_ns
        elif not self.refine:
            explained = self.filter.explained(view, mode.pose)
            if not self._is_near(mode.pose, SLIP_M, SLIP_RAD):
                self._forget_side(mode.pose)
                self.status = Status.SEARCHING
                self._start_counting()
            self.filter.start(mode.pose, mode.covariance)
            self._count(explained, None)
        else:
            self._follow(view, self._nearer(mode))
        if self.has_pose and self.twin is not None:
            self._compare_with_twin(self.twin, view)
        self._judge(stamp_ns)

    @property
    def is_lost(self) -> bool:
        """Whether the particles should start anew: the pose explains too little, and so do they."""
        return self._long.is_below(self.settings.lost_ratio)

    def lose(self) -> None:
        """There is no pose any more."""
        self.has_pose, self.status = False, Status.LOST
        self.side_known = not self.symmetric
        self._start_counting()
        self._forget_twin()

    def _follow(self, view: FeatureView, mode: Mode) -> None:
        """Least squares on the features, beside a mode of the particles that may be elsewhere."""
        elsewhere = self._is_elsewhere(mode)
        rival = self.filter.explained(view, mode.pose) if elsewhere else None
        near = None if elsewhere or mode.weight < SURE_WEIGHT else mode.pose
        self._count(self.filter.update(view, near), rival)
        if self._is_refuted():
            self._forget_side(mode.pose)
            self._take(mode)

    def _forget_side(self, pose: Pose) -> None:
        """Where nothing tells the ends apart, a jump to another pose that is no slip leaves both."""
        self.side_known &= not self.symmetric or self._is_near(pose, SLIP_M, SLIP_RAD)

    def _take(self, mode: Mode) -> None:
        """The particles' mode is the pose from now on, to be confirmed."""
        if not self._is_near(mode.pose, SLIP_M, SLIP_RAD):
            self._forget_twin()
        self.filter.start(mode.pose, mode.covariance)
        if self.status is Status.TRACKING:
            self.status = Status.SEARCHING
        weight = mode.weight + (mode.twin_weight if self._has_twins else 0.0)
        if weight >= SURE_WEIGHT and self._is_narrow(mode.covariance):
            self.has_pose = True
            self._start_counting()

    @property
    def _has_twins(self) -> bool:
        """Whether something else than the particles tells which of a pose and its twin is right."""
        return self.refine and (self.symmetric or self.twin is not None)

    def _nearer(self, mode: Mode) -> Mode:
        """A mode of the particles, or its twin, if that is nearer to the pose: they need not choose between both."""
        if not self._has_twins:
            return mode
        turned = mode.pose.mirrored()
        both = mode._replace(weight=mode.weight + mode.twin_weight)
        if math.cos(turned.heading - self.pose.heading) < math.cos(mode.pose.heading - self.pose.heading):
            return both
        return both._replace(pose=turned, covariance=mirrored_covariance(mode.covariance))

    def _compare_with_twin(self, twin: TwinOdds, view: FeatureView) -> None:
        twin.update(view, self.pose)
        if twin.is_refuted:
            self.filter.start(self.pose.mirrored(), mirrored_covariance(self.filter.covariance))
            twin.turn()
            self.turned = True

    def _is_refuted(self) -> bool:
        """Whether the particles, all of them elsewhere, explain for some time no less than the pose does."""
        rival = self._rival
        return rival.of >= REFUTING_FEATURES and rival.features >= min(self._own_beside, 0.9 * rival.of)

    def _is_elsewhere(self, mode: Mode) -> bool:
        """Whether the particles' main mode is another place."""
        return mode.weight >= SURE_WEIGHT and not self._is_near(mode.pose, MODE_M, MODE_RAD)

    def _is_near(self, pose: Pose, reach_m: float, reach_rad: float) -> bool:
        turned = abs(wrap_angle(pose.heading - self.pose.heading))
        return self.pose.distance_to(pose) <= reach_m and turned <= reach_rad

    def _judge(self, stamp_ns: int) -> None:
        s = self.settings
        self._doubt_if_blind(stamp_ns)
        doubted = not self._is_narrow(self.filter.covariance) or (self.twin is not None and not self.twin.is_sure)
        if self.status is Status.TRACKING:
            if doubted or any(agreement.is_below(s.lost_ratio) for agreement in (self._long, self._recent)):
                self.status = Status.SEARCHING
        elif self.has_pose and not doubted and self._long.seen >= self._needed and self._is_confirmed():
            self.status = Status.TRACKING

    def _doubt_if_blind(self, stamp_ns: int) -> None:
        """A pose that nothing has confirmed for some time has to be confirmed anew."""
        if self._explained_any or self._confirmed_ns is None:
            self._confirmed_ns = stamp_ns
        elif self.status is Status.TRACKING and stamp_ns - self._confirmed_ns > 1e9 * self.settings.blind_s:
            self.status = Status.SEARCHING
            self._start_counting(0.0, AGAIN_FEATURES)

    def _is_confirmed(self) -> bool:
        ratio = self.settings.confirmed_ratio
        return not (self._long.own < ratio * self._long.seen or self._recent.is_below(ratio))

    def _is_narrow(self, covariance: FloatArray) -> bool:
        position = math.sqrt(covariance[0, 0] + covariance[1, 1])
        return position < SURE_M and math.sqrt(covariance[2, 2]) < SURE_RAD

    def _start_counting(self, features: float = 0.0, needed: float = CONFIRMING_FEATURES) -> None:
        """So many features have been seen and explained; so many are needed until the pose is believed."""
        self._needed = needed
        self._long.start(features)
        self._recent.start(min(features, RECENT_FEATURES))
        self._explained_any = False
        self._rival, self._own_beside = _NOTHING, 0.0

    def _forget_twin(self, told: bool = False) -> None:
        """Nothing speaks for the pose against its twin, unless it was told by a person."""
        if self.twin is not None:
            self.twin.reset(told)

    def _count(self, own: Explained, rival: Explained | None) -> None:
        """Averages over the last features."""
        self._long.add(own)
        self._recent.add(own)
        self._explained_any = own.features > 0.5
        if rival is None:
            self._rival, self._own_beside = _NOTHING, 0.0
        else:
            self._rival = Explained(self._rival.features + rival.features, self._rival.of + rival.of, math.nan)
            self._own_beside += own.features
        self.residual_m = own.residual_m
