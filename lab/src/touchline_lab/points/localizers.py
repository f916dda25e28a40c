"""What a point set is given to: localizers that answer with a pose for one observation."""

import math
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from touchline.camera import OmniCamera
from touchline.field import FieldModel
from touchline.geometry import Pose
from touchline.localization.registration.registration import Registration
from touchline.localization.registration.weights import WeightSettings, precision_weights
from touchline.localization.search.pose_search import PoseSearch
from touchline.published.nubot.global_search import GlobalSearch
from touchline.published.nubot.matcher import Matcher
from touchline.systems import SYSTEMS, RobotSetup, open_system
from touchline.types import Frame, LinePoints, Observation, Prior, Samples

COMPASS_SIGMA_RAD = 0.1  # standard deviation of a compass: five degrees, and a little
# share of the points that are explained below which a descent has ended beside the pose: where one in twenty is clutter
# the right one explains at least 85 %, one that is missed a quarter to a half
DOUBTED = 0.7
AROUND_M, AROUND_RAD = 1.2, math.radians(54.0)  # of the start, where the pose is searched then


class PointLocalizer(Protocol):
    """Localises a single observation, without memory of those before. None: it finds no pose."""

    def from_pose(self, points: LinePoints, start: Pose) -> Pose | None:
        """Beginning from a pose that is a little off."""
        ...

    def from_heading(self, points: LinePoints, heading_rad: float) -> Pose | None:
        """Knowing nothing but what a compass says."""
        ...

    def from_nothing(self, points: LinePoints) -> Pose | None:
        """Knowing nothing; on a symmetric field the twin is as right."""
        ...


class ByRegistration:
    """Touchline's own: registration, and the search of the whole field."""

    def __init__(self, field: FieldModel) -> None:
        self.registration = Registration(field.distance_map())
        self.search = PoseSearch(field, self.registration)

    def from_pose(self, points: LinePoints, start: Pose) -> Pose | None:
        at, spreads, begin = points.positions_m, points.covariances_m2, np.array(start)
        found = self.registration.fit(at, spreads, begin)
        if found.explained < DOUBTED:
            modes = self.search.near(at, spreads, begin, AROUND_M, AROUND_RAD)
            if modes and modes[0].explained > found.explained:
                return modes[0].pose
        return Pose(float(found.pose[0]), float(found.pose[1]), math.remainder(float(found.pose[2]), 2.0 * math.pi))

    def from_heading(self, points: LinePoints, heading_rad: float) -> Pose | None:
        modes = self.search.facing(points.positions_m, points.covariances_m2, heading_rad, COMPASS_SIGMA_RAD)
        return modes[0].pose if modes else None

    def from_nothing(self, points: LinePoints) -> Pose | None:
        modes = self.search.everywhere(points.positions_m, points.covariances_m2)
        return modes[0].pose if modes else None


class ByRprop:
    """NuBot's: matching by RPROP, and its grid of samples (Xiong et al., sections 4.1 and 4.2)."""

    def __init__(self, field: FieldModel) -> None:
        self.matcher = Matcher(field.distance_map())
        self.search = GlobalSearch(self.matcher, field.length, field.width, symmetric=field.is_symmetric)
        self.weights = WeightSettings()

    def from_pose(self, points: LinePoints, start: Pose) -> Pose | None:
        weights = precision_weights(points, self.weights)
        found, _, _ = self.matcher.descend(points.positions_m, weights, np.array(start))
        return Pose(float(found[0]), float(found[1]), math.remainder(float(found[2]), 2.0 * math.pi))

    def from_heading(self, points: LinePoints, heading_rad: float | None) -> Pose | None:
        weights = precision_weights(points, self.weights)
        fix = self.search.locate_any_heading(points.positions_m, weights, heading_rad)
        return None if fix is None else fix.match.pose

    def from_nothing(self, points: LinePoints) -> Pose | None:
        return self.from_heading(points, None)


class ByStep:
    """Any system as it runs: told a pose or nothing, one frame, its estimate."""

    def __init__(self, field: FieldModel, name: str) -> None:
        self.system = open_system(name, RobotSetup(field))

    def from_pose(self, points: LinePoints, start: Pose) -> Pose | None:
        return self._step(points, Prior(start), None)

    def from_heading(self, points: LinePoints, heading_rad: float) -> Pose | None:
        return self._step(points, None, heading_rad)

    def from_nothing(self, points: LinePoints) -> Pose | None:
        return self._step(points, None, None)

    def _step(self, points: LinePoints, prior: Prior | None, heading_rad: float | None) -> Pose | None:
        self.system.reset(prior)
        stamp = np.zeros(1, np.int64)
        compass = None if heading_rad is None else Samples(stamp, np.array([[heading_rad]]))
        return self.system.step(Frame(0, observation=Observation(0, points), compass=compass)).pose


OWN = "touchline"
_OF_PARTS: Mapping[str, Callable[[FieldModel], PointLocalizer]] = {OWN: ByRegistration, "nubot-mti": ByRprop}


def point_systems() -> tuple[str, ...]:
    """The names that `point_localizer` knows: systems that need no more than line points."""
    return tuple(dict.fromkeys((OWN, *(name for name, info in SYSTEMS.items() if OmniCamera in info.cameras))))


def point_localizer(name: str, field: FieldModel) -> PointLocalizer:
    """The named one of `point_systems` for a field."""
    make = _OF_PARTS.get(name)
    return ByStep(field, name) if make is None else make(field)
