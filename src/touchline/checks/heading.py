"""Checks of everything that turns: gyro, compass and odometry against each other, the compass's lag."""

import math
from collections.abc import Iterator

import numpy as np

from touchline.checks.findings import Finding, Severity, graded
from touchline.checks.survey import Survey
from touchline.geometry import FloatArray, wrap_angles
from touchline.sources.description import finite_number
from touchline.types import ProblemCode

_WINDOW_S = 0.5
_MIN_TURN_RAD = math.radians(8.0)
_MIN_WINDOWS = 5
_TOLERANCE = 0.12
_COMPASS_TOLERANCE = 0.3  # magnetic disturbance depends on the place
_LAG_TOLERANCE_S = 0.06
_MAX_STEP_S = 0.25
_COMPASS = "the compass"


def check_turns(survey: Survey) -> Iterator[Finding]:
    """Whether gyro, compass and odometry turn the same way and equally far."""
    turns = {
        "gz (summed)": survey.turn_rad[1:],
        _COMPASS: survey.turns("yaw"),
        "odometry's theta": survey.turns("theta"),
    }
    usable = {name: steps for name, steps in turns.items() if np.isfinite(steps).any()}
    reference, *others = usable or [""]
    for name in others:
        file = "odometry.csv" if name.startswith("odometry") else "imu.csv"
        ratio = _ratio_of_turns(usable[reference], usable[name], survey)
        if ratio is None:
            what = f"{name} is not compared with {reference}: the robot hardly turns"
            yield Finding("turns", Severity.NOTE, file, what, "Record a turn on the spot to have it compared.")
            continue
        tolerance = _COMPASS_TOLERANCE if name == _COMPASS else _TOLERANCE
        code = ProblemCode.ODOMETRY_TURN_SIGN if ratio < 0.0 else ProblemCode.ODOMETRY_TURN_SCALE
        yield graded(
            "turns",
            file,
            f"{name} turns {ratio:.3f} × as far as {reference}",
            (ratio < 0.0, Severity.ERROR, "One of them counts clockwise, or degrees instead of radians."),
            (ratio < 0.3, Severity.ERROR, "Check the units."),
            (abs(ratio - 1.0) > tolerance, Severity.WARNING, "Check the scale of both sensors."),
            code="" if name == _COMPASS else code,
        )


def check_compass_lag(survey: Survey) -> Iterator[Finding]:
    """How late the compass is: what it lacks behind the summed gyro grows with the yaw rate."""
    lack = wrap_angles(survey.turns("yaw") - survey.turn_rad[1:])
    change = np.diff(survey.column("gz"))
    good = np.isfinite(lack) & np.isfinite(change) & (np.abs(lack) < math.radians(5.0))
    good &= np.diff(survey.stamps_s) < _MAX_STEP_S
    power = float(np.sum(change[good] ** 2))
    if good.sum() < 20 or power == 0.0:
        return
    lag = -float(np.sum(lack[good] * change[good])) / power
    deviation = float(np.std(lack[good] + lag * change[good])) / math.sqrt(power)
    if deviation > 0.02:
        return
    imu = survey.recording.sequence.get("imu")
    expected = finite_number(imu.get("tilt_and_yaw_lag_s")) or 0.0 if isinstance(imu, dict) else 0.0
    what = f"the compass is {1000 * lag:.0f} ± {1000 * deviation:.0f} ms late, {1000 * expected:.0f} ms documented"
    late = abs(lag - expected) > _LAG_TOLERANCE_S + 3.0 * deviation
    advice = "Write imu: tilt_and_yaw_lag_s into sequence.yaml, or correct the time stamps."
    yield graded("compass lag", "imu.csv", what, (late, Severity.WARNING, advice))


def check_compass(survey: Survey) -> Iterator[Finding]:
    """The compass against the true heading, where that is known."""
    truth = survey.recording.truth
    yaw = survey.column("yaw")
    if truth is None or not np.isfinite(yaw).any():
        return
    nearest = [truth.nearest_index(int(stamp)) for stamp in survey.recording.image_stamps]
    error = wrap_angles(yaw - truth.poses[nearest, 2])[np.isfinite(yaw) & ~survey.black]
    if len(error) == 0:
        return
    middle = math.atan2(float(np.median(np.sin(error))), float(np.median(np.cos(error))))
    spread = float(np.sqrt(np.mean(wrap_angles(error - middle) ** 2)))
    what = f"the compass is {math.degrees(middle):+.1f}° off the true heading, ± {math.degrees(spread):.1f}° rms"
    off_deg, spread_deg = math.degrees(abs(middle)), math.degrees(spread)
    usable = "Usable; calibrating the compass away from metal makes the search for the pose surer."
    yield graded(
        "compass",
        "imu.csv",
        what,
        (off_deg > 45.0, Severity.ERROR, "Its zero has to be the field's x axis."),
        (max(off_deg, spread_deg) > 12.0, Severity.WARNING, "Calibrate the compass away from metal."),
        (off_deg >= 8.0 or spread_deg >= 6.0, Severity.NOTE, usable),
    )


def _ratio_of_turns(reference: FloatArray, steps: FloatArray, survey: Survey) -> float | None:
    """Median ratio of the turns over windows of half a second in which the reference turns; None if it hardly does."""
    stamps = survey.stamps_s
    width = max(round(_WINDOW_S / float(np.median(np.diff(stamps)))), 1)
    starts = np.arange(0, len(steps) - width + 1)
    a, b = (np.concatenate(([0.0], np.nancumsum(values)))[:, None] for values in (reference, steps))
    broken = np.concatenate(([0], np.cumsum(~(np.isfinite(reference) & np.isfinite(steps)))))
    far, near = starts + width, starts
    turned = (a[far] - a[near]).ravel()
    use = (np.abs(turned) > _MIN_TURN_RAD) & (broken[far] == broken[near]) & (stamps[far] - stamps[near] < 3.0)
    if use.sum() < _MIN_WINDOWS:
        return None
    return float(np.median((b[far] - b[near]).ravel()[use] / turned[use]))
