"""A check by what lines, crossings and landmarks say: whether a humanoid's camera and field fit its images."""

import math
from collections import Counter
from collections.abc import Iterator

import numpy as np

from touchline.checks.findings import Finding, Severity, graded, too_few
from touchline.checks.projection import perspective_camera
from touchline.checks.survey import Survey
from touchline.messages import without_numbers
from touchline.perception.covered import is_covered
from touchline.sources.description import CAMERA, FIELD
from touchline.sources.observations import OBSERVATIONS
from touchline.systems import RobotSetup, open_system
from touchline.types import ProblemCode, Status

_SYSTEM = "nimbro-lines"
_MAX_FRAMES, _MIN_FRAMES = 40, 5
_GOOD_M = 0.10  # mean error of the features at the pose; the recordings have 2 to 4 cm
_ASKEW_DEG = 0.8  # more is beyond what the system estimates for sure


def check_features(survey: Survey) -> Iterator[Finding]:
    """Localize the first images through a perspective camera, or by features of the robot's own detector."""
    recording = survey.recording
    own = recording.has_observations
    camera = None if own else perspective_camera(survey)
    if (camera is None and not own) or (own and survey.seen["point"]) or survey.field is None:
        return  # line points are another check's
    system = open_system(_SYSTEM, RobotSetup(survey.field, camera))
    looked, residuals_m, unseen = 0, [], Counter[str]()
    for frame in recording.again():
        if looked == _MAX_FRAMES:
            break
        if frame.observation is None and (own or frame.image is None or is_covered(frame.image)):
            continue
        looked += 1
        estimate = system.step(frame)
        assert estimate.observation is not None
        if estimate.observation.problem is not None:
            unseen[without_numbers(estimate.observation.problem)] += 1
            last = estimate.observation.problem
        elif estimate.status is Status.TRACKING and math.isfinite(estimate.residual_m):
            residuals_m.append(estimate.residual_m)
    if looked < _MIN_FRAMES:
        yield too_few("features", FIELD, "whether the features fit", looked, _MIN_FRAMES)
        return
    if unseen and 2 * unseen.total() > looked:
        what, _, advice = last.partition(": ")
        advice = f"{advice[:1].upper()}{advice[1:]}" if advice else "Look at `touchline view --stages`."
        advice += "" if advice.endswith(("?", ".")) else "."
        yield Finding("features", Severity.ERROR, CAMERA, f"in {unseen.total()} of {looked} images, {what}", advice)
        return
    yield from _fit(residuals_m, looked, own)
    if not own and residuals_m:
        yield from _askew(np.degrees(getattr(system, "camera_lean", np.zeros(2))))


def _fit(residuals_m: list[float], looked: int, own: bool) -> Iterator[Finding]:
    where = OBSERVATIONS if own else FIELD
    if len(residuals_m) < _MIN_FRAMES:
        what = f"lines, crossings and landmarks fit no pose in {looked - len(residuals_m)} of {looked} images"
        advice = "Look at `touchline view --stages`; check the field and camera.yaml."
        if own:
            advice = "Is it this field, are places in the robot frame (m)? Two lines and a crossing tell a pose."
        yield Finding("features", Severity.WARNING, where, what, advice)
        return
    typical = float(np.median(residuals_m))
    what = f"features lie {100 * typical:.1f} cm from the field's (median), tracked in {len(residuals_m)} of {looked}"
    case = typical > _GOOD_M, Severity.WARNING, "Is it this field, and this camera's calibration?"
    yield graded("features", where, f"{what} images", case)


def _askew(lean_deg: np.ndarray) -> Iterator[Finding]:
    """By how much the camera is thought to be mounted askew."""
    if float(np.abs(lean_deg).max()) > _ASKEW_DEG:
        roll, pitch = lean_deg.tolist()
        what = f"the lines say that the camera is turned by roll {roll:+.1f}°, pitch {pitch:+.1f}° throughout"
        advice = "touchline calibrate camera measures its mount."
        yield Finding("mount", Severity.NOTE, CAMERA, what, advice, ProblemCode.CAMERA_DIFFERS)
