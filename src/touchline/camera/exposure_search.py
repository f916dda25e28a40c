"""The search for the most entropy along a path of exposure settings (section 5 of Lu et al., 2013).

The place on the path is counted in stops: each doubles the light, exposure_ms · gain. Entropy rises to a peak and falls
behind it, evenly where the image is too dark, steeply where it is overexposed. Sun beside shade may make a second peak.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from pydantic import Field, model_validator

from touchline.config import Settings, added
from touchline.errors import InputError


class PathSettings(Settings):
    """The path exposure = a · gain + b, and what the camera can do. The paper's path is a = 1, b = 0."""

    a_ms: float = added(
        4.0,
        paper=1.0,
        gt=0,
        description="exposure for each unit of gain (ms): more is less noise and more motion blur; 4 keeps a lamp-lit "
        "hall below 16 ms. For a camera whose gain counts up to 50 the paper has 1",
    )
    b_ms: float = Field(0.0, description="exposure at no gain (ms); 0 is the path exposure = α · gain")
    least_exposure_ms: float = Field(0.05, gt=0, description="shortest exposure of the camera (ms)")
    longest_exposure_ms: float = Field(
        60.0, gt=0, description="longest exposure allowed (ms): a robot that turns at 1 rad/s blurs far lines by 13 px"
    )
    least_gain: float = Field(1.0, gt=0, description="lowest gain of the camera, 1 is none")
    highest_gain: float = Field(24.0, gt=0, description="highest gain allowed; the usual sensors reach 24 (28 dB)")

    @model_validator(mode="after")
    def _some_path_is_left(self) -> PathSettings:
        low, high = self.gain_range
        if not low < high:
            raise ValueError("no part of the path exposure = a · gain + b lies within the camera's limits")
        return self

    @property
    def gain_range(self) -> tuple[float, float]:
        """The gains between which exposure and gain are both allowed."""
        shortest, longest = ((limit - self.b_ms) / self.a_ms for limit in self._exposures)
        return max(self.least_gain, shortest), min(self.highest_gain, longest)

    @property
    def stops_range(self) -> tuple[float, float]:
        """The ends of the path, log2 of exposure_ms · gain."""
        low, high = (math.log2((self.a_ms * gain + self.b_ms) * gain) for gain in self.gain_range)
        return low, high

    def at(self, stops: float) -> tuple[float, float]:
        """exposure_ms and gain whose product is 2 to the power of `stops`, or the nearest end of the path."""
        light = 2.0 ** float(np.clip(stops, *self.stops_range))
        gain = (math.sqrt(self.b_ms**2 + 4.0 * self.a_ms * light) - self.b_ms) / (2.0 * self.a_ms)
        gain = float(np.clip(gain, *self.gain_range))
        return self.a_ms * gain + self.b_ms, gain

    @property
    def _exposures(self) -> tuple[float, float]:
        return self.least_exposure_ms, self.longest_exposure_ms


class SearchSettings(Settings):
    """Hill climbing along the path."""

    grabs: int = Field(8, ge=3, description="most images of one search, the first at the settings it starts from")
    step_stops: float = Field(
        0.9,
        gt=0,
        description="step of the climb (stops): half of the peak's width, so that patches of sun, which make bumps of "
        "half a stop, don't stop it",
    )
    growth: float = Field(
        1.2, ge=1, description="how much longer each step is than the last one once three have led upwards"
    )
    tolerance_stops: float = Field(
        0.3,
        gt=0,
        description="the search ends with neighbours this near on both sides: within it entropy varies by 0.05",
    )
    longest_first_step_stops: float = Field(
        4.0, gt=0, description="most that is believed of the brightness's change (stops): lamps on or off"
    )
    step_from_brightness: bool = added(
        True,
        paper=False,
        description="whether the first step is as long as the brightness says; the paper takes only its direction",
    )
    same_nats: float = Field(
        0.01, ge=0, description="difference in entropy (nats) of two images of the same, at the most: noise"
    )
    elsewhere_nats: float | None = added(
        0.4,
        paper=None,
        ge=0,
        description="entropy (nats) above the best place's that a gap elsewhere must promise to be looked into: sun "
        "beside shade may make a second peak: much, since such promises are generous. none: the paper's single climb",
    )


# Half the light leaves 2^(1/2.2) times fewer grey levels in each of three channels, so entropy rises by 3 ln 2 / 2.2
# nats a stop at the most. Where the image is overexposed it falls about three times as steeply.
_RISE, _FALL = 3.0 * math.log(2.0) / 2.2, 3.0


@dataclass(frozen=True, slots=True)
class Tried:
    """One image of a search: where on the path, with which settings, and its entropy (nats)."""

    stops: float
    exposure_ms: float
    gain: float
    entropy: float


class EntropySearch:
    """Asks for places on the path one by one: `propose`, take an image there, `tell` its entropy, until None.

    A first step that lowers the entropy turns the search round; once the peak lies between two places, a parabola
    through the best three leads to it, unless a gap elsewhere promises far more.
    """

    def __init__(self, start: float, bounds: tuple[float, float], first_step: float, settings: SearchSettings) -> None:
        if not bounds[0] < bounds[1]:
            raise InputError(f"exposure search: the path from {bounds[0]:g} to {bounds[1]:g} stops has no length")
        if first_step == 0.0:
            raise InputError("exposure search: the first step must lead somewhere")
        self.settings = settings
        self.bounds = bounds
        self.tried: dict[float, float] = {}
        self._start = float(np.clip(start, *bounds))
        self._first_step = first_step
        self._rises = 0

    @property
    def best(self) -> float:
        """The place with the most entropy so far (stops)."""
        return max(self.tried, key=lambda place: self.tried[place])

    def tell(self, stops: float, entropy: float) -> None:
        """The entropy of the image taken at a proposed place."""
        self._rises = self._rises + 1 if entropy > max(self.tried.values(), default=-np.inf) else 0
        self.tried[stops] = entropy

    def propose(self) -> float | None:
        """Where to take the next image (stops); None when the search is over."""
        if not self.tried:
            return self._start
        if len(self.tried) >= self.settings.grabs:
            return None
        if len(self.tried) == 1:
            ahead = self._new(self._start + self._first_step)
            return ahead if ahead is not None else self._new(self._start - self._first_step)
        places = sorted(self.tried)
        elsewhere = self._elsewhere(places)
        if elsewhere is not None:
            return elsewhere
        k = places.index(self.best)
        if k in (0, len(places) - 1):
            step = self.settings.step_stops * self.settings.growth ** max(self._rises - 2, 0)
            outward = self._new(self.best + (step if k else -step))
            if outward is not None:
                return outward
            return self._between(places[k - 1] if k else places[1])
        return self._within(self._told_apart(places[:k][::-1]), self.best, self._told_apart(places[k + 1 :]))

    def _elsewhere(self, places: list[float]) -> float | None:
        """Where, in a gap that doesn't touch the best place, the entropy may rise far above it; None if nowhere.

        Sun and shade may make a peak each. The steepest rise and fall bound what lies between two places (Shubert
        1972: A sequential method seeking the global maximum of a function).
        """
        worth, found = self.settings.elsewhere_nats, None
        if worth is None:
            return None
        highest = self.tried[self.best] + worth
        for low, high in itertools.pairwise(places):
            if self.best in (low, high) or high - low <= self.settings.tolerance_stops:
                continue
            way = self._way_up(low, high)
            bound = self.tried[low] + _RISE * way
            if bound > highest:
                highest, found = bound, low + float(np.clip(way / (high - low), 0.3, 0.7)) * (high - low)
        return found

    def _way_up(self, low: float, high: float) -> float:
        """How far beyond `low` the highest peak lies that fits between two places (stops)."""
        way = (self.tried[high] - self.tried[low] + _FALL * (high - low)) / (_RISE + _FALL)
        return float(np.clip(way, 0.0, high - low))

    def _told_apart(self, outwards: list[float]) -> float:
        """The nearest of the places on one side whose image differs from the best one: a camera with coarse steps
        gives the same image twice.
        """
        for place in outwards[:-1]:
            near = abs(place - self.best) <= self.settings.tolerance_stops
            if not (near and self.tried[self.best] - self.tried[place] < self.settings.same_nats):
                return place
        return outwards[-1]

    def _new(self, stops: float) -> float | None:
        """A place on the path, unless one was tried that can't be told from it."""
        place = float(np.clip(stops, *self.bounds))
        known = min(abs(place - other) for other in self.tried)
        return place if known > 0.1 * self.settings.tolerance_stops else None

    def _between(self, neighbour: float) -> float | None:
        """The path ends at the best place: what lies between it and its neighbour?"""
        best, tolerance = self.best, self.settings.tolerance_stops
        if abs(neighbour - best) <= tolerance:
            return None
        return self._new(
            best + math.copysign(min(abs(neighbour - best) / 2.0, self.settings.step_stops), neighbour - best)
        )

    def _within(self, low: float, best: float, high: float) -> float | None:
        below, above, s = best - low, high - best, self.settings
        upwards = self.tried[best] + _RISE * self._way_up(best, high) > self.tried[low] + _RISE * self._way_up(
            low, best
        )
        if min(below, above) <= s.tolerance_stops:
            upwards = above > below
        wider = above if upwards else -below
        if abs(wider) <= s.tolerance_stops:
            return None
        if abs(wider) > 1.5 * s.step_stops:  # far too wide for a parabola: a golden section, at most one step
            return self._new(best + math.copysign(min(0.38 * abs(wider), s.step_stops), wider))
        heights = [self.tried[place] for place in (low, best, high)]
        curvature, slope, _ = np.polyfit([-below, 0.0, above], heights, 2)
        peak = best - slope / (2.0 * curvature) if curvature < 0.0 else best
        if abs(peak - best) < 0.35 * s.tolerance_stops:
            peak = best + math.copysign(min(0.4 * abs(wider), 1.3 * s.tolerance_stops), wider)
        place = self._new(float(np.clip(peak, low + 0.15 * below, high - 0.15 * above)))
        return place if place is not None else self._new(best + 0.38 * wider)
