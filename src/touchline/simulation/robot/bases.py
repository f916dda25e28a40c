"""Wheels under a robot: what the base's velocity does to each of them, and what they tell of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from touchline.errors import InputError
from touchline.geometry import FloatArray
from touchline.messages import did_you_mean


@dataclass(frozen=True, eq=False)
class OmniBase:
    """Omni wheels, each rolling along its own direction and free across it.

    directions_rad: (K,) rolling directions in the base frame. levers_m: (K,) arm of a rotation of the base about its
    origin: the wheel's speed at 1 rad/s. Three or more wheels that tell forward, sideways and rotation apart.
    """

    directions_rad: FloatArray
    levers_m: FloatArray

    def __post_init__(self) -> None:
        if self.directions_rad.ndim != 1 or self.directions_rad.shape != self.levers_m.shape:
            raise ValueError(f"directions and levers need (K,), got {self.directions_rad.shape}, {self.levers_m.shape}")
        if np.linalg.matrix_rank(self.wheels_from_body, tol=1e-6) < 3:
            raise InputError("wheels: these directions and levers can't tell forward, sideways and rotation apart")

    @cached_property
    def wheels_from_body(self) -> FloatArray:
        """(K, 3): wheel travels of a base motion (forward, left, rotation)."""
        return np.column_stack((np.cos(self.directions_rad), np.sin(self.directions_rad), self.levers_m))

    @cached_property
    def body_from_wheels(self) -> FloatArray:
        """(3, K): the least-squares base motion of wheel travels."""
        return np.linalg.pinv(self.wheels_from_body)

    def wheel_speeds(self, body: FloatArray) -> FloatArray:
        """Wheel speeds or travels (N, K) of base motions (N, 3) vx, vy (m/s or m), rotation (rad/s or rad)."""
        return body @ self.wheels_from_body.T

    def body_velocity(self, wheels: FloatArray) -> FloatArray:
        """Base motions (N, 3) of wheel speeds or travels (N, K), by least squares."""
        return wheels @ self.body_from_wheels.T


def omni_base(wheels: int, radius_m: float = 0.2) -> OmniBase:
    """The usual base of three (at 60°, 180°, 300°) or four wheels (45°, 135°, ...), all tangential.

    Raises InputError for another number.
    """
    if wheels not in (3, 4):
        raise InputError(f"wheels: there are bases with 3 and 4 omni wheels, not {wheels}")
    first = math.pi / 3.0 if wheels == 3 else math.pi / 4.0
    places = first + 2.0 * math.pi / wheels * np.arange(wheels)
    return OmniBase(places + 0.5 * math.pi, np.full(wheels, radius_m))


BASES = ("three-wheels", "four-wheels", "legs")


def named_base(name: str) -> OmniBase | None:
    """The base of a scenario's robot; None for legs, which have no wheels. Raises InputError for another name."""
    if name not in BASES:
        raise InputError(f"base '{name}' is unknown; {did_you_mean(name, BASES)}")
    return None if name == "legs" else omni_base(3 if name == "three-wheels" else 4)
