"""Kalman fusion of odometry and matching (Xiong et al., section 4.2; Lu et al. 2013, section 4).

Where the lines fix the pose, the match decides; along a direction that no line observes, its covariance is huge and
the odometry carries the pose on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from pydantic import Field

from touchline.config import Settings, constants_now
from touchline.geometry import FloatArray, Pose, wrap_angle

# a match beyond the gate is believed if the prediction's mean error is more than this factor, or BETTER_MARGIN, above
# its own: a lone line that RPROP slid along is explained as well where it was predicted
BETTER_FACTOR = 2.0
BETTER_MARGIN = 0.02  # see BETTER_FACTOR; what noise alone changes in the mean error


class FusionSettings(Settings):
    """The Kalman filter. The paper leaves all of it open."""

    removed: ClassVar[Mapping[str, str]] = {
        **constants_now(__name__, "better_factor", "better_margin"),
        **constants_now(
            "touchline.localization.fusion.tracker", "poor_error", "shove_position_m", "shove_heading_rad", "shoved_rad"
        ),
    }

    gate: float = Field(
        16.3,
        gt=0,
        description="squared Mahalanobis distance between prediction and match above which they contradict each other: "
        "the 99.9 % quantile of chi square with 3 degrees of freedom",
    )
    start_position_m: float = Field(
        0.3, gt=0, description="standard deviation of x and y of a pose told by a person (m)"
    )
    start_heading_rad: float = Field(
        0.15, gt=0, description="standard deviation of the heading of a pose told by a person (rad)"
    )


class PoseFilter:
    """The pose and its covariance (3, 3) of x, y, heading in (m, m, rad), field frame."""

    def __init__(
        self, pose: Pose, covariance: FloatArray | None = None, settings: FusionSettings | None = None
    ) -> None:
        """covariance: of a pose from a match; without one the pose was told by a person."""
        self.settings = settings or FusionSettings()
        self.pose = pose
        if covariance is None:
            s = self.settings
            covariance = np.diag([s.start_position_m, s.start_position_m, s.start_heading_rad]) ** 2
        self.covariance = np.array(covariance, dtype=np.float64)

    def predict(self, motion: Pose, motion_covariance: FloatArray) -> None:
        """Move by the odometry: motion is `before_from_after`, its covariance (3, 3) in the robot frame before it."""
        cosine, sine = math.cos(self.pose.heading), math.sin(self.pose.heading)
        by_pose = np.eye(3)
        by_pose[0, 2] = -sine * motion.x - cosine * motion.y
        by_pose[1, 2] = cosine * motion.x - sine * motion.y
        by_motion = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        self.pose = self.pose.compose(motion)
        self.covariance = by_pose @ self.covariance @ by_pose.T + by_motion @ motion_covariance @ by_motion.T

    def distance2_to(self, pose: Pose, covariance: FloatArray) -> float:
        """Squared Mahalanobis distance of a match from the prediction; 3 on average while both are right."""
        innovation = self._innovation(pose)
        return float(innovation @ np.linalg.solve(self.covariance + covariance, innovation))

    def update(self, pose: Pose, covariance: FloatArray, trusted: bool = True) -> bool:
        """Fuse a match; False if it contradicts the prediction and was not trusted, so that nothing changed.

        A match beyond the gate that is trusted (its points lie well on the lines) means that the robot moved in a way
        that the odometry didn't feel: a shove. The prediction's covariance then grows by just such a jump before the
        fusion, so that the pose follows at once where the lines observe it, and the odometry keeps what they don't.
        """
        innovation = self._innovation(pose)
        if self.distance2_to(pose, covariance) > self.settings.gate:
            if not trusted:
                return False
            self.covariance = self.covariance + np.outer(innovation, innovation)
        gain = np.linalg.solve(self.covariance + covariance, self.covariance).T
        step = gain @ innovation
        self.pose = Pose(
            self.pose.x + float(step[0]), self.pose.y + float(step[1]), wrap_angle(self.pose.heading + float(step[2]))
        )
        keep = np.eye(3) - gain  # Joseph's form: stays positive definite
        self.covariance = keep @ self.covariance @ keep.T + gain @ covariance @ gain.T
        return True

    def _innovation(self, pose: Pose) -> FloatArray:
        return np.array(
            [pose.x - self.pose.x, pose.y - self.pose.y, wrap_angle(pose.heading - self.pose.heading)], dtype=np.float64
        )


def equal_error(error: float) -> float:
    """Mean error up to which another pose explains the points as well as one of this mean error."""
    return max(BETTER_FACTOR * error, error + BETTER_MARGIN)
