"""Kalman fusion of odometry and matching (Xiong et al., section 4.2; Lu et al. 2013, section 4).

Where the lines fix the pose, the match decides; along a direction that no line observes, its covariance is huge and
the odometry carries the pose on.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from pydantic import Field

from touchline.config import Settings, added
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.motion.driven import EXACT_SCALES, SCALE_DRIFT, Scales, driven
from touchline.motion.start import StartSettings

# a match beyond the gate is believed if the prediction's mean error is more than this factor, or BETTER_MARGIN, above
# its own: a lone line that RPROP slid along is explained as well where it was predicted
BETTER_FACTOR = 2.0
BETTER_MARGIN = 0.02  # see BETTER_FACTOR; what noise alone changes in the mean error


class FusionPaper(Settings):
    """Switches to the papers' exact form."""

    compass_start: bool = added(
        True,
        paper=False,
        description="matching starts with the compass heading, too, where that differs from the prediction or the "
        "first start fits badly: a shove turns the robot, which only the compass feels; false: at the prediction alone",
    )
    shoves: bool = added(
        True,
        paper=False,
        description="a match beyond the gate is a shove, a slide along a lone line, or nothing, and one that fits as "
        "well farther along a lone line tells nothing along it; false as in the papers: every match is fused as it is",
    )
    learn_odometry_scale: bool = added(
        True,
        paper=False,
        description="estimate by how much the odometry tells travel forward and sideways, and turns, too long; "
        "without it their errors, which come again in every frame, are taken for noise and pull the pose",
    )
    any_shove: bool = added(
        False,
        paper=True,
        description="believe a match however far it lies from the prediction if its points fit better there; a shove "
        "moves a robot by 0.6 m at most, and what is farther is searched for",
    )


class FusionSettings(StartSettings):
    """The Kalman filter. The paper leaves all of it open."""

    gate: float = Field(
        16.3,
        gt=0,
        description="squared Mahalanobis distance between prediction and match above which they contradict each other: "
        "the 99.9 % quantile of chi square with 3 degrees of freedom",
    )
    paper: FusionPaper = FusionPaper()


class Fusion(Enum):
    """What a frame's match says of the prediction: it supports it, the robot was shoved meanwhile, or neither."""

    SUPPORTS = "supports"
    SHOVED = "shoved"
    CONTRADICTS = "contradicts"


_SCALES = np.arange(3, 6)


class PoseFilter:
    """The pose and its covariance (3, 3) of x, y, heading in (m, m, rad), field frame.

    Three more states are the odometry's scale errors: what comes again in every step is no noise. `scales` (3,): those
    found so far; true motion is that of the odometry times one plus the scale.
    """

    def __init__(
        self,
        pose: Pose,
        covariance: FloatArray | None = None,
        settings: FusionSettings | None = None,
        scales: Scales = EXACT_SCALES,
    ) -> None:
        """covariance: of a pose from a match; without one the pose was told by a person. scales: standard deviations
        of the odometry's scale errors, zero where they are not to be found out.
        """
        self.settings = settings or FusionSettings()
        self.pose = pose
        self.scales = np.zeros(3)
        self._joint = np.zeros((6, 6))  # covariance of x, y, heading and the three scales
        self._joint[:3, :3] = self.settings.start_covariance if covariance is None else covariance
        self._joint[_SCALES, _SCALES] = np.square(scales)
        self._drifting = np.array([scale > 0.0 for scale in scales])

    @property
    def covariance(self) -> FloatArray:
        """(3, 3) of the pose."""
        return self._joint[:3, :3]

    def placed(self, pose: Pose, covariance: FloatArray | None) -> PoseFilter:
        """A filter that starts at another pose, and still knows the scales."""
        other = PoseFilter(pose, covariance, self.settings)
        other.scales, other._drifting = self.scales.copy(), self._drifting
        other._joint[3:, 3:] = self._joint[3:, 3:]
        return other

    def loosened(self, more: FloatArray) -> PoseFilter:
        """A copy whose pose is less sure by a covariance (3, 3)."""
        other = self.placed(self.pose, None)
        other._joint = self._joint.copy()
        other._joint[:3, :3] += more
        return other

    def predict(self, motion: Pose, motion_covariance: FloatArray) -> None:
        """Move by the odometry: motion is `before_from_after`, its covariance (3, 3) in the robot frame before it."""
        step = driven(self.pose, self.scales, motion)
        self.pose = step.pose
        self._joint = step.by_state @ self._joint @ step.by_state.T
        self._joint[:3, :3] += step.by_motion @ motion_covariance @ step.by_motion.T
        self._joint[_SCALES, _SCALES] += self._drifting * SCALE_DRIFT**2

    def distance2_to(self, pose: Pose, covariance: FloatArray) -> float:
        """Squared Mahalanobis distance of a match from the prediction; 3 on average while both are right."""
        innovation = pose.minus(self.pose)
        return float(innovation @ np.linalg.solve(self.covariance + covariance, innovation))

    def update(self, pose: Pose, covariance: FloatArray, trusted: bool = True) -> bool:
        """Fuse a match; False if it contradicts the prediction and was not trusted, so that nothing changed.

        A match beyond the gate that is trusted (its points lie well on the lines) means that the robot moved in a way
        that the odometry didn't feel: a shove. The prediction's covariance then grows by just such a jump before the
        fusion, so that the pose follows at once where the lines observe it, and the odometry keeps what they don't.
        """
        innovation = pose.minus(self.pose)
        if self.settings.paper.shoves and self.distance2_to(pose, covariance) > self.settings.gate:
            if not trusted:
                return False
            self._joint[:3, :3] += np.outer(innovation, innovation)
        gain = np.linalg.solve(self.covariance + covariance, self._joint[:3]).T
        step = gain @ innovation
        self.pose = Pose(
            self.pose.x + float(step[0]), self.pose.y + float(step[1]), wrap_angle(self.pose.heading + float(step[2]))
        )
        self.scales = self.scales + step[3:]
        keep = np.eye(6)  # Joseph's form: stays positive definite
        keep[:, :3] -= gain
        self._joint = keep @ self._joint @ keep.T + gain @ covariance @ gain.T
        return True


def equal_error(error: float) -> float:
    """Mean error up to which another pose explains the points as well as one of this mean error."""
    return max(BETTER_FACTOR * error, error + BETTER_MARGIN)


def fused_covariance(one: FloatArray, other: FloatArray) -> FloatArray:
    """(3, 3) of the fusion of two poses with covariances (3, 3)."""
    return one @ np.linalg.solve(one + other, other)
