"""The three values that flow through Touchline: Frame, Observation, Estimate.

Arrays are not copied: treat them as read-only. Time stamps are integer nanoseconds of one clock. What is seen is in the
robot frame: x forward, y left, metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cache
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose, Pose3, wrap_angle
from touchline.given import given_numbers, refused
from touchline.messages import counted

ImageArray = npt.NDArray[np.uint8]
KindArray = npt.NDArray[np.str_]
Colors = tuple[str, ...]
"""From the ground up; empty where not known."""


MAX_VALUE = 1.0e9  # no metre, radian or rad/s of a robot gets there
_TWIN_M, _TWIN_RAD = 0.5, 0.5  # nearer than this to the turned pose a hypothesis is the twin
MAX_OBSERVED_POINTS = 10_000_000
"""The most line points of one observation."""


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """Stamped measurements of one sensor, in the order of time.

    stamp_ns: int64 (N,), strictly increasing. values: float64 (N, k), one column per quantity.
    """

    stamp_ns: npt.NDArray[np.int64]
    values: FloatArray

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or len(self.stamp_ns) != len(self.values):
            raise ValueError(
                f"samples need stamps (N,) and values (N, k), got {self.stamp_ns.shape}, {self.values.shape}"
            )

    def __len__(self) -> int:
        return len(self.stamp_ns)


def _check_shapes(what: str, **arrays: tuple[npt.NDArray[Any], tuple[int, ...]]) -> None:
    """Raises ValueError unless each array has its shape."""
    wrong = [f"{name} {shape}, got {array.shape}" for name, (array, shape) in arrays.items() if array.shape != shape]
    if wrong:
        raise ValueError(f"{what} need {'; '.join(wrong)}")


def _check_kinds(what: str, kinds: KindArray, known: type[StrEnum]) -> None:
    """Raises ValueError for a kind that is not known."""
    unknown = set(kinds.tolist()) - set(known)
    if unknown:
        raise ValueError(f"{what} are of the kinds {', '.join(known)}, not {', '.join(sorted(map(str, unknown)))}")


@dataclass(frozen=True, eq=False, slots=True)
class LinePoints:
    """Points on white lines; of an observation's `boundary`, points where the field's green ends.

    positions_m: (N, 2) robot frame. covariances_m2: (N, 2, 2) robot frame. confidences: (N,) in 0..1.
    pixels: (N, 2) u, v of where each was seen; NaN where unknown.
    """

    positions_m: FloatArray
    covariances_m2: FloatArray
    confidences: FloatArray
    pixels: FloatArray

    def __post_init__(self) -> None:
        for name in ("positions_m", "covariances_m2", "confidences", "pixels"):
            given = getattr(self, name)
            if not isinstance(given, np.ndarray):
                try:
                    object.__setattr__(self, name, np.array(given, dtype=np.float64, ndmin=1))
                except (TypeError, ValueError):
                    raise refused(name, "an array of numbers", given) from None
        n = check_point_count(len(self.positions_m))
        shapes = (self.positions_m.shape, self.covariances_m2.shape, self.confidences.shape, self.pixels.shape)
        if shapes != ((n, 2), (n, 2, 2), (n,), (n, 2)):
            raise ValueError(f"line points need (N, 2), (N, 2, 2), (N,), (N, 2), got {shapes}")

    def __len__(self) -> int:
        return len(self.positions_m)

    def usable(self, max_range_m: float = math.inf) -> LinePoints:
        """Those that are measurements: finite, no negative confidence or variance, within max_range_m."""
        if _all_measured(self.positions_m, self.covariances_m2, self.confidences, max_range_m):
            return self
        kept = _measured(self.positions_m, self.covariances_m2, self.confidences, max_range_m)
        if kept.all():
            return self
        return LinePoints(self.positions_m[kept], self.covariances_m2[kept], self.confidences[kept], self.pixels[kept])


def _measured(
    positions_m: FloatArray, covariances_m2: FloatArray, confidences: FloatArray, max_range_m: float
) -> npt.NDArray[np.bool_]:
    """(N,) which places (N, 2) are measurements: finite, no negative confidence or variance, within max_range_m."""
    if len(positions_m) == 0:
        return np.zeros(0, dtype=np.bool_)
    kept = np.isfinite(positions_m).all(axis=1) & np.isfinite(covariances_m2).all(axis=(1, 2))
    kept &= np.isfinite(confidences) & (confidences >= 0.0)
    kept &= (covariances_m2[:, 0, 0] >= 0.0) & (covariances_m2[:, 1, 1] >= 0.0)
    if max_range_m < math.inf:
        with np.errstate(over="ignore"):
            kept &= np.hypot(positions_m[:, 0], positions_m[:, 1]) <= max_range_m
    return np.asarray(kept)


def _all_measured(
    positions_m: FloatArray, covariances_m2: FloatArray, confidences: FloatArray, max_range_m: float
) -> bool:
    """Whether all places are measurements; quick, and False where that is not plain: far off, or a sum too large."""
    if len(positions_m) == 0:
        return False
    total = np.add.reduce(positions_m, axis=None) + np.add.reduce(covariances_m2, axis=None)
    if not math.isfinite(total + np.add.reduce(confidences)):
        return False
    least_m2 = min(np.minimum.reduce(covariances_m2[:, 0, 0]), np.minimum.reduce(covariances_m2[:, 1, 1]))
    far_m = max(np.maximum.reduce(positions_m, axis=None), -np.minimum.reduce(positions_m, axis=None))
    return bool(min(least_m2, np.minimum.reduce(confidences)) >= 0.0 and 1.5 * far_m <= max_range_m)


def check_point_count(count: int) -> int:
    """The count. Raises InputError for more points than one observation can hold."""
    if count > MAX_OBSERVED_POINTS:
        raise InputError(f"{count} points: one observation holds {MAX_OBSERVED_POINTS} at most")
    return count


def _positions(what: str, given: object) -> FloatArray:
    """(N, 2) positions. Raises InputError for what is none."""
    try:
        positions_m = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        positions_m = np.zeros(0)
    if positions_m.ndim != 2 or positions_m.shape[1] != 2:
        raise refused(what, "LinePoints or positions (N, 2) in m", given)
    return positions_m


@cache  # nothing can be changed in arrays without elements
def empty_points() -> LinePoints:
    """No line points."""
    return LinePoints(np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros((0, 2)))


def generic_covariances(positions_m: FloatArray) -> FloatArray:
    """Covariances (N, 2, 2) of positions (N, 2), robot frame, of which nobody says how precise they are.

    The same in all directions; standard deviation 1 cm and 2 % of the range, as of a usual camera's calibration.
    """
    sigma_m = 0.01 + 0.02 * np.hypot(positions_m[:, 0], positions_m[:, 1])
    covariances_m2 = np.zeros((len(positions_m), 2, 2))
    covariances_m2[:, 0, 0] = covariances_m2[:, 1, 1] = sigma_m**2
    return covariances_m2


def points_at(positions_m: FloatArray) -> LinePoints:
    """Line points of which only the positions (N, 2), robot frame, are known: sure, with `generic_covariances`."""
    n = len(positions_m)
    return LinePoints(positions_m, generic_covariances(positions_m), np.ones(n), np.full((n, 2), np.nan))


@dataclass(frozen=True, eq=False, slots=True)
class Lines:
    """Visible parts of straight lines.

    ends_m: (N, 2, 2) both ends, robot frame. covariances_m2: (N, 2, 2, 2) of each end.
    confidences: (N,) in 0..1. pixels: (N, 2, 2) u, v of each end; NaN where unknown.
    """

    ends_m: FloatArray
    covariances_m2: FloatArray
    confidences: FloatArray
    pixels: FloatArray

    def __post_init__(self) -> None:
        n = len(self.ends_m)
        _check_shapes(
            "lines",
            ends_m=(self.ends_m, (n, 2, 2)),
            covariances_m2=(self.covariances_m2, (n, 2, 2, 2)),
            confidences=(self.confidences, (n,)),
            pixels=(self.pixels, (n, 2, 2)),
        )

    def __len__(self) -> int:
        return len(self.ends_m)

    def usable(self, max_range_m: float = math.inf) -> Lines:
        """Those of which both ends are measurements, as `LinePoints.usable` says."""
        kept = np.logical_and.reduce(
            [
                _measured(self.ends_m[:, end], self.covariances_m2[:, end], self.confidences, max_range_m)
                for end in (0, 1)
            ]
        )
        if kept.all():
            return self
        return Lines(self.ends_m[kept], self.covariances_m2[kept], self.confidences[kept], self.pixels[kept])


@cache
def no_lines() -> Lines:
    """No lines."""
    return Lines(np.zeros((0, 2, 2)), np.zeros((0, 2, 2, 2)), np.zeros(0), np.zeros((0, 2, 2)))


class CrossingKind(StrEnum):
    """How many arms of paint leave a crossing: two, three or four."""

    L = "L"
    T = "T"
    X = "X"


@dataclass(frozen=True, eq=False, slots=True)
class Crossings:
    """Where lines meet.

    kinds: (N,) of `CrossingKind`. positions_m: (N, 2) robot frame. orientations_rad: (N,) robot frame, of L the
    bisector into the opening, of T the stem, away from the bar, of X either line modulo pi/2; NaN where unknown.
    covariances_m2: (N, 2, 2). confidences: (N,) in 0..1. pixels: (N, 2) u, v; NaN where unknown.
    """

    kinds: KindArray
    positions_m: FloatArray
    orientations_rad: FloatArray
    covariances_m2: FloatArray
    confidences: FloatArray
    pixels: FloatArray

    def __post_init__(self) -> None:
        n = len(self.positions_m)
        _check_shapes(
            "crossings",
            kinds=(self.kinds, (n,)),
            positions_m=(self.positions_m, (n, 2)),
            orientations_rad=(self.orientations_rad, (n,)),
            covariances_m2=(self.covariances_m2, (n, 2, 2)),
            confidences=(self.confidences, (n,)),
            pixels=(self.pixels, (n, 2)),
        )
        _check_kinds("crossings", self.kinds, CrossingKind)

    def __len__(self) -> int:
        return len(self.positions_m)

    def usable(self, max_range_m: float = math.inf) -> Crossings:
        """Those that are measurements, as `LinePoints.usable` says."""
        kept = _measured(self.positions_m, self.covariances_m2, self.confidences, max_range_m)
        kept &= ~np.isinf(self.orientations_rad)
        if kept.all():
            return self
        return Crossings(
            self.kinds[kept],
            self.positions_m[kept],
            self.orientations_rad[kept],
            self.covariances_m2[kept],
            self.confidences[kept],
            self.pixels[kept],
        )


@cache
def no_crossings() -> Crossings:
    """No crossings."""
    return Crossings(
        np.zeros(0, "U1"), np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2, 2)), np.zeros(0), np.zeros((0, 2))
    )


class LandmarkKind(StrEnum):
    """Things that stand or are painted at one known place of the field."""

    POST = "post"
    POLE = "pole"
    GOAL = "goal"
    PENALTY_MARK = "penalty_mark"
    CIRCLE = "circle"


@dataclass(frozen=True, eq=False, slots=True)
class Landmarks:
    """Feet of goal posts and poles, middles of goals, penalty marks and the centre circle.

    kinds: (N,) of `LandmarkKind`. positions_m: (N, 2) robot frame. covariances_m2: (N, 2, 2).
    confidences: (N,) in 0..1. colors: of each from the ground up, empty where not known. pixels: (N, 2) u, v; NaN
    where unknown.
    """

    kinds: KindArray
    positions_m: FloatArray
    covariances_m2: FloatArray
    confidences: FloatArray
    colors: tuple[Colors, ...]
    pixels: FloatArray

    def __post_init__(self) -> None:
        n = len(self.positions_m)
        _check_shapes(
            "landmarks",
            kinds=(self.kinds, (n,)),
            positions_m=(self.positions_m, (n, 2)),
            covariances_m2=(self.covariances_m2, (n, 2, 2)),
            confidences=(self.confidences, (n,)),
            pixels=(self.pixels, (n, 2)),
        )
        if len(self.colors) != n:
            raise ValueError(f"{n} landmarks need as many tuples of colours, got {len(self.colors)}")
        _check_kinds("landmarks", self.kinds, LandmarkKind)

    def __len__(self) -> int:
        return len(self.positions_m)

    def usable(self, max_range_m: float = math.inf) -> Landmarks:
        """Those that are measurements, as `LinePoints.usable` says."""
        kept = _measured(self.positions_m, self.covariances_m2, self.confidences, max_range_m)
        if kept.all():
            return self
        return Landmarks(
            self.kinds[kept],
            self.positions_m[kept],
            self.covariances_m2[kept],
            self.confidences[kept],
            tuple(colors for colors, keep in zip(self.colors, kept, strict=True) if keep),
            self.pixels[kept],
        )


@cache
def no_landmarks() -> Landmarks:
    """No landmarks."""
    return Landmarks(np.zeros(0, "U1"), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), (), np.zeros((0, 2)))


@dataclass(frozen=True, eq=False, slots=True)
class Observation:
    """What was seen in one frame, in the robot frame. problem: why nothing could be seen, if so.

    points, boundary: LinePoints, or positions (N, 2) of which nobody says how precise they are.
    Raises InputError for what is neither.
    """

    stamp_ns: int
    points: LinePoints = field(default_factory=empty_points)
    lines: Lines = field(default_factory=no_lines)
    crossings: Crossings = field(default_factory=no_crossings)
    landmarks: Landmarks = field(default_factory=no_landmarks)
    boundary: LinePoints = field(default_factory=empty_points)
    problem: str | None = None

    def __repr__(self) -> str:
        named = ((self.points, "line point"), (self.lines, "line"), (self.crossings, "crossing"))
        seen = [counted(len(of), what) for of, what in (*named, (self.landmarks, "landmark")) if len(of)]
        return f"Observation({self.stamp_ns / 1e9:.3f} s: {self.problem or ', '.join(seen) or 'nothing seen'})"

    def usable(self, max_range_m: float = math.inf) -> Observation:
        """Without points, lines, crossings and landmarks that are no measurements, or farther away than max_range_m."""
        points = self.points.usable(max_range_m)
        if points is self.points and not (len(self.lines) or len(self.crossings) or len(self.landmarks)):
            return self  # as of nearly every image of a mirror
        return replace(
            self,
            points=points,
            lines=self.lines.usable(max_range_m) if len(self.lines) else self.lines,
            crossings=self.crossings.usable(max_range_m) if len(self.crossings) else self.crossings,
            landmarks=self.landmarks.usable(max_range_m) if len(self.landmarks) else self.landmarks,
        )

    def __post_init__(self) -> None:
        for name in ("points", "boundary"):
            given = getattr(self, name)
            if not isinstance(given, LinePoints):
                object.__setattr__(self, name, points_at(_positions(name, given)))


_PLACE = "x, y in m"


@dataclass(frozen=True, slots=True)
class Evidence:
    """What somebody else says of where the robot stands: a team mate, the ball, a colour.

    source: who says it, which the estimate names if it turns the pose. probability: that it is true. Either the half:
    own_half; or a place: what the robot sees at seen_m (x, y, robot frame; itself by default) is at place_m (x, y,
    field frame), give or take spread_m, a standard deviation.
    Raises InputError for neither or both, and for what is no probability or no place.
    """

    source: str
    probability: float = 0.9
    own_half: bool | None = None
    place_m: tuple[float, float] | None = None
    seen_m: tuple[float, float] = (0.0, 0.0)
    spread_m: float = 0.5

    def __post_init__(self) -> None:
        (probability,) = given_numbers("evidence: probability", "a number between 0 and 1", [self.probability], 1)
        if not 0.0 < probability < 1.0:
            raise InputError(f"evidence: probability: {probability:g} is not between 0 and 1")
        if (self.own_half is None) == (self.place_m is None):
            raise InputError("evidence says the half (own_half) or a place (place_m), one of them")
        for name in ("place_m", "seen_m"):
            given = getattr(self, name)
            if given is not None and not all(map(math.isfinite, given_numbers(f"evidence: {name}", _PLACE, given, 2))):
                raise refused(f"evidence: {name}", _PLACE, given)
        (spread,) = given_numbers("evidence: spread_m", "a length in m above 0", [self.spread_m], 1)
        if not 0.0 < spread < math.inf:
            raise InputError(f"evidence: spread_m: {spread:g} is no length above 0 m")

    def log_likelihood(self, pose: Pose) -> float:
        """Logarithm of the probability of its being said at a pose."""
        if self.place_m is None:
            fits = 1.0 if (pose.x < 0.0) == self.own_half else 0.0
        else:
            (x, y) = pose.transform(np.array([self.seen_m], dtype=np.float64))[0]
            away2 = (x - self.place_m[0]) ** 2 + (y - self.place_m[1]) ** 2
            fits = math.exp(-0.5 * min(away2 / self.spread_m**2, 100.0))
        return math.log(self.probability * fits + (1.0 - self.probability) * (1.0 - fits))


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One image (or what was seen in it) and all that was measured since the frame before.

    image: uint8 (H, W, 3), BGR. observation: what a detector of the robot's own found, which takes the place of the
    image. base_from_camera: pose of the camera body in the base frame at this stamp, lean of the body included; it
    takes the place of the camera's mount and of `tilt`. odometry: x, y, theta in the odometry frame.
    wheels: a, b travelled (m). gyro: gx, gy, gz (rad/s). compass: yaw in the field frame (rad).
    tilt: roll, pitch (rad). evidence: what others say of the pose. `problem` says why an expected image is missing.
    Anything but the stamp may be missing (None).
    """

    stamp_ns: int
    image: ImageArray | None = None
    observation: Observation | None = None
    base_from_camera: Pose3 | None = None
    odometry: Samples | None = None
    wheels: Samples | None = None
    gyro: Samples | None = None
    compass: Samples | None = None
    tilt: Samples | None = None
    exposure_ms: float | None = None
    gain: float | None = None
    name: str = ""
    problem: str | None = None
    evidence: tuple[Evidence, ...] = ()

    def __repr__(self) -> str:
        image = "no image" if self.image is None else f"image {self.image.shape[1]}×{self.image.shape[0]}"
        seen = "" if self.observation is None else ", own observation"
        sensors = [(name, getattr(self, name)) for name in ("odometry", "wheels", "gyro", "compass", "tilt")]
        told = "".join(f", {len(samples)} × {name}" for name, samples in sensors if samples is not None)
        return f"Frame({self.stamp_ns / 1e9:.3f} s: {image}{seen}{told})"


class Status(StrEnum):
    """How far an estimate can be trusted."""

    TRACKING = "tracking"
    SEARCHING = "searching"
    LOST = "lost"


class Mode(StrEnum):
    """Which sensors a fused estimate comes from (Ismail et al. 2021, section II.D)."""

    OMNIVISION = "omnivision"
    ODOMETRY = "odometry"
    BOTH = "omnivision+odometry"


class OdometryScales(NamedTuple):
    """By how much the odometry tells travel ahead, travel aside and turns too short, as a system has learned it;
    and the standard deviations of that.
    """

    errors: tuple[float, float, float]
    deviations: tuple[float, float, float]

    def corrected(self, motion: Pose) -> tuple[Pose, FloatArray]:
        """A motion of the odometry as it was, and the covariance (3, 3) that is left of its scales."""
        scaled = [value * (1.0 + error) for value, error in zip(motion, self.errors, strict=True)]
        left = np.square([value * deviation for value, deviation in zip(scaled, self.deviations, strict=True)])
        return Pose(scaled[0], scaled[1], wrap_angle(scaled[2])), np.diag(left)


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Another pose that would explain what was seen, too.

    residual_m: mean distance of the points to the lines. probability: of being the right one; None where the system
    estimates none. covariance: (3, 3) of x, y, heading in (m, m, rad), field frame; None where unknown.
    """

    pose: Pose
    residual_m: float
    probability: float | None = None
    covariance: FloatArray | None = field(default=None, compare=False)


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """Where the robot stands. covariance: (3, 3) of x, y, heading in (m, m, rad), field frame.

    residual_m: (weighted) mean distance of the points to the nearest line; NaN without points. hypotheses: the other
    poses that are possible, this one not among them. probability: of this pose being the right one; None where the
    system estimates none. mode: of systems that fuse sensors by modes, None of others. odometry: what is known of its
    scales, None where a system learns nothing of them.
    """

    stamp_ns: int
    pose: Pose
    covariance: FloatArray
    status: Status
    residual_m: float = float("nan")
    points: int = 0
    hypotheses: tuple[Hypothesis, ...] = ()
    probability: float | None = None
    perception_ms: float = 0.0
    localization_ms: float = 0.0
    observation: Observation | None = field(default=None, repr=False)
    mode: Mode | None = None
    problems: tuple[str, ...] = ()
    """What was wrong with the robot's data since the estimate before: a phrase each."""
    odometry: OdometryScales | None = None

    @property
    def twin_probability(self) -> float | None:
        """Of the robot standing at the pose's twin, at the other end of the field.

        None where nothing is estimated; 0 where a system that estimates probabilities names no twin.
        """
        told = [other.probability for other in self.twins if other.probability is not None]
        return sum(told) if told or self.probability is not None else None

    @property
    def twins(self) -> tuple[Hypothesis, ...]:
        """The hypotheses that are this pose at the other end of the field, which looks the same from there."""
        twin = self.pose.mirrored()
        return tuple(
            other
            for other in self.hypotheses
            if other.pose.distance_to(twin) < _TWIN_M and abs(wrap_angle(other.pose.heading - twin.heading)) < _TWIN_RAD
        )

    def __repr__(self) -> str:
        x, y, heading = self.pose
        dx, dy, turn = np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))
        residual = "" if math.isnan(self.residual_m) else f", residual {100.0 * self.residual_m:.1f} cm"
        others = f", {counted(len(self.hypotheses), 'other pose')}" if self.hypotheses else ""
        return (
            f"Estimate({self.stamp_ns / 1e9:.3f} s: x {x:.3f} ± {dx:.3f} m, y {y:.3f} ± {dy:.3f} m, heading "
            f"{math.degrees(heading):.2f} ± {math.degrees(turn):.2f}°, {self.status.value}, {self.points} points"
            f"{residual}{others})"
        )

    def to_dict(self) -> dict[str, Any]:
        """Everything but the observation, in numbers, words and lists as JSON knows them; NaN as None."""
        return {
            "stamp_ns": int(self.stamp_ns),
            "pose": _pose_tree(self.pose),
            "covariance": self.covariance.tolist(),
            "status": self.status.value,
            "residual_m": _number_or_none(self.residual_m),
            "points": int(self.points),
            "probability": self.probability,
            "twin_probability": self.twin_probability,
            "hypotheses": [
                {
                    "pose": _pose_tree(other.pose),
                    "residual_m": _number_or_none(other.residual_m),
                    "probability": other.probability,
                    "covariance": None if other.covariance is None else other.covariance.tolist(),
                }
                for other in self.hypotheses
            ],
            "perception_ms": float(self.perception_ms),
            "localization_ms": float(self.localization_ms),
            "mode": None if self.mode is None else self.mode.value,
            "problems": list(self.problems),
        }

    def matrix(self) -> FloatArray:
        """`field_from_robot` as a homogeneous transform (4, 4)."""
        c, s = math.cos(self.pose.heading), math.sin(self.pose.heading)
        return np.array(
            [[c, -s, 0.0, self.pose.x], [s, c, 0.0, self.pose.y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
        )

    def ros_covariance(self) -> FloatArray:
        """(36,) the covariance as ROS's PoseWithCovariance holds it: rows of x, y, z, roll, pitch, yaw; 0 off the
        plane.
        """
        full = np.zeros((6, 6))
        full[np.ix_((0, 1, 5), (0, 1, 5))] = self.covariance
        return full.ravel()


def _pose_tree(pose: Pose) -> dict[str, float]:
    return {"x_m": float(pose.x), "y_m": float(pose.y), "heading_rad": float(pose.heading)}


def _number_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known before the first frame: a pose, the own half (x < 0), or nothing.

    covariance: (3, 3) of the pose in (m, m, rad); None: as the system's settings have it.
    Raises InputError for a pose and a half, and for a pose or covariance that is none.
    """

    pose: Pose | None = None
    own_half: bool = False
    covariance: FloatArray | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if self.pose is not None and not all(math.isfinite(value) for value in self.pose):
            raise InputError(f"the start pose {tuple(self.pose)} must be three finite numbers: x, y (m), heading (rad)")
        if self.pose is not None and self.own_half:
            raise InputError("give a start pose or the own half, not both")
        if self.covariance is not None:
            _check_covariance(self.pose, self.covariance)


def as_prior(prior: object) -> Prior:
    """What is told to a system at its start: a Prior, None for nothing, or a pose as x, y, heading (m, m, rad).

    Raises InputError for anything else.
    """
    if prior is None:
        return Prior()
    if isinstance(prior, Prior):
        return prior
    return Prior(Pose(*given_numbers("start pose", "x, y (m), heading (rad), a Prior or None", prior, 3)))


def _check_covariance(pose: Pose | None, covariance: FloatArray) -> None:
    """Raises InputError unless the covariance is that of a pose."""
    if pose is None:
        raise InputError("a covariance needs the start pose that it is of")
    if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
        raise InputError(f"the start pose's covariance must be (3, 3) finite numbers, got shape {covariance.shape}")
    if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
        raise InputError("the start pose's covariance must be symmetric with positive variances")


class System(Protocol):
    """What sources and sinks know of a localization system."""

    def step(self, frame: Frame) -> Estimate:
        """Take one frame, return where the robot stands at its time stamp.

        Raises ValueError for a frame that is older than the last one; pose and motion stay as they were. Whoever can't
        rule such frames out steps a `systems.ordered.OrderedSystem`.
        """
        ...

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
        ...
