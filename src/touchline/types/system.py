"""What sources and sinks know of a localization system: it is told a prior, takes frames and gives estimates."""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from touchline.errors import InputError
from touchline.geometry import FloatArray, Pose
from touchline.given import given_numbers
from touchline.types.estimate import Estimate
from touchline.types.frame import Frame


@dataclass(frozen=True, slots=True)
class WeightedPose:
    """A pose that a robot may have, its covariance (3, 3) in (m, m, rad), and the probability of being the right one.

    Raises InputError for what is none of these.
    """

    pose: Pose
    covariance: FloatArray = field(compare=False)
    weight: float

    def __post_init__(self) -> None:
        _check_covariance(self.pose, self.covariance)
        if not (all(map(math.isfinite, self.pose)) and 0.0 < self.weight <= 1.0):
            raise InputError(f"a weighted pose needs finite numbers and a weight above 0 and up to 1, got {self!r:.80}")


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known before the first frame: a pose, the own half (x < 0), or nothing; or what has happened since.

    covariance: (3, 3) of the pose in (m, m, rad); None: as the system's settings have it.

    poses: where the robot may stand by now. kept: probability that what was believed still holds; above 0 the prior
    joins it instead of replacing it. spread (3, 3): by how much the robot has moved then, unfelt. What is left of 1
    counts for anywhere on the field; own_half beside `kept` or `poses`: all of it is likelier there.
    Raises InputError for a pose and a half, for a pose or covariance that is none, and for weights beyond 1.
    """

    pose: Pose | None = None
    own_half: bool = False
    covariance: FloatArray | None = field(default=None, compare=False)
    poses: tuple[WeightedPose, ...] = ()
    kept: float = 0.0
    spread: FloatArray | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if not 0.0 <= self.kept <= 1.0 or self.rest < -1e-9 or (self.pose is not None and (self.kept or self.poses)):
            raise InputError("a prior has a pose, or weighted poses and what is kept, of 1 together")
        if self.pose is not None and not all(math.isfinite(value) for value in self.pose):
            raise InputError(f"the start pose {tuple(self.pose)} must be three finite numbers: x, y (m), heading (rad)")
        if self.pose is not None and self.own_half:
            raise InputError("give a start pose or the own half, not both")
        if self.covariance is not None:
            _check_covariance(self.pose, self.covariance)

    @property
    def rest(self) -> float:
        """Probability of standing elsewhere than at the weighted poses and at what is kept."""
        return 1.0 - self.kept - sum(one.weight for one in self.poses)


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

    def reset(self, prior: Prior | None = None) -> None:
        """Forget everything but the prior."""
