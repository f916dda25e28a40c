"""Checks of a perspective camera: what it sees of the ground, and whether field lines are where it projects them."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from touchline.camera import Camera, field_of_view, is_perspective
from touchline.checks.findings import Finding, Severity, graded, too_few
from touchline.checks.survey import Survey
from touchline.errors import InputError
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose, Pose3
from touchline.motion.attitude import with_camera_poses
from touchline.perception.covered import is_covered
from touchline.sources.description import CAMERA
from touchline.types import ImageArray, ProblemCode

_MIN_GROUND = 0.2  # of the image: less is sky
_FRAMES, _MIN_FRAMES = 24, 3
_STEP_M = 0.05
_MAX_M = 6.0
_MIN_PLACES = 40  # in one image, for three angles
_SEARCHED_PX = 20.0  # to each side of a line: 2° of a wide-angle camera
_PROFILE_PX = 0.5
_MIN_CONTRAST = 40.0
_NOTED_DEG, _POOR_DEG = 0.4, 1.5  # an IMU's tilt is good to half a degree
_TURN_RAD = 1e-4
_MIN_M = 0.2  # height of a camera: robots of the smallest league are taller


class Places(NamedTuple):
    """Places along projected lines: pixels (N, 2), unit normals (N, 2), half widths (N,) px, ground points (N, 2) in
    the base frame (m).
    """

    pixels: FloatArray
    normals: FloatArray
    half_widths: FloatArray
    ground: FloatArray


def check_view(survey: Survey) -> Iterator[Finding]:
    """What a perspective camera sees, by camera.yaml alone."""
    camera = perspective_camera(survey)
    if camera is None:
        return
    ground = float(field_of_view(camera).mean())
    place = camera.base_from_camera
    down_deg = math.degrees(place.roll_pitch_yaw()[1])
    what = (
        f"{camera.model}, {camera.width}×{camera.height} pixels, {place.translation_m[2]:.2f} m high, looking down by "
        f"{down_deg:.1f}°: {100 * ground:.0f} % of the image show the ground"
    )
    advice = "Positive mount: pitch looks down; it is in radians."
    low = "Is the robot's base a frame on the ground? --base NAME says which is; base_link of a humanoid is its hip."
    cases = (ground < _MIN_GROUND, Severity.ERROR, advice), (place.translation_m[2] < _MIN_M, Severity.WARNING, low)
    yield graded("camera", CAMERA, what, *cases)


def check_projection(survey: Survey) -> Iterator[Finding]:
    """Field lines projected at the true poses against the white ones in the images: is the camera turned?"""
    camera, field = perspective_camera(survey), survey.field
    if camera is None or field is None:
        return
    recording, truth = survey.recording, survey.recording.truth
    if truth is None:
        what = "whether the camera is mounted as camera.yaml says is not tested: the true poses are not known"
        yield Finding("projection", Severity.NOTE, CAMERA, what)
        return
    chosen = set(np.linspace(0, len(recording) - 1, _FRAMES).astype(int).tolist())
    offsets, turns, looked, where = [], [], 0, CAMERA
    for index, (frame, pose) in enumerate(with_camera_poses(recording.again(), camera)):
        if index not in chosen or frame.image is None or is_covered(frame.image):
            continue
        looked += 1
        where = CAMERA if frame.base_from_camera is None else "camera_pose.csv"
        places = project_places(camera, field, truth.nearest(frame.stamp_ns), pose)
        off = line_offsets(frame.image, places)
        turn = fitted_turn(camera, places, off, pose or camera.base_from_camera)
        if turn is not None:
            offsets.append(off[np.isfinite(off)])
            turns.append(turn)
    if looked < _MIN_FRAMES:
        yield too_few("projection", CAMERA, "whether the camera is mounted as camera.yaml says", looked, _MIN_FRAMES)
        return
    if len(turns) < max(_MIN_FRAMES, looked // 2):
        what = f"field lines are found in {len(turns)} of {looked} images where the true poses put them"
        advice = "Look at `touchline view`: are field and camera.yaml right? A head that moves needs camera_pose.csv."
        yield Finding("projection", Severity.WARNING, CAMERA, what, advice)
        return
    yield _finding(np.concatenate(offsets), np.degrees(turns), where)


def perspective_camera(survey: Survey) -> Camera | None:
    """The camera, unless it looks at a mirror, there is none, or its file is broken (the check of it says so)."""
    recording = survey.recording
    if not is_perspective(recording.camera_kind) or recording.camera_file is None:
        return None
    try:
        return recording.camera
    except InputError:
        return None


def project_places(camera: Camera, field: FieldModel, field_from_robot: Pose, base_from_camera: Pose3 | None) -> Places:
    """Places every 5 cm along the field's lines that lie in the image and up to 6 m away, one table for all lines."""
    found = []
    to_base = field_from_robot.inverse()
    for line in field.polylines(_STEP_M):
        along = np.gradient(line, axis=0)
        across = np.column_stack((-along[:, 1], along[:, 0])) / np.linalg.norm(along, axis=1, keepdims=True)
        middle, left, right = (
            camera.image_from_ground(to_base.transform(line + side * field.line_width * across), base_from_camera)
            for side in (0.0, 0.5, -0.5)
        )
        with np.errstate(invalid="ignore"):
            tangent = np.gradient(middle, axis=0)
            normal = np.column_stack((-tangent[:, 1], tangent[:, 0]))
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            half = 0.5 * np.abs(np.sum((left - right) * normal, axis=1))
            middle += np.sum((0.5 * (left + right) - middle) * normal, axis=1)[:, np.newaxis] * normal
        ground = to_base.transform(line)
        seen = camera.sees(middle) & np.isfinite(normal).all(axis=1) & (np.hypot(*ground.T) < _MAX_M)
        seen &= (half > 0.6) & (half < 25.0)
        seen[:3] = seen[-3:] = False  # other lines meet it there
        found.append(np.column_stack((middle, normal, half, ground))[seen])
    table = np.concatenate(found)
    return Places(table[:, :2], table[:, 2:4], table[:, 4], table[:, 5:])


def line_offsets(image: ImageArray, places: Places) -> FloatArray:
    """How far (px) along its normal the middle of the white line lies from each place, (N,); NaN where no single line
    of about that width stands out.

    The line ends where the profile falls to half its height. Red and blue are looked at: green carpet has little.
    """
    offsets = np.full(len(places.pixels), np.nan)
    if not len(offsets):
        return offsets
    steps = np.arange(-1.0, 1.0 + 1e-9, _PROFILE_PX / _SEARCHED_PX) * _SEARCHED_PX
    reach = places.half_widths + _SEARCHED_PX
    scale = reach / _SEARCHED_PX
    along = (scale[:, np.newaxis] * steps)[..., np.newaxis] * places.normals[:, np.newaxis]
    path = (places.pixels[:, np.newaxis] + along).astype(np.float32)
    white = np.minimum(image[..., 0], image[..., 2])
    profiles = cv2.remap(white, path[..., 0], path[..., 1], cv2.INTER_LINEAR, borderValue=0).astype(np.float64)
    low, high = np.percentile(profiles, 15, axis=1), profiles.max(axis=1)
    edge = 0.5 * (low + high)
    for k in np.flatnonzero(high - low > _MIN_CONTRAST):
        bright = np.flatnonzero(profiles[k] > edge[k])
        first, last = int(bright[0]), int(bright[-1])
        if first == 0 or last == len(steps) - 1 or len(bright) != last - first + 1:
            continue
        ends = [a + (edge[k] - profiles[k, a]) / (profiles[k, a + 1] - profiles[k, a]) for a in (first - 1, last)]
        step_px = scale[k] * _PROFILE_PX
        width = step_px * (ends[1] - ends[0])
        if abs(width - 2.0 * places.half_widths[k]) < max(2.0, 0.5 * places.half_widths[k]):
            offsets[k] = step_px * 0.5 * (ends[0] + ends[1]) - reach[k]
    return offsets


def fitted_turn(camera: Camera, places: Places, offsets: FloatArray, base_from_camera: Pose3) -> FloatArray | None:
    """(3,) roll, pitch, yaw (rad) by which the camera is turned in its own frame against `base_from_camera`.

    Least squares of the offsets (N,), those far off left out; None where too few places are seen.
    """
    used = np.isfinite(offsets)
    columns = []
    for small in _TURN_RAD * np.eye(3):
        turned = [base_from_camera.compose(Pose3.from_roll_pitch_yaw(*way)) for way in (small, -small)]
        ends = [camera.image_from_ground(places.ground, pose) for pose in turned]
        columns.append(np.sum((ends[0] - ends[1]) * places.normals, axis=1) / (2.0 * _TURN_RAD))
    jacobian = np.stack(columns, axis=1)
    used &= np.isfinite(jacobian).all(axis=1)
    turn: FloatArray = np.zeros(3)
    for _ in range(5):
        if used.sum() < _MIN_PLACES:
            return None
        turn = np.linalg.lstsq(jacobian[used], offsets[used], rcond=None)[0]
        rest = np.abs(offsets - jacobian @ turn)
        used = rest < max(1.0, 3.0 * float(np.median(rest[used])))
    return turn


def _finding(offsets: FloatArray, turns_deg: FloatArray, where: str) -> Finding:
    """offsets (M,) px of all places; turns_deg (K, 3) of the images."""
    middle = np.median(turns_deg, axis=0)
    spread = 1.4826 * np.median(np.abs(turns_deg - middle), axis=0)
    what = (
        f"field lines lie {np.median(np.abs(offsets)):.1f} px from where the true poses put them (median of "
        f"{len(offsets)} places in {len(turns_deg)} images)"
    )
    worst = float(np.abs(middle).max())
    certain = bool((np.abs(middle) > 3.0 * spread / math.sqrt(len(turns_deg))).any())
    if worst < _NOTED_DEG or not certain:
        return Finding("projection", Severity.OK, where, what)
    angles = ", ".join(
        f"{name} {angle:+.1f}° ± {each:.1f}°"
        for name, angle, each in zip(("roll", "pitch", "yaw"), middle, spread, strict=True)
    )
    what += f": the camera is turned by {angles} against {where} and the IMU"
    advice = "Calibrate how the camera is mounted, and the IMU."
    severity = Severity.WARNING if worst > _POOR_DEG else Severity.NOTE
    return Finding("projection", severity, where, what, advice, ProblemCode.CAMERA_DIFFERS)
