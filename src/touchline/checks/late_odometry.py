"""A check of when odometry comes, beside features of the robot's own detector: by the headings that these tell.

Messages without a stamp are as old as their receipt, and nobody tells how late that is. Features correct the heading
least where the odometry's turns are put at their own time: the shift at which they do is found.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from touchline.checks.delay import Delay
from touchline.checks.findings import Finding, Severity
from touchline.checks.survey import Survey
from touchline.field import FieldModel
from touchline.geometry import FloatArray, wrap_angles
from touchline.systems import RobotSetup, open_system
from touchline.types import Frame, ProblemCode, Samples, Status

_SYSTEM = "touchline"
_MAX_NS = 60_000_000_000
_STEP_S = 0.05
_SHIFTS_S = (-0.2, -0.1, 0.0, 0.1, 0.2)  # and two more about the best
_MIN_STEPS, _FIRST_STEPS = 250, 20  # half of a minute: in less, a few turns decide
_MAX_RAD = math.radians(6.0)  # of a correction: more is another pose
_TOGETHER = 4.0  # standard deviations are larger by: corrections err together, as walks of a minute show
_LATE_S = 0.03  # that is told: 3 cm at 1 m/s
_SURE = 2.0  # standard deviations


def check_late_odometry(survey: Survey) -> Iterator[Finding]:
    """Whether the odometry's times are late or early against those of features."""
    recording = survey.recording
    if not recording.has_observations or survey.seen["point"] or not np.isfinite(survey.column("theta")).any():
        return
    if survey.field is None:
        return
    first_ns = int(recording.image_stamps[0]) if len(recording) else 0
    frames = list(itertools.takewhile(lambda each: each.stamp_ns - first_ns < _MAX_NS, recording.again()))
    found = find_late(survey.field, frames)
    if found is None or abs(found.late_s) < max(_LATE_S, _SURE * found.deviation_s):
        return
    late_ms, give_or_take = 1e3 * found.late_s, 1e3 * found.deviation_s
    way, code = ("later", ProblemCode.STAMPS_EARLY) if late_ms > 0.0 else ("earlier", ProblemCode.STAMPS_LATE)
    what = f"odometry comes {abs(late_ms):.0f} ± {give_or_take:.0f} ms {way} than what the features show of turns"
    advice = f"Where an odometer of a bag or a live robot has no stamps, --late {late_ms:.0f} takes that off."
    yield Finding("delay", Severity.WARNING, "odometry.csv", what, advice, code)


def find_late(field: FieldModel, frames: Sequence[Frame]) -> Delay | None:
    """How late the samples of frames with features come; None where that is not shown: the robot hardly turns."""
    if len(frames) < _MIN_STEPS:
        return None

    @cache
    def corrections(shift: float) -> FloatArray:
        return _corrections(field, frames, shift)

    def cost(shift: float) -> float:
        found = corrections(shift)
        return float(np.mean(np.minimum(found, _MAX_RAD) ** 2)) if len(found) else math.inf

    middle = min(_SHIFTS_S[1:-1], key=cost)
    best = min(sorted({*_SHIFTS_S, middle - _STEP_S, middle + _STEP_S}), key=cost)
    before, here, after = (cost(shift) for shift in (best - _STEP_S, best, best + _STEP_S))
    bend, count = before - 2.0 * here + after, len(corrections(best))
    if count < _MIN_STEPS or not bend > 0.0 or not math.isfinite(bend):
        return None
    deviation_s = _STEP_S * math.sqrt(2.0 * here / (count * bend))
    return Delay(best + 0.5 * _STEP_S * (before - after) / bend, _TOGETHER * deviation_s)


def _corrections(field: FieldModel, frames: Sequence[Frame], late_s: float) -> FloatArray:
    """(K,) by how much images turned the heading that odometry had carried on (rad, absolute), were it so late."""
    shifted = [*_redealt(frames, round(1e9 * late_s))]
    # a scale of the turns that is learned would take up a part of it
    system = open_system(_SYSTEM, RobotSetup(field, None), {"odometry.turn_scale": 0.0})
    estimates = [system.step(frame) for frame in shifted]
    odometry = Samples.joined(frame.odometry for frame in shifted)
    if odometry is None:
        return np.zeros(0)
    at_ns = np.array([estimate.stamp_ns for estimate in estimates], dtype=np.float64)
    headings = np.array([estimate.pose.heading for estimate in estimates])
    turned = np.interp(at_ns, odometry.stamp_ns.astype(np.float64), np.unwrap(odometry.values[:, 2]))
    steps = wrap_angles(np.diff(headings) - np.diff(turned))
    tracking = np.array([estimate.status is Status.TRACKING for estimate in estimates])
    kept = tracking[1:] & tracking[:-1] & (np.abs(steps) > 1e-9)
    kept[:_FIRST_STEPS] = False
    return np.abs(steps[kept] - np.median(steps[kept])) if kept.any() else np.zeros(0)


def _redealt(frames: Sequence[Frame], late_ns: int) -> Iterator[Frame]:
    """Frames whose samples of motion were measured so much earlier than they say."""
    sensors = ("odometry", "gyro", "tilt", "compass")
    joined = {sensor: Samples.joined(getattr(frame, sensor) for frame in frames) for sensor in sensors}
    ends = dict.fromkeys(sensors, 0)
    for frame in frames:
        dealt: dict[str, Any] = dict.fromkeys(sensors)
        for sensor, samples in joined.items():
            if samples is not None:
                begin, end = ends[sensor], int(samples.stamp_ns.searchsorted(frame.stamp_ns + late_ns, side="right"))
                if end > begin:
                    dealt[sensor] = Samples(samples.stamp_ns[begin:end] - late_ns, samples.values[begin:end])
                ends[sensor] = end
        yield replace(frame, **dealt)
