"""The four errors of a perspective camera: roll and pitch, height, focal length.

What the camera sees is taken as that of a level camera at the height that it has: a ray is bent to the optical axis,
turned back and meets the ground again (exactly: at 6 m and 2° the first order is 1 m off). Roll and pitch are about the
camera's own forward and left, so that they stay the same while a head pans.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from touchline.camera import PerspectiveCamera, ground_view
from touchline.errors import InputError
from touchline.field.offset_map import CHUNK
from touchline.geometry import FloatArray, Pose3
from touchline.localization.camera_errors.base import (
    COLUMNS,
    NORMAL,
    PLACED,
    SECTOR,
    CameraErrors,
    Lean,
    fill_all,
    place_all,
    prepare,
    terms_at,
)
from touchline.localization.camera_errors.fisheye_focal import angle_stretch, scaled_angle
from touchline.types import Frame

HEIGHT_M = 1.0  # of an undescribed camera
# of roll and pitch (rad), as the kinematics of a robot that nobody has calibrated tell them: three degrees, and five
# happen; relative ones of height and focal length
DEVIATIONS = 0.05, 0.05, 0.02, 0.02
OWN_DEVIATIONS = 0.02, 0.02, 0.02, 0.02  # behind a detector whose makers have laid what it sees on the ground
DRIFT = np.array([0.0003, 0.0003, 0.0001, 0.00003])  # of these in the root of a second
LEARNED = 1.0  # share of an image's correction of the errors
LEAN_RAD, MIN_LEAN_RAD, MAX_LEAN_RAD = 0.008, 0.002, 0.03  # error of roll and pitch in one image
FLOOR = 0.005, 0.005, 0.015  # m, m, rad, that no image shows: a camera turned aside turns all
NO_AXIS = np.zeros(3)
NAMES = ("roll (rad)", "pitch (rad)", "height ratio", "focal ratio")


@njit(cache=True, error_model="numpy")
def ahead(axis: FloatArray) -> tuple[float, float]:
    """Where an optical axis (3,) points to on the ground, a unit vector; the robot's forward if it points nowhere."""
    length = math.hypot(axis[0], axis[1])
    return (axis[0] / length, axis[1] / length) if length > 1e-6 else (1.0, 0.0)


class PerspectiveResponse(NamedTuple):
    """eye (3,): x, y and height of the camera, robot frame (m). axis (3,): its optical axis, a unit vector; zeros if
    it is unknown, and the focal length has no effect. fisheye: whether this scales angles to it, not their tangents.
    """

    eye: FloatArray
    axis: FloatArray
    fisheye: bool


class PerspectiveTerms(NamedTuple):
    """eye, axis, fisheye: as of `PerspectiveResponse`. ahead: unit vector that `ahead` gives. roll, pitch: cosine and
    sine. height_ratio, focal_ratio: errors.
    """

    eye: tuple[float, float, float]
    axis: tuple[float, float, float]
    fisheye: bool
    ahead: tuple[float, float]
    roll: tuple[float, float]
    pitch: tuple[float, float]
    height_ratio: float
    focal_ratio: float


def perspective_errors(camera: PerspectiveCamera | None, height_m: float | None = None) -> CameraErrors:
    """Those of a camera, or of one at a height behind a detector of the robot's own."""
    eye = np.array([0.0, 0.0, height_m or HEIGHT_M])
    if camera is not None:
        eye = np.ascontiguousarray(camera.base_from_camera.translation_m)
    height_m, fisheye = float(eye[2]), camera is not None and camera.scales_angles
    prior = np.diag(np.square(OWN_DEVIATIONS if camera is None else DEVIATIONS))
    lean = Lean(LEAN_RAD, MIN_LEAN_RAD, MAX_LEAN_RAD, 1.0 / height_m)

    def at(frame: Frame | None = None) -> PerspectiveResponse:
        """Where the camera is and looks at the image of a frame; as it is mounted without one."""
        pose = None
        if camera is not None:
            pose = camera.base_from_camera if frame is None else _pose(camera, frame)
        if pose is None:
            return PerspectiveResponse(eye, NO_AXIS, fisheye)
        axis = np.ascontiguousarray(pose.rotation[:, 0])
        return PerspectiveResponse(np.ascontiguousarray(pose.translation_m), axis, fisheye)

    return CameraErrors(
        NAMES, height_m, prior, DRIFT, LEARNED, lean, SECTOR, at, FLOOR, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)
    )


def _pose(camera: PerspectiveCamera, frame: Frame) -> Pose3 | None:
    lean = (None, None) if frame.tilt is None or not len(frame.tilt) else map(float, frame.tilt.values[-1])
    try:
        return ground_view(camera, frame.base_from_camera, *lean).pose
    except InputError:
        return None


def _is_perspective(value: Any) -> bool:
    return getattr(value, "instance_class", None) in (PerspectiveResponse, PerspectiveTerms)


@overload(prepare, jit_options={"error_model": "numpy"})
def _prepare(points, errors, response):  # type: ignore[no-untyped-def]
    if not _is_perspective(response):
        return None

    def nothing(points, errors, response):  # type: ignore[no-untyped-def]
        return np.empty(((points.shape[0] + CHUNK - 1) // CHUNK, 0))

    return nothing


@overload(terms_at, jit_options={"error_model": "numpy"})
def _terms_at(errors, response):  # type: ignore[no-untyped-def]
    if not _is_perspective(response):
        return None

    def numbers(errors, response):  # type: ignore[no-untyped-def]
        eye, axis = response.eye, response.axis
        roll, pitch = (math.cos(errors[0]), math.sin(errors[0])), (math.cos(errors[1]), math.sin(errors[1]))
        return PerspectiveTerms(
            (eye[0], eye[1], eye[2]), (axis[0], axis[1], axis[2]), response.fisheye, ahead(axis), roll, pitch,
            errors[2], errors[3],
        )  # fmt: skip

    return numbers


@njit(cache=True, error_model="numpy", inline="always")
def _bent(x, y, terms):  # type: ignore[no-untyped-def]
    """A ground point (m) from the camera's foot as a pinhole of the right focal length sees it."""
    axis, h = terms.axis, terms.eye[2]
    along = x * axis[0] + y * axis[1] - h * axis[2]
    if along > 0.0:
        wide = 1.0 + terms.focal_ratio
        bent = along * terms.focal_ratio
        down = (h * wide + axis[2] * bent) / h
        x, y = (x * wide - axis[0] * bent) / down, (y * wide - axis[1] * bent) / down
    return x, y


@njit(cache=True, error_model="numpy", inline="always")
def _levelled(x, y, terms):  # type: ignore[no-untyped-def]
    """A ground point from the camera's foot as a level camera at the right height sees it, robot frame (m)."""
    h, (ax, ay) = terms.eye[2], terms.ahead
    x, y = ax * x + ay * y, ax * y - ay * x
    c, s = terms.pitch
    depth = h * c + x * s
    x, y = (x * c - h * s) * h / depth, y * h / depth
    c, s = terms.roll
    depth = h * c - y * s
    stretch = (1.0 + terms.height_ratio) * h / depth
    x, y = x * stretch, (y * c + h * s) * stretch
    return ax * x - ay * y + terms.eye[0], ay * x + ax * y + terms.eye[1]


@overload(place_all, jit_options={"error_model": "numpy"})
def _place_all(row, room, terms, prepared):  # type: ignore[no-untyped-def]
    if not _is_perspective(terms):
        return None

    def levelled(row, room, terms, prepared):  # type: ignore[no-untyped-def]
        eye = terms.eye
        if terms.fisheye:  # not within the loop: functions of angles are no SIMD instructions
            for i in range(CHUNK):
                x, y = row[i] - eye[0], row[CHUNK + i] - eye[1]
                x, y = scaled_angle(x, y, terms.focal_ratio, eye[2], terms.axis)
                room[PLACED + i], room[PLACED + CHUNK + i] = _levelled(x, y, terms)
        else:
            for i in range(CHUNK):
                x, y = _bent(row[i] - eye[0], row[CHUNK + i] - eye[1], terms)
                room[PLACED + i], room[PLACED + CHUNK + i] = _levelled(x, y, terms)

    return levelled


@overload(fill_all, jit_options={"error_model": "numpy"})
def _fill_all(row, room, terms, prepared):  # type: ignore[no-untyped-def]
    if not _is_perspective(terms):
        return None

    def columns(row, room, terms, prepared):  # type: ignore[no-untyped-def]
        eye, axis, h, (ax, ay) = terms.eye, terms.axis, terms.eye[2], terms.ahead
        for i in range(CHUNK):
            x, y = room[PLACED + i] - eye[0], room[PLACED + CHUNK + i] - eye[1]
            rx, ry = room[NORMAL + i], room[NORMAL + CHUNK + i]
            u, v, ru, rv = ax * x + ay * y, ax * y - ay * x, ax * rx + ay * ry, ax * ry - ay * rx
            room[COLUMNS + 3 * CHUNK + i] = (ru * u * v + rv * (h * h + v * v)) / h
            room[COLUMNS + 4 * CHUNK + i] = -(ru * (h * h + u * u) + rv * u * v) / h
            room[COLUMNS + 5 * CHUNK + i] = rx * x + ry * y
            outwards = rx * (axis[0] + x * axis[2] / h) + ry * (axis[1] + y * axis[2] / h)
            room[COLUMNS + 6 * CHUNK + i] = -max(x * axis[0] + y * axis[1] - h * axis[2], 0.0) * outwards
        for i in range(CHUNK if terms.fisheye else 0):
            x, y = room[PLACED + i] - eye[0], room[PLACED + CHUNK + i] - eye[1]
            rx, ry = room[NORMAL + i], room[NORMAL + CHUNK + i]
            outwards = rx * (axis[0] + x * axis[2] / h) + ry * (axis[1] + y * axis[2] / h)
            room[COLUMNS + 6 * CHUNK + i] = -angle_stretch(x, y, h, axis) * outwards

    return columns
