"""The gyro: its turning rate integrated to an angle, and how far that errs."""

import math

from pydantic import Field

from touchline.config import Settings
from touchline.motion.integrated import IntegratedSensor
from touchline.motion.samples import NANOSECONDS
from touchline.types import MAX_VALUE, Samples

NOISE_RAD = 0.002  # random heading error after one second, growing with the root of the time
GAP_S = 0.25  # time without a reading after which the turn in it is unknown: two of a slow one


class GyroSettings(Settings):
    """How the gyro is scaled, and how much it errs."""

    scale: float = Field(1.0, gt=0, description="true turning rate per rate that the gyro shows")
    bias_rad_s: float = Field(0.0, description="what the gyro shows at rest (rad/s); 0: not known")
    scale_error: float = Field(0.01, ge=0, description="relative error of the scale: 1 % is usual of cheap gyros")
    bias_error_rad_s: float = Field(
        0.01, ge=0, description="error of the bias (rad/s): 0.2 to 0.5 degrees per second are usual"
    )

    def variance(self, turns_rad: float, duration_s: float) -> float:
        """Variance (rad²) of the angle after some time in which the turns add up to turns_rad, both ways."""
        known = (self.scale_error * turns_rad) ** 2 + (self.bias_error_rad_s * duration_s) ** 2
        return known + NOISE_RAD**2 * duration_s


class IntegratedGyro:
    """Equation (1) of Ismail et al. 2021: the turning rate, integrated to an angle by trapezoids."""

    def __init__(self, settings: GyroSettings) -> None:
        self.settings = settings
        self.integral = IntegratedSensor(2)
        """Of the samples: the angle (rad, not wrapped) and the corrected rate (rad/s) at each reading."""
        self.dropped = 0

    def add(self, samples: Samples) -> None:
        """Append readings gx, gy, gz (rad/s). Rows without a usable gz, or not later than the newest, are dropped."""
        known, scale, bias_rad_s = self.integral.samples, self.settings.scale, self.settings.bias_rad_s
        last_ns, (angle_rad, last_rad_s) = (known.last_ns, known.last) if len(known) else (None, [0.0, 0.0])
        for stamp_ns, reading in zip(samples.stamp_ns.tolist(), samples.values[:, 2].tolist(), strict=True):
            if not abs(reading) < MAX_VALUE or (last_ns is not None and stamp_ns <= last_ns):
                self.dropped += 1
                continue
            rate_rad_s = scale * (reading - bias_rad_s)
            if last_ns is not None:
                angle_rad += 0.5 * (last_rad_s + rate_rad_s) * (stamp_ns - last_ns) / NANOSECONDS
                if stamp_ns - last_ns > GAP_S * NANOSECONDS:
                    self.integral.note_gap(last_ns, stamp_ns)
            known.append(stamp_ns, [angle_rad, rate_rad_s])
            last_ns, last_rad_s = stamp_ns, rate_rad_s

    def rate_rad_s(self, start_ns: int, end_ns: int) -> float | None:
        """Mean of the turning rates read from one stamp to another, both included; None without one."""
        rates_rad_s = [rate_rad_s for _, rate_rad_s in self.integral.samples.rows_within(start_ns, end_ns)]
        return math.fsum(rates_rad_s) / len(rates_rad_s) if rates_rad_s else None

    def turn_rad(self, start_ns: int, end_ns: int) -> float:
        """The turn (rad, not wrapped) from one stamp to another; NaN where the readings don't tell it."""
        known = self.integral.samples
        if self.integral.gaps_ns(start_ns, end_ns):
            return math.nan
        beyond_s = (end_ns - max(start_ns, known.last_ns)) / NANOSECONDS
        turn_rad = known.at(end_ns)[0] - known.at(start_ns)[0]
        return turn_rad + known.last[1] * beyond_s if beyond_s > 0.0 else turn_rad

    def forget_before(self, stamp_ns: int) -> None:
        """Forget what isn't needed to look up angles from a stamp on."""
        self.integral.forget_before(stamp_ns)

    def clear(self) -> None:
        """Forget all readings."""
        self.integral.clear()
