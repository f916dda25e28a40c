"""`touchline calibrate self`: what a mirror differs by from its camera.yaml, from a recording of play.

A bundle adjustment (`calibration/bundle.py`) of the mirror, and of the pose and the shaking of images from all over a
recording: robust Gauss-Newton steps on the distances of the line points from the lines. The mirror is that of
`localization/camera_errors/mirror.py`, with a smooth correction of its ranges. The poses of a run of the system
are where it begins.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from touchline.calibration.bundle import Block, NormalEquations, entries, prior_block, residual_block
from touchline.camera import Camera, OmniCamera
from touchline.camera.uncertainty import CameraUncertainty
from touchline.errors import NoFitError
from touchline.field import FieldModel
from touchline.geometry import FloatArray, Pose
from touchline.localization.camera_errors.base import CameraErrors, placed_points
from touchline.localization.camera_errors.mirror import MISFIT_M2, NAMES, mirror_errors
from touchline.localization.camera_errors.mirror_response import HEIGHT_M, MirrorResponse
from touchline.types import Estimate, LinePoints

IMAGES, MIN_IMAGES = 50, 3  # images that are fitted; whether few are enough their uncertainty tells
APART_M, TURN_M = 0.3, 1.5  # how far images lie apart at least; a turn by a radian counts so much
KNOTS_M = np.array([1.0, 2.0, 3.0, 4.5, 6.5])  # of the correction of ranges, linear between them
KNOT_RATIO = 0.01  # its standard deviation at each, before
SHAKING_PER_M = 0.005  # standard deviation of an image's own lean
WIDTHS_M = (0.3, 0.2, 0.1, 0.1, 0.05, 0.05, 0.05, 0.05)  # from which points lose influence, step by step
FLOOR_M = 0.01  # standard deviation that no point falls below
REPEATED = 6.0  # so many points err together: neighbours on a line, images of the same place
ON_LINE = 3.0  # standard deviations within which a point lies on its line
MIN_ON_LINES = 0.7  # share of the points that must
MAX_TILT_DEG, MAX_CENTER_PX, MAX_RANGE_RATIO = 0.1, 0.8, 0.01  # standard deviations of what is written
_STEP = 1e-6
ERRORS = len(NAMES)
_SHARED, _OWN = ERRORS + len(KNOTS_M), 5
_OWN_PRIOR = np.array([1e-3, 1e-3, 1e-3, SHAKING_PER_M**-2.0, SHAKING_PER_M**-2.0])  # of poses it only damps steps
_BEARINGS = 72  # directions of the table that is written


C = TypeVar("C", bound=Camera)


class View(NamedTuple):
    """One image: its line points, and the pose (3,) that a system has found."""

    points: LinePoints
    pose: FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class SelfCalibration(Generic[C]):
    """camera: corrected. shared (S,): what the old one errs by, with its covariance; as the module of its kind says.

    points_m, poses: of the views (N, 2), (V, 3), before and after, robot and field frame; of line points and features.
    before, after: share of what is seen that lies where it should, and its distance from there (m).
    """

    camera: C
    shared: FloatArray
    covariance: FloatArray
    points_m: tuple[Sequence[FloatArray], Sequence[FloatArray]]
    poses: tuple[FloatArray, FloatArray]
    before: tuple[float, float]
    after: tuple[float, float]

    @property
    def deviations(self) -> FloatArray:
        """(S,) standard deviations of `shared`."""
        return np.sqrt(np.diag(self.covariance))

    def check(self, seen: str, instead: str, bounds: Sequence[tuple[str, float, float, str]]) -> None:
        """Raises NoFitError with the reason where a calibration is none.

        seen, instead: in words, what was seen and which command needs no camera. bounds: of what is written a name,
        its standard deviation, the largest one, and their unit.
        """
        if self.after[0] < MIN_ON_LINES:
            raise NoFitError(
                f"only {100 * self.after[0]:.0f} % of {seen}, {100 * MIN_ON_LINES:.0f} % are needed. Is it the right "
                f"field, and a camera.yaml that is about right? touchline calibrate {instead} needs none"
            )
        for what, deviation, limit, unit in bounds:
            if deviation > limit:
                raise NoFitError(
                    f"the recording leaves {what} uncertain by ± {deviation:.2g}{unit}, {limit:.2g}{unit} are needed: "
                    "the robot must see more lines, near ones and far ones, from more places and with more headings"
                )


def require_views(count: int) -> None:
    """Raises NoFitError for too few images."""
    if count < MIN_IMAGES:
        raise NoFitError(
            f"{count} images with a known pose that lie apart are too few, {MIN_IMAGES} are needed: the robot must "
            "move about and see lines"
        )


def spread_views(estimates: Sequence[Estimate], count: int = IMAGES) -> tuple[View, ...]:
    """Images of a run that lie apart, each as far as possible from those before it, places and headings alike."""
    found = [
        View(e.observation.points, e.pose.as_array())
        for e in estimates
        if e.explains_image and e.observation is not None and len(e.observation.points) >= 30
    ]
    if not found:
        return ()
    poses = np.array([one.pose for one in found])
    places = np.column_stack((poses[:, :2], TURN_M * np.cos(poses[:, 2]), TURN_M * np.sin(poses[:, 2])))
    chosen, gaps = [len(found) // 2], np.full(len(found), np.inf)
    while len(chosen) < count:
        gaps = np.minimum(gaps, np.linalg.norm(places - places[chosen[-1]], axis=1))
        if gaps.max() < APART_M:
            break
        chosen.append(int(np.argmax(gaps)))
    return tuple(found[k] for k in chosen)


def calibrate_self(views: Sequence[View], camera: OmniCamera, field: FieldModel) -> SelfCalibration[OmniCamera]:
    """The camera that puts the line points of all views on the field's lines. Raises NoFitError with the reason."""
    require_views(len(views))
    bundle = _Views(views, mirror_errors(camera), field)
    state = bundle.start()
    before, starts = bundle.quality(state), state[bundle.own[:, :3]]
    for width_m in WIDTHS_M:
        equations = NormalEquations(bundle.blocks(state, width_m))
        state = state + equations.step()
    shared, covariance = state[bundle.shared], equations.covariance(bundle.shared)
    better = _camera(camera, shared, covariance, bundle.mirror)
    seen = [one.points.positions_m for one in views], [better.ground_from_image(one.points.pixels) for one in views]
    poses = starts, state[bundle.own[:, :3]]
    found = SelfCalibration(better, shared, covariance, seen, poses, before, bundle.quality(state))
    sure = better.uncertainty
    found.check(
        "the line points lie on lines with the best mirror",
        "lines",
        (
            ("the mirror's lean", sure.tilt_deg, MAX_TILT_DEG, "°"),
            ("the centre", sure.center_px, MAX_CENTER_PX, " px"),
            ("ranges", 100.0 * sure.range_ratio, 100.0 * MAX_RANGE_RATIO, " %"),
        ),
    )
    return found


def corrected(positions_m: FloatArray, shared: FloatArray, mirror: MirrorResponse) -> FloatArray:
    """Points (N, 2), base frame, without errors (5,) and range corrections (knots,)."""
    ranges = np.hypot(positions_m[:, 0], positions_m[:, 1])
    factor = 1.0 + np.interp(ranges, KNOTS_M, shared[ERRORS:])
    stretched = np.ascontiguousarray(positions_m * factor[:, np.newaxis])
    return placed_points(stretched, np.ascontiguousarray(shared[:ERRORS]), mirror)


class _Views:
    """The views' line points beside the field's lines.

    A state holds what is shared (5 + knots), then of each view the pose (3,) and its head's shaking (2,).
    """

    def __init__(self, views: Sequence[View], errors: CameraErrors, field: FieldModel) -> None:
        self.views, self.mirror, self._map = views, errors.response(), field.distance_map()
        self.shared, self.own = entries(_SHARED, len(views), _OWN)
        self._prior = np.diag([0.0] * ERRORS + [KNOT_RATIO**-2.0] * len(KNOTS_M))
        self._prior[:ERRORS, :ERRORS] = np.linalg.inv(errors.prior + 1e-14 * np.eye(ERRORS))

    def start(self) -> FloatArray:
        """The camera as it is and the poses that a system has found."""
        poses = np.column_stack(([one.pose for one in self.views], np.zeros((len(self.views), 2))))
        return np.concatenate((np.zeros(_SHARED), poses.ravel()))

    def blocks(self, state: FloatArray, width_m: float) -> list[Block]:
        """Normal equations of a Gauss-Newton step, priors included."""
        blocks = [prior_block(self.shared, self._prior, state[self.shared])]
        for points, own in zip((view.points for view in self.views), self.own, strict=True):
            at = np.concatenate((own, self.shared))
            blocks.append(residual_block(at, *self._linear(points, state[at], width_m)))
            blocks.append(prior_block(own, _OWN_PRIOR, state[own] * (_OWN_PRIOR > 1.0)))
        return blocks

    def quality(self, state: FloatArray) -> tuple[float, float]:
        """Share of all points on lines, and the root of the mean square distance (m) of those within 0.3 m."""
        on_line, squares = [], []
        for view, own in zip(self.views, self.own, strict=True):
            _, distances_m, weights = self._linear(view.points, state[np.concatenate((own, self.shared))], math.inf)
            on_line.append(distances_m**2 * weights * REPEATED < ON_LINE**2)
            squares.append(distances_m[distances_m < 0.3] ** 2)
        return float(np.mean(np.concatenate(on_line))), float(np.sqrt(np.mean(np.concatenate(squares))))

    def _linear(
        self, points: LinePoints, state: FloatArray, width_m: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of a view's points: derivatives (N, 5 + shared) by its pose, its shaking and what is shared, distances (N,)
        from the lines (m), and weights (N,).
        """
        shared = state[_OWN:].copy()
        shared[:2] += state[3:_OWN]
        base = corrected(points.positions_m, shared, self.mirror)
        pose = Pose(*state[:3].tolist())
        distances_m, slopes = self._map.look_up(pose.transform(base))
        c, s = math.cos(pose.heading), math.sin(pose.heading)
        own = slopes @ np.array([[c, -s], [s, c]])
        rows = np.empty((len(base), _OWN + _SHARED))
        rows[:, :2] = slopes
        rows[:, 2] = own[:, 1] * base[:, 0] - own[:, 0] * base[:, 1]
        for j, moved in enumerate(_STEP * np.eye(_SHARED)):
            there = corrected(points.positions_m, shared + moved, self.mirror)
            rows[:, _OWN + j] = ((there - base) * own).sum(axis=1) / _STEP
        rows[:, 3:_OWN] = rows[:, _OWN : _OWN + 2]
        variances = FLOOR_M**2 + np.einsum("ni,nij,nj->n", own, points.covariances_m2, own)
        squares = np.square(distances_m) / (width_m**2 + 9.0 * variances)
        return rows, distances_m, 1.0 / (np.square(1.0 + squares) * variances * REPEATED)


def _camera(camera: OmniCamera, shared: FloatArray, covariance: FloatArray, mirror: MirrorResponse) -> OmniCamera:
    """The camera with ranges and bearings for every direction, and how sure it is."""
    bearings = np.arange(_BEARINGS) * (2.0 * math.pi / _BEARINGS)
    formula = (bearings - camera.mount_yaw_rad) * camera.handedness
    radii = np.clip(camera.radius_px, camera.radius_px[0] + 1e-6, camera.radius_px[-1] - 1e-6)  # both ends count
    ranges, offsets = [], []
    for bearing, angle in zip(bearings, formula, strict=True):
        out = radii[:, np.newaxis] * np.array([math.cos(angle), math.sin(angle)])
        ground = corrected(camera.ground_from_image(out + np.array(camera.center)), shared, mirror)
        reach = np.hypot(ground[:, 0], ground[:, 1])
        ranges.append(np.maximum.accumulate(reach) + 1e-6 * np.arange(len(reach)))
        turned = np.arctan2(ground[:, 1], ground[:, 0]) - bearing
        offsets.append(np.arctan2(np.sin(turned), np.cos(turned)))
    return replace(
        camera,
        bearings_rad=bearings,
        range_m=np.array(ranges),
        bearing_offset_rad=np.clip(np.array(offsets), -0.19, 0.19),
        stated_uncertainty=_uncertainty(shared, covariance),
    )


def _uncertainty(shared: FloatArray, covariance: FloatArray) -> CameraUncertainty:
    variances = np.diag(covariance)
    unseen2 = (0.1 * MISFIT_M2) ** 2 * float(shared[:2] @ shared[:2])
    tilt_rad = 0.5 * HEIGHT_M * math.sqrt(float(variances[:2].mean()) + unseen2)
    range_ratio = math.sqrt(float(variances[4] + variances[ERRORS:].mean()))
    return CameraUncertainty(math.degrees(tilt_rad), math.sqrt(float(variances[2:4].mean())), range_ratio)
