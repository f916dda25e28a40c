"""What comes out: where the robot stands, how sure that is, and where else it may stand."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np

from touchline.enums import StrEnum
from touchline.geometry import FloatArray, Pose, wrap_angle
from touchline.messages import counted
from touchline.types.drawing import ShownPose, pose_marks, poses_html
from touchline.types.problem import Problem
from touchline.types.seen import Observation

UNCONFIRMED = "not yet confirmed by motion"  # reason of a pose that explains its image, before the robot has moved
_TWIN_M, _TWIN_RAD = 0.5, 0.5  # nearer than this to the turned pose a hypothesis is the twin


_Value = TypeVar("_Value")


class _Later(NamedTuple):
    """A field of an `Estimate` that few ask for."""

    make: Callable[[], Any]


def later(make: Callable[[], _Value]) -> _Value:
    """For one of `ON_DEMAND`: its value, made once, when it is first asked for. make: of immutable data alone."""
    return cast(_Value, _Later(make))


class _OnDemand:
    """Makes a `later` value when it is asked for. slot: where it is kept."""

    def __init__(self, slot: Any) -> None:
        self._slot = slot

    def __get__(self, one: Estimate, kind: type[Estimate]) -> Any:
        value = self._slot.__get__(one, kind)
        if type(value) is _Later:
            value = value.make()
            self._slot.__set__(one, value)
        return value

    def __set__(self, one: Estimate, value: Any) -> None:
        self._slot.__set__(one, value)


class Status(StrEnum):
    """How far an estimate can be trusted."""

    TRACKING = "tracking"
    """Consistent with all that was measured; bounded, where a system gives bounds."""
    SEARCHING = "searching"
    """A pose that is likely, but not confirmed."""
    LOST = "lost"
    """Nothing is known but the motion since the last pose."""


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

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", Pose(*map(float, self.pose)))


class Look(NamedTuple):
    """Where to turn the head: bearing (rad, robot frame, left is positive); the features there, the nearest first, by
    their places in the field (m); and by how many nats the view would shrink what is not known of the pose.
    """

    bearing_rad: float
    features: tuple[str, ...]
    nats: float


class Looking(Protocol):
    """Knows a field well enough to say where to look."""

    def of(self, estimate: Estimate) -> Look | None:
        """The best direction for what is believed now."""


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """Where the robot stands. pose: plain floats. covariance: (3, 3) of x, y, heading in (m, m, rad), field frame.

    residual_m: (weighted) mean distance of the points to the nearest line; NaN without points. hypotheses: the other
    poses that are possible, this one not among them. probability: of this pose being the right one; None where the
    system estimates none. mode: of systems that fuse sensors by modes, None of others. odometry: what is known of its
    scales, None where a system learns nothing of them.

    protection_m, protection_rad: the protection level. The error of the position (m) and of the heading (rad) is larger
    in at most one of a thousand tracked images, given the end of the field; None where no bound can be given.
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
    problems: tuple[Problem, ...] = ()
    """What was wrong with the robot's data since the estimate before."""
    odometry: OdometryScales | None = None
    protection_m: float | None = None
    protection_rad: float | None = None
    reason: str = ""
    """Why the pose is not tracked, or why no bound can be given: a phrase; empty where nothing is to be said."""
    end_probability: float | None = None
    """Of the robot playing towards the end of the field that the pose says; None where a system estimates none."""
    statistics: Mapping[str, float] = field(default_factory=dict)
    """How far sensors and field contradict each other, by name, each over its threshold: from 1 on it is an alarm."""
    gaze: Looking | None = field(default=None, repr=False)
    """What finds `look`."""
    camera_errors: FloatArray | None = field(default=None, repr=False)
    """(K,) by which the camera differs from its camera.yaml, as a system has learned it; None of others."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", Pose(*map(float, self.pose)))

    @property
    def look(self) -> Look | None:
        """Where a head that can be turned should look; found when asked for. None where a system does not know."""
        return None if self.gaze is None else self.gaze.of(self)

    @property
    def twin_probability(self) -> float | None:
        """Of the robot standing at the pose's twin, at the other end of the field.

        None where nothing is estimated; 0 where a system that estimates probabilities names no twin.
        """
        probabilities = [other.probability for other in self.twins if other.probability is not None]
        return sum(probabilities) if probabilities or self.probability is not None else None

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
            f"{math.degrees(heading):.2f} ± {math.degrees(turn):.2f}°, {self.status_text()}, {self.points} points"
            f"{residual}{others})"
        )

    def _repr_html_(self) -> str:
        return self.html()

    def html(self, picture: str = "") -> str:
        """All poses in a table, what is known of them, and a picture, if there is one."""
        said = [*filter(None, (_bound_text(self), self.reason, _statistics_text(self))), *map(str, self.problems)]
        return poses_html(f"{self.stamp_ns / 1e9:.3f} s, {self.points} points", self._shown(), said, picture)

    def svg_marks(self) -> str:
        """SVG in metres of the field frame, y up: the line points as seen from the pose, all poses and their ellipses
        of 2 sigma.
        """
        seen = np.zeros((0, 2)) if self.observation is None else self.observation.points.usable().positions_m
        return pose_marks(self._shown(), self.pose.transform(seen))

    def _shown(self) -> list[ShownPose]:
        own = ShownPose(self.status.value, self.pose, self.covariance, self.residual_m, self.probability)
        others = (ShownPose("or", o.pose, o.covariance, o.residual_m, o.probability) for o in self.hypotheses)
        return [own, *others]

    def status_text(self) -> str:
        """The status with its bound and reason: "tracking within 7 cm", "searching (not yet confirmed by motion)"."""
        within = "" if self.protection_m is None else f" within {math.ceil(100.0 * self.protection_m)} cm"
        return f"{self.status.value}{within}{f' ({self.reason})' if self.reason else ''}"

    @property
    def explains_image(self) -> bool:
        """Whether the pose is tracked, or would be if the robot had moved."""
        return self.status is Status.TRACKING or self.reason == UNCONFIRMED

    def unconfirmed(self, reason: str) -> Estimate:
        """The same pose, searching and without a bound, for this reason."""
        return replace(self, status=Status.SEARCHING, protection_m=None, protection_rad=None, reason=reason)

    def to_dict(self) -> dict[str, Any]:
        """Everything but the observation, in numbers, words and lists as JSON knows them; NaN as None."""
        return {
            "stamp_ns": int(self.stamp_ns),
            "pose": self.pose.to_dict(),
            "covariance": self.covariance.tolist(),
            "status": self.status.value,
            "reason": self.reason,
            "protection_m": self.protection_m,
            "protection_rad": self.protection_rad,
            "residual_m": _number_or_none(self.residual_m),
            "points": int(self.points),
            "probability": self.probability,
            "twin_probability": self.twin_probability,
            "end_probability": self.end_probability,
            "hypotheses": [
                {
                    "pose": other.pose.to_dict(),
                    "residual_m": _number_or_none(other.residual_m),
                    "probability": other.probability,
                    "covariance": None if other.covariance is None else other.covariance.tolist(),
                }
                for other in self.hypotheses
            ],
            "perception_ms": float(self.perception_ms),
            "localization_ms": float(self.localization_ms),
            "mode": None if self.mode is None else self.mode.value,
            "problems": [asdict(problem) for problem in self.problems],
            "statistics": {name: _number_or_none(value) for name, value in self.statistics.items()},
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


ON_DEMAND = "hypotheses", "odometry"  # fields of an estimate that may be made `later`
for _name in ON_DEMAND:
    setattr(Estimate, _name, _OnDemand(getattr(Estimate, _name)))


def _number_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _bound_text(estimate: Estimate) -> str:
    """The protection level and the end's probability; empty where neither is known."""
    parts = []
    if estimate.protection_m is not None:
        parts.append(f"within {100.0 * estimate.protection_m:.1f} cm")
    if estimate.protection_rad is not None:
        parts.append(f"within {math.degrees(estimate.protection_rad):.1f}°")
    if estimate.end_probability is not None:
        parts.append(f"this end of the field: {100.0 * estimate.end_probability:.4g} %")
    return ", ".join(parts)


def _statistics_text(estimate: Estimate) -> str:
    """The consistency statistics; empty where there are none."""
    values = ", ".join(f"{name} {value:.2f}" for name, value in estimate.statistics.items())
    return f"consistency, 1 is the alarm: {values}" if values else ""
