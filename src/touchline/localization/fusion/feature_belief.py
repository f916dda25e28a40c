"""Whether a pose is believed, by how much of what is seen it explains, and by how much another place does.

An addition of ours to Schulz and Behnke 2012: their pose is the particles' at any time.
"""

from __future__ import annotations

import math

from pydantic import Field

from touchline.config import Settings
from touchline.localization.fusion.feature_filter import Explained
from touchline.types import Status

CONFIRMING_FEATURES = 20.0  # that a new pose must be judged by until it is believed: two or three images
AGAIN_FEATURES = 6.0  # the same of one that was believed before the robot was blind: at the very place expected
MEMORY_FEATURES = 40.0  # over which it is averaged how much a pose explains: some five images
REFUTING_FEATURES = 15.0  # that another place has to explain as well as the pose: two images
RECENT_FEATURES = 12.0  # the same over a short time: two images that a pose explains nothing of are enough to doubt it

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


class FeatureBelief:
    """`status` of the pose that is followed; `residual_m`: mean error of the last features that it explains."""

    def __init__(self, settings: BeliefSettings | None = None) -> None:
        self.settings = settings or BeliefSettings()
        self._long, self._recent = Agreement(MEMORY_FEATURES), Agreement(RECENT_FEATURES)
        self.reset()

    def reset(self, told: bool = False) -> None:
        """Forget everything. told: a person has told the pose."""
        self.status = Status.TRACKING if told else Status.SEARCHING
        self.residual_m = math.nan
        self._confirmed_ns: int | None = None
        self.start_counting(CONFIRMING_FEATURES if told else 0.0)

    def start_counting(self, features: float = 0.0, needed: float = CONFIRMING_FEATURES) -> None:
        """So many features have been seen and explained; so many are needed until the pose is believed."""
        self._needed = needed
        self._long.start(features)
        self._recent.start(min(features, RECENT_FEATURES))
        self._explained_any = False
        self._rival, self._own_beside = _NOTHING, 0.0

    def count(self, own: Explained, rival: Explained | None) -> None:
        """Take what the pose explains of a frame. rival: what another place does; None: the particles are near."""
        self._long.add(own)
        self._recent.add(own)
        self._explained_any = own.features > 0.5
        if rival is None:
            self._rival, self._own_beside = _NOTHING, 0.0
        else:
            self._rival = Explained(self._rival.features + rival.features, self._rival.of + rival.of, math.nan)
            self._own_beside += own.features
        self.residual_m = own.residual_m

    def doubt(self) -> None:
        """Another pose is followed from now on; one that was lost remains so until it is confirmed."""
        if self.status is Status.TRACKING:
            self.status = Status.SEARCHING

    def start_anew(self) -> None:
        """What was followed has jumped."""
        self.status = Status.SEARCHING
        self.start_counting()

    def lose(self) -> None:
        """There is no pose any more."""
        self.status = Status.LOST
        self.start_counting()

    def take_anew(self, stamp_ns: int) -> None:
        """The time without a confirmation counts from here: there was no pose before."""
        self._confirmed_ns = stamp_ns

    def judge(self, stamp_ns: int, has_pose: bool, doubted: bool) -> None:
        """Whether the pose is believed. doubted: for another reason than what it explains."""
        self._doubt_if_blind(stamp_ns)
        ratio = self.settings.lost_ratio
        if self.status is Status.TRACKING:
            if doubted or any(agreement.is_below(ratio) for agreement in (self._long, self._recent)):
                self.status = Status.SEARCHING
        elif has_pose and not doubted and self._long.seen >= self._needed and self._is_confirmed():
            self.status = Status.TRACKING

    @property
    def is_lost(self) -> bool:
        """Whether the particles should start anew: the pose explains too little, and so do they."""
        return self._long.is_below(self.settings.lost_ratio)

    @property
    def is_refuted(self) -> bool:
        """Whether the particles, all of them elsewhere, explain for some time no less than the pose does."""
        rival = self._rival
        return rival.of >= REFUTING_FEATURES and rival.features >= min(self._own_beside, 0.9 * rival.of)

    def _is_confirmed(self) -> bool:
        ratio = self.settings.confirmed_ratio
        return not (self._long.own < ratio * self._long.seen or self._recent.is_below(ratio))

    def _doubt_if_blind(self, stamp_ns: int) -> None:
        """A pose that nothing has confirmed for some time has to be confirmed anew."""
        if self._explained_any or self._confirmed_ns is None:
            self._confirmed_ns = stamp_ns
        elif self.status is Status.TRACKING and stamp_ns - self._confirmed_ns > 1e9 * self.settings.blind_s:
            self.status = Status.SEARCHING
            self.start_counting(0.0, AGAIN_FEATURES)
