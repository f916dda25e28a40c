"""Checks of what describes the recording: camera.yaml, field.yaml, ground_truth.tum."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from touchline.checks.delay import base_steps
from touchline.checks.findings import Finding, Severity, graded
from touchline.checks.sensors import compare_travel
from touchline.checks.survey import Survey
from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.messages import frames_in_words
from touchline.sources.description import CAMERA, FIELD, NO_CAMERA
from touchline.sources.problems import ProblemKind
from touchline.sources.truth import TRUTH
from touchline.types import ProblemCode

if TYPE_CHECKING:
    from touchline.camera import OmniCamera

_CORRECT = "Correct the file, or calibrate again."
_RIM_SUPPORT = 0.5
_RIM_OFF_PX = 3.0
_RIM_SHAKES_PX = 0.5
_SAME_LINE_M = 0.02
_HALL_M = 5.0  # beyond the lines
_MIN_TURNS = 4
_FASTEST_M_S = 7.0  # a true pose that moves faster was put elsewhere by hand


def check_camera(survey: Survey) -> Iterator[Finding]:
    """Whether camera.yaml can be read and makes sense beside the images."""
    recording = survey.recording
    if recording.camera_kind == NO_CAMERA:
        what = "none: what is seen comes from a detector of the robot's own"
        yield Finding("camera", Severity.OK, "sequence.yaml", what)
        return
    if recording.camera_file is None:
        yield Finding("camera", Severity.ERROR, CAMERA, "is missing", "Without it pixels have no place on the ground.")
        return
    try:
        _ = recording.camera
    except InputError as error:
        yield Finding("camera", Severity.ERROR, CAMERA, _told(error, recording.camera_file), _CORRECT)
        return
    camera = survey.omni
    if camera is None:
        return  # what a perspective camera sees is checked by itself
    oddities = list(_omni_oddities(camera))
    yield from oddities
    if not oddities and not recording.problems.counts[ProblemKind.IMAGE_SIZE]:
        what = f"omni, {camera.width}×{camera.height} pixels, ranges up to {float(np.max(camera.range_m)):.3g} m"
        yield Finding("camera", Severity.OK, CAMERA, what)


def check_mirror(survey: Survey) -> Iterator[Finding]:
    """The edge of the mirror's disc in the images against camera.yaml's center and outer radius."""
    rims = np.array([rim for _, rim in survey.rims if rim.support >= _RIM_SUPPORT]).reshape(-1, 4)
    camera = survey.omni
    if camera is None or not survey.rims:
        return
    if len(rims) < 0.5 * len(survey.rims):
        yield Finding("mirror", Severity.NOTE, CAMERA, "the mirror's place is not measured: its edge is hard to see")
        return
    u, v, radius = np.median(rims[:, :3], axis=0)
    off = math.hypot(u - camera.center[0], v - camera.center[1])
    shake = math.hypot(*(1.4826 * np.median(np.abs(rims[:, :2] - (u, v)), axis=0)))
    what = f"the mirror's disc is centred at ({u:.1f}, {v:.1f}), {off:.1f} px from camera.yaml's center"
    advice = "The mirror was moved since the calibration, or sits askew: calibrate again."
    cases = (off > _RIM_OFF_PX, Severity.WARNING, advice), (off > 0.5 * _RIM_OFF_PX, Severity.NOTE, advice)
    yield graded("mirror", CAMERA, what, *cases)
    if shake > _RIM_SHAKES_PX:
        what = f"the mirror's disc moves by about {shake:.1f} px between images"
        yield Finding("mirror", Severity.WARNING, CAMERA, what, "Tighten the mirror's mount.")
    if camera.outer_radius_px > radius + 1.0:
        what = f"outer_radius_px {camera.outer_radius_px:g} reaches beyond the mirror's disc of radius {radius:.1f} px"
        yield Finding("mirror", Severity.WARNING, CAMERA, what, "Lower outer_radius_px.")


def check_handedness(survey: Survey) -> Iterator[Finding]:
    """Whether the image turns the way that handedness says when the robot turns."""
    scores = survey.turn_score[np.isfinite(survey.turn_score)]
    if survey.omni is None:
        return
    if len(scores) < _MIN_TURNS or abs(float(np.mean(scores))) < 0.1:
        what = "handedness is not tested: the robot hardly turns from image to image"
        yield Finding("handedness", Severity.NOTE, CAMERA, what, "Record a turn on the spot to have it tested.")
    elif float(np.mean(scores)) > 0:
        what = f"the image turns with the gyro as handedness says ({len(scores)} turns)"
        yield Finding("handedness", Severity.OK, CAMERA, what)
    else:
        what = f"the image turns against handedness in {int((scores < 0).sum())} of {len(scores)} turns"
        advice = "Change the sign of handedness (a mirrored image?) or of gz."
        yield Finding("handedness", Severity.ERROR, CAMERA, what, advice, ProblemCode.IMAGES_MIRRORED)


def check_field(survey: Survey) -> Iterator[Finding]:
    """field.yaml against the preset that sequence.yaml names."""
    from touchline.field import open_field, preset_names

    recording = survey.recording
    try:
        field = recording.field
    except InputError as error:
        what, advice = _told(error, recording.folder / FIELD), "Correct the file, or remove it to use the preset."
        yield Finding("field", Severity.ERROR, FIELD, what, advice)
        return
    words = f"{field.name}, {field.length:g} × {field.width:g} m, lines {100 * field.line_width:g} cm"
    name = recording.sequence.get("field")
    if not (recording.folder / FIELD).exists():
        yield Finding("field", Severity.OK, "sequence.yaml", f"preset {words}")
        return
    if name not in preset_names():
        what = f"{words}; sequence.yaml names '{name}', which is no preset to compare it with"
        yield Finding("field", Severity.NOTE, FIELD, what)
        return
    preset = open_field(str(name))
    own, other = (np.concatenate(model.polylines(0.25)) for model in (field, preset))
    off = max(float(preset.line_distances(own).max()), float(field.line_distances(other).max()))
    if off > _SAME_LINE_M or abs(field.line_width - preset.line_width) > 0.005:
        what = f"{words}; its lines are up to {off:.2f} m from those of the preset '{name}'"
        advice = "field.yaml is what counts: measure the field if you are not sure."
        yield Finding("field", Severity.WARNING, FIELD, what, advice)
    else:
        yield Finding("field", Severity.OK, FIELD, f"{words}, as the preset")


def check_truth(survey: Survey) -> Iterator[Finding]:
    """Whether the true poses lie in the hall and move as odometry does."""
    truth, field = survey.recording.truth, survey.field
    if truth is None or field is None:
        return
    limits = np.array([field.length, field.width]) / 2 + _HALL_M
    outside = np.flatnonzero((np.abs(truth.poses[:, :2]) > limits).any(axis=1)).tolist()
    if outside:
        what = f"poses more than {_HALL_M:g} m outside the lines: {frames_in_words(outside)}"
        yield Finding("truth", Severity.ERROR, TRUTH, what, "Metres, from the centre mark?")
    stamps_ns = survey.recording.image_stamps
    nearest = [truth.nearest_index(int(stamp)) for stamp in stamps_ns]
    poses = truth.poses[nearest]
    if len(stamps_ns) > 1:  # where the truth has begun too late, or ended, nothing is known
        poses[np.abs(truth.stamp_ns[nearest] - stamps_ns) > np.median(np.diff(stamps_ns))] = np.nan
    subject = ("truth", TRUTH, "the true poses", "Check frames and units of both.")
    yield from compare_travel(survey, subject, _true_steps(poses, survey.stamps_s))


def _told(error: InputError, file: Path) -> str:
    """What the error says, without the file, which the finding names by itself."""
    return str(error).removeprefix(str(file)).lstrip(":, ")


def _omni_oddities(camera: OmniCamera) -> Iterator[Finding]:
    u, v = camera.center
    room = min(u, v, camera.width - 1 - u, camera.height - 1 - v)
    if not (0 <= u < camera.width and 0 <= v < camera.height):
        what = f"center ({u:g}, {v:g}) lies outside the image of {camera.width}×{camera.height} pixels"
        yield Finding("camera", Severity.ERROR, CAMERA, what, "Calibrate again.")
    elif camera.outer_radius_px > room + 0.1 * min(camera.width, camera.height):
        what = f"outer_radius_px {camera.outer_radius_px:g} reaches beyond the image ({room:g} px from center to edge)"
        yield Finding("camera", Severity.WARNING, CAMERA, what, "Check center and radii.")
    if camera.radius_px[0] > camera.inner_radius_px or camera.radius_px[-1] < camera.outer_radius_px - 1.0:
        what = (
            f"range_table covers {camera.radius_px[0]:g} to {camera.radius_px[-1]:g} px, the field is seen from "
            f"{camera.inner_radius_px:g} to {camera.outer_radius_px:g} px"
        )
        yield Finding("camera", Severity.WARNING, CAMERA, what, "What lies outside the table can't be used.")
    reach = float(np.max(camera.range_m))
    if reach < 2.0:
        what = f"range_table ends at {reach:.2f} m"
        yield Finding("camera", Severity.WARNING, CAMERA, what, "Are its ranges in metres? Lines are farther away.")


def _true_steps(poses: FloatArray, stamps_s: FloatArray) -> FloatArray:
    """(N - 1, 2) travel in the base frame (m); NaN where the robot was put elsewhere."""
    steps = base_steps(poses)[:, :2]
    steps[np.hypot(*np.diff(poses[:, :2], axis=0).T) > _FASTEST_M_S * np.diff(stamps_s)] = np.nan
    return steps
