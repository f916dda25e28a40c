"""Measuring wheels: their counters continued over restarts, and how far they err."""

from pydantic import Field

from touchline.config import Settings, added
from touchline.motion.integrated import IntegratedSensor
from touchline.motion.samples import EXTRAPOLATION_S, NANOSECONDS
from touchline.motion.wheel_pair import WheelPair
from touchline.types import MAX_VALUE, Samples

_ZEROED_M_S = 1.0  # a step to exactly zero at less than this speed is no restart but a robot that rolls about


MAX_SPEED_M_S = 10.0  # a counter that steps faster than this was restarted: twice what robots reach


class WheelPaper(Settings):
    """Switches to the paper's exact form."""

    chord: bool = added(
        True,
        paper=False,
        description="a step points along the heading in its middle and is as long as its arc's chord, exact at "
        "constant velocity; false as in equations (2) and (3): along the heading at its start, as long as the way",
    )


class WheelSettings(Settings):
    """How the wheels are scaled, and how much they err."""

    a_lever_m: float = Field(
        0.0,
        description="travel of wheel a per radian of the robot's turn (m); 0 for a wheel on the line through the "
        "robot's origin along its rolling direction, as in the recordings",
    )
    b_lever_m: float = Field(0.0, description="travel of wheel b per radian of the robot's turn (m), as wheel a's")
    a_scale: float = Field(1.0, gt=0, description="true travel per travel that wheel a counts; 1: as it was calibrated")
    b_scale: float = Field(1.0, gt=0, description="true travel per travel that wheel b counts; 1: as it was calibrated")
    scale_error: float = Field(
        0.01, ge=0, description="relative error of a wheel's circumference: measuring wheels err by less than 1 %"
    )
    slip_m: float = Field(
        0.004, ge=0, description="random error of a wheel after one metre of its way (m), growing with the root of it"
    )
    paper: WheelPaper = WheelPaper()

    def pair(self, directions_rad: tuple[float, float] | None) -> WheelPair | None:
        """The wheels with directions of a and b (rad), None if nobody knows them.

        Raises InputError for parallel wheels.
        """
        return None if directions_rad is None else WheelPair(*directions_rad, self.a_lever_m, self.b_lever_m)

    def variance(self, travel_m: float, way_m: float) -> float:
        """Variance (m²) of a wheel's travel: by its circumference with the net travel, by slip with the way rolled."""
        return (self.scale_error * travel_m) ** 2 + self.slip_m**2 * way_m


class WheelCounters:
    """Travels of wheels a and b (m), continued where a counter was set to zero."""

    def __init__(self, settings: WheelSettings) -> None:
        self.settings = settings
        self.integral = IntegratedSensor(2)
        self.dropped = 0
        self.restarts = 0
        self._counted: list[float] = []

    def add(self, samples: Samples) -> None:
        """Append counter readings a, b (m). Rows without numbers, or not later than the newest, are dropped."""
        known = self.integral.samples
        for stamp_ns, values in zip(samples.stamp_ns.tolist(), samples.values.tolist(), strict=True):
            counted = values[:2]
            if not all(abs(value) < MAX_VALUE for value in counted) or (len(known) and stamp_ns <= known.last_ns):
                self.dropped += 1
                continue
            if len(known) == 0:
                self.integral.append(stamp_ns, [0.0, 0.0], after_gap=False)
            else:
                self._continue(stamp_ns, counted)
            self._counted = counted

    def forget_before(self, stamp_ns: int) -> None:
        """Forget what isn't needed to look up travels from a stamp on."""
        self.integral.forget_before(stamp_ns)

    def clear(self) -> None:
        """Forget all samples."""
        self.integral.clear()
        self._counted = []

    def _continue(self, stamp_ns: int, counted: list[float]) -> None:
        s, known = self.settings, self.integral.samples
        last, duration_s = known.last, (stamp_ns - known.last_ns) / NANOSECONDS
        steps = [new - old for new, old in zip(counted, self._counted, strict=True)]
        speed_m_s = max(abs(step) for step in steps) / duration_s
        zeroed = counted == [0.0, 0.0] and speed_m_s > _ZEROED_M_S
        restarted = zeroed or speed_m_s > MAX_SPEED_M_S
        if restarted:
            self.restarts += 1
            steps = [float(rate) * min(duration_s, EXTRAPOLATION_S) for rate in known.slope(EXTRAPOLATION_S)]
        else:
            steps = [scale * step for scale, step in zip((s.a_scale, s.b_scale), steps, strict=True)]
        self.integral.append(stamp_ns, [x + step for x, step in zip(last, steps, strict=True)], restarted)
