"""The compass: the heading at a stamp, its lag made good by the gyro."""

from pydantic import Field

from touchline.config import Settings
from touchline.geometry import wrap_angle
from touchline.motion.gyro import IntegratedGyro
from touchline.motion.samples import NANOSECONDS, SampleHistory

# time over which the compass's own turning rate is taken to bridge the lag without a gyro: long enough to average its
# noise of half a degree
RATE_WINDOW_S = 0.1
MAX_AGE_S = 0.3  # age of the newest sample beyond which there is no heading: three image periods
# probability that a compass is false from the first image on, built in or told the wrong way round: the pose's twin has
# it as long as nothing but the compass tells the end
COMPASS_FALSE = 0.02


class CompassTrackSettings(Settings):
    """How the heading at a stamp follows from samples before it."""

    lag_s: float = Field(
        0.02,
        ge=0,
        description="how late the compass reports (s): a sample shows the heading of this long before its "
        "stamp; 20 ms are usual of filtered headings",
    )


class Compass:
    """The compass headings of the last seconds. samples: yaw (rad, field frame)."""

    def __init__(self, settings: CompassTrackSettings, gyro: IntegratedGyro) -> None:
        """gyro: tells the turning rate while the compass has not reported yet."""
        self.settings = settings
        self.samples = SampleHistory(columns=1, angle=0)
        self.gyro = gyro

    def heading_at(self, stamp_ns: int) -> float | None:
        """The compass heading (rad, field frame, uncorrected) at a stamp; None if there's no recent sample.

        The reading for this instant comes lag_s later. While it isn't there yet, the turning rate bridges the time.
        """
        if len(self.samples) == 0:
            return None
        wanted_ns = stamp_ns + int(self.settings.lag_s * NANOSECONDS)
        beyond_s = (wanted_ns - self.samples.last_ns) / NANOSECONDS
        before_s = (self.samples.first_ns - wanted_ns) / NANOSECONDS
        if max(beyond_s - self.settings.lag_s, before_s) > MAX_AGE_S:
            return None
        if beyond_s <= 0.0:
            return wrap_angle(self.samples.at(wanted_ns)[0])
        return wrap_angle(self.samples.last[0] + self._rate_rad_s(stamp_ns, beyond_s) * beyond_s)

    def _rate_rad_s(self, stamp_ns: int, bridged_s: float) -> float:
        """Turning rate over the bridged time before the stamp."""
        rate_rad_s = self.gyro.rate_rad_s(stamp_ns - int(bridged_s * NANOSECONDS), stamp_ns)
        return float(self.samples.slope(RATE_WINDOW_S)[0]) if rate_rad_s is None else rate_rad_s
