"""Whether a pose is believed, by how much of what is seen it explains, and by how much another place does.

An addition of ours to Schulz and Behnke 2012: their pose is the particles' at any time.
"""

import math

import numpy as np
from pydantic import Field

from touchline.geometry import FloatArray, Pose, deviation_m, deviation_rad
from touchline.motion.start import StartSettings
from touchline.published.nimbro_lines.feature_filter import Explained
from touchline.types import Status

CONFIRMING_FEATURES = 20.0  # that a new pose must be judged by until it is believed: two or three images
AGAIN_FEATURES = 6.0  # the same of one that was believed before the robot was blind: at the very place expected
TOLD_FEATURES = 3.0  # the same of one that a person has told
MEMORY_FEATURES = 40.0  # over which it is averaged how much a pose explains: some five images
REFUTING_FEATURES = 15.0  # that another place has to explain as well as the pose: two images
RECENT_FEATURES = 12.0  # the same over a short time: two images that a pose explains nothing of are enough to doubt it
SURE_M = 0.5  # standard deviation of a position above which no pose is believed: right is within 0.5 m
SURE_RAD = 0.3  # the same of the heading


class BeliefSettings(StartSettings):
    """When a pose is believed."""

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


class Fix:
    """Whether the features that a pose explains would fix it if it were not known: one post seen often does not.

    Sums up their information on a shift of the field and a turn about its centre, which stay while the robot walks.
    """

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Nothing has been seen."""
        self._information = np.zeros((3, 3))

    def add(self, explained: Explained, pose: Pose) -> None:
        """Take the features of a frame, seen from a pose."""
        turned = _about_centre(pose)
        self._information += turned.T @ explained.information @ turned

    def is_sure(self, pose: Pose) -> bool:
        """Whether they tell where a robot is that is about there."""
        back = np.linalg.inv(_about_centre(pose))
        information = back.T @ self._information @ back
        if np.linalg.matrix_rank(information, hermitian=True) < 3:
            return False
        return is_narrow(np.linalg.inv(information))


class FeatureBelief:
    """`status` of the pose that is followed; `residual_m`: mean error of the last features that it explains."""

    def __init__(self, settings: BeliefSettings | None = None) -> None:
        self.settings = settings or BeliefSettings()
        self._long, self._recent = Agreement(MEMORY_FEATURES), Agreement(RECENT_FEATURES)
        self._since, self._fix = Agreement(MEMORY_FEATURES), Fix()  # what has been seen since it is to be confirmed
        self.reset()

    def reset(self, start_known: bool = False) -> None:
        """Forget everything. start_known: a person has told the pose, whose word counts as so many features."""
        self._kept = Status.TRACKING if start_known else Status.SEARCHING
        self._confirmed = False
        self.residual_m = math.nan
        self._explained_ns: int | None = None
        self.start_counting(TOLD_FEATURES if start_known else CONFIRMING_FEATURES)
        if start_known:
            self._long.start(CONFIRMING_FEATURES)
            self._recent.start(RECENT_FEATURES)

    @property
    def status(self) -> Status:
        """A pose that was told is believed no sooner than what is seen has confirmed it."""
        return self._kept if self._confirmed or self._kept is Status.LOST else Status.SEARCHING

    @property
    def is_searching(self) -> bool:
        """Whether another pose is sought: none is believed, and nobody's word is kept to."""
        return self._kept is not Status.TRACKING

    def start_counting(self, needed: float = CONFIRMING_FEATURES) -> None:
        """Nothing has been seen; so many features are needed until the pose is believed."""
        self._needed = needed
        for each in (self._long, self._recent, self._since, self._fix):
            each.start()
        self._explained_any = False
        self._forget_rival()

    def count(self, own: Explained, rival: Explained | None, pose: Pose) -> None:
        """Take what the pose explains of a frame. rival: what another place does; None: the particles are near."""
        for agreement in (self._long, self._recent, self._since):
            agreement.add(own)
        self._fix.add(own, pose)
        self._explained_any = own.features > 0.5
        if rival is None:
            self._forget_rival()
        else:
            self._rival_explained += rival.features
            self._beside += rival.of
            self._own_beside += own.features
        self.residual_m = own.residual_m

    def doubt(self) -> None:
        """Another pose is followed from now on; one that was lost remains so until it is confirmed."""
        if self._kept is Status.TRACKING:
            self._drop()

    def start_anew(self) -> None:
        """What was followed has jumped."""
        self._drop()
        self.start_counting()

    def lose(self) -> None:
        """There is no pose any more."""
        self._drop(Status.LOST)
        self.start_counting()

    def take_anew(self, stamp_ns: int) -> None:
        """The time without a confirmation counts from here: there was no pose before."""
        self._explained_ns = stamp_ns

    def judge(self, stamp_ns: int, pose: Pose | None, doubted: bool) -> None:
        """Whether the pose is believed; None: there is none. doubted: for another reason than what it explains."""
        self._doubt_if_blind(stamp_ns)
        ratio = self.settings.lost_ratio
        if self._kept is Status.TRACKING and (doubted or self._long.is_below(ratio) or self._recent.is_below(ratio)):
            self._drop()
        elif not self._confirmed and pose is not None and not doubted and self._is_confirmed(pose):
            self._kept, self._confirmed = Status.TRACKING, True

    @property
    def is_lost(self) -> bool:
        """Whether the particles should start anew: the pose explains too little, and so do they."""
        return self._long.is_below(self.settings.lost_ratio)

    @property
    def is_refuted(self) -> bool:
        """Whether the particles, all of them elsewhere, explain for some time no less than the pose does."""
        return self._beside >= REFUTING_FEATURES and self._rival_explained >= min(self._own_beside, 0.9 * self._beside)

    def _drop(self, status: Status = Status.SEARCHING) -> None:
        self._kept, self._confirmed = status, False

    def _forget_rival(self) -> None:
        self._rival_explained = self._own_beside = self._beside = 0.0

    def _is_confirmed(self, pose: Pose) -> bool:
        ratio, since = self.settings.confirmed_ratio, self._since
        if since.seen < self._needed or since.own < ratio * since.seen or self._recent.is_below(ratio):
            return False
        return self._fix.is_sure(pose)

    def _doubt_if_blind(self, stamp_ns: int) -> None:
        """A pose that nothing has confirmed for some time has to be confirmed anew."""
        if self._explained_any or self._explained_ns is None:
            self._explained_ns = stamp_ns
        elif self._kept is Status.TRACKING and stamp_ns - self._explained_ns > 1e9 * self.settings.blind_s:
            self._drop()
            self.start_counting(AGAIN_FEATURES)


def is_narrow(covariance: FloatArray) -> bool:
    """Whether a covariance (3, 3) is of a pose that may be believed."""
    return deviation_m(covariance) < SURE_M and deviation_rad(covariance) < SURE_RAD


def _about_centre(pose: Pose) -> FloatArray:
    """(3, 3): the change of a pose by a small shift of the field and turn about its centre."""
    return np.array([[1.0, 0.0, -pose.y], [0.0, 1.0, pose.x], [0.0, 0.0, 1.0]])
