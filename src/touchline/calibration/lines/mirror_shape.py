"""A mirror that was fitted to lines, as ground points of pixels and as a camera."""

from dataclasses import dataclass

import numpy as np

from touchline.calibration.lines.equations import (
    BEND_X,
    CENTER_U,
    HEIGHT_M,
    LOG_SCALE,
    MIN_DEPTH,
    PER_PX,
    SHAPE,
    STEEPEST_RAD,
)
from touchline.camera import OmniCamera
from touchline.errors import NoFitError
from touchline.geometry import FloatArray, longest_run, wrap_angles

_DIRECTIONS = 72
_STEP_PX = 2.0
_MAX_OFFSET_RAD = 0.19  # a camera.yaml holds 0.2 at most
_MIN_RISE_M = 1e-4  # of the range from radius to radius


@dataclass(frozen=True, eq=False)
class MirrorShape:
    """Parameters (Q,) of `equations`, the image's handedness and the spacing of the spline's knots (px).

    origin_m: (2,) where the robot's origin lies from the mirror's, in the mirror's frame (x along u): the axis about
    which the robot turned, or zero. upright_px: (2,) u, v, the centre of the upright mirror that is nearest to this
    one; None for one that is upright. One that leans has its axis several pixels aside.
    """

    parameters: FloatArray
    handedness: int
    knot_px: float
    origin_m: FloatArray
    upright_px: FloatArray | None = None

    @property
    def axis(self) -> FloatArray:
        """Where the mirror's axis lies in the image (2,) u, v."""
        return self.parameters[CENTER_U : CENTER_U + 2]

    @property
    def center(self) -> FloatArray:
        """The centre (2,) u, v about which the mirror looks most alike on all sides."""
        return self.axis if self.upright_px is None else self.upright_px

    @property
    def bend_per_m(self) -> FloatArray:
        """The bend (2,) of a mirror that leans, 1/m; see `equations`."""
        return self.parameters[BEND_X : BEND_X + 2]

    def range_m(self, radius_px: FloatArray) -> FloatArray:
        """Ranges (N,) at radii (N,) about the axis, without the bend; beyond the horizon's steepest angle they stay."""
        turn = np.minimum(self.parameters[PER_PX] * radius_px, STEEPEST_RAD)
        logs = self.parameters[LOG_SCALE] + np.log(np.tan(np.maximum(turn, 1e-9)))
        if len(self.parameters) > SHAPE:
            logs += spline_rows(radius_px, self.knot_px, len(self.parameters) - SHAPE) @ self.parameters[SHAPE:]
        return np.exp(logs)

    def ground(self, pixels: FloatArray) -> FloatArray:
        """Ground points (N, 2) in the robot frame, x along the image's u, of pixels (N, 2)."""
        offset = pixels - self.axis
        radius = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)
        directions = offset * np.array([1.0, self.handedness]) / radius[:, np.newaxis]
        upright = directions * self.range_m(radius)[:, np.newaxis]
        depth = np.maximum(1.0 - upright @ self.bend_per_m, MIN_DEPTH)[:, np.newaxis]
        return (upright + HEIGHT_M**2 * self.bend_per_m) / depth - self.origin_m

    def camera(self, size: tuple[int, int], inner_px: float, outer_px: float, mount_yaw_rad: float = 0.0) -> OmniCamera:
        """The camera of images of a size (width, height) whose robot ends at inner_px and whose ground at outer_px.

        Raises NoFitError for a shape that is no mirror's.
        """
        radii = np.arange(np.floor(0.8 * inner_px), np.ceil(outer_px) + _STEP_PX, _STEP_PX)
        level = self.upright_px is None and not np.any(self.bend_per_m) and not np.any(self.origin_m)
        bearings = np.zeros(1) if level else 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        around = self.handedness * bearings
        directions = np.column_stack((np.cos(around), np.sin(around)))
        pixels = self.center + radii[np.newaxis, :, np.newaxis] * directions[:, np.newaxis]
        ground = self.ground(pixels.reshape(-1, 2)).reshape(len(bearings), len(radii), 2)
        ranges = np.hypot(ground[..., 0], ground[..., 1])
        offsets = wrap_angles(np.arctan2(ground[..., 1], ground[..., 0]) - bearings[:, np.newaxis])
        fine = (np.abs(offsets) < _MAX_OFFSET_RAD).all(axis=0)
        fine &= np.concatenate(([True], (np.diff(ranges, axis=1) > _MIN_RISE_M).all(axis=0)))
        first, last = longest_run(fine)
        if last - first < 2:
            raise NoFitError(
                "the lines fit no mirror, through which ranges grow from its middle outwards: a camera that looks "
                "through a lens alone needs --model pinhole or fisheye"
            )
        kept = slice(first, last)
        rows = np.mod(bearings + mount_yaw_rad, 2.0 * np.pi)
        order = np.argsort(rows)
        return OmniCamera(
            *size,
            (float(self.center[0]), float(self.center[1])),
            float(inner_px),
            float(min(outer_px, radii[last - 1])),
            self.handedness,
            mount_yaw_rad,
            radii[kept],
            rows[order],
            ranges[order, kept],
            None if level else offsets[order, kept],
        )


def spline_rows(radius_px: FloatArray, knot_px: float, count: int) -> FloatArray:
    """What each of so many coefficients of the spline of `equations` counts (N, K) at radii (N,)."""
    from scipy.interpolate import BSpline

    at = np.clip(radius_px / knot_px, 0.0, count - 3.0)
    return BSpline.design_matrix(at, np.arange(-3.0, count + 1.0), 3).toarray()
