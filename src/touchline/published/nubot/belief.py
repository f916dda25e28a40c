"""How far the pose is believed, and what is known of the end of the field that the robot is at."""

from touchline.field.region import OWN_HALF, Region
from touchline.geometry import FloatArray, mirrored_covariance
from touchline.motion.compass import COMPASS_FALSE
from touchline.published.nubot.global_localizer import Localization
from touchline.published.nubot.pose_filter import PoseFilter
from touchline.types import Hypothesis, Prior, Problem, Status


class Belief:
    """`status`; `region` in which the robot has to be, None for the whole field; `twin_probability` of standing at the
    other end of a symmetric field: 0 where the end is known, None where nothing tells it. `doubts`: why a tracked pose
    is not believed in this frame; `notes`: which sensors are not.
    """

    def __init__(self, symmetric: bool, unknown: FloatArray) -> None:
        """symmetric: whether half a turn of the field shows the same lines. unknown: covariance (3, 3) of a pose of
        which nothing is known.
        """
        self.symmetric = symmetric
        self.unknown = unknown
        self.reset()

    def reset(self, prior: Prior | None = None) -> None:
        """Know nothing but the prior."""
        prior = prior or Prior()
        self.status = Status.SEARCHING if prior.pose is None else Status.TRACKING
        self.region: Region | None = OWN_HALF if prior.own_half else None
        self.twin_probability: float | None = 0.0
        self._compass_is_right = False  # it has agreed with an end that was told
        self.doubts: tuple[Problem, ...] = ()
        self.notes: tuple[Problem, ...] = ()

    @property
    def is_tracking(self) -> bool:
        """Whether the pose is followed: it is the robot's, or was and is not refuted yet."""
        return self.status is Status.TRACKING

    @property
    def told_status(self) -> Status:
        """What the robot is told: a pose in doubt is followed, but not called tracked."""
        return Status.SEARCHING if self.is_tracking and self.doubts else self.status

    def lose(self, compass_trusted: bool = False) -> None:
        """The pose is believed wrong. compass_trusted: the compass had agreed with it."""
        self._compass_is_right |= compass_trusted and self.twin_probability == 0.0
        self.status = Status.LOST
        self.doubts = ()

    def take(self, found: Localization, compass_rad: float | None) -> None:
        """What a search has come to: the pose is believed once it is confirmed."""
        if found.has_pose and not found.kept:
            known = self.region is not None or not self.symmetric
            by_compass = 0.0 if known or self._compass_is_right else COMPASS_FALSE
            self.twin_probability = by_compass if known or compass_rad is not None else None
        self.status = Status.SEARCHING
        if found.confirmed:
            self.status, self.region, self.doubts = Status.TRACKING, None, ()

    def covariance(self, pose_filter: PoseFilter) -> FloatArray:
        """(3, 3) of the pose. One that is not believed is the best guess, but the robot may be anywhere."""
        believed = self.told_status is Status.TRACKING
        return pose_filter.covariance.copy() if believed else pose_filter.covariance + self.unknown

    def other_end(self, pose_filter: PoseFilter, residual_m: float) -> tuple[Hypothesis, ...]:
        """The pose at the other end of a symmetric field, where at most a compass tells: lines look the same there."""
        if self.twin_probability == 0.0:
            return ()
        probability = None if self.notes else self.twin_probability  # a compass in doubt tells nothing
        covariance = mirrored_covariance(self.covariance(pose_filter))
        return (Hypothesis(pose_filter.pose.mirrored(), residual_m, probability, covariance),)
