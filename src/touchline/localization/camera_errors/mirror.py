"""The five errors of a mirror: how it leans, where it lies, how long its ranges are.

A point p, seen through a mirror with the errors g (1/m, lean), c (px, displacement) and s (ranges that are too short by
a share), belongs at

    p' = (1 + s) p + C c + G g,     p" = (p' + h² g) / (1 - g·p')

C: what a displaced mirror does, G: what a leaning one does by its surface that moves, both from the `MirrorResponse` of
the mirror's own shape; as mirrors bend they are taken half way between p and p', with errors that are about right.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba.extending import overload

from touchline.camera import Camera, OmniCamera
from touchline.camera.uncertainty import USUAL_RANGE_RATIO, USUAL_TILT_DEG, CameraUncertainty
from touchline.field.offset_map import CHUNK
from touchline.geometry import FloatArray
from touchline.localization.camera_errors.base import (
    ALL_ROUND,
    COLUMNS,
    NORMAL,
    PLACED,
    CameraErrors,
    Lean,
    fill_all,
    place_all,
    prepare,
    terms_at,
)
from touchline.localization.camera_errors.mirror_response import (
    HEIGHT_M,
    SCALE_STEP_M,
    MirrorResponse,
    mirror_response,
)
from touchline.types import Frame

DRIFT_RATIO = 0.01  # of the errors in the root of a second, as a share of what was unknown at first: a loosening mount
LEARNED = 0.3  # share of an image's correction of the errors: points of neighbouring images err together
# of g about its mean from image to image: 0.06° at first, 0.04 to 0.4° in robots that drive
LEAN = Lean(first=0.003, min=0.002, max=0.02, per_m=1.0)
# by how much mirrors shift the ground about the robot beyond these errors, median of five shapes: per 1/m of g, per px
MISFIT_M2, MISFIT_M_PER_PX = 0.08, 0.0003
UNTOLD = CameraUncertainty(USUAL_TILT_DEG, 0.0, USUAL_RANGE_RATIO)  # of an undescribed camera
# standard deviations of what an exact one still seems to differ by, as a detector shifts the edges of lines by a
# twentieth of a pixel: tilt (deg), centre (share of the outer radius), ranges
EXACT_TILT_DEG, EXACT_CENTER_RATIO, EXACT_RANGE_RATIO = 0.02, 0.0005, 0.002
MIN_DEPTH = 0.2  # of 1 - g·p: beyond it is the horizon
NAMES = ("lean towards x (1/m)", "lean towards y (1/m)", "centre u (px)", "centre v (px)", "range ratio")


class MirrorTerms(NamedTuple):
    """The errors of this module's equations: g (1/m), c (px), s; and h (m)."""

    lean_x: float
    lean_y: float
    center_u: float
    center_v: float
    scale: float
    height_m: float


def mirror_errors(camera: Camera | None) -> CameraErrors:
    """Those of a mirror, as far as its camera.yaml is unsure; one without a camera.yaml leans and shakes, too."""
    uncertainty, exact, center_px = UNTOLD, None, 0.0
    if isinstance(camera, OmniCamera):
        uncertainty, center_px = camera.uncertainty, EXACT_CENTER_RATIO * camera.outer_radius_px
    seeming = stated(CameraUncertainty(EXACT_TILT_DEG, center_px, EXACT_RANGE_RATIO))
    if isinstance(camera, OmniCamera) and camera.stated_uncertainty is None:
        exact = np.linalg.inv(seeming)
    prior, response = stated(uncertainty), mirror_response(camera if isinstance(camera, OmniCamera) else None)
    drift = DRIFT_RATIO * np.sqrt(np.diag(prior))
    misfit = (MISFIT_M2, MISFIT_M2, MISFIT_M_PER_PX, MISFIT_M_PER_PX, 0.0)

    def at(frame: Frame | None = None) -> MirrorResponse:
        """The same for every image: a mirror does not turn."""
        return response

    floor, least = (0.0, 0.0, 0.0), tuple(np.sqrt(np.diag(seeming)).tolist())
    return CameraErrors(NAMES, HEIGHT_M, prior, drift, LEARNED, LEAN, ALL_ROUND, at, floor, misfit, least, exact)


def stated(uncertainty: CameraUncertainty) -> FloatArray:
    """Covariance (5, 5) of the errors as far as a camera.yaml is unsure."""
    lean, aside_px = 2.0 * math.radians(uncertainty.tilt_deg) / HEIGHT_M, uncertainty.center_px
    return np.diag(np.square([lean, lean, aside_px, aside_px, uncertainty.range_ratio]))


@njit(cache=True, error_model="numpy")
def _fill_shapes(place, parts, shapes):  # type: ignore[no-untyped-def]
    """C and G where the mirror shows the points of a chunk, place (2, CHUNK): xx, xy, yy of either, into shapes
    (6 CHUNK,). As in `look_up_offsets`, all loops but the reading become SIMD instructions.
    """
    for i in range(CHUNK):
        reach2 = max(place[0, i] * place[0, i] + place[1, i] * place[1, i], 1e-9)
        shapes[i] = min(math.sqrt(reach2) / SCALE_STEP_M, parts.shape[0] - 1.000001)
    for i in range(CHUNK):
        cell = np.uint64(shapes[i])  # no test for negative indices
        after, f = cell + np.uint64(1), shapes[i] - np.int64(cell)
        across = (1.0 - f) * parts[cell, 1] + f * parts[after, 1]
        sideways = (1.0 - f) * parts[cell, 3] + f * parts[after, 3]
        shapes[i], shapes[CHUNK + i] = across, sideways
        shapes[2 * CHUNK + i] = (1.0 - f) * parts[cell, 0] + f * parts[after, 0] - across
        shapes[3 * CHUNK + i] = (1.0 - f) * parts[cell, 2] + f * parts[after, 2] - sideways
    for i in range(CHUNK):
        x, y, across, sideways = place[0, i], place[1, i], shapes[i], shapes[CHUNK + i]
        reach2 = max(x * x + y * y, 1e-9)
        oblong, bulge = shapes[2 * CHUNK + i] / reach2, shapes[3 * CHUNK + i] / reach2
        xx, xy, yy = x * x, x * y, y * y
        shapes[i], shapes[CHUNK + i], shapes[2 * CHUNK + i] = across + oblong * xx, oblong * xy, across + oblong * yy
        shapes[3 * CHUNK + i], shapes[4 * CHUNK + i] = sideways + bulge * xx, bulge * xy
        shapes[5 * CHUNK + i] = sideways + bulge * yy


@njit(cache=True, error_model="numpy", inline="always")
def _aside(shape, errors):  # type: ignore[no-untyped-def]
    """C c + G g."""
    cxx, cxy, cyy, gxx, gxy, gyy = shape
    x = cxx * errors[2] + cxy * errors[3] + gxx * errors[0] + gxy * errors[1]
    y = cxy * errors[2] + cyy * errors[3] + gxy * errors[0] + gyy * errors[1]
    return x, y


@njit(cache=True, error_model="numpy", inline="always")
def _shape(shapes, i):  # type: ignore[no-untyped-def]
    return (
        shapes[i], shapes[CHUNK + i], shapes[2 * CHUNK + i],
        shapes[3 * CHUNK + i], shapes[4 * CHUNK + i], shapes[5 * CHUNK + i],
    )  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always")
def _shifted(x, y, errors, shape):  # type: ignore[no-untyped-def]
    """p' of the module's equations."""
    aside_x, aside_y = _aside(shape, errors)
    return (1.0 + errors[4]) * x + aside_x, (1.0 + errors[4]) * y + aside_y


@njit(cache=True, error_model="numpy", inline="always")
def _nearer(qx, qy, errors):  # type: ignore[no-untyped-def]
    """1 / (1 - g·p')."""
    return 1.0 / max(1.0 - errors[0] * qx - errors[1] * qy, MIN_DEPTH)


def _is_mirror(value: Any) -> bool:
    return getattr(value, "instance_class", None) in (MirrorResponse, MirrorTerms)


@overload(prepare, jit_options={"error_model": "numpy"})
def _prepare(points, errors, response):  # type: ignore[no-untyped-def]
    if not _is_mirror(response):
        return None

    def shapes(points, errors, response):  # type: ignore[no-untyped-def]
        """C and G half way to where the points belong."""
        out = np.zeros(((points.shape[0] + CHUNK - 1) // CHUNK, 6 * CHUNK))
        place = np.zeros((2, CHUNK))
        for chunk in range(out.shape[0]):
            row, first = out[chunk], chunk * CHUNK
            for i in range(min(CHUNK, points.shape[0] - first)):
                place[0, i], place[1, i] = points[first + i, 0], points[first + i, 1]
            _fill_shapes(place, response.parts, row)
            for i in range(CHUNK):
                x, y = _aside(_shape(row, i), errors)
                place[0, i], place[1, i] = place[0, i] + 0.5 * x, place[1, i] + 0.5 * y
            _fill_shapes(place, response.parts, row)
        return out

    return shapes


@overload(terms_at, jit_options={"error_model": "numpy"})
def _terms_at(errors, response):  # type: ignore[no-untyped-def]
    if not _is_mirror(response):
        return None
    return lambda errors, response: MirrorTerms(
        errors[0], errors[1], errors[2], errors[3], errors[4], response.height_m
    )


@overload(place_all, jit_options={"error_model": "numpy"})
def _place_all(row, room, terms, prepared):  # type: ignore[no-untyped-def]
    if not _is_mirror(terms):
        return None

    def upright(row, room, terms, prepared):  # type: ignore[no-untyped-def]
        square = terms.height_m * terms.height_m
        for i in range(CHUNK):
            qx, qy = _shifted(row[i], row[CHUNK + i], terms, _shape(prepared, i))
            nearer = _nearer(qx, qy, terms)
            room[PLACED + i] = nearer * (qx + square * terms[0])
            room[PLACED + CHUNK + i] = nearer * (qy + square * terms[1])

    return upright


@overload(fill_all, jit_options={"error_model": "numpy"})
def _fill_all(row, room, terms, prepared):  # type: ignore[no-untyped-def]
    if not _is_mirror(terms):
        return None

    def columns(row, room, terms, prepared):  # type: ignore[no-untyped-def]
        square = terms.height_m * terms.height_m
        for i in range(CHUNK):
            rx, ry = room[NORMAL + i], room[NORMAL + CHUNK + i]
            cxx, cxy, cyy, gxx, gxy, gyy = _shape(prepared, i)
            qx, qy = _shifted(row[i], row[CHUNK + i], terms, (cxx, cxy, cyy, gxx, gxy, gyy))
            nearer = _nearer(qx, qy, terms)
            outward = rx * room[PLACED + i] + ry * room[PLACED + CHUNK + i]
            mx, my = nearer * (rx + outward * terms[0]), nearer * (ry + outward * terms[1])  # before the tilt
            room[COLUMNS + 3 * CHUNK + i] = nearer * (outward * qx + square * rx) + gxx * mx + gxy * my
            room[COLUMNS + 4 * CHUNK + i] = nearer * (outward * qy + square * ry) + gxy * mx + gyy * my
            room[COLUMNS + 5 * CHUNK + i] = cxx * mx + cxy * my
            room[COLUMNS + 6 * CHUNK + i] = cxy * mx + cyy * my
            room[COLUMNS + 7 * CHUNK + i] = row[i] * mx + row[CHUNK + i] * my

    return columns
