"""All that a robot feels of its own motion in the last seconds, and any past interval of it, as often as asked."""

import math
from typing import NamedTuple, Protocol

import numpy as np

from touchline.errors import InputError
from touchline.geometry import Pose, wrap_angle
from touchline.motion.clocks import SensorClocks
from touchline.motion.compass import MAX_AGE_S, Compass, CompassTrackSettings
from touchline.motion.gyro import GyroSettings, IntegratedGyro
from touchline.motion.odometry import Motion, Odometry, OdometrySettings
from touchline.motion.samples import NANOSECONDS, SampleHistory
from touchline.motion.wheel_odometry import WheelOdometry
from touchline.motion.wheels import WheelSettings
from touchline.types import Frame, Samples

_KEPT_NS = int(5.0 * NANOSECONDS)  # before the last frame: images come late by some tenths of a second
_TIDY_NS = int(0.5 * NANOSECONDS)  # between two times at which older samples are forgotten
_MAX_NS = int(60.0 * NANOSECONDS)  # without any frame, so that memory stays bounded
_KEPT_MOTIONS = 8  # that were asked for since the last samples


class Orientation(NamedTuple):
    """The compass heading (rad, field frame, uncorrected), roll and pitch (rad); None where not measured lately."""

    heading_rad: float | None
    roll_rad: float | None
    pitch_rad: float | None


class Sensor(Protocol):
    """What the history knows of each sensor."""

    @property
    def dropped(self) -> int: ...
    def add(self, samples: Samples) -> None: ...
    def forget_before(self, stamp_ns: int) -> None: ...
    def clear(self) -> None: ...


class MotionHistory:
    """Odometry, measuring wheels, gyro, compass and attitude of at least the last 5 s, each with its own noise.

    Samples without numbers and out of order are dropped, samples far ahead of everything else are refused; both are
    counted.
    """

    def __init__(
        self,
        odometry: OdometrySettings | None = None,
        compass: CompassTrackSettings | None = None,
        gyro: GyroSettings | None = None,
        wheels: WheelSettings | None = None,
        wheel_directions_rad: tuple[float, float] | None = None,
    ) -> None:
        """wheels: None for motion by the odometry alone. wheel_directions_rad: of a and b in the robot frame, where the
        settings name none. Raises InputError for parallel wheels.
        """
        self.clocks = SensorClocks()
        self.odometry = Odometry(odometry or OdometrySettings())
        self.gyro = IntegratedGyro(gyro or GyroSettings())
        self.compass = Compass(compass or CompassTrackSettings(), self.gyro)
        self.attitude = SampleHistory(columns=2)
        self.wheels: WheelOdometry | None = None
        self._tidied_ns = 0
        self._motions: dict[tuple[int, int], Motion] = {}  # by stamps: an image's is asked for more than once
        self._sensors: dict[str, Sensor] = {
            "odometry": self.odometry.samples,
            "gyro": self.gyro,
            "compass": self.compass.samples,
            "attitude": self.attitude,
        }
        if wheels is not None:
            self.wheels = WheelOdometry(wheels, wheels.pair(wheel_directions_rad), self.gyro)
            self._sensors["wheels"] = self.wheels.wheels

    def add(self, frame: Frame) -> None:
        """Take all samples of a frame. Raises ValueError, and takes none, if it is older than the newest frame."""
        if not isinstance(frame, Frame) or not isinstance(frame.stamp_ns, (int, np.integer)):
            raise InputError(f"a system steps a Frame with a whole number of nanoseconds, got {frame!r:.60}")
        newest_ns = self.clocks.frame_ns
        if newest_ns is not None and frame.stamp_ns < newest_ns:
            raise ValueError(
                f"motion runs forward in time, got {newest_ns} to {frame.stamp_ns} ns: a system whose frames may be "
                "out of order is stepped through an OrderedSystem"
            )
        self.clocks.frame_ns = frame.stamp_ns
        sensors = frame.odometry, frame.wheels, frame.gyro, frame.compass, frame.tilt
        for name, samples in zip(("odometry", "wheels", "gyro", "compass", "attitude"), sensors, strict=True):
            if samples is not None:
                self._take(name, samples)
        if newest_ns is not None and not 0 <= newest_ns - self._tidied_ns < _TIDY_NS:
            self._tidied_ns = newest_ns
            for sensor in self._sensors.values():
                sensor.forget_before(newest_ns - _KEPT_NS)

    def take(self, frame: Frame) -> Motion:
        """`add`, and the motion since the frame before; none at the first one."""
        before_ns = self.clocks.frame_ns
        self.add(frame)
        if before_ns is None:
            return Motion(Pose(0.0, 0.0, 0.0), np.zeros((3, 3)), 0.0)
        return self.between(before_ns, frame.stamp_ns)

    def add_samples(self, name: str, samples: Samples | None) -> None:
        """Take samples of a sensor: odometry, wheels, gyro, compass, attitude. Those of one not in use are ignored."""
        self._take(name, samples)
        newest_ns = self.clocks.newest_ns(name)
        if newest_ns is not None:
            self._sensors[name].forget_before(newest_ns - _MAX_NS)

    def _take(self, name: str, samples: Samples | None) -> None:
        sensor = self._sensors.get(name)
        if sensor is None or samples is None or len(samples) == 0:
            return
        self._motions.clear()
        samples, clock_jumped = self.clocks.believed(name, samples)
        if clock_jumped:
            sensor.clear()
        sensor.add(samples)

    def clear(self) -> None:
        """Forget all samples, as if none had come yet; counts stay."""
        self.clocks.clear()
        self._motions.clear()
        for sensor in self._sensors.values():
            sensor.clear()

    def between(self, start_ns: int, end_ns: int) -> Motion:
        """The robot's motion from one stamp to a later one, by wheels and gyro or by the odometry, if it knows more.

        Raises ValueError if the stamps run backwards.
        """
        if end_ns < start_ns:
            raise ValueError(f"motion runs forward in time, got {start_ns} to {end_ns} ns")
        if (start_ns, end_ns) not in self._motions:
            if len(self._motions) >= _KEPT_MOTIONS:
                self._motions.clear()
            self._motions[start_ns, end_ns] = self._between(start_ns, end_ns)
        return self._motions[start_ns, end_ns]

    def _between(self, start_ns: int, end_ns: int) -> Motion:
        if self.wheels is None:
            return self.odometry.between(start_ns, end_ns)
        return self.odometry_instead(start_ns, end_ns) or self.wheels.between(start_ns, end_ns)

    def gyro_apart_rad(self, start_ns: int, end_ns: int) -> float:
        """How far the gyro's turn is from the motion's (rad); NaN where it tells none of its own."""
        motion = self.between(start_ns, end_ns)
        turn_rad = math.nan if motion.by_gyro else self.gyro.turn_rad(start_ns, end_ns)
        return abs(wrap_angle(turn_rad - motion.pose.heading))

    def odometry_instead(self, start_ns: int, end_ns: int) -> Motion | None:
        """The odometry's motion, if wheels or gyro say nothing for some of the time and the odometry knows more."""
        missing_s = 0.0 if self.wheels is None else self.wheels.missing_s(start_ns, end_ns)
        if missing_s == 0.0:
            return None
        motion = self.odometry.between(start_ns, end_ns)
        return motion if motion.missing_s < missing_s else None

    def at(self, stamp_ns: int) -> Orientation:
        """How the robot was oriented at a stamp."""
        return Orientation(self.compass.heading_at(stamp_ns), *self._attitude_at(stamp_ns))

    @property
    def dropped(self) -> dict[str, int]:
        """Samples left out so far, by sensor: without a number, or not later than the newest."""
        return {name: sensor.dropped for name, sensor in self._sensors.items()}

    @property
    def refused(self) -> dict[str, int]:
        """Samples refused so far, by sensor: far ahead of the frames and of every other sensor."""
        return {name: self.clocks.refused[name] for name in self._sensors}

    def _attitude_at(self, stamp_ns: int) -> tuple[float | None, float | None]:
        """Roll and pitch (rad), as late as the compass: both come from one filter."""
        known = self.attitude
        wanted_ns = stamp_ns + int(self.compass.settings.lag_s * NANOSECONDS)
        if len(known) == 0 or max(stamp_ns - known.last_ns, known.first_ns - wanted_ns) > MAX_AGE_S * NANOSECONDS:
            return None, None
        roll_rad, pitch_rad = known.at(wanted_ns)
        return roll_rad, pitch_rad
