"""Checks by what the lines say: whether the camera's ranges and the field's dimensions fit the images."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from touchline.checks.delay import find_delay
from touchline.checks.findings import Finding, Severity, graded, too_few
from touchline.checks.survey import Survey
from touchline.field import FieldModel
from touchline.field.distances import nearest_line_points
from touchline.geometry import FloatArray, wrap_angles
from touchline.localization.camera_errors.mirror_response import HEIGHT_M
from touchline.localization.registration.learned_mirror import LearnedMirror
from touchline.perception.covered import is_covered
from touchline.sources.description import CAMERA, FIELD
from touchline.systems import RobotSetup, open_system
from touchline.types import Estimate, ProblemCode, Samples, Status

_SYSTEM = "nubot-mti"  # that leaves the camera as it is told: one that learns its errors would hide them
_MAX_FRAMES = 100  # enough to tell a calibration, and a few tenths of a second
_BLOCKS = 5  # of consecutive frames that these are in, spread over the recording: it may begin with a robot that stands
_MIN_FRAMES = 5
_NEAR_M = 4.0
_GOOD_M = 0.03  # a line's deviation at up to _NEAR_M with a good calibration; real robots have 0.02 to 0.04
_POOR_M = 0.08
_MIN_NEAR = 0.75  # of the points, within a quarter metre; goals and clutter take a tenth
_TILT_DEG = 0.1
_SCALE = 0.01
_HEADING_DEG, _POOR_HEADING_DEG = 1.0, 3.0
_SAME_POSE_M = 1.0
_UNSURE = 0.03  # probability of the other end from which it is to be settled: a start that is told leaves 0.05
_LATE_S = 0.04  # constant delay of the stamps that is told: 8 cm at 2 m/s


def check_lines(survey: Survey) -> Iterator[Finding]:
    """Localize some of the images by their lines and see how well these fit, near and far."""
    recording = survey.recording
    camera = survey.omni
    if not recording.has_observations and (camera is None or recording.linear):
        return
    if (recording.has_observations and not survey.seen["point"]) or (field := survey.field) is None:
        return  # features alone are another check's
    system, tilt = open_system(_SYSTEM, RobotSetup(field, camera)), LearnedMirror(field, looked_for=(False, False))
    estimates, looked, odometry = [], 0, []
    chosen = chosen_frames(len(recording))
    for index, frame in enumerate(recording.again(chosen)):
        odometry.append(frame.odometry)
        if frame.observation is None and (frame.image is None or is_covered(frame.image)):
            continue
        looked += 1
        estimate = system.step(replace(frame, odometry=None, wheels=None))  # poses that have followed no odometry
        if estimate.status is Status.TRACKING and estimate.points:
            estimates.append(estimate)
            assert estimate.observation is not None
            tilt.update(estimate.observation.points, estimate.pose)
        if index == max(chosen):
            break
    if looked < _MIN_FRAMES:
        yield too_few("lines", FIELD, "whether the lines fit", looked, _MIN_FRAMES)
        return
    if len(estimates) < _MIN_FRAMES:
        what = f"the lines fit no pose in {looked - len(estimates)} of {looked} images"
        advice = "Look at `touchline view --stages`; check the field, camera.yaml and whether the carpet is in view."
        yield Finding("lines", Severity.WARNING, FIELD, what, advice)
        return
    frames = [_deviations(tilt, field, estimate) for estimate in estimates]
    near_a_line = sum(len(off) for off, _, _ in frames) / sum(estimate.points for estimate in estimates)
    off = np.concatenate([off[ranges < _NEAR_M] for off, _, ranges in frames])
    yield _fit(off, near_a_line, f"tracked in {len(estimates)} of {looked} images")
    if not recording.has_observations:  # of another detector's points the camera's part is not known
        yield from _range_scale(frames)
        yield _tilt(tilt)
    yield from _late(estimates, odometry)
    yield from _headings(survey, estimates)
    yield from _ends(estimates)


def _ends(estimates: list[Estimate]) -> Iterator[Finding]:
    """Whether the end of a symmetric field is open, where the system tells how sure it is."""
    probabilities = [estimate.twin_probability for estimate in estimates if estimate.twin_probability is not None]
    twin = float(np.median(probabilities)) if probabilities else 0.0
    if twin >= _UNSURE:
        what = "nothing tells the ends of the field apart: the other has a probability of "
        what += f"{100.0 * twin:.0f} % (median)"
        advice = "Use --own-half or --start, a compass, or what team mates say; a wrong start can't be found out."
        yield Finding("ends", Severity.NOTE, FIELD, what, advice, ProblemCode.END_UNDECIDED)


def chosen_frames(frames: int) -> frozenset[int]:
    """Indices of the frames that are looked at: all of a short recording, else blocks of consecutive ones."""
    if frames <= _MAX_FRAMES:
        return frozenset(range(frames))
    length = _MAX_FRAMES // _BLOCKS
    starts = np.linspace(0, frames - length, _BLOCKS).round().astype(int).tolist()
    return frozenset(index for start in starts for index in range(start, start + length))


def _deviations(
    tilt: LearnedMirror, field: FieldModel, estimate: Estimate
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the points within a quarter metre of a line: distance to it (N,) in m, its derivative (N, 4) by x, y, heading
    and by a scale of all ranges, and the range (N,) in m.
    """
    assert estimate.observation is not None
    points = tilt.corrected(estimate.observation.points.positions_m)
    placed = np.ascontiguousarray(estimate.pose.transform(points))
    residuals = placed - nearest_line_points(field.line_tables, placed)
    distance = np.hypot(*residuals.T)
    normal = residuals / np.maximum(distance, 1e-9)[:, np.newaxis]
    seen = placed - np.array([estimate.pose.x, estimate.pose.y])
    turned = np.column_stack((-seen[:, 1], seen[:, 0]))
    derivative = np.column_stack((normal, np.sum(normal * turned, axis=1), np.sum(normal * seen, axis=1)))
    near = distance < 0.25
    return distance[near], derivative[near], np.hypot(*points.T)[near]


def _fit(off: FloatArray, near_a_line: float, tracked: str) -> Finding:
    if not len(off):
        what = f"no point lies near a line, {tracked}"
        advice = "Is it this field, and are the points in metres?"
        return Finding("lines", Severity.WARNING, FIELD, what, advice, ProblemCode.FIELD_OFF_LINES)
    typical = float(np.median(off))
    what = f"points lie {100 * typical:.1f} cm from the lines (median), {tracked}"
    few = near_a_line < _MIN_NEAR
    if few:
        what += f"; but only {100 * near_a_line:.0f} % of them lie near a line at all"
    advice = "Is it this field, and this camera's calibration?"
    poor = few or typical > _POOR_M, Severity.WARNING, advice
    code = ProblemCode.FIELD_OFF_LINES
    return graded("lines", FIELD, what, poor, (typical > _GOOD_M, Severity.NOTE, advice), code=code)


def _range_scale(frames: list[tuple[FloatArray, FloatArray, FloatArray]]) -> Iterator[Finding]:
    """A scale error of the ranges, one for all frames, beside a correction of each frame's pose."""
    information = vector = 0.0
    for off, derivative, ranges in frames:
        weighted = derivative / ((0.02 + 0.005 * ranges**2) ** 2)[:, np.newaxis]
        normal, right = derivative.T @ weighted + np.diag([1.0, 1.0, 1.0, 0.0]), -weighted.T @ off
        by_pose = np.linalg.solve(normal[:3, :3], normal[:3, 3])  # what the pose can explain as well
        information += float(normal[3, 3] - normal[3, :3] @ by_pose)
        vector += float(right[3] - right[:3] @ by_pose)
    if information <= 0.0:
        return
    scale = vector / information
    if abs(scale) > _SCALE:
        what = f"ranges are {'short' if scale > 0 else 'long'} by about {100 * abs(scale):.1f} %"
        advice = "Calibrate the mirror again, or check the field's size."
        yield Finding("ranges", Severity.WARNING, CAMERA, what, advice, ProblemCode.CAMERA_DIFFERS)


def _late(estimates: list[Estimate], odometry: list[Samples | None]) -> Iterator[Finding]:
    """A constant delay of the images' stamps, by how the poses follow the odometry."""
    samples = Samples.joined(odometry)
    found = None if samples is None else find_delay(estimates, samples)
    if found is None or abs(found.late_s) < _LATE_S + 3.0 * found.deviation_s:
        return
    what = (
        f"images are stamped {1000 * abs(found.late_s):.0f} ± {1000 * found.deviation_s:.0f} ms "
        f"too {'late' if found.late_s > 0 else 'early'}: the robot is seen where odometry had it by then"
    )
    advice = "Stamp an image when it is taken, not when it arrives, or subtract the constant delay from its stamps."
    code = ProblemCode.STAMPS_LATE if found.late_s > 0 else ProblemCode.STAMPS_EARLY
    yield Finding("delay", Severity.WARNING, "images.csv", what, advice, code)


def _headings(survey: Survey, estimates: list[Estimate]) -> Iterator[Finding]:
    """A constant difference between the headings by the lines and the true ones, where these are known."""
    truth = survey.recording.truth
    if truth is None:
        return
    pairs = [(estimate.pose, truth.nearest(estimate.stamp_ns)) for estimate in estimates]
    near = [(pose, true) for pose, true in pairs if pose.distance_to(true) < _SAME_POSE_M]
    if len(near) < _MIN_FRAMES:
        return  # the other end of the field, or a truth of something else
    off_deg = np.degrees(wrap_angles([pose.heading - true.heading for pose, true in near]))
    middle = float(np.median(off_deg))
    spread = 1.4826 * float(np.median(np.abs(off_deg - middle)))
    if abs(middle) <= _HEADING_DEG or spread > 0.5 * abs(middle):
        return
    what = f"headings by the lines are {middle:+.1f}° off the true ones throughout (± {spread:.1f}°)"
    advice = f"If the truth is right, add {math.radians(middle):+.4f} rad to mount_yaw."
    severity = Severity.WARNING if abs(middle) > _POOR_HEADING_DEG else Severity.NOTE
    yield Finding("heading", severity, CAMERA, what, advice, ProblemCode.IMAGES_TURNED)


def _tilt(tilt: LearnedMirror) -> Finding:
    """The mirror's lean, from half the angle by which it turns the rays."""
    bend = float(np.hypot(*tilt.mean[:2]))
    lean_deg = math.degrees(math.atan(bend * HEIGHT_M)) / 2.0
    what = f"the mirror leans by about {lean_deg:.2f}°"
    advice = "Matching takes that out; better straighten the mirror."
    return graded("tilt", CAMERA, what, (lean_deg > _TILT_DEG, Severity.NOTE, advice))
