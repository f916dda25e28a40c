"""Where a robot may stand after something has moved it unseen, until images show where: one mechanism for penalties,
pick-ups, falls and restarts.

A mixture over the whole field, both of its ends: weighted poses, each carried on by a filter, and the same density
everywhere else. It weighs the poses that a search finds, and says at which end each of them lies.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline.geometry import FloatArray, Pose
from touchline.localization.estimator.bank import Bank, Member, is_same
from touchline.localization.estimator.field_end import PRIOR_LOG_ODDS, OwnHalf
from touchline.localization.estimator.filter import Filter
from touchline.localization.registration.covariance import ANYWHERE
from touchline.localization.search.pose_search import Mode
from touchline.motion.delayed import Delayed
from touchline.types import Prior

MAX_PARTS = 16
MIN_REST = 0.02  # probability of standing where nothing says: no prior is a condition
NARROW = 0.6  # standard deviation (m, rad) up to which a pose is followed; registration reaches no farther
MIN_VARIANCES = np.diag(np.square([0.1, 0.1, 0.1]))  # of what is kept: a found pose is off by some centimetres itself
MAX_FOUND_GAIN, MIN_FOUND_GAIN = 5.0, -10.0  # log-odds of a pose that is found, against the one that is followed
FRESH_STEPS = 3  # motions without an odometry, until which a mixture says where the robot stands now
SETTLING_IMAGES = 4  # in a row that one pose has to explain, until it is tracked
LYING_RAD, UPRIGHT_RAD, STABLE_S = math.radians(45.0), math.radians(25.0), 0.4
# by a fall: 0.4 m and 40 degrees are usual; and by every second on the ground
FALL = Prior(kept=0.95, spread=np.diag(np.square([0.4, 0.4, 0.8])))
LOST = Prior(kept=0.95)  # of a pose that is predicted too widely to be followed
LYING = np.diag(np.square([0.1, 0.1, 0.25]))


class Part(NamedTuple):
    """One pose of the mixture."""

    filter: Filter
    weight: float

    def log_density(self, pose: Pose) -> float:
        """Logarithm of its weighted density at a pose."""
        off = pose.minus(self.filter.pose)
        covariance = self.filter.covariance
        distance2 = float(off @ np.linalg.solve(covariance, off))
        return math.log(self.weight) - 0.5 * distance2 - 0.5 * math.log(np.linalg.det(2.0 * math.pi * covariance))

    @property
    def is_narrow(self) -> bool:
        """Whether images can be registered from it."""
        return float(np.diag(self.filter.covariance).max()) <= NARROW**2


class Whereabouts:
    """The mixture. `settled`: so many images in a row have been explained by one pose, at a known end."""

    def __init__(self, parts: Sequence[Part], rest: float, own_half: bool, area_m2: float) -> None:
        """rest: probability of standing elsewhere, on so many m². own_half: whether all of it was likelier at x < 0."""
        self.parts = sorted(parts, key=lambda part: -part.weight)[:MAX_PARTS]
        self._rest = math.log(max(rest, MIN_REST) / (2.0 * math.pi * area_m2))
        self._half = OwnHalf() if own_half else None
        self._settling = self._unmeasured = 0
        self._followed: Member | None = None

    @property
    def is_fresh(self) -> bool:
        """Whether the robot has hardly moved since without an odometry."""
        return self._unmeasured <= FRESH_STEPS

    @property
    def best(self) -> Filter | None:
        """The likeliest."""
        return self.parts[0].filter if self.parts else None

    def predict(self, moved: Delayed, seconds: float, noise: FloatArray) -> None:
        """Propagate by the odometry. noise (3, 3): of the motion, robot frame before it; where no odometry measured it,
        a robot that drives on does not turn back at every image: deviations add up, not variances.
        """
        if moved.motion.missing_s > 0.0:
            self._unmeasured += 1
            noise = (2 * self._unmeasured - 1) * noise
        for part in self.parts:
            part.filter.predict(moved, seconds, noise)
        if self._half is not None:
            self._half.predict(moved.motion.pose)

    def loosen(self, covariance: FloatArray) -> None:
        """The robot has moved, unfelt, by this covariance (3, 3)."""
        self.parts = [Part(part.filter.loosened(covariance), part.weight) for part in self.parts]

    def log_density(self, pose: Pose) -> float:
        """Logarithm of the probability of standing there, per m² and rad."""
        half = 0.0 if self._half is None else 0.5 * self._half.log_odds(pose)
        return float(np.logaddexp.reduce([self._rest, *(part.log_density(pose) for part in self.parts)])) + half

    def log_odds(self, pose: Pose) -> float:
        """Of a pose, against its twin; no more than that of an end that an operator gave."""
        odds = self.log_density(pose) - self.log_density(pose.mirrored())
        return min(max(odds, -PRIOR_LOG_ODDS), PRIOR_LOG_ODDS)

    def at_likelier_end(self, modes: Sequence[Mode]) -> tuple[Mode, ...]:
        """Poses that were found, each at the end where it is likelier."""
        return tuple(mode.mirrored() if self.log_odds(mode.pose) < 0.0 else mode for mode in modes)

    def gains(self, modes: Sequence[Mode], best: Member | None) -> list[float]:
        """Log-odds of poses that were found, against the pose that is followed, or against the likeliest of them."""
        densities = [self.log_density(mode.pose) for mode in modes]
        reference = max(densities, default=0.0) if best is None else self.log_density(best.filter.pose)
        return [min(max(each - reference, MIN_FOUND_GAIN), MAX_FOUND_GAIN) for each in densities]

    def settles(self, best: Member | None, consistent: bool) -> bool:
        """Take what an image made of the pose that is followed; whether that may be tracked from now on."""
        self._settling = self._settling + 1 if consistent and best is self._followed else 0
        self._followed = best
        return self._settling >= SETTLING_IMAGES


def joined(bank: Bank, end_probability: float, before: Whereabouts | None, prior: Prior, area_m2: float) -> Whereabouts:
    """What was believed (of it, what is not yet confirmed: `before`) and a prior that joins it; the bank follows what
    can be registered from, and knows what it has learned of odometry and camera.
    """
    spread = MIN_VARIANCES if prior.spread is None else prior.spread + MIN_VARIANCES
    known = before.parts if before is not None else _followed(bank, end_probability)
    learned = bank.knowing
    parts = [Part(part.filter.loosened(spread), prior.kept * part.weight) for part in known if prior.kept > 0.0]
    parts += [Part(learned.placed(one.pose, one.covariance), one.weight) for one in prior.poses]
    rest = 1.0 - sum(part.weight for part in parts)
    found = Whereabouts(parts, rest, prior.own_half, area_m2)
    members: list[Member] = []
    for part in found.parts:  # the bank follows one of each pair of twins, the likelier: the field's end is another's
        twin = part.filter.pose.mirrored()
        if part.is_narrow and not any(is_same(twin, one.filter.pose) for one in members):
            members.append(_member(part))
    bank.follow(members, learned.placed(learned.pose, ANYWHERE))
    return found


def _followed(bank: Bank, end_probability: float) -> list[Part]:
    """What the bank follows, at both ends."""
    each = list(zip(bank.members, bank.probabilities, strict=True))
    here = [Part(one.filter, weight * end_probability) for one, weight in each]
    there = [Part(one.filter.mirrored(), weight * (1.0 - end_probability)) for one, weight in each]
    return [part for part in (*here, *there) if part.weight > 1e-6]


def _member(part: Part) -> Member:
    """A hypothesis for the bank: what its prior contradicts is counted there."""
    return Member(part.filter.loosened(np.zeros((3, 3))), part.log_density(part.filter.pose))


class Posture:
    """Whether the robot `lies`, by its roll and pitch; `fell`: whether it has just begun to."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """It stands."""
        self.lies = self.fell = False
        self._upright_since_ns: int | None = None

    def update(self, stamp_ns: int, attitude: FloatArray | None) -> None:
        """Take the roll and pitch (N, 2), rad, since the last image; None: not measured, as if it stood."""
        lean = 0.0
        if attitude is not None and len(attitude):
            leans = [abs(angle) for row in attitude[:, :2].tolist() for angle in row]
            lean = math.nan if math.isnan(sum(leans)) else max(leans)
        self.fell = not self.lies and LYING_RAD < lean < math.pi
        if lean > (UPRIGHT_RAD if self.lies else LYING_RAD):
            self.lies, self._upright_since_ns = self.lies or self.fell, None
        elif self._upright_since_ns is None:
            self._upright_since_ns = stamp_ns
        stable_ns = 0 if self._upright_since_ns is None else stamp_ns - self._upright_since_ns
        self.lies = self.lies and stable_ns < 1e9 * STABLE_S
