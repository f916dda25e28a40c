"""The pose by measuring wheels and gyro, corrected from outside.

M. A. Ismail, D. Purwanto, A. Arifin: Soccer robot localization based on sensor fusion from odometry and omnivision,
section II.A, equations (4) to (6), figure 4.
"""

import numpy as np

from touchline.geometry import Pose, wrap_angle
from touchline.motion.history import MotionHistory
from touchline.motion.odometry import Motion
from touchline.motion.samples import EXTRAPOLATION_S, NANOSECONDS
from touchline.motion.wheel_odometry import Rolled


class DeadReckoning:
    """`pose`: x_o, y_o, θ_o of equations (4) to (6), taken from frame to frame by a motion history.

    What had to be extrapolated at one frame is replaced by what was measured at the next. Where wheels or gyro say
    nothing, the odometry takes their place, if it knows more.
    """

    def __init__(self, history: MotionHistory) -> None:
        """Raises ValueError for a history without wheels."""
        if history.wheels is None:
            raise ValueError("dead reckoning by wheels needs a motion history with wheels")
        self.history = history
        self.wheels = history.wheels
        self.reset()

    def reset(self, pose: Pose | None = None) -> None:
        """Start anew at a pose (field frame), by default at the origin."""
        self.sums = [0.0, 0.0, 0.0]
        """Σ Δx_o, Σ Δy_o (m), Σ Δθ_o (rad, not wrapped) of equations (4) to (6), up to the newest sample used."""
        self.offset = [0.0, 0.0, 0.0]
        """x_ofst, y_ofst (m), θ_ofst (rad) of equations (4) to (6)."""
        self._summed_ns = 0
        self._extrapolated = Pose(0.0, 0.0, 0.0)  # from the newest sample used to the frame
        self.stamp_ns: int | None = None
        self.set_pose(pose or Pose(0.0, 0.0, 0.0))

    @property
    def pose(self) -> Pose:
        """x_o, y_o, θ_o at the last frame: the sums and the offset of equations (4) to (6)."""
        return self._summed_pose().compose(self._extrapolated)

    def set_pose(self, pose: Pose) -> None:
        """Change the offset so that the pose at the last frame is this one (figure 4: from the fusion).

        Where the wheels have been silent for longer than their motion is extrapolated, the pose holds their way, too:
        what they tell of it later is not added.
        """
        if self.stamp_ns is not None and self.stamp_ns - self._summed_ns > int(EXTRAPOLATION_S * NANOSECONDS):
            self._summed_ns, self._extrapolated = self.stamp_ns, Pose(0.0, 0.0, 0.0)
        summed = pose.compose(self._extrapolated.inverse())
        self.offset = [value - total for value, total in zip(summed, self.sums, strict=True)]

    def advance(self, stamp_ns: int, gyro_bias_rad_s: float = 0.0) -> Motion:
        """The motion since the last frame; none at the first one. The history has this frame's samples already.

        gyro_bias_rad_s: what the gyro shows at rest as far as it was learned; taken off where the gyro tells the turn.
        """
        start_ns, self.stamp_ns = self.stamp_ns, stamp_ns
        if start_ns is None:
            self._summed_ns = stamp_ns
            return Motion(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)
        before = self.pose
        motion = self.history.odometry_instead(start_ns, stamp_ns)
        if motion is not None:
            self._take_over(before.compose(motion.pose), stamp_ns)
            return motion
        motion = self._measured(before, start_ns, stamp_ns)
        if motion.by_gyro:
            motion = without_bias(motion, gyro_bias_rad_s, (stamp_ns - start_ns) / NANOSECONDS)
            self.set_pose(before.compose(motion.pose))
        return motion

    def _summed_pose(self) -> Pose:
        x, y, heading = (total + offset for total, offset in zip(self.sums, self.offset, strict=True))
        return Pose(x, y, wrap_angle(heading))

    def _measured(self, before: Pose, start_ns: int, end_ns: int) -> Motion:
        """By wheels and gyro; where an earlier frame had to extrapolate, its error is made good in this one."""
        known_ns = self.wheels.known_until_ns(self._summed_ns, end_ns)
        rolled = Rolled()
        for step in self.wheels.steps(self._summed_ns, known_ns):
            rolled.add(step)
            moved = self.wheels.displaced(step, self.sums[2] + self.offset[2])
            self.sums = [self.sums[0] + moved.x, self.sums[1] + moved.y, self.sums[2] + step.turn_rad]
        self._summed_ns = known_ns
        beyond = self.wheels.extrapolated(known_ns, end_ns)
        self._extrapolated = Pose(0.0, 0.0, 0.0) if beyond is None else self.wheels.displaced(beyond)
        pose, missing_s = before.inverse().compose(self.pose), self.wheels.missing_s(start_ns, end_ns)
        return self.wheels.motion(pose, rolled, (end_ns - start_ns) / NANOSECONDS, missing_s)

    def _take_over(self, pose: Pose, stamp_ns: int) -> None:
        """Go on from the pose that the odometry led to."""
        self._extrapolated = Pose(0.0, 0.0, 0.0)
        summed = self._summed_pose()
        turn_rad = wrap_angle(pose.heading - summed.heading)
        self.sums = [self.sums[0] + pose.x - summed.x, self.sums[1] + pose.y - summed.y, self.sums[2] + turn_rad]
        self._summed_ns = stamp_ns


def without_bias(motion: Motion, bias_rad_s: float, duration_s: float) -> Motion:
    """A motion over some time without the turn that a gyro's bias added to it, and half of that in its direction."""
    turn_rad = bias_rad_s * duration_s
    moved = Pose(0.0, 0.0, -0.5 * turn_rad).compose(motion.pose)
    return motion._replace(pose=moved._replace(heading=wrap_angle(motion.pose.heading - turn_rad)))
