"""A camera head as it was built: how it differs from its design, how it shakes, and what its camera.yaml says of it."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from touchline.camera import OmniCamera
from touchline.camera.model_free import Edges, calibrated_camera
from touchline.camera.uncertainty import CameraUncertainty
from touchline.geometry import FloatArray, wrap_angles
from touchline_lab.simulation.cameras.mirror_rays import MirrorMount
from touchline_lab.simulation.cameras.omni import SimulatedOmniCamera
from touchline_lab.simulation.robot.noise import drift
from touchline_lab.simulation.robot.track import STEP_S, Track
from touchline_lab.simulation.scenario import CameraSettings

_DRIVING_M_S = 0.3  # from this speed on a head shakes as much as it ever does; standing it is still
_TURNING_M = 0.3  # a robot that turns on the spot shakes like one whose wheels drive with this lever
# of the image's centre, for a mirror displaced: 620 px of focal length over 0.1 m, less what looks tilted
_PX_PER_MM = 5.0
_DIRECTIONS = 24  # in which the strip is laid for a calibration, as in the paper
_EDGE_PX = 0.1  # error of an edge found in an image
_BEARING_RAD = math.radians(0.1)  # error of a direction that the robot was turned to, after smoothing
# The strip's edges; a team that knows its mirror lays some where its parts meet (1.2, 5.5 m), and some farther off.
_EDGES_M = np.array(
    [0.6, 0.73, 0.86, 1.02, 1.2, 1.38, 1.6, 1.85, 2.15, 2.5, 2.9, 3.4, 4.0, 4.6, 5.15, 5.5, 5.9, 6.6, 7.7, 9.2, 12.0]
)


class Head(NamedTuple):
    """A robot's mirror: how it sits, and how it swings about that.

    swing_rad (N, 2): how much it leans further about x and y at the steps of the robot's track. range_error: relative
    error of the distances that somebody measured on the ground for its camera.yaml. marks (B, E, 3): standard normal
    errors of the calibration's marks, across and along the image's radius, and of their directions (first column).
    """

    mount: MirrorMount
    swing_rad: FloatArray
    range_error: float
    marks: FloatArray

    def swing_at(self, time_s: float) -> tuple[float, float]:
        """Further lean about x and y (rad) at a time."""
        row = min(max(round(time_s / STEP_S), 0), len(self.swing_rad) - 1)
        return float(self.swing_rad[row, 0]), float(self.swing_rad[row, 1])


def draw_head(settings: CameraSettings, track: Track, rng: np.random.Generator) -> Head:
    """The head of one robot: its mount as the settings say, and whatever is left to chance."""
    mirror = settings.mirror
    lean, aside, marks_rng, swing_rng = rng.spawn(4)
    tilt = np.radians(np.array(mirror.tilt_deg) + mirror.tilt_spread_deg * lean.standard_normal(2))
    shift = 1e-3 * (np.array(mirror.shift_mm) + mirror.shift_spread_mm * aside.standard_normal(2))
    mount = MirrorMount(float(tilt[0]), float(tilt[1]), float(shift[0]), float(shift[1]))
    error = mirror.range_spread * float(marks_rng.standard_normal())
    marks = marks_rng.standard_normal((_DIRECTIONS, len(_EDGES_M), 3))
    return Head(mount, _swing(settings, track, swing_rng), error, marks)


def known_camera(settings: CameraSettings, head: Head, camera: SimulatedOmniCamera) -> OmniCamera:
    """What the camera.yaml of a head says: its design, or what a calibration has made of it."""
    if settings.known_from == "calibrate-mirror":
        return _calibrated(head, camera)
    scale = 1.0 + head.range_error
    stated = _uncertainty(settings)
    if settings.known_from == "design":
        if camera.mirror is None:  # a camera.yaml of its own
            return camera.design
        return replace(camera.design, range_m=scale * camera.design.range_m, stated_uncertainty=stated)
    calibrated = _calibrated(head, camera)  # calibrate range: one table, the mean of all directions
    ranges = scale * np.exp(np.log(calibrated.range_m).mean(axis=0, keepdims=True))
    return replace(
        calibrated, bearings_rad=np.zeros(1), range_m=ranges, bearing_offset_rad=None, stated_uncertainty=stated
    )


def _uncertainty(settings: CameraSettings) -> CameraUncertainty:
    """What whoever has built such heads would say of their design: nothing can be wrong with an ideal one."""
    mirror = settings.mirror
    tilt_deg = math.hypot(mirror.tilt_spread_deg, *mirror.tilt_deg)
    shift_mm = math.hypot(mirror.shift_spread_mm, *mirror.shift_mm)
    return CameraUncertainty(tilt_deg, _PX_PER_MM * shift_mm, mirror.range_spread)


def _calibrated(head: Head, camera: SimulatedOmniCamera) -> OmniCamera:
    """What `calibrate mirror` makes of a strip laid in all directions, its edges found to a tenth of a pixel."""
    design = camera.design
    bearings = 2.0 * np.pi / _DIRECTIONS * np.arange(_DIRECTIONS)
    out = np.column_stack((np.cos(bearings), np.sin(bearings)))
    ground = (out[:, np.newaxis] * _EDGES_M[:, np.newaxis]).reshape(-1, 2)
    offset = camera.project(ground) - np.array(design.center)
    offset += _EDGE_PX * head.marks[..., :2].reshape(-1, 2)
    radii = np.hypot(offset[:, 0], offset[:, 1]).reshape(_DIRECTIONS, -1)
    formula = design.mount_yaw_rad + design.handedness * np.arctan2(offset[:, 1], offset[:, 0])
    measured = bearings + _BEARING_RAD * head.marks[:, 0, 2]
    offsets = wrap_angles(measured[:, np.newaxis] - formula.reshape(_DIRECTIONS, -1))
    return calibrated_camera(
        Edges(measured, offsets, radii, _EDGES_M),
        size=(design.width, design.height),
        center=design.center,
        handedness=design.handedness,
        mount_yaw_rad=design.mount_yaw_rad,
        inner_radius_px=design.inner_radius_px,
    )


def _swing(settings: CameraSettings, track: Track, rng: np.random.Generator) -> FloatArray:
    """(N, 2) how much the mirror leans further at the track's steps: noise that decays, while the robot drives."""
    size = math.radians(settings.mirror.vibration_deg)
    rows = len(track.poses)
    if size == 0.0:
        return np.zeros((rows, 2))
    axes = [drift(rows, STEP_S, size, settings.mirror.vibration_s, each) for each in rng.spawn(2)]
    steps = np.hypot(track.driven[:, 0], track.driven[:, 1]) + _TURNING_M * np.abs(track.driven[:, 2])
    driving = np.minimum(steps / STEP_S / _DRIVING_M_S, 1.0)
    return driving[:, np.newaxis] * np.stack(axes, axis=1)
