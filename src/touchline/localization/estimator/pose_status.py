"""Whether the likeliest pose is tracked, by what the images show of late and how much of it the pose explains."""

from typing import NamedTuple

from touchline.localization.camera_errors.base import ImageTrust
from touchline.localization.estimator.bank import CARRIED_AWAY, CARRIED_BLIND, Bank, Member
from touchline.localization.estimator.field_end import FieldEnd
from touchline.localization.registration.covariance import is_observed
from touchline.localization.registration.joint import Seen
from touchline.localization.registration.seen import points_that_count
from touchline.types import Status

NO_POSE = "no pose explains an image yet"
_DOUBTS = (  # why no pose is tracked, the first that holds
    "several poses are likely, or too few images support one",
    "which end of the field is open",
    "the image contradicts the pose",
    "the pose explains {:.0f} % of what is seen of late",
    "the pose is not known in all directions",
    "nothing that the pose explains has been seen for too long",
    "the search of the field goes on in the next image",
)
BLIND_S = 4.0  # without anything that the pose explains, after which it is in doubt: the robot may have been carried


class Criteria(NamedTuple):
    """min_points: line points without which an image shows too little. min_explained: share of what is seen that a pose
    must explain. min_probability: from which the likeliest is tracked. blind_frames: images in a row that show nothing.
    """

    min_points: int
    min_explained: float
    min_probability: float
    blind_frames: int


class PoseStatus:
    """`status`; `reason`: why no pose is tracked; `images`: so many have shown something; `blind_frames`: so many in a
    row have not.
    """

    def __init__(self, criteria: Criteria, trust: ImageTrust) -> None:
        self.criteria, self.trust = criteria, trust
        self.reset(tracking=False)

    def reset(self, tracking: bool) -> None:
        """Nothing has been seen. tracking: whether the pose was given."""
        self.status = Status.TRACKING if tracking else Status.SEARCHING
        self.reason = "" if tracking else NO_POSE
        self.images, self.blind_frames = 0, 0
        self._explained, self._unexplained_s = 1.0, 0.0  # of late; time in which a pose explained nothing
        self._image_trust = self.trust
        self._sees_one = False  # whether the newest image shows one thing alone
        self._contradicted_s = 0.0  # of that, time in which something was seen

    def sees(self, seen: Seen) -> bool:
        """Take what an image shows; whether that is enough to correct a pose."""
        points = points_that_count(seen.positions_m, seen.shares, seen.crude)
        shows = points >= self.criteria.min_points or len(seen.raw_m) > 0
        self._sees_one = seen.is_one_thing
        self.blind_frames = 0 if shows else self.blind_frames + 1
        self._image_trust = self.trust.of(seen.crude)
        return shows

    @property
    def is_blind(self) -> bool:
        """Whether nothing that the pose explains has been seen for too long."""
        blind = self.blind_frames >= self.criteria.blind_frames and self._unexplained_s >= self.trust.looks_away_s
        return blind or self._contradicted_s > BLIND_S

    @property
    def carried_log_odds(self) -> float:
        """That the robot was moved unfelt, in an image that makes one search."""
        return CARRIED_BLIND if self._unexplained_s > BLIND_S else CARRIED_AWAY

    def is_in_doubt(self, best: Member | None) -> bool:
        """Whether the whole field is searched."""
        if self.status is not Status.TRACKING or best is None or not is_observed(best.filter.covariance):
            return True
        good = self.criteria.min_explained if self.trust.good is None else self.trust.good
        return min(best.explained, self._explained) < good

    def is_likely(self, bank: Bank) -> bool:
        """Whether the likeliest pose is the only likely one, and enough images support it."""
        return bank.probabilities[0] >= self.criteria.min_probability and bank.is_confirmed

    def is_consistent(self, bank: Bank) -> bool:
        """Whether it is, is known in all directions, and explains the last image."""
        best = bank.members[0]
        return self.is_likely(bank) and is_observed(best.filter.covariance) and self._fits(bank, 1.0)

    def update(self, bank: Bank, end: FieldEnd, seconds: float, searches: bool = False) -> Status:
        """Judge the likeliest pose after an image, so many seconds after the last. searches: whether a part of the
        field is still to be searched, before which no pose is tracked that was not.
        """
        best, tracked = bank.best, self.status is Status.TRACKING
        if best is None:
            return self.status
        fits = self._fits(bank, 0.5)
        shown = self.blind_frames == 0 and (fits or not self._sees_one)  # one thing alone may be a false one
        if shown:
            memory = 1.0 if self.images == 0 or self._unexplained_s > BLIND_S else self.trust.memory
            self._explained += memory * (bank.share - self._explained)
            self.images += 1
        self._unexplained_s = 0.0 if shown and fits else self._unexplained_s + seconds
        contradicted = shown and not fits  # the robot was carried off, or what this image shows are no lines
        if shown:
            self._contradicted_s = self._contradicted_s + seconds if contradicted else 0.0
        likely = self.is_likely(bank)
        decided = likely and end.is_decided(self.criteria.min_probability)
        ratio = self._image_trust.tracked_ratio if tracked else 1.0
        unexplained = shown and self._explained < ratio * self.criteria.min_explained
        known = is_observed(best.filter.covariance)
        doubted = (
            not likely,
            not decided,
            contradicted,
            unexplained,
            not known,
            self.is_blind,
            searches and not tracked,
        )
        self.reason = _DOUBTS[doubted.index(True)].format(100.0 * self._explained) if True in doubted else ""
        if not self.reason:
            self.status, bank.confirmed = Status.TRACKING, True
        else:
            self.status = Status.SEARCHING if not tracked or decided else Status.LOST
        return self.status

    def _fits(self, bank: Bank, ratio: float) -> bool:
        return bank.share >= ratio * self.criteria.min_explained
